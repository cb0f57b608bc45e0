//! Recordings at the pace of their own time.

use super::*;

#[test]
fn realtime_paces_by_the_frames_own_time() {
    // one thread on a clock that moves only by sleeping and by the model's work
    let clock = FakeClock::default();
    let mut model = MockModel {
        work: Some(Box::new(|n, _| {
            // frame 10 takes five periods, all others half of one
            clock.advance(if n == 10 { 50_000_000 } else { 5_000_000 });
            false
        })),
        ..MockModel::default()
    };
    let mut sink = MockSink::default();
    let options = Options {
        pace: Pace::Realtime,
        ..options(1)
    };
    let outcome = run_mocks(
        &mut MockSource::frames(30),
        &mut model,
        &mut MockEncode::default(),
        &mut sink,
        &options,
        &clock,
    );
    outcome.result.unwrap();
    let written = &sink.sequences;
    assert_eq!(written[..11], (0..11).collect::<Vec<u64>>());
    assert_eq!(outcome.report.drops.queue, 3, "{written:?}");
    assert_eq!(written.last(), Some(&29));
    assert!(clock.now_ns() >= 29 * 10_000_000);
    assert!((outcome.report.age_ms.max - 50.0).abs() < 1.0);
    assert!((outcome.report.age_ms.p50 - 5.0).abs() < 0.1);
}

/// A clock that sleeps 300 µs too long each time, as systems do.
#[derive(Default)]
struct Sleepy(FakeClock);

impl Clock for Sleepy {
    fn now_ns(&self) -> i64 {
        self.0.now_ns()
    }
    fn sleep(&self, time: Duration) {
        self.0.sleep(time + Duration::from_micros(300));
    }
}

/// Runs `script` at its own pace on two threads. A frame is read, as `reading` says, when the one before
/// it is written: then only reading and waiting for a frame's time move a fake clock.
fn run_in_step(script: Vec<Event>, mut reading: impl FnMut() + Send, clock: &FakeClock) -> Outcome {
    let (written_tx, written) = bounded::<()>(1);
    let mut source = MockSource::new(script);
    source.before = Box::new(move |n| {
        if n > 0 {
            written.recv().unwrap();
        }
        reading();
    });
    let mut sink = MockSink {
        after: Some(Box::new(move |_| written_tx.send(()).unwrap())),
        ..MockSink::default()
    };
    let options = Options {
        pace: Pace::Realtime,
        ..options(2)
    };
    let (mut model, mut encode) = (MockModel::default(), MockEncode::default());
    run_mocks(
        &mut source,
        &mut model,
        &mut encode,
        &mut sink,
        &options,
        clock,
    )
}

#[test]
fn a_recording_that_is_read_too_slowly_falls_back_and_its_frames_do_not_age() {
    // each frame takes three of its periods to be read
    let clock = FakeClock::default();
    let reading = || clock.sleep(Duration::from_millis(30));
    let report = run_in_step(vec![Event::Frame; 600], reading, &clock).report;
    assert_eq!((report.frames, report.drops.total()), (600, 0));
    // without falling back the last would be 12 s old
    assert!(report.age_ms.max < 700.0, "{:?}", report.age_ms);
    assert!(clock.now_ns() >= 600 * 30_000_000);
}

#[test]
fn realtime_does_not_drift() {
    // a minute of frames; sleeping too long must not add up
    let clock = Sleepy::default();
    let options = Options {
        pace: Pace::Realtime,
        ..options(1)
    };
    let outcome = run_mocks(
        &mut MockSource::frames(6000),
        &mut MockModel::default(),
        &mut MockEncode::default(),
        &mut MockSink::default(),
        &options,
        &clock,
    );
    assert_eq!(outcome.report.frames, 6000);
    let end_ns = clock.now_ns() - 5999 * 10_000_000;
    assert!((0..1_000_000).contains(&end_ns), "{end_ns} ns late");
    assert!(
        outcome.report.age_ms.max < 1.0,
        "{:?}",
        outcome.report.age_ms
    );
}

#[test]
fn the_frames_behind_a_pause_are_in_time() {
    // a second without frames, which is no reason to wait half a second for the next one
    let clock = FakeClock::default();
    let mut script = vec![Event::Frame; 5];
    script.push(Event::Gap(100));
    script.extend([Event::Frame; 10]);
    let report = run_in_step(script, || {}, &clock).report;
    assert_eq!(report.frames, 15);
    assert!(clock.now_ns() >= 1_000_000_000);
    // capture sleeps for the next frame while this one is on its way
    assert!(report.age_ms.max < 50.0, "{:?}", report.age_ms);
}
