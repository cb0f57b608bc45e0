//! Planar depth as EXR: channel `Z`, metres as f32, 0 where nothing was measured, with the
//! attributes of our EXR inputs: the file can be replayed.

use super::{ExportFrame, is_measured};
use crate::capture::CaptureError;
use crate::capture::sequences::exr::write_exr_metres;
use std::path::Path;

/// Writes the frame's depth to `path`.
///
/// # Errors
/// [`CaptureError`] names the file and the cause.
pub fn depth(frame: &ExportFrame<'_>, path: &Path) -> Result<(), CaptureError> {
    let clean = |z: &f32| if is_measured(*z) { *z } else { 0.0 };
    let depth: Vec<f32> = frame.depth_m.iter().map(clean).collect();
    write_exr_metres(path, frame.camera, frame.sequence, frame.time, &depth)
}
