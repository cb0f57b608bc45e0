//! Section *residual*: measurements that their sphere does not give back.
//!
//! A block is *smooth* (every pixel's depth is its sphere's), *sparse* (each pixel says whether it
//! is) or *dense* (no pixel's is). The other pixels come back as [`super::bins`]: which one is
//! coded against the bins of six decoded neighbours and of the sphere itself, three contexts mixed.
//! With a bin for each integer that is lossless.
//!
//! Why not a multiple of a step off the sphere: noise and steps of the sensor belong to the
//! measurements, neighbours share them and the sphere knows nothing of them. On Kinect and
//! RealSense frames at a bound of 5 mm bins take a third to a half fewer bits, without loss a
//! fifth less than JPEG XL (effort 7) of the same integers.

use super::bins::{self, Bins};
use super::cells::{Cell, Cells, Neighbours};
use super::mask::extent;
use super::mixer::{CONTEXTS, Mixer, Place};
use super::range_coder::{Bit, Coder, Integer};
use super::state::Picture;
use super::surface::{self, is_real, to_integer};
use crate::contact_map::labels::NO_SPHERE;
use crate::deproject::{BLOCK, Rays};

/// How the pixels of a block come back.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Kind {
    /// From their spheres.
    #[default]
    Smooth,
    /// Some from their spheres, others from bins.
    Sparse,
    /// From bins.
    Dense,
}

/// Classes of how far off neighbours were.
const ACTIVITIES: usize = 11;
/// Steps of the magnitude, and largest value of each.
const STEPS: [u32; 14] = [1, 2, 3, 5, 7, 11, 15, 23, 31, 47, 63, 95, 127, 191];
/// Estimates of one context: zero, sign, and beyond each step.
const NODES: usize = 2 + STEPS.len();
const CELLS: [usize; CONTEXTS] = [9 * 9 * 9 * 5, 9 * 9 * 9 * 5, 2 * 7 * 9 * 9 * ACTIVITIES];

/// Learnt models of the section.
#[derive(Clone, Debug)]
pub struct Models {
    listed: Bit,
    list: bins::Models,
    active: [Bit; 9],
    dense: [Bit; 27],
    miss: [Bit; 81],
    misses: Integer,
    steps: Mixer,
    fine: [Bit; STEPS.len()],
    far: Integer,
}

impl Models {
    /// Back to the start: a key frame begins.
    pub fn reset(&mut self) {
        let Self {
            listed,
            list,
            active,
            dense,
            miss,
            misses,
            steps,
            fine,
            far,
        } = self;
        *listed = Bit::default();
        *list = bins::Models::default();
        active.fill(Bit::default());
        dense.fill(Bit::default());
        miss.fill(Bit::default());
        *misses = Integer::default();
        fine.fill(Bit::default());
        *far = Integer::default();
        steps.reset();
    }
}

impl Default for Models {
    fn default() -> Self {
        Self {
            listed: Bit::default(),
            list: bins::Models::default(),
            active: Default::default(),
            dense: [Bit::default(); 27],
            miss: [Bit::default(); 81],
            misses: Integer::default(),
            steps: Mixer::new(CELLS.map(|n| n * NODES), ACTIVITIES * 3 * NODES),
            fine: Default::default(),
            far: Integer::default(),
        }
    }
}

/// Codes the list of integers and makes the bins. `wanted`: the measurements (not used to decode).
///
/// # Errors
/// [`bins::NoSuchInteger`] where the bytes name one.
#[allow(clippy::too_many_arguments)] // one section's whole state
pub fn code_bins<C: Coder>(
    coder: &mut C,
    models: &mut Models,
    bins: &mut Bins,
    key: bool,
    wanted: Option<(&[u16], &crate::contact_map::contact::Reach, bool)>,
) -> Result<(), bins::NoSuchInteger> {
    if key {
        let worth = wanted
            .is_some_and(|(plane, reach, lossless)| bins.worth_listing(plane, reach, lossless));
        let listed = coder.bit(&mut models.listed, worth);
        bins.begin(listed);
    }
    if bins.is_listed() {
        bins.code_list(coder, &mut models.list, wanted.map_or(&[], |w| w.0))?;
    }
    Ok(())
}

