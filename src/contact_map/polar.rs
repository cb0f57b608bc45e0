//! A sphere's own latitude and longitude (paper 3.2, Eq. 1), and the patch grid made of them.
//!
//! `P(φ, θ) = (ρ sin φ cos θ, ρ sin φ sin θ, ρ cos φ)`: φ from the z-axis, 0 to 180°; θ from the
//! x-axis, 0 to 360°; ρ the radius. Angles are in radians here.
//!
//! Deviation. The paper gives every sphere the same number of cells, so a cell of a tabletop
//! (radius kilometres) holds the whole room. [`Patch`] turns each sphere so that its points lie
//! around φ = 90°, θ = 0 and cuts cells of equal *arc length*. There is no pole near the points,
//! and the error is the same in millimetres on every sphere.

use crate::fit::cloud::CloudSphere;
use glam::{DVec3, Vec3};
use std::f64::consts::{FRAC_PI_2, PI, TAU};

/// Direction from a sphere's centre as Eq. 1 has it, radians.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Angles {
    /// φ, from the z-axis, 0 to π.
    pub phi: f64,
    /// θ, from the x-axis, 0 (included) to 2π (not included).
    pub theta: f64,
}

impl Angles {
    /// Angles of a point relative to the centre. At the poles θ is 0; at the centre φ is too.
    #[must_use]
    pub fn of(from_center: DVec3) -> Self {
        let across = from_center.x.hypot(from_center.y);
        let phi = across.atan2(from_center.z);
        let theta = from_center.y.atan2(from_center.x);
        let theta = if theta < 0.0 { theta + TAU } else { theta };
        Self {
            phi,
            // −1e−17 + 2π rounds to 2π
            theta: if across == 0.0 || theta >= TAU {
                0.0
            } else {
                theta
            },
        }
    }

    /// Eq. 1: the point of the sphere with radius ρ about the origin.
    #[must_use]
    pub fn point(&self, rho: f64) -> DVec3 {
        let (sin_phi, cos_phi) = self.phi.sin_cos();
        let (sin_theta, cos_theta) = self.theta.sin_cos();
        rho * DVec3::new(sin_phi * cos_theta, sin_phi * sin_theta, cos_phi)
    }
}

/// The paper's grid: φ in rows, θ in columns, the same for every sphere (paper: `mr`).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PolarGrid {
    /// Rows over φ = 0 … 180°.
    pub rows: u32,
    /// Columns over θ = 0 … 360°.
    pub columns: u32,
}

impl PolarGrid {
    /// A grid of map resolution `mr`: `mr` rows and twice as many columns, so that cells are
    /// square at the equator. At least 1, at most 32768.
    #[must_use]
    pub fn new(map_resolution: u32) -> Self {
        let rows = map_resolution.clamp(1, 1 << 15);
        Self {
            rows,
            columns: 2 * rows,
        }
    }

    /// Number of the cell that holds the direction, row by row.
    #[must_use]
    pub fn cell(&self, angles: Angles) -> u32 {
        let place = |part: f64, count: u32| ((part * f64::from(count)) as u32).min(count - 1);
        place(angles.phi / PI, self.rows) * self.columns + place(angles.theta / TAU, self.columns)
    }

    /// Direction of a cell's middle.
    #[must_use]
    pub fn middle(&self, cell: u32) -> Angles {
        let (row, column) = (cell / self.columns, cell % self.columns);
        Angles {
            phi: (f64::from(row) + 0.5) * PI / f64::from(self.rows),
            theta: (f64::from(column) + 0.5) * TAU / f64::from(self.columns),
        }
    }
}

/// A cell of a sphere's patch: steps of arc from the anchor.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct PatchCell {
    /// Steps of latitude.
    pub row: i32,
    /// Steps of longitude, counted on the equator.
    pub column: i32,
}

/// Largest row or column either way. 2²⁴ cells of 1 mm are 16 km.
pub const MAX_STEPS: i32 = 1 << 24;

