//! Which sphere each pixel touches: the contact map inside blocks of more than one sphere.
//!
//! Coarse to fine, so that the map is only as fine as it must be (the paper's map resolution, by
//! place): a quad is given to one sphere, or its pixels are. What predicts a label: decoded
//! neighbours, the last frame, and the spheres themselves, which are known by now: where two of
//! them cross, the map changes from one to the other.

use super::flow::Past;
use super::mask::{self, Mask, QUAD, QUADS, extent, quad_pixels};
use super::mixer::{CONTEXTS, Mixer, Mixture, Place};
use super::range_coder::{self, Bit, Coder};
use super::surface::{self, Depths, Surfaces};
use crate::contact_map::assign::{EMPTY, PALETTE, Palette};
use crate::contact_map::contact::Reach;
use crate::contact_map::labels::NO_SPHERE;
use crate::deproject::{BLOCK, Rays};

/// Contexts of a pixel's label, each for any palette entry but the last.
const CELLS: [usize; CONTEXTS] = [243, 324, 243];
const NODES: usize = PALETTE - 1;

/// By entry and rank of a label: 0 where the label is the entry, 1 where it is a later one, else 2.
const CLASS: [[usize; PALETTE + 1]; NODES] = [[0, 1, 1, 1, 2], [2, 0, 1, 1, 2], [2, 2, 0, 1, 2]];

/// Learnt models of the labels of quads and pixels.
#[derive(Clone, Debug)]
pub struct Models {
    split: [Bit; 5 * 3 * 2 * 3 * NODES],
    whole: [Bit; 243 * NODES],
    pixel: Mixer,
}

impl Models {
    /// Back to the start: a key frame begins.
    pub fn reset(&mut self) {
        self.split.fill(Bit::default());
        self.whole.fill(Bit::default());
        self.pixel.reset();
    }
}

impl Default for Models {
    fn default() -> Self {
        Self {
            split: [Bit::default(); 5 * 3 * 2 * 3 * NODES],
            whole: [Bit::default(); 243 * NODES],
            pixel: Mixer::new(CELLS.map(|n| n * NODES), 9 * NODES),
        }
    }
}

/// A frame's contact map: palettes of blocks and labels of pixels, by sphere number.
#[derive(Clone, Debug, Default)]
pub struct LabelMap {
    /// One for each block; [`NO_SPHERE`] is a palette entry like any other in a block that has
    /// measurements but no sphere.
    pub palettes: Vec<Palette>,
    /// Entries in each palette; 0 for an empty block.
    pub sizes: Vec<u8>,
    /// Of the blocks of several spheres, in order: the labels of their pixels, row by row. Those
    /// without a measurement hold a label, too: that of their quad, or the one to their left. The
    /// pixels of other blocks are not written down: they all have the block's one.
    pub tiles: Vec<[u16; BLOCK * BLOCK]>,
    /// Place of each block's tile, for blocks of several spheres.
    tile: Vec<u32>,
}

impl LabelMap {
    /// A map over `rays` without any palette.
    pub fn reset(&mut self, rays: &Rays) {
        self.palettes.clear();
        self.palettes.resize(rays.blocks(), EMPTY);
        self.sizes.clear();
        self.sizes.resize(rays.blocks(), 0);
        self.tile.resize(rays.blocks(), 0);
        self.tiles.clear();
        // room for the worst frame: it does not grow while a stream runs
        self.tiles.reserve(rays.blocks());
    }

    /// Place of block `k` among the blocks of several spheres, if it is one.
    #[inline(always)]
    #[must_use]
    pub fn place(&self, k: usize) -> Option<usize> {
        (self.sizes[k] > 1).then(|| self.tile[k] as usize)
    }

    /// The labels of the pixels of block `k`, where they are not all its first palette entry.
    #[inline(always)]
    #[must_use]
    pub fn tile(&self, k: usize) -> Option<&[u16; BLOCK * BLOCK]> {
        self.tiles.get(self.place(k)?)
    }

    /// The label of a pixel (bit `8·row + column`) of block `k`.
    #[inline(always)]
    #[must_use]
    pub fn label(&self, k: usize, bit: usize) -> u16 {
        self.tile(k).map_or(self.palettes[k][0], |tile| tile[bit])
    }

    /// The pixels of block `k` that have a sphere.
    #[inline(always)]
    #[must_use]
    pub fn with_sphere(&self, k: usize) -> u64 {
        let Some(tile) = self.tile(k) else {
            return u64::from(self.palettes[k][0] != NO_SPHERE).wrapping_neg();
        };
        let mut cells = [0u8; BLOCK * BLOCK];
        for (cell, label) in cells.iter_mut().zip(tile) {
            *cell = u8::from(*label != NO_SPHERE);
        }
        surface::packed(&cells)
    }

