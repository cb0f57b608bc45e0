//! Contact: does a pixel's measurement touch a sphere?
//!
//! Two distances answer that. The model gives a pixel to a sphere by the distance of its point to
//! the surface ([`Contact`], the paper's). The payload promises an error along the ray
//! ([`Reach`]), which is longer where a surface is seen at a slant; pixels between the two belong
//! to their sphere and get a residual.

use crate::deproject::{BLOCK, Rays};
use crate::fit::contact_distance::ContactDistance;
use crate::fit::sphere::Sphere;

/// Relative error of a depth rebuilt in single precision, a few roundings.
const ROUNDING: f32 = 4e-7;

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

    /// The largest distance along the ray, in depth integers, at which `raw` still touches.
    #[inline(always)]
    #[must_use]
    pub fn at(&self, raw: f32) -> f32 {
        self.floor.max(self.growth * raw * raw)
    }
}

/// Which pixels of a block touch a sphere (bit `8·row + column`).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Touch {
    /// Points whose distance to the surface is within reach: the paper's contact.
    pub touching: u64,
    /// Points whose distance along the ray is within a share of it: these need no residual.
    pub along_ray: u64,
}

/// A point touches only where its ray meets the surface within so many contact distances: at a
/// grazing angle the nearest point of a sphere says nothing of what the pixel sees.
const BEYOND: f32 = 4.0;

/// The contact of the paper (4.1): a point touches a sphere where its distance to the surface is at
/// most the contact distance, `| |p − c| − r | ≤ τ(z)`. Metres.
///
/// With `F = a·|p|² + m·p − 1` and `G² = |m|² + 4a` the distance is d where `F = ±G·d + a·d²`, so
/// the test is `|F − a·τ²| ≤ G·τ`. Along the ray F is a parabola in the distance, too, with the
/// slope `F′ = (2a·q·z + l)/√q`: the surface is within τ where `|F + a·τ²| ≤ F′·τ`. Both are
/// exact, without a root or a division.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Contact {
    floor: f32,
    per_z2: f32,
    along_ray: f32,
}

impl Contact {
    /// Contact within `distance`, and within the share `along_ray` of it along the ray.
    #[must_use]
    pub fn new(distance: &ContactDistance, along_ray: f64) -> Self {
        Self {
            floor: distance.floor_m as f32,
            per_z2: distance.per_z2 as f32,
            along_ray: along_ray as f32,
        }
    }

    /// True where every measurement of the block is for certain within reach along the ray. The reach
    /// is that of the nearest one of a column on the longest ray, so a block at the very limit may be
    /// refused.
    ///
    /// With z in depth integers `F = (a·q·z + l)·z − 1`, and the surface is within ±δ of z where
    /// `|F + a·q·δ²| ≤ F′·δ`. `FULL` where all pixels are measured.
    #[inline(always)]
    #[must_use]
    pub fn all_along_ray<const FULL: bool>(
        &self,
        plane: &[u16],
        rays: &Rays,
        at: (usize, usize),
        sphere: &Sphere,
    ) -> bool {
        let Some(patch) = Patch::new(plane, rays, at) else {
            return false;
        };
        let (unit, u, v) = (patch.unit, patch.u, patch.v);
        let most = |x: &[f32; BLOCK]| (x[0] * x[0]).max(x[BLOCK - 1] * x[BLOCK - 1]);
        let q = most(u) + most(v) + 1.0;
        let share = CERTAIN * self.along_ray / (unit * q.sqrt());
        let (floor, per_z2) = (share * self.floor, share * self.per_z2 * unit * unit);
        let (a, m) = (sphere.a * unit * unit, sphere.m * unit);
        // what depends on the column or the row alone
        let (mut square, mut step) = ([0f32; BLOCK], [0f32; BLOCK]);
        let (mut auu, mut mu) = ([0f32; BLOCK], [0f32; BLOCK]);
        let (mut avv, mut mv) = ([0f32; BLOCK], [0f32; BLOCK]);
        let Some(nearest) = patch.nearest() else {
            return false;
        };
        for i in 0..BLOCK {
            let grown = per_z2 * (nearest[i] * nearest[i]);
            let within = if grown > floor { grown } else { floor };
            square[i] = within * within;
            step[i] = if sphere.far { -within } else { within };
            (auu[i], mu[i]) = (a * (u[i] * u[i]), m.x * u[i]);
            (avv[i], mv[i]) = (a * (v[i] * v[i]) + a, m.y * v[i] + m.z);
        }
        let mut off = [f32::MIN; BLOCK];
        for j in 0..BLOCK {
            let Some(raw) = patch.row(j) else {
                return false;
            };
            for i in 0..BLOCK {
                let z = f32::from(raw[i]);
                let (aq, l) = (auu[i] + avv[j], mu[i] + mv[j]);
                let aqz = aq * z;
                let slope = aqz + l;
                let value = (slope * z - 1.0) + aq * square[i];
                let beyond = value.abs() - step[i] * (slope + aqz);
                let beyond = if FULL || raw[i] != 0 { beyond } else { -1.0 };
                off[i] = if off[i] > beyond { off[i] } else { beyond };
            }
        }
        off.iter().all(|&off| off <= -ROUNDED)
    }