/// A sphere turned so that its points lie about φ = 90°, θ = 0 of its own grid.
///
/// Seven floats, in the precision they are stored in. The centre is `anchor − normal/curvature`;
/// it is never needed: all is computed from the anchor outwards, which stays exact where the
/// radius goes to infinity.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Patch {
    /// The surface point at φ = 90°, θ = 0, metres about the model's origin.
    pub anchor: Vec3,
    /// Unit normal there: the local x-axis.
    pub normal: Vec3,
    /// Signed curvature, 1/m: positive where the normal points outwards, 0 for a plane.
    pub curvature: f32,
}

impl Patch {
    /// The patch of a sphere around `near` (the centroid of its points, metres).
    #[must_use]
    pub fn new(sphere: &CloudSphere, near: DVec3) -> Self {
        let gradient = sphere.curvature * near + sphere.normal;
        // at the very centre of a closed sphere every direction is as good
        let normal = gradient.try_normalize().unwrap_or(DVec3::X);
        let anchor = near - sphere.signed_distance(near) * normal;
        // where 1 + 2κF is negative the surface is out of first order's reach: step again
        let anchor = anchor - sphere.signed_distance(anchor) * normal;
        Self {
            anchor: anchor.as_vec3(),
            normal: normal.as_vec3(),
            curvature: sphere.curvature as f32,
        }
    }

    /// The same patch in fewer digits: within `reach_m` of its anchor the surface moves by a few
    /// hundredths of `step_m` at most. Digits below that would cost bits and say nothing.
    #[must_use]
    pub fn rounded(&self, reach_m: f64, step_m: f64) -> Self {
        let reach_m = reach_m.max(step_m);
        // powers of two: the numbers end in zeros
        let grain = |limit: f64| limit.max(f64::MIN_POSITIVE).log2().floor().exp2();
        let round = |v: f32, grain: f64| {
            let rounded = ((f64::from(v) / grain).round() * grain) as f32;
            if rounded.is_finite() { rounded } else { v }
        };
        let (length, turn) = (grain(step_m / 64.0), grain(step_m / (64.0 * reach_m)));
        let bend = grain(step_m / (32.0 * reach_m * reach_m));
        let mut normal = self.normal.to_array();
        let size = normal.map(f32::abs);
        let pole = (0..3).fold(0, |most, k| if size[k] >= size[most] { k } else { most });
        // two components say the third, the greatest
        let mut rest = 1.0;
        for k in (0..3).filter(|k| *k != pole) {
            normal[k] = round(normal[k], turn);
            rest -= f64::from(normal[k]) * f64::from(normal[k]);
        }
        normal[pole] = (rest.max(0.0).sqrt() as f32).copysign(normal[pole]);
        let unit = (Vec3::from(normal).length() - 1.0).abs() < 1e-4;
        Self {
            anchor: self.anchor.to_array().map(|v| round(v, length)).into(),
            normal: if unit { normal.into() } else { self.normal },
            curvature: round(self.curvature, bend),
        }
    }

    /// Centre and radius, metres, as the paper stores them.
    #[must_use]
    pub fn center_radius(&self) -> (DVec3, f64) {
        self.sphere().center_radius()
    }

    /// The sphere the patch lies on.
    #[must_use]
    pub fn sphere(&self) -> CloudSphere {
        CloudSphere {
            curvature: f64::from(self.curvature),
            normal: self.axes()[0],
            offset: 0.0,
        }
        .translated(self.anchor.as_dvec3())
    }

    /// Local x (the normal), y and z axes in f64, a function of the stored normal alone.
    fn axes(&self) -> [DVec3; 3] {
        let x = self.normal.as_dvec3().try_normalize().unwrap_or(DVec3::X);
        let (y, z) = x.any_orthonormal_pair();
        [x, y, z]
    }

    /// Tool for many points: axes computed once.
    #[must_use]
    pub fn grid(&self, step_m: f64) -> PatchGrid {
        PatchGrid {
            anchor: self.anchor.as_dvec3(),
            axes: self.axes(),
            curvature: f64::from(self.curvature),
            step_m,
        }
    }
}

