//! A depth camera that needs no hardware: analytic scenes, a sensor's noise, known truth.
//!
//! ```text
//! scene (surfaces, pose at frame k) -> render (inverse depth, f64) -> noise (sensor) -> u16
//! ```
//! Frame `k` is a pure function of the options and `k`: any frame can be made without the ones
//! before it, in any order, with the same bytes. Paced, it behaves as a driver with six buffers
//! in front of a camera that does not wait; unpaced, frames come as fast as they are
//! asked for. A frame is rendered while the reader waits for it, so its age starts near zero (a
//! real camera adds its exposure and its transfer).
//!
//! Rendering and noise take about 2.5 ms (still camera) to 4 ms (moving camera) for a VGA frame on
//! one idle core with AVX2: 848x480 at 90 frames per second takes a third of a core. Where that is too slow
//! for the size and rate asked for, `prerender=N` renders the first N frames once and repeats
//! them; otherwise late rendering loses frames like a late reader does.

mod field;
mod generate;
mod noise;
mod options;
mod pace;
mod painter;
mod random;
mod render;
mod scene;
mod sensor;
mod surface;
#[cfg(test)]
mod tests;
mod truth;

pub use generate::generate;
use options::Fault;
pub use options::SyntheticOptions;
pub use scene::Scene;
pub use sensor::{NoiseModel, Sensor};
pub use surface::{Pose, Shape, Surface};
pub use truth::{SceneTruth, TrueSphere};

use super::{CaptureError, FrameSource, Next, SourceLosses};
use crate::frame::{Camera, DepthFrame, FrameTime};
use pace::{Driver, Schedule, Turn};
use painter::Painter;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

/// Longest time [`FrameSource::next`] keeps the reader waiting, nanoseconds.
const POLL_NS: i64 = 200_000_000;

/// The synthetic sensor.
#[derive(Debug)]
pub struct SyntheticSource {
    options: SyntheticOptions,
    camera: Camera,
    painter: Painter,
    driver: Driver,
    schedule: Schedule,
    /// Monotonic clock at the first frame, ns; set by the first call of `next`.
    start_ns: Option<i64>,
    /// Frames rendered at opening.
    rendered: Vec<Vec<u16>>,
    /// The frame rendered ahead of its time, and its depth.
    ahead: Option<u64>,
    ahead_depth: Vec<u16>,
    /// The next frame an unpaced source gives; the least a paced one may give.
    next: u64,
    losses: SourceLosses,
}

impl SyntheticSource {
    /// Opens the sensor; renders `prerender` frames.
    ///
    /// # Errors
    /// [`CaptureError::Usage`] for a number out of range.
    pub fn open(options: SyntheticOptions) -> Result<Self, CaptureError> {
        let options = options.validated()?;
        let mut painter = Painter::new(&options);
        let camera = painter.camera().clone();
        let rendered = (0..u64::from(options.prerender))
            .map(|index| {
                let mut depth = Vec::new();
                painter.paint(index, &mut depth);
                depth
            })
            .collect();
        let pauses = [options.stall, options.unplug];
        let schedule = Schedule::new(options.fps * options.speed, pauses);
        Ok(Self {
            options,
            camera,
            painter,
            driver: Driver::new(schedule),
            schedule,
            start_ns: None,
            rendered,
            ahead: None,
            ahead_depth: Vec::new(),
            next: 0,
            losses: SourceLosses::default(),
        })
    }

    /// The options it was opened with.
    #[must_use]
    pub fn options(&self) -> &SyntheticOptions {
        &self.options
    }

    /// What is really there in frame `index`: exact depth, surfaces, spheres, pose. Allocates.
    #[must_use]
    pub fn truth(&mut self, index: u64) -> SceneTruth {
        self.painter.truth(self.source_index(index))
    }

    /// Fills `depth` (resized to the image) with frame `index`, whatever came before.
    pub fn render(&mut self, index: u64, depth: &mut Vec<u16>) {
        let index = self.source_index(index);
        match self.rendered.get(index as usize) {
            Some(frame) => depth.clone_from(frame),
            None => self.painter.paint(index, depth),
        }
    }

    /// The frame shown as frame `index`: another one only where frames are repeated.
    fn source_index(&self, index: u64) -> u64 {
        index
            .checked_rem(self.rendered.len() as u64)
            .unwrap_or(index)
    }

    /// Counts frame `index` as lost where it is to be, with those skipped before it.
    fn loses(&mut self, index: u64) -> bool {
        let Some(fault) = self.options.fault(index) else {
            return false;
        };
        self.losses.sensor_gap += index.saturating_sub(self.next);
        match fault {
            Fault::Lost => self.losses.sensor_gap += 1,
            Fault::Damaged => self.losses.damaged += 1,
        }
        self.next = index + 1;
        true
    }