    /// Pixels of the block at `at` whose measurement touches `sphere` on the side the camera sees.
    /// Pixels without a measurement may be among them.
    #[inline(always)]
    #[must_use]
    pub fn pixels(&self, plane: &[u16], rays: &Rays, at: (usize, usize), sphere: &Sphere) -> Touch {
        let Some(patch) = Patch::new(plane, rays, at) else {
            return Touch::default();
        };
        let Some(rows) = patch.block() else {
            return Touch::default();
        };
        let test = Test::new(self, &patch, sphere);
        // columns of bits: bit j of lane i is row j, column i
        let (mut near, mut along) = ([0u32; BLOCK], [0u32; BLOCK]);
        for j in (0..BLOCK).rev() {
            let raw = rows[j];
            let (mv, vv) = (test.mv[j], test.vv[j]);
            for i in 0..BLOCK {
                let point = test.point(raw[i], i, mv, vv);
                along[i] = (along[i] + along[i]) | u32::from(test.along_ray(&point));
                near[i] = (near[i] + near[i]) | u32::from(test.near(&point));
            }
        }
        Touch {
            touching: transposed(near),
            along_ray: transposed(along),
        }
    }
}

/// Share of the reach that leaves room for rounding in [`Contact::all_along_ray`].
const CERTAIN: f32 = 0.995;
/// Rounding of F, which is of the order of 1.
const ROUNDED: f32 = 1e-6;

/// Rays and depth integers of a block.
struct Patch<'a> {
    u: &'a [f32; BLOCK],
    v: &'a [f32; BLOCK],
    rows: &'a [u16],
    stride: usize,
    unit: f32,
}

impl<'a> Patch<'a> {
    #[inline(always)]
    fn new(plane: &'a [u16], rays: &'a Rays, at: (usize, usize)) -> Option<Self> {
        let stride = rays.stride();
        let (x0, y0) = (at.0 * BLOCK, at.1 * BLOCK);
        let first = y0 * stride + x0;
        Some(Self {
            u: rays.u.get(x0..)?.first_chunk()?,
            v: rays.v.get(y0..)?.first_chunk()?,
            rows: plane.get(first..first + (BLOCK - 1) * stride + BLOCK)?,
            stride,
            unit: rays.unit,
        })
    }

    #[inline(always)]
    fn row(&self, j: usize) -> Option<&[u16; BLOCK]> {
        self.rows.get(j * self.stride..)?.first_chunk()
    }

