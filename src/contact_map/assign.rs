//! Who touches what: each block's pixels are given to the fewest spheres that explain them.
//!
//! A label change costs bits and noise invites it, so a block takes one sphere where one explains
//! all but a few pixels, a second or third only where it pays (`bits` below), and inside a block a
//! pixel keeps the label of the pixel before it while that one still touches (hysteresis in space).

use super::contact::{Contact, Touch};
use super::labels::{INVALID, NO_SPHERE};
use crate::deproject::{BLOCK, Rays};
use crate::fit::sphere::Sphere;

/// Most spheres one block is divided among.
pub const PALETTE: usize = 4;
/// Most candidates tried for one block.
pub const CANDIDATES: usize = 10;

/// Bits a pixel costs that no sphere of its block explains.
const MISS_BITS: u32 = 9;
/// Half bits that a pair of neighbours costs of which only one is explained: what noise scatters is
/// not worth a sphere. (0 costs 7 % more bits on D435 and D455 sequences, 9 one more in a hundred.)
const RAGGED_BITS: u32 = 4;
/// A block with at most so many pixels beyond reach is not divided further.
const SETTLED: u32 = 2;
/// Where all but so many pixels are within reach of the block's own spheres none around is tried.
const ENOUGH: u32 = 4;
/// Bits one more sphere costs in a block: its number and the boundary.
const SPLIT_BITS: [u32; PALETTE] = [0, 26, 24, 24];

/// The spheres of one block, most pixels first, [`NO_SPHERE`] behind the last.
pub type Palette = [u16; PALETTE];

/// No sphere at all.
pub const EMPTY: Palette = [NO_SPHERE; PALETTE];

/// Candidate spheres of one block, each once, in order of preference.
#[derive(Clone, Copy, Debug, Default)]
pub struct Candidates {
    ids: [u16; CANDIDATES],
    len: usize,
    /// Bit `id % 64` is set for each of the list: most of those not in it are told by that alone.
    seen: u64,
}

impl Candidates {
    /// Adds a sphere unless it is there already, is none, or the list is full.
    #[inline(always)]
    pub fn add(&mut self, id: u16) {
        let bit = 1 << (id % 64);
        let mut there = false;
        if self.seen & bit != 0 {
            for &other in self.ids() {
                there |= other == id;
            }
        }
        if id < NO_SPHERE && self.len < CANDIDATES && !there {
            self.ids[self.len] = id;
            self.len += 1;
            self.seen |= bit;
        }
    }

    /// The list.
    #[must_use]
    pub fn ids(&self) -> &[u16] {
        &self.ids[..self.len]
    }
}

/// What became of one block.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BlockContacts {
    /// Spheres that have pixels here.
    pub palette: Palette,
    /// Pixels of each palette entry (bit `8·row + column`), disjoint.
    pub pixels: [u64; PALETTE],
    /// Measured pixels that none of them touches.
    pub missing: u64,
    /// Measured pixels that are beyond reach along the ray: these and more.
    pub rough: u64,
}

impl Default for BlockContacts {
    fn default() -> Self {
        Self {
            palette: EMPTY,
            pixels: [0; PALETTE],
            missing: 0,
            rough: 0,
        }
    }
}

impl BlockContacts {
    /// No sphere touches any of the `valid` pixels.
    #[inline(always)]
    #[must_use]
    pub fn untouched(valid: u64) -> Self {
        Self {
            missing: valid,
            rough: valid,
            ..Self::default()
        }
    }

    /// The label of a pixel (bit `8·row + column`): [`INVALID`] where nothing was measured.
    #[inline(always)]
    #[must_use]
    pub fn label(&self, bit: usize) -> u16 {
        let own = |pixels: &u64| pixels >> bit & 1 != 0;
        match self.pixels.iter().position(own) {
            Some(entry) => self.palette[entry],
            None if own(&self.missing) => NO_SPHERE,
            None => INVALID,
        }
    }

    /// What the first sphere touches where it is the only one.
    #[inline(always)]
    fn first_touch(&self, valid: u64) -> Touch {
        Touch {
            touching: self.pixels[0],
            along_ray: valid & !self.rough,
        }
    }

