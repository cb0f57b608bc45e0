//! Additive moments of 3-D points and the sphere they determine.
//!
//! The surface is `F(p) = (κ/2)|p|² + n·p + d`, `|n|² − 2κd = 1`: a plane at κ = 0, curvature
//! signed. With the points about their own centroid, `d` follows from the rest and the fit
//! minimises `ΣF² / Σ|∇F|²` (Taubin, *Estimation of planar curves, surfaces and nonplanar space
//! curves*, PAMI 1991): a 4×4 symmetric eigenproblem in `(κ√q̄, n)`, q = |p|². It needs no view
//! direction, is exact for planes, patches and closed spheres alike, and cannot fail for points
//! that span a surface.

use super::cloud::CloudSphere;
use glam::DVec3;

/// Count and power sums of points about an origin of the caller's choice.
///
/// Merging adds the sums, so the fit of a union costs O(1). The origin must be near the points:
/// the sums hold fourth powers.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PointMoments {
    /// Number of points.
    pub count: f64,
    /// Σp, metres.
    pub first: DVec3,
    /// Σxx, Σyy, Σzz, m².
    pub square: DVec3,
    /// Σyz, Σxz, Σxy, m².
    pub cross: DVec3,
    /// Σ|p|²p, m³.
    pub third: DVec3,
    /// Σ|p|⁴, m⁴.
    pub fourth: f64,
}

/// A sphere and how well its points lie on it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MomentFit {
    /// The sphere, about the moments' origin.
    pub sphere: CloudSphere,
    /// RMS distance of the points from it (first order), metres.
    pub rms_m: f64,
}

impl PointMoments {
    /// Takes in one point, metres about the origin.
    #[inline]
    pub fn add(&mut self, p: DVec3) {
        let q = p.length_squared();
        self.count += 1.0;
        self.first += p;
        self.square += p * p;
        self.cross += DVec3::new(p.y * p.z, p.x * p.z, p.x * p.y);
        self.third += q * p;
        self.fourth += q * q;
    }

    /// Takes in all points of `other`, which must be about the same origin.
    #[inline]
    pub fn merge(&mut self, other: &Self) {
        self.count += other.count;
        self.first += other.first;
        self.square += other.square;
        self.cross += other.cross;
        self.third += other.third;
        self.fourth += other.fourth;
    }

    /// The same points about another origin: `to` is the new origin in the old coordinates.
    #[must_use]
    pub fn shifted(&self, to: DVec3) -> Self {
        // p' = p − t, expanded term by term; q' = q − 2t·p + |t|²
        let (n, t, t2) = (self.count, to, to.length_squared());
        let (s, q) = (self.first, self.square.element_sum());
        let st = self.second_times(t);
        let square = self.square - 2.0 * t * s + n * t * t;
        let tt = DVec3::new(t.y * t.z, t.x * t.z, t.x * t.y);
        let ts = DVec3::new(
            t.y * s.z + t.z * s.y,
            t.x * s.z + t.z * s.x,
            t.x * s.y + t.y * s.x,
        );
        let ts1 = t.dot(s);
        Self {
            count: n,
            first: s - n * t,
            square,
            cross: self.cross - ts + n * tt,
            third: self.third - 2.0 * st + t2 * s - (q - 2.0 * ts1 + n * t2) * t,
            fourth: self.fourth - 4.0 * t.dot(self.third)
                + 4.0 * t.dot(st)
                + 2.0 * t2 * q
                + n * t2 * t2
                - 4.0 * t2 * ts1,
        }
    }

    /// (Σ p pᵀ) t.
    fn second_times(&self, t: DVec3) -> DVec3 {
        let (s, c) = (self.square, self.cross);
        DVec3::new(
            s.x * t.x + c.z * t.y + c.y * t.z,
            c.z * t.x + s.y * t.y + c.x * t.z,
            c.y * t.x + c.x * t.y + s.z * t.z,
        )
    }

