//! Camera motion between two frames, and what it does to spheres.
//!
//! When the camera moves every sphere moves alike. Six numbers then stand for all of them: the
//! last frame's spheres are carried along before they are tried, and a payload that states the
//! motion can keep spheres that stand still in the world (`codec`).
//!
//! The motion is found by aligning the middles of image blocks with the spheres that held them
//! (projective point-to-surface alignment, as in KinectFusion, Newcombe et al. 2011, with spheres
//! in place of a depth map): a middle averages 64 measurements, so a few thousand of them fix the
//! motion far below the noise of one.

use super::sphere::Sphere;
use glam::{DMat3, DVec3};

/// Rotation steps per unit of the Gibbs vector (axis · tan(angle/2)).
const TURN_STEPS: f64 = 65536.0;
/// Translation steps per metre.
const SHIFT_STEPS: f64 = 16384.0;
/// Largest number of steps of a component: half a turn vector unit, 2 m.
pub const MOST: i32 = 32767;

/// A rigid motion `p' = R·p + t` from the last frame's axes to this one's, in whole steps, so that
/// whoever reads the numbers computes the same motion.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Motion {
    /// Gibbs vector of R (axis · tan(angle/2)) in 2⁻¹⁶.
    pub turn: [i32; 3],
    /// t in 2⁻¹⁴ m.
    pub shift: [i32; 3],
}

impl Motion {
    /// The motion with rotation vector `omega` (small, radians) and translation `t` (metres),
    /// rounded; `None` where it is beyond what one frame can do.
    #[must_use]
    pub fn new(omega: DVec3, t: DVec3) -> Option<Self> {
        let round = |v: DVec3, steps: f64| {
            let s = (v * steps + 0.5).floor();
            (s.is_finite() && s.abs().max_element() <= f64::from(MOST))
                .then_some([s.x as i32, s.y as i32, s.z as i32])
        };
        Some(Self {
            turn: round(0.5 * omega, TURN_STEPS)?,
            shift: round(t, SHIFT_STEPS)?,
        })
    }

    /// True where nothing moves.
    #[must_use]
    pub fn is_still(&self) -> bool {
        *self == Self::default()
    }

    /// R and t. Only +, −, ×, ÷: the same bits on every platform.
    fn matrix(&self) -> (DMat3, DVec3) {
        let [x, y, z] = self.turn.map(|s| f64::from(s) / TURN_STEPS);
        let n = 1.0 + x * x + y * y + z * z;
        let row = |a: f64, b: f64, c: f64| DVec3::new(a / n, b / n, c / n);
        // Rodrigues' form of the Gibbs vector; columns of R
        let r = DMat3::from_cols(
            row(
                1.0 + x * x - y * y - z * z,
                2.0 * (x * y + z),
                2.0 * (x * z - y),
            ),
            row(
                2.0 * (x * y - z),
                1.0 - x * x + y * y - z * z,
                2.0 * (y * z + x),
            ),
            row(
                2.0 * (x * z + y),
                2.0 * (y * z - x),
                1.0 - x * x - y * y + z * z,
            ),
        );
        (
            r,
            DVec3::from_array(self.shift.map(|s| f64::from(s) / SHIFT_STEPS)),
        )
    }

    /// A mover of many spheres.
    #[must_use]
    pub fn mover(&self) -> Mover {
        let (r, t) = self.matrix();
        Mover { r, t }
    }
}

/// A motion, ready to apply.
#[derive(Clone, Copy, Debug)]
pub struct Mover {
    r: DMat3,
    t: DVec3,
}

impl Mover {
    /// Where the point `p` (metres) of this frame was in the last one: `Rᵀ·(p − t)`.
    #[must_use]
    pub fn back(&self, p: [f64; 3]) -> [f64; 3] {
        let (c, t) = (self.r.to_cols_array_2d(), self.t.to_array());
        let d = [p[0] - t[0], p[1] - t[1], p[2] - t[2]];
        [0, 1, 2].map(|k| c[k][0] * d[0] + c[k][1] * d[1] + c[k][2] * d[2])
    }

    /// The sphere where the motion takes it; `None` where that is through or behind the camera.
    #[must_use]
    pub fn sphere(&self, s: &Sphere) -> Option<Sphere> {
        let (a, m) = (
            f64::from(s.a),
            [f64::from(s.m.x), f64::from(s.m.y), f64::from(s.m.z)],
        );
        let (c, t) = (self.r.to_cols_array_2d(), self.t.to_array());
        // written out: the order of operations is part of the format
        let mut turned = [0.0; 3];
        for (k, v) in turned.iter_mut().enumerate() {
            *v = c[0][k] * m[0] + c[1][k] * m[1] + c[2][k] * m[2];
        }
        let tt = t[0] * t[0] + t[1] * t[1] + t[2] * t[2];
        let d = 1.0 - a * tt + (turned[0] * t[0] + turned[1] * t[1] + turned[2] * t[2]);
        if d.abs() < 1e-6 {
            return None;
        }
        let [x, y, z] = [0, 1, 2].map(|k| ((turned[k] - 2.0 * a * t[k]) / d) as f32);
        let moved = Sphere {
            a: (a / d) as f32,
            m: glam::Vec3::new(x, y, z),
            far: s.far,
        };
        (moved.a.is_finite() && moved.m.is_finite()).then_some(moved)
    }
}

/// One observation: the middle of a block and the sphere that held it.
#[derive(Clone, Copy, Debug)]
pub struct Observation {
    /// Middle of the block's points, metres.
    pub point: DVec3,
    /// Contact distance there, metres.
    pub reach: f64,
    /// The last frame's sphere.
    pub sphere: Sphere,
}

