//! The camera as messages: Foxglove's calibration and our own full description.

use crate::frame::Camera;
use serde_json::json;

/// Name of Foxglove's calibration schema.
pub const CALIBRATION_SCHEMA: &str = "foxglove.CameraCalibration";
/// Name of our camera's schema.
pub const CAMERA_SCHEMA: &str = "saint-live.camera";

/// JSON schema of [`calibration`], field names as Foxglove defines them.
#[must_use]
pub fn calibration_schema() -> serde_json::Value {
    let numbers = |count: usize| json!({"type": "array", "items": {"type": "number"}, "minItems": count, "maxItems": count});
    json!({
        "title": CALIBRATION_SCHEMA,
        "description": "Pinhole camera, no distortion",
        "type": "object",
        "properties": {
            "timestamp": {
                "type": "object",
                "title": "time",
                "properties": {
                    "sec": {"type": "integer", "minimum": 0},
                    "nsec": {"type": "integer", "minimum": 0, "maximum": 999_999_999}
                }
            },
            "frame_id": {"type": "string"},
            "width": {"type": "integer", "minimum": 0},
            "height": {"type": "integer", "minimum": 0},
            "distortion_model": {"type": "string"},
            "D": {"type": "array", "items": {"type": "number"}},
            "K": numbers(9),
            "R": numbers(9),
            "P": numbers(12)
        }
    })
}

/// The camera as Foxglove reads it, stamped `time_ns` (as `log_time`).
#[must_use]
pub fn calibration(camera: &Camera, time_ns: u64) -> serde_json::Value {
    let lens = &camera.intrinsics;
    json!({
        "timestamp": {"sec": time_ns / 1_000_000_000, "nsec": time_ns % 1_000_000_000},
        "frame_id": "depth",
        "width": camera.width,
        "height": camera.height,
        "distortion_model": "",
        "D": [],
        "K": [lens.fx, 0.0, lens.cx, 0.0, lens.fy, lens.cy, 0.0, 0.0, 1.0],
        "R": [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        "P": [lens.fx, 0.0, lens.cx, 0.0, 0.0, lens.fy, lens.cy, 0.0, 0.0, 0.0, 1.0, 0.0]
    })
}

/// The whole camera as JSON. JSON has no infinity: an open depth range ends at the largest number,
/// and a value that is no number at all is left out or becomes that bound too.
#[must_use]
pub fn camera_text(camera: &Camera) -> String {
    let mut camera = camera.clone();
    camera.fps = camera.fps.filter(|fps| fps.is_finite());
    if !camera.depth_max_m.is_finite() {
        camera.depth_max_m = f64::MAX;
    }
    if !camera.depth_min_m.is_finite() {
        camera.depth_min_m = 0.0;
    }
    // a struct of finite numbers, strings and a list always has a JSON form
    serde_json::to_string(&camera).unwrap_or_default()
}

/// JSON schema of a serialised [`Camera`].
#[must_use]
pub fn camera_schema() -> serde_json::Value {
    json!({
        "title": CAMERA_SCHEMA,
        "description": "Units: pixels, metres, 1/s; depth integers listed in `invalid` mean no measurement",
        "type": "object",
        "properties": {
            "width": {"type": "integer"},
            "height": {"type": "integer"},
            "intrinsics": {
                "type": "object",
                "properties": {
                    "fx": {"type": "number"}, "fy": {"type": "number"},
                    "cx": {"type": "number"}, "cy": {"type": "number"}
                }
            },
            "depth_unit_m": {"type": "number"},
            "invalid": {"type": "array", "items": {"type": "integer"}},
            "depth_min_m": {"type": "number"},
            "depth_max_m": {"type": "number"},
            "fps": {"type": ["number", "null"]},
            "name": {"type": "string"}
        }
    })
}
