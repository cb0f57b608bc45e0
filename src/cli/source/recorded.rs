//! A recording of ours as a source of depth frames.

use super::{Camera, CaptureError, ColorFrame, DepthFrame, FrameSource, Next, SourceLosses};
use crate::cli::failure::Failure;
use crate::cli::tape::Tape;
use saint_live::export::png16;
use std::collections::VecDeque;
use std::path::Path;

/// Gives the frames of a recording; damage met on the way is an error at the end.
pub struct RecordedSource {
    tape: Tape,
    from: u64,
    to: u64,
    given: u64,
    colors: VecDeque<ColorFrame>,
    last_sequence: Option<u64>,
    losses: SourceLosses,
}

impl RecordedSource {
    /// Opens a recording at frame `from`, up to (not including) frame `to`.
    pub fn open(path: &Path, from: u64, to: Option<u64>) -> Result<Self, Failure> {
        let mut tape = Tape::open(path)?;
        tape.seek(from)?;
        Ok(Self {
            to: to.unwrap_or(u64::MAX).min(tape.frames()),
            tape,
            from,
            given: 0,
            colors: VecDeque::new(),
            last_sequence: None,
            losses: SourceLosses::default(),
        })
    }

    /// Narrows the depths that are measurements, metres.
    pub fn limit_depth(&mut self, min_m: Option<f64>, max_m: Option<f64>) {
        let camera = &mut self.tape.camera;
        if let Some(min) = min_m {
            camera.depth_min_m = camera.depth_min_m.max(min);
        }
        if let Some(max) = max_m {
            camera.depth_max_m = camera.depth_max_m.min(max);
        }
    }

    fn end(&mut self) -> Result<Next, CaptureError> {
        match self.tape.take_fault() {
            None => Ok(Next::End),
            Some(what) => Err(CaptureError::Input {
                path: self.tape.path().to_owned(),
                frame: None,
                // the error names the path itself
                what: match what.strip_prefix(&format!("{}: ", self.tape.path().display())) {
                    Some(rest) => rest.to_owned(),
                    None => what,
                },
                remedy: "every whole frame was used; take an intact copy for the rest".to_owned(),
            }),
        }
    }
}

impl FrameSource for RecordedSource {
    fn camera(&self) -> &Camera {
        &self.tape.camera
    }

    fn is_live(&self) -> bool {
        false
    }

    fn len_hint(&self) -> Option<u64> {
        Some(self.to.saturating_sub(self.from + self.given))
    }

    fn next(&mut self, frame: &mut DepthFrame) -> Result<Next, CaptureError> {
        loop {
            let Some(number) = self.tape.advance() else {
                return self.end();
            };
            if number >= self.to {
                return self.end();
            }
            let colors = self.tape.take_colors();
            if number < self.from {
                // it only leads up to the first frame asked for
                continue;
            }
            self.colors.extend(colors);
            if self.tape.cloud().is_some() {
                return Err(CaptureError::Input {
                    path: self.tape.path().to_owned(),
                    frame: Some(number),
                    what: "has a polar contact map: points, no depth image".to_owned(),
                    remedy:
                        "replay a recording with a sensor contact map, or export this one to ply"
                            .to_owned(),
                });
            }
            let decoded = self.tape.frame();
            frame.sequence = decoded.sequence;
            frame.time = decoded.time;
            frame.depth.clear();
            let codes = decoded
                .depth_m
                .iter()
                .map(|z| png16::code(decoded.camera, *z));
            frame.depth.extend(codes);
            if let Some(last) = self.last_sequence {
                self.losses.sensor_gap += frame.sequence.saturating_sub(last + 1);
            }
            self.last_sequence = Some(frame.sequence);
            self.given += 1;
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
