//! Other programs' recordings: one file that holds depth images among other things.
//!
//! ```text
//! .bag   rosbag ──┐ messages                      ┌─ intrinsics, unit, numbers and times from the
//! .mcap  mcap   ──┴─► ros ───┐ depth images       │  file; what is missing from the user
//! .mkv   matroska ───────────┼────────────► source ─► FrameSource
//! .sens  sens ───────────────┘
//! ```
//! | file | what is read |
//! |---|---|
//! | `.bag` (ROS 1, RealSense) | `sensor_msgs/Image` of 16UC1, mono16 or 32FC1, `CompressedImage` of compressedDepth, `CameraInfo`, RealSense's `Depth_Units` |
//! | `.mcap` (ROS 2, ROS 1, raw captures of this program) | the same messages |
//! | `.mkv` (Azure Kinect) | the track `DEPTH` of 16-bit big-endian integers, `calibration.json` among the attachments |
//! | `.sens` (ScanNet) | raw and zlib depth, the header's intrinsics and unit |
//!
//! Every length is checked against what is left of the file and against a limit before memory is
//! taken. A cut file gives its whole images, then an error.

mod matroska;
mod mcap;
mod open;
mod ros;
mod rosbag;
pub mod rvl;
mod sens;
mod source;

pub use open::{holds_depth_images, is_container};

use super::CaptureError;
use super::sequences::camera::Said;
use super::sequences::{SequenceOptions, input};
use crate::frame::{ColorFrame, FrameTime};
use crate::intrinsics::Calibration;
use std::path::Path;

/// Largest record, message or decompressed chunk that is read, bytes.
const MAX_RECORD: u64 = 256 << 20;
/// What to do about a damaged file.
const REPLACE: &str = "every whole image before it was used; take an intact copy for the rest";

/// One depth image as a file holds it. The buffers are used again for the next image.
#[derive(Debug, Default)]
struct DepthImage {
    width: u32,
    height: u32,
    /// Which of the two buffers holds the image.
    stored: Stored,
    /// Depth integers, row-major.
    integers: Vec<u16>,
    /// Planar depth in metres, row-major; 0 or not finite where nothing was measured.
    metres: Vec<f32>,
    /// The file's own frame number, where it has one.
    number: Option<u64>,
    time: Stamp,
}

/// How an image's depth is stored.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Stored {
    #[default]
    Integers,
    Metres,
}

/// When an image was taken, as far as the file says.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Stamp {
    /// Not at all.
    #[default]
    Unknown,
    /// On one clock, ns: Unix time or the recording's own.
    Clock(i64),
    /// On both clocks.
    Exact(FrameTime),
}

/// What a file says before its first image.
#[derive(Debug, Default)]
struct About {
    /// What the file says of the camera.
    said: Said,
    /// The same, for an image size that may be another.
    calibration: Option<Calibration>,
    /// Metres per depth integer by the format's own convention.
    unit_m: Option<f64>,
    /// Number of images, where the file says so.
    images: Option<u64>,
}

/// A file of depth images, read from its beginning.
trait Container: Send {
    /// What was found on opening.
    fn about(&self) -> &About;

    /// Reads the next depth image; `false` at the end.
    ///
    /// # Errors
    /// The file is damaged or cut here; what follows may still be read by the next call.
    fn next(&mut self, image: &mut DepthImage) -> Result<bool, CaptureError>;

    /// The colour image that stands before the depth image last read, where there is one; of
    /// several the newest.
    fn take_color(&mut self) -> Option<ColorFrame> {
        None
    }
}

/// Opens a file that [`is_container`] knows.
///
/// # Errors
/// [`CaptureError::Input`] names the file and what is wrong with it or missing in it.
pub(super) fn open(
    path: &Path,
    options: &SequenceOptions,
) -> Result<Box<dyn super::FrameSource>, CaptureError> {
    let container = open::container(path, options)?;
    Ok(Box::new(source::ContainerSource::open(
        container, path, options,
    )?))
}

/// An error about a file that cannot be used from here on.
fn damaged(path: &Path, what: impl Into<String>) -> CaptureError {
    input(path, what, REPLACE)
}
