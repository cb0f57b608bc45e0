//! Where the pixels of a block were in the last frame.
//!
//! The camera's motion and the depth of a block's first sphere tell it: mask and labels are
//! predicted from there. Whole pixels, one shift for a block.

use super::label_map::LabelMap;
use super::sphere_table::Entry;
use crate::deproject::{BLOCK, Rays};
use crate::fit::motion::Motion;

/// Where a block was in the last frame, relative to where it is, in pixels. It was inside the image,
/// padded to whole blocks.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Shift {
    /// To the right.
    pub x: i32,
    /// Down.
    pub y: i32,
}

/// A picture of the last frame, looked at where each block was then.
pub struct Past<'a, P> {
    /// The picture.
    pub picture: &'a P,
    /// One for each block.
    pub shifts: &'a [Shift],
}

impl<P> Clone for Past<'_, P> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<P> Copy for Past<'_, P> {}

impl<P> Past<'_, P> {
    /// Where pixel (x, y) of block `k` was.
    #[inline(always)]
    #[must_use]
    pub fn at(&self, k: usize, (x, y): (usize, usize)) -> (usize, usize) {
        let shift = self.shifts[k];
        let moved = |at: usize, by: i32| at.wrapping_add_signed(by as isize);
        (moved(x, shift.x), moved(y, shift.y))
    }
}

/// Shift of each block that is `asked` for; all zero where the camera stands still.
pub(super) fn shifts(
    rays: &Rays,
    map: &LabelMap,
    asked: impl Fn(usize) -> bool,
    entries: &[Option<Entry>],
    motion: &Motion,
    out: &mut Vec<Shift>,
) {
    out.clear();
    out.resize(rays.blocks(), Shift::default());
    if motion.is_still() {
        return;
    }
    let mover = motion.mover();
    // ray steps of a pixel, from the single-precision table that all sides share
    let du = f64::from(rays.u[1]) - f64::from(rays.u[0]);
    let dv = f64::from(rays.v[1]) - f64::from(rays.v[0]);
    for (k, out) in out.iter_mut().enumerate().filter(|block| asked(block.0)) {
        let Some(Some(entry)) = entries.get(usize::from(map.palettes[k][0])) else {
            continue;
        };
        let (x0, y0) = (
            k % rays.block_columns * BLOCK,
            k / rays.block_columns * BLOCK,
        );
        let (u, v) = (rays.u[x0 + BLOCK / 2], rays.v[y0 + BLOCK / 2]);
        let w = entry.sphere.inverse_depth(u, v, u * u + v * v + 1.0);
        let (u, v, z) = (f64::from(u), f64::from(v), 1.0 / f64::from(w));
        let p = mover.back([u * z, v * z, z]);
        // the whole block stays inside; NaN stays where it is
        let shift = |by: f64, start: usize, size: usize| {
            // the largest integer not above it; a call without SSE 4.1
            let by = by + 0.5;
            let whole = by as isize;
            let by = whole - isize::from(by < whole as f64);
            by.clamp(-(start as isize), (size - BLOCK - start) as isize) as i32
        };
        *out = Shift {
            x: shift((p[0] / p[2] - u) / du, x0, rays.block_columns * BLOCK),
            y: shift((p[1] / p[2] - v) / dv, y0, rays.block_rows * BLOCK),
        };
    }
}