/// Codes the kinds of the blocks. A block with `NO_SPHERE` in its palette is never smooth.
pub(super) fn code_kinds<C: Coder>(
    coder: &mut C,
    models: &mut Models,
    rays: &Rays,
    now: &mut Picture,
    before: Option<&[Kind]>,
) {
    let columns = rays.block_columns;
    for k in 0..rays.blocks() {
        let size = usize::from(now.map.sizes[k]);
        if size == 0 {
            now.kinds[k] = Kind::Smooth;
            continue;
        }
        let west = if k % columns > 0 {
            now.kinds[k - 1]
        } else {
            Kind::Smooth
        };
        let north = if k >= columns {
            now.kinds[k - columns]
        } else {
            Kind::Smooth
        };
        let kind = now.kinds[k];
        let active = now.map.palettes[k][..size].contains(&NO_SPHERE) || {
            let past = before.map_or(2, |b| usize::from(b[k] != Kind::Smooth));
            let around = usize::from(west != Kind::Smooth) + usize::from(north != Kind::Smooth);
            coder.bit(&mut models.active[around * 3 + past], kind != Kind::Smooth)
        };
        now.kinds[k] = if !active {
            Kind::Smooth
        } else {
            let past = before.map_or(0, |b| b[k] as usize);
            let context = (west as usize * 3 + north as usize) * 3 + past;
            if coder.bit(&mut models.dense[context], kind == Kind::Dense) {
                Kind::Dense
            } else {
                Kind::Sparse
            }
        };
    }
}

/// What the pixels of a frame that come back from bins look at.
pub(super) struct Scene<'a> {
    pub rays: &'a Rays,
    pub bins: &'a Bins,
    pub now: &'a Picture,
    /// The pixels of each block that their sphere gives back (not used to decode).
    pub hits: &'a [u64],
}

impl Scene<'_> {
    /// Codes the bin of a pixel of a block (bit `8·row + column`), given what its neighbours tell, the
    /// `depth` that its sphere predicts, if it has one, and the integer rebuilt `last`; `integer` is the
    /// pixel's (not used to decode). Returns what it tells in turn.
    #[allow(clippy::too_many_arguments)] // one pixel's whole surroundings
    #[inline(always)]
    fn code_bin<const FAST: bool, C: Coder>(
        &self,
        coder: &mut C,
        models: &mut Models,
        (block, bit): (usize, usize),
        near: &Neighbours,
        depth: Option<f32>,
        last: u16,
        integer: u16,
    ) -> Cell {
        let table = self.bins.of(block, bit);
        let guess = depth.filter(|&d| is_real(d));
        let around = Around::gather(table, near, last, guess);
        let dense = self.now.kinds[block] == Kind::Dense;
        let bin = around.code::<FAST, C>(coder, models, dense, table.of(integer));
        let bin = table.clamp(bin);
        around.cell(bin, table.center(bin))
    }
}

/// Walks the measured pixels of sparse and dense blocks in raster order and rebuilds those that come
/// back from bins: their `cells` say so. `wanted` tells the integer of a pixel (not used to decode).
#[allow(unsafe_code)] // run-time dispatch generated by the macro
#[multiversion::multiversion(targets("x86_64+avx2+bmi1+bmi2+lzcnt+popcnt"))]
pub(super) fn code_pixels<C: Coder, W: Fn(usize, usize) -> u16>(
    coder: &mut C,
    models: &mut Models,
    scene: &Scene<'_>,
    cells: &mut Cells,
    wanted: W,
) {
    let (rays, now) = (scene.rays, scene.now);
    let columns = rays.block_columns;
    let mut last = 0u16;
    for y in 0..rays.height {
        let j = y % BLOCK;
        for bx in 0..columns {
            let block = y / BLOCK * columns + bx;
            let kind = now.kinds[block];
            let mut on = now.mask.pixels.row(bx, y);
            if kind == Kind::Smooth || on == 0 {
                continue;
            }
            let mut window = cells.around(rays, block, j..j + 1);
            let depths = now.depth_row(rays, block, j);
            while on != 0 {
                let i = on.trailing_zeros() as usize;
                on &= on - 1;
                let bit = j * BLOCK + i;
                let near = window.neighbours(i, j);
                let sphere = now.map.label(block, bit) != NO_SPHERE;
                if kind == Kind::Sparse && sphere {
                    let stands = scene.hits[block] >> bit & 1 != 0;
                    if !coder.bit(&mut models.miss[miss_context(&near)], !stands) {
                        continue;
                    }
                }
                let depth = Some(depths[i]).filter(|_| sphere);
                let integer = wanted(bx * BLOCK + i, y);
                let at = (block, bit);
                let cell =
                    scene.code_bin::<false, C>(coder, models, at, &near, depth, last, integer);
                window.set(i, j, cell);
                last = cell.integer;
            }
            cells.keep(block, j, &window);
        }
    }
}