    pub(super) fn write_tile(&mut self, k: usize, tile: [u16; BLOCK * BLOCK]) {
        self.tile[k] = self.tiles.len() as u32;
        self.tiles.push(tile);
    }

    /// The labels right above block `k` and to its left, as far as they are decoded; its own are yet
    /// to come.
    #[inline(always)]
    pub(super) fn around(&self, rays: &Rays, k: usize) -> Window {
        let columns = rays.block_columns;
        let (west, north) = (!k.is_multiple_of(columns), k >= columns);
        let east = !(k + 1).is_multiple_of(columns);
        let mut window = Window([NO_SPHERE; WINDOW]);
        let labels = &mut window.0;
        if north {
            let above = k - columns;
            let row = &mut labels[1..=BLOCK];
            match self.tile(above) {
                None => row.fill(self.palettes[above][0]),
                Some(tile) => row.copy_from_slice(&tile[BLOCK * (BLOCK - 1)..]),
            }
            if west {
                labels[0] = self.label(above - 1, BLOCK * BLOCK - 1);
            }
            if east {
                labels[BLOCK + 1] = self.label(above + 1, BLOCK * (BLOCK - 1));
            }
        }
        if west {
            for j in 0..BLOCK {
                labels[Window::at(0, j) - 1] = self.label(k - 1, BLOCK * j + BLOCK - 1);
            }
        }
        window
    }

    /// The labels from pixel (x, y) on, a row and a column more than a block's.
    #[inline(always)]
    pub(super) fn past(&self, rays: &Rays, (x, y): (usize, usize)) -> Window {
        let mut window = Window([NO_SPHERE; WINDOW]);
        let (columns, rows) = (rays.block_columns, rays.block_rows);
        let (right, low) = (x % BLOCK, y % BLOCK);
        for (by, from, to) in [(y / BLOCK, low, BLOCK), (y / BLOCK + 1, 0, low + 1)] {
            for (bx, left, end) in [(x / BLOCK, right, BLOCK), (x / BLOCK + 1, 0, right + 1)] {
                if bx >= columns || by >= rows {
                    continue;
                }
                let k = by * columns + bx;
                let (i, j) = (bx * BLOCK + left - x, by * BLOCK + from - y);
                let tile = self.tile(k);
                for n in 0..to - from {
                    let at = Window::at(i, j + n);
                    let row = &mut window.0[at..at + end - left];
                    match tile {
                        None => row.fill(self.palettes[k][0]),
                        Some(tile) => {
                            let start = (from + n) * BLOCK + left;
                            row.copy_from_slice(&tile[start..start + end - left]);
                        }
                    }
                }
            }
        }
        window
    }
}

/// Cells from one row of a window to the next, and of a window.
const STEP: usize = 16;
const WINDOW: usize = STEP * (BLOCK + 2);

/// Labels in and around a block.
pub(super) struct Window(pub [u16; WINDOW]);

impl Window {
    /// Cell of the pixel in column `i`, row `j` of the block.
    #[inline(always)]
    pub const fn at(i: usize, j: usize) -> usize {
        (j + 1) * STEP + i + 1
    }

    /// Palette entry of each label, `PALETTE` for one of another block.
    #[inline(always)]
    fn ranks(&self, palette: &[u16]) -> [u8; WINDOW] {
        let mut ranks = [PALETTE as u8; WINDOW];
        for (e, id) in palette.iter().enumerate().rev() {
            for (rank, label) in ranks.iter_mut().zip(&self.0) {
                *rank = if label == id { e as u8 } else { *rank };
            }
        }
        ranks
    }
}

/// The encoder's choice of labels. Costs are in 1/16 bit; the decoder is asked nothing.
pub trait Choice: Sync {
    /// A block of several spheres at these depths comes next.
    fn block(&mut self, k: usize, palette: &[u16], depths: &[Depths; PALETTE]);
    /// The palette entry for all `pixels` of a quad, or `None` to divide it. `costs`: of each entry;
    /// `division`: of dividing.
    fn quad(&mut self, pixels: u64, costs: &[u32], division: u32) -> Option<usize>;
    /// The palette entry of a pixel (bit `8·row + column`).
    fn pixel(&mut self, bit: u32, costs: &[u32]) -> usize;
    /// These pixels of the block got this palette entry: those of them that touch it.
    fn given(&mut self, k: usize, pixels: u64, entry: usize) -> u64;
}

