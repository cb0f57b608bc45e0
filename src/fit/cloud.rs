//! What the fits of unorganised points share: parameters, the sphere, the model.

use super::contact_distance::ContactDistance;
use super::sphere::PLANE_RADIUS_M;
use crate::partition::lattice::Packing;
use glam::DVec3;
use std::fmt;
use std::str::FromStr;

/// In [`CloudModel::assignment`]: a point that no sphere explains.
pub const UNASSIGNED: u32 = u32::MAX;

/// Share of the points that may stay unexplained (paper 3.1: "around .1% of total points").
pub const UNEXPLAINED_SHARE: f64 = 1e-3;

/// Which of the paper's two schemes fits the spheres (paper 3.2).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Scheme {
    /// Cell by cell, small spheres to large.
    #[default]
    Progressive,
    /// Spheres through randomly drawn points, the best kept.
    Random,
}

impl fmt::Display for Scheme {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Progressive => "progressive",
            Self::Random => "random",
        })
    }
}

impl FromStr for Scheme {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "progressive" => Ok(Self::Progressive),
            "random" => Ok(Self::Random),
            _ => Err(format!(
                "scheme {text:?} is unknown; use progressive or random"
            )),
        }
    }
}

/// The paper's parameters of a fit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FitParameters {
    /// Upper limit of spheres in the model (paper: `ms`).
    pub max_spheres: usize,
    /// How far a point may lie from its sphere.
    pub contact_distance: ContactDistance,
    /// Distance between neighbouring cell centres, metres.
    pub cube_size_m: f64,
    /// Upper limit of spheres fitted in one cell (paper 4.1: 25).
    pub spheres_per_cube: usize,
    /// Lattice of the cells.
    pub packing: Packing,
    /// Random or progressive.
    pub scheme: Scheme,
    /// Seed of the random scheme. Same seed, same bytes.
    pub seed: u64,
}

impl Default for FitParameters {
    fn default() -> Self {
        Self {
            max_spheres: 65_000,
            contact_distance: ContactDistance::default(),
            cube_size_m: 0.2,
            spheres_per_cube: 25,
            packing: Packing::Hexagonal,
            scheme: Scheme::Progressive,
            seed: 0,
        }
    }
}

/// A sphere as the zero set of `(κ/2)|p|² + n·p + d` with `|n|² − 2κd = 1`, metres about a local
/// origin. κ = 0 is a plane; κ > 0 has `n` pointing outwards.
///
/// Deviation. Paper 3.2 gives a plane "a sufficiently large radius"; centre and radius lose
/// their digits there, so they are made only at the surface ([`CloudSphere::center_radius`]).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CloudSphere {
    /// κ, signed curvature 1/R, 1/m.
    pub curvature: f64,
    /// n, the gradient at the local origin.
    pub normal: DVec3,
    /// d, metres.
    pub offset: f64,
}

impl CloudSphere {
    /// Scales the three so that `|n|² − 2κd = 1`. `None` where they describe no real surface.
    #[must_use]
    pub fn normalised(curvature: f64, normal: DVec3, offset: f64) -> Option<Self> {
        let power = normal.length_squared() - 2.0 * curvature * offset;
        let scale = 1.0 / power.sqrt();
        (scale.is_finite() && scale > 0.0).then(|| Self {
            curvature: curvature * scale,
            normal: normal * scale,
            offset: offset * scale,
        })
    }

    /// The sphere with this centre and radius, metres. `None` for a radius not above 0.
    #[must_use]
    pub fn from_center_radius(center: DVec3, radius: f64) -> Option<Self> {
        if !(radius > 0.0 && radius.is_finite()) {
            return None;
        }
        // (|p − c|² − R²) / 2R
        Some(Self {
            curvature: 1.0 / radius,
            normal: -center / radius,
            offset: (center.length_squared() - radius * radius) / (2.0 * radius),
        })
    }

