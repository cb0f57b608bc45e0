//! The scenes: surfaces and camera pose as functions of time.
//!
//! World axes are the camera's own at rest (x right, y down, z forward), metres, the camera 1.1 m
//! above the floor. A scene is a pure function of (scene, seed, shot, time): any frame can be made
//! without the ones before it.

use super::random::{Stream, mix};
use super::surface::{Pose, Shape, Surface};
use glam::{DQuat, DVec3};
use std::f64::consts::TAU;

/// What the synthetic camera looks at.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scene {
    /// Still camera, still room.
    Room,
    /// Hand-held camera moving through the room.
    Walk,
    /// Still camera; a person of spheres juggles, a box crosses.
    Juggle,
    /// Spheres before nothing.
    Spheres,
    /// One tilted plane.
    Plane,
    /// The room from another place every `cut` frames.
    Cut,
    /// The room, interrupted by frames of pure noise.
    Noise,
    /// Every second pixel 1 m, the others 2 m.
    Checkerboard,
    /// No pixel measured.
    Empty,
    /// The room, lost pixels marked 65535 instead of 0.
    Codes65535,
    /// The juggler, seen by a camera that falls silent for a second now and then.
    Stall,
}

impl Scene {
    /// All scenes, with the name and the one-line description shown to people.
    pub const ALL: [(Self, &'static str, &'static str); 11] = [
        (Self::Room, "room", "still camera, still room"),
        (Self::Walk, "walk", "hand-held camera moving in the room"),
        (
            Self::Juggle,
            "juggle",
            "still camera, a juggler and a crossing box",
        ),
        (Self::Spheres, "spheres", "spheres before nothing"),
        (Self::Plane, "plane", "one tilted plane"),
        (Self::Cut, "cut", "another view every 30 frames (cut=N)"),
        (
            Self::Noise,
            "noise",
            "the room and bursts of pure noise (burst=N)",
        ),
        (
            Self::Checkerboard,
            "checkerboard",
            "1 m and 2 m in alternate pixels",
        ),
        (Self::Empty, "empty", "no pixel measured"),
        (
            Self::Codes65535,
            "codes65535",
            "the room, holes marked 65535",
        ),
        (
            Self::Stall,
            "stall",
            "the juggler; silent for a second every 60 frames (stall=N)",
        ),
    ];

    /// The scene of that name.
    #[must_use]
    pub fn named(name: &str) -> Option<Self> {
        let found = Self::ALL.iter().find(|entry| entry.1 == name);
        found.map(|entry| entry.0)
    }

    /// Its name.
    #[must_use]
    pub fn name(self) -> &'static str {
        // ALL holds every variant (tested)
        let found = Self::ALL.iter().find(|entry| entry.0 == self);
        found.map_or("", |entry| entry.1)
    }

    /// True where the camera stands still within a shot.
    pub(super) fn camera_is_still(self) -> bool {
        self != Self::Walk
    }
}

/// One instant of a scene.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct World {
    pub surfaces: Vec<Surface>,
    pub pose: Pose,
}

impl World {
    /// Sets the world to `scene` at `time_s`, in the given shot (0 unless the scene is cut).
    /// What does not move comes first.
    pub fn set(&mut self, scene: Scene, seed: u64, shot: u64, time_s: f64) {
        self.surfaces.clear();
        self.pose = Pose::default();
        let mut chance = Stream::new(mix(seed, shot));
        match scene {
            Scene::Room | Scene::Cut | Scene::Noise | Scene::Codes65535 => {
                self.room(&mut chance);
            }
            Scene::Walk => {
                self.room(&mut chance);
                self.pose = walk(time_s);
            }
            Scene::Juggle | Scene::Stall => {
                self.room(&mut chance);
                self.juggler(time_s);
            }
            Scene::Spheres => self.spheres(&mut chance),
            Scene::Plane => {
                let normal = DVec3::new(0.25, -0.35, -1.0).normalize();
                self.still(Shape::Plane {
                    normal,
                    offset: normal.dot(DVec3::new(0.0, 0.0, 1.5)),
                });
            }
            Scene::Checkerboard | Scene::Empty => {}
        }
        if shot > 0 {
            self.pose.rotation = DQuat::from_rotation_y(0.4 * chance.signed())
                * DQuat::from_rotation_x(0.1 * chance.signed());
            self.pose.position = DVec3::new(
                0.4 * chance.signed(),
                0.2 * chance.signed(),
                0.5 * chance.signed(),
            );
        }
    }

    fn still(&mut self, shape: Shape) {
        self.surfaces.push(Surface {
            shape,
            dropout: 0.0,
            moves: false,
        });
    }

    fn ball(&mut self, center: DVec3, radius: f64, moves: bool) {
        self.surfaces.push(Surface {
            shape: Shape::Sphere { center, radius },
            dropout: 0.0,
            moves,
        });
    }

