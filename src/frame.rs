//! Data that crosses stages: the camera, its depth frames, colour beside them.
//!
//! Units and axes are stated once, here: metres, right-handed optical frame (x right, y down,
//! z forward), depth is planar z (not distance along the ray), times are int64 nanoseconds.

use serde::{Deserialize, Serialize};

/// Pinhole intrinsics in pixels. The centre of the top-left pixel is (0, 0).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Intrinsics {
    /// Focal length along x, pixels.
    pub fx: f64,
    /// Focal length along y, pixels.
    pub fy: f64,
    /// Principal point, x, pixels.
    pub cx: f64,
    /// Principal point, y, pixels.
    pub cy: f64,
}

impl Intrinsics {
    /// The same lens at another image size: the pixel grid is scaled about its outer border.
    #[must_use]
    pub fn rescaled(&self, from: (u32, u32), to: (u32, u32)) -> Self {
        let (sx, sy) = (
            f64::from(to.0) / f64::from(from.0),
            f64::from(to.1) / f64::from(from.1),
        );
        Self {
            fx: self.fx * sx,
            fy: self.fy * sy,
            cx: (self.cx + 0.5) * sx - 0.5,
            cy: (self.cy + 0.5) * sy - 0.5,
        }
    }
}

/// All that is needed to read a stream of depth integers as geometry.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Camera {
    /// Image width, pixels.
    pub width: u32,
    /// Image height, pixels.
    pub height: u32,
    /// Pinhole intrinsics, pixels.
    pub intrinsics: Intrinsics,
    /// Metres per depth integer.
    pub depth_unit_m: f64,
    /// Depth integers that mean "no measurement". 0 always does, listed or not.
    pub invalid: Vec<u16>,
    /// Depths nearer than this are not measurements, metres.
    pub depth_min_m: f64,
    /// Depths farther than this are not measurements, metres.
    pub depth_max_m: f64,
    /// Nominal frame rate, frames per second, where the source has one.
    pub fps: Option<f64>,
    /// What the source calls itself (card name, sequence name).
    pub name: String,
}

impl Camera {
    /// Pixels in one frame.
    #[must_use]
    pub fn pixels(&self) -> usize {
        self.width as usize * self.height as usize
    }
}

/// When a frame was taken.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct FrameTime {
    /// Device clock (CLOCK_MONOTONIC for V4L2), ns. Replay: time since the recording's own zero.
    pub device_ns: i64,
    /// Wall clock (Unix epoch), ns; 0 where it is not known.
    pub wall_ns: i64,
}

/// One depth frame as the sensor gave it.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct DepthFrame {
    /// The source's own frame number: a gap is a frame the sensor or driver lost.
    pub sequence: u64,
    /// When it was taken.
    pub time: FrameTime,
    /// Depth integers, row-major, `width * height` of them, in `Camera::depth_unit_m`.
    pub depth: Vec<u16>,
}

/// One compressed colour image, bytes untouched.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ColorFrame {
    /// Sequence of the depth frame it belongs to, or the colour camera's own.
    pub sequence: u64,
    /// When it was taken.
    pub time: FrameTime,
    /// `"jpeg"` or `"png"`.
    pub format: String,
    /// The image file's bytes.
    pub data: Vec<u8>,
}
