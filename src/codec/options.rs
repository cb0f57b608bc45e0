//! What a stream is encoded for.

use super::effort::Effort;
use super::header::Tolerance;
use crate::fit::contact_distance::ContactDistance;

/// How a stream is encoded.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CodecOptions {
    /// A key frame at least every so many frames; 1 makes every frame a key frame.
    pub keyframe_every: u32,
    /// How well measurements come back.
    pub tolerance: Tolerance,
    /// The contact distance of the fit: errors are weighed by it, and spheres stated as finely.
    pub contact: ContactDistance,
    /// The mask may be smoothed where it is noise: few pixels are lost or invented, and counted. Never
    /// without loss.
    pub smooth_mask: bool,
    /// How long to look for fewer bits.
    pub effort: Effort,
}

/// The bound, in contact distances, where none is asked for. Within the contact distance lie all but
/// a few readings of a surface; the bound says from where on a reading is coded by itself. At 2.5
/// contact distances that costs a quarter fewer bits than at one, for a mean error 6 % larger
/// (Kinect and D435 sequences).
pub const DEFAULT_BOUND: f64 = 2.5;

impl CodecOptions {
    /// Options for spheres fitted to `contact`, with the default bound.
    #[must_use]
    pub fn fitted(contact: ContactDistance, keyframe_every: u32) -> Self {
        Self {
            keyframe_every,
            tolerance: Tolerance {
                contact: contact.scaled(DEFAULT_BOUND),
                lossless: false,
            },
            contact,
            smooth_mask: false,
            effort: Effort::Live,
        }
    }
}