    /// The sphere (or plane) through four points. `None` where three of them, or all, coincide
    /// or lie on a line.
    #[must_use]
    pub fn through(points: [DVec3; 4]) -> Option<Self> {
        let [o, a, b, c] = points;
        let (a, b, c) = (a - o, b - o, c - o);
        let (bc, ca, ab) = (b.cross(c), c.cross(a), a.cross(b));
        // F(o) = 0 gives d = 0; Cramer's rule on the other three, multiplied out by the
        // determinant, which is 0 for a plane and then needs no division
        let normal = -(a.length_squared() * bc + b.length_squared() * ca + c.length_squared() * ab);
        let curvature = 2.0 * a.dot(bc);
        let size = a
            .length_squared()
            .max(b.length_squared())
            .max(c.length_squared());
        if normal.length_squared() <= 1e-24 * size.powi(4) {
            return None;
        }
        Some(Self::normalised(curvature, normal, 0.0)?.translated(o))
    }

    /// The same surface moved by `by`, metres.
    #[must_use]
    pub fn translated(&self, by: DVec3) -> Self {
        Self {
            curvature: self.curvature,
            normal: self.normal - self.curvature * by,
            offset: self.offset + 0.5 * self.curvature * by.length_squared() - self.normal.dot(by),
        }
    }

    /// The sphere a `share` of the way from this one to `other`; both pass by `near`, where their
    /// normals tell which sides belong together. `None` where nothing lies between them.
    #[must_use]
    pub fn towards(&self, other: &Self, near: DVec3, share: f64) -> Option<Self> {
        let gradient = |s: &Self| s.curvature * near + s.normal;
        let same_side = gradient(self).dot(gradient(other)) >= 0.0;
        let (a, b) = (1.0 - share, if same_side { share } else { -share });
        Self::normalised(
            a * self.curvature + b * other.curvature,
            a * self.normal + b * other.normal,
            a * self.offset + b * other.offset,
        )
    }

    /// F(p): the signed distance from the surface to first order.
    #[inline]
    #[must_use]
    pub fn value(&self, p: DVec3) -> f64 {
        0.5 * self.curvature * p.length_squared() + self.normal.dot(p) + self.offset
    }

    /// Signed distance of `p` from the surface along the gradient, metres. At the far side of
    /// the centre the distance to the near pole is meant, as F does not tell the sides apart.
    #[must_use]
    pub fn signed_distance(&self, p: DVec3) -> f64 {
        let f = self.value(p);
        2.0 * f / (1.0 + (1.0 + 2.0 * self.curvature * f).max(0.0).sqrt())
    }

    /// Distance of `p` from the surface, metres.
    #[must_use]
    pub fn distance(&self, p: DVec3) -> f64 {
        self.signed_distance(p).abs()
    }

    /// Point of the surface nearest to `p`, metres.
    #[must_use]
    pub fn project(&self, p: DVec3) -> DVec3 {
        let gradient = (self.curvature * p + self.normal).normalize_or_zero();
        p - self.signed_distance(p) * gradient
    }

    /// Centre and radius, metres: what the paper stores. A plane gets the radius
    /// [`PLANE_RADIUS_M`].
    #[must_use]
    pub fn center_radius(&self) -> (DVec3, f64) {
        let radius = 1.0 / self.curvature.abs();
        if radius <= PLANE_RADIUS_M {
            return (-self.normal / self.curvature, radius);
        }
        // from the surface point nearest the origin, along the normal, towards the inside
        let foot = self.project(DVec3::ZERO);
        let normal = (self.curvature * foot + self.normal).normalize_or_zero();
        let side = if self.curvature < 0.0 { 1.0 } else { -1.0 };
        (foot + side * PLANE_RADIUS_M * normal, PLANE_RADIUS_M)
    }

    /// Centre x, y, z and radius as the paper's four floats, metres.
    #[must_use]
    pub fn paper_floats(&self) -> [f32; 4] {
        let (c, r) = self.center_radius();
        [c.x as f32, c.y as f32, c.z as f32, r as f32]
    }
}

/// The spheres of a cloud and who touches which.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CloudModel {
    /// Zero of the spheres' coordinates in the source's, metres.
    pub origin: DVec3,
    /// The spheres, about `origin`.
    pub spheres: Vec<CloudSphere>,
    /// Per point: its sphere's place in `spheres`, or [`UNASSIGNED`].
    pub assignment: Vec<u32>,
    /// Share of the points within contact distance of their sphere, 0 to 1 (1 for no points).
    pub explained: f64,
}

impl CloudModel {
    /// Recounts `explained` from `assignment`.
    pub(crate) fn count_explained(&mut self) {
        let left = self.assignment.iter().filter(|&&s| s == UNASSIGNED).count();
        let n = self.assignment.len();
        self.explained = if n == 0 {
            1.0
        } else {
            1.0 - left as f64 / n as f64
        };
    }

