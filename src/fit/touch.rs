//! Who touches a sphere: the inner loops of both schemes.
//!
//! A point touches a sphere where its distance t has |t| ≤ τ. Along the gradient F = t + κt²/2,
//! so this reads |F − κτ²/2| ≤ τ for |κ|τ < 1: no root per point. All points within `widen`
//! contact distances are found alike.

use super::cloud::CloudSphere;
use glam::Vec3;
use multiversion::multiversion;

/// Points of a block with bounds of its own.
pub(crate) const BLOCK: usize = 64;

/// The sphere in the precision of the inner loops: F = h·|p|² + n·p + d.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Surface {
    pub h: f32,
    pub n: [f32; 3],
    pub d: f32,
}

impl Surface {
    /// The sphere, normalised in double precision.
    pub fn sphere(&self) -> Option<CloudSphere> {
        let normal = Vec3::from_array(self.n).as_dvec3();
        CloudSphere::normalised(2.0 * f64::from(self.h), normal, f64::from(self.d))
    }
}

impl From<&CloudSphere> for Surface {
    fn from(sphere: &CloudSphere) -> Self {
        Self {
            h: (0.5 * sphere.curvature) as f32,
            n: sphere.normal.as_vec3().to_array(),
            d: sphere.offset as f32,
        }
    }
}

/// Arrays of x, y, z and |p|², all of one length.
pub(crate) type Arrays<'a> = [&'a [f32]; 4];

/// F at point `i`.
#[inline(always)]
fn value([x, y, z, q]: &Arrays<'_>, s: &Surface, i: usize) -> f32 {
    (s.h * q[i] + s.n[0] * x[i]) + (s.n[1] * y[i] + s.n[2] * z[i]) + s.d
}

/// F at point `i` less its value at half the contact band: the point touches where this is
/// within `tau` of 0.
#[inline(always)]
fn band(points: &Arrays<'_>, s: &Surface, i: usize, tau: f32) -> f32 {
    value(points, s, i) - s.h * tau * tau
}

/// The same arrays with lengths the compiler knows to be equal.
#[inline(always)]
fn of_length<'a>(points: Arrays<'a>, n: usize) -> Arrays<'a> {
    points.map(|axis| &axis[..n])
}

#[multiversion(targets("x86_64+avx2"))]
pub(crate) fn count(s: &Surface, points: [&[f32]; 4], tau: &[f32]) -> u32 {
    let n = tau.len();
    let points = of_length(points, n);
    let mut touching = 0u32;
    for i in 0..n {
        let touches = band(&points, s, i, tau[i]).abs() <= tau[i];
        touching = touching.wrapping_add(u32::from(touches));
    }
    touching
}

#[multiversion(targets("x86_64+avx2"))]
pub(crate) fn count_constant(s: &Surface, points: [&[f32]; 4], tau: f32) -> u32 {
    let n = points[0].len();
    let points = of_length(points, n);
    let s = Surface {
        d: s.d - s.h * tau * tau,
        ..*s
    };
    let mut touching = 0u32;
    for i in 0..n {
        touching = touching.wrapping_add(u32::from(value(&points, &s, i).abs() <= tau));
    }
    touching
}

/// Marks the points within `widen` contact distances.
#[multiversion(targets("x86_64+avx2"))]
pub(crate) fn mark(s: &Surface, points: [&[f32]; 4], tau: &[f32], widen: f32, marks: &mut [u8]) {
    let n = tau.len();
    let (points, marks) = (of_length(points, n), &mut marks[..n]);
    for i in 0..n {
        let reach = widen * tau[i];
        marks[i] = u8::from(band(&points, s, i, reach).abs() <= reach);
    }
}

