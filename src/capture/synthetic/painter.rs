//! One frame of the synthetic sensor: scene, view, noise in turn.

use super::field::White;
use super::noise::{Coding, Noise, pure_noise};
use super::options::SyntheticOptions;
use super::random::mix;
use super::render::{Renderer, View};
use super::scene::{Scene, World};
use super::sensor::NoiseModel;
use super::surface::{Pose, Shape};
use super::truth::{SceneTruth, TrueSphere};
use crate::frame::{Camera, Intrinsics};
use glam::DVec3;

/// Depth of the pattern that lasting noise seems to stick to when the camera moves, metres.
const PATTERN_DEPTH_M: f64 = 2.5;

/// Makes any frame of one stream; holds no memory of the frames before but its scratch.
#[derive(Debug)]
pub(super) struct Painter {
    options: SyntheticOptions,
    camera: Camera,
    world: World,
    renderer: Renderer,
    view: View,
    noise: Noise,
    dropout: Vec<f32>,
}

impl Painter {
    pub fn new(options: &SyntheticOptions) -> Self {
        let camera = camera(options);
        let (width, height) = (camera.width as usize, camera.height as usize);
        let coding = Coding {
            unit_m: camera.depth_unit_m,
            hole: if options.scene == Scene::Codes65535 {
                u16::MAX
            } else {
                0
            },
            focal_px: camera.intrinsics.fx,
        };
        Self {
            options: *options,
            world: World::default(),
            renderer: Renderer::new(width, height, camera.intrinsics),
            view: View::default(),
            noise: Noise::new(options.noise.sensor(), coding, width),
            dropout: Vec::new(),
            camera,
        }
    }

    pub fn camera(&self) -> &Camera {
        &self.camera
    }

    /// Fills `depth` (resized to the image) with frame `index`.
    pub fn paint(&mut self, index: u64, depth: &mut Vec<u16>) {
        depth.resize(self.camera.pixels(), 0);
        let frame_key = mix(self.options.seed ^ 0x6672_616d, index) as u32;
        let run = index.checked_div(self.options.burst);
        if run.is_some_and(|run| run % 2 == 1) {
            pure_noise(frame_key, depth);
            return;
        }
        self.look(index);
        if self.options.noise == NoiseModel::Off {
            self.noise.exact(&self.view, depth);
            return;
        }
        self.dropout.clear();
        self.dropout.push(0.0);
        self.dropout
            .extend(self.world.surfaces.iter().map(|s| s.dropout));
        let white = White {
            lasting: mix(self.options.seed ^ 0x6c61_7374, self.shot(index)) as u32,
            fleeting: frame_key,
            shift: self.pattern_shift(),
        };
        self.noise.apply(&self.view, &self.dropout, white, depth);
    }

    /// What is really there in frame `index`.
    pub fn truth(&mut self, index: u64) -> SceneTruth {
        self.look(index);
        let pose = self.world.pose;
        let spheres = self.world.surfaces.iter().zip(1_u16..);
        SceneTruth {
            index,
            pose,
            depth_m: self
                .view
                .inverse_depth
                .iter()
                .map(|&w| if w > 0.0 { 1.0 / w } else { 0.0 })
                .collect(),
            surface: self.view.surface.clone(),
            spheres: spheres
                .filter_map(|(surface, id)| match surface.shape {
                    Shape::Sphere { center, radius } => Some(TrueSphere {
                        surface: id,
                        center_m: pose.to_camera(center),
                        radius_m: radius,
                    }),
                    _ => None,
                })
                .collect(),
            surfaces: self.world.surfaces.clone(),
        }
    }

    fn shot(&self, index: u64) -> u64 {
        index.checked_div(self.options.cut).unwrap_or(0)
    }

    /// Renders the exact view of frame `index`.
    fn look(&mut self, index: u64) {
        let (scene, shot) = (self.options.scene, self.shot(index));
        let time_s = index as f64 / self.options.fps;
        self.world.set(scene, self.options.seed, shot, time_s);
        let place = self.options.placement();
        self.world.pose = Pose {
            position: place.to_world(self.world.pose.position),
            rotation: place.rotation * self.world.pose.rotation,
        };
        let still = scene.camera_is_still().then_some(shot);
        self.renderer.draw(
            &self.world.surfaces,
            &self.world.pose,
            still,
            &mut self.view,
        );
        if scene == Scene::Checkerboard {
            checkerboard(&mut self.view, self.camera.width as usize);
        }
    }

    /// How far the picture has moved since the camera was at rest, at a typical depth, whole
    /// pixels: lasting noise comes from the surfaces' texture and moves with them.
    fn pattern_shift(&self) -> (i32, i32) {
        let mark = self
            .world
            .pose
            .to_camera(DVec3::new(0.0, 0.0, PATTERN_DEPTH_M));
        let k = &self.camera.intrinsics;
        if self.world.pose == Pose::default() || mark.z < 0.1 * PATTERN_DEPTH_M {
            return (0, 0);
        }
        let moved = (k.fx * mark.x / mark.z, k.fy * mark.y / mark.z);
        (-moved.0.round() as i32, -moved.1.round() as i32)
    }
}

/// 1 m and 2 m in alternate pixels.
fn checkerboard(view: &mut View, width: usize) {
    let pixels = view.inverse_depth.iter_mut().zip(&mut view.surface);
    for (pixel, (w, surface)) in pixels.enumerate() {
        let near = (pixel % width + pixel / width).is_multiple_of(2);
        *w = if near { 1.0 } else { 0.5 };
        *surface = if near { 1 } else { 2 };
    }
}

/// The camera of these options. The principal point is off the middle by a hundredth of the
/// image, as in real cameras, so that a mix-up shows.
fn camera(options: &SyntheticOptions) -> Camera {
    let sensor = options.noise.sensor();
    let (width, height) = (f64::from(options.width), f64::from(options.height));
    let focal = sensor.focal_per_width * width;
    let codes = (options.unit_m, 65534.0 * options.unit_m);
    Camera {
        width: options.width,
        height: options.height,
        intrinsics: Intrinsics {
            fx: focal,
            fy: focal,
            cx: (width - 1.0) / 2.0 + 0.01 * width,
            cy: (height - 1.0) / 2.0 - 0.01 * height,
        },
        depth_unit_m: options.unit_m,
        invalid: match options.scene {
            Scene::Codes65535 => vec![0, u16::MAX],
            _ => vec![0],
        },
        depth_min_m: sensor.range_m.0.max(codes.0),
        depth_max_m: sensor.range_m.1.min(codes.1),
        fps: Some(options.fps),
        name: format!("synthetic:{}", options.scene.name()),
    }
}
