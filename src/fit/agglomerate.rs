//! Cold fit: small surfaces grown into the largest that still fit, by additive moments.
//!
//! Deviation. Paper 3.2 tries, per cube, radii "from the smallest to the largest that fits" and
//! assigns point by point. We start from the smallest patches (one image block each) and unite
//! neighbours while one sphere for both costs fewer bits than two: the same progression from small
//! to large, but O(1) a step and without a radius grid. First inside each hex-packed cell (cells
//! are independent), then across cells.

use super::moments::{Fit, Moments, SPHERE_BITS, bits_per_point};
use std::cmp::Ordering;
use std::collections::BinaryHeap;

/// One surface of the graph: its points' moments, the sphere through them and what it costs.
#[derive(Clone, Copy, Debug)]
pub struct Patch {
    /// Sums over the patch's points.
    pub moments: Moments,
    /// Best surface.
    pub fit: Fit,
    /// Bits for the points on that surface.
    pub bits: f64,
}

impl Patch {
    /// The patch of these points; `None` where no surface is defined.
    #[must_use]
    pub fn new(moments: Moments) -> Option<Self> {
        let fit = moments.fit()?;
        Some(Self {
            moments,
            fit,
            bits: moments.bits(fit.misfit),
        })
    }

    /// Both patches on one surface.
    fn union(&self, other: &Self) -> Option<Self> {
        let moments = self.moments.union(&other.moments);
        let (fit, bits) = self.on_one(other, &moments)?;
        Some(Self { moments, fit, bits })
    }

    /// The surface of both, of which `moments` are the sums, and the bits. Each part is priced by its
    /// own misfit: a mean over the union would let a large good part hide a small bad one.
    #[inline]
    fn on_one(&self, other: &Self, moments: &Moments) -> Option<(Fit, f64)> {
        let fit = moments.fit()?;
        let part = |p: &Self| p.moments.count * bits_per_point(p.moments.misfit(&fit.sphere));
        Some((fit, SPHERE_BITS + part(self) + part(other)))
    }
}

/// A possible union, best gain first; ties by index, so that the order never depends on anything
/// but the input.
#[derive(Clone, Copy, Debug)]
struct Union {
    gain: f32,
    a: u32,
    b: u32,
    age: u32,
}

impl PartialEq for Union {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}
impl Eq for Union {}
impl PartialOrd for Union {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}
impl Ord for Union {
    fn cmp(&self, other: &Self) -> Ordering {
        self.gain
            .total_cmp(&other.gain)
            .then_with(|| (other.a, other.b).cmp(&(self.a, self.b)))
    }
}

/// Patches of which neither is this near to the other's surface (mean square, contact distances)
/// are not united: one surface for both would have to leave them as far.
const APART: f64 = 12.0;
/// Pairs of patches priced between two looks at the clock.
const STRIDE: u32 = 128;

/// No entry.
const NONE: u32 = u32::MAX;

/// One entry of a list of neighbours: a patch and the entry after it.
#[derive(Clone, Copy, Debug)]
struct Link {
    to: u32,
    next: u32,
}

/// The neighbours of one patch: a chain through `Agglomeration::links`. Chains are joined without
/// moving them, and all of them share one buffer that a frame does not have to grow.
#[derive(Clone, Copy, Debug)]
struct Neighbours {
    first: u32,
    last: u32,
    count: u32,
}

impl Neighbours {
    const EMPTY: Self = Self {
        first: NONE,
        last: NONE,
        count: 0,
    };
}

/// A graph of patches that are united while that saves bits. Buffers are kept between frames.
#[derive(Debug, Default)]
pub struct Agglomeration {
    patches: Vec<Patch>,
    parent: Vec<u32>,
    age: Vec<u32>,
    /// Ages when the last run began.
    former: Vec<u32>,
    neighbours: Vec<Neighbours>,
    links: Vec<Link>,
    heap: BinaryHeap<Union>,
    seen: Vec<u32>,
    stamp: u32,
}

impl Agglomeration {
    /// Forgets all patches, keeps the buffers.
    pub fn clear(&mut self) {
        self.patches.clear();
        self.parent.clear();
        self.age.clear();
        self.former.clear();
        self.heap.clear();
        self.neighbours.clear();
        self.links.clear();
    }