/// The cells of a [`Patch`] at a step.
#[derive(Clone, Copy, Debug)]
pub struct PatchGrid {
    anchor: DVec3,
    axes: [DVec3; 3],
    curvature: f64,
    /// Arc length of a cell's side at the equator, metres.
    step_m: f64,
}

impl PatchGrid {
    /// The cell of the surface point beneath `p` (metres about the model's origin). `None`
    /// beyond [`MAX_STEPS`].
    #[must_use]
    pub fn cell(&self, p: DVec3) -> Option<PatchCell> {
        let [ex, ey, ez] = self.axes;
        let (rel, k) = (p - self.anchor, self.curvature);
        let (x, y, z) = (rel.dot(ex), rel.dot(ey), rel.dot(ez));
        // from the centre, divided by the radius: (1 + κx, κy, κz)
        let (latitude_m, longitude_m) = if k == 0.0 {
            (z, y)
        } else {
            let (a, b, c) = (1.0 + k * x, k * y, k * z);
            (c.atan2(a.hypot(b)) / k, b.atan2(a) / k)
        };
        let (row, column) = (
            (latitude_m / self.step_m).round(),
            (longitude_m / self.step_m).round(),
        );
        let limit = f64::from(MAX_STEPS);
        (row.abs() <= limit && column.abs() <= limit).then_some(PatchCell {
            row: row as i32,
            column: column as i32,
        })
    }

