//! A long run with faults everywhere: does memory grow, does the account balance, is the file whole?

use crate::stages::{FPS, encode_stage, input, model_stage, time_ns};
use saint_live::capture::{CaptureError, FrameSource, Next, SourceLosses};
use saint_live::frame::{Camera, ColorFrame, DepthFrame};
use saint_live::pipeline::budget::{Budget, Late};
use saint_live::pipeline::clock::Monotonic;
use saint_live::pipeline::packet::Packet;
use saint_live::pipeline::recorder::Recorder;
use saint_live::pipeline::stages::Sink;
use saint_live::pipeline::statistics::Drops;
use saint_live::pipeline::{Options, Pace, Priority, StageError, Stages, run as run_pipeline};
use saint_live::recording::{
    RecordingReader, RecordingWriter, Split, Target, WriterOptions, check,
};
use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant};

/// The looped input with everything a camera does wrong, by chance but always the same.
struct Faulty {
    camera: Camera,
    frames: Vec<DepthFrame>,
    sequence: u64,
    losses: SourceLosses,
    chance: u64,
}

impl Faulty {
    /// True once in `odds` times.
    fn happens(&mut self, odds: u64) -> bool {
        self.chance = self
            .chance
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (self.chance >> 33).is_multiple_of(odds)
    }
}

impl FrameSource for Faulty {
    fn camera(&self) -> &Camera {
        &self.camera
    }
    fn is_live(&self) -> bool {
        false
    }
    fn losses(&self) -> SourceLosses {
        self.losses
    }
    fn next(&mut self, frame: &mut DepthFrame) -> Result<Next, CaptureError> {
        if self.happens(200) {
            self.losses.sensor_gap += 2;
            self.sequence += 2;
        }
        if self.happens(300) {
            self.losses.damaged += 1;
            self.sequence += 1;
        }
        if self.happens(1000) {
            self.losses.stall += 1;
            self.sequence += 1;
            return Ok(Next::Waiting(None));
        }
        let from = &self.frames[self.sequence as usize % self.frames.len()];
        frame.sequence = self.sequence;
        frame.time.device_ns = time_ns(self.sequence);
        frame.depth.clone_from(&from.depth);
        self.sequence += 1;
        Ok(Next::Frame)
    }
}

/// An output that is slow at times.
struct Slow {
    recorder: Recorder,
    frames: u64,
}

impl Sink for Slow {
    fn frame(&mut self, packet: &Packet) -> Result<(), StageError> {
        self.frames += 1;
        if self.frames.is_multiple_of(700) {
            std::thread::sleep(Duration::from_millis(250));
        }
        self.recorder.frame(packet)
    }
    fn color(&mut self, color: &ColorFrame) -> Result<(), StageError> {
        self.recorder.color(color)
    }
    fn idle(&mut self) -> Result<(), StageError> {
        self.recorder.idle()
    }
    fn finish(&mut self) -> Result<(), StageError> {
        self.recorder.finish()
    }
    fn account(&mut self, drops: &Drops) {
        self.recorder.account(drops);
    }
    fn kept(&self) -> Option<u64> {
        self.recorder.kept()
    }
}

/// Resident memory, KiB.
fn resident_kib() -> f64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap();
    let line = status.lines().find(|line| line.starts_with("VmRSS:"));
    let number = line.and_then(|line| line.split_whitespace().nth(1)?.parse().ok());
    number.unwrap()
}

/// Runs for this long and says what it cost.
pub fn run(length: Duration) {
    let folder = tempfile::tempdir().unwrap();
    let (camera, frames) = input();
    let target = Target::File {
        path: folder.path().join("soak.mcap"),
        overwrite: false,
    };
    let options = WriterOptions {
        split: Some(Split::Bytes(20_000_000)),
        ..WriterOptions::default()
    };
    let writer = RecordingWriter::create(target, &camera, &options).unwrap();
    let mut source = Faulty {
        camera: camera.clone(),
        frames,
        sequence: 0,
        losses: SourceLosses::default(),
        chance: 1,
    };
    let mut sink = Slow {
        recorder: Recorder::new(writer),
        frames: 0,
    };
    let stages = Stages {
        source: &mut source,
        color: None,
        model: &mut model_stage(&camera),
        encode: &mut encode_stage(&camera),
        sink: &mut sink,
        trace: None,
        start: None,
    };
    let options = Options {
        threads: 2,
        stage_threads: 0,
        priority: Priority::Usual,
        pace: Pace::Realtime,
        budget: Budget {
            limit: Duration::from_millis(1000 / FPS),
            late: Late::Degrade,
        },
        frames: None,
        duration: Some(length),
    };
    let start = Instant::now();
    let mut memory: Vec<(f64, f64)> = Vec::new();
    let stop = AtomicBool::new(false);
    let outcome = run_pipeline(stages, &options, &Monotonic, &stop, &mut |_| {
        let now = start.elapsed().as_secs_f64();
        if memory.last().is_none_or(|(last, _)| now - last >= 1.0) {
            memory.push((now, resident_kib()));
        }
    });
    outcome.result.unwrap();
    let report = outcome.report;
    let drops = serde_json::to_string(&report.drops).unwrap();
    println!(
        "{:.0} s: sensor {}, written {}, drops {drops}",
        report.elapsed_s, report.sensor_frames, report.frames
    );
    assert_eq!(report.sensor_frames, report.frames + report.drops.total());
    let summary = sink.recorder.summary.take().unwrap();
    assert_eq!(summary.frames, report.frames);
    println!("file: {} parts, {} bytes", summary.parts, summary.bytes);
    // the first tenth fills buffers and the allocator's pools
    let settled = &memory[memory.len() / 10..];
    println!(
        "memory: {:.0} KiB at first, {:.0} KiB settled, {:.0} KiB at the end, slope {:.2} KiB/min",
        memory[0].1,
        settled[0].1,
        settled[settled.len() - 1].1,
        slope(settled) * 60.0
    );
    let mut frames = 0;
    for entry in std::fs::read_dir(folder.path()).unwrap() {
        let path = entry.unwrap().path();
        let found = check(&path, true, &mut |_| true).unwrap();
        assert!(found.is_sound(), "{:?}", found.faults);
        frames += RecordingReader::open(&path).unwrap().frames();
    }
    assert_eq!(frames, report.frames);
    println!("check: every part is sound, {frames} frames decoded");
}

/// Least squares.
fn slope(points: &[(f64, f64)]) -> f64 {
    let n = points.len() as f64;
    let mean = |f: fn(&(f64, f64)) -> f64| points.iter().map(f).sum::<f64>() / n;
    let (x, y) = (mean(|p| p.0), mean(|p| p.1));
    let (mut above, mut below) = (0.0, 0.0);
    for point in points {
        above += (point.0 - x) * (point.1 - y);
        below += (point.0 - x).powi(2);
    }
    if below > 0.0 { above / below } else { 0.0 }
}