    /// The free entry of the palette that a sphere for the untouched pixels would take; none where
    /// it would save nothing.
    #[inline(always)]
    #[must_use]
    pub fn wants(&self) -> Option<usize> {
        let free = self.palette.iter().position(|&id| id == NO_SPHERE)?;
        (MISS_BITS * self.missing.count_ones() > SPLIT_BITS[free]).then_some(free)
    }

    /// Takes the spheres for which `gone` is true off the block: what was theirs is untouched.
    pub fn release(&mut self, gone: impl Fn(u16) -> bool) {
        let before = *self;
        (self.palette, self.pixels) = (EMPTY, [0; PALETTE]);
        let mut kept = 0;
        for (&id, &pixels) in before.palette.iter().zip(&before.pixels) {
            if id == NO_SPHERE {
                break;
            }
            if gone(id) {
                self.missing |= pixels;
                self.rough |= pixels;
            } else {
                (self.palette[kept], self.pixels[kept]) = (id, pixels);
                kept += 1;
            }
        }
    }
}

/// One block as the contact pass sees it.
#[derive(Clone, Copy, Debug)]
pub struct Block<'a> {
    /// Depth integers, padded to whole blocks, 0 where nothing is measured.
    pub plane: &'a [u16],
    /// The rays of its pixels.
    pub rays: &'a Rays,
    /// Block column and row.
    pub at: (usize, usize),
    /// Measured pixels (bit `8·row + column`).
    pub valid: u64,
    /// All spheres.
    pub spheres: &'a [Option<Sphere>],
    /// Who touches.
    pub contact: &'a Contact,
}

