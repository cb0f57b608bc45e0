//! The paper's own schemes on depth frames: each frame is a cloud, fitted from nothing.
//!
//! A frame's measurements become points ([`LocalPoints`]), the progressive or the random scheme
//! fits them ([`CloudFit`]), and the model is put on the sensor's ray grid as the live fit's is
//! ([`super::live`]), so that the same encoder takes both.
//!
//! What changes on the way. A cloud's contact is the distance from the surface, a frame's the
//! distance along the pixel's ray in the decoder's arithmetic, which is never shorter. A pixel
//! whose own sphere is too far along its ray takes a neighbour's, or none.
//!
//! These schemes are not anytime: a fit that has begun runs to its end, which may take seconds.
//! The deadline is asked before it only.

use super::cloud::{CloudModel, CloudSphere, FitParameters, UNASSIGNED};
use super::live::FitReport;
use super::motion::Motion;
use super::scheme::{CloudFit, ParameterError};
use super::sphere::Sphere;
use crate::contact_map::contact::Reach;
use crate::contact_map::labels::{Contacts, INVALID, NO_SPHERE, SaintFrame};
use crate::deproject::{Rays, Validity};
use crate::frame::{Camera, DepthFrame};
use crate::partition::points::{LocalPoints, TooManyPoints};
use glam::{DVec3, Vec3};

