//! The data of an experiment: a cloud, or the frames of a depth camera. And stand-ins for them.

use super::{Chance, ExperimentError};
use crate::capture::synthetic::{Scene, SyntheticOptions, SyntheticSource};
use crate::capture::{FrameSource, Next};
use crate::deproject::{Rays, Validity};
use crate::fit::contact_distance::ContactDistance;
use crate::fit::framewise::FrameCloud;
use crate::frame::{Camera, DepthFrame};
use crate::model::build::printed_distance;
use crate::partition::points::LocalPoints;
use glam::DVec3;
use std::f64::consts::TAU;

/// A cloud and the parameters that suit it.
#[derive(Clone, Debug)]
pub struct Subject {
    /// Its name.
    pub name: String,
    /// Positions, metres, all finite.
    pub points: Vec<DVec3>,
    /// True for the pixels of a depth camera.
    pub is_frame: bool,
    /// Contact distance.
    pub contact: ContactDistance,
    /// Distance of neighbouring cell centres, metres.
    pub cube_size_m: f64,
}

/// Contact distance of a cloud, as a share of its diagonal, unless one is given.
const CONTACT_SHARE: f64 = 1.0 / 500.0;
/// Cell size of a cloud, as a share of its diagonal.
const CUBE_SHARE: f64 = 1.0 / 12.0;
/// Cell size of a depth frame, metres.
const FRAME_CUBE_M: f64 = 0.2;

impl Subject {
    /// A cloud. Non-finite points are left out; of more than `max_points`, every k-th is taken.
    ///
    /// # Errors
    /// A cloud with fewer than 50 points, or without extent.
    pub fn cloud(
        name: &str,
        points: &[DVec3],
        contact: Option<ContactDistance>,
        max_points: usize,
    ) -> Result<Self, ExperimentError> {
        let finite: Vec<DVec3> = points.iter().copied().filter(|p| p.is_finite()).collect();
        let stride = finite.len().div_ceil(max_points.max(1)).max(1);
        let points: Vec<DVec3> = finite.into_iter().step_by(stride).collect();
        let diagonal = diagonal(&points);
        let share = ContactDistance::constant(printed_distance(diagonal * CONTACT_SHARE, 2));
        if points.len() < 50 || diagonal <= 0.0 {
            return Err(ExperimentError::Data(format!(
                "{name} has {} usable points over {diagonal} m; an experiment needs at least 50 that are not all in one place",
                points.len()
            )));
        }
        Ok(Self {
            name: name.to_owned(),
            points,
            is_frame: false,
            contact: contact.unwrap_or(share),
            cube_size_m: diagonal * CUBE_SHARE,
        })
    }

    /// The measured pixels of a depth frame.
    ///
    /// # Errors
    /// As [`Subject::cloud`].
    pub fn frame(
        name: &str,
        camera: &Camera,
        frame: &DepthFrame,
        contact: Option<ContactDistance>,
        max_points: usize,
    ) -> Result<Self, ExperimentError> {
        let mut cloud = FrameCloud::default();
        cloud.refill(&Rays::new(camera), &Validity::new(camera), frame)?;
        let points: Vec<DVec3> = (0..cloud.points.len())
            .map(|i| cloud.points.world(i))
            .collect();
        Ok(Self {
            contact: contact.unwrap_or_default(),
            cube_size_m: FRAME_CUBE_M,
            is_frame: true,
            ..Self::cloud(name, &points, contact, max_points)?
        })
    }

    /// Points about a local origin.
    ///
    /// # Errors
    /// More points than a `u32` can number.
    pub fn local(&self) -> Result<LocalPoints, ExperimentError> {
        Ok(LocalPoints::new(&self.points)?)
    }

    /// Length of the bounding box's diagonal, metres.
    #[must_use]
    pub fn diagonal_m(&self) -> f64 {
        diagonal(&self.points)
    }

    /// One line for people.
    #[must_use]
    pub fn describe(&self) -> String {
        format!(
            "{}: {} points, diagonal {} m, contact distance {}",
            self.name,
            self.points.len(),
            super::report::digits(self.diagonal_m()),
            self.contact
        )
    }
}

/// Length of the bounding box's diagonal.
fn diagonal(points: &[DVec3]) -> f64 {
    let low = points.iter().fold(DVec3::MAX, |a, b| a.min(*b));
    let high = points.iter().fold(DVec3::MIN, |a, b| a.max(*b));
    if points.is_empty() {
        0.0
    } else {
        low.distance(high)
    }
}

