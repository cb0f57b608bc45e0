//! Which sphere each pixel touches: the contact map inside blocks of more than one sphere.
//!
//! Coarse to fine, so that the map is only as fine as it must be (the paper's map resolution, by
//! place): a quad is given to one sphere, or its pixels are. What predicts a label: decoded
//! neighbours, the last frame, and the spheres themselves, which are known by now: where two of
//! them cross, the map changes from one to the other.

use super::grid::{BlockRow, Plane};
use super::mask::{self, Mask, Past, QUAD, QUADS, extent, quad_pixels};
use super::mixer::{CONTEXTS, Mixer, Mixture, Place};
use super::range_coder::{self, Bit, Coder};
use super::surface::{self, Depths, Surfaces};
use crate::contact_map::assign::{EMPTY, PALETTE, Palette};
use crate::contact_map::contact::Reach;
use crate::contact_map::labels::NO_SPHERE;
use crate::deproject::{BLOCK, Rays};
use rayon::prelude::*;

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
    /// Label of each measured pixel. Pixels without a measurement hold a label, too: that of their
    /// quad, or the one to their left.
    pub pixels: Plane<u16>,
}

impl LabelMap {
    /// An empty map over `rays` whose pixels are still to be written.
    pub fn reset(&mut self, rays: &Rays) {
        self.palettes.clear();
        self.palettes.resize(rays.blocks(), EMPTY);
        self.sizes.clear();
        self.sizes.resize(rays.blocks(), 0);
        self.pixels.cover(rays, NO_SPHERE);
    }
}

/// The encoder's choice of labels. Costs are in 1/16 bit; the decoder is asked nothing.
pub trait Choice: Sync {
    /// A block of one sphere at these depths: its pixels that touch it.
    fn alone(&self, k: usize, depths: &Depths) -> u64;
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
    fn alone(&self, _: usize, _: &Depths) -> u64 {
        0
    }
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

/// Labels and predicted depths of the blocks that have one sphere or none: nothing of them is coded.
/// `touching` gets the pixels of each that touch their sphere, as `choice` says.
#[allow(clippy::too_many_arguments)] // one section's whole state
pub(super) fn write_alone<W: Choice>(
    rays: &Rays,
    map: &mut LabelMap,
    surfaces: &Surfaces<'_>,
    predicted: &mut Plane<f32>,
    choice: &W,
    touching: &mut [u64],
) {
    let LabelMap {
        palettes,
        sizes,
        pixels,
    } = map;
    let columns = rays.block_columns;
    let blocks = palettes.par_chunks(columns).zip(sizes.par_chunks(columns));
    let rows = pixels.block_rows().zip(predicted.block_rows());
    rows.zip(blocks)
        .zip(touching.par_chunks_mut(columns))
        .enumerate()
        .for_each(|(by, (((labels, depths), (palettes, sizes)), touching))| {
            let planes = (labels, depths);
            write_row_alone(
                rays,
                by,
                (palettes, sizes),
                surfaces,
                choice,
                planes,
                touching,
            );
        });
}

/// Blocks that are written together.
const STRIP: usize = 4;

#[allow(unsafe_code)] // run-time dispatch generated by the macro
#[multiversion::multiversion(targets("x86_64+avx2+bmi1+popcnt"))]
fn write_row_alone<W: Choice>(
    rays: &Rays,
    by: usize,
    (palettes, sizes): (&[Palette], &[u8]),
    surfaces: &Surfaces<'_>,
    choice: &W,
    (mut labels, mut predicted): (BlockRow<'_, u16>, BlockRow<'_, f32>),
    touching: &mut [u64],
) {
    let (mut ids, mut depths) = ([[0u16; BLOCK * BLOCK]; STRIP], [surface::NOTHING; STRIP]);
    let strips = palettes.chunks(STRIP).zip(sizes.chunks(STRIP));
    for (n, ((palettes, sizes), touching)) in strips.zip(touching.chunks_mut(STRIP)).enumerate() {
        let bx = n * STRIP;
        for (e, (palette, &size)) in palettes.iter().zip(sizes).enumerate() {
            // an empty block's palette is all NO_SPHERE; blocks of several spheres are written later
            ids[e] = [palette[0]; BLOCK * BLOCK];
            touching[e] = 0;
            if size == 1 {
                let k = by * rays.block_columns + bx + e;
                surfaces.depths(rays, k, palette[0], &mut depths[e]);
                touching[e] = choice.alone(k, &depths[e]);
            }
        }
        labels.write_blocks(bx * BLOCK, &ids[..palettes.len()]);
        predicted.write_blocks(bx * BLOCK, &depths[..palettes.len()]);
    }
}

/// Codes the labels of the blocks of several spheres, once [`write_alone`] is through with the
/// others, and writes labels and predicted depths of their pixels. Without a mask every pixel in the
/// image counts as measured. `FAST`, a pixel's label has one context. `touching`: as there.
#[allow(clippy::too_many_arguments)] // one section's whole state
#[allow(unsafe_code)] // run-time dispatch generated by the macro
#[multiversion::multiversion(targets("x86_64+avx2+bmi1+bmi2+popcnt"))]
pub(super) fn code<const FAST: bool, C: Coder, W: Choice>(
    coder: &mut C,
    models: &mut Models,
    rays: &Rays,
    reach: &Reach,
    mask: Option<&Mask>,
    map: &mut LabelMap,
    before: Option<Past<'_, u16>>,
    surfaces: &Surfaces<'_>,
    predicted: &mut Plane<f32>,
    choice: &mut W,
    touching: &mut [u64],
) {
    let mut depths = [surface::NOTHING; PALETTE];
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
        let crossing = Crossing::of(&depths, &palette, size, reach);
        let mut block = Block {
            k,
            palette,
            size,
            on: mask.map_or_else(|| mask::inside(rays, k), |mask| mask.block(rays, k)),
            crossing: &crossing,
            start: map.pixels.index(x0, y0),
            before,
            map,
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
        predicted.write_block(x0, y0, &chosen);
    }
}

/// How the spheres of a palette lie to each other: of each entry and the next one (bit `8·row +
/// column`).
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
    start: usize,
    before: Option<Past<'a, u16>>,
    map: &'a mut LabelMap,
    /// Pixels coded so far that touch their sphere.
    touching: u64,
}