impl Block<'_> {
    /// The measured pixels that touch sphere `id`; within reach along the ray is touching, too.
    #[inline(always)] // a closure would lose the caller's vector instructions
    fn touch(&self, id: u16) -> Touch {
        let Some(Some(sphere)) = self.spheres.get(usize::from(id)) else {
            return Touch::default();
        };
        let t = self.contact.pixels(self.plane, self.rays, self.at, sphere);
        Touch {
            touching: (t.touching | t.along_ray) & self.valid,
            along_ray: t.along_ray & self.valid,
        }
    }

    /// True where one sphere explains (nearly) all: what it leaves is too little for another one.
    #[inline(always)]
    fn settles(&self, touch: Touch) -> bool {
        let beyond = self.valid & !touch.along_ray;
        let apart = self.valid & !touch.touching;
        let enough = saving(beyond) <= SPLIT_BITS[1] && apart.count_ones() <= SETTLED;
        (beyond.count_ones() <= SETTLED || enough) && self.valid.count_ones() > 8
    }

    /// All that touches `id` to `id`.
    #[inline(always)]
    #[must_use]
    pub fn alone(&self, id: u16, touch: Touch) -> BlockContacts {
        let mut out = BlockContacts {
            missing: self.valid & !touch.touching,
            rough: self.valid & !touch.along_ray,
            ..Default::default()
        };
        if touch.touching != 0 {
            out.palette[0] = id;
            out.pixels[0] = touch.touching;
        }
        out
    }

    /// All to `id`, which is known to lie within reach of everything here.
    #[inline(always)]
    #[must_use]
    pub fn whole(&self, id: u16) -> BlockContacts {
        self.alone(
            id,
            Touch {
                touching: self.valid,
                along_ray: self.valid,
            },
        )
    }

    /// Tries `first` alone. True where it explains (nearly) all and the block is done; what touches
    /// it is its own either way.
    #[inline(always)]
    #[must_use]
    pub fn hold(&self, first: u16) -> (BlockContacts, bool) {
        // most blocks lie within reach of their sphere along the ray: the cheaper question first
        if let Some(Some(sphere)) = self.spheres.get(usize::from(first)) {
            let (contact, plane, rays, at) = (self.contact, self.plane, self.rays, self.at);
            let all = match self.valid {
                u64::MAX => contact.all_along_ray::<true>(plane, rays, at, sphere),
                _ => contact.all_along_ray::<false>(plane, rays, at, sphere),
            };
            if all && self.valid.count_ones() > 8 {
                return (self.whole(first), true);
            }
        }
        let own = self.touch(first);
        (self.alone(first, own), self.settles(own))
    }

    /// Divides the measured pixels among spheres: all to one where that one explains nearly all,
    /// else among the candidates that `gather` adds: those known of the block itself, then, where
    /// `true` is passed, those of the blocks around. `held` is what [`hold`](Self::hold) found for
    /// `first`.
    #[inline(always)]
    #[must_use]
    pub fn divide(
        &self,
        first: u16,
        held: &BlockContacts,
        gather: impl Fn(&mut Candidates, bool),
    ) -> BlockContacts {
        let own = held.first_touch(self.valid);
        let mut trial = Trial::new(self.valid);
        for around in [false, true] {
            let known = trial.candidates.len;
            gather(&mut trial.candidates, around);
            for k in known..trial.candidates.len {
                // those around until enough is explained
                if around && trial.beyond.count_ones() <= ENOUGH {
                    trial.candidates.len = k;
                    break;
                }
                let id = trial.candidates.ids[k];
                let touch = if id == first { own } else { self.touch(id) };
                if self.settles(touch) {
                    return self.alone(id, touch);
                }
                trial.put(k, touch);
            }
            // the spheres that were here before still divide it among them
            let beyond = trial.beyond.count_ones();
            if beyond <= ENOUGH || (trial.apart == 0 && beyond <= 2 * ENOUGH) {
                break;
            }
        }
        trial.cover(self.valid)
    }

    /// Divides the pixels among the `fresh` spheres and those of the block, which are as they were
    /// when it was divided.
    #[inline(always)]
    pub fn extend(&self, contacts: &mut BlockContacts, fresh: &Candidates) {
        if fresh.len == 0 {
            return;
        }
        let mut trial = Trial::new(self.valid);
        let alone = contacts.palette[1] == NO_SPHERE;
        for id in contacts.palette {
            trial.candidates.add(id);
        }
        for k in 0..trial.candidates.len {
            let touch = if alone {
                contacts.first_touch(self.valid)
            } else {
                self.touch(trial.candidates.ids[k])
            };
            trial.put(k, touch);
        }
        for &id in fresh.ids() {
            let k = trial.candidates.len;
            trial.candidates.add(id);
            if trial.candidates.len > k {
                let touch = self.touch(id);
                if self.settles(touch) {
                    *contacts = self.alone(id, touch);
                    return;
                }
                trial.put(k, touch);
            }
        }
        *contacts = trial.cover(self.valid);
    }
}

/// Candidates and what they touch.
struct Trial {
    candidates: Candidates,
    touch: [Touch; CANDIDATES],
    /// Pixels that none of them reaches along the ray.
    beyond: u64,
    /// Pixels that none of them touches.
    apart: u64,
}

impl Trial {
    #[inline(always)]
    fn new(valid: u64) -> Self {
        Self {
            candidates: Candidates::default(),
            touch: [Touch::default(); CANDIDATES],
            beyond: valid,
            apart: valid,
        }
    }

    /// What candidate `k` touches.
    #[inline(always)]
    fn put(&mut self, k: usize, touch: Touch) {
        self.touch[k] = touch;
        self.beyond &= !touch.along_ray;
        self.apart &= !touch.touching;
    }

    /// The pixels, divided among the candidates.
    #[inline(always)]
    fn cover(&self, valid: u64) -> BlockContacts {
        cover(valid, self.candidates.ids(), &self.touch)
    }
}

