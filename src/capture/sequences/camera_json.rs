//! `camera.json`, the calibration beside a folder of depth images.

use super::input;
use crate::capture::CaptureError;
use crate::frame::Camera;
use crate::intrinsics::Calibration;
use serde::Serialize;
use std::path::{Path, PathBuf};

/// The file's name.
pub const FILE_NAME: &str = "camera.json";

/// The file's fields, as [`Calibration`] reads them.
#[derive(Serialize)]
struct CameraJson<'a> {
    width: u32,
    height: u32,
    fx: f64,
    fy: f64,
    cx: f64,
    cy: f64,
    depth_scale_m_per_unit: f64,
    depth_min_m: f64,
    depth_max_m: f64,
    fps: Option<f64>,
    invalid_values: &'a [u16],
    sensor: &'a str,
}

/// Writes `camera.json` into `folder`. An existing file is replaced.
///
/// # Errors
/// [`CaptureError::Input`] when it cannot be written.
pub fn write_camera_json(folder: &Path, camera: &Camera) -> Result<(), CaptureError> {
    let path = folder.join(FILE_NAME);
    let failed = |what: String| input(&path, what, "check the folder and the space left");
    let text = serde_json::to_string_pretty(&CameraJson {
        width: camera.width,
        height: camera.height,
        fx: camera.intrinsics.fx,
        fy: camera.intrinsics.fy,
        cx: camera.intrinsics.cx,
        cy: camera.intrinsics.cy,
        depth_scale_m_per_unit: camera.depth_unit_m,
        depth_min_m: camera.depth_min_m,
        depth_max_m: camera.depth_max_m,
        fps: camera.fps,
        invalid_values: &camera.invalid,
        sensor: &camera.name,
    })
    .map_err(|error| failed(error.to_string()))?;
    std::fs::write(&path, text + "\n").map_err(|error| failed(error.to_string()))
}

/// The calibration beside images in `folder`: there, or one level up when the folder is the
/// `depth/` of a sequence.
pub(super) fn find(folder: &Path) -> Result<Option<Calibration>, CaptureError> {
    let up = folder.file_name().filter(|name| *name == "depth");
    let places = [Some(folder), up.and_then(|_| folder.parent())];
    let file: Option<PathBuf> = places
        .into_iter()
        .flatten()
        .map(|place| place.join(FILE_NAME))
        .find(|path| path.is_file());
    let read = |path: PathBuf| {
        Calibration::read(&path).map_err(|error| super::calibration_error(error, &path))
    };
    file.map(read).transpose()
}
