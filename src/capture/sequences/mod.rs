//! Recorded sequences: folders and files of depth images as a [`FrameSource`].
//!
//! [`open`] decides the layout (`layout`, `tum`), the numbering and the gaps (`numbering`), the
//! times (`timestamps`) and who is believed about the camera (`camera`); `source` then reads one
//! image per frame ([`exr`], [`png`]). Float depth becomes integers in one place (`metres`).
//!
//! | input | what is read |
//! |---|---|
//! | folder with `depth.txt` | TUM RGB-D: 16-bit PNG, 5000 units/m, colour by nearest time |
//! | folder with `frame-000000.depth.png` | 7-Scenes: 16-bit PNG, millimetres, 65535 invalid |
//! | folder with `depth/` | `depth/*.png` or `depth/*.exr`, `colour/`, `camera.json`, `timestamps.txt` |
//! | folder of images | `*.exr` or 16-bit `*.png`, in numeric order |
//! | `depth_%06d.exr` | the files of that name, in numeric order |
//! | `frame.exr`, `frame.png` | one frame |
//! | `.bag`, `.mcap`, `.mkv`, `.sens` | other programs' recordings: [`containers`] |

pub(super) mod camera;
pub mod camera_json;
pub mod exr;
pub mod exr_attributes;
mod layout;
pub(super) mod metres;
mod numbering;
pub mod png;
mod seven_scenes;
mod source;
pub(super) mod timestamps;
mod tum;

use super::{CaptureError, FrameSource, containers};
use crate::intrinsics::{Calibration, HOW_TO_GIVE, IntrinsicsError};
use std::path::{Path, PathBuf};

pub use numbering::natural_order;
pub use timestamps::timestamp_line;

/// 4096x4096: no depth sensor has more pixels; a file that says so is damaged.
const MAX_PIXELS: u64 = 1 << 24;
/// Rate of sequences that name neither times nor a rate.
pub(super) const DEFAULT_FPS: f64 = 30.0;
/// Unit of integers that name none: millimetres, as most tools write them.
pub(super) const DEFAULT_UNIT_M: f64 = 0.001;

/// What the values of an EXR depth channel measure.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ExrDepth {
    /// Distance along the optical axis, metres.
    #[default]
    Planar,
    /// Distance from the camera along the pixel's ray, metres.
    Ray,
    /// One over the planar distance, 1/metres.
    Inverse,
}

impl std::str::FromStr for ExrDepth {
    type Err = CaptureError;

    fn from_str(name: &str) -> Result<Self, CaptureError> {
        match name {
            "planar" => Ok(Self::Planar),
            "ray" => Ok(Self::Ray),
            "inverse" => Ok(Self::Inverse),
            _ => Err(CaptureError::Usage(format!(
                "EXR depth \"{name}\": planar, ray or inverse expected"
            ))),
        }
    }
}

/// What the user said about a recorded sequence; everything here wins over the files.
#[derive(Clone, Debug, Default)]
pub struct SequenceOptions {
    /// Intrinsics and whatever else the calibration file holds.
    pub calibration: Option<Calibration>,
    /// Metres per depth integer.
    pub depth_unit_m: Option<f64>,
    /// Nearest depth that is a measurement, metres.
    pub depth_min_m: Option<f64>,
    /// Farthest depth that is a measurement, metres.
    pub depth_max_m: Option<f64>,
    /// Depth integers that mean "no measurement".
    pub invalid: Option<Vec<u16>>,
    /// Frames per second.
    pub fps: Option<f64>,
    /// What the EXR depth channel measures.
    pub exr_depth: ExrDepth,
    /// EXR channel to read instead of `Z`, by its full name.
    pub exr_channel: Option<String>,
    /// EXR layer (part, or prefix of the channel name) to look in.
    pub exr_layer: Option<String>,
    /// Topic of the depth images in a file of messages.
    pub topic: Option<String>,
    /// Frames to leave out at the start.
    pub first: usize,
    /// Frames to give at most.
    pub count: Option<usize>,
    /// Leave the colour images beside the depth where they are.
    pub without_color: bool,
}