#[multiversion(targets("x86_64+avx2"))]
pub(crate) fn mark_constant(s: &Surface, points: [&[f32]; 4], reach: f32, marks: &mut [u8]) {
    let n = points[0].len();
    let (points, marks) = (of_length(points, n), &mut marks[..n]);
    let s = Surface {
        d: s.d - s.h * reach * reach,
        ..*s
    };
    for i in 0..n {
        marks[i] = u8::from(value(&points, &s, i).abs() <= reach);
    }
}

/// Appends the places of the marks that are 1, ascending.
pub(crate) fn list(marks: &[u8], places: &mut Vec<u32>) {
    // most of a cloud does not touch a given sphere: pass over it eight points at a time
    let (eights, rest) = marks.as_chunks::<8>();
    for (chunk, eight) in eights.iter().enumerate() {
        let mut set = u64::from_le_bytes(*eight);
        while set != 0 {
            places.push(chunk as u32 * 8 + set.trailing_zeros() / 8);
            set &= set - 1;
        }
    }
    let first = (marks.len() - rest.len()) as u32;
    let touching = (first..).zip(rest).filter(|&(_, &m)| m != 0);
    places.extend(touching.map(|(place, _)| place));
}

/// Balls around blocks of points: what they hold lies within `radius` of the centre.
#[derive(Clone, Debug, Default)]
pub(crate) struct Bounds {
    x: Vec<f32>,
    y: Vec<f32>,
    z: Vec<f32>,
    /// |centre|².
    q: Vec<f32>,
    radius: Vec<f32>,
    /// Largest contact distance of the block's points.
    tau: Vec<f32>,
}

impl Bounds {
    /// Of each [`BLOCK`] of the points; `tau` is empty where all have `constant_tau`.
    pub fn refill(&mut self, [x, y, z, _]: Arrays<'_>, tau: &[f32], constant_tau: f32) {
        for list in self.lists_mut() {
            list.clear();
        }
        let blocks = x.chunks(BLOCK).zip(y.chunks(BLOCK)).zip(z.chunks(BLOCK));
        for (block, ((x, y), z)) in blocks.enumerate() {
            let middle = |axis: &[f32]| {
                let ends = axis.iter().fold((f32::MAX, f32::MIN), |(low, high), &v| {
                    (low.min(v), high.max(v))
                });
                0.5 * (ends.0 + ends.1)
            };
            let (cx, cy, cz) = (middle(x), middle(y), middle(z));
            let square = |i: usize| (x[i] - cx).powi(2) + (y[i] - cy).powi(2) + (z[i] - cz).powi(2);
            let far2 = (0..x.len()).map(square).fold(0f32, f32::max);
            self.x.push(cx);
            self.y.push(cy);
            self.z.push(cz);
            self.q.push(cx * cx + cy * cy + cz * cz);
            self.radius.push(far2.sqrt());
            let own = tau.iter().skip(block * BLOCK).take(x.len());
            self.tau.push(
                own.copied()
                    .fold(if tau.is_empty() { constant_tau } else { 0.0 }, f32::max),
            );
        }
    }

    fn lists_mut(&mut self) -> [&mut Vec<f32>; 6] {
        [
            &mut self.x,
            &mut self.y,
            &mut self.z,
            &mut self.q,
            &mut self.radius,
            &mut self.tau,
        ]
    }
}

