//! Contact: does a pixel's measurement touch a sphere?

use crate::deproject::{BLOCK, Rays};
use crate::fit::contact_distance::ContactDistance;
use crate::fit::sphere::Sphere;

/// Relative error of a depth rebuilt in single precision, a few roundings.
const ROUNDING: f32 = 4e-7;
/// Share of the floor that a residual step uses; the rest is room for the same rounding.
const SAFE: f32 = 0.999;

/// A contact distance in the sensor's own integers: `max(floor, growth·raw²)` along the ray.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reach {
    floor: f32,
    growth: f32,
}

impl Reach {
    /// `distance` in units of `unit_m` metres.
    #[must_use]
    pub fn new(distance: &ContactDistance, unit_m: f64) -> Self {
        Self {
            floor: (distance.floor_m / unit_m) as f32,
            growth: (distance.per_z2 * unit_m) as f32,
        }
    }

    /// True where a measured `raw` touches a surface at depth `predicted` (both depth integers) on
    /// a ray of squared length `q`.
    #[inline(always)]
    #[must_use]
    pub fn touches(&self, raw: f32, predicted: f32, q: f32) -> bool {
        let error = raw - predicted;
        // rounding of the rebuilt depth to single precision must not break the bound
        let reach = self.at(raw) - ROUNDING * raw;
        (error * error * q <= reach * reach) & (reach > 0.0)
    }

    /// Step of the residual on a ray of squared length `q`, depth integers: a residual of whole
    /// steps ends within the floor.
    #[inline(always)]
    #[must_use]
    pub fn step(&self, q: f32) -> i32 {
        ((2.0 * SAFE * self.floor / q.sqrt()) as i32).max(1)
    }

    /// The largest distance along the ray, in depth integers, at which `raw` still touches.
    #[inline(always)]
    #[must_use]
    pub fn at(&self, raw: f32) -> f32 {
        self.floor.max(self.growth * raw * raw)
    }
}

/// Pixels of the block at `at` whose measurement touches `sphere` (bit `8·row + column`), in the
/// decoder's own arithmetic ([`Sphere::inverse_depth`]).
#[inline(always)]
#[must_use]
pub fn contacts(
    plane: &[u16],
    rays: &Rays,
    at: (usize, usize),
    sphere: &Sphere,
    reach: &Reach,
) -> u64 {
    let stride = rays.stride();
    let (x0, y0) = (at.0 * BLOCK, at.1 * BLOCK);
    let Some(u) = rays.u[x0..].first_chunk::<BLOCK>() else {
        return 0;
    };
    let mut bits = 0u64;
    let (a4, side) = (4.0 * sphere.a, if sphere.far { -1.0 } else { 1.0 });
    for j in 0..BLOCK {
        let Some(row) = plane[(y0 + j) * stride + x0..].first_chunk::<BLOCK>() else {
            return 0;
        };
        let v = rays.v[y0 + j];
        let mut on = [0u8; BLOCK];
        for i in 0..BLOCK {
            let raw = f32::from(row[i]);
            let q = u[i] * u[i] + v * v + 1.0;
            let l = sphere.m.x * u[i] + sphere.m.y * v + sphere.m.z;
            let w = 0.5 * (l + side * (l * l + a4 * q).sqrt());
            on[i] = u8::from(reach.touches(raw, rays.per_metre / w, q) & (raw > 0.0) & (w > 0.0));
        }
        // gather one bit of each byte
        let packed = u64::from_le_bytes(on).wrapping_mul(0x0102_0408_1020_4080) >> 56;
        bits |= packed << (8 * j);
    }
    bits
}

/// Pixels of a block that hold a measurement (bit `8·row + column`).
#[inline(always)]
#[must_use]
pub fn measured(plane: &[u16], rays: &Rays, at: (usize, usize)) -> u64 {
    let stride = rays.stride();
    let mut bits = 0u64;
    for j in 0..BLOCK {
        let start = (at.1 * BLOCK + j) * stride + at.0 * BLOCK;
        let mut on = [0u8; BLOCK];
        for (o, &raw) in on.iter_mut().zip(&plane[start..start + BLOCK]) {
            *o = u8::from(raw != 0);
        }
        let packed = u64::from_le_bytes(on).wrapping_mul(0x0102_0408_1020_4080) >> 56;
        bits |= packed << (8 * j);
    }
    bits
}
