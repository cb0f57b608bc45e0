//! Where frames come from: one trait, all sources.
//!
//! A source owns its device or folder, fills the buffer it is handed (buffers go round; no
//! allocation per frame) and reports every loss it can see.

pub mod color;
pub mod color_image;
mod color_open;
pub mod containers;
pub mod devices;
pub mod sequences;
pub mod synthetic;
pub mod v4l2;

use crate::frame::{Camera, ColorFrame, DepthFrame};
use std::path::PathBuf;

/// What [`FrameSource::next`] found.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Next {
    /// The buffer holds a frame.
    Frame,
    /// No frame within the source's poll interval (at most 200 ms); ask again. The text says why
    /// where there is something to say ("camera unplugged, waiting for it").
    Waiting(Option<String>),
    /// The sequence is over.
    End,
}

/// Frames that never left the source, by cause.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct SourceLosses {
    /// Sequence numbers the sensor or driver skipped (or numbered files that are missing).
    pub sensor_gap: u64,
    /// Frames the driver flagged as damaged, or that were short.
    pub damaged: u64,
    /// Whole frames the driver held when a broken stream had to be started anew.
    pub stall: u64,
}

/// A stream of depth frames: camera, recorded sequence or synthetic sensor.
pub trait FrameSource: Send {
    /// The camera as it was opened. Constant over the life of the source.
    fn camera(&self) -> &Camera;
    /// True for a device that does not wait for us: its oldest frames are dropped when we are late.
    fn is_live(&self) -> bool;
    /// Number of frames to come where it is known (progress bars).
    fn len_hint(&self) -> Option<u64> {
        None
    }
    /// Fills `frame` with the next depth frame.
    ///
    /// # Errors
    /// Anything that ends the stream: [`CaptureError`] names the file or device, the frame and the remedy.
    fn next(&mut self, frame: &mut DepthFrame) -> Result<Next, CaptureError>;
    /// The colour image recorded beside the frame last returned, where the source has one.
    fn take_color(&mut self) -> Option<ColorFrame> {
        None
    }
    /// Facts worth keeping about where the frames come from: device, clock, who gave the
    /// intrinsics. Names are fixed, values are for people.
    fn notes(&self) -> Vec<(&'static str, String)> {
        Vec::new()
    }
    /// Frames lost so far, by cause.
    fn losses(&self) -> SourceLosses {
        SourceLosses::default()
    }
}

/// Why a source cannot go on; a variant is what the caller does about it.
#[derive(Debug, thiserror::Error)]
pub enum CaptureError {
    /// The request itself is wrong (unknown scene, bad number): usage, exit 2.
    #[error("{0}")]
    Usage(String),
    /// The device cannot be opened, configured or read: exit 3.
    #[error("{device}: {what}; {remedy}")]
    Device {
        /// Path of the device node.
        device: String,
        /// What happened.
        what: String,
        /// What to do.
        remedy: String,
    },
    /// A file or folder is missing, damaged or inconsistent: exit 4.
    #[error("{}{}: {what}; {remedy}", .path.display(), .frame.map(|n| format!(" (frame {n})")).unwrap_or_default())]
    Input {
        /// File or folder.
        path: PathBuf,
        /// Frame number, where there is one.
        frame: Option<u64>,
        /// What happened.
        what: String,
        /// What to do.
        remedy: String,
    },
}