/// No choice: what the bytes say.
pub struct AsRead;

impl Choice for AsRead {
    #[inline(always)]
    fn block(&mut self, _: usize, _: &[u16], _: &[Depths; PALETTE]) {}
    #[inline(always)]
    fn quad(&mut self, _: u64, _: &[u32], _: u32) -> Option<usize> {
        None
    }
    #[inline(always)]
    fn pixel(&mut self, _: u32, _: &[u32]) -> usize {
        0
    }
    #[inline(always)]
    fn given(&mut self, _: usize, _: u64, _: usize) -> u64 {
        0
    }
}

/// Codes the labels of the blocks of several spheres: nothing is coded of the others. Without a mask
/// every pixel in the image counts as measured. `FAST`, a pixel's label has one context. `tiles` gets
/// the depths of those blocks' pixels, in the order of the map's, `touching` of each block the pixels
/// that touch the sphere they got, as `choice` says.
#[allow(clippy::too_many_arguments)] // one section's whole state
#[allow(unsafe_code)] // run-time dispatch generated by the macro
#[multiversion::multiversion(targets("x86_64+avx2+bmi1+bmi2+lzcnt+popcnt"))]
pub(super) fn code<const FAST: bool, C: Coder, W: Choice>(
    coder: &mut C,
    models: &mut Models,
    rays: &Rays,
    reach: &Reach,
    mask: Option<&Mask>,
    map: &mut LabelMap,
    before: Option<Past<'_, LabelMap>>,
    surfaces: &Surfaces<'_>,
    tiles: &mut Vec<Depths>,
    choice: &mut W,
    touching: &mut [u64],
) {
    let mut depths = [surface::NOTHING; PALETTE];
    tiles.clear();
    tiles.reserve(rays.blocks());
    for k in 0..rays.blocks() {
        let size = usize::from(map.sizes[k]);
        if size <= 1 {
            continue;
        }
        let (x0, y0, ..) = extent(rays, k);
        let palette = map.palettes[k];
        for (depths, &id) in depths.iter_mut().zip(&palette[..size]) {
            surfaces.depths(rays, k, id, depths);
        }
        choice.block(k, &palette[..size], &depths);
        let crossing = if FAST {
            Crossing::default()
        } else {
            Crossing::of(&depths, &palette, size, reach)
        };
        let around = map.around(rays, k);
        let past = before.map(|b| b.picture.past(rays, b.at(k, (x0, y0))));
        let mut block = Block {
            k,
            palette,
            size,
            on: mask.map_or_else(|| mask::inside(rays, k), |mask| mask.block(rays, k)),
            crossing: &crossing,
            ranks: around.ranks(&palette[..size]),
            around,
            past: past.map(|labels| (labels.ranks(&palette[..size]), labels)),
            touching: 0,
        };
        let mut entries = [0u8; BLOCK * BLOCK];
        for q in 0..QUADS {
            block.code_quad::<FAST, C, W>(coder, models, q, choice, &mut entries);
        }
        touching[k] = block.touching;
        let mut chosen = surface::NOTHING;
        for (i, d) in chosen.iter_mut().enumerate() {
            *d = depths[usize::from(entries[i] & 3)][i];
        }
        tiles.push(chosen);
        let mut tile = [NO_SPHERE; BLOCK * BLOCK];
        for (j, row) in tile.chunks_exact_mut(BLOCK).enumerate() {
            row.copy_from_slice(&block.around.0[Window::at(0, j)..][..BLOCK]);
        }
        map.write_tile(k, tile);
    }
}

/// How the spheres of a palette lie to each other (not looked at in a fast frame): of each entry and the next one (bit `8·row +
/// column`).
#[derive(Default)]
struct Crossing {
    /// The entry is in front of the next one.
    front: [u64; NODES],
    /// They are within reach of each other.
    close: [u64; NODES],
}

impl Crossing {
    #[inline(always)]
    fn of(depths: &[Depths; PALETTE], palette: &Palette, size: usize, reach: &Reach) -> Self {
        let mut crossing = Self {
            front: [0; NODES],
            close: [0; NODES],
        };
        for e in 0..size - 1 {
            if palette[e] == NO_SPHERE || palette[e + 1] == NO_SPHERE {
                continue;
            }
            let (a, b) = (&depths[e], &depths[e + 1]);
            let (mut front, mut close) = ([0u8; BLOCK * BLOCK], [0u8; BLOCK * BLOCK]);
            for i in 0..BLOCK * BLOCK {
                front[i] = u8::from(a[i] < b[i]);
                close[i] = u8::from((a[i] - b[i]).abs() <= reach.at(a[i]));
            }
            crossing.front[e] = surface::packed(&front);
            crossing.close[e] = surface::packed(&close);
        }
        crossing
    }
}

