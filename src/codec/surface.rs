//! Depths that spheres predict, in depth integers: the arithmetic encoder and decoder share.

use super::sphere_table::Entry;
use crate::contact_map::labels::NO_SPHERE;
use crate::deproject::{BLOCK, Rays};
use crate::fit::sphere::Sphere;

/// Predicted depths of a block's pixels, row by row; not above 0 or NaN where there is no surface.
pub(super) type Depths = [f32; BLOCK * BLOCK];

/// No surface anywhere.
pub(super) const NOTHING: Depths = [0.0; BLOCK * BLOCK];

/// The first predicted depth, in depth integers, that no sensor integer is near. Such a pixel is
/// rebuilt from the largest integer, not from its sphere.
pub(super) const BEYOND: f32 = 65536.0;

/// The spheres of a frame by number.
pub(super) struct Surfaces<'a>(pub &'a [Option<Entry>]);

impl Surfaces<'_> {
    /// Depths of sphere `id` in block `k`; nothing where there is no such sphere.
    #[inline(always)]
    pub fn depths(&self, rays: &Rays, k: usize, id: u16, out: &mut Depths) {
        let entry = self.0.get(usize::from(id)).copied().flatten();
        let (Some(entry), true) = (entry, id != NO_SPHERE) else {
            *out = NOTHING;
            return;
        };
        depths_of(rays, k, &entry.sphere, out);
    }
}

/// Depths of `sphere` in block `k`.
#[inline(always)]
pub(super) fn depths_of(rays: &Rays, k: usize, sphere: &Sphere, out: &mut Depths) {
    let (x0, y0) = (
        k % rays.block_columns * BLOCK,
        k / rays.block_columns * BLOCK,
    );
    let Some(u) = rays.u[x0..].first_chunk::<BLOCK>() else {
        return;
    };
    let (a4, side) = (4.0 * sphere.a, if sphere.far { -1.0 } else { 1.0 });
    for (row, &v) in out.chunks_exact_mut(BLOCK).zip(&rays.v[y0..]) {
        for i in 0..BLOCK {
            let q = u[i] * u[i] + v * v + 1.0;
            let l = sphere.m.x * u[i] + sphere.m.y * v + sphere.m.z;
            row[i] = rays.per_metre / (0.5 * (l + side * (l * l + a4 * q).sqrt()));
        }
    }
}

/// Cells of 0 or 1 as bits `8·row + column`.
#[inline(always)]
pub(super) fn packed(cells: &[u8; BLOCK * BLOCK]) -> u64 {
    let mut bits = 0;
    for (j, row) in cells.chunks_exact(BLOCK).enumerate() {
        if let Some(row) = row.first_chunk::<BLOCK>() {
            let row = u64::from_le_bytes(*row).wrapping_mul(0x0102_0408_1020_4080) >> 56;
            bits |= row << (BLOCK * j);
        }
    }
    bits
}

/// A predicted depth as the integer a residual adds to: nearest, 0 where there is no surface.
#[inline(always)]
pub(super) fn to_integer(depth: f32) -> u16 {
    // the cast takes NaN and negatives to 0 and large values to the largest integer
    (depth + 0.5) as u16
}
