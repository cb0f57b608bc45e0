//! Sections on their own: what goes into a coder comes out again, and choices against brute force.

use super::choice::{Errors, MISS_COST};
use super::flow::{self, Past, Shift};
use super::label_map::LabelMap;
use super::labels::{self, AsRead, Choice};
use super::mask::{self, Fill, Mask, QUADS, quad_pixels};
use super::palette_choice;
use super::range_coder::{self, Coder, Decoder, Encoder};
use super::sphere_table::Entry;
use super::surface::{self, Depths, Surfaces};
use super::tiles::Tiles;
use crate::contact_map::assign::{BlockContacts, EMPTY, PALETTE};
use crate::contact_map::contact::Reach;
use crate::contact_map::labels::{Contacts, INVALID, NO_SPHERE, SaintFrame};
use crate::deproject::{BLOCK, Rays, Validity};
use crate::fit::contact_distance::ContactDistance;
use crate::fit::motion::Motion;
use crate::fit::sphere::Sphere;
use crate::frame::{Camera, DepthFrame, Intrinsics};
use glam::{DMat3, DVec3, Vec3};
use proptest::prelude::*;

pub(super) const UNIT_M: f64 = 0.001;

pub(super) fn camera(width: u32, height: u32) -> Camera {
    Camera {
        width,
        height,
        intrinsics: Intrinsics {
            fx: 0.9 * f64::from(width.max(height)),
            fy: 0.8 * f64::from(width.max(height)),
            cx: 0.45 * f64::from(width),
            cy: 0.55 * f64::from(height),
        },
        depth_unit_m: UNIT_M,
        invalid: vec![0],
        depth_min_m: 0.0,
        depth_max_m: 66.0,
        fps: None,
        name: String::new(),
    }
}

/// Numbers that look random and are the same each time (splitmix64).
pub(super) struct Chance(pub u64);

impl Chance {
    pub fn below(&mut self, n: u64) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ z >> 30).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ z >> 27).wrapping_mul(0x94D0_49BB_1331_11EB);
        (z ^ z >> 31) % n
    }

    pub fn float(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.below(1 << 30) as f64 / f64::from(1 << 30)
    }

    /// A mask of a block: mostly whole quads, as real ones are.
    pub fn block(&mut self) -> u64 {
        let each = (0..QUADS).map(|q| {
            quad_pixels(q)
                & match self.below(4) {
                    0 => 0,
                    1 => self.below(1 << 32) | self.below(1 << 32) << 32,
                    _ => u64::MAX,
                }
        });
        each.fold(0, |all, quad| all | quad)
    }

    /// A shift of each block that leaves it inside the padded image.
    fn shifts(&mut self, rays: &Rays) -> Vec<Shift> {
        let mut shift = |at: usize, size: usize| {
            let place = self.below((size * BLOCK - BLOCK) as u64 + 1) as i32;
            place - (at * BLOCK) as i32
        };
        let (columns, rows) = (rays.block_columns, rays.block_rows);
        (0..rays.blocks())
            .map(|k| Shift {
                y: shift(k / columns, rows),
                x: shift(k % columns, columns),
            })
            .collect()
    }

    /// A surface before the camera, or one that no ray meets.
    pub fn sphere(&mut self) -> Sphere {
        Sphere {
            a: self.float(-0.6, 0.6) as f32,
            m: Vec3::new(
                self.float(-0.4, 0.4) as f32,
                self.float(-0.4, 0.4) as f32,
                self.float(0.3, 1.2) as f32,
            ),
            far: self.below(9) == 0,
        }
    }
}

pub(super) fn sizes() -> impl Strategy<Value = (u32, u32)> {
    (2u32..42, 2u32..42)
}