/// Why a frame cannot be fitted as a cloud.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum FrameFitError {
    /// Parameters out of range.
    #[error(transparent)]
    Parameters(#[from] ParameterError),
    /// More pixels than a cloud may have points.
    #[error(transparent)]
    Points(#[from] TooManyPoints),
}

/// The progressive or random scheme for the frames of one camera, with its buffers.
#[derive(Debug)]
pub struct FrameFit {
    rays: Rays,
    validity: Validity,
    reach: Reach,
    parameters: FitParameters,
    cloud: FrameCloud,
    fit: CloudFit,
    sides: Vec<Sides>,
    spheres: Vec<Sphere>,
    numbers: Numbers,
}

/// A frame's measured pixels as points.
#[derive(Debug, Default)]
pub struct FrameCloud {
    /// The points, metres, optical frame, row by row.
    pub points: LocalPoints,
    /// Pixel of each point, `y * width + x`.
    pub pixels: Vec<u32>,
    positions: Vec<DVec3>,
}

impl FrameCloud {
    /// Takes in the measured pixels of a frame of `rays.width * rays.height` pixels.
    ///
    /// # Errors
    /// More pixels than a `u32` can number.
    pub fn refill(
        &mut self,
        rays: &Rays,
        validity: &Validity,
        frame: &DepthFrame,
    ) -> Result<(), TooManyPoints> {
        self.pixels.clear();
        self.positions.clear();
        let unit = f64::from(rays.unit);
        for (y, row) in frame.depth.chunks_exact(rays.width).enumerate() {
            for (x, &raw) in row
                .iter()
                .enumerate()
                .filter(|(_, r)| validity.accepts(**r))
            {
                self.pixels.push((y * rays.width + x) as u32);
                self.positions.push(rays.point(x, y, f64::from(raw) * unit));
            }
        }
        self.points.refill(&self.positions)
    }
}

/// One sphere of the cloud as the camera may see it: from outside its near and its far side are
/// two surfaces, each with a number of its own.
#[derive(Clone, Copy, Debug)]
struct Sides {
    surface: Option<Sphere>,
    pixels: [u32; 2],
    number: [u16; 2],
}

impl Sides {
    /// 1 where the point at inverse depth `w` lies on the far side, else 0.
    fn of(surface: &Sphere, w: f32, u: f32, v: f32) -> usize {
        let l = surface.m.dot(Vec3::new(u, v, 1.0));
        usize::from(surface.a < 0.0 && 2.0 * w < l)
    }
}

impl FrameFit {
    /// For frames of `camera`. At most 65533 spheres, whatever `parameters` allow.
    ///
    /// # Errors
    /// Parameters out of range.
    pub fn new(camera: &Camera, parameters: &FitParameters) -> Result<Self, ParameterError> {
        parameters.check()?;
        Ok(Self {
            rays: Rays::new(camera),
            validity: Validity::new(camera),
            reach: Reach::new(&parameters.contact_distance, camera.depth_unit_m),
            parameters: FitParameters {
                max_spheres: parameters.max_spheres.min(usize::from(NO_SPHERE) - 1),
                ..*parameters
            },
            cloud: FrameCloud::default(),
            fit: CloudFit::default(),
            sides: Vec::new(),
            spheres: Vec::new(),
            numbers: Numbers::default(),
        })
    }

    /// Fits `frame`. Where `time_is_up` says true before the fit, the frame comes back without
    /// spheres and `degraded`. A sphere keeps its number from frame to frame while most of its
    /// pixels keep it.
    ///
    /// # Errors
    /// [`FrameFitError`], for no frame whose camera and parameters were accepted.
    ///
    /// # Panics
    /// Where the frame does not have `width * height` pixels: sources guarantee it.
    pub fn model(
        &mut self,
        frame: &DepthFrame,
        out: &mut SaintFrame,
        time_is_up: &dyn Fn() -> bool,
    ) -> Result<FitReport, FrameFitError> {
        assert_eq!(frame.depth.len(), self.rays.width * self.rays.height);
        self.cloud.refill(&self.rays, &self.validity, frame)?;
        let valid = self.cloud.pixels.len() as u32;
        let mut report = FitReport {
            valid_pixels: valid,
            ..FitReport::default()
        };
        let model = if time_is_up() {
            report.degraded = true;
            CloudModel {
                assignment: vec![UNASSIGNED; self.cloud.points.len()],
                ..CloudModel::default()
            }
        } else {
            report.cold_pixels = valid;
            self.fit.fit(&self.cloud.points, &self.parameters)?
        };
        out.motion = Motion::default();
        self.see(frame, &model);
        let mut labels = match std::mem::take(&mut out.contacts) {
            Contacts::Labels(labels) => labels,
            Contacts::Blocks(_) => Vec::new(),
        };
        self.label(frame, &model, &mut labels);
        self.numbers
            .settle(&self.spheres, &mut labels, &mut out.spheres);
        report.explained_pixels = labels.iter().filter(|l| **l < NO_SPHERE).count() as u32;
        out.contacts = Contacts::Labels(labels);
        report.spheres = out.spheres.iter().flatten().count() as u32;
        report.new = report.spheres;
        Ok(report)
    }

    /// Forgets the numbers of the frame before.
    pub fn reset(&mut self) {
        self.numbers = Numbers::default();
    }

    /// The model's spheres in the camera's form, each side with pixels as one.
    fn see(&mut self, frame: &DepthFrame, model: &CloudModel) {
        self.sides.clear();
        self.sides.extend(model.spheres.iter().map(|sphere| Sides {
            surface: sphere.translated(model.origin).seen_from_zero(),
            pixels: [0; 2],
            number: [NO_SPHERE; 2],
        }));
        let width = self.rays.width;
        for (point, &s) in model.assignment.iter().enumerate() {
            let Some(sides) = self.sides.get_mut(s as usize) else {
                continue;
            };
            let Some(surface) = &sides.surface else {
                continue;
            };
            let pixel = self.cloud.pixels[point] as usize;
            let w = self.rays.per_metre / f32::from(frame.depth[pixel]);
            let (u, v) = (self.rays.u[pixel % width], self.rays.v[pixel / width]);
            sides.pixels[Sides::of(surface, w, u, v)] += 1;
        }
        self.spheres.clear();
        for sides in &mut self.sides {
            let Some(surface) = sides.surface else {
                continue;
            };
            for side in 0..2 {
                if sides.pixels[side] > 0 && self.spheres.len() < self.parameters.max_spheres {
                    sides.number[side] = self.spheres.len() as u16;
                    self.spheres.push(Sphere {
                        far: side == 1,
                        ..surface
                    });
                }
            }
        }
    }

    /// A label for each pixel: the sphere of the pixel before while it touches, so that labels
    /// do not follow the noise where spheres overlap; else its own; else the one above.
    fn label(&self, frame: &DepthFrame, model: &CloudModel, labels: &mut Vec<u16>) {
        let (rays, width) = (&self.rays, self.rays.width);
        labels.clear();
        labels.resize(rays.width * rays.height, INVALID);
        for (point, &pixel) in self.cloud.pixels.iter().enumerate() {
            let pixel = pixel as usize;
            let (x, y) = (pixel % width, pixel / width);
            let (u, v) = (rays.u[x], rays.v[y]);
            let q = u * u + v * v + 1.0;
            let raw = f32::from(frame.depth[pixel]);
            let own = match self.sides.get(model.assignment[point] as usize) {
                Some(sides) => sides.surface.map_or(NO_SPHERE, |surface| {
                    sides.number[Sides::of(&surface, rays.per_metre / raw, u, v)]
                }),
                None => NO_SPHERE,
            };
            let left = if x > 0 { labels[pixel - 1] } else { INVALID };
            let above = if y > 0 {
                labels[pixel - width]
            } else {
                INVALID
            };
            let touches = |label: &u16| {
                self.spheres.get(usize::from(*label)).is_some_and(|s| {
                    let w = s.inverse_depth(u, v, q);
                    w > 0.0 && self.reach.touches(raw, rays.per_metre / w, q)
                })
            };
            labels[pixel] = [left, own, above]
                .into_iter()
                .find(touches)
                .unwrap_or(NO_SPHERE);
        }
    }
}

/// Keeps a surface's number from frame to frame: fits made from nothing come in any order, and
/// the payload of a P frame pays for every label that changed its name.
#[derive(Debug, Default)]
struct Numbers {
    before: Vec<u16>,
    pairs: Vec<(u16, u16)>,
    overlaps: Vec<(u32, u16, u16)>,
    number: Vec<u16>,
    taken: Vec<bool>,
}

impl Numbers {
    /// Renumbers `labels` (places in `spheres`) and puts the spheres that have pixels into
    /// their slots. The largest overlap with a number of the frame before goes first.
    fn settle(&mut self, spheres: &[Sphere], labels: &mut [u16], slots: &mut Vec<Option<Sphere>>) {
        self.pairs.clear();
        self.pairs.extend(
            labels
                .iter()
                .zip(&self.before)
                .filter(|(now, before)| **now < NO_SPHERE && **before < NO_SPHERE)
                .map(|(now, before)| (*now, *before)),
        );
        self.pairs.sort_unstable();
        self.overlaps.clear();
        for run in self.pairs.chunk_by(|a, b| a == b) {
            self.overlaps.push((run.len() as u32, run[0].0, run[0].1));
        }
        self.overlaps
            .sort_unstable_by_key(|&(pixels, now, before)| (u32::MAX - pixels, now, before));
        self.number.clear();
        self.number.resize(spheres.len(), NO_SPHERE);
        self.taken.clear();
        self.taken.resize(usize::from(NO_SPHERE), false);
        for &(_, now, before) in &self.overlaps {
            let number = &mut self.number[usize::from(now)];
            let taken = &mut self.taken[usize::from(before)];
            if *number == NO_SPHERE && !*taken {
                *number = before;
                *taken = true;
            }
        }
        let mut used = vec![false; spheres.len()];
        for &label in labels.iter().filter(|l| **l < NO_SPHERE) {
            used[usize::from(label)] = true;
        }
        let mut free = 0;
        slots.clear();
        for ((number, sphere), _) in
            (self.number.iter_mut().zip(spheres).zip(&used)).filter(|(_, used)| **used)
        {
            if *number == NO_SPHERE {
                // fewer spheres than numbers, so there is a free one
                while self.taken[free] {
                    free += 1;
                }
                self.taken[free] = true;
                *number = free as u16;
            }
            let slot = usize::from(*number);
            if slots.len() <= slot {
                slots.resize(slot + 1, None);
            }
            slots[slot] = Some(*sphere);
        }
        for label in labels.iter_mut().filter(|l| **l < NO_SPHERE) {
            *label = self.number[usize::from(*label)];
        }
        self.before.clear();
        self.before.extend_from_slice(labels);
    }
}

impl CloudSphere {
    /// The same surface in the form of a camera at the zero of its coordinates, near side.
    /// `None` where it passes through the camera, or so close that single precision overflows.
    #[must_use]
    pub fn seen_from_zero(&self) -> Option<Sphere> {
        let sphere = Sphere {
            a: (-0.5 * self.curvature / self.offset) as f32,
            m: (self.normal / -self.offset).as_vec3(),
            far: false,
        };
        (sphere.a.is_finite() && sphere.m.is_finite()).then_some(sphere)
    }

    /// The surface of a camera's sphere, about the camera. `None` where there is no real one.
    #[must_use]
    pub fn from_seen(sphere: &Sphere) -> Option<Self> {
        Self::normalised(2.0 * f64::from(sphere.a), sphere.m.as_dvec3(), -1.0)
    }
}

#[cfg(test)]
#[path = "framewise_tests.rs"]
mod tests;