/// The same of a fast frame, block by block: which pixels of a sparse block their spheres miss is told
/// by their number and places, bits have one context, and no pixel looks at a later block.
#[allow(unsafe_code)] // run-time dispatch generated by the macro
#[multiversion::multiversion(targets("x86_64+avx2+bmi1+bmi2+lzcnt+popcnt"))]
pub(super) fn code_pixels_fast<C: Coder, W: Fn(usize, usize) -> u16>(
    coder: &mut C,
    models: &mut Models,
    scene: &Scene<'_>,
    cells: &mut Cells,
    wanted: W,
) {
    let (rays, now) = (scene.rays, scene.now);
    let mut last = 0u16;
    let mut depths = surface::NOTHING;
    for block in 0..rays.blocks() {
        let kind = now.kinds[block];
        if kind == Kind::Smooth {
            continue;
        }
        let on = now.mask.block(rays, block);
        let known = on & now.map.with_sphere(block);
        let mut left = if kind == Kind::Sparse {
            let missed = known & !scene.hits[block];
            code_places(coder, &mut models.misses, known, missed) | on & !known
        } else {
            on
        };
        if left == 0 {
            continue;
        }
        now.depths(rays, block, &mut depths);
        let mut window = cells.around(rays, block, 0..BLOCK);
        let (x0, y0, ..) = extent(rays, block);
        while left != 0 {
            let bit = left.trailing_zeros() as usize;
            left &= left - 1;
            let (i, j) = (bit % BLOCK, bit / BLOCK);
            let depth = Some(depths[bit]).filter(|_| known >> bit & 1 != 0);
            let integer = wanted(x0 + i, y0 + j);
            let (at, near) = ((block, bit), window.neighbours(i, j));
            let cell = scene.code_bin::<true, C>(coder, models, at, &near, depth, last, integer);
            window.set(i, j, cell);
            last = cell.integer;
        }
        for j in 0..BLOCK {
            cells.keep(block, j, &window);
        }
    }
}

/// Codes which of the pixels `among` are `wanted`: how many, and of each how many it skips.
#[inline(always)]
pub(super) fn code_places<C: Coder>(
    coder: &mut C,
    count: &mut Integer,
    among: u64,
    wanted: u64,
) -> u64 {
    let most = among.count_ones();
    let number = count.code(coder, wanted.count_ones()).min(most);
    let (mut left, mut wanted, mut places) = (among, wanted, 0);
    for still in (1..=number).rev() {
        let next = 1u64 << (wanted.trailing_zeros() & 63);
        wanted &= wanted.wrapping_sub(1);
        // those to come need a place each
        let room = left.count_ones() - still + 1;
        let skipped = (left & (next - 1)).count_ones().min(room - 1);
        for _ in 0..coder.uniform(room, skipped) {
            left &= left - 1;
        }
        places |= left & left.wrapping_neg();
        left &= left.wrapping_sub(1);
    }
    places
}

#[inline(always)]
fn miss_context(near: &Neighbours) -> usize {
    let state = |cell: Cell| match (cell.is_coded(), cell.off().unsigned_abs()) {
        (false, _) => 0,
        (true, 0..=1) => 1,
        _ => 2,
    };
    let above = state(near.north_east) * 3 + state(near.north_west);
    (state(near.west[0]) * 3 + state(near.north[0])) * 9 + above
}

/// Bins around a pixel.
struct Around {
    /// Where the bin is looked for.
    center: i32,
    /// The sphere's bin, if there is a sphere.
    sphere: Option<i32>,
    cells: [usize; CONTEXTS],
    activity: usize,
}