fn code_mask<C: Coder>(
    coder: &mut C,
    (fills, models): &mut (mask::FillModels, mask::Models),
    rays: &Rays,
    before: Option<(&Mask, &[Shift])>,
    wanted: &[u64],
    fast: bool,
) -> Mask {
    let mut mask = Mask::default();
    mask.reset(rays);
    let past = before.map(|(mask, shifts)| Past {
        picture: &mask.pixels,
        shifts,
    });
    mask::code_fills(coder, fills, rays, &mut mask, before.map(|b| b.0), wanted);
    mask::code_quads(coder, models, rays, &mut mask, past, wanted);
    let code = if fast {
        mask::code_pixels::<true, C>
    } else {
        mask::code_pixels::<false, C>
    };
    let how = mask::Precision::Exact;
    code(coder, models, rays, &mut mask, past, wanted, how);
    mask
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    /// Any mask of any size comes back: a key frame, then two that look into the one before.
    #[test]
    fn masks_come_back((width, height) in sizes(), fast in any::<bool>(), seed in any::<u64>()) {
        let rays = Rays::new(&camera(width, height));
        let mut chance = Chance(seed);
        let (mut written, mut read) = Default::default();
        let mut before: Option<Mask> = None;
        for _ in 0..3 {
            let wanted: Vec<_> = (0..rays.blocks())
                .map(|k| chance.block() & mask::inside(&rays, k))
                .collect();
            let shifts = chance.shifts(&rays);
            let past = before.as_ref().map(|b| (b, shifts.as_slice()));
            let mut bytes = Vec::new();
            let mut coder = Encoder::new(&mut bytes);
            let there = code_mask(&mut coder, &mut written, &rays, past, &wanted, fast);
            coder.finish();
            let mut coder = Decoder::new(&bytes);
            let here = code_mask(&mut coder, &mut read, &rays, past, &[], fast);
            prop_assert!(!coder.overran());
            prop_assert_eq!(&here.pixels, &there.pixels);
            prop_assert_eq!((&here.fills, &here.quads), (&there.fills, &there.quads));
            for (k, &wanted) in wanted.iter().enumerate() {
                prop_assert_eq!(here.block(&rays, k), wanted);
                // those beyond the image too: they are 0
                let at = (k % rays.block_columns, k / rays.block_columns);
                prop_assert_eq!(here.pixels.block(at.0, at.1), wanted);
            }
            before = Some(here);
        }
    }

    /// Any labels out of any palettes come back, with the depths of their spheres.
    #[test]
    fn labels_come_back((width, height) in sizes(), fast in any::<bool>(), seed in any::<u64>()) {
        let rays = Rays::new(&camera(width, height));
        let mut chance = Chance(seed);
        let reach = Reach::new(&ContactDistance::default(), UNIT_M);
        let (mut written, mut read) = Default::default();
        let mut before: Option<LabelMap> = None;
        for _ in 0..3 {
            let entries: Vec<_> = (0..9)
                .map(|_| (chance.below(5) > 0).then(|| Entry { sphere: chance.sphere(), step: -8 }))
                .collect();
            let wanted: Vec<_> = (0..rays.blocks())
                .map(|k| chance.block() & mask::inside(&rays, k))
                .collect();
            let mut models = Default::default();
            let mask = code_mask(&mut Encoder::new(&mut Vec::new()), &mut models, &rays, None, &wanted, false);
            let mut there = LabelMap::default();
            there.reset(&rays);
            for (k, fill) in mask.fills.iter().enumerate() {
                if *fill != Fill::Empty {
                    let size = 1 + chance.below(PALETTE as u64) as usize;
                    let first = chance.below(7);
                    for e in 0..size {
                        // unlike each other, now and then no sphere
                        let label = (first + 3 * e as u64) % 10;
                        there.palettes[k][e] = if label == 9 { NO_SPHERE } else { label as u16 };
                    }
                    there.sizes[k] = size as u8;
                }
            }
            let mut here = there.clone();
            let shifts = chance.shifts(&rays);
            let past = before.as_ref().map(|b| Past { picture: b, shifts: &shifts });
            let (mut drawn, mut rebuilt) = (Tiles::default(), Tiles::default());
            drawn.reset(&rays);
            rebuilt.reset(&rays);
            let mut script = Script::new(&mut chance, &there);
            let mut bytes = Vec::new();
            let mut coder = Encoder::new(&mut bytes);
            let scene = labels::Scene {
                rays: &rays,
                reach: &reach,
                mask: (!fast).then_some(&mask),
                before: past,
                surfaces: Surfaces(&entries),
            };
            let mut hits = vec![u64::MAX; rays.blocks()];
            let outcome = labels::Outcome { depths: &mut drawn, touching: &mut hits };
            labels::code(&mut coder, &mut written, &scene, &mut there, &mut script, outcome);
            coder.finish();
            let mut coder = Decoder::new(&bytes);
            let mut none = vec![0; rays.blocks()];
            let outcome = labels::Outcome { depths: &mut rebuilt, touching: &mut none };
            labels::code(&mut coder, &mut read, &scene, &mut here, &mut AsRead, outcome);
            prop_assert!(!coder.overran());
            prop_assert_eq!(&here.tiles, &there.tiles);
            for (k, entries) in script.wanted.iter().enumerate() {
                let mut depths = [surface::NOTHING; PALETTE];
                for (depths, &id) in depths.iter_mut().zip(&here.palettes[k]) {
                    scene.surfaces.depths(&rays, k, id, depths);
                }
                for (bit, &e) in entries.iter().enumerate().filter(|(b, _)| wanted[k] >> b & 1 != 0) {
                    prop_assert_eq!(here.label(k, bit), here.palettes[k][usize::from(e)]);
                    let depth = depths[usize::from(e)][bit];
                    for tiles in [&rebuilt, &drawn] {
                        let tile = tiles.get(k);
                        prop_assert_eq!(tile.is_some(), here.sizes[k] > 1);
                        prop_assert!(tile.is_none_or(|tile| tile[bit].to_bits() == depth.to_bits()));
                    }
                }
                let given = hits[k] & wanted[k];
                prop_assert_eq!(given, if there.sizes[k] == 0 { 0 } else { wanted[k] });
            }
            before = Some(here);
        }
    }

    /// A map by blocks gives the palettes of its label image.
    #[test]
    fn palettes_of_blocks_are_those_of_their_pixels((width, height) in sizes(), seed in any::<u64>()) {
        let camera = camera(width, height);
        let rays = Rays::new(&camera);
        let mut chance = Chance(seed);
        let spheres: Vec<_> = (0..6).map(|n| (n != 4).then(|| chance.sphere())).collect();
        let mut block = |k: usize| {
            let mut left = mask::inside(&rays, k) & (chance.block() | chance.block());
            let mut block = BlockContacts::default();
            for (e, pixels) in block.pixels.iter_mut().enumerate().take(chance.below(5) as usize) {
                // four different ones, of which slot 4 is empty and 6 is none at all
                block.palette[e] = (e as u16 * 2 + (k as u16 % 2)) % 7;
                *pixels = left & [chance.block(), u64::MAX][chance.below(2) as usize];
                left &= !*pixels;
            }
            block.missing = left;
            block
        };
        let blocks: Vec<_> = (0..rays.blocks()).map(&mut block).collect();
        let contacts = Contacts::Blocks(blocks.clone());
        let by_block = SaintFrame { spheres, contacts, ..SaintFrame::default() };
        let labels = Contacts::Labels(by_block.labels(rays.width, rays.height));
        let by_pixel = SaintFrame { contacts: labels, ..by_block.clone() };
        for (k, block) in blocks.iter().enumerate() {
            let all = block.pixels.iter().fold(block.missing, |all, p| all | p);
            for measured in [all, all & chance.block()] {
                let gathered = palette_choice::gather(&by_block, &rays, k, measured);
                prop_assert_eq!(gathered, palette_choice::gather(&by_pixel, &rays, k, measured));
            }
        }
    }

    /// A block keeps a sphere, and every sphere that alone explains five of its pixels.
    #[test]
    fn palettes_keep_what_is_needed((width, height) in sizes(), seed in any::<u64>()) {
        let camera = camera(width, height);
        let rays = Rays::new(&camera);
        let mut chance = Chance(seed);
        let spheres: Vec<_> = (0..6).map(|n| (n != 4).then(|| chance.sphere())).collect();
        // each pixel lies near one of the spheres
        let (mut depth, mut labels) = (Vec::new(), Vec::new());
        for i in 0..camera.pixels() {
            let (x, y) = (i % rays.width, i / rays.width);
            let n = (chance.below(6) * chance.below(2)) as usize;
            let q = rays.u[x] * rays.u[x] + rays.v[y] * rays.v[y] + 1.0;
            let w = spheres[n].map_or(0.0, |s: Sphere| s.inverse_depth(rays.u[x], rays.v[y], q));
            depth.push(((1000.0 / w) as u16).saturating_add(chance.below(4) as u16));
            labels.push([n as u16, NO_SPHERE, INVALID, 60_000][(chance.below(24) / 21) as usize * chance.below(4) as usize]);
        }
        let frame = DepthFrame { depth, ..DepthFrame::default() };
        let saint = SaintFrame { spheres, contacts: Contacts::Labels(labels), ..SaintFrame::default() };
        let mut plane = Vec::new();
        Validity::new(&camera).clean(&rays, &frame, &mut plane);
        let mut measured = Vec::new();
        mask::measure(&rays, &plane, &mut measured);
        let contact = ContactDistance::default();
        let (bound, contact) = (Reach::new(&contact.scaled(2.5), UNIT_M), Reach::new(&contact, UNIT_M));
        let errors = Errors { plane: &plane, reach: &bound, contact: &contact };
        for (k, &measured) in measured.iter().enumerate() {
            let (all, size) = palette_choice::gather(&saint, &rays, k, measured);
            let size = usize::from(size);
            prop_assert_eq!(size > 0, measured != 0);
            let mut palette = all;
            let left = match size {
                0 | 1 => size,
                _ => palette_choice::prune(&saint, &rays, &errors, (k, measured), |_| 48 * 16, &mut palette, size),
            };
            prop_assert!(left <= size && (left > 0 || size == 0), "{size} entries, {left} left");
            prop_assert_eq!(&palette[left..], &EMPTY[left..]);
            prop_assert!(palette[..left].iter().all(|id| all[..size].contains(id)));
            let mut prices = [[MISS_COST; BLOCK * BLOCK]; PALETTE];
            for (prices, &id) in prices.iter_mut().zip(&all[..size]) {
                if let Some(Some(sphere)) = saint.spheres.get(usize::from(id)) {
                    let mut depths: Depths = surface::NOTHING;
                    surface::depths_of(&rays, k, sphere, &mut depths);
                    errors.prices(&rays, k, &depths, prices);
                }
            }
            for e in 0..size {
                let alone = (0..BLOCK * BLOCK).filter(|&i| {
                    measured >> i & 1 != 0
                        && prices[e][i] <= 8
                        && (0..size).all(|o| o == e || prices[o][i] == MISS_COST)
                });
                let alone = alone.count();
                prop_assert!(alone < 5 || palette[..left].contains(&all[e]), "{alone} pixels lost their sphere");
            }
        }
    }

    /// Shifts against points carried along in double precision, by sine and cosine.
    #[test]
    fn shifts_follow_the_points((width, height) in (9u32..90, 9u32..90), seed in any::<u64>()) {
        let camera = camera(width, height);
        let rays = Rays::new(&camera);
        let mut chance = Chance(seed);
        let mut step = |most: f64| chance.float(-most, most) as i32;
        let motion = Motion {
            turn: [step(4000.0), step(4000.0), step(4000.0)],
            shift: [step(3000.0), step(3000.0), step(3000.0)],
        };
        let spheres: Vec<_> = (0..5).map(|_| Sphere { far: false, ..chance.sphere() }).collect();
        let entries: Vec<_> = spheres.iter().map(|&sphere| Some(Entry { sphere, step: 0 })).collect();
        let mut map = LabelMap::default();
        map.reset(&rays);
        for k in 0..rays.blocks() {
            map.palettes[k][0] = chance.below(5) as u16;
        }
        let mut found = Vec::new();
        flow::shifts(&rays, &map, |_| true, &entries, &motion, &mut found);
        let gibbs = DVec3::from_array(motion.turn.map(|n| f64::from(n) / 65_536.0));
        let turn = DMat3::from_axis_angle(gibbs.try_normalize().unwrap_or(DVec3::X), 2.0 * gibbs.length().atan());
        let shift = DVec3::from_array(motion.shift.map(|n| f64::from(n) / 16_384.0));
        let lens = &camera.intrinsics;
        for (k, &found) in found.iter().enumerate() {
            let (x, y) = (k % rays.block_columns * BLOCK, k / rays.block_columns * BLOCK);
            let (mx, my) = ((x + BLOCK / 2) as f64, (y + BLOCK / 2) as f64);
            let ray = DVec3::new((mx - lens.cx) / lens.fx, (my - lens.cy) / lens.fy, 1.0);
            let sphere = spheres[usize::from(map.palettes[k][0])];
            // a·z²·q + l·z = 1
            let (a, l) = (f64::from(sphere.a), sphere.m.as_dvec3().dot(ray));
            let root = (l * l + 4.0 * a * ray.length_squared()).sqrt();
            let p = turn.transpose() * (ray * (2.0 / (l + root)) - shift);
            let moved = [
                (lens.fx * p.x / p.z + lens.cx - mx, x, rays.block_columns),
                (lens.fy * p.y / p.z + lens.cy - my, y, rays.block_rows),
            ];
            // grazing rays and points at the camera are a matter of rounding
            if root < 0.05 || root.is_nan() || p.z.abs() < 0.05 || (l + root).abs() < 0.05 {
                continue;
            }
            let found = [found.x, found.y];
            for ((exact, start, blocks), found) in moved.into_iter().zip(found) {
                let (low, high) = (-(start as f64), ((blocks - 1) * BLOCK - start) as f64);
                let near = [-0.02, 0.02].map(|by| (exact + by + 0.5).floor().clamp(low, high));
                prop_assert!(
                    near.contains(&f64::from(found)) || exact.abs() > 1e4,
                    "block {k}: {found} pixels, exactly {exact}"
                );
            }
        }
    }
}

