//! Ray casting: surfaces to inverse depth, row by row, in f64.
//!
//! O(pixels × surfaces whose bounding rectangle holds them); no trigonometry and no allocation in
//! a frame once warm. What does not move under a still camera is drawn once and copied.

use super::surface::{Form, Pose, Shape, Surface};
use crate::frame::Intrinsics;
use glam::DVec3;
use multiversion::multiversion;

/// A rendered view: inverse planar depth (1/m, 0 = nothing) and surface number per pixel
/// (0 = nothing, else 1 + the surface's place in the scene), both row-major.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct View {
    pub inverse_depth: Vec<f64>,
    pub surface: Vec<u16>,
}

impl View {
    fn cleared(&mut self, pixels: usize) {
        self.inverse_depth.clear();
        self.inverse_depth.resize(pixels, 0.0);
        self.surface.clear();
        self.surface.resize(pixels, 0);
    }
}

/// Casts the rays of one camera.
#[derive(Debug)]
pub(super) struct Renderer {
    width: usize,
    height: usize,
    intrinsics: Intrinsics,
    /// Ray slope of each column.
    u: Vec<f64>,
    /// What stands still, and the shot it belongs to.
    background: Option<(u64, View)>,
}

impl Renderer {
    pub fn new(width: usize, height: usize, intrinsics: Intrinsics) -> Self {
        Self {
            width,
            height,
            intrinsics,
            u: (0..width)
                .map(|x| (x as f64 - intrinsics.cx) / intrinsics.fx)
                .collect(),
            background: None,
        }
    }

    /// Draws `surfaces` from `pose`. `still` names the shot when its camera does not move: all
    /// frames of one shot then share the surfaces that do not move.
    pub fn draw(&mut self, surfaces: &[Surface], pose: &Pose, still: Option<u64>, view: &mut View) {
        let pixels = self.width * self.height;
        let Some(shot) = still else {
            view.cleared(pixels);
            self.add(surfaces, pose, |_| true, view);
            return;
        };
        if self.background.as_ref().is_none_or(|(of, _)| *of != shot) {
            let mut background = self.background.take().map(|b| b.1).unwrap_or_default();
            background.cleared(pixels);
            self.add(surfaces, pose, |s| !s.moves, &mut background);
            self.background = Some((shot, background));
        }
        if let Some((_, background)) = &self.background {
            view.inverse_depth.clone_from(&background.inverse_depth);
            view.surface.clone_from(&background.surface);
        }
        self.add(surfaces, pose, |s| s.moves, view);
    }

    fn add(
        &self,
        surfaces: &[Surface],
        pose: &Pose,
        wanted: impl Fn(&Surface) -> bool,
        view: &mut View,
    ) {
        for (surface, id) in surfaces.iter().zip(1_u16..) {
            if !wanted(surface) {
                continue;
            }
            let Some(form) = surface.shape.seen_from(pose) else {
                continue;
            };
            let (columns, rows) = self.rectangle(&surface.shape, pose);
            for y in rows {
                let v = (y as f64 - self.intrinsics.cy) / self.intrinsics.fy;
                let row = y * self.width;
                let span = row + columns.start..row + columns.end;
                cast_row(
                    &form,
                    &self.u[columns.clone()],
                    v,
                    id,
                    &mut view.inverse_depth[span.clone()],
                    &mut view.surface[span],
                );
            }
        }
    }

    /// Columns and rows the shape can cover: the tangents of its bounding ball.
    fn rectangle(
        &self,
        shape: &Shape,
        pose: &Pose,
    ) -> (std::ops::Range<usize>, std::ops::Range<usize>) {
        let k = &self.intrinsics;
        match shape.bound() {
            None => (0..self.width, 0..self.height),
            Some((center, radius)) => {
                let c = pose.to_camera(center);
                (
                    pixels(tangents(c.x, c.z, radius), k.fx, k.cx, self.width),
                    pixels(tangents(c.y, c.z, radius), k.fy, k.cy, self.height),
                )
            }
        }
    }
}