/// Frames of one depth camera.
#[derive(Clone, Debug)]
pub struct DepthFrames {
    /// Their name.
    pub name: String,
    /// The camera.
    pub camera: Camera,
    /// The frames, in time.
    pub frames: Vec<DepthFrame>,
    /// Contact distance.
    pub contact: ContactDistance,
    /// What the frames would be without noise, where it is known: planar depth of each pixel,
    /// metres, 0 for nothing.
    pub truth_m: Option<Vec<Vec<f64>>>,
}

/// Frames of the synthetic sensor: the room, walked through, with the noise of stereo.
///
/// # Errors
/// Never for these options.
pub fn synthetic_frames(count: usize, size: (u32, u32)) -> Result<DepthFrames, ExperimentError> {
    let failed = |e: crate::capture::CaptureError| ExperimentError::Data(e.to_string());
    let options = SyntheticOptions {
        width: size.0,
        height: size.1,
        fps: 3.0,
        frames: Some(count as u64),
        ..SyntheticOptions::unpaced(Scene::Walk)
    };
    let mut source = SyntheticSource::open(options).map_err(failed)?;
    let (mut frames, mut truth_m) = (Vec::new(), Vec::new());
    let mut frame = DepthFrame::default();
    while source.next(&mut frame).map_err(failed)? == Next::Frame {
        truth_m.push(source.truth(frame.sequence).depth_m);
        frames.push(frame.clone());
    }
    Ok(DepthFrames {
        name: "synthetic walk".to_owned(),
        camera: source.camera().clone(),
        contact: ContactDistance::default(),
        frames,
        truth_m: Some(truth_m),
    })
}

/// Scans of made-up objects, 20 cm across, with 0.1 mm of noise: stand-ins where no data are
/// given. The same seed gives the same points.
#[must_use]
pub fn synthetic_objects(points: usize, seed: u64) -> Vec<(&'static str, Vec<DVec3>)> {
    type Shape = fn(f64, f64) -> DVec3;
    // u, v in 0..1
    let shapes: [(&str, Shape); 6] = [
        ("knobbly ball", |u, v| {
            let (theta, z) = (TAU * u, 2.0 * v - 1.0);
            let flat = (1.0 - z * z).max(0.0).sqrt();
            let bump = 1.0 + 0.12 * (5.0 * theta).sin() * flat + 0.08 * (9.0 * z).cos();
            0.08 * bump * DVec3::new(flat * theta.cos(), flat * theta.sin(), z)
        }),
        ("ring", |u, v| {
            let (a, b) = (TAU * u, TAU * v);
            let out = 0.07 + 0.03 * b.cos();
            DVec3::new(out * a.cos(), out * a.sin(), 0.03 * b.sin())
        }),
        ("box", |u, v| {
            let face = (6.0 * u) as u32;
            let (a, b) = ((6.0 * u).fract() - 0.5, v - 0.5);
            let side = if face.is_multiple_of(2) { 0.5 } else { -0.5 };
            let p = match face / 2 {
                0 => DVec3::new(side, a, b),
                1 => DVec3::new(a, side, b),
                _ => DVec3::new(a, b, side),
            };
            p * DVec3::new(0.16, 0.1, 0.06)
        }),
        ("vase", |u, v| {
            let z = 0.2 * v - 0.1;
            let radius = 0.04 + 0.02 * (30.0 * z).sin();
            DVec3::new(radius * (TAU * u).cos(), radius * (TAU * u).sin(), z)
        }),
        ("saddle", |u, v| {
            let (x, y) = (0.18 * (u - 0.5), 0.18 * (v - 0.5));
            DVec3::new(x, y, 6.0 * (x * x - y * y))
        }),
        ("waves", |u, v| {
            let (x, y) = (0.18 * (u - 0.5), 0.18 * (v - 0.5));
            DVec3::new(x, y, 0.008 * (120.0 * x).sin() * (90.0 * y).cos())
        }),
    ];
    let mut chance = Chance::new(seed);
    let scan = |shape: Shape, chance: &mut Chance| {
        let noise = |chance: &mut Chance| 1e-4 * chance.normal();
        let point = |_| {
            let p = shape(chance.unit(), chance.unit());
            p + DVec3::new(noise(chance), noise(chance), noise(chance))
        };
        (0..points).map(point).collect()
    };
    shapes
        .iter()
        .map(|(name, shape)| (*name, scan(*shape, &mut chance)))
        .collect()
}