/// One block of several spheres in the making.
struct Block<'a> {
    k: usize,
    palette: Palette,
    size: usize,
    on: u64,
    crossing: &'a Crossing,
    /// Labels of the block and around it, as far as they are decoded, and their palette entries.
    around: Window,
    ranks: [u8; WINDOW],
    /// The last frame's.
    past: Option<([u8; WINDOW], Window)>,
    /// Pixels coded so far that touch their sphere.
    touching: u64,
}

impl Block<'_> {
    #[inline(always)]
    fn code_quad<const FAST: bool, C: Coder, W: Choice>(
        &mut self,
        coder: &mut C,
        models: &mut Models,
        q: usize,
        choice: &mut W,
        entries: &mut [u8; BLOCK * BLOCK],
    ) {
        let pixels = quad_pixels(q);
        let on = self.on & pixels;
        let first = Window::at(q % 2 * QUAD, q / 2 * QUAD);
        if on == 0 {
            // nobody asks, but neighbours look
            self.fill(first, self.around.0[first - 1], self.ranks[first - 1]);
            return;
        }
        // the labels of the quad as a whole look like its upper left middle
        let past = self.past.as_ref();
        let near = [
            self.ranks[first - 1 + STEP],
            self.ranks[first + 1 - STEP],
            self.ranks[first - 1 - STEP],
            // the quad to the north-east of the last one is not decoded
            self.ranks[first + if q == 3 { 3 } else { 4 } - STEP],
            past.map_or(self.none(), |(ranks, _)| ranks[first + 1 + STEP]),
        ]
        .map(usize::from);
        let mut nodes = [0usize; NODES];
        for e in 0..self.size - 1 {
            nodes[e] = e * 243 + near.iter().fold(0, |c, &rank| c * 3 + CLASS[e][rank]);
        }
        let split = &mut models.split[self.split_context(q, first)];
        let mut want = None;
        if C::WRITES {
            let mut costs = [0u32; PALETTE];
            let mut far = split.cost(false);
            for e in 0..self.size {
                costs[e] = far;
                if e + 1 < self.size {
                    costs[e] += models.whole[nodes[e]].cost(true);
                    far += models.whole[nodes[e]].cost(false);
                }
            }
            want = choice.quad(on, &costs[..self.size], split.cost(true));
        }
        if coder.bit(split, want.is_none()) {
            for j in 0..QUAD {
                for i in 0..QUAD {
                    let bit = (q / 2 * QUAD + j) * BLOCK + q % 2 * QUAD + i;
                    let at = first + j * STEP + i;
                    if on >> bit & 1 == 0 {
                        self.around.0[at] = self.around.0[at - 1];
                        self.ranks[at] = self.ranks[at - 1];
                    } else {
                        let entry =
                            self.code_pixel::<FAST, C, W>(coder, models, (q, j, i), at, choice);
                        self.around.0[at] = self.palette[entry];
                        self.ranks[at] = entry as u8;
                        entries[bit] = entry as u8;
                        self.touching |= choice.given(self.k, 1 << bit, entry);
                    }
                }
            }
        } else {
            let mut entry = 0;
            while entry + 1 < self.size
                && !coder.bit(&mut models.whole[nodes[entry]], want == Some(entry))
            {
                entry += 1;
            }
            self.fill(first, self.palette[entry], entry as u8);
            for j in 0..QUAD {
                let bit = (q / 2 * QUAD + j) * BLOCK + q % 2 * QUAD;
                entries[bit..bit + QUAD].fill(entry as u8);
            }
            self.touching |= choice.given(self.k, pixels, entry);
        }
    }

    /// Palette entry of "no sphere", which is what lies where there was no last frame.
    #[inline(always)]
    fn none(&self) -> u8 {
        let palette = &self.palette[..self.size];
        let found = palette.iter().position(|&id| id == NO_SPHERE);
        found.unwrap_or(PALETTE) as u8
    }

    #[inline(always)]
    fn fill(&mut self, first: usize, label: u16, rank: u8) {
        for j in 0..QUAD {
            let start = first + j * STEP;
            self.around.0[start..start + QUAD].fill(label);
            self.ranks[start..start + QUAD].fill(rank);
        }
    }

    /// Do the labels around the quad agree, was it divided in the last frame, and do the first two
    /// spheres cross in it?
    #[inline(always)]
    fn split_context(&self, q: usize, first: usize) -> usize {
        let cells = &self.around.0;
        let (w, n) = (cells[first - 1], cells[first - STEP]);
        let west = (1..QUAD).all(|j| cells[first - 1 + j * STEP] == w);
        let north = cells[first - STEP..][..QUAD].iter().all(|&l| l == n);
        let agree = match (west, north) {
            (true, true) if w != n => 1,
            (true, true) if usize::from(self.ranks[first - 1]) < PALETTE => 0,
            (true, true) => 4,
            (false, false) => 3,
            _ => 2,
        };
        let past = self.past.as_ref().map_or(2, |(_, labels)| {
            let label = labels.0[first];
            let row = |j: usize| &labels.0[first + j * STEP..][..QUAD];
            usize::from((0..QUAD).any(|j| row(j).iter().any(|&l| l != label)))
        });
        let pixels = quad_pixels(q);
        let front = self.crossing.front[0] & pixels;
        let crossed = usize::from(front != 0 && front != pixels);
        let close = match self.crossing.close[0] & pixels {
            0 => 0,
            all if all == pixels => 2,
            _ => 1,
        };
        (((agree * 3 + past) * 2 + crossed) * 3 + close) * NODES + self.size - 2
    }

    #[inline(always)]
    fn code_pixel<const FAST: bool, C: Coder, W: Choice>(
        &self,
        coder: &mut C,
        models: &mut Models,
        (q, j, i): (usize, usize, usize),
        at: usize,
        choice: &mut W,
    ) -> usize {
        let bit = (q / 2 * QUAD + j) * BLOCK + q % 2 * QUAD + i;
        // the north-east is not decoded where it lies in a later quad
        let there = i + 1 < QUAD || (j == 0 && q < 3);
        let back = STEP - usize::from(there);
        let near = [at - 1, at - STEP, at - STEP - 1, at - back];
        let [w, n, nw, ne] = near.map(|at| usize::from(self.ranks[at]));
        let past = self
            .past
            .as_ref()
            .map(|(ranks, _)| [at, at + 1, at + STEP].map(|at| usize::from(ranks[at])));
        let mut places = [Place::default(); NODES];
        for e in 0..self.size - 1 {
            let class = &CLASS[e];
            let beside = class[w] * 3 + class[n];
            let around = (beside * 3 + class[nw]) * 3 + class[ne];
            let [here, east, south] = past.map_or([2; 3], |p| p.map(|rank| class[rank]));
            let geometry = ((self.cross(e, bit, 1) * 3 + self.cross(e, bit, BLOCK)) * 2
                + (self.crossing.front[e] >> bit & 1) as usize)
                * 2
                + (self.crossing.close[e] >> bit & 1) as usize;
            places[e] = Place {
                contexts: [
                    e * CELLS[0] + around * 3 + here,
                    e * CELLS[1] + geometry * 9 + beside,
                    e * CELLS[2] + ((here * 3 + east) * 3 + south) * 9 + beside,
                ],
                weights: e * 9 + beside,
            };
        }
        let mixer = &mut models.pixel;
        let mut mixtures = [Mixture::default(); NODES];
        let mut want = 0;
        if C::WRITES {
            let mut costs = [0u32; PALETTE];
            let mut far = 0;
            for e in 0..self.size {
                costs[e] = far;
                if e + 1 < self.size {
                    mixtures[e] = mixer.mix::<FAST>(&places[e]);
                    costs[e] += range_coder::cost(mixtures[e].one(), true);
                    far += range_coder::cost(mixtures[e].one(), false);
                }
            }
            want = choice.pixel(bit as u32, &costs[..self.size]);
        }
        let mut entry = 0;
        while entry + 1 < self.size {
            let at = &places[entry];
            // entries have models of their own: coding one leaves the others' mixtures as they are
            if !C::WRITES {
                mixtures[entry] = mixer.mix::<FAST>(at);
            }
            if mixer.code_mixed::<FAST, C>(coder, at, &mixtures[entry], want == entry) {
                break;
            }
            entry += 1;
        }
        entry
    }

    /// 1 where entry `e` and the next one cross on the way from the pixel `back` bits before, 0 where
    /// not, 2 where that lies outside the block.
    #[inline(always)]
    fn cross(&self, e: usize, bit: usize, back: usize) -> usize {
        let edge = if back == 1 {
            bit.is_multiple_of(BLOCK)
        } else {
            bit < BLOCK
        };
        if edge {
            return 2;
        }
        let front = self.crossing.front[e];
        ((front >> bit ^ front >> (bit - back)) & 1) as usize
    }
}