/// Slopes `(least, greatest)` of the rays that touch a disc at `(side, ahead)`; infinite where it
/// reaches behind the camera.
fn tangents(side: f64, ahead: f64, radius: f64) -> (f64, f64) {
    let distance = side.hypot(ahead);
    if distance <= radius {
        return (f64::NEG_INFINITY, f64::INFINITY);
    }
    let (middle, spread) = (side.atan2(ahead), (radius / distance).asin());
    let right_angle = std::f64::consts::FRAC_PI_2;
    let slope = |angle: f64| {
        if angle <= -right_angle {
            f64::NEG_INFINITY
        } else if angle >= right_angle {
            f64::INFINITY
        } else {
            angle.tan()
        }
    };
    (slope(middle - spread), slope(middle + spread))
}

fn pixels(slopes: (f64, f64), focal: f64, center: f64, size: usize) -> std::ops::Range<usize> {
    // one pixel of margin against rounding; `as` clamps to 0
    let first = (slopes.0 * focal + center - 1.0).floor() as usize;
    let last = (slopes.1 * focal + center + 2.0).ceil() as usize;
    let end = last.min(size);
    first.min(end)..end
}

/// Draws one row of one surface where it is nearer than what is there. `u`, `best` and `id` have
/// equal lengths. Same result with and without AVX2: no fused multiply-add.
#[multiversion(targets("x86_64+avx2"))]
fn cast_row(form: &Form, u: &[f64], v: f64, surface: u16, best: &mut [f64], id: &mut [u16]) {
    assert!(u.len() == best.len() && u.len() == id.len());
    let at = |m: DVec3| (m.x, m.y * v + m.z);
    match *form {
        Form::Plane { m } => {
            let (mx, m0) = at(m);
            // it is before the camera on one side of its horizon only
            let seen = if mx > 0.0 {
                u.partition_point(|&u| mx * u + m0 <= 0.0)..u.len()
            } else {
                0..u.partition_point(|&u| mx * u + m0 > 0.0)
            };
            let (best, id) = (&mut best[seen.clone()], &mut id[seen.clone()]);
            for ((&u, best), id) in u[seen].iter().zip(best).zip(id) {
                let w = mx * u + m0;
                let nearer = w > *best;
                *best = if nearer { w } else { *best };
                *id = if nearer { surface } else { *id };
            }
        }
        Form::Sphere { a, m } => {
            let (mx, m0) = at(m);
            let q0 = v * v + 1.0;
            for ((&u, best), id) in u.iter().zip(best).zip(id) {
                let l = mx * u + m0;
                // a ray that misses gives NaN, which never compares as nearer
                let w = 0.5 * (l + (l * l + 4.0 * a * (u * u + q0)).sqrt());
                let nearer = w > *best;
                *best = if nearer { w } else { *best };
                *id = if nearer { surface } else { *id };
            }
        }
        Form::Convex {
            front,
            back,
            barrel,
        } => {
            let (front, back) = (front.map(at), back.map(at));
            // a solid without a round side: bounds nothing
            let (k, c, axis) =
                barrel.map_or((0.0, DVec3::ZERO, DVec3::ZERO), |b| (b.k, b.c, b.axis));
            let ((cx, c0), (ax, a0)) = (at(c), at(axis));
            let q0 = v * v + 1.0;
            for ((&u, best), id) in u.iter().zip(best).zip(id) {
                let mut enter = f64::INFINITY;
                for (x, o) in front {
                    let w = x * u + o;
                    enter = if w < enter { w } else { enter };
                }
                let mut exit = 0.0;
                for (x, o) in back {
                    let w = x * u + o;
                    exit = if w > exit { w } else { exit };
                }
                if barrel.is_some() {
                    let along = ax * u + a0;
                    let across = u * u + q0 - along * along;
                    let b = cx * u + c0;
                    let root = (b * b - k * across).sqrt();
                    let w = (b + root) / k;
                    enter = if k < 0.0 || w > enter { enter } else { w };
                    let w = (b - root) / k;
                    exit = if w <= exit { exit } else { w };
                }
                let nearer = enter > *best && enter >= exit;
                *best = if nearer { enter } else { *best };
                *id = if nearer { surface } else { *id };
            }
        }
    }
}
