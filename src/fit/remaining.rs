//! The points no sphere explains yet, and who of them touches a given sphere: the inner loops of
//! both schemes.

use super::cloud::CloudSphere;
use super::contact_distance::ContactDistance;
use super::point_moments::PointMoments;
use crate::partition::points::LocalPoints;
use glam::DVec3;
use multiversion::multiversion;

/// Points still to be explained, one array per coordinate.
///
/// A point touches a sphere where its distance t has |t| ≤ τ. Along the gradient
/// F = t + κt²/2, so this reads |F − κτ²/2| ≤ τ for |κ|τ < 1: no root per point.
#[derive(Clone, Debug, Default)]
pub(crate) struct Remaining {
    x: Vec<f32>,
    y: Vec<f32>,
    z: Vec<f32>,
    /// Contact distance of each point, metres.
    tau: Vec<f32>,
    /// Number of each point in the cloud.
    pub id: Vec<u32>,
    /// Curvature above which single precision no longer resolves the contact distance, 1/m.
    curvature_limit: f64,
    /// Scratch of [`Remaining::remove`].
    marks: Vec<u8>,
}

/// The sphere in the precision of the inner loops: F = h·|p|² + n·p + d.
#[derive(Clone, Copy)]
struct Surface {
    h: f32,
    n: [f32; 3],
    d: f32,
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

/// F at a point less its value at half the contact band: the point touches where this is within
/// `tau` of 0.
#[inline(always)]
fn band(s: &Surface, x: f32, y: f32, z: f32, tau: f32) -> f32 {
    s.h * (x * x + y * y + z * z - tau * tau) + (s.n[0] * x + s.n[1] * y + s.n[2] * z + s.d)
}

#[multiversion(targets("x86_64+avx2"))]
fn count(s: &Surface, x: &[f32], y: &[f32], z: &[f32], tau: &[f32]) -> u32 {
    let n = x.len();
    let (y, z, tau) = (&y[..n], &z[..n], &tau[..n]);
    let mut touching = 0u32;
    for i in 0..n {
        let touches = band(s, x[i], y[i], z[i], tau[i]).abs() <= tau[i];
        touching = touching.wrapping_add(u32::from(touches));
    }
    touching
}

#[multiversion(targets("x86_64+avx2"))]
fn mark(s: &Surface, x: &[f32], y: &[f32], z: &[f32], tau: &[f32], marks: &mut [u8]) {
    let n = x.len();
    let (y, z, tau, marks) = (&y[..n], &z[..n], &tau[..n], &mut marks[..n]);
    for i in 0..n {
        marks[i] = u8::from(band(s, x[i], y[i], z[i], tau[i]).abs() <= tau[i]);
    }
}

impl Remaining {
    /// Empties the set, keeping its memory.
    pub fn clear(&mut self) {
        for axis in [&mut self.x, &mut self.y, &mut self.z, &mut self.tau] {
            axis.clear();
        }
        self.id.clear();
    }

    /// Takes in the points `ids` of the cloud. `shift` moves the zero (metres about the cloud's
    /// origin) nearer to them.
    pub fn fill(
        &mut self,
        points: &LocalPoints,
        ids: impl Iterator<Item = u32>,
        shift: DVec3,
        contact: &ContactDistance,
    ) {
        self.clear();
        for id in ids {
            let p = points.at(id as usize).as_dvec3();
            let local = p - shift;
            self.x.push(local.x as f32);
            self.y.push(local.y as f32);
            self.z.push(local.z as f32);
            self.tau.push(contact.at(p.z + points.origin.z) as f32);
            self.id.push(id);
        }
        // (κ/2)|p|² is rounded to 2⁻²⁴ of itself: hold that below a sixteenth of τ. The band
        // test needs |κ|τ < 1 besides.
        let mut far2 = 0f32;
        let (mut least, mut most) = (f32::MAX, 0f32);
        for i in 0..self.len() {
            far2 = far2.max(self.x[i] * self.x[i] + self.y[i] * self.y[i] + self.z[i] * self.z[i]);
            least = least.min(self.tau[i]);
            most = most.max(self.tau[i]);
        }
        let by_rounding = f64::from(least) * f64::from(1 << 20) / f64::from(far2).max(1e-30);
        self.curvature_limit = by_rounding.min(0.5 / f64::from(most).max(1e-30));
    }

    /// True where the sphere's contacts can be told in single precision.
    pub fn resolves(&self, sphere: &CloudSphere) -> bool {
        sphere.curvature.abs() <= self.curvature_limit
    }

    /// Every `stride`-th point of `from`.
    pub fn sample(&mut self, from: &Self, stride: usize) {
        self.clear();
        self.curvature_limit = from.curvature_limit;
        let stride = stride.max(1);
        self.x.extend(from.x.iter().step_by(stride));
        self.y.extend(from.y.iter().step_by(stride));
        self.z.extend(from.z.iter().step_by(stride));
        self.tau.extend(from.tau.iter().step_by(stride));
        self.id.extend(from.id.iter().step_by(stride));
    }

    pub fn len(&self) -> usize {
        self.id.len()
    }

    pub fn at(&self, i: usize) -> DVec3 {
        DVec3::new(
            f64::from(self.x[i]),
            f64::from(self.y[i]),
            f64::from(self.z[i]),
        )
    }

    pub fn tau(&self, i: usize) -> f32 {
        self.tau[i]
    }

    /// Points that touch the sphere.
    pub fn touching(&self, sphere: &CloudSphere) -> usize {
        count(&sphere.into(), &self.x, &self.y, &self.z, &self.tau) as usize
    }

    /// Appends the places of the points that touch the sphere to `places`, ascending.
    pub fn list_touching(&self, sphere: &CloudSphere, marks: &mut Vec<u8>, places: &mut Vec<u32>) {
        marks.resize(self.len(), 0);
        mark(&sphere.into(), &self.x, &self.y, &self.z, &self.tau, marks);
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

    /// Moments of the points within `widen` contact distances of the sphere.
    pub fn moments(&self, sphere: &CloudSphere, widen: f32) -> PointMoments {
        let s = Surface::from(sphere);
        let mut sums = PointMoments::default();
        for i in 0..self.len() {
            let tau = widen * self.tau[i];
            if band(&s, self.x[i], self.y[i], self.z[i], tau).abs() <= tau {
                sums.add(self.at(i));
            }
        }
        sums
    }

    /// Takes the points that touch the sphere out; says how many. The rest keep their order.
    pub fn remove(&mut self, sphere: &CloudSphere) -> usize {
        let before = self.len();
        let mut marks = std::mem::take(&mut self.marks);
        marks.resize(before, 0);
        let (x, y, z, tau) = (&self.x, &self.y, &self.z, &self.tau);
        mark(&sphere.into(), x, y, z, tau, &mut marks);
        for axis in [&mut self.x, &mut self.y, &mut self.z, &mut self.tau] {
            keep_unmarked(axis, &marks);
        }
        keep_unmarked(&mut self.id, &marks);
        self.marks = marks;
        before - self.len()
    }
}

/// Keeps the values whose mark is 0, in order. No branch on the marks: they are noise to it.
fn keep_unmarked<T: Copy>(values: &mut Vec<T>, marks: &[u8]) {
    let mut kept = 0;
    for (i, &mark) in marks.iter().enumerate() {
        values[kept] = values[i];
        kept += usize::from(mark == 0);
    }
    values.truncate(kept);
}