    /// The point of the surface at a cell's middle, metres about the model's origin: Eq. 1 with
    /// φ = 90° − latitude, in the patch's axes, less the anchor.
    #[must_use]
    pub fn point(&self, cell: PatchCell) -> DVec3 {
        let k = self.curvature;
        let (z_m, y_m) = (
            f64::from(cell.row) * self.step_m,
            f64::from(cell.column) * self.step_m,
        );
        let [ex, ey, ez] = self.axes;
        if k == 0.0 {
            return self.anchor + y_m * ey + z_m * ez;
        }
        let latitude = (k * z_m).clamp(-FRAC_PI_2, FRAC_PI_2);
        let longitude = k * y_m;
        let (sin_lat, cos_lat) = latitude.sin_cos();
        // cos λ cos θ − 1 without the cancellation
        let (half_lat, half_lon) = ((0.5 * latitude).sin(), (0.5 * longitude).sin());
        let down = -2.0 * (cos_lat * half_lon * half_lon + half_lat * half_lat);
        self.anchor + (down / k) * ex + (cos_lat * longitude.sin() / k) * ey + (sin_lat / k) * ez
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn direction() -> impl Strategy<Value = DVec3> {
        (-1f64..1.0, 0f64..TAU).prop_map(|(z, t)| {
            let ring = (1.0 - z * z).sqrt();
            DVec3::new(ring * t.cos(), ring * t.sin(), z)
        })
    }

    #[test]
    fn angles_follow_equation_one() {
        let degrees = |p: DVec3| {
            let a = Angles::of(p);
            (a.phi.to_degrees(), a.theta.to_degrees())
        };
        assert_eq!(degrees(DVec3::Z), (0.0, 0.0));
        assert_eq!(degrees(-DVec3::Z), (180.0, 0.0));
        assert_eq!(degrees(DVec3::X), (90.0, 0.0));
        assert_eq!(degrees(DVec3::Y), (90.0, 90.0));
        assert_eq!(degrees(-DVec3::X), (90.0, 180.0));
        assert_eq!(degrees(-DVec3::Y), (90.0, 270.0));
        assert_eq!(degrees(DVec3::ZERO), (0.0, 0.0));
        assert!(Angles::of(DVec3::new(1.0, -1e-300, 0.0)).theta < TAU);
    }

    proptest! {
        #[test]
        fn angles_round_trip(d in direction(), rho in 0.01f64..100.0) {
            let p = d * rho;
            prop_assert!(Angles::of(p).point(rho).distance(p) < 1e-12 * rho);
        }

        #[test]
        fn literal_cell_is_within_half_a_cell(d in direction(), mr in 1u32..2000) {
            let grid = PolarGrid::new(mr);
            let (a, m) = (Angles::of(d), grid.middle(grid.cell(Angles::of(d))));
            let half = 0.5 * PI / f64::from(grid.rows) + 1e-12;
            prop_assert!((a.phi - m.phi).abs() <= half && (a.theta - m.theta).abs() <= half);
            prop_assert!(m.point(1.0).distance(d) <= 2f64.sqrt() * half);
        }

        #[test]
        fn patch_cell_is_within_half_a_cell(
            center in direction(), outward in direction(), d in direction(),
            radius in prop_oneof![0.02f64..2.0, 1f64..1e4, Just(1e7)],
            hollow in any::<bool>(), reach in 0f64..1.0, off in -0.004f64..0.004, step_m in 1e-3f64..0.02,
        ) {
            // a point of the sphere up to 2 m of arc from the patch's middle, off the surface
            let anchor = center * 3.0;
            let middle = anchor - outward * radius;
            let mut sphere = CloudSphere::from_center_radius(middle, radius).unwrap();
            if hollow {
                sphere = CloudSphere { curvature: -sphere.curvature, normal: -sphere.normal, offset: -sphere.offset };
            }
            let sideways = (d - d.dot(outward) * outward).normalize_or(outward.any_orthonormal_vector());
            let arc = (2.0 * reach / radius).min(reach * PI);
            let off = off.max(-0.5 * radius);
            let p = middle + (radius + off) * (arc.cos() * outward + arc.sin() * sideways);
            let patch = Patch::new(&sphere, anchor + 0.01 * outward);
            let grid = patch.grid(step_m);
            let rebuilt = grid.point(grid.cell(p).unwrap());
            // the stored sphere is the given one up to single precision
            let slack = 4e-6 + if radius > 1e6 { 1e-4 } else { 0.0 };
            prop_assert!(patch.sphere().distance(rebuilt) < 1e-6);
            let error = rebuilt.distance(p);
            let bound = 0.5f64.sqrt() * step_m + off.abs() + slack;
            prop_assert!(error <= bound, "{error} m off, at most {bound}");
        }
    }

    proptest! {
        #[test]
        fn rounding_moves_the_surface_by_a_few_hundredths_of_a_step(
            anchor in direction(), normal in direction(), radius in prop_oneof![0.1f64..2.0, 1f64..1e4],
            reach in 0.001f64..3.0, step_m in 1e-3f64..0.02, at in 0f64..TAU,
        ) {
            let patch = Patch {
                anchor: (5.0 * anchor).as_vec3(),
                normal: normal.as_vec3().normalize(),
                curvature: (1.0 / radius) as f32,
            };
            // no farther than a quarter of the way round
            let reach = reach.min(radius);
            let rounded = patch.rounded(reach, step_m);
            let (row, column) = (reach * at.sin() / step_m, reach * at.cos() / step_m);
            let cell = PatchCell { row: row as i32, column: column as i32 };
            let p = patch.grid(step_m).point(cell);
            let off = rounded.sphere().distance(p).abs();
            prop_assert!(off < 0.06 * step_m + 3e-6, "{} steps", off / step_m);
            prop_assert!((rounded.normal.length() - 1.0).abs() < 1e-4);
        }
    }

    #[test]
    fn a_plane_has_a_flat_patch() {
        let plane = CloudSphere::normalised(0.0, DVec3::new(0.0, 0.0, 1.0), -2.0).unwrap();
        let patch = Patch::new(&plane, DVec3::new(0.5, 0.25, 2.1));
        assert_eq!(patch.anchor, Vec3::new(0.5, 0.25, 2.0));
        let grid = patch.grid(0.01);
        let p = DVec3::new(-3.0, 7.0, 2.0);
        assert!(grid.point(grid.cell(p).unwrap()).distance(p) < 0.0071);
        assert!(grid.cell(DVec3::X * 1e9).is_none());
    }
}