    /// Adds a patch and returns its number.
    pub fn push(&mut self, patch: Patch) -> u32 {
        let k = self.patches.len();
        self.patches.push(patch);
        self.parent.push(k as u32);
        self.age.push(0);
        self.neighbours.push(Neighbours::EMPTY);
        k as u32
    }

    /// Says that two patches touch.
    pub fn touch(&mut self, a: u32, b: u32) {
        if a != b {
            self.link(a, b);
            self.link(b, a);
        }
    }

    /// Appends `to` to the neighbours of `from`.
    fn link(&mut self, from: u32, to: u32) {
        let entry = self.links.len() as u32;
        self.links.push(Link { to, next: NONE });
        let list = &mut self.neighbours[from as usize];
        if list.count == 0 {
            list.first = entry;
        } else {
            self.links[list.last as usize].next = entry;
        }
        list.last = entry;
        list.count += 1;
    }

    /// Makes `patch` the union of `members`, roots without neighbours so far, under the first.
    pub fn absorb(&mut self, members: [u32; 4], patch: Patch) {
        let [keep, gone @ ..] = members;
        self.patches[keep as usize] = patch;
        for k in gone {
            self.parent[k as usize] = keep;
        }
    }

    /// Number of patches pushed.
    #[must_use]
    pub fn len(&self) -> usize {
        self.patches.len()
    }

