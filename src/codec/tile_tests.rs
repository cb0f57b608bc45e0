//! Pictures kept by blocks, read by windows: each against a plane read pixel by pixel.

use super::bitmap::Bitmap;
use super::cells::{Cell, Cells};
use super::choice::{Cheapest, Errors, MISS_COST};
use super::label_map::{LabelMap, Window};
use super::mask;
use super::range_coder::{Decoder, Encoder, Integer};
use super::residual::code_places;
use super::section_tests::{Chance, UNIT_M, camera, sizes};
use super::sphere_table::Entry;
use super::surface::{self, Surfaces};
use crate::contact_map::contact::Reach;
use crate::contact_map::labels::NO_SPHERE;
use crate::deproject::{BLOCK, Rays};
use crate::fit::contact_distance::ContactDistance;
use proptest::prelude::*;

/// Block and bit of a pixel inside the padded image.
fn place(rays: &Rays, x: i64, y: i64) -> Option<(usize, usize)> {
    let inside = |at: i64, blocks: usize| (0..(blocks * BLOCK) as i64).contains(&at);
    if !inside(x, rays.block_columns) || !inside(y, rays.block_rows) {
        return None;
    }
    let (x, y) = (x as usize, y as usize);
    let k = y / BLOCK * rays.block_columns + x / BLOCK;
    Some((k, y % BLOCK * BLOCK + x % BLOCK))
}

