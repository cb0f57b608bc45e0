//! Who touches what: each block's pixels are given to the fewest spheres that explain them.
//!
//! A label change costs bits and noise invites it, so a block takes one sphere where one explains
//! all but a few pixels, a second or third only where it pays (`bits` below), and inside a block a
//! pixel keeps the label of the pixel before it while that one still touches (hysteresis in space).

use super::contact::{Contact, Touch};
use super::labels::NO_SPHERE;
use crate::deproject::Rays;
use crate::fit::sphere::Sphere;

/// Most spheres one block is divided among.
pub const PALETTE: usize = 4;
/// Most candidates tried for one block.
pub const CANDIDATES: usize = 10;

/// Bits a pixel costs that no sphere of its block explains.
const MISS_BITS: u32 = 9;
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
}

impl Candidates {
    /// Adds a sphere unless it is there already, is none, or the list is full.
    #[inline]
    pub fn add(&mut self, id: u16) {
        if id < NO_SPHERE && self.len < CANDIDATES && !self.ids[..self.len].contains(&id) {
            self.ids[self.len] = id;
            self.len += 1;
        }
    }

    /// The list.
    #[must_use]
    pub fn ids(&self) -> &[u16] {
        &self.ids[..self.len]
    }
}

/// What became of one block.
#[derive(Clone, Copy, Debug)]
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

/// The measured pixels that touch sphere `id`; within reach along the ray is touching, too.
#[inline(always)] // a closure would lose the caller's vector instructions
fn touch_of(
    plane: &[u16],
    rays: &Rays,
    at: (usize, usize),
    valid: u64,
    id: u16,
    spheres: &[Option<Sphere>],
    contact: &Contact,
) -> Touch {
    let Some(Some(sphere)) = spheres.get(usize::from(id)) else {
        return Touch::default();
    };
    let t = contact.pixels(plane, rays, at, sphere);
    Touch {
        touching: (t.touching | t.along_ray) & valid,
        along_ray: t.along_ray & valid,
    }
}

/// Divides the measured pixels (`valid`) of the block at `at` among spheres: all to `first` where
/// that one explains nearly all, else among the candidates that `gather` adds: those known of the
/// block itself, then, where `true` is passed, those of the blocks around.
#[inline(always)]
#[allow(clippy::too_many_arguments)] // one block's whole view
pub fn assign(
    plane: &[u16],
    rays: &Rays,
    at: (usize, usize),
    valid: u64,
    first: u16,
    gather: impl Fn(&mut Candidates, bool),
    spheres: &[Option<Sphere>],
    contact: &Contact,
) -> BlockContacts {
    let mut out = BlockContacts {
        missing: valid,
        rough: valid,
        ..Default::default()
    };
    if valid == 0 {
        return out;
    }
    let measured = valid.count_ones();
    // one that explains (nearly) all is taken: the rest is not even tried
    let settles = |t: Touch| (valid & !t.along_ray).count_ones() <= SETTLED && measured > 8;
    let alone = |id: u16, t: Touch| {
        let mut out = BlockContacts {
            missing: valid & !t.touching,
            rough: valid & !t.along_ray,
            ..Default::default()
        };
        out.palette[0] = id;
        out.pixels[0] = t.touching;
        out
    };
    let own = touch_of(plane, rays, at, valid, first, spheres, contact);
    if settles(own) {
        return alone(first, own);
    }
    let mut candidates = Candidates::default();
    let mut touch = [Touch::default(); CANDIDATES];
    let (mut beyond, mut apart) = (valid, valid);
    for around in [false, true] {
        let known = candidates.len;
        gather(&mut candidates, around);
        for k in known..candidates.len {
            let id = candidates.ids[k];
            touch[k] = if id == first {
                own
            } else {
                touch_of(plane, rays, at, valid, id, spheres, contact)
            };
            if settles(touch[k]) {
                return alone(id, touch[k]);
            }
            beyond &= !touch[k].along_ray;
            apart &= !touch[k].touching;
        }
        // the spheres that were here before still divide it among them
        if beyond.count_ones() <= ENOUGH || (apart == 0 && beyond.count_ones() <= 2 * ENOUGH) {
            break;
        }
    }
    // greedy cover: first along the ray, then what merely touches
    let touch = &mut touch[..candidates.len];
    let mut chosen = [0usize; PALETTE];
    let mut n = 0;
    let mut covered = 0u64;
    let mut rough = valid;
    for along_ray in [true, false] {
        while n < PALETTE {
            let mut best = (0u32, 0usize);
            for (k, t) in touch.iter().enumerate() {
                let pixels = if along_ray { t.along_ray } else { t.touching };
                let gain = (pixels & !covered).count_ones() * MISS_BITS;
                if gain > best.0 {
                    best = (gain, k);
                }
            }
            if best.0 <= SPLIT_BITS[n] {
                break;
            }
            chosen[n] = best.1;
            covered |= if along_ray {
                touch[best.1].along_ray
            } else {
                touch[best.1].touching
            };
            n += 1;
        }
        if along_ray {
            rough &= !covered;
            for &k in &chosen[..n] {
                covered |= touch[k].touching;
            }
        }
    }
    out.missing = valid & !covered;
    out.rough = rough;
    // a pixel that one of them reaches along the ray does not go to one that merely touches it
    for &k in &chosen[..n] {
        touch[k].touching &= touch[k].along_ray | rough;
    }
    let touch = |k: usize| touch[k].touching;
    let mut left = covered;
    let mut current = 0usize;
    // scan in the order of coding, stay with the current sphere while it touches
    while left != 0 {
        let first = left.trailing_zeros();
        let stays = chosen[..n].iter().enumerate().max_by_key(|&(c, &k)| {
            let run = (!(touch(k) >> first) | !(left >> first))
                .trailing_zeros()
                .min(8 - first % 8);
            // the run to the end of the row, then whoever was on, then whoever has more
            (run, u32::from(c == current), touch(k).count_ones())
        });
        let Some((c, &k)) = stays else { break };
        current = c;
        let run = (!(touch(k) >> first) | !(left >> first))
            .trailing_zeros()
            .clamp(1, 8 - first % 8);
        let taken = (((1u128 << run) - 1) as u64) << first;
        out.pixels[c] |= taken & left;
        left &= !taken;
    }
    for c in 0..n {
        out.palette[c] = candidates.ids()[chosen[c]];
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

/// Offers the untouched pixels of the block at `at` to `candidates` (spheres around it that it was
/// not divided among), as entries of its palette still free. True where one was taken.
pub fn adopt(
    contacts: &mut BlockContacts,
    candidates: &Candidates,
    pixels: impl Fn(u16) -> u64,
) -> bool {
    let mut adopted = false;
    while let Some(free) = contacts.palette.iter().position(|&id| id == NO_SPHERE) {
        let gain = |&id: &u16| (pixels(id) & contacts.missing).count_ones();
        // the first of those with most pixels
        let best = candidates.ids().iter().rev().max_by_key(|&id| gain(id));
        let Some(&id) = best.filter(|&id| gain(id) * MISS_BITS > SPLIT_BITS[free]) else {
            break;
        };
        contacts.palette[free] = id;
        contacts.pixels[free] = pixels(id) & contacts.missing;
        contacts.missing &= !contacts.pixels[free];
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
            let mut out = assign(&plane, &rays, (0, 0), valid, 0, gather, &spheres, &contact);
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
