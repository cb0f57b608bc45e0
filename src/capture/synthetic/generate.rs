//! Recordings made by the synthetic sensor.

use super::{SyntheticOptions, SyntheticSource};
use crate::capture::{CaptureError, FrameSource, Next};
use crate::frame::{Camera, DepthFrame};

/// Hands `frames` frames of the sensor to `write`, one after the other, as fast as it takes them.
/// Returns how many were written. The sequence numbers start at 0, the times at 0 ns.
///
/// The file format is the caller's: `write` gets the camera with every frame.
///
/// # Errors
/// [`CaptureError::Usage`] for options out of range (as the caller's error), or what `write` says.
pub fn generate<E: From<CaptureError>>(
    options: SyntheticOptions,
    frames: u64,
    write: &mut dyn FnMut(&Camera, &DepthFrame) -> Result<(), E>,
) -> Result<u64, E> {
    let mut source = SyntheticSource::open(SyntheticOptions {
        paced: false,
        frames: Some(frames),
        ..options
    })?;
    let mut frame = DepthFrame::default();
    let mut written = 0;
    while source.next(&mut frame)? == Next::Frame {
        write(source.camera(), &frame)?;
        written += 1;
    }
    Ok(written)
}