/// Labels drawn by lot: what an encoder may choose.
struct Script {
    /// Palette entry of each pixel of each block.
    wanted: Vec<[u8; BLOCK * BLOCK]>,
    block: usize,
    divide: bool,
}

impl Script {
    fn new(chance: &mut Chance, map: &LabelMap) -> Self {
        let draw = |&size: &u8| {
            let mut entries = [0; BLOCK * BLOCK];
            for q in 0..QUADS {
                let (one, entry) = (chance.below(2) == 0, chance.below(u64::from(size.max(1))));
                for (bit, e) in entries.iter_mut().enumerate() {
                    if quad_pixels(q) >> bit & 1 != 0 {
                        *e = entry as u8;
                        if !one {
                            *e = chance.below(u64::from(size.max(1))) as u8;
                        }
                    }
                }
            }
            entries
        };
        Self {
            wanted: map.sizes.iter().map(draw).collect(),
            block: 0,
            divide: false,
        }
    }

    /// Those of these pixels that get the entry they should.
    fn as_wanted(&self, k: usize, pixels: u64, entry: usize) -> u64 {
        let right = |bit: usize| u64::from(usize::from(self.wanted[k][bit]) == entry) << bit;
        pixels & (0..BLOCK * BLOCK).map(right).fold(0, |all, one| all | one)
    }
}

