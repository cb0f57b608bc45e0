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
    /// |p|², square metres.
    q: Vec<f32>,
    /// Contact distance of each point, metres; empty where all have `constant_tau`.
    tau: Vec<f32>,
    constant_tau: f32,
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

/// Arrays of x, y, z and |p|², all of one length.
type Arrays<'a> = [&'a [f32]; 4];

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
fn count(s: &Surface, points: [&[f32]; 4], tau: &[f32]) -> u32 {
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
fn count_constant(s: &Surface, points: [&[f32]; 4], tau: f32) -> u32 {
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
fn mark(s: &Surface, points: [&[f32]; 4], tau: &[f32], widen: f32, marks: &mut [u8]) {
    let n = tau.len();
    let (points, marks) = (of_length(points, n), &mut marks[..n]);
    for i in 0..n {
        let reach = widen * tau[i];
        marks[i] = u8::from(band(&points, s, i, reach).abs() <= reach);
    }
}

#[multiversion(targets("x86_64+avx2"))]
fn mark_constant(s: &Surface, points: [&[f32]; 4], reach: f32, marks: &mut [u8]) {
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

impl Remaining {
    /// Empties the set, keeping its memory.
    pub fn clear(&mut self) {
        for axis in self.axes_mut() {
            axis.clear();
        }
        self.id.clear();
    }

    fn axes_mut(&mut self) -> [&mut Vec<f32>; 5] {
        [
            &mut self.x,
            &mut self.y,
            &mut self.z,
            &mut self.q,
            &mut self.tau,
        ]
    }

    fn axes(&self) -> [&Vec<f32>; 5] {
        [&self.x, &self.y, &self.z, &self.q, &self.tau]
    }

    fn arrays(&self) -> Arrays<'_> {
        [&self.x, &self.y, &self.z, &self.q]
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
        let constant = contact.is_constant();
        self.constant_tau = contact.floor_m as f32;
        let (mut far2, mut least, mut most) = (0f32, f32::MAX, 0f32);
        if constant {
            (least, most) = (self.constant_tau, self.constant_tau);
        }
        for id in ids {
            let p = points.at(id as usize).as_dvec3();
            let local = (p - shift).as_vec3();
            let q = local.length_squared();
            far2 = far2.max(q);
            self.x.push(local.x);
            self.y.push(local.y);
            self.z.push(local.z);
            self.q.push(q);
            if !constant {
                let tau = contact.at(p.z + points.origin.z) as f32;
                least = least.min(tau);
                most = most.max(tau);
                self.tau.push(tau);
            }
            self.id.push(id);
        }
        // (κ/2)|p|² is rounded to 2⁻²⁴ of itself: hold that below a sixteenth of τ. The band
        // test needs |κ|τ < 1 besides.
        let by_rounding = f64::from(least) * f64::from(1 << 20) / f64::from(far2).max(1e-30);
        self.curvature_limit = by_rounding.min(0.5 / f64::from(most).max(1e-30));
    }

    /// True where the sphere's contacts can be told in single precision.
    pub fn resolves(&self, sphere: &CloudSphere) -> bool {
        sphere.curvature.abs() <= self.curvature_limit
    }

    /// Becomes the points of `from` in the given places.
    fn gather(&mut self, from: &Self, places: impl Iterator<Item = usize> + Clone) {
        self.clear();
        self.curvature_limit = from.curvature_limit;
        self.constant_tau = from.constant_tau;
        for (mine, theirs) in self.axes_mut().into_iter().zip(from.axes()) {
            if !theirs.is_empty() {
                mine.extend(places.clone().map(|i| theirs[i]));
            }
        }
        self.id.extend(places.map(|i| from.id[i]));
    }

    /// Every `stride`-th point of `from`.
    pub fn sample(&mut self, from: &Self, stride: usize) {
        self.gather(from, (0..from.len()).step_by(stride.max(1)));
    }

    /// The points of `from` in these places.
    pub fn pick(&mut self, from: &Self, places: &[u32]) {
        self.gather(from, places.iter().map(|&i| i as usize));
    }

    /// The points of `from` within `widen` contact distances of the sphere, evenly thinned to
    /// about `limit` of them. `places` is scratch.
    pub fn near(
        &mut self,
        from: &Self,
        sphere: &CloudSphere,
        widen: f32,
        limit: usize,
        places: &mut Vec<u32>,
    ) {
        places.clear();
        let mut marks = std::mem::take(&mut self.marks);
        from.mark(sphere, widen, &mut marks);
        list(&marks, places);
        self.marks = marks;
        let stride = places.len().div_ceil(limit).max(1);
        self.gather(from, places.iter().step_by(stride).map(|&i| i as usize));
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
        self.tau.get(i).copied().unwrap_or(self.constant_tau)
    }

    /// Points that touch the sphere.
    pub fn touching(&self, sphere: &CloudSphere) -> usize {
        let count = if self.tau.is_empty() {
            count_constant(&sphere.into(), self.arrays(), self.constant_tau)
        } else {
            count(&sphere.into(), self.arrays(), &self.tau)
        };
        count as usize
    }

    /// Marks the points within `widen` contact distances of the sphere by 1, the others by 0.
    fn mark(&self, sphere: &CloudSphere, widen: f32, marks: &mut Vec<u8>) {
        marks.resize(self.len(), 0);
        if self.tau.is_empty() {
            let reach = widen * self.constant_tau;
            mark_constant(&sphere.into(), self.arrays(), reach, marks);
        } else {
            mark(&sphere.into(), self.arrays(), &self.tau, widen, marks);
        }
    }

    /// Appends the places of the points that touch the sphere to `places`, ascending.
    pub fn list_touching(&self, sphere: &CloudSphere, marks: &mut Vec<u8>, places: &mut Vec<u32>) {
        self.mark(sphere, 1.0, marks);
        list(marks, places);
    }

    /// Moments of the points within `widen` contact distances of the sphere. `marks` and
    /// `places` are scratch.
    pub fn moments(
        &self,
        sphere: &CloudSphere,
        widen: f32,
        (marks, places): (&mut Vec<u8>, &mut Vec<u32>),
    ) -> PointMoments {
        self.mark(sphere, widen, marks);
        places.clear();
        list(marks, places);
        let mut sums = PointMoments::default();
        for &i in places.iter() {
            sums.add(self.at(i as usize));
        }
        sums
    }

    /// Takes the points that touch the sphere out; says how many. The rest keep their order.
    pub fn remove(&mut self, sphere: &CloudSphere) -> usize {
        let before = self.len();
        let mut marks = std::mem::take(&mut self.marks);
        self.mark(sphere, 1.0, &mut marks);
        for axis in self.axes_mut() {
            keep_unmarked(axis, &marks);
        }
        keep_unmarked(&mut self.id, &marks);
        self.marks = marks;
        before - self.len()
    }
}

/// Appends the places of the marks that are 1, ascending.
fn list(marks: &[u8], places: &mut Vec<u32>) {
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

/// Keeps the values whose mark is 0, in order; an array without values stays so. Neighbours on
/// the curve mostly share their fate, so eight at a time are moved or passed over.
fn keep_unmarked<T: Copy>(values: &mut Vec<T>, marks: &[u8]) {
    if values.is_empty() {
        return;
    }
    let mut kept = 0;
    let (eights, rest) = marks.as_chunks::<8>();
    for (chunk, eight) in eights.iter().enumerate() {
        let from = 8 * chunk;
        match u64::from_le_bytes(*eight) {
            0 => {
                values.copy_within(from..from + 8, kept);
                kept += 8;
            }
            0x0101_0101_0101_0101 => {}
            _ => {
                // no branch on a single mark: they are noise to it
                for (i, &mark) in (from..).zip(eight) {
                    values[kept] = values[i];
                    kept += usize::from(mark == 0);
                }
            }
        }
    }
    for (i, &mark) in (marks.len() - rest.len()..).zip(rest) {
        values[kept] = values[i];
        kept += usize::from(mark == 0);
    }
    values.truncate(kept);
}
