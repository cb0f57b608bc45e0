//! Which pixels hold a measurement.
//!
//! Coarse to fine: blocks of 8×8 pixels are full, empty or mixed ([`code_fills`], section
//! *blocks*); the four quads of mixed blocks likewise ([`code_quads`], section *pixels*); then the
//! pixels of mixed quads in raster order ([`code_pixels`]), under three mixed contexts of decoded
//! neighbours and of the last frame's mask.

use super::bitmap::Bitmap;
use super::flow::Past;
use super::mixer::{Mixer, Place};
use super::range_coder::{self, Bit, Coder};
use crate::contact_map::contact::measured;
use crate::deproject::{BLOCK, Rays};

/// Pixels along one side of a quad, a quarter of a block.
pub const QUAD: usize = BLOCK / 2;
/// Quads of a block: top left, top right, bottom left, bottom right.
pub const QUADS: usize = 4;

/// Pixels of quad `q` in its block (bit `8·row + column`).
#[inline(always)]
#[must_use]
pub const fn quad_pixels(q: usize) -> u64 {
    0x0F0F_0F0F << (QUAD * (q & 1) + QUAD * BLOCK * (q >> 1))
}

/// Measured pixels of a block or a quad.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(u8)]
pub enum Fill {
    /// None.
    #[default]
    Empty,
    /// All that lie in the image.
    Full,
    /// Some.
    Mixed,
}

impl Past<'_, Bitmap> {
    /// Fill of the quad that begins at (x, y).
    #[inline(always)]
    fn quad(&self, k: usize, at: (usize, usize)) -> Fill {
        let (x, y) = self.at(k, at);
        let row = |j: usize| self.picture.window((x, 0), (y + j, 0)) & 15;
        match row(0) + row(1) * 16 + row(2) * 256 + row(3) * 4096 {
            0 => Fill::Empty,
            0xFFFF => Fill::Full,
            _ => Fill::Mixed,
        }
    }
}

impl Fill {
    /// What `on` fills of `inside`, the pixels that lie in the image.
    fn of(on: u64, inside: u64) -> Self {
        match on & inside {
            0 => Self::Empty,
            n if n == inside => Self::Full,
            _ => Self::Mixed,
        }
    }
}

/// Learnt models of the section *blocks*.
#[derive(Clone, Debug)]
pub struct FillModels {
    full: [Bit; 36],
    empty: [Bit; 36],
}

impl Default for FillModels {
    fn default() -> Self {
        Self {
            full: [Bit::default(); 36],
            empty: [Bit::default(); 36],
        }
    }
}

/// Learnt models of quads and pixels.
#[derive(Clone, Debug)]
pub struct Models {
    full: [Bit; 324],
    empty: [Bit; 324],
    pixel: Mixer,
}

impl Models {
    /// Back to the start: a key frame begins.
    pub fn reset(&mut self) {
        self.full.fill(Bit::default());
        self.empty.fill(Bit::default());
        self.pixel.reset();
    }
}

impl Default for Models {
    fn default() -> Self {
        Self {
            full: [Bit::default(); 324],
            empty: [Bit::default(); 324],
            pixel: Mixer::new([4096, 2048, 4096], 64),
        }
    }
}

/// A frame's mask.
#[derive(Clone, Debug, Default)]
pub struct Mask {
    /// Set where there is a measurement.
    pub pixels: Bitmap,
    /// One for each block.
    pub fills: Vec<Fill>,
    /// Four for each block.
    pub quads: Vec<[Fill; QUADS]>,
}

impl Mask {
    /// A mask over `rays` that is still to be coded.
    pub fn reset(&mut self, rays: &Rays) {
        self.pixels.cover(rays);
        self.fills.clear();
        self.fills.resize(rays.blocks(), Fill::Empty);
        self.quads.clear();
        self.quads.resize(rays.blocks(), [Fill::Empty; QUADS]);
    }

    /// Measured pixels of block `k` as far as they are decoded (bit `8·row + column`).
    #[inline(always)]
    #[must_use]
    pub fn block(&self, rays: &Rays, k: usize) -> u64 {
        match self.fills[k] {
            Fill::Empty => 0,
            Fill::Full => inside(rays, k),
            Fill::Mixed => {
                let columns = rays.block_columns;
                self.pixels.block(k % columns, k / columns)
            }
        }
    }
}

/// Measured pixels of each block of a padded plane of depth integers (0 = no measurement).
pub fn measure(rays: &Rays, plane: &[u16], out: &mut Vec<u64>) {
    out.clear();
    out.extend((0..rays.blocks()).map(|k| {
        let at = (k % rays.block_columns, k / rays.block_columns);
        measured(plane, rays, at)
    }));
}

/// Pixels of block `k` that lie in the image (bit `8·row + column`).
#[inline(always)]
#[must_use]
pub fn inside(rays: &Rays, k: usize) -> u64 {
    let (_, _, w, h) = extent(rays, k);
    let row = u64::MAX >> (BLOCK * BLOCK - w) & 0xFF;
    let rows = u64::MAX >> (BLOCK * (BLOCK - h));
    (row * 0x0101_0101_0101_0101) & rows
}

