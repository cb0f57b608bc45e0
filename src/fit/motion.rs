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

/// Observations side by side.
const LANES: usize = 4;

/// Some observations, an array for each of their numbers.
#[derive(Clone, Copy, Debug)]
struct Group {
    point: [[f64; LANES]; 3],
    per_reach: [f64; LANES],
    a: [f64; LANES],
    m: [[f64; LANES]; 3],
}

/// An entry without an observation: it weighs nothing.
const EMPTY: Group = Group {
    point: [[0.0; LANES]; 3],
    per_reach: [0.0; LANES],
    a: [0.0; LANES],
    m: [[0.0; LANES], [0.0; LANES], [1.0; LANES]],
};

/// What is known of a motion.
#[derive(Clone, Debug, Default)]
pub struct Observations {
    groups: Vec<Group>,
    len: usize,
}

impl Observations {
    /// Forgets all of them, keeps the buffer.
    pub fn clear(&mut self) {
        self.groups.clear();
        self.len = 0;
    }

    /// Adds one.
    pub fn push(&mut self, o: &Observation) {
        let i = self.len % LANES;
        if i == 0 {
            self.groups.push(EMPTY);
        }
        if let Some(group) = self.groups.last_mut() {
            for (lanes, x) in group.point.iter_mut().zip(o.point.to_array()) {
                lanes[i] = x;
            }
            for (lanes, x) in group.m.iter_mut().zip(o.sphere.m.to_array()) {
                lanes[i] = f64::from(x);
            }
            group.per_reach[i] = 1.0 / o.reach;
            group.a[i] = f64::from(o.sphere.a);
        }
        self.len += 1;
    }
}

/// The motion that brings the spheres onto the points; `None` without a clear one.
#[must_use]
pub fn estimate(observations: &Observations) -> Option<Motion> {
    if observations.len < 30 {
        return None;
    }
    let (mut omega, mut shift) = (DVec3::ZERO, DVec3::ZERO);
    // from generous to strict: far-off blocks are boundaries and moving objects
    for width in [8.0, 3.0, 1.5, 1.0] {
        let mut system = [[0.0f64; 7]; 6];
        let turn = rotation(-omega).to_cols_array_2d();
        sum_up(
            &observations.groups,
            &turn,
            shift.to_array(),
            width,
            &mut system,
        );
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

/// The linear system of the step from the motion known so far (`turn`, columns of a rotation, after
/// `back`); observations beyond `width` contact distances have no say.
#[allow(unsafe_code)] // run-time dispatch generated by the macro
#[multiversion::multiversion(targets("x86_64+avx2"))]
fn sum_up(
    groups: &[Group],
    turn: &[[f64; 3]; 3],
    back: [f64; 3],
    width: f64,
    system: &mut [[f64; 7]; 6],
) {
    let mut sums = [[[0.0; LANES]; 7]; 6];
    let per_width = 1.0 / width;
    for g in groups {
        let (mut rows, mut weights) = ([[0.0; LANES]; 7], [0.0; LANES]);
        for i in 0..LANES {
            // the point in the last frame's axes, as far as the motion is known
            let d = [0, 1, 2].map(|k| g.point[k][i] - back[k]);
            let p = [0, 1, 2].map(|k| turn[0][k] * d[0] + turn[1][k] * d[1] + turn[2][k] * d[2]);
            let (a, m) = (g.a[i], [0, 1, 2].map(|k| g.m[k][i]));
            let gradient = [0, 1, 2].map(|k| 2.0 * a * p[k] + m[k]);
            let [x, y, z] = gradient;
            let square = x * x + y * y + z * z;
            let length = square.sqrt();
            let per_length = if square > 0.0 {
                g.per_reach[i] / length
            } else {
                0.0
            };
            let (pp, mp) = (
                p[0] * p[0] + p[1] * p[1] + p[2] * p[2],
                m[0] * p[0] + m[1] * p[1] + m[2] * p[2],
            );
            let n = gradient.map(|g| g * per_length);
            let off = (a * pp + mp - 1.0) * per_length;
            // Tukey's biweight
            let x = off * per_width;
            let near = (1.0 - x * x).max(0.0);
            weights[i] = near * near;
            let row = [
                p[1] * n[2] - p[2] * n[1],
                p[2] * n[0] - p[0] * n[2],
                p[0] * n[1] - p[1] * n[0],
                n[0],
                n[1],
                n[2],
                off,
            ];
            for (lanes, x) in rows.iter_mut().zip(row) {
                lanes[i] = x;
            }
        }
        for i in 0..6 {
            for j in i..7 {
                for k in 0..LANES {
                    sums[i][j][k] += weights[k] * rows[i][k] * rows[j][k];
                }
            }
        }
    }
    for (row, sums) in system.iter_mut().zip(&sums) {
        for (x, [a, b, c, d]) in row.iter_mut().zip(sums) {
            *x = (a + b) + (c + d);
        }
    }
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
            let mut all = Vec::new();
            for (sphere, points) in scene() {
                all.extend(points.iter().map(|p| Observation { point: r * *p + t, reach: 0.01, sphere }));
            }
            // the last group is not full
            all.pop();
            let mut observations = Observations::default();
            all.iter().for_each(|o| observations.push(o));
            let found = estimate(&observations).unwrap();
            let (fr, ft) = found.matrix();
            for o in &all {
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
        assert_eq!(estimate(&Observations::default()), None);
        assert!(Motion::default().is_still());
    }
}