/// Opens a recorded sequence: a folder, a single image, a printf pattern or another program's file.
///
/// The first frame is read here, so that whatever is wrong with all frames is said at once.
///
/// # Errors
/// [`CaptureError::Input`] names the file, the frame and the remedy; [`CaptureError::Usage`] when
/// `options` asks for something impossible.
pub fn open(input: &Path, options: &SequenceOptions) -> Result<Box<dyn FrameSource>, CaptureError> {
    check(options)?;
    if containers::is_container(input) {
        return containers::open(input, options);
    }
    if let Some(topic) = &options.topic {
        let shown = input.display();
        return Err(CaptureError::Usage(format!(
            "--topic {topic}: {shown} has no topics"
        )));
    }
    let layout = layout::find(input)?;
    Ok(Box::new(source::ImageSequence::open(layout, options)?))
}

fn check(options: &SequenceOptions) -> Result<(), CaptureError> {
    let positive = [
        ("depth unit", options.depth_unit_m),
        ("largest depth", options.depth_max_m),
        ("frame rate", options.fps),
    ];
    for (what, value) in positive {
        if let Some(value) = value.filter(|value| !(value.is_finite() && *value > 0.0)) {
            return Err(CaptureError::Usage(format!(
                "the {what} is {value}, but it must be above 0"
            )));
        }
    }
    if let Some(min) = options
        .depth_min_m
        .filter(|min| !(min.is_finite() && *min >= 0.0))
    {
        let what = format!("the nearest depth is {min}, but it must be 0 or more");
        return Err(CaptureError::Usage(what));
    }
    Ok(())
}

/// An input error without a frame number.
pub(super) fn input(
    path: &Path,
    what: impl Into<String>,
    remedy: impl Into<String>,
) -> CaptureError {
    CaptureError::Input {
        path: path.to_owned(),
        frame: None,
        what: what.into(),
        remedy: remedy.into(),
    }
}

/// The same error, naming the frame too.
pub(super) fn in_frame(error: CaptureError, number: u64) -> CaptureError {
    match error {
        CaptureError::Input {
            path, what, remedy, ..
        } => CaptureError::Input {
            path,
            frame: Some(number),
            what,
            remedy,
        },
        other => other,
    }
}

fn calibration_error(error: IntrinsicsError, input_path: &Path) -> CaptureError {
    match error {
        IntrinsicsError::Io { path, source } => {
            input(&path, source.to_string(), "check its permissions")
        }
        IntrinsicsError::Unreadable { path, what } => {
            input(&path, what, format!("repair it, or {HOW_TO_GIVE}"))
        }
        IntrinsicsError::Aspect { calibrated, image } => input(
            input_path,
            format!(
                "the calibration is for {}x{} and the image is {}x{}, another aspect",
                calibrated.0, calibrated.1, image.0, image.1
            ),
            "give the intrinsics of that image size with --intrinsics",
        ),
        IntrinsicsError::Text { .. } => CaptureError::Usage(error.to_string()),
    }
}

/// Checks an image size before anything of that size is allocated; gives its pixels, or says what
/// is wrong.
pub(super) fn pixel_count(width: u64, height: u64) -> Result<usize, String> {
    let pixels = width.saturating_mul(height);
    if pixels == 0 || pixels > MAX_PIXELS {
        return Err(format!(
            "{width}x{height} pixels, but 1 to {MAX_PIXELS} are possible"
        ));
    }
    Ok(pixels as usize)
}

/// The same for an image file.
fn checked_pixels(path: &Path, width: u64, height: u64) -> Result<usize, CaptureError> {
    pixel_count(width, height).map_err(|what| input(path, what, "replace the file"))
}

/// One depth image of a sequence.
#[derive(Clone, Debug, PartialEq)]
struct FrameFile {
    path: PathBuf,
    /// Frame number: from the file name where it has one, else the position.
    number: u64,
    time: Option<crate::frame::FrameTime>,
    color: Option<ColorFile>,
}

/// The colour image recorded with a depth image.
#[derive(Clone, Debug, PartialEq)]
struct ColorFile {
    path: PathBuf,
    time: Option<crate::frame::FrameTime>,
}

#[cfg(test)]
mod damage_tests;
#[cfg(test)]
mod tests;