    /// All rows.
    #[inline(always)]
    fn block(&self) -> Option<[&[u16; BLOCK]; BLOCK]> {
        let mut rows = [&[0; BLOCK]; BLOCK];
        for (j, row) in rows.iter_mut().enumerate() {
            *row = self.row(j)?;
        }
        Some(rows)
    }

    /// The smallest measured depth integer of each column; the largest there is where there is none.
    #[inline(always)]
    fn nearest(&self) -> Option<[f32; BLOCK]> {
        // less one, so that what is not measured counts as farthest
        let mut least = [u16::MAX; BLOCK];
        for j in 0..BLOCK {
            let row = self.row(j)?;
            for i in 0..BLOCK {
                least[i] = least[i].min(row[i].wrapping_sub(1));
            }
        }
        let mut nearest = [0f32; BLOCK];
        for i in 0..BLOCK {
            nearest[i] = f32::from(least[i]) + 1.0;
        }
        Some(nearest)
    }
}

/// One sphere against the pixels of one block: what does not change from pixel to pixel.
struct Test {
    floor: f32,
    per_z2: f32,
    share: f32,
    unit: f32,
    uu: [f32; BLOCK],
    mu: [f32; BLOCK],
    vv: [f32; BLOCK],
    mv: [f32; BLOCK],
    mz: f32,
    a: f32,
    side: f32,
    slope: f32,
}

/// One pixel in that test.
struct Point {
    /// Squared length of the ray.
    q: f32,
    /// F at the point.
    value: f32,
    /// Slope of F along the ray, times its length and the contact distance.
    within: f32,
    /// The contact distance, and its square.
    reach: f32,
    squared: f32,
    /// The ray meets the sphere.
    meets: bool,
}

impl Test {
    #[inline(always)]
    fn new(contact: &Contact, patch: &Patch<'_>, sphere: &Sphere) -> Self {
        let (a, m) = (sphere.a, sphere.m);
        let (mut uu, mut mu) = ([0f32; BLOCK], [0f32; BLOCK]);
        let (mut vv, mut mv) = ([0f32; BLOCK], [0f32; BLOCK]);
        for i in 0..BLOCK {
            (uu[i], mu[i]) = (patch.u[i] * patch.u[i], m.x * patch.u[i]);
            (vv[i], mv[i]) = (patch.v[i] * patch.v[i], m.y * patch.v[i]);
        }
        Self {
            floor: contact.floor,
            per_z2: contact.per_z2,
            share: contact.along_ray,
            unit: patch.unit,
            uu,
            mu,
            vv,
            mv,
            mz: m.z,
            a,
            side: if sphere.far { -1.0 } else { 1.0 },
            slope: (m.length_squared() + 4.0 * a).max(0.0).sqrt(),
        }
    }

    #[inline(always)]
    fn point(&self, raw: u16, i: usize, mv: f32, vv: f32) -> Point {
        let z = f32::from(raw) * self.unit;
        // the decoder's arithmetic: whether the ray meets the sphere must not differ
        let (q, l) = (self.uu[i] + vv + 1.0, self.mu[i] + mv + self.mz);
        let aq = self.a * q;
        let meets = l * l + 4.0 * aq >= 0.0;
        let grown = self.per_z2 * (z * z);
        let reach = if grown > self.floor {
            grown
        } else {
            self.floor
        };
        let aqz = aq * z;
        let slope = aqz + l;
        Point {
            q,
            value: slope * z - 1.0,
            within: (slope + aqz) * reach,
            reach,
            squared: reach * reach,
            meets,
        }
    }

    /// `|F + a·τ²|·√q ≤ τ·F′` for a `share` of τ, squared with the sign kept: it cannot hold where
    /// the slope `F′` is negative (the other side).
    #[inline(always)]
    fn within(&self, p: &Point, share: f32) -> bool {
        let value = p.value + self.a * share * share * p.squared;
        value * value * p.q <= self.side * share * share * (p.within * p.within.abs())
    }