/// The motion that brings the spheres onto the points; `None` without a clear one.
#[must_use]
pub fn estimate(observations: &[Observation]) -> Option<Motion> {
    if observations.len() < 30 {
        return None;
    }
    let (mut omega, mut shift) = (DVec3::ZERO, DVec3::ZERO);
    // from generous to strict: far-off blocks are boundaries and moving objects
    for width in [8.0, 3.0, 1.5, 1.0] {
        let (turn, back) = (rotation(-omega), shift);
        let mut system = [[0.0f64; 7]; 6];
        for o in observations {
            // the point in the last frame's axes, as far as the motion is known
            let p = turn * (o.point - back);
            let (a, m) = (f64::from(o.sphere.a), o.sphere.m.as_dvec3());
            let gradient = 2.0 * a * p + m;
            let length = gradient.length();
            if length == 0.0 {
                continue;
            }
            let n = gradient / length;
            let d = (a * p.length_squared() + m.dot(p) - 1.0) / length / o.reach;
            // Tukey's biweight
            let x = d / width;
            if x.abs() >= 1.0 {
                continue;
            }
            let weight = (1.0 - x * x) * (1.0 - x * x);
            let turned = p.cross(n) / o.reach;
            let n = n / o.reach;
            let row = [turned.x, turned.y, turned.z, n.x, n.y, n.z, d];
            for i in 0..6 {
                for j in i..7 {
                    system[i][j] += weight * row[i] * row[j];
                }
            }
        }
        // a frame's motion is some centimetres and some hundredths of a radian unless the data say more
        for (i, row) in system.iter_mut().enumerate() {
            row[i] += 400.0;
        }
        let x = solve(&mut system)?;
        // p_last = p − ω×p − t in the last frame's axes; compose to first order
        omega += DVec3::new(x[0], x[1], x[2]);
        shift = rotation(DVec3::new(x[0], x[1], x[2])) * shift + DVec3::new(x[3], x[4], x[5]);
    }
    Motion::new(omega, shift)
}

fn rotation(omega: DVec3) -> DMat3 {
    DMat3::from_quat(glam::DQuat::from_scaled_axis(omega))
}

/// Solves the symmetric system whose upper triangle and right-hand side are given.
fn solve(s: &mut [[f64; 7]; 6]) -> Option<[f64; 6]> {
    for i in 0..6 {
        for j in 0..i {
            s[i][j] = s[j][i];
        }
    }
    for i in 0..6 {
        if s[i][i] <= 1e-9 {
            return None;
        }
        for k in i + 1..6 {
            let f = s[k][i] / s[i][i];
            for j in i..7 {
                s[k][j] -= f * s[i][j];
            }
        }
    }
    let mut x = [0.0; 6];
    for i in (0..6).rev() {
        let known: f64 = (i + 1..6).map(|j| s[i][j] * x[j]).sum();
        x[i] = (s[i][6] - known) / s[i][i];
    }
    Some(x)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// A room: planes and balls, seen from the origin, and points on them.
    fn scene() -> Vec<(Sphere, Vec<DVec3>)> {
        let spheres = [
            (DVec3::new(0.0, 0.0, 9003.0), 9000.0),
            (DVec3::new(0.0, 9001.0, 2.0), 9000.0),
            (DVec3::new(-9001.5, 0.0, 2.0), 9000.0),
            (DVec3::new(0.3, 0.2, 2.0), 0.4),
            (DVec3::new(-0.6, -0.3, 2.5), 0.5),
        ];
        spheres
            .iter()
            .filter_map(|&(c, r)| {
                let sphere = Sphere::from_center_radius(c, r)?;
                let points = (0..400).map(|k| {
                    let (x, y) = (
                        f64::from(k % 20) * 0.04 - 0.4,
                        f64::from(k / 20) * 0.04 - 0.4,
                    );
                    let towards = (-c).normalize();
                    let side = towards.any_orthonormal_pair();
                    c + r * (towards + (side.0 * x + side.1 * y) / r.max(1.0)).normalize()
                });
                Some((sphere, points.collect()))
            })
            .collect()
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(40))]
        #[test]
        fn a_known_motion_is_found(w in prop::array::uniform3(-0.02f64..0.02), t in prop::array::uniform3(-0.03f64..0.03)) {
            let truth = Motion::new(DVec3::from_array(w), DVec3::from_array(t)).unwrap();
            let (r, t) = truth.matrix();
            let mut observations = Vec::new();
            for (sphere, points) in scene() {
                observations.extend(points.iter().map(|p| Observation { point: r * *p + t, reach: 0.01, sphere }));
            }
            let found = estimate(&observations).unwrap();
            let (fr, ft) = found.matrix();
            for o in &observations {
                let p = r.transpose() * (o.point - t);
                let error = (fr * p + ft - o.point).length();
                prop_assert!(error < 2e-3, "{error} m off: {found:?} for {truth:?}");
            }
        }

        #[test]
        fn a_moved_sphere_is_where_its_points_are(w in prop::array::uniform3(-0.3f64..0.3), t in prop::array::uniform3(-0.3f64..0.3)) {
            let motion = Motion::new(DVec3::from_array(w), DVec3::from_array(t)).unwrap();
            let (r, t) = motion.matrix();
            prop_assert!((r * r.transpose() - DMat3::IDENTITY).to_cols_array().iter().all(|e| e.abs() < 1e-12));
            for (sphere, points) in scene() {
                let moved = motion.mover().sphere(&sphere).unwrap();
                for p in points {
                    prop_assert!(moved.distance(r * p + t) < 2e-5 * (1.0 + p.length()));
                }
            }
        }
    }

    #[test]
    fn nothing_to_see_is_no_motion() {
        assert_eq!(estimate(&[]), None);
        assert!(Motion::default().is_still());
    }
}
