//! Planar depth as 16-bit PNG in the sensor's unit, with `camera.json` beside: an input again.

use super::{ExportFrame, is_measured};
use crate::capture::CaptureError;
use crate::capture::sequences::{camera_json, png};
use crate::frame::Camera;
use std::path::Path;

/// Writes the frame's depth to `path`.
///
/// # Errors
/// [`CaptureError`] names the file and the cause.
pub fn depth(frame: &ExportFrame<'_>, path: &Path) -> Result<(), CaptureError> {
    let codes: Vec<u16> = frame
        .depth_m
        .iter()
        .map(|z| code(frame.camera, *z))
        .collect();
    png::write_png_depth(path, frame.camera.width, frame.camera.height, &codes)
}

/// Writes `camera.json` into the folder of the images.
///
/// # Errors
/// [`CaptureError`] names the file and the cause.
pub fn camera(folder: &Path, camera: &Camera) -> Result<(), CaptureError> {
    camera_json::write_camera_json(folder, camera)
}

/// The depth integer nearest to `depth_m`: 0 where there is none or it is too far for 16 bits.
/// A depth that rounds to a code that means "no measurement" takes the next one below, so that it
/// stays a measurement.
#[must_use]
pub fn code(camera: &Camera, depth_m: f32) -> u16 {
    let units = (f64::from(depth_m) / camera.depth_unit_m).round();
    if !is_measured(depth_m) || !(1.0..=f64::from(u16::MAX)).contains(&units) {
        return 0;
    }
    let wanted = units as u16;
    let free = (1..=wanted)
        .rev()
        .find(|code| !camera.invalid.contains(code));
    free.unwrap_or(0)
}
