//! Section *mask*: which pixels hold a measurement.
//!
//! Blocks first (full, empty or mixed), then the pixels of mixed blocks in raster order, each
//! under a context of six decoded neighbours and three pixels of the last frame's mask.

use super::grid::Plane;
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
    pixel: [Bit; 1024],
}

impl Default for Models {
    fn default() -> Self {
        Self {
            full: [Bit::default(); 36],
            empty: [Bit::default(); 36],
            pixel: [Bit::default(); 1024],
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
    let stride = mask.pixels.stride();
    for y in 0..rays.height {
        for bx in 0..columns {
            if mask.fills[y / BLOCK * columns + bx] != Fill::Mixed {
                continue;
            }
            let start = mask.pixels.index(bx * BLOCK, y);
            for i in start..start + BLOCK.min(rays.width - bx * BLOCK) {
                let p = mask.pixels.cells();
                let near = [
                    p[i - 1],
                    p[i - 2],
                    p[i - stride - 1],
                    p[i - stride],
                    p[i - stride + 1],
                    p[i - 2 * stride],
                ];
                let mut context = near.iter().fold(0usize, |c, &n| c << 1 | usize::from(n));
                context = context << 4
                    | before.map_or(8, |b| {
                        let b = b.pixels.cells();
                        usize::from(b[i]) << 2
                            | usize::from(b[i + 1]) << 1
                            | usize::from(b[i + stride])
                    });
                let value = p[i] != 0;
                let read = coder.bit(&mut models.pixel[context], value);
                mask.pixels.cells_mut()[i] = u8::from(read);
            }
        }
    }
}