    /// True without any patch.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.patches.is_empty()
    }

    /// The patch that `k` is part of now.
    #[must_use]
    pub fn root(&self, mut k: u32) -> u32 {
        while self.parent[k as usize] != k {
            k = self.parent[k as usize];
        }
        k
    }

    /// The union under root `k`.
    #[must_use]
    pub fn patch(&self, k: u32) -> &Patch {
        &self.patches[k as usize]
    }

    /// Unites touching patches, best saving first, while there is one and `stop` says false: it is
    /// asked once in so many pairs. `allowed` restricts which pairs may be united (patches of one
    /// cell); pairs that the run before has `tried` are priced again where one of the two has grown
    /// since. False where it was stopped.
    pub fn run(
        &mut self,
        allowed: impl Fn(u32, u32) -> bool,
        tried: impl Fn(u32, u32) -> bool,
        stop: &dyn Fn() -> bool,
    ) -> bool {
        self.heap.clear();
        self.seen.resize(self.patches.len(), 0);
        let mut pairs = 0u32;
        let mut stopped = || {
            pairs += 1;
            pairs.is_multiple_of(STRIDE) && stop()
        };
        for a in 0..self.patches.len() as u32 {
            if self.root(a) != a {
                continue;
            }
            let still = self.is_as_before(a);
            self.stamp += 1;
            let mut entry = self.neighbours[a as usize].first;
            while entry != NONE {
                let Link { to, next } = self.links[entry as usize];
                let b = self.root(to);
                if a < b && self.seen[b as usize] != self.stamp && allowed(a, b) {
                    self.seen[b as usize] = self.stamp;
                    if !(still && self.is_as_before(b) && tried(a, b)) {
                        if stopped() {
                            return false;
                        }
                        self.propose(a, b);
                    }
                }
                entry = next;
            }
        }
        self.former.clone_from(&self.age);
        while let Some(best) = self.heap.pop() {
            let (a, b) = (self.root(best.a), self.root(best.b));
            if a == b {
                continue;
            }
            if stopped() {
                return false;
            }
            // one of the two has grown since: priced anew now that its turn has come
            let age = self.age[a as usize].wrapping_add(self.age[b as usize]);
            if (a.min(b), a.max(b), age) != (best.a, best.b, best.age) {
                if allowed(a, b) {
                    self.propose(a, b);
                }
                continue;
            }
            self.unite(a, b);
        }
        true
    }

    /// True where patch `k` has not grown since the last run began.
    fn is_as_before(&self, k: u32) -> bool {
        self.former.get(k as usize) == Some(&self.age[k as usize])
    }

    fn propose(&mut self, a: u32, b: u32) {
        let (pa, pb) = (&self.patches[a as usize], &self.patches[b as usize]);
        let apart = |p: &Patch, q: &Patch| p.moments.misfit(&q.fit.sphere) > APART;
        if apart(pa, pb) && apart(pb, pa) {
            return;
        }
        if let Some((_, bits)) = pa.on_one(pb, &pa.moments.union(&pb.moments)) {
            let gain = pa.bits + pb.bits - bits;
            if gain > 0.0 {
                let age = self.age[a as usize].wrapping_add(self.age[b as usize]);
                self.heap.push(Union {
                    gain: gain as f32,
                    a: a.min(b),
                    b: a.max(b),
                    age,
                });
            }
        }
    }

    fn unite(&mut self, a: u32, b: u32) {
        let Some(union) = self.patches[a as usize].union(&self.patches[b as usize]) else {
            return;
        };
        // the one with more neighbours keeps its number: fewer are moved
        let count = |k: u32| self.neighbours[k as usize].count;
        let (keep, gone) = if count(a) >= count(b) { (a, b) } else { (b, a) };
        self.patches[keep as usize] = union;
        self.parent[gone as usize] = keep;
        self.age[keep as usize] = self.age[keep as usize]
            .wrapping_add(self.age[gone as usize])
            .wrapping_add(1);
        self.join(keep, gone);
    }

    /// Gives the neighbours of `gone` to `keep`, one entry for each root.
    fn join(&mut self, keep: u32, gone: u32) {
        let moved = std::mem::replace(&mut self.neighbours[gone as usize], Neighbours::EMPTY);
        let own = self.neighbours[keep as usize];
        let first = if own.count == 0 {
            moved.first
        } else {
            self.links[own.last as usize].next = moved.first;
            own.first
        };
        self.stamp += 1;
        self.seen.resize(self.patches.len(), 0);
        // entries that stay move to the front of the chain
        let mut joined = Neighbours::EMPTY;
        let (mut read, mut write) = (first, first);
        while read != NONE {
            let Link { to, next } = self.links[read as usize];
            let root = self.root(to);
            if root != keep && self.seen[root as usize] != self.stamp {
                self.seen[root as usize] = self.stamp;
                let entry = &mut self.links[write as usize];
                entry.to = root;
                joined.last = write;
                joined.count += 1;
                write = entry.next;
            }
            read = next;
        }
        if joined.count > 0 {
            joined.first = first;
            self.links[joined.last as usize].next = NONE;
        }
        self.neighbours[keep as usize] = joined;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// A grid of small patches on a few planes at slants, neighbours touching.
    fn grid(depths: &[f64], slants: &[f64]) -> Agglomeration {
        let mut graph = Agglomeration::default();
        for k in 0..36u32 {
            let (x, y) = (f64::from(k % 6), f64::from(k / 6));
            let mut moments = Moments::default();
            for i in 0..25 {
                let u = 0.1 * (x - 3.0) + 0.02 * f64::from(i % 5);
                let v = 0.1 * (y - 3.0) + 0.02 * f64::from(i / 5);
                let which = k as usize % depths.len();
                let w = 1.0 / depths[which] + slants[which] * (u + u * v);
                moments.add_point(u, v, w, 1e4);
            }
            if let Some(patch) = Patch::new(moments) {
                graph.push(patch);
            }
        }
        for k in 0..graph.len() as u32 {
            for n in [k + 1, k + 6] {
                if (n as usize) < graph.len() {
                    graph.touch(k, n);
                }
            }
        }
        graph
    }

    proptest! {
        /// Pairs that are passed over because they have been tried would not have been united.
        #[test]
        fn a_pair_that_saved_nothing_is_not_needed_again(
            depths in prop::collection::vec(1.0f64..1.1, 1..4), slant in -0.2f64..0.2,
        ) {
            let slants: Vec<f64> = (0..depths.len()).map(|k| slant * k as f64).collect();
            let left = |a: u32, b: u32| a % 6 < 3 && b % 6 < 3;
            let roots = |again: bool| {
                let mut graph = grid(&depths, &slants);
                let done = graph.run(left, |_, _| false, &|| false)
                    && graph.run(|_, _| true, |a, b| !again && left(a, b), &|| false)
                    && graph.run(|_, _| true, |_, _| !again, &|| false);
                assert!(done);
                (0..graph.len() as u32).map(|k| graph.root(k)).collect::<Vec<_>>()
            };
            let (once, again) = (roots(false), roots(true));
            prop_assert!(once.iter().zip(0u32..).any(|(&root, k)| root != k));
            prop_assert_eq!(once, again);
        }
    }
}