impl Block<'_> {
    /// Palette entry of a label, `PALETTE` for one of another block.
    #[inline(always)]
    fn rank(&self, label: u16) -> usize {
        let mut rank = PALETTE;
        for e in (0..self.size).rev() {
            rank = if self.palette[e] == label { e } else { rank };
        }
        rank
    }

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
        let stride = self.map.pixels.stride();
        let first = self.start + q % 2 * QUAD + q / 2 * QUAD * stride;
        let cells = self.map.pixels.cells();
        if on == 0 {
            // nobody asks, but neighbours look
            let label = cells[first - 1];
            self.fill(first, label);
            return;
        }
        // the labels of the quad as a whole look like its upper left middle
        let past = self
            .before
            .map(|b| b.cells[b.at(self.k, first + 1 + stride)]);
        let near = [
            cells[first - 1 + stride],
            cells[first + 1 - stride],
            cells[first - 1 - stride],
            if q == 3 {
                cells[first + 3 - stride]
            } else {
                cells[first + 4 - stride]
            },
            past.unwrap_or(NO_SPHERE),
        ]
        .map(|label| self.rank(label));
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
                    let at = first + j * stride + i;
                    if on >> bit & 1 == 0 {
                        let left = self.map.pixels.cells()[at - 1];
                        self.map.pixels.cells_mut()[at] = left;
                    } else {
                        let entry =
                            self.code_pixel::<FAST, C, W>(coder, models, (q, j, i), at, choice);
                        self.map.pixels.cells_mut()[at] = self.palette[entry];
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
            self.fill(first, self.palette[entry]);
            for j in 0..QUAD {
                let bit = (q / 2 * QUAD + j) * BLOCK + q % 2 * QUAD;
                entries[bit..bit + QUAD].fill(entry as u8);
            }
            self.touching |= choice.given(self.k, pixels, entry);
        }
    }

    #[inline(always)]
    fn fill(&mut self, first: usize, label: u16) {
        let stride = self.map.pixels.stride();
        for j in 0..QUAD {
            let start = first + j * stride;
            self.map.pixels.cells_mut()[start..start + QUAD].fill(label);
        }
    }

    /// Do the labels around the quad agree, was it divided in the last frame, and do the first two
    /// spheres cross in it?
    #[inline(always)]
    fn split_context(&self, q: usize, first: usize) -> usize {
        let stride = self.map.pixels.stride();
        let cells = self.map.pixels.cells();
        let (w, n) = (cells[first - 1], cells[first - stride]);
        let west = (1..QUAD).all(|j| cells[first - 1 + j * stride] == w);
        let north = cells[first - stride..][..QUAD].iter().all(|&l| l == n);
        let agree = match (west, north) {
            (true, true) if w != n => 1,
            (true, true) if self.palette[..self.size].contains(&w) => 0,
            (true, true) => 4,
            (false, false) => 3,
            _ => 2,
        };
        let past = self.before.map_or(2, |b| {
            let first = b.at(self.k, first);
            let label = b.cells[first];
            let row = |j: usize| &b.cells[first + j * stride..][..QUAD];
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
        let stride = self.map.pixels.stride();
        let cells = self.map.pixels.cells();
        let bit = (q / 2 * QUAD + j) * BLOCK + q % 2 * QUAD + i;
        // the north-east is not decoded where it lies in a later quad
        let there = i + 1 < QUAD || (j == 0 && q < 3);
        let back = stride - usize::from(there);
        let near = [at - 1, at - stride, at - stride - 1, at - back];
        let [w, n, nw, ne] = near.map(|at| self.rank(cells[at]));
        let past = self.before.map(|b| {
            let at = b.at(self.k, at);
            [at, at + 1, at + stride].map(|at| self.rank(b.cells[at]))
        });
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