    fn room(&mut self, chance: &mut Stream) {
        let floor = 1.1;
        for (normal, offset) in [
            (DVec3::Y, floor),
            (DVec3::Y, -1.5),
            (DVec3::X, -1.9),
            (DVec3::X, 2.1),
        ] {
            self.still(Shape::Plane { normal, offset });
        }
        // the far wall, 3.6 m away, is bent: a sphere of 20 m around the camera
        self.ball(DVec3::new(0.2, -0.1, -16.4), 20.0, false);
        let table = DVec3::new(0.35, 0.75, 2.3);
        let turned = DQuat::from_rotation_y(0.35 + 0.2 * chance.signed());
        let half = DVec3::new(0.55, 0.35, 0.35);
        self.still(Shape::Box {
            center: table,
            half,
            rotation: turned,
        });
        let top = table.y - half.y;
        self.still(Shape::Box {
            center: table + turned * DVec3::new(0.36, -half.y - 0.09, 0.1),
            half: DVec3::new(0.11, 0.09, 0.07),
            rotation: DQuat::from_rotation_y(1.1 * chance.signed()),
        });
        self.still(Shape::Cylinder {
            center: table + turned * DVec3::new(0.08, -half.y - 0.12, -0.15),
            axis: DVec3::Y,
            radius: 0.05,
            half_length: 0.12,
        });
        for (x, z, radius) in [(-0.35, 0.05, 0.13), (-0.12, -0.18, 0.07), (0.1, 0.2, 0.1)] {
            let radius = radius * (1.0 + 0.1 * chance.signed());
            let place = table + turned * DVec3::new(x, 0.0, z);
            self.ball(DVec3::new(place.x, top - radius, place.z), radius, false);
        }
        let x = -0.85 + 0.1 * chance.signed();
        self.ball(DVec3::new(x, floor - 0.27, 2.4), 0.27, false);
        self.ball(DVec3::new(-0.35, floor - 0.2, 2.9), 0.2, false);
        if let Some(dark) = self.surfaces.last_mut() {
            dark.dropout = 1.5;
        }
        self.still(Shape::Cylinder {
            center: DVec3::new(-1.25, -0.2, 3.1),
            axis: DVec3::Y,
            radius: 0.16,
            half_length: 1.3,
        });
    }

    fn juggler(&mut self, time_s: f64) {
        let sway = (time_s * TAU / 6.0).sin();
        let hips = DVec3::new(0.5 * sway - 0.35, 0.25, 1.75);
        let step = (time_s * TAU / 1.2).sin();
        for (x, y, z, radius) in [
            (0.0, -0.78, 0.0, 0.115),
            (0.0, -0.62, 0.0, 0.07),
            (0.0, -0.42, 0.0, 0.19),
            (0.0, -0.2, 0.0, 0.17),
            (0.0, 0.0, 0.0, 0.18),
            (0.1, 0.3, -0.1 * step, 0.1),
            (-0.1, 0.3, 0.1 * step, 0.1),
            (0.11, 0.6, -0.2 * step, 0.08),
            (-0.11, 0.6, 0.2 * step, 0.08),
            (0.25, -0.42, -0.06, 0.07),
            (-0.25, -0.42, -0.06, 0.07),
            (0.28, -0.22, -0.2, 0.055),
            (-0.28, -0.22, -0.2, 0.055),
        ] {
            self.ball(hips + DVec3::new(x, y, z), radius, true);
        }
        for number in 0..3 {
            // three-ball cascade: each throw goes to the other hand, half a metre up
            let throws = time_s / 0.9 + f64::from(number) * 2.0 / 3.0;
            let flown = throws.fract();
            let side = if throws as i64 % 2 == 0 { 1.0 } else { -1.0 };
            let place = DVec3::new(
                side * (0.25 - 0.5 * flown),
                -0.2 - 2.0 * flown * (1.0 - flown),
                -0.35,
            );
            self.ball(hips + place, 0.06, true);
        }
        let across = time_s * TAU / 5.0;
        self.surfaces.push(Surface {
            shape: Shape::Box {
                center: DVec3::new(1.1 * across.sin(), 0.32, 1.15 + 0.1 * across.cos()),
                half: DVec3::new(0.13, 0.09, 0.11),
                rotation: DQuat::from_rotation_y(across) * DQuat::from_rotation_z(0.3),
            },
            dropout: 0.0,
            moves: true,
        });
    }

    fn spheres(&mut self, chance: &mut Stream) {
        for number in 0..6 {
            let z = 1.0 + 0.4 * f64::from(number);
            let center = DVec3::new(0.35 * z * chance.signed(), 0.25 * z * chance.signed(), z);
            self.ball(center, 0.12 * z * (1.0 + 0.4 * chance.signed()), false);
        }
    }
}

/// A hand-held walk: a slow loop, and the tremor of a hand at 1 to 5 Hz.
fn walk(time_s: f64) -> Pose {
    let wave = |amplitude: f64, hertz: f64, phase: f64| {
        amplitude * ((TAU * hertz * time_s + phase).sin() - phase.sin())
    };
    Pose {
        rotation: DQuat::from_rotation_y(wave(0.25, 0.11, 0.4) + wave(0.003, 3.1, 0.0))
            * DQuat::from_rotation_x(wave(0.06, 0.17, 0.0) + wave(0.003, 4.3, 1.0))
            * DQuat::from_rotation_z(wave(0.03, 0.13, 0.7) + wave(0.002, 2.3, 2.0)),
        position: DVec3::new(
            wave(0.45, 0.12, 0.0) + wave(0.002, 2.7, 0.5),
            wave(0.08, 0.19, 1.0) + wave(0.012, 1.8, 0.0),
            wave(0.35, 0.09, 0.3) + wave(0.002, 3.7, 0.0),
        ),
    }
}