/// A map of single spheres, tiles and empty blocks.
fn map(chance: &mut Chance, rays: &Rays) -> LabelMap {
    let mut map = LabelMap::default();
    map.reset(rays);
    for k in 0..rays.blocks() {
        map.sizes[k] = chance.below(4) as u8;
        for e in 0..usize::from(map.sizes[k]) {
            map.palettes[k][e] = chance.below(9) as u16;
        }
        if map.sizes[k] > 1 {
            map.tiles
                .put(k, std::array::from_fn(|_| chance.below(20) as u16));
        }
    }
    map
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]

    #[test]
    fn bits_stand_where_they_were_set((width, height) in sizes(), seed in any::<u64>()) {
        let rays = Rays::new(&camera(width, height));
        let mut chance = Chance(seed);
        let mut bitmap = Bitmap::default();
        bitmap.cover(&rays);
        let blocks: Vec<u64> = (0..rays.blocks()).map(|_| chance.block()).collect();
        for (k, &bits) in blocks.iter().enumerate() {
            bitmap.set_block(k % rays.block_columns, k / rays.block_columns, bits);
        }
        let truth = |x: i64, y: i64| place(&rays, x, y).is_some_and(|(k, bit)| blocks[k] >> bit & 1 != 0);
        for y in 0..rays.block_rows * BLOCK {
            for x in 0..rays.block_columns * BLOCK {
                prop_assert_eq!(bitmap.get(x, y), truth(x as i64, y as i64));
                let (left, up) = (chance.below(5) as usize, chance.below(3) as usize);
                let window = bitmap.window((x, left), (y, up));
                for n in 0..16 {
                    let there = truth((x + n) as i64 - left as i64, y as i64 - up as i64);
                    prop_assert_eq!(window >> n & 1 != 0, there, "{} {} {}", x, y, n);
                }
            }
        }
    }

    #[test]
    fn windows_show_the_labels_that_are_there((width, height) in sizes(), seed in any::<u64>()) {
        let rays = Rays::new(&camera(width, height));
        let mut chance = Chance(seed);
        let map = map(&mut chance, &rays);
        let truth = |x: i64, y: i64| place(&rays, x, y).map_or(NO_SPHERE, |(k, bit)| map.label(k, bit));
        for k in 0..rays.blocks() {
            let (x0, y0) = (k % rays.block_columns * BLOCK, k / rays.block_columns * BLOCK);
            let around = map.around(&rays, k);
            for n in 0..=BLOCK + 1 {
                prop_assert_eq!(around.0[n], truth((x0 + n) as i64 - 1, y0 as i64 - 1));
            }
            for j in 0..BLOCK {
                prop_assert_eq!(around.0[Window::at(0, j) - 1], truth(x0 as i64 - 1, (y0 + j) as i64));
            }
            let x = chance.below((rays.stride() - BLOCK) as u64 + 1) as usize;
            let y = chance.below(((rays.block_rows - 1) * BLOCK) as u64 + 1) as usize;
            let past = map.past(&rays, (x, y));
            for j in 0..=BLOCK {
                for i in 0..=BLOCK {
                    let (found, there) = (past.0[Window::at(i, j)], truth((x + i) as i64, (y + j) as i64));
                    prop_assert_eq!(found, there, "{} {} {} {}", x, y, i, j);
                }
            }
            let with_sphere = (0..BLOCK * BLOCK).filter(|&bit| map.label(k, bit) != NO_SPHERE);
            prop_assert_eq!(map.with_sphere(k), with_sphere.fold(0, |all, bit| all | 1 << bit));
        }
    }

    #[test]
    fn windows_show_the_cells_that_were_decoded((width, height) in sizes(), seed in any::<u64>()) {
        let rays = Rays::new(&camera(width, height));
        let mut chance = Chance(seed);
        let mut cells = Cells::default();
        cells.reset(&rays);
        let mut plane = vec![[0u16; BLOCK * BLOCK]; rays.blocks()];
        for (k, integers) in plane.iter_mut().enumerate() {
            if chance.below(4) == 0 {
                continue;
            }
            let depths = std::array::from_fn(|_| chance.below(70_000) as f32);
            let on = chance.block();
            cells.write(k, on, &depths);
            for (bit, integer) in integers.iter_mut().enumerate().filter(|b| on >> b.0 & 1 != 0) {
                *integer = depths[bit].min(65_535.0) as u16;
            }
        }
        let truth = |x: i64, y: i64| place(&rays, x, y).map_or(0, |(k, bit)| plane[k][bit]);
        for k in 0..rays.blocks() {
            let (x0, y0) = ((k % rays.block_columns * BLOCK) as i64, (k / rays.block_columns * BLOCK) as i64);
            let row = chance.below(BLOCK as u64) as usize;
            for rows in [row..row + 1, 0..BLOCK] {
                let window = cells.around(&rays, k, rows.clone());
                for (j, i) in rows.clone().flat_map(|j| (0..BLOCK).map(move |i| (j, i))) {
                    let (x, y) = (x0 + i as i64, y0 + j as i64);
                    let near = window.neighbours(i, j);
                    // of the block to the right only the row above the first is decoded
                    let later = i + 1 == BLOCK && j > rows.start;
                    let found = [near.west[0], near.west[1], near.north[0], near.north[1], near.north_west, near.north_east];
                    let there = [
                        truth(x - 1, y), truth(x - 2, y), truth(x, y - 1), truth(x, y - 2), truth(x - 1, y - 1),
                        if later { 0 } else { truth(x + 1, y - 1) },
                    ];
                    prop_assert_eq!(found.map(|cell: Cell| cell.integer), there);
                }
            }
        }
    }

    /// Any pixels out of any come back, each as one of those that are left.
    #[test]
    fn places_come_back(blocks in prop::collection::vec((any::<u64>(), any::<u64>(), any::<u64>()), 1..20)) {
        let mut bytes = Vec::new();
        let (mut coder, mut count) = (Encoder::new(&mut bytes), Integer::default());
        for &(among, a, b) in &blocks {
            prop_assert_eq!(code_places(&mut coder, &mut count, among, among & a & b), among & a & b);
        }
        coder.finish();
        let (mut coder, mut count) = (Decoder::new(&bytes), Integer::default());
        for &(among, a, b) in &blocks {
            prop_assert_eq!(code_places(&mut coder, &mut count, among, 0), among & a & b);
        }
        prop_assert!(!coder.overran());
    }

    /// Any bytes name pixels that are there.
    #[test]
    fn no_bytes_name_other_places(bytes in prop::collection::vec(any::<u8>(), 0..60), among in any::<u64>()) {
        let (mut coder, mut count) = (Decoder::new(&bytes), Integer::default());
        for _ in 0..8 {
            prop_assert_eq!(code_places(&mut coder, &mut count, among, 0) & !among, 0);
        }
    }

    /// Blocks looked at together miss what each pixel's price says.
    #[test]
    fn runs_of_blocks_miss_what_single_pixels_miss((width, height) in sizes(), seed in any::<u64>()) {
        let rays = Rays::new(&camera(width, height));
        let mut chance = Chance(seed);
        let mut map = LabelMap::default();
        map.reset(&rays);
        let entries: Vec<_> = (0..3).map(|n| (n > 0).then(|| Entry { sphere: chance.sphere(), step: -8 })).collect();
        let surfaces = Surfaces(&entries);
        let mut plane = vec![0u16; rays.padded()];
        let mut depths = surface::NOTHING;
        for k in 0..rays.blocks() {
            map.sizes[k] = (chance.below(8) > 0).into();
            map.palettes[k][0] = if chance.below(12) == 0 { NO_SPHERE } else { chance.below(3) as u16 };
            surfaces.depths(&rays, k, map.palettes[k][0], &mut depths);
            let (x0, y0, ..) = mask::extent(&rays, k);
            for (bit, depth) in depths.iter().enumerate() {
                let off = chance.float(-60.0, 60.0) as f32;
                plane[(y0 + bit / BLOCK) * rays.stride() + x0 + bit % BLOCK] = (depth + off) as u16;
            }
        }
        let (reach, contact) = (Reach::new(&ContactDistance::default(), UNIT_M), Reach::new(&ContactDistance::default(), UNIT_M));
        let errors = Errors { plane: &plane, reach: &reach, contact: &contact };
        let measured: Vec<u64> = (0..rays.blocks()).map(|k| chance.block() & mask::inside(&rays, k)).collect();
        let choice = Cheapest::new(&rays, errors, (&measured, &[]));
        let mut touching = vec![u64::MAX; rays.blocks()];
        choice.touch_alone(&map, &surfaces, &mut touching);
        let mut prices = [0u16; BLOCK * BLOCK];
        for (k, &touching) in touching.iter().enumerate() {
            let id = map.palettes[k][0];
            surfaces.depths(&rays, k, id, &mut depths);
            errors.prices(&rays, k, &depths, &mut prices);
            let (x0, y0, ..) = mask::extent(&rays, k);
            for bit in 0..BLOCK * BLOCK {
                // a price tells nothing of a pixel that has no integer
                let raw = plane[(y0 + bit / BLOCK) * rays.stride() + x0 + bit % BLOCK];
                let hit = map.sizes[k] == 1 && id != NO_SPHERE && prices[bit] != MISS_COST && measured[k] >> bit & 1 != 0;
                prop_assert!(raw == 0 || hit == (touching >> bit & 1 != 0), "{} {}", k, bit);
            }
        }
    }
}