/// First pixel and size of block `k`, clipped to the image.
#[inline]
#[must_use]
pub fn extent(rays: &Rays, k: usize) -> (usize, usize, usize, usize) {
    let (x0, y0) = (
        k % rays.block_columns * BLOCK,
        k / rays.block_columns * BLOCK,
    );
    (
        x0,
        y0,
        BLOCK.min(rays.width - x0),
        BLOCK.min(rays.height - y0),
    )
}

#[inline(always)]
fn code_fill<C: Coder>(coder: &mut C, full: &mut Bit, empty: &mut Bit, fill: Fill) -> Fill {
    if coder.bit(full, fill == Fill::Full) {
        Fill::Full
    } else if coder.bit(empty, fill == Fill::Empty) {
        Fill::Empty
    } else {
        Fill::Mixed
    }
}

/// Codes the fills of the blocks; `wanted` are the measured pixels of each (not used to decode).
pub fn code_fills<C: Coder>(
    coder: &mut C,
    models: &mut FillModels,
    rays: &Rays,
    mask: &mut Mask,
    before: Option<&Mask>,
    wanted: &[u64],
) {
    let columns = rays.block_columns;
    for k in 0..rays.blocks() {
        let fill = Fill::of(wanted.get(k).copied().unwrap_or(0), inside(rays, k));
        let at = |there: bool, k: usize| if there { mask.fills[k] } else { Fill::Empty };
        let west = at(!k.is_multiple_of(columns), k.wrapping_sub(1));
        let north = at(k >= columns, k.wrapping_sub(columns));
        let past = before.map_or(3, |b| b.fills[k] as usize);
        let context = (west as usize * 3 + north as usize) * 4 + past;
        let (full, empty) = (&mut models.full[context], &mut models.empty[context]);
        mask.fills[k] = code_fill(coder, full, empty, fill);
    }
}

/// Codes the quads of mixed blocks and sets all pixels that they and the fills tell, the others
/// to 0.
pub fn code_quads<C: Coder>(
    coder: &mut C,
    models: &mut Models,
    rays: &Rays,
    mask: &mut Mask,
    before: Option<Past<'_, Bitmap>>,
    wanted: &[u64],
) {
    let (columns, blocks) = (rays.block_columns, rays.blocks());
    let Mask {
        pixels,
        fills,
        quads,
    } = mask;
    write_fills(rays, fills, pixels);
    for k in 0..blocks {
        let fill = fills[k];
        if fill != Fill::Mixed {
            quads[k] = [fill; QUADS];
            continue;
        }
        let (all, on) = (inside(rays, k), wanted.get(k).copied().unwrap_or(0));
        let (x, y) = (k % columns, k / columns);
        let quad = |there: bool, k: usize, q: usize| if there { quads[k][q] } else { Fill::Empty };
        let block = |there: bool, k: usize| if there { fills[k] } else { Fill::Empty };
        // around the block: quads that are decoded, blocks where they are not
        let west = [1, 3].map(|q| quad(x > 0, k.wrapping_sub(1), q));
        let north = [2, 3].map(|q| quad(k >= columns, k.wrapping_sub(columns), q));
        let east = block(x + 1 < columns, k + 1);
        let south = block(k + columns < blocks, k + columns);
        for q in 0..QUADS {
            let here = quad_pixels(q) & all;
            if here == 0 {
                quads[k][q] = Fill::Empty;
                continue;
            }
            let (right, low) = (q & 1, q >> 1);
            let w = if right == 1 {
                quads[k][q - 1]
            } else {
                west[low]
            };
            let n = if low == 1 {
                quads[k][q - 2]
            } else {
                north[right]
            };
            let e = if right == 1 { east } else { Fill::Mixed };
            let s = if low == 1 { south } else { Fill::Mixed };
            let past = before.map_or(3, |b| {
                let first = (x * BLOCK + QUAD * right, y * BLOCK + QUAD * low);
                b.quad(k, first) as usize
            });
            let around = [n, e, s]
                .iter()
                .fold(w as usize, |c, &f| c * 3 + f as usize);
            let context = around * 4 + past;
            let (full, empty) = (&mut models.full[context], &mut models.empty[context]);
            let fill = code_fill(coder, full, empty, Fill::of(on, here));
            quads[k][q] = fill;
            if fill == Fill::Full {
                pixels.set_block(x, y, here);
            }
        }
    }
}

/// Writes the pixels of full blocks as measured, all others as not. Those beyond the image stay 0.
fn write_fills(rays: &Rays, fills: &[Fill], pixels: &mut Bitmap) {
    let last = u8::MAX >> (rays.stride() - rays.width);
    for (by, fills) in fills.chunks(rays.block_columns).enumerate() {
        for (y, row) in (by * BLOCK..).zip(pixels.block_row_mut(by)) {
            if y >= rays.height {
                row.fill(0);
                continue;
            }
            for (bits, fill) in row.iter_mut().zip(fills) {
                *bits = u8::from(*fill == Fill::Full).wrapping_neg();
            }
            if let Some(bits) = row.last_mut() {
                *bits &= last;
            }
        }
    }
}