/// Greedy cover: first along the ray, then what merely touches.
#[inline(always)]
fn cover(valid: u64, ids: &[u16], touch: &[Touch; CANDIDATES]) -> BlockContacts {
    let mut out = BlockContacts::default();
    let mut chosen = [Touch::default(); PALETTE];
    let mut n = 0;
    let mut covered = 0u64;
    let mut rough = valid;
    for along_ray in [true, false] {
        while n < PALETTE {
            let mut best = (SPLIT_BITS[n], None);
            for (k, t) in touch.iter().enumerate().take(ids.len()) {
                let pixels = if along_ray { t.along_ray } else { t.touching } & !covered;
                let most = MISS_BITS * pixels.count_ones();
                if most <= best.0 {
                    continue;
                }
                // what touches nothing has a border either way
                let gain = if along_ray { saving(pixels) } else { most };
                if gain > best.0 {
                    best = (gain, Some(k));
                }
            }
            let Some(k) = best.1 else { break };
            let taken = touch[k];
            covered |= if along_ray {
                taken.along_ray
            } else {
                taken.touching
            };
            chosen[n] = taken;
            out.palette[n] = ids[k];
            n += 1;
        }
        if along_ray {
            rough &= !covered;
            for taken in &chosen[..n] {
                covered |= taken.touching;
            }
        }
    }
    out.missing = valid & !covered;
    out.rough = rough;
    // a pixel that one of them reaches along the ray does not go to one that merely touches it
    let reached = chosen.map(|t| t.touching & (t.along_ray | rough));
    if n == 1 {
        out.pixels[0] = covered;
    } else {
        share(covered, &reached, n, &mut out.pixels);
    }
    // most pixels first; entries that ended up empty go
    for c in 0..n {
        for d in c + 1..n {
            if out.pixels[d].count_ones() > out.pixels[c].count_ones() {
                out.pixels.swap(c, d);
                out.palette.swap(c, d);
            }
        }
    }
    for c in 0..n {
        if out.pixels[c] == 0 {
            out.palette[c] = NO_SPHERE;
        }
    }
    out
}

/// Neighbouring pixels of which one is in the set.
#[inline(always)]
fn edges(set: u64) -> u32 {
    const RIGHT: u64 = 0x7F7F_7F7F_7F7F_7F7F;
    ((set ^ (set >> 1)) & RIGHT).count_ones() + ((set ^ (set >> 8)) & (u64::MAX >> 8)).count_ones()
}

/// Bits saved where a sphere explains these pixels, less what their border costs.
#[inline(always)]
fn saving(pixels: u64) -> u32 {
    (MISS_BITS * pixels.count_ones()).saturating_sub(RAGGED_BITS * edges(pixels) / 2)
}

/// Gives the pixels of `left` to the first `n` spheres, of which each reaches `reached`: in the
/// order of coding, row by row, each run to the one that goes on longest, then to whoever was on,
/// then to whoever has more.
#[inline(always)]
fn share(left: u64, reached: &[u64; PALETTE], n: usize, pixels: &mut [u64; PALETTE]) {
    let size = reached.map(u64::count_ones);
    let mut current = 0;
    for j in 0..BLOCK {
        let rest = left & (u64::MAX << (8 * j));
        if rest & !reached[current] == 0 {
            // whoever is on reaches all that is left
            pixels[current] |= rest;
            return;
        }
        let mut row = (rest >> (8 * j)) as u32 & 0xFF;
        while row != 0 {
            if row & !((reached[current] >> (8 * j)) as u32) == 0 {
                pixels[current] |= u64::from(row) << (8 * j);
                break;
            }
            let start = row.trailing_zeros();
            let mut best = (0, 0);
            for c in 0..n {
                let own = (reached[c] >> (8 * j)) as u32 & row;
                let run = (!(own >> start)).trailing_zeros();
                let key = 256 * run + 128 * u32::from(c == current) + size[c];
                if key >= best.0 {
                    best = (key, c);
                }
            }
            current = best.1;
            let run = (best.0 >> 8).max(1);
            let taken = row & (((1 << run) - 1) << start);
            pixels[current] |= u64::from(taken) << (8 * j);
            row &= !taken;
        }
    }
}

