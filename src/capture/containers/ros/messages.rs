//! The messages that matter here: images, compressed images, the camera, a number.
//!
//! Definitions: `sensor_msgs` and `std_msgs` of ROS; ROS 1 puts a sequence number before the stamp.

use super::fields::{Fields, Layout};
use crate::frame::Intrinsics;
use crate::intrinsics::Calibration;

/// Kinds of messages, by their type's name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::capture::containers) enum Kind {
    Image,
    CompressedImage,
    CameraInfo,
    Float32,
    Other,
}

impl Kind {
    /// `sensor_msgs/Image` (ROS 1) and `sensor_msgs/msg/Image` (ROS 2) are one kind.
    pub(in crate::capture::containers) fn named(name: &str) -> Self {
        match name.replace("/msg/", "/").as_str() {
            "sensor_msgs/Image" => Self::Image,
            "sensor_msgs/CompressedImage" => Self::CompressedImage,
            "sensor_msgs/CameraInfo" => Self::CameraInfo,
            "std_msgs/Float32" => Self::Float32,
            _ => Self::Other,
        }
    }

    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Image => "sensor_msgs/Image",
            Self::CompressedImage => "sensor_msgs/CompressedImage",
            Self::CameraInfo => "sensor_msgs/CameraInfo",
            Self::Float32 => "std_msgs/Float32",
            Self::Other => "message",
        }
    }
}

/// `std_msgs/Header` without the frame's name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Header {
    /// ROS 1 only.
    pub(super) sequence: Option<u32>,
    pub(super) stamp_ns: i64,
}

impl Header {
    fn read(fields: &mut Fields<'_>) -> Option<Self> {
        let sequence = match fields.layout() {
            Layout::Ros1 => Some(fields.u32()?),
            Layout::Cdr => None,
        };
        let (seconds, nanoseconds) = (fields.u32()?, fields.u32()?);
        fields.text()?;
        Some(Self {
            sequence,
            stamp_ns: i64::from(seconds) * 1_000_000_000 + i64::from(nanoseconds),
        })
    }
}

/// `sensor_msgs/Image`.
pub(super) struct Image<'a> {
    pub(super) header: Header,
    pub(super) height: u32,
    pub(super) width: u32,
    pub(super) encoding: &'a str,
    pub(super) big_endian: bool,
    /// Bytes from row to row.
    pub(super) step: u32,
    pub(super) data: &'a [u8],
}

impl<'a> Image<'a> {
    pub(super) fn read(bytes: &'a [u8], layout: Layout) -> Option<Self> {
        let fields = &mut Fields::new(bytes, layout)?;
        Some(Self {
            header: Header::read(fields)?,
            height: fields.u32()?,
            width: fields.u32()?,
            encoding: fields.text()?,
            big_endian: fields.u8()? != 0,
            step: fields.u32()?,
            data: fields.bytes()?,
        })
    }
}

/// `sensor_msgs/CompressedImage`.
pub(super) struct CompressedImage<'a> {
    pub(super) header: Header,
    pub(super) format: &'a str,
    pub(super) data: &'a [u8],
}

impl<'a> CompressedImage<'a> {
    pub(super) fn read(bytes: &'a [u8], layout: Layout) -> Option<Self> {
        let fields = &mut Fields::new(bytes, layout)?;
        Some(Self {
            header: Header::read(fields)?,
            format: fields.text()?,
            data: fields.bytes()?,
        })
    }
}

/// The pinhole of a `sensor_msgs/CameraInfo` for the images beside it, and whether their lens is
/// distorted. `None` where the message is damaged or the camera is not calibrated (K is zero).
pub(super) fn camera_info(bytes: &[u8], layout: Layout) -> Option<(Calibration, bool)> {
    let fields = &mut Fields::new(bytes, layout)?;
    Header::read(fields)?;
    let (height, width) = (fields.u32()?, fields.u32()?);
    fields.text()?;
    let mut distorted = false;
    for _ in 0..fields.u32()? {
        distorted |= fields.f64()? != 0.0;
    }
    let k: [f64; 9] = fields.f64s()?;
    let _rectification: [f64; 9] = fields.f64s()?;
    let _projection: [f64; 12] = fields.f64s()?;
    let binning = [fields.u32()?, fields.u32()?].map(|n| f64::from(n.max(1)));
    let (x0, y0) = (f64::from(fields.u32()?), f64::from(fields.u32()?));
    let (roi_height, roi_width) = (fields.u32()?, fields.u32()?);
    let finite = k.iter().all(|value| value.is_finite());
    if !finite || k[0] <= 0.0 || k[4] <= 0.0 {
        return None;
    }
    // K is for the whole sensor: the image is a window of it, then binned
    let centre = |c: f64, from: f64, by: f64| (c - from + 0.5) / by - 0.5;
    let mut calibration = Calibration::from_intrinsics(Intrinsics {
        fx: k[0] / binning[0],
        fy: k[4] / binning[1],
        cx: centre(k[2], x0, binning[0]),
        cy: centre(k[5], y0, binning[1]),
    });
    let part = |whole: u32, window: u32, by: f64| {
        let side = if window == 0 { whole } else { window };
        (f64::from(side) / by) as u32
    };
    let size = (
        part(width, roi_width, binning[0]),
        part(height, roi_height, binning[1]),
    );
    calibration.size = Some(size).filter(|size| size.0 > 0 && size.1 > 0);
    Some((calibration, distorted))
}

/// `std_msgs/Float32`.
pub(super) fn float32(bytes: &[u8], layout: Layout) -> Option<f32> {
    Fields::new(bytes, layout)?.f32()
}
