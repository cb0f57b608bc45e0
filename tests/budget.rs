//! The latency budget with the real fit and codec, sensors that turn hard, and a clock that counts
//! pieces of work instead of time: the same on every machine.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "a test fails by panicking"
)]

use saint_live::capture::FrameSource;
use saint_live::capture::synthetic::{SyntheticOptions, SyntheticSource};
use saint_live::codec::{CodecOptions, EncodedFrame, Encoder};
use saint_live::contact_map::labels::SaintFrame;
use saint_live::fit::live::{FitOptions, Modeler};
use saint_live::frame::DepthFrame;
use saint_live::pipeline::budget::{Budget, Late};
use saint_live::pipeline::clock::Clock;
use saint_live::pipeline::packet::{CodingReport, FrameRecord, ModelReport, Packet};
use saint_live::pipeline::report::Report;
use saint_live::pipeline::stages::{Encode, Model, Sink};
use saint_live::pipeline::{self, Options, Pace, Priority, StageError, Stages};
use std::sync::atomic::{AtomicBool, AtomicI64, Ordering};
use std::time::Duration;

const FPS: f64 = 30.0;
const PERIOD_NS: i64 = 33_333_333;

/// Moves on when work is done.
#[derive(Default)]
struct WorkClock(AtomicI64);

impl WorkClock {
    fn advance(&self, ns: i64) {
        self.0.fetch_add(ns, Ordering::SeqCst);
    }
}

impl Clock for WorkClock {
    fn now_ns(&self) -> i64 {
        self.0.load(Ordering::SeqCst)
    }
    fn sleep(&self, time: Duration) {
        self.advance(i64::try_from(time.as_nanos()).unwrap());
    }
}

/// What a piece of the fit takes in frame n, ns.
type Piece<'a> = &'a (dyn Fn(u64) -> i64 + Sync);

/// The fit asks for the time between its pieces of work.
struct Fit<'a> {
    modeler: Modeler,
    clock: &'a WorkClock,
    piece_ns: Piece<'a>,
}

impl Model for Fit<'_> {
    fn model(
        &mut self,
        depth: &DepthFrame,
        saint: &mut SaintFrame,
        deadline: &dyn Fn() -> bool,
    ) -> Result<ModelReport, StageError> {
        let piece_ns = (self.piece_ns)(depth.sequence);
        let fit = self.modeler.model(depth, saint, &|| {
            // once the time is up no piece is begun
            if !deadline() {
                self.clock.advance(piece_ns);
            }
            deadline()
        });
        Ok(fit.into())
    }
}

/// A tenth of the period for every frame.
struct Code<'a> {
    encoder: Encoder,
    clock: &'a WorkClock,
}

impl Encode for Code<'_> {
    fn encode(
        &mut self,
        depth: &DepthFrame,
        saint: &SaintFrame,
        modelled: &ModelReport,
        encoded: &mut EncodedFrame,
    ) -> Result<CodingReport, StageError> {
        self.encoder
            .encode(depth, saint, modelled.degraded, encoded)?;
        self.clock.advance(PERIOD_NS / 10);
        Ok(CodingReport::default())
    }
}

#[derive(Default)]
struct Keep(Vec<FrameRecord>);

impl Sink for Keep {
    fn frame(&mut self, packet: &Packet) -> Result<(), StageError> {
        self.0.push(packet.record);
        Ok(())
    }
}

/// Age when it left, ns.
fn age_ns(record: &FrameRecord) -> i64 {
    record.encode.end_ns - record.stamp_ns
}

fn coverage(record: &FrameRecord) -> f64 {
    f64::from(record.modelled.explained) / f64::from(record.modelled.points.max(1))
}

/// Runs a synthetic sensor at its pace.
fn run(scene: &str, piece_ns: Piece<'_>, late: Late) -> (Vec<FrameRecord>, Report) {
    let scene = format!("{scene},size=160x120,fps={FPS},paced=false");
    let mut source = SyntheticSource::open(SyntheticOptions::parse(&scene).unwrap()).unwrap();
    let camera = source.camera().clone();
    let fit = FitOptions::default();
    let codec = CodecOptions::fitted(fit.contact_distance, 30);
    let clock = WorkClock::default();
    let mut model = Fit {
        modeler: Modeler::new(&camera, &fit),
        clock: &clock,
        piece_ns,
    };
    let mut encode = Code {
        encoder: Encoder::new(&camera, codec).unwrap(),
        clock: &clock,
    };
    let mut sink = Keep::default();
    let options = Options {
        threads: 1,
        stage_threads: 1,
        priority: Priority::Usual,
        pace: Pace::Realtime,
        budget: Budget::one_period(Some(FPS), late),
        frames: None,
        duration: None,
    };
    let stages = Stages {
        source: &mut source,
        color: None,
        model: &mut model,
        encode: &mut encode,
        sink: &mut sink,
        trace: None,
        start: None,
    };
    let stop = AtomicBool::new(false);
    let outcome = pipeline::run(stages, &options, &clock, &stop, &mut |_| ());
    outcome.result.unwrap();
    let report = outcome.report;
    assert_eq!(report.sensor_frames, report.frames + report.drops.total());
    (sink.0, report)
}

