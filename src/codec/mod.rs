//! The frame payload: a SAINT frame as bytes (`FORMAT.md`).
//!
//! Reading order, that of the payload: [`header`]; section *blocks*, which spheres a block touches
//! ([`mask`] for its fill, [`palettes`]); section *spheres* ([`sphere_table`]); section *pixels*,
//! which of them each pixel touches ([`mask`] in a [`bitmap`], [`labels`] in a [`label_map`], from the
//! last frame by [`flow`]);
//! section *residual*, what spheres do not give back ([`residual`] in [`bins`] and [`cells`]). Each is a model
//! written once for both directions over the [`range_coder`] and the [`mixer`]; [`encoder`] (with
//! `palette_choice` and `choice`) and [`decoder`] (with `output`) walk them in the same order.

pub mod merged;
pub mod polar;
mod polar_claims;

use crate::frame::FrameTime;

pub mod bins;
pub mod bitmap;
pub mod cells;
mod choice;
pub mod decoder;
pub mod effort;
pub mod encoder;
pub mod flow;
pub mod header;
pub mod label_map;
pub mod labels;
pub mod mask;
mod mask_choice;
pub mod mixer;
pub mod options;
mod output;
mod palette_choice;
pub mod palettes;
pub mod payload;
pub mod range_coder;
pub mod rate;
pub mod residual;
#[cfg(test)]
mod section_tests;
pub mod spent;
pub mod sphere_table;
mod state;
mod surface;
#[cfg(test)]
mod tile_tests;
pub mod tiles;

pub use decoder::{DecodedFrame, Decoder, Level};
pub use effort::Effort;
pub use encoder::Encoder;
pub use header::Tolerance;
pub use options::CodecOptions;
pub use payload::{Domain, Payload, PayloadDecoder};
pub use spent::{EncodeReport, Spent};

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

/// Why a payload cannot be written or read.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum CodecError {
    /// The payload ends early.
    #[error(
        "payload ends at byte {have}, {need} bytes are needed; the recording is damaged or was cut"
    )]
    Truncated {
        /// Bytes that must be there.
        need: usize,
        /// Bytes that are there.
        have: usize,
    },
    /// The bytes contradict the format.
    #[error("payload is damaged at byte {at}: {what}")]
    Corrupt {
        /// Offset in the payload.
        at: usize,
        /// What is wrong.
        what: &'static str,
    },
    /// The checksum does not match.
    #[error(
        "payload checksum is {found:08x}, its bytes give {computed:08x}; the recording is damaged"
    )]
    Checksum {
        /// As written.
        found: u32,
        /// Of the bytes that are there.
        computed: u32,
    },
    /// Another version of the format.
    #[error(
        "payload is of format version {found}, this program reads version {}; use a newer program",
        header::VERSION
    )]
    Version {
        /// As written.
        found: u8,
    },
    /// A value beyond the format's limits.
    #[error("beyond the format's limits: {0}")]
    Limit(String),
    /// A P frame without the frame it refers to.
    #[error(
        "frame {sequence} refers to frame {reference}, which was not decoded before it; start at a key frame"
    )]
    MissingReference {
        /// The P frame.
        sequence: u64,
        /// The frame it needs.
        reference: u64,
    },
    /// A polar payload that cannot be read.
    #[error(transparent)]
    Polar(#[from] polar::PolarCodecError),
    /// The frame is not of the camera the encoder was made for.
    #[error("frame has {found} pixels, the camera {expected}")]
    Size {
        /// Pixels in the frame.
        found: usize,
        /// Pixels of the camera.
        expected: usize,
    },
}