/// Offers the untouched pixels of the block at `at` to `candidates` (spheres around it that it was
/// not divided among), as entries of its palette still free. True where one was taken.
pub fn adopt(
    contacts: &mut BlockContacts,
    candidates: &Candidates,
    pixels: impl Fn(u16) -> u64,
) -> bool {
    let mut touching = [0; CANDIDATES];
    for (touching, &id) in touching.iter_mut().zip(candidates.ids()) {
        *touching = pixels(id) & contacts.missing;
    }
    let touching = &mut touching[..candidates.len];
    let mut adopted = false;
    while let Some(free) = contacts.wants() {
        // the first of those with most pixels
        let best = (0..touching.len())
            .rev()
            .max_by_key(|&k| touching[k].count_ones());
        let Some(k) = best.filter(|&k| MISS_BITS * touching[k].count_ones() > SPLIT_BITS[free])
        else {
            break;
        };
        contacts.palette[free] = candidates.ids[k];
        contacts.pixels[free] = touching[k];
        contacts.missing &= !touching[k];
        for pixels in touching.iter_mut() {
            *pixels &= contacts.missing;
        }
        adopted = true;
    }
    adopted
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::contact_map::contact::measured;
    use crate::fit::contact_distance::ContactDistance;
    use crate::frame::{Camera, Intrinsics};
    use glam::DVec3;
    use proptest::prelude::*;

    const CAMERA: Camera = Camera {
        width: 8,
        height: 8,
        intrinsics: Intrinsics {
            fx: 80.0,
            fy: 80.0,
            cx: 3.5,
            cy: 3.5,
        },
        depth_unit_m: 0.001,
        invalid: vec![],
        depth_min_m: 0.0,
        depth_max_m: 65.0,
        fps: None,
        name: String::new(),
    };

    proptest! {
        /// Two walls and a ball, holes and noise: every measurement goes to a sphere that it
        /// touches, once, or is missing.
        #[test]
        fn pixels_are_divided_among_spheres_they_touch(
            edge in 0usize..9, far in 1.0f64..1.5, noise in 0f64..0.03, holes in any::<u64>(), seed in any::<u64>(),
        ) {
            let rays = Rays::new(&CAMERA);
            let wall = |z: f64| Sphere::from_center_radius(DVec3::new(0.0, 0.0, z + 500.0), 500.0);
            let ball = Sphere::from_center_radius(DVec3::new(0.03, 0.0, 1.0), 0.05);
            let spheres = [wall(1.0), None, wall(far), ball];
            let mut random = seed | 1;
            let mut next = || { random ^= random << 13; random ^= random >> 7; random ^= random << 17; (random >> 40) as f64 / (1u64 << 24) as f64 };
            let plane: Vec<u16> = (0..64).map(|k| {
                let z = if k % 8 < edge { 1.0 } else { far };
                if holes & holes >> 7 & 1 << k != 0 { 0 } else { ((z + (next() - 0.5) * noise) * 1e3) as u16 }
            }).collect();
            let valid = measured(&plane, &rays, (0, 0));
            let distance = ContactDistance::constant(0.01);
            let contact = Contact::new(&distance, 0.9);
            let gather = |list: &mut Candidates, around: bool| if around { list.add(2); list.add(3) } else { list.add(0); list.add(1) };
            let block = Block { plane: &plane, rays: &rays, at: (0, 0), valid, spheres: &spheres, contact: &contact };
            let (held, done) = block.hold(0);
            let mut out = if done { held } else { block.divide(0, &held, gather) };
            prop_assert_eq!(out.missing & !out.rough, 0);
            let mut all = Candidates::default();
            for id in 0..4 { if !out.palette.contains(&id) { all.add(id); } }
            let before = out.missing.count_ones();
            let more = adopt(&mut out, &all, |id| spheres[usize::from(id)].map_or(0, |s| contact.pixels(&plane, &rays, (0, 0), &s).touching));
            prop_assert!(out.missing.count_ones() < before || !more);
            let mut seen = 0u64;
            for (&id, &pixels) in out.palette.iter().zip(&out.pixels) {
                prop_assert_eq!(id == NO_SPHERE, pixels == 0);
                prop_assert_eq!(seen & pixels, 0);
                seen |= pixels;
                for bit in (0..64).filter(|b| pixels >> b & 1 != 0) {
                    let p = rays.point(bit % 8, bit / 8, f64::from(plane[bit]) * 1e-3);
                    prop_assert!(spheres[usize::from(id)].unwrap().distance(p) < 0.01 + 1e-5);
                }
            }
            prop_assert_eq!(seen | out.missing, valid);
            prop_assert_eq!(seen & out.missing, 0);
        }
    }
}