    fn next_unpaced(&mut self, frame: &mut DepthFrame) -> Next {
        let index = self.next;
        if self.ended(index) {
            return Next::End;
        }
        if self.loses(index) {
            return Next::Waiting(None);
        }
        self.next += 1;
        self.render(index, &mut frame.depth);
        frame.sequence = index;
        frame.time = FrameTime {
            device_ns: self.schedule.due_ns(index),
            wall_ns: 0,
        };
        Next::Frame
    }

    fn next_paced(&mut self, frame: &mut DepthFrame) -> Result<Next, CaptureError> {
        let start = match self.start_ns {
            Some(start) => start,
            None => *self.start_ns.insert(monotonic_ns()?),
        };
        let asked = monotonic_ns()?;
        let index = loop {
            let now = monotonic_ns()?;
            match self.driver.turn(now - start) {
                Turn::Ready(index) if !self.ended(index) && self.loses(index) => {}
                Turn::Ready(index) => break index,
                Turn::Due(index, _) if self.ended(index) => return Ok(Next::End),
                Turn::Due(index, due) => {
                    if self.ahead != Some(index) {
                        let mut depth = std::mem::take(&mut self.ahead_depth);
                        self.render(index, &mut depth);
                        self.ahead_depth = depth;
                        self.ahead = Some(index);
                        continue;
                    }
                    let left = POLL_NS - (now - asked);
                    if left <= 0 {
                        return Ok(Next::Waiting(self.pause(index)));
                    }
                    let wait = (due - (now - start)).clamp(0, left);
                    std::thread::sleep(Duration::from_nanos(wait as u64));
                }
            }
        };
        if self.ended(index) {
            return Ok(Next::End);
        }
        if self.ahead.take() == Some(index) {
            std::mem::swap(&mut frame.depth, &mut self.ahead_depth);
        } else {
            self.render(index, &mut frame.depth);
        }
        self.losses.sensor_gap += index.saturating_sub(self.next);
        self.next = index + 1;
        let device_ns = start + self.schedule.due_ns(index);
        frame.sequence = index;
        frame.time = FrameTime {
            device_ns,
            wall_ns: wall_ns() - (monotonic_ns()? - device_ns),
        };
        Ok(Next::Frame)
    }

    /// Why frame `index` is long in coming, where it is meant to be.
    fn pause(&self, index: u64) -> Option<String> {
        let follows = |every: u64| every > 0 && index.is_multiple_of(every);
        if follows(self.options.unplug) {
            Some("synthetic sensor unplugged, waiting for it".to_owned())
        } else {
            follows(self.options.stall).then(|| "synthetic sensor stalled, waiting".to_owned())
        }
    }

    fn ended(&self, index: u64) -> bool {
        self.options.frames.is_some_and(|frames| index >= frames)
    }
}

impl FrameSource for SyntheticSource {
    fn camera(&self) -> &Camera {
        &self.camera
    }

    fn is_live(&self) -> bool {
        self.options.paced
    }

    fn len_hint(&self) -> Option<u64> {
        self.options.frames.map(|n| n.saturating_sub(self.next))
    }

    fn next(&mut self, frame: &mut DepthFrame) -> Result<Next, CaptureError> {
        if self.ended(self.next) {
            return Ok(Next::End);
        }
        if self.options.paced {
            self.next_paced(frame)
        } else {
            Ok(self.next_unpaced(frame))
        }
    }

    fn notes(&self) -> Vec<(&'static str, String)> {
        let clock = match self.options.paced {
            true => "CLOCK_MONOTONIC of the capturing machine, when the frame was due",
            false => "the scene's own, from 0",
        };
        vec![
            ("intrinsics_from", "the synthetic sensor".to_owned()),
            ("depth_unit_from", "the synthetic sensor".to_owned()),
            ("clock", clock.to_owned()),
        ]
    }

    fn losses(&self) -> SourceLosses {
        self.losses
    }
}

/// CLOCK_MONOTONIC, the clock of V4L2 time stamps, nanoseconds.
fn monotonic_ns() -> Result<i64, CaptureError> {
    let mut now = libc::timespec {
        tv_sec: 0,
        tv_nsec: 0,
    };
    // SAFETY: `now` is a valid timespec that the call only writes to.
    #[allow(unsafe_code)]
    let status = unsafe { libc::clock_gettime(libc::CLOCK_MONOTONIC, &raw mut now) };
    if status != 0 {
        return Err(CaptureError::Device {
            device: "synthetic".to_owned(),
            what: format!("no monotonic clock: {}", std::io::Error::last_os_error()),
            remedy: "use paced=false".to_owned(),
        });
    }
    Ok(now.tv_sec * 1_000_000_000 + now.tv_nsec)
}

/// Unix time, nanoseconds; 0 where the clock is before 1970.
fn wall_ns() -> i64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH);
    since.map_or(0, |since| since.as_nanos() as i64)
}
