//! The encoder's choice of the mask, where it may choose: holes and specks that are noise.
//!
//! A stereo or structured-light sensor's mask flickers along every edge. Kept to the pixel it takes a
//! third of a payload. A mask that may differ is smoothed in space and time: a pixel goes with most
//! of its neighbours, and with its past where they are divided.

use super::grid::Plane;
use super::mask::{QUADS, inside, quad_pixels};
use crate::contact_map::contact::measured;
use crate::deproject::{BLOCK, Rays};

/// From so many measured neighbours of eight on a hole is filled; where it was measured in the last
/// frame, from fewer on.
const FILLED: [u32; 2] = [6, 4];
/// Up to so many a reading is dropped; where there was none in the last frame, up to more.
const DROPPED: [u32; 2] = [2, 4];

/// What smoothing changed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Changed {
    /// Measured pixels that are not in the payload.
    pub lost: u32,
    /// Pixels of the payload that were not measured.
    pub invented: u32,
}

/// Smooths the mask of `plane` (padded depth integers, 0 = no measurement) against `past`, the last
/// frame's; filled pixels get the integer of a measured neighbour. `before` is scratch.
pub(super) fn smooth(
    rays: &Rays,
    plane: &mut [u16],
    past: Option<&Plane<u8>>,
    before: &mut Vec<u16>,
) -> Changed {
    before.clear();
    before.extend_from_slice(plane);
    let stride = rays.stride();
    let mut changed = Changed::default();
    for k in 0..rays.blocks() {
        let (bx, by) = (k % rays.block_columns, k / rays.block_columns);
        let (all, on) = (inside(rays, k), measured(before, rays, (bx, by)));
        for q in 0..QUADS {
            // whole quads have no edge but that to the next one, which that one sees to
            let here = quad_pixels(q) & all;
            if on & here == 0 || on & here == here {
                continue;
            }
            let mut left = here;
            while left != 0 {
                let bit = left.trailing_zeros() as usize;
                left &= left - 1;
                let (x, y) = (bx * BLOCK + bit % BLOCK, by * BLOCK + bit / BLOCK);
                let (x0, x1) = (x.saturating_sub(1), (x + 1).min(rays.width - 1));
                let (y0, y1) = (y.saturating_sub(1), (y + 1).min(rays.height - 1));
                let around = || (y0..=y1).flat_map(|y| &before[y * stride + x0..=y * stride + x1]);
                let at = y * stride + x;
                let own = before[at];
                let near = around().filter(|&&raw| raw != 0).count() as u32 - u32::from(own != 0);
                let was = past.map(|p| p.cells()[p.index(x, y)] != 0);
                if own == 0 && near >= FILLED[usize::from(was == Some(true))] {
                    // the nearest surface: what fills a hole must not stand in the air
                    plane[at] = around().copied().max().unwrap_or(0);
                    changed.invented += 1;
                } else if own != 0 && near <= DROPPED[usize::from(was == Some(false))] {
                    plane[at] = 0;
                    changed.lost += 1;
                }
            }
        }
    }
    changed
}