/// A calm frame has some ten pieces, the first one of a scene some twenty.
const CALM_NS: i64 = PERIOD_NS / 50;
/// Four of them are more than the period.
const HARD_NS: i64 = PERIOD_NS / 3;
/// Age that a frame may reach: the budget, the piece it was in when that was over, the wait for the
/// frame before.
const BOUND_NS: i64 = PERIOD_NS + HARD_NS + PERIOD_NS / 9;

fn oldest(records: &[FrameRecord]) -> i64 {
    records.iter().map(age_ns).max().unwrap()
}

#[test]
fn a_hard_episode_costs_quality_not_age_and_quality_comes_back() {
    let hard = |n: u64| (20..40).contains(&n);
    let piece = |n: u64| if hard(n) { HARD_NS } else { CALM_NS };
    let (records, report) = run("juggle,frames=60", &piece, Late::Wait);
    assert!(oldest(&records) > BOUND_NS, "nothing is hard: {report:?}");
    assert!(report.late + report.drops.queue > 10, "{report:?}");
    assert_eq!((report.degraded, report.quality), (0, 1.0));

    let (records, report) = run("juggle,frames=60", &piece, Late::Degrade);
    assert!(oldest(&records) <= BOUND_NS, "age {} ns", oldest(&records));
    assert!(report.degraded >= 10 && report.quality < 0.9, "{report:?}");
    assert!(report.frames >= 50, "{report:?}");
    let before = coverage(records.iter().rfind(|r| r.sequence < 20).unwrap());
    for record in &records {
        let settled = record.sequence < 20 || record.sequence >= 43;
        if settled {
            let n = record.sequence;
            assert!(!record.modelled.degraded, "frame {n} is degraded");
            assert!(age_ns(record) < PERIOD_NS, "frame {n} is late");
        }
    }
    let after = coverage(records.last().unwrap());
    assert!(after > before - 0.03, "{after} after, {before} before");
}

#[test]
fn dropping_keeps_the_age_too_and_counts() {
    let piece = |n: u64| {
        if (20..40).contains(&n) {
            HARD_NS
        } else {
            CALM_NS
        }
    };
    let (records, report) = run("juggle,frames=120", &piece, Late::Drop);
    assert!(report.drops.budget >= 5, "{report:?}");
    assert_eq!(report.degraded, 0);
    let last = records.iter().rev().take(20);
    let came = last.filter(|record| record.sequence >= 100).count();
    assert_eq!(came, 20, "calm frames come through again");
}

#[test]
fn cuts_bursts_stalls_and_a_doubled_rate_stay_bounded() {
    for scene in [
        "cut,cut=4,frames=40",
        "juggle,burst=5,frames=40",
        "juggle,stall=10,frames=40",
        "juggle,speed=2,frames=60",
    ] {
        for piece in [CALM_NS, HARD_NS] {
            let (records, report) = run(scene, &|_| piece, Late::Degrade);
            assert!(
                oldest(&records) <= BOUND_NS,
                "{scene}: age {} ns",
                oldest(&records)
            );
            assert!(
                report.frames * 3 >= report.sensor_frames,
                "{scene}: {report:?}"
            );
        }
    }
}

#[test]
fn bad_input_stays_inside_the_budget_degraded_and_counted() {
    // nothing measured, 65535 where nothing was, alternate pixels at 1 and 2 m, noise throughout
    for scene in ["empty", "codes65535", "checkerboard", "noise,burst=1"] {
        let scene = format!("{scene},frames=20");
        let (records, report) = run(&scene, &|_| HARD_NS, Late::Degrade);
        assert!(
            oldest(&records) <= BOUND_NS,
            "{scene}: age {} ns",
            oldest(&records)
        );
        let degraded = records.iter().filter(|r| r.modelled.degraded).count();
        assert_eq!(report.degraded, degraded as u64, "{scene}");
        let share = degraded as f64 / report.frames as f64;
        assert!((report.quality - (1.0 - share)).abs() < 1e-12, "{scene}");
        assert_eq!(report.lost_points, 0, "{scene}");
    }
}