    /// Drops the spheres that hold no point and, beyond `max_spheres`, those that hold fewest.
    /// The rest is ordered by points held, most first: a prefix is the coarser model.
    pub(crate) fn order_and_limit(&mut self, max_spheres: usize) {
        let mut held = vec![0u32; self.spheres.len()];
        for &s in self.assignment.iter().filter(|&&s| s != UNASSIGNED) {
            held[s as usize] += 1;
        }
        let mut order: Vec<u32> = (0..held.len() as u32)
            .filter(|&s| held[s as usize] > 0)
            .collect();
        order.sort_by_key(|&s| (std::cmp::Reverse(held[s as usize]), s));
        order.truncate(max_spheres);
        let mut renumbered = vec![UNASSIGNED; held.len()];
        for (new, &old) in order.iter().enumerate() {
            renumbered[old as usize] = new as u32;
        }
        self.spheres = order.iter().map(|&s| self.spheres[s as usize]).collect();
        for s in self.assignment.iter_mut().filter(|s| **s != UNASSIGNED) {
            *s = renumbered[*s as usize];
        }
        self.count_explained();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn vector(limit: f64) -> impl Strategy<Value = DVec3> {
        (-limit..limit, -limit..limit, -limit..limit).prop_map(|(x, y, z)| DVec3::new(x, y, z))
    }

    proptest! {
        #[test]
        fn distances_agree_with_centre_and_radius(
            c in vector(3.0), radius in 0.05f64..1000.0, direction in vector(1.0), off in -0.02f64..0.02,
        ) {
            prop_assume!(direction.length() > 0.1);
            let center = c - direction.normalize() * radius;
            let sphere = CloudSphere::from_center_radius(center, radius).unwrap();
            let p = center + direction.normalize() * (radius + off);
            prop_assert!((sphere.distance(p) - off.abs()).abs() < 1e-8);
            prop_assert!(((sphere.project(p) - center).length() - radius).abs() < 1e-8);
            let (back, r) = sphere.center_radius();
            prop_assert!((back - center).length() < 1e-7 && (r - radius).abs() < 1e-7);
            let moved = sphere.translated(DVec3::new(1.0, 2.0, 3.0));
            prop_assert!((moved.value(p + DVec3::new(1.0, 2.0, 3.0)) - sphere.value(p)).abs() < 1e-8);
        }

        #[test]
        fn four_points_lie_on_their_sphere(a in vector(1.0), b in vector(1.0), c in vector(1.0), d in vector(1.0)) {
            if let Some(sphere) = CloudSphere::through([a, b, c, d]) {
                for p in [a, b, c, d] {
                    prop_assert!(sphere.distance(p) < 1e-6, "{}", sphere.distance(p));
                }
            }
        }
    }

    #[test]
    fn four_coplanar_points_give_a_plane() {
        let p = |x, y| DVec3::new(x, y, 2.0);
        let plane =
            CloudSphere::through([p(0.0, 0.0), p(1.0, 0.1), p(0.3, 1.0), p(-1.0, 2.0)]).unwrap();
        assert_eq!(plane.curvature, 0.0);
        let (center, radius) = plane.center_radius();
        assert_eq!(radius, PLANE_RADIUS_M);
        assert!(((p(0.5, 0.5) - center).length() - radius).abs() < 1e-4);
        assert!(
            CloudSphere::through([DVec3::ZERO, DVec3::X, DVec3::X * 2.0, DVec3::X * 3.0]).is_none()
        );
        assert!(CloudSphere::through([DVec3::ONE; 4]).is_none());
    }

    #[test]
    fn limiting_keeps_the_largest() {
        let mut model = CloudModel {
            spheres: (1..=3)
                .filter_map(|r| CloudSphere::from_center_radius(DVec3::ZERO, f64::from(r)))
                .collect(),
            assignment: vec![0, 2, 2, UNASSIGNED, 2, 0],
            ..CloudModel::default()
        };
        model.order_and_limit(1);
        assert_eq!(
            model.assignment,
            [UNASSIGNED, 0, 0, UNASSIGNED, 0, UNASSIGNED]
        );
        assert_eq!(model.spheres[0].center_radius().1, 3.0);
        assert_eq!(model.explained, 0.5);
    }
}