impl Choice for Script {
    fn block(&mut self, k: usize, _: &[u16], _: &[Depths; PALETTE]) {
        self.block = k;
    }

    fn quad(&mut self, pixels: u64, costs: &[u32], _: u32) -> Option<usize> {
        let entries = &self.wanted[self.block];
        let mut on = (0..BLOCK * BLOCK).filter(|bit| pixels >> bit & 1 != 0);
        let first = entries[on.next().unwrap()];
        assert!(usize::from(first) < costs.len());
        // every other quad of one label is divided all the same
        self.divide = !self.divide;
        (self.divide && on.all(|bit| entries[bit] == first)).then_some(usize::from(first))
    }

    fn pixel(&mut self, bit: u32, _: &[u32]) -> usize {
        usize::from(self.wanted[self.block][bit as usize])
    }

    fn given(&mut self, k: usize, pixels: u64, entry: usize) -> u64 {
        self.as_wanted(k, pixels, entry)
    }
}

/// The logarithm taken piece by piece is never below the true one, and 2.4/16 bit above at most:
/// 1.38/16 for the straight line between powers of two, less than one for the rounding.
#[test]
fn costs_are_logarithms() {
    for one in 1u32..65_536 {
        for value in [false, true] {
            let p = f64::from(if value { one } else { 65_536 - one }) / 65_536.0;
            let (cost, exact) = (f64::from(range_coder::cost(one, value)), -16.0 * p.log2());
            assert!(
                cost >= exact - 1e-9 && cost < exact + 2.4,
                "{one}, {value}: {cost}/16 bit, exactly {exact}"
            );
        }
    }
}

/// A camera that stands still looks straight back, and so does a block without a sphere.
#[test]
fn without_a_motion_or_a_sphere_nothing_shifts() {
    let rays = Rays::new(&camera(40, 24));
    let mut map = LabelMap::default();
    map.reset(&rays);
    map.palettes[3][0] = 7;
    map.palettes[4][0] = 0;
    let entries = [None, None];
    let moved = Motion {
        turn: [300, -4000, 5],
        shift: [1, 2, 3],
    };
    for motion in [Motion::default(), moved] {
        let mut out = Vec::new();
        flow::shifts(&rays, &map, |_| true, &entries, &motion, &mut out);
        assert_eq!(out, vec![Shift::default(); rays.blocks()]);
    }
}