/// Appends the points within `widen` contact distances of the sphere to `near`, block by block.
/// `tau` is empty where all points have `constant_tau`; the bounds are those of the points.
///
/// Within e of the surface |F| = |t + κt²/2| ≤ e + |κ|e²/2, so a block whose centre has more,
/// with e its radius and the reach, holds no such point. Half a contact distance is added for
/// rounding.
#[multiversion(targets("x86_64+avx2"))]
pub(crate) fn list_near(
    s: &Surface,
    points: [&[f32]; 4],
    (tau, constant_tau): (&[f32], f32),
    widen: f32,
    bounds: &Bounds,
    near: &mut Vec<(u32, u64)>,
) {
    let blocks = bounds.x.len();
    let centers = of_length([&bounds.x, &bounds.y, &bounds.z, &bounds.q], blocks);
    let (radius, widest) = (&bounds.radius[..blocks], &bounds.tau[..blocks]);
    let reach = widen * constant_tau;
    let constant = Surface {
        d: s.d - s.h * reach * reach,
        ..*s
    };
    for first in (0..blocks).step_by(BLOCK) {
        let n = BLOCK.min(blocks - first);
        let chunk = of_length(centers.map(|axis| &axis[first..first + n]), n);
        let (radius, widest) = (&radius[first..first + n], &widest[first..first + n]);
        let mut marks = [0u8; BLOCK];
        for (i, mark) in marks[..n].iter_mut().enumerate() {
            let e = radius[i] + (widen + 0.5) * widest[i];
            *mark = u8::from(value(&chunk, s, i).abs() <= e + s.h.abs() * e * e);
        }
        let mut blocks = packed(&marks);
        while blocks != 0 {
            let b = first + blocks.trailing_zeros() as usize;
            blocks &= blocks - 1;
            let from = b * BLOCK;
            let n = BLOCK.min(points[0].len() - from);
            let block = points.map(|axis| &axis[from..from + n]);
            let bits = if !tau.is_empty() {
                touching_each(s, block, &tau[from..from + n], widen)
            } else if n == BLOCK {
                touching(&constant, of_length(block, BLOCK), reach)
            } else {
                touching(&constant, block, reach)
            };
            if bits != 0 {
                near.push((b as u32, bits));
            }
        }
    }
}

/// The points of one block within `reach`; `s` is shifted by half the band.
#[inline(always)]
fn touching(s: &Surface, block: Arrays<'_>, reach: f32) -> u64 {
    let mut marks = [0u8; BLOCK];
    let n = block[0].len();
    let block = of_length(block, n);
    for (i, mark) in marks[..n].iter_mut().enumerate() {
        *mark = u8::from(value(&block, s, i).abs() <= reach);
    }
    packed(&marks)
}

/// The points of one block within `widen` of their own contact distances.
#[inline(always)]
fn touching_each(s: &Surface, block: Arrays<'_>, tau: &[f32], widen: f32) -> u64 {
    let mut marks = [0u8; BLOCK];
    let block = of_length(block, tau.len());
    for (i, mark) in marks[..tau.len()].iter_mut().enumerate() {
        let reach = widen * tau[i];
        *mark = u8::from(band(&block, s, i, reach).abs() <= reach);
    }
    packed(&marks)
}

/// Gives the points of these blocks that are nearer to the surface than `nearest` to `owner`
/// `number`.
#[multiversion(targets("x86_64+avx2"))]
pub(crate) fn offer(
    s: &Surface,
    number: u32,
    points: [&[f32]; 4],
    blocks: &[(u32, u64)],
    (nearest, owner): (&mut [f32], &mut [u32]),
) {
    for &(block, bits) in blocks {
        let from = block as usize * BLOCK;
        let n = BLOCK.min(points[0].len() - from);
        let block = of_length(points.map(|axis| &axis[from..from + n]), n);
        let (nearest, owner) = (&mut nearest[from..from + n], &mut owner[from..from + n]);
        for i in 0..n {
            let distance = value(&block, s, i).abs();
            let nearer = bits >> i & 1 != 0 && distance < nearest[i];
            nearest[i] = if nearer { distance } else { nearest[i] };
            owner[i] = if nearer { number } else { owner[i] };
        }
    }
}

/// The marks, each 0 or 1, as bits.
#[inline(always)]
fn packed(marks: &[u8; BLOCK]) -> u64 {
    let (eights, _) = marks.as_chunks::<8>();
    let mut bits = 0;
    for (k, eight) in eights.iter().enumerate() {
        // byte i to bit 56 + i
        let gathered = u64::from_le_bytes(*eight).wrapping_mul(0x0102_0408_1020_4080) >> 56;
        bits |= gathered << (8 * k);
    }
    bits
}
