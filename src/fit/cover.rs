//! Which points each sphere covers, and the spheres that the others make superfluous.

use super::block_set::{BlockSet, Counts, list_bits};
use super::cloud::{CloudSphere, UNASSIGNED};
use super::lanes::Lanes;
use super::ordered::Ordered;
use super::point_moments::PointMoments;

/// Shares of the way to the least-squares fit that are tried.
const SETTLE: [f64; 3] = [1.0, 0.5, 0.25];
/// Points that determine a least-squares fit: more change it by less than the contact distance
/// is worth.
const SETTLE_POINTS: usize = 512;

/// Spheres over a fixed set of points. A point may be covered by several.
#[derive(Clone, Debug, Default)]
pub(crate) struct Cover {
    pub spheres: Vec<CloudSphere>,
    /// The points each sphere covers.
    members: Vec<BlockSet>,
    /// How many spheres cover each point.
    covers: Counts,
}

/// A sphere of the cover as it was.
#[derive(Clone, Debug)]
pub(crate) struct Former {
    s: usize,
    sphere: CloudSphere,
    members: BlockSet,
}

impl Cover {
    /// No sphere over `points` points yet.
    pub fn new(points: usize) -> Self {
        Self {
            covers: Counts::new(points),
            ..Self::default()
        }
    }

    /// Takes in a sphere and the points that touch it.
    pub fn push(&mut self, sphere: CloudSphere, members: BlockSet) {
        self.covers.add(&members);
        self.spheres.push(sphere);
        self.members.push(members);
    }

    /// Drops the sphere with the fewest points of its own, again and again, while no more than
    /// `allowed` points stay uncovered. Greedy covering leaves such spheres: later ones cover
    /// what an early one was chosen for. O(blocks of all members) for each sphere dropped.
    pub fn prune(&mut self, allowed: usize) {
        let mut uncovered = self.uncovered_count();
        loop {
            let own = self.own_counts();
            let Some(s) = (0..own.len()).min_by_key(|&s| own[s]) else {
                break;
            };
            if uncovered + own[s] > allowed {
                break;
            }
            uncovered += own[s];
            self.covers.remove(&self.members[s]);
            self.forget(s);
        }
    }

    /// Points that only sphere `s` covers, for each `s`.
    pub fn own_counts(&self) -> Vec<usize> {
        let own = |members: &BlockSet| {
            let alone = |&(block, bits): &(u32, u64)| bits & self.covers.once(block);
            let ones = members.blocks.iter().map(|b| alone(b).count_ones());
            ones.sum::<u32>() as usize
        };
        self.members.iter().map(own).collect()
    }

    /// The points that only sphere `s` covers, into `places`.
    pub fn own(&self, s: usize, places: &mut Vec<u32>) {
        places.clear();
        for &(block, bits) in &self.members[s].blocks {
            list_bits(block, bits & self.covers.once(block), places);
        }
    }

    /// Takes the members of sphere `s` away. `open` gets the points that nobody covers then.
    pub fn take(&mut self, s: usize, open: &mut Vec<u32>) -> Former {
        let none = Former {
            s,
            sphere: self.spheres[s],
            members: BlockSet::default(),
        };
        self.put(none, open)
    }

    /// Puts `sphere` in the place of sphere `s`; gives what was there. `open` as in
    /// [`Cover::take`].
    pub fn replace(
        &mut self,
        s: usize,
        sphere: CloudSphere,
        points: &Ordered,
        open: &mut Vec<u32>,
    ) -> Former {
        let members = points.touching(&sphere);
        self.put(Former { s, sphere, members }, open)
    }

    /// The points that no sphere covers, into `open`.
    pub fn uncovered(&self, open: &mut Vec<u32>) {
        open.clear();
        for block in 0..self.covers.blocks() {
            list_bits(block, self.covers.never(block), open);
        }
    }

    fn uncovered_count(&self) -> usize {
        let bare = (0..self.covers.blocks()).map(|b| self.covers.never(b).count_ones() as usize);
        bare.sum()
    }

    fn put(&mut self, new: Former, open: &mut Vec<u32>) -> Former {
        self.swap(new, Some(open))
    }

    fn swap(&mut self, new: Former, open: Option<&mut Vec<u32>>) -> Former {
        let s = new.s;
        self.covers.remove(&self.members[s]);
        self.covers.add(&new.members);
        let former = Former {
            s,
            sphere: std::mem::replace(&mut self.spheres[s], new.sphere),
            members: std::mem::replace(&mut self.members[s], new.members),
        };
        if let Some(open) = open {
            self.uncovered(open);
        }
        former
    }

    /// Takes the steps back, the last first.
    pub fn undo(&mut self, steps: Vec<Former>) {
        for step in steps.into_iter().rev() {
            self.swap(step, None);
        }
    }

    /// Forgets sphere `s`, which has no members.
    pub fn forget(&mut self, s: usize) {
        self.spheres.remove(s);
        self.members.remove(s);
    }

    /// Moves each sphere towards the least-squares fit of its members, as far as it keeps the
    /// points that only it covers: what was bent for more contacts need not lie at the rim of
    /// the contact band.
    pub fn settle(&mut self, points: &Ordered) {
        let mut alone = Lanes::default();
        let mut places = Vec::new();
        for s in 0..self.spheres.len() {
            places.clear();
            self.members[s].list(&mut places);
            let mut moments = PointMoments::default();
            let stride = (places.len() / SETTLE_POINTS).max(1);
            for &i in places.iter().step_by(stride) {
                moments.add(points.at(i as usize));
            }
            let Some(fit) = moments.fit() else { continue };
            let before = self.spheres[s];
            self.own(s, &mut places);
            let near = points.at(places.first().map_or(0, |&i| i as usize));
            alone.pick(&points.lanes, &places);
            let settled = SETTLE
                .iter()
                .filter_map(|&share| before.towards(&fit.sphere, near, share))
                .find(|sphere| {
                    points.lanes.resolves(sphere) && alone.touching(sphere) == alone.len()
                });
            if let Some(sphere) = settled {
                let members = points.touching(&sphere);
                self.swap(Former { s, sphere, members }, None);
            }
        }
    }

    /// Gives every covered point to the nearest of its spheres: `assignment[id]`, by number in
    /// `spheres`.
    pub fn assign(&self, points: &Ordered, assignment: &mut [u32]) {
        let mut nearest = vec![f32::INFINITY; points.len()];
        let mut owner = vec![UNASSIGNED; points.len()];
        for (s, (sphere, members)) in (0u32..).zip(self.spheres.iter().zip(&self.members)) {
            points
                .lanes
                .offer((s, sphere), members, (&mut nearest, &mut owner));
        }
        for (&id, &owner) in points.lanes.id.iter().zip(&owner) {
            assignment[id as usize] = owner;
        }
    }
}
