//! One sphere, in the form every stage uses.
//!
//! The surface is the zero set of `a·|p|² + m·p − 1`: linear in its four numbers, a plane where
//! `a = 0`, signed curvature, never degenerate for a surface that does not pass through the
//! camera. With the ray `r = (u, v, 1)`, `q = |r|²` and inverse depth `w = 1/z` it reads
//! `w = a·q/w + m·r`, so a fit in inverse depth (where stereo and structured-light noise is
//! uniform) is one 4×4 linear system. The paper's centre and radius are `C = −m / 2a`,
//! `R = √(|C|² + 1/a)`.
//!
//! Deviation. Paper 3.2 stores centre and radius and models a plane by "a sufficiently large
//! radius". We keep `(a, m)` inside, because centre and radius lose all their digits exactly
//! there, and give centre and radius at the public surface ([`Sphere::center_radius`]).

use glam::{DVec3, Vec3};

/// Radius given to a surface with no measurable curvature, metres.
pub const PLANE_RADIUS_M: f64 = 1.0e4;

/// A sphere, or a plane where `a` is 0: `a·|p|² + m·p = 1`, metres, optical frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sphere {
    /// Curvature term, 1/m².
    pub a: f32,
    /// Linear term, 1/m.
    pub m: Vec3,
    /// True where the camera sees the far side of the sphere from outside (a hollow): the ray's
    /// second intersection.
    pub far: bool,
}

impl Sphere {
    /// Centre (metres) and radius (metres) as the paper has them. A plane gets the radius
    /// [`PLANE_RADIUS_M`].
    #[must_use]
    pub fn center_radius(&self) -> (DVec3, f64) {
        let m = self.m.as_dvec3();
        let norm = m.length();
        // |C|² + 1/a = (|m|² + 4a) / 4a²
        let a = f64::from(self.a);
        let radius = (norm * norm + 4.0 * a).max(0.0).sqrt() / (2.0 * a.abs());
        if !radius.is_finite() || radius > PLANE_RADIUS_M {
            // the plane's foot point, then back along its normal, on the side the sign of `a` tells
            let foot = m / (norm * norm);
            let side = if a > 0.0 { -1.0 } else { 1.0 };
            return (foot + side * m / norm * PLANE_RADIUS_M, PLANE_RADIUS_M);
        }
        (m / (-2.0 * a), radius)
    }

    /// The sphere with this centre and radius (metres). Fails (`None`) where it passes through
    /// the camera centre, which no depth camera can see.
    #[must_use]
    pub fn from_center_radius(center: DVec3, radius: f64) -> Option<Self> {
        let power = radius * radius - center.length_squared();
        if power == 0.0 || !power.is_finite() {
            return None;
        }
        let a = 1.0 / power;
        let m = center * (-2.0 * a);
        Some(Self {
            a: a as f32,
            m: m.as_vec3(),
            far: false,
        })
    }

    /// Distance of `p` (metres) from the surface, metres, unsigned.
    #[must_use]
    pub fn distance(&self, p: DVec3) -> f64 {
        let (a, m) = (f64::from(self.a), self.m.as_dvec3());
        let f = a * p.length_squared() + m.dot(p) - 1.0;
        let gradient = (2.0 * a * p + m).length();
        // exact for a quadric of this family: |F| = |a|·d² ± g·d on the near branch
        let root = (gradient * gradient - 4.0 * a * f).max(0.0).sqrt();
        2.0 * f.abs() / (gradient + root)
    }

    /// Inverse depth (1/m) along the ray `(u, v, 1)`, in the arithmetic of the decoder: single
    /// precision, this order of operations, no fused multiply-add. Not finite or not positive
    /// where the ray misses the sphere.
    #[inline]
    #[must_use]
    pub fn inverse_depth(&self, u: f32, v: f32, q: f32) -> f32 {
        let l = self.m.x * u + self.m.y * v + self.m.z;
        let root = (l * l + 4.0 * self.a * q).sqrt();
        if self.far {
            0.5 * (l - root)
        } else {
            0.5 * (l + root)
        }
    }
}