    #[inline(always)]
    fn along_ray(&self, p: &Point) -> bool {
        self.within(p, self.share) & p.meets
    }

    #[inline(always)]
    fn near(&self, p: &Point) -> bool {
        let close = (p.value - self.a * p.squared).abs() <= self.slope * p.reach;
        close & self.within(p, BEYOND) & p.meets
    }
}

/// Columns of bits (the low eight of each lane) as rows: bit `8·row + column`.
#[inline(always)]
fn transposed(columns: [u32; BLOCK]) -> u64 {
    let mut bytes = [0; BLOCK];
    for (byte, column) in bytes.iter_mut().zip(columns) {
        *byte = column as u8;
    }
    let mut x = u64::from_le_bytes(bytes);
    // swaps 1×1, then 2×2, then 4×4 squares across the diagonal
    for (step, mask) in [
        (7, 0x00AA_00AA_00AA_00AA),
        (14, 0x0000_CCCC_0000_CCCC),
        (28, 0x0000_0000_F0F0_F0F0),
    ] {
        let t = (x ^ (x >> step)) & mask;
        x ^= t ^ (t << step);
    }
    x
}

/// Pixels of a block that hold a measurement (bit `8·row + column`).
#[inline(always)]
#[must_use]
pub fn measured(plane: &[u16], rays: &Rays, at: (usize, usize)) -> u64 {
    let stride = rays.stride();
    let first = at.1 * BLOCK * stride + at.0 * BLOCK;
    let Some(rows) = plane.get(first..first + (BLOCK - 1) * stride + BLOCK) else {
        return 0;
    };
    // most blocks are full
    let mut least = [u16::MAX; BLOCK];
    for j in 0..BLOCK {
        if let Some(row) = rows[j * stride..].first_chunk::<BLOCK>() {
            for i in 0..BLOCK {
                least[i] = least[i].min(row[i]);
            }
        }
    }
    if least.iter().all(|&raw| raw != 0) {
        return u64::MAX;
    }
    let mut on = [0u32; BLOCK];
    for j in 0..BLOCK {
        if let Some(row) = rows[j * stride..].first_chunk::<BLOCK>() {
            for i in 0..BLOCK {
                on[i] |= u32::from(row[i] != 0) << j;
            }
        }
    }
    transposed(on)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::{Camera, Intrinsics};
    use glam::DVec3;
    use proptest::prelude::*;

    fn rays() -> Rays {
        Rays::new(&Camera {
            width: 64,
            height: 64,
            intrinsics: Intrinsics {
                fx: 60.0,
                fy: 62.0,
                cx: 31.0,
                cy: 32.5,
            },
            depth_unit_m: 0.001,
            invalid: vec![],
            depth_min_m: 0.0,
            depth_max_m: 65.0,
            fps: None,
            name: String::new(),
        })
    }

    proptest! {
        #[test]
        fn columns_become_rows(bits in any::<u64>()) {
            let column = |i: usize| (0..8).fold(0, |c, j| c | ((bits >> (8 * j + i) & 1) as u32) << j);
            prop_assert_eq!(transposed(std::array::from_fn(column)), bits);
        }

        /// Against the distance to centre and radius in double precision.
        #[test]
        fn contact_is_the_distance_to_the_surface(
            (x, y) in (-0.4f64..0.4, -0.4f64..0.4), z in 0.5f64..6.0,
            radius in prop_oneof![0.05f64..0.4, 1f64..9e3, Just(9e9)], hollow in any::<bool>(),
            floor_m in 0.002f64..0.02, per_z2 in 0f64..5e-3, share in 0.3f64..1.0, seed in any::<u64>(),
        ) {
            let rays = rays();
            let radius = if hollow { radius + 7.5 } else { radius.min(0.9 * z + if radius > 1.0 { radius } else { 0.0 }) };
            // around the camera, or a ball before it
            let front = DVec3::new(x, y, 1.0) * z;
            let center = if hollow { front - front.normalize() * radius } else { front + front.normalize() * radius };
            let Some(sphere) = Sphere::from_center_radius(center, radius) else { return Ok(()) };
            let distance = ContactDistance { floor_m, per_z2 };
            let at = (((x + 0.5) * 7.9) as usize, ((y + 0.5) * 7.9) as usize);
            // measurements near the surface, some holes
            let mut random = seed | 1;
            let mut next = || { random ^= random << 13; random ^= random >> 7; random ^= random << 17; (random >> 40) as f64 / (1u64 << 24) as f64 };
            let plane: Vec<u16> = (0..rays.padded()).map(|k| {
                let (u, v) = (rays.u[k % 64], rays.v[k / 64]);
                let w = sphere.inverse_depth(u, v, u * u + v * v + 1.0);
                if next() < 0.1 || w.is_nan() || w <= 0.0 { 0 } else { ((1.0 / f64::from(w) + (next() - 0.5) * 0.1) * 1e3).clamp(0.0, 65535.0) as u16 }
            }).collect();
            let measured = measured(&plane, &rays, at);
            let contact = Contact::new(&distance, share);
            let mut found = contact.pixels(&plane, &rays, at, &sphere);
            found.touching &= measured;
            found.along_ray &= measured;
            let all = match measured {
                u64::MAX => contact.all_along_ray::<true>(&plane, &rays, at, &sphere),
                _ => contact.all_along_ray::<false>(&plane, &rays, at, &sphere),
            };
            // far inside the reach of the nearest point: that must be seen
            let mut inside = true;
            for bit in 0..64 {
                let (px, py) = (at.0 * 8 + bit % 8, at.1 * 8 + bit / 8);
                let raw = plane[py * 64 + px];
                if raw == 0 {
                    prop_assert_eq!((found.touching | found.along_ray) >> bit & 1, 0);
                    continue;
                }
                let z = f64::from(raw) * 1e-3;
                let p = rays.point(px, py, z);
                // single precision keeps the sphere itself to parts in ten million
                let slack = 4e-6 * (1.0 + p.length_squared());
                let d = sphere.distance(p);
                let l = f64::from(sphere.m.x * rays.u[px] + sphere.m.y * rays.v[py] + sphere.m.z);
                let (u, v) = (rays.u[px], rays.v[py]);
                let q = u * u + v * v + 1.0;
                let off = (1.0 / f64::from(sphere.inverse_depth(u, v, q)) - z).abs() * f64::from(q).sqrt();
                let nearest = (0..64).map(|k| plane[(at.1 * 8 + k / 8) * 64 + at.0 * 8 + k % 8]).filter(|&raw| raw != 0).min();
                inside &= off <= 0.8 * share * distance.at(f64::from(nearest.unwrap_or(0)) * 1e-3);
                if all {
                    prop_assert!(off <= share * distance.at(z) + 2.0 * slack, "{} m off along the ray of {}", off, distance.at(z));
                }
                // near the outline of a ball both intersections may be in reach: not counted
                let clear = f64::from(2.0 * sphere.a * q) * z + l;
                inside &= clear.abs() > 0.5 * l.abs();
                if (d - distance.at(z)).abs() > slack && off < 3.0 * distance.at(z) && clear.abs() > 0.2 * l.abs() {
                    let touches = d <= distance.at(z);
                    prop_assert_eq!(found.touching >> bit & 1 != 0, touches, "{} m off of {}", d, distance.at(z));
                }
                if (off - share * distance.at(z)).abs() > 1e-3 * off + 2.0 * slack && clear.abs() > 0.2 * l.abs() {
                    prop_assert_eq!(found.along_ray >> bit & 1 != 0, off <= share * distance.at(z), "{} m off along the ray of {}", off, distance.at(z));
                }
            }
            prop_assert!(all || !inside);
        }
    }
}