/// Codes the pixels of mixed quads; `FAST`, each under one context.
#[allow(unsafe_code)] // run-time dispatch generated by the macro
#[multiversion::multiversion(targets("x86_64+avx2+bmi1+bmi2+lzcnt"))]
pub fn code_pixels<const FAST: bool, C: Coder>(
    coder: &mut C,
    models: &mut Models,
    rays: &Rays,
    mask: &mut Mask,
    before: Option<Past<'_, Bitmap>>,
    wanted: &[u64],
    how: Precision,
) {
    let columns = rays.block_columns;
    let mixer = &mut models.pixel;
    for y in 0..rays.height {
        let row = y / BLOCK * columns;
        let low = y % BLOCK / QUAD * 2;
        for k in row..row + columns {
            if mask.fills[k] != Fill::Mixed {
                continue;
            }
            let on = wanted.get(k).map_or(0, |on| on >> (y % BLOCK * BLOCK));
            for right in 0..2 {
                if mask.quads[k][low + right] != Fill::Mixed {
                    continue;
                }
                let x0 = (k - row) * BLOCK + right * QUAD;
                let mut bits = 0;
                if how == Precision::Plain {
                    for j in 0..QUAD.min(rays.width - x0) {
                        let on = on >> (right * QUAD + j) & 1;
                        bits |= (coder.plain(1, on as u32) as u8) << j;
                    }
                    mask.pixels.set(k - row, y, bits << (right * QUAD));
                    continue;
                }
                let past = before.map(|b| (b.picture, b.at(k, (x0, y))));
                let mut around = Around::of(&mask.pixels, past, (x0, y));
                for j in 0..QUAD.min(rays.width - x0) {
                    let at = around.place(j);
                    let mixture = mixer.mix::<FAST>(&at);
                    let mut on = on >> (right * QUAD + j) & 1 != 0;
                    if let (true, Precision::Within(patience)) = (C::WRITES, how) {
                        let price = |on: bool| range_coder::cost(mixture.one(), on);
                        on ^= price(on) >= price(!on) + patience;
                    }
                    let read = mixer.code_mixed::<FAST, C>(coder, &at, &mixture, on);
                    around.row |= usize::from(read) << (LEFT + j);
                    bits |= u8::from(read) << j;
                }
                mask.pixels.set(k - row, y, bits << (right * QUAD));
            }
        }
    }
}

/// How the pixels of a mask are coded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Precision {
    /// Each as it is.
    Exact,
    /// Encoding, a pixel becomes what its neighbours expect where what it is would cost so much (1/16
    /// bit) more, or above.
    Within(u32),
    /// Each as it is, a plain bit: fast, whatever the mask.
    Plain,
}

/// Columns to the left of a pixel that its contexts look at.
const LEFT: usize = 3;

/// Rows of the mask around four pixels as bits; bit [`LEFT`] is the first pixel's column. Read
/// once for the four of them.
struct Around {
    top: usize,
    above: usize,
    /// The pixels' own row, as far as it is known.
    row: usize,
    below: usize,
    /// The last mask's three rows.
    past: Option<[usize; 3]>,
}

impl Around {
    #[inline(always)]
    fn of(
        mask: &Bitmap,
        before: Option<(&Bitmap, (usize, usize))>,
        (x, y): (usize, usize),
    ) -> Self {
        Self {
            top: mask.window((x, LEFT), (y, 2)),
            above: mask.window((x, LEFT), (y, 1)),
            row: mask.window((x, LEFT), (y, 0)),
            below: mask.window((x, LEFT), (y + 1, 0)),
            past: before.map(|(past, (x, y))| {
                [(y, 1), (y, 0), (y + 1, 0)].map(|row| past.window((x, LEFT), row))
            }),
        }
    }

    /// Contexts of pixel `j`: six neighbours decoded already with three pixels of the last mask and
    /// what is known to the east and south; ten neighbours; the last mask all around.
    #[inline(always)]
    fn place(&self, j: usize) -> Place {
        // bit 3 of each row is the pixel's own column
        let [top, above, row, below] = [self.top, self.above, self.row, self.below].map(|w| w >> j);
        let near = row >> 1 & 3 | (above >> 2 & 7) << 2 | (top >> 3 & 1) << 5;
        let ahead = row >> 4 & 1 | (below >> 3 & 1) << 1;
        let wide = row & 1
            | (above >> 1 & 1) << 1
            | (above >> 5 & 1) << 2
            | (top >> 2 & 1) << 3
            | (top >> 4 & 1) << 4;
        let (few, all) = match self.past {
            None => (8, 512),
            Some(past) => {
                let [n, same, s] = past.map(|w| w >> (j + 2) & 7);
                (same >> 1 | (s >> 1 & 1) << 2, n | same << 3 | s << 6)
            }
        };
        let (w, n) = (row >> 2 & 1, above >> 3 & 1);
        Place {
            contexts: [
                near << 6 | few << 2 | ahead,
                near << 5 | wide,
                all << 2 | w << 1 | n,
            ],
            weights: near,
        }
    }
}
