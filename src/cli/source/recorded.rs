//! A recording of ours as a source of depth frames: its payloads, decoded.

use super::{Camera, CaptureError, ColorFrame, DepthFrame, FrameSource, Next, SourceLosses};
use crate::cli::failure::Failure;
use saint_live::codec::{CodecError, Decoder, EncodedFrame};
use saint_live::recording::{RecordingError, RecordingReader};
use std::collections::VecDeque;
use std::path::{Path, PathBuf};

/// Plays a recording frame by frame. A damaged place is skipped to the next key frame and counted;
/// a cut file plays to its last whole frame. Either is told at the end, as an error.
pub struct RecordedSource {
    path: PathBuf,
    camera: Camera,
    reader: RecordingReader,
    decoder: Decoder,
    encoded: EncodedFrame,
    colors: VecDeque<ColorFrame>,
    /// Frames to decode and not to give: they lead up to the first one asked for.
    lead_in: u64,
    left: u64,
    last_sequence: Option<u64>,
    losses: SourceLosses,
    fault: Option<CaptureError>,
}

impl RecordedSource {
    /// Opens a recording at frame `from`, up to (not including) frame `to`.
    pub fn open(path: &Path, from: u64, to: Option<u64>) -> Result<Self, Failure> {
        let mut reader = RecordingReader::open(path)?;
        let end = to.unwrap_or(u64::MAX).min(reader.frames());
        let lead_in = if from == 0 {
            0
        } else {
            reader.seek(from)?.decode_through
        };
        Ok(Self {
            path: path.to_owned(),
            camera: reader.camera().clone(),
            left: end.saturating_sub(from),
            reader,
            decoder: Decoder::new(),
            encoded: EncodedFrame::default(),
            colors: VecDeque::new(),
            lead_in,
            last_sequence: None,
            losses: SourceLosses::default(),
            fault: None,
        })
    }

    /// Narrows the depths that are measurements, metres.
    pub fn limit_depth(&mut self, min_m: Option<f64>, max_m: Option<f64>) {
        if let Some(min) = min_m {
            self.camera.depth_min_m = self.camera.depth_min_m.max(min);
        }
        if let Some(max) = max_m {
            self.camera.depth_max_m = self.camera.depth_max_m.min(max);
        }
    }

    /// Keeps the first fault and tells each.
    fn fault(&mut self, what: &dyn std::fmt::Display) {
        tracing::warn!("{what}");
        self.fault.get_or_insert_with(|| CaptureError::Input {
            path: self.path.clone(),
            frame: Some(self.reader.position()),
            what: what.to_string(),
            remedy: "what could be read was used; record again, or use an intact copy".to_owned(),
        });
    }

    fn end(&mut self) -> Result<Next, CaptureError> {
        self.fault.take().map_or(Ok(Next::End), Err)
    }
}

impl FrameSource for RecordedSource {
    fn camera(&self) -> &Camera {
        &self.camera
    }

    fn is_live(&self) -> bool {
        false
    }

    fn len_hint(&self) -> Option<u64> {
        Some(self.left)
    }

    fn next(&mut self, frame: &mut DepthFrame) -> Result<Next, CaptureError> {
        loop {
            if self.left == 0 {
                return self.end();
            }
            match self.reader.next_frame(&mut self.encoded) {
                Ok(true) => {}
                Ok(false) => return self.end(),
                Err(error @ RecordingError::Damaged { .. }) => {
                    self.fault(&error);
                    continue;
                }
                Err(error) => {
                    self.fault(&error);
                    return self.end();
                }
            }
            self.colors.extend(self.reader.take_colors());
            let decoded = match self.decoder.decode(&self.encoded.payload) {
                Ok(decoded) => decoded,
                Err(error) => {
                    // frames after a damaged place wait for their key frame
                    if !matches!(error, CodecError::MissingReference { .. }) {
                        self.fault(&error);
                    }
                    continue;
                }
            };
            if self.lead_in > 0 {
                self.lead_in -= 1;
                self.colors.clear();
                continue;
            }
            self.left -= 1;
            frame.sequence = self.encoded.sequence;
            frame.time = self.encoded.time;
            depth_integers(&decoded.depth_m, &self.camera, &mut frame.depth);
            if let Some(last) = self.last_sequence {
                self.losses.sensor_gap += frame.sequence.saturating_sub(last + 1);
            }
            self.last_sequence = Some(frame.sequence);
            return Ok(Next::Frame);
        }
    }

    fn take_color(&mut self) -> Option<ColorFrame> {
        self.colors.pop_front()
    }

    fn losses(&self) -> SourceLosses {
        self.losses
    }
}

/// Metres as the camera's depth integers, row-major; what is not a depth becomes 0. The largest
/// integer stands for everything beyond it; codes that mean "no measurement" are stepped over.
pub fn depth_integers(depth_m: &[f32], camera: &Camera, out: &mut Vec<u16>) {
    let per_metre = 1.0 / camera.depth_unit_m;
    out.clear();
    out.extend(depth_m.iter().map(|&z| {
        if !(z.is_finite() && z > 0.0) {
            return 0;
        }
        let raw = (f64::from(z) * per_metre).round().clamp(1.0, 65535.0) as u16;
        if camera.invalid.contains(&raw) {
            raw - 1
        } else {
            raw
        }
    }));
}
