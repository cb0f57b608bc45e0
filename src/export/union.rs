//! The frames of several cameras in one file, in their common frame: binary PLY.

use super::{ExportCloud, ExportError, ExportFrame, Point, color};
use crate::frame::FrameTime;
use crate::rig::Pose;
use glam::DVec3;

/// What one camera shows.
#[derive(Clone, Copy, Debug)]
pub enum Seen<'a> {
    /// A frame on the sensor's grid.
    Frame(ExportFrame<'a>),
    /// A frame of points without a grid.
    Cloud(ExportCloud<'a>),
}

/// One camera's part of a union.
#[derive(Clone, Copy, Debug)]
pub struct View<'a> {
    /// The camera's number in the recording.
    pub camera: u8,
    /// Where it stands.
    pub pose: Pose,
    /// What it shows.
    pub seen: Seen<'a>,
}

impl View<'_> {
    fn facts(&self) -> (u64, FrameTime) {
        match &self.seen {
            Seen::Frame(frame) => (frame.sequence, frame.time),
            Seen::Cloud(cloud) => (cloud.sequence, cloud.time),
        }
    }

    fn points(&self) -> Box<dyn Iterator<Item = Point> + '_> {
        match &self.seen {
            Seen::Frame(frame) => Box::new(frame.points()),
            Seen::Cloud(cloud) => Box::new(cloud.points()),
        }
    }

    fn spheres(&self) -> Box<dyn Iterator<Item = (u16, DVec3, f64)> + '_> {
        match &self.seen {
            Seen::Frame(frame) => {
                let present = frame.spheres.iter().enumerate();
                Box::new(present.filter_map(|(slot, sphere)| {
                    let (center, radius) = (*sphere)?.center_radius();
                    Some((u16::try_from(slot).ok()?, center, radius))
                }))
            }
            Seen::Cloud(cloud) => Box::new(cloud.spheres()),
        }
    }

    /// Checks that a frame's arrays fit its camera.
    ///
    /// # Errors
    /// [`ExportError::FrameSize`].
    pub fn check(&self) -> Result<(), ExportError> {
        match &self.seen {
            Seen::Frame(frame) => frame.check(),
            Seen::Cloud(_) => Ok(()),
        }
    }
}

/// Replaces `file` by the points of all views: `float x y z`, `uchar red green blue`, `int sphere`
/// (−1 without one; numbers are each camera's own), `uchar camera`.
pub fn points(views: &[View<'_>], file: &mut Vec<u8>) {
    let mut body = Vec::new();
    let mut count = 0u64;
    for view in views {
        for point in view.points() {
            let place = view.pose.to_common(point.position.as_dvec3());
            put(&mut body, place.to_array());
            body.extend_from_slice(&color::of_sphere(point.sphere));
            body.extend_from_slice(&point.sphere.map_or(-1, i32::from).to_le_bytes());
            body.push(view.camera);
            count += 1;
        }
    }
    finish(views, count, "", &body, file);
}

/// Replaces `file` by the spheres of all views: centre `float x y z`, `float radius` (metres),
/// then as [`points`].
pub fn spheres(views: &[View<'_>], file: &mut Vec<u8>) {
    let mut body = Vec::new();
    let mut count = 0u64;
    for view in views {
        for (slot, center, radius) in view.spheres() {
            put(&mut body, view.pose.to_common(center).to_array());
            body.extend_from_slice(&(radius as f32).to_le_bytes());
            body.extend_from_slice(&color::of_sphere(Some(slot)));
            body.extend_from_slice(&i32::from(slot).to_le_bytes());
            body.push(view.camera);
            count += 1;
        }
    }
    finish(views, count, "property float radius\n", &body, file);
}

fn put(body: &mut Vec<u8>, values: [f64; 3]) {
    for value in values {
        body.extend_from_slice(&(value as f32).to_le_bytes());
    }
}

fn finish(views: &[View<'_>], count: u64, radius: &str, body: &[u8], file: &mut Vec<u8>) {
    let mut header = String::from(
        "ply\nformat binary_little_endian 1.0\ncomment metres, common frame of the cameras\n",
    );
    for view in views {
        let (sequence, time) = view.facts();
        header.push_str(&format!(
            "comment camera {} frame {sequence} device_ns {} wall_ns {}\n",
            view.camera, time.device_ns, time.wall_ns
        ));
    }
    header.push_str(&format!(
        "element vertex {count}\nproperty float x\nproperty float y\nproperty float z\n{radius}\
         property uchar red\nproperty uchar green\nproperty uchar blue\nproperty int sphere\n\
         property uchar camera\nend_header\n"
    ));
    file.clear();
    file.reserve(header.len() + body.len());
    file.extend_from_slice(header.as_bytes());
    file.extend_from_slice(body);
}
