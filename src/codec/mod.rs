//! The frame payload: a SAINT frame as bytes (`FORMAT.md`).

pub mod polar;

use crate::frame::FrameTime;

/// One encoded frame, as it is stored or sent.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct EncodedFrame {
    /// The source's frame number.
    pub sequence: u64,
    /// When the frame was taken.
    pub time: FrameTime,
    /// True where the payload decodes alone.
    pub key: bool,
    /// The payload's bytes.
    pub payload: Vec<u8>,
}
