//! Throughput of the whole pipeline: frames from memory, paced by nothing, written nowhere, in one
//! thread and in several by turns.

use super::super::engine::{self, Engine};
use super::super::failure::{Failure, Kind};
use super::forth_and_back;
use saint_live::capture::{CaptureError, FrameSource, Next};
use saint_live::frame::{Camera, DepthFrame};
use saint_live::pipeline::budget::Budget;
use saint_live::pipeline::clock::Monotonic;
use saint_live::pipeline::packet::Packet;
use saint_live::pipeline::stages::Sink;
use saint_live::pipeline::{self, Options, Pace, Priority, StageError, Stages};
use serde::Serialize;
use std::sync::atomic::AtomicBool;

/// Rounds, each once with one thread and once with all.
const ROUNDS: usize = 5;

/// Frames per second with one thread and with all of them.
#[derive(Debug, Serialize)]
pub struct Throughput {
    /// With one thread, median of the rounds.
    pub fps_of_one: f64,
    /// With all threads, median of the rounds.
    pub fps: f64,
    /// Median of the rounds' ratios.
    pub speed_up: f64,
    /// Least and largest of them.
    pub speed_up_range: [f64; 2],
    /// Rounds.
    pub rounds: usize,
}

impl Throughput {
    /// A line of the table.
    pub fn line(&self) -> String {
        let [least, most] = self.speed_up_range;
        format!(
            "throughput  {:.1} frames a second, with one thread {:.1}: x{:.2} (x{least:.2} to x{most:.2} of {} rounds)\n",
            self.fps, self.fps_of_one, self.speed_up, self.rounds
        )
    }
}

/// Measures `count` frames a round; `None` where there is one thread only.
pub fn measure(
    camera: &Camera,
    engine: &Engine,
    frames: &[DepthFrame],
    count: u64,
    stop: &AtomicBool,
) -> Result<Option<Throughput>, Failure> {
    if engine.threads < 2 {
        return Ok(None);
    }
    let one = Engine {
        threads: 1,
        ..engine.clone()
    };
    let (mut alone, mut together, mut ratios) = (Vec::new(), Vec::new(), Vec::new());
    for _ in 0..ROUNDS {
        let slow = round(camera, &one, frames, count, stop)?;
        let fast = round(camera, engine, frames, count, stop)?;
        alone.push(slow);
        together.push(fast);
        ratios.push(fast / slow);
    }
    for figures in [&mut alone, &mut together, &mut ratios] {
        figures.sort_by(f64::total_cmp);
    }
    Ok(Some(Throughput {
        fps_of_one: alone[ROUNDS / 2],
        fps: together[ROUNDS / 2],
        speed_up: ratios[ROUNDS / 2],
        speed_up_range: [ratios[0], ratios[ROUNDS - 1]],
        rounds: ROUNDS,
    }))
}

/// One run from the first frame to the last, in a thread that is its own pool of workers.
fn round(
    camera: &Camera,
    engine: &Engine,
    frames: &[DepthFrame],
    count: u64,
    stop: &AtomicBool,
) -> Result<f64, Failure> {
    let (mut model, mut encode) = engine::stages(camera, engine)?;
    let mut source = Memory {
        camera,
        frames,
        next: 0,
    };
    let options = Options {
        threads: engine.threads,
        stage_threads: engine.stage_threads(1, true),
        priority: Priority::Usual,
        pace: Pace::Block,
        budget: Budget::UNLIMITED,
        frames: Some(count),
        duration: None,
    };
    let stages = Stages {
        source: &mut source,
        color: None,
        model: model.as_mut(),
        encode: &mut encode,
        sink: &mut Nowhere,
        trace: None,
        start: None,
    };
    let ended = std::thread::scope(|scope| {
        let run = || {
            let _own = Engine::own_worker();
            pipeline::run(stages, &options, &Monotonic, stop, &mut |_| ())
        };
        scope.spawn(run).join()
    });
    let outcome = ended.map_err(|_| Failure::new(Kind::Failure, "the pipeline panicked"))?;
    outcome.result?;
    if outcome.report.frames < count {
        return Err(Failure::new(
            Kind::Failure,
            "stopped before the bench was done",
        ));
    }
    Ok(outcome.report.fps)
}

/// Frames held in memory, forth and back.
struct Memory<'a> {
    camera: &'a Camera,
    frames: &'a [DepthFrame],
    next: u64,
}

impl FrameSource for Memory<'_> {
    fn camera(&self) -> &Camera {
        self.camera
    }

    fn is_live(&self) -> bool {
        false
    }

    fn next(&mut self, frame: &mut DepthFrame) -> Result<Next, CaptureError> {
        let held = &self.frames[forth_and_back(self.next, self.frames.len())];
        frame.depth.clone_from(&held.depth);
        frame.time = held.time;
        frame.sequence = self.next;
        self.next += 1;
        Ok(Next::Frame)
    }
}

/// An output that keeps nothing.
struct Nowhere;

impl Sink for Nowhere {
    fn frame(&mut self, _: &Packet) -> Result<(), StageError> {
        Ok(())
    }
}
