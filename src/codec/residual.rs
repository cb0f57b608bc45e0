//! Section *residual*: measurements that do not touch the sphere of their pixel.
//!
//! A measurement is `prediction + k·step` in the sensor's integers. Within the contact distance k
//! is 0 and the sphere's own depth stands; elsewhere the step is twice the contact distance's
//! floor, so the rebuilt depth is within the floor. With step 1 everywhere the integers come back
//! exactly (lossless).

use super::grid::Plane;
use super::mask::Mask;
use super::range_coder::{Bit, Coder, Integer};
use crate::deproject::{BLOCK, Rays};

/// Learnt models of the section.
#[derive(Clone, Debug)]
pub struct Models {
    block: [Bit; 9],
    zero: [Bit; 64],
    sign: [Bit; 9],
    size: [Integer; 6],
}

impl Default for Models {
    fn default() -> Self {
        Self {
            block: Default::default(),
            zero: [Bit::default(); 64],
            sign: Default::default(),
            size: Default::default(),
        }
    }
}

/// Largest |k|: a whole range of 16-bit integers either way.
pub const MOST: i32 = 1 << 17;

/// Which blocks have any k ≠ 0.
pub fn code_blocks<C: Coder>(
    coder: &mut C,
    models: &mut Models,
    rays: &Rays,
    sizes: &[u8],
    active: &mut [bool],
    before: Option<&[bool]>,
) {
    let columns = rays.block_columns;
    for k in 0..rays.blocks() {
        if sizes[k] == 0 {
            active[k] = false;
            continue;
        }
        let west = k % columns > 0 && active[k - 1];
        let north = k >= columns && active[k - columns];
        let past = before.map_or(2, |b| usize::from(b[k]));
        let context = (usize::from(west) + usize::from(north)) * 3 + past;
        active[k] = coder.bit(&mut models.block[context], active[k]);
    }
}

/// log₂-like class of a magnitude, 0 to 5.
#[inline(always)]
fn class(magnitude: u32) -> usize {
    (32 - magnitude.leading_zeros()).min(5) as usize
}

/// Codes k of pixel (x, y), cell `i` of the planes; neighbours are decoded already.
#[inline(always)]
pub fn code_pixel<C: Coder>(
    coder: &mut C,
    models: &mut Models,
    plane: &Plane<i32>,
    i: usize,
    value: i32,
) -> i32 {
    let (cells, stride) = (plane.cells(), plane.stride());
    let (w, n, nw, ne) = (
        cells[i - 1],
        cells[i - stride],
        cells[i - stride - 1],
        cells[i - stride + 1],
    );
    let around = 2 * (w.unsigned_abs() + n.unsigned_abs()) + nw.unsigned_abs() + ne.unsigned_abs();
    let level = class(around);
    let context =
        level * 8 + usize::from(w != 0) * 4 + usize::from(n != 0) * 2 + usize::from(ne != 0);
    if coder.bit(&mut models.zero[context], value == 0) {
        return 0;
    }
    let sign = (w.signum() + 1) as usize * 3 + (n.signum() + 1) as usize;
    let negative = coder.bit(&mut models.sign[sign], value < 0);
    let size = models.size[level]
        .code(coder, value.unsigned_abs().saturating_sub(1))
        .min(MOST as u32 - 1) as i32
        + 1;
    if negative { -size } else { size }
}

/// Walks the measured pixels of active blocks in raster order.
pub fn for_each_pixel(
    rays: &Rays,
    mask: &Mask,
    active: &[bool],
    mut visit: impl FnMut(usize, usize, usize),
) {
    let columns = rays.block_columns;
    for y in 0..rays.height {
        for bx in 0..columns {
            if !active[y / BLOCK * columns + bx] {
                continue;
            }
            let x0 = bx * BLOCK;
            let start = mask.pixels.index(x0, y);
            for x in x0..x0 + BLOCK.min(rays.width - x0) {
                let i = start + x - x0;
                if mask.pixels.cells()[i] != 0 {
                    visit(x, y, i);
                }
            }
        }
    }
}
