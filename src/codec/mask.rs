//! Section *mask*: which pixels hold a measurement.
//!
//! Blocks first (full, empty or mixed), then the pixels of mixed blocks in raster order: three
//! contexts of decoded neighbours and of the last frame's mask, mixed.

use super::grid::Plane;
use super::mixer::{self, CONTEXTS, Estimate, Weights};
use super::range_coder::{Bit, Coder};
use crate::contact_map::contact::measured;
use crate::deproject::{BLOCK, Rays};

/// Measured pixels of a block.
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

/// Learnt models of the section.
#[derive(Clone, Debug)]
pub struct Models {
    full: [Bit; 36],
    empty: [Bit; 36],
    pixel: [Vec<Estimate>; CONTEXTS],
    weights: [Weights; 64],
}

impl Models {
    /// Back to the start: a key frame begins.
    pub fn reset(&mut self) {
        self.full.fill(Bit::default());
        self.empty.fill(Bit::default());
        self.weights.fill(Weights::default());
        for p in &mut self.pixel {
            p.fill(Estimate::default());
        }
    }
}

impl Default for Models {
    fn default() -> Self {
        Self {
            full: [Bit::default(); 36],
            empty: [Bit::default(); 36],
            pixel: [1024, 2048, 4096].map(|n| vec![Estimate::default(); n]),
            weights: [Weights::default(); 64],
        }
    }
}

/// A frame's mask.
#[derive(Clone, Debug, Default)]
pub struct Mask {
    /// 1 where there is a measurement.
    pub pixels: Plane<u8>,
    /// One for each block.
    pub fills: Vec<Fill>,
}

impl Mask {
    /// A mask over `rays` whose pixels are still to be written.
    pub fn reset(&mut self, rays: &Rays) {
        self.pixels.cover(rays, 0);
        self.fills.clear();
        self.fills.resize(rays.blocks(), Fill::Empty);
    }

    /// Sets pixels and fills from a padded plane of depth integers (0 = no measurement).
    pub fn measure(&mut self, rays: &Rays, plane: &[u16]) {
        let stride = rays.stride();
        for y in 0..rays.height {
            let start = self.pixels.index(0, y);
            let row = &mut self.pixels.cells_mut()[start..start + rays.width];
            for (m, &raw) in row.iter_mut().zip(&plane[y * stride..]) {
                *m = u8::from(raw != 0);
            }
        }
        for k in 0..rays.blocks() {
            let (_, _, w, h) = extent(rays, k);
            let count = measured(
                plane,
                rays,
                (k % rays.block_columns, k / rays.block_columns),
            )
            .count_ones() as usize;
            self.fills[k] = match count {
                0 => Fill::Empty,
                n if n == w * h => Fill::Full,
                _ => Fill::Mixed,
            };
        }
    }
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

/// Codes `mask`; `before` is the mask of the reference frame.
pub fn code<C: Coder>(
    coder: &mut C,
    models: &mut Models,
    rays: &Rays,
    mask: &mut Mask,
    before: Option<&Mask>,
) {
    let columns = rays.block_columns;
    for k in 0..rays.blocks() {
        let fill = mask.fills[k];
        let west = if k % columns > 0 {
            mask.fills[k - 1]
        } else {
            Fill::Empty
        };
        let north = if k >= columns {
            mask.fills[k - columns]
        } else {
            Fill::Empty
        };
        let past = before.map_or(3, |b| b.fills[k] as usize);
        let context = (west as usize * 3 + north as usize) * 4 + past;
        let read = if coder.bit(&mut models.full[context], fill == Fill::Full) {
            Fill::Full
        } else if coder.bit(&mut models.empty[context], fill == Fill::Empty) {
            Fill::Empty
        } else {
            Fill::Mixed
        };
        mask.fills[k] = read;
        if read != Fill::Mixed {
            // cells beyond the image stay 0
            let (x0, y0, w, h) = extent(rays, k);
            for j in 0..h {
                let start = mask.pixels.index(x0, y0 + j);
                mask.pixels.cells_mut()[start..start + w].fill(u8::from(read == Fill::Full));
            }
        }
    }
    for y in 0..rays.height {
        for bx in 0..columns {
            if mask.fills[y / BLOCK * columns + bx] != Fill::Mixed {
                continue;
            }
            let start = mask.pixels.index(bx * BLOCK, y);
            for i in start..start + BLOCK.min(rays.width - bx * BLOCK) {
                let cells = contexts(&mask.pixels, before.map(|b| &b.pixels), i);
                let value = mask.pixels.cells()[i] != 0;
                let [a, b, c] = &mut models.pixel;
                let read = mixer::code(
                    coder,
                    [&mut a[cells[0]], &mut b[cells[1]], &mut c[cells[2]]],
                    &mut models.weights[cells[0] >> 4],
                    value,
                );
                mask.pixels.cells_mut()[i] = u8::from(read);
            }
        }
    }
}

/// Contexts of a pixel: ten neighbours decoded already; six of them with three pixels of the last
/// mask; the last mask all around.
#[inline(always)]
fn contexts(mask: &Plane<u8>, before: Option<&Plane<u8>>, i: usize) -> [usize; CONTEXTS] {
    let (p, s) = (mask.cells(), mask.stride());
    let bits = |p: &[u8], at: &[usize]| at.iter().fold(0, |c, &k| c << 1 | usize::from(p[k]));
    let near = bits(p, &[i - 1, i - 2, i - s - 1, i - s, i - s + 1, i - 2 * s]);
    let wide = bits(
        p,
        &[i - 3, i - s - 2, i - s + 2, i - 2 * s - 1, i - 2 * s + 1],
    );
    let (few, all) = match before {
        None => (8, 512),
        Some(b) => {
            let b = b.cells();
            (
                bits(b, &[i, i + 1, i + s]),
                bits(
                    b,
                    &[
                        i - s - 1,
                        i - s,
                        i - s + 1,
                        i - 1,
                        i,
                        i + 1,
                        i + s - 1,
                        i + s,
                        i + s + 1,
                    ],
                ),
            )
        }
    };
    [
        near << 4 | few,
        near << 5 | wide,
        all << 2 | (near >> 5) << 1 | near >> 2 & 1,
    ]
}
