//! What an Azure Kinect recording says of its camera.
//!
//! `calibration.json` is the device's own: `ModelParameters` are cx, cy, fx, fy of the 1024×1024
//! sensor as shares of it (the corner of the first pixel is 0), then the lens distortion. An image
//! is the sensor, or a window of it, at full or half resolution; its size tells which.

use crate::frame::Intrinsics;
use serde_json::Value;

/// Name of the attachment.
pub(super) const FILE_NAME: &str = "calibration.json";
/// Name of the camera.
pub(super) const CAMERA: &str = "Azure Kinect";
/// Name of the depth track.
pub(super) const DEPTH_NAME: &str = "DEPTH";
/// Tag that holds the depth track's UID.
pub(super) const DEPTH_TAG: &str = "K4A_DEPTH_TRACK";
/// Tag that holds the device's time of the file's zero, ns.
pub(super) const START_TAG: &str = "K4A_START_OFFSET_NS";

/// A depth mode.
struct Mode {
    size: (u32, u32),
    /// Side of the whole sensor at the mode's resolution, pixels.
    side: f64,
    /// First column and row of the window.
    from: (f64, f64),
}

const fn mode(size: (u32, u32), side: f64, from: (f64, f64)) -> Mode {
    Mode { size, side, from }
}

const MODES: [Mode; 4] = [
    mode((640, 576), 1024.0, (192.0, 180.0)),
    mode((320, 288), 512.0, (96.0, 90.0)),
    mode((1024, 1024), 1024.0, (0.0, 0.0)),
    mode((512, 512), 512.0, (0.0, 0.0)),
];

/// The pinhole of a depth image of this size; says why there is none.
pub(super) fn intrinsics(json: &[u8], size: (u32, u32)) -> Result<Intrinsics, String> {
    let Some(mode) = MODES.iter().find(|mode| mode.size == size) else {
        return Err(format!(
            "{}x{} is no depth mode of the camera (640x576, 320x288, 1024x1024, 512x512)",
            size.0, size.1
        ));
    };
    // the file ends in a zero byte
    let end = json.iter().position(|byte| *byte == 0);
    let json = &json[..end.unwrap_or(json.len())];
    let tree: Value = serde_json::from_slice(json).map_err(|error| error.to_string())?;
    let cameras = &tree["CalibrationInformation"]["Cameras"];
    let depth = cameras.as_array().and_then(|cameras| {
        let depth = |camera: &&Value| {
            camera["Location"] == "CALIBRATION_CameraLocationD0"
                || camera["Purpose"] == "CALIBRATION_CameraPurposeDepth"
        };
        cameras.iter().find(depth)
    });
    let depth = depth.ok_or("it has no depth camera")?;
    let parameter = |index: usize| depth["Intrinsics"]["ModelParameters"][index].as_f64();
    let all = || Some([parameter(0)?, parameter(1)?, parameter(2)?, parameter(3)?]);
    let [cx, cy, fx, fy] = all().ok_or("its depth camera has no parameters")?;
    let intrinsics = Intrinsics {
        fx: fx * mode.side,
        fy: fy * mode.side,
        cx: cx * mode.side - mode.from.0 - 0.5,
        cy: cy * mode.side - mode.from.1 - 0.5,
    };
    if !(intrinsics.fx > 0.0 && intrinsics.fy > 0.0) {
        return Err(format!("focal lengths {fx} and {fy} must be above 0"));
    }
    Ok(intrinsics)
}

#[cfg(test)]
mod tests {
    use super::*;

    const JSON: &str = r#"{"CalibrationInformation":{"Cameras":[
        {"Location":"CALIBRATION_CameraLocationPV0","Intrinsics":{"ModelParameters":[9,9,9,9]}},
        {"Location":"CALIBRATION_CameraLocationD0",
         "Intrinsics":{"ModelParameters":[0.5,0.503,0.4925,0.4926,6.0,4.3]}}]}}"#;

    #[test]
    fn the_window_follows_the_image_size() {
        let of = |size| intrinsics(JSON.as_bytes(), size).unwrap();
        let narrow = of((640, 576));
        // the sensor's middle is column 511.5; the window begins at 192
        assert!((narrow.cx - (511.5 - 192.0)).abs() < 1e-9, "{narrow:?}");
        assert!(
            (narrow.cy - (0.503 * 1024.0 - 180.5)).abs() < 1e-9,
            "{narrow:?}"
        );
        assert!((narrow.fx - 504.32).abs() < 1e-9, "{narrow:?}");
        // the binned mode is the same view at half the size
        let binned = of((320, 288));
        let halved = narrow.rescaled((640, 576), (320, 288));
        for (a, b) in [
            (binned.fx, halved.fx),
            (binned.fy, halved.fy),
            (binned.cx, halved.cx),
            (binned.cy, halved.cy),
        ] {
            assert!((a - b).abs() < 1e-9, "{binned:?} {halved:?}");
        }
        assert!(intrinsics(JSON.as_bytes(), (641, 576)).is_err());
        assert!(intrinsics(b"{}", (640, 576)).is_err());
        assert!(intrinsics(b"{", (640, 576)).is_err());
        assert!(intrinsics(format!("{JSON}\0").as_bytes(), (640, 576)).is_ok());
    }
}
