//! Analytic surfaces and the closed forms of their inverse depth.
//!
//! Along the ray `r = (u, v, 1)` every surface here has an inverse depth `w = 1/z` without an
//! iteration: a plane is affine in `(u, v)`, a sphere or a cylinder takes one square root, and a
//! convex solid is the intersection of the intervals of its parts. The nearest surface is the one
//! with the largest `w`, so "nothing there" is simply `w = 0`.

use glam::{DQuat, DVec3};

/// A surface in world coordinates, metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Shape {
    /// All points with `normal · p = offset`; the normal has unit length. Seen from both sides.
    Plane {
        /// Unit normal.
        normal: DVec3,
        /// Signed distance of the plane from the world's origin, metres.
        offset: f64,
    },
    /// A ball, or a curved wall when the camera is inside.
    Sphere {
        /// Centre, metres.
        center: DVec3,
        /// Radius, metres.
        radius: f64,
    },
    /// A solid box. Not drawn when the camera is inside.
    Box {
        /// Centre, metres.
        center: DVec3,
        /// Half of its edges, metres.
        half: DVec3,
        /// Box axes to world axes.
        rotation: DQuat,
    },
    /// A solid cylinder with flat caps. Not drawn when the camera is inside.
    Cylinder {
        /// Middle of the axis, metres.
        center: DVec3,
        /// Unit direction of the axis.
        axis: DVec3,
        /// Radius, metres.
        radius: f64,
        /// Half of its length, metres.
        half_length: f64,
    },
}

/// A shape and how well a sensor sees it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Surface {
    /// Its geometry.
    pub shape: Shape,
    /// How much more often than usual it gives no depth, in standard deviations of the speckle
    /// field (0 = ordinary, 1.5 = dark or glossy: about one pixel in six lost).
    pub dropout: f32,
    /// True where it moves from frame to frame.
    pub moves: bool,
}

/// Camera-to-world: where the camera is and how it is turned.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// Camera axes to world axes.
    pub rotation: DQuat,
    /// Camera centre in the world, metres.
    pub position: DVec3,
}

impl Default for Pose {
    fn default() -> Self {
        Self {
            rotation: DQuat::IDENTITY,
            position: DVec3::ZERO,
        }
    }
}

impl Pose {
    /// A world point in the camera's optical frame, metres.
    #[must_use]
    pub fn to_camera(&self, world: DVec3) -> DVec3 {
        self.rotation.inverse() * (world - self.position)
    }

    /// A point of the camera's optical frame in the world, metres.
    #[must_use]
    pub fn to_world(&self, camera: DVec3) -> DVec3 {
        self.rotation * camera + self.position
    }
}

/// The closed form of one surface seen from one pose. Vectors are in the camera frame and act on
/// the ray `(u, v, 1)`.
#[derive(Clone, Copy, Debug)]
#[allow(
    clippy::large_enum_variant,
    reason = "one at a time, on the stack: boxing would allocate per surface and frame"
)]
pub(super) enum Form {
    /// `w = m·r`
    Plane { m: DVec3 },
    /// `w = (m·r + √((m·r)² + 4a·r·r)) / 2`
    Sphere { a: f64, m: DVec3 },
    /// Entered at the least of `front·r`, left at the greatest of `back·r`.
    Convex {
        front: [DVec3; 3],
        back: [DVec3; 5],
        barrel: Option<Barrel>,
    },
}

/// The round side of a cylinder: with everything taken across the axis, `w` solves
/// `k·w² − 2(c·r)w + r·r = 0`.
#[derive(Clone, Copy, Debug)]
pub(super) struct Barrel {
    /// Distance² of the camera from the axis minus radius², positive outside.
    pub k: f64,
    /// Axis foot point, across the axis.
    pub c: DVec3,
    /// Unit axis.
    pub axis: DVec3,
}

impl Shape {
    /// A ball that holds the whole shape: centre (world) and radius, metres; `None` when endless.
    #[must_use]
    pub fn bound(&self) -> Option<(DVec3, f64)> {
        match *self {
            Self::Plane { .. } => None,
            Self::Sphere { center, radius } => Some((center, radius)),
            Self::Box { center, half, .. } => Some((center, half.length())),
            Self::Cylinder {
                center,
                radius,
                half_length,
                ..
            } => Some((center, radius.hypot(half_length))),
        }
    }

    /// The closed form as seen from `pose`; `None` where it cannot be seen from there (camera
    /// inside a solid, or exactly on the surface).
    pub(super) fn seen_from(&self, pose: &Pose) -> Option<Form> {
        let turn = pose.rotation.inverse();
        match *self {
            Self::Plane { normal, offset } => {
                let m = turn * normal / (offset - normal.dot(pose.position));
                m.is_finite().then_some(Form::Plane { m })
            }
            Self::Sphere { center, radius } => {
                let c = pose.to_camera(center);
                let a = 1.0 / (radius * radius - c.length_squared());
                let m = c * (-2.0 * a);
                (a.is_finite() && m.is_finite()).then_some(Form::Sphere { a, m })
            }
            Self::Box {
                center,
                half,
                rotation,
            } => {
                let c = pose.to_camera(center);
                let axes = [DVec3::X, DVec3::Y, DVec3::Z].map(|axis| turn * (rotation * axis));
                let mut sides = Sides::new();
                for (axis, half) in axes.into_iter().zip(half.to_array()) {
                    sides.slab(axis, axis.dot(c), half);
                }
                // a camera inside sees nothing, and six backs
                (sides.fronts > 0).then(|| sides.convex(None))
            }
            Self::Cylinder {
                center,
                axis,
                radius,
                half_length,
            } => {
                let c = pose.to_camera(center);
                let axis = turn * axis;
                let across = c - axis * axis.dot(c);
                let k = across.length_squared() - radius * radius;
                let mut sides = Sides::new();
                sides.slab(axis, axis.dot(c), half_length);
                // inside the endless cylinder only a cap can be entered
                if k == 0.0 || (k < 0.0 && sides.fronts == 0) {
                    return None;
                }
                Some(sides.convex(Some(Barrel { k, c: across, axis })))
            }
        }
    }
}

/// Half-spaces sorted by the side of them the camera is on. Unused places bound nothing.
struct Sides {
    front: [DVec3; 3],
    back: [DVec3; 5],
    fronts: usize,
    backs: usize,
}

impl Sides {
    fn new() -> Self {
        Self {
            front: [DVec3::new(0.0, 0.0, 1e12); 3],
            back: [DVec3::ZERO; 5],
            fronts: 0,
            backs: 0,
        }
    }

    /// Adds the two planes `axis · p = along ± half`.
    fn slab(&mut self, axis: DVec3, along: f64, half: f64) {
        for (normal, offset) in [(axis, along + half), (-axis, half - along)] {
            // inside is normal·p <= offset; the camera, at the origin, is outside for offset < 0
            let offset = if offset == 0.0 { 1e-12 } else { offset };
            let m = normal / offset;
            if offset < 0.0 {
                // a slab has at most one of its planes before the camera, a box three
                self.front[self.fronts] = m;
                self.fronts += 1;
            } else if self.backs < self.back.len() {
                self.back[self.backs] = m;
                self.backs += 1;
            }
        }
    }

    fn convex(&self, barrel: Option<Barrel>) -> Form {
        Form::Convex {
            front: self.front,
            back: self.back,
            barrel,
        }
    }
}