    /// The sphere nearest the points, or the plane where the points' curvature is not
    /// significant (Bayesian information criterion: a sphere must earn its extra number).
    ///
    /// `None` for fewer than five points and for points on a line or in one place: they
    /// determine no surface. Cost: two small Jacobi eigenproblems, about a microsecond.
    #[must_use]
    pub fn fit(&self) -> Option<MomentFit> {
        if self.count < 5.0 {
            return None;
        }
        let mean = self.first / self.count;
        let about = self.shifted(mean);
        let scale = 1.0 / self.count;
        let (s, c) = (about.square * scale, about.cross * scale);
        let q_mean = s.element_sum();
        if !q_mean.is_finite() || q_mean <= 0.0 {
            return None;
        }
        let plane = smallest([[s.x, c.z, c.y], [c.z, s.y, c.x], [c.y, c.x, s.z]]);
        // second-largest spread: none means a line
        if plane.values[1] <= 1e-10 * q_mean {
            return None;
        }
        // Rows of (κ√q̄, n): F = κ/2·(q − q̄) + n·p, divided by √q̄ so that all entries are lengths²
        let h = 0.5 / q_mean.sqrt();
        let k0 = about.third * (scale * h);
        let k00 = (about.fourth * scale - q_mean * q_mean) * h * h;
        let ball = smallest([
            [k00, k0.x, k0.y, k0.z],
            [k0.x, s.x, c.z, c.y],
            [k0.y, c.z, s.y, c.x],
            [k0.z, c.y, c.x, s.z],
        ]);
        // what rounding leaves of a perfect fit
        let floor = 1e-15 * q_mean;
        let (flat, round) = (
            plane.values[0].max(0.0) + floor,
            ball.values[0].max(0.0) + floor,
        );
        let curved = self.count * (flat / round).ln() > self.count.ln();
        let [k, nx, ny, nz] = ball.vector;
        let (curvature, normal) = if curved {
            (k / q_mean.sqrt(), DVec3::new(nx, ny, nz))
        } else {
            (0.0, DVec3::from_array(plane.vector))
        };
        let offset = -0.5 * curvature * q_mean;
        let sphere = CloudSphere::normalised(curvature, normal, offset)?;
        Some(MomentFit {
            sphere: sphere.translated(mean),
            rms_m: if curved { round } else { flat }.sqrt(),
        })
    }
}

/// Eigenvalues in ascending order and the unit eigenvector of the smallest.
struct Smallest<const N: usize> {
    values: [f64; N],
    vector: [f64; N],
}

/// Cyclic Jacobi rotations on a symmetric matrix (Golub & Van Loan, *Matrix Computations*, 8.5).
fn smallest<const N: usize>(mut a: [[f64; N]; N]) -> Smallest<N> {
    let mut v = [[0.0; N]; N];
    for (i, row) in v.iter_mut().enumerate() {
        row[i] = 1.0;
    }
    for _ in 0..20 {
        let (mut off, mut diagonal) = (0.0, 0.0);
        for (i, row) in a.iter().enumerate() {
            diagonal += row[i] * row[i];
            off += row[..i].iter().map(|v| v * v).sum::<f64>();
        }
        if off <= 1e-32 * diagonal {
            break;
        }
        for p in 0..N {
            for q in p + 1..N {
                if a[p][q] == 0.0 {
                    continue;
                }
                let theta = (a[q][q] - a[p][p]) / (2.0 * a[p][q]);
                let t = theta.signum() / (theta.abs() + (theta * theta + 1.0).sqrt());
                let c = 1.0 / (t * t + 1.0).sqrt();
                let s = t * c;
                for row in &mut a {
                    (row[p], row[q]) = (c * row[p] - s * row[q], s * row[p] + c * row[q]);
                }
                let (top, bottom) = a.split_at_mut(q);
                for (ap, aq) in top[p].iter_mut().zip(&mut bottom[0]) {
                    (*ap, *aq) = (c * *ap - s * *aq, s * *ap + c * *aq);
                }
                for row in &mut v {
                    (row[p], row[q]) = (c * row[p] - s * row[q], s * row[p] + c * row[q]);
                }
            }
        }
    }
    let mut values = [0.0; N];
    let mut least = 0;
    for i in 0..N {
        values[i] = a[i][i];
        if values[i] < values[least] {
            least = i;
        }
    }
    let mut vector = [0.0; N];
    for i in 0..N {
        vector[i] = v[i][least];
    }
    values.sort_by(f64::total_cmp);
    Smallest { values, vector }
}

#[cfg(test)]
#[path = "point_moments_tests.rs"]
mod tests;