impl Around {
    #[inline(always)]
    fn gather(table: &bins::Table, near: &Neighbours, last: u16, guess: Option<f32>) -> Self {
        let ([west, far_west], [north, far_north]) = (near.west, near.north);
        let (north_west, north_east) = (near.north_west, near.north_east);
        // the nearest one that was measured stands for one that was not
        let or = |a: u16, b: u16| if a == 0 { b } else { a };
        let any = or(north.integer, last);
        let w = or(west.integer, any);
        let n = or(north.integer, w);
        let nw = table.of(or(north_west.integer, n));
        let ne = table.of(or(north_east.integer, n));
        let ww = table.of(or(far_west.integer, w));
        let nn = table.of(or(far_north.integer, n));
        let (w, n) = (table.of(w), table.of(n));
        let (low, high) = (w.min(n), w.max(n));
        // median edge detector, as in JPEG-LS
        let median = if nw >= high {
            low
        } else if nw <= low {
            high
        } else {
            w + n - nw
        };
        let (sphere, part, shifted, center) = match guess {
            None => (None, 0, median, median),
            Some(d) => {
                let bin = table.of(to_integer(d));
                let near = 3 * (west.off() + north.off());
                // the sphere, moved as its neighbours were
                let shifted = bin + ((near + north_east.off() + north_west.off() + 4) >> 3);
                let center = (median + shifted + i32::from(median > shifted)) >> 1;
                (Some(bin), table.part(bin, d), shifted, center)
            }
        };
        let error = |cell: Cell| usize::from(cell.error);
        let beside = error(north_west) + error(north_east);
        let activity = match 2 * (error(west) + error(north)) + beside {
            n @ 0..=2 => n,
            3..=4 => 3,
            5..=7 => 4,
            8..=12 => 5,
            13..=20 => 6,
            21..=36 => 7,
            37..=64 => 8,
            65..=120 => 9,
            _ => 10,
        };
        let cells = [
            ((nine(n - center) * 9 + nine(nn - n)) * 9 + nine(ne - n)) * 5 + five(w - center),
            ((nine(w - center) * 9 + nine(ww - w)) * 9 + nine(nw - n)) * 5 + five(n - center),
            (((part + 3) as usize * 9 + nine(sphere.unwrap_or(center) - center)) * 9
                + nine(shifted - center))
                * ACTIVITIES
                + activity,
        ];
        Self {
            center,
            sphere,
            cells,
            activity,
        }
    }

    #[inline(always)]
    fn code<const FAST: bool, C: Coder>(
        &self,
        coder: &mut C,
        models: &mut Models,
        dense: bool,
        bin: i32,
    ) -> i32 {
        let difference = bin - self.center;
        let Models {
            steps, fine, far, ..
        } = models;
        let set = match (self.sphere, dense) {
            (None, _) => 0,
            (_, false) => 1,
            _ => 2,
        };
        let [column, row, sphere] = self.cells;
        let sphere = sphere + usize::from(dense) * (CELLS[2] / 2);
        let mut bit = |coder: &mut C, node: usize, value: bool| {
            let at = Place {
                contexts: [column, row, sphere].map(|cell| cell * NODES + node),
                weights: (self.activity * 3 + set) * NODES + node,
            };
            steps.code::<FAST, C>(coder, &at, value)
        };
        if bit(coder, 0, difference == 0) {
            return self.center;
        }
        let negative = bit(coder, 1, difference < 0);
        let magnitude = difference.unsigned_abs();
        let mut step = 0;
        while step < STEPS.len() && bit(coder, 2 + step, magnitude > STEPS[step]) {
            step += 1;
        }
        let size = match STEPS.get(step) {
            None => {
                let far = far.code(coder, magnitude.saturating_sub(STEPS[step - 1] + 1));
                STEPS[step - 1] + 1 + far.min(1 << 17)
            }
            Some(&end) => {
                let first = if step == 0 { 1 } else { STEPS[step - 1] + 1 };
                let width = (end - first + 1).ilog2();
                let within = magnitude.wrapping_sub(first);
                if width == 0 {
                    first
                } else {
                    let top = coder.bit(&mut fine[step], within >> (width - 1) & 1 != 0);
                    let rest = coder.plain(width - 1, within & ((1 << (width - 1)) - 1));
                    first + (u32::from(top) << (width - 1) | rest)
                }
            }
        };
        if negative {
            self.center - size as i32
        } else {
            self.center + size as i32
        }
    }

    #[inline(always)]
    fn cell(&self, bin: i32, integer: u16) -> Cell {
        let error = bin.abs_diff(self.center).min(255) as u8;
        Cell::of_bin(integer, error, self.sphere.map_or(0, |s| bin - s))
    }
}

/// A difference in nine classes: 0, ±1, ±2, ±3 to 5, more.
#[inline(always)]
fn nine(difference: i32) -> usize {
    match difference {
        0 => 4,
        1 => 5,
        -1 => 3,
        2 => 6,
        -2 => 2,
        3..=5 => 7,
        -5..=-3 => 1,
        6.. => 8,
        _ => 0,
    }
}

/// A difference in five classes: 0, ±1, more.
#[inline(always)]
fn five(difference: i32) -> usize {
    (difference.clamp(-2, 2) + 2) as usize
}
