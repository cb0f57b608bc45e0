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

/// True where a sphere gives a depth that a sensor integer may be near.
#[inline(always)]
pub(super) fn is_real(depth: f32) -> bool {
    (depth > 0.0) & (depth < BEYOND)
}

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

    /// Sphere `id`, if there is one.
    #[inline(always)]
    pub fn surface(&self, rays: &Rays, id: u16) -> Option<Surface> {
        let entry = self.0.get(usize::from(id)).copied().flatten()?;
        Some(Surface::of(rays, &entry.sphere))
    }

    /// Row `j` of them.
    #[inline(always)]
    pub fn depth_row(&self, rays: &Rays, k: usize, j: usize, id: u16) -> [f32; BLOCK] {
        match self.0.get(usize::from(id)) {
            Some(Some(entry)) => row_of(rays, k, j, &entry.sphere),
            _ => [0.0; BLOCK],
        }
    }
}

/// Depths of `sphere` in block `k`.
#[inline(always)]
pub(super) fn depths_of(rays: &Rays, k: usize, sphere: &Sphere, out: &mut Depths) {
    for (j, out) in out.as_chunks_mut::<BLOCK>().0.iter_mut().enumerate() {
        *out = row_of(rays, k, j, sphere);
    }
}

/// Row `j` of them.
#[inline(always)]
fn row_of(rays: &Rays, k: usize, j: usize, sphere: &Sphere) -> [f32; BLOCK] {
    let (x0, y0) = (
        k % rays.block_columns * BLOCK,
        k / rays.block_columns * BLOCK,
    );
    let mut row = [0.0f32; BLOCK];
    let Some(u) = rays.u[x0..].first_chunk::<BLOCK>() else {
        return row;
    };
    let (v, surface) = (rays.v[y0 + j], Surface::of(rays, sphere));
    for i in 0..BLOCK {
        row[i] = surface.depth(u[i], v);
    }
    row
}

/// A sphere, ready to be looked at along many rays.
#[derive(Clone, Copy)]
pub(super) struct Surface {
    m: glam::Vec3,
    a4: f32,
    side: f32,
    per_metre: f32,
}

impl Surface {
    #[inline(always)]
    pub fn of(rays: &Rays, sphere: &Sphere) -> Self {
        Self {
            m: sphere.m,
            a4: 4.0 * sphere.a,
            side: if sphere.far { -1.0 } else { 1.0 },
            per_metre: rays.per_metre,
        }
    }

    /// Its depth along the ray (u, v, 1), in depth integers.
    #[inline(always)]
    pub fn depth(&self, u: f32, v: f32) -> f32 {
        let q = u * u + v * v + 1.0;
        let l = self.m.x * u + self.m.y * v + self.m.z;
        self.per_metre / (0.5 * (l + self.side * (l * l + self.a4 * q).sqrt()))
    }
}

/// Cells of 0 or 1 as bits `8·row + column`.
#[inline(always)]
pub(super) fn packed(cells: &[u8; BLOCK * BLOCK]) -> u64 {
    let mut bits = 0;
    for (j, row) in cells.as_chunks().0.iter().enumerate() {
        bits |= packed_row(row) << (BLOCK * j);
    }
    bits
}

/// A row of them.
#[inline(always)]
pub(super) fn packed_row(row: &[u8; BLOCK]) -> u64 {
    u64::from_le_bytes(*row).wrapping_mul(0x0102_0408_1020_4080) >> 56
}

/// A predicted depth as the integer a residual adds to: nearest, 0 where there is no surface.
#[inline(always)]
pub(super) fn to_integer(depth: f32) -> u16 {
    // the cast takes NaN and negatives to 0 and large values to the largest integer
    (depth + 0.5) as u16
}
