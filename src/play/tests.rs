use super::walk::MOST_KEPT;
use super::*;
use std::cell::Cell;
use std::convert::Infallible;

const MS: i64 = 1_000_000;

/// Frames at these times, a key frame each `every`; decoding one takes `cost` on the clock.
struct Tape<'a> {
    times: Vec<i64>,
    every: u64,
    at: u64,
    /// The frame that would be shown.
    now: u64,
    decoded: Vec<u64>,
    cost: Duration,
    clock: &'a Cell<Duration>,
}

impl Frames for Tape<'_> {
    type Error = Infallible;
    type Kept = u64;
    fn frames(&self) -> u64 {
        self.times.len() as u64
    }
    fn keep(&self) -> u64 {
        self.at - 1
    }
    fn put_back(&mut self, kept: u64) {
        self.now = kept;
    }
    fn seek(&mut self, frame: u64) -> Result<u64, Infallible> {
        self.at = frame / self.every * self.every;
        Ok(self.at)
    }
    fn advance(&mut self) -> Result<Option<(u64, i64)>, Infallible> {
        let Some(time) = self.times.get(self.at as usize) else {
            return Ok(None);
        };
        self.clock.set(self.clock.get() + self.cost);
        self.decoded.push(self.at);
        self.now = self.at;
        self.at += 1;
        Ok(Some((self.at - 1, *time)))
    }
}

struct TestClock<'a>(&'a Cell<Duration>);

impl Clock for TestClock<'_> {
    fn now(&self) -> Duration {
        self.0.get()
    }
    fn wait(&mut self, time: Duration) {
        self.0.set(self.0.get() + time);
    }
}

/// Plays; gives the frames shown with the times (ms) they were shown at, and the report.
fn run(
    times: Vec<i64>,
    cost_ms: u64,
    options: PlayOptions,
    rounds: u64,
) -> (Vec<(u64, u64)>, PlayReport) {
    let ended = Cell::new(0u64);
    let count = times.len() as u64;
    run_with(times, cost_ms, options, |shown| {
        if shown.is_some_and(|number| number + 1 == count) {
            ended.set(ended.get() + 1);
        }
        (shown.is_none() && ended.get() >= rounds).then_some(Command::Stop)
    })
}

/// As [`run`]; `command` is told each frame shown, and asked with `None`.
fn run_with(
    times: Vec<i64>,
    cost_ms: u64,
    options: PlayOptions,
    command: impl Fn(Option<u64>) -> Option<Command>,
) -> (Vec<(u64, u64)>, PlayReport) {
    let clock = Cell::new(Duration::from_secs(9));
    let mut tape = Tape {
        times,
        every: 10,
        at: 0,
        now: 0,
        decoded: vec![],
        cost: Duration::from_millis(cost_ms),
        clock: &clock,
    };
    let mut shown = vec![];
    let report = play(
        &mut tape,
        &options,
        &mut TestClock(&clock),
        || command(None),
        |tape, number| {
            assert_eq!(tape.now, number, "another frame is in the picture");
            command(Some(number));
            let now = clock.get() - Duration::from_secs(9);
            shown.push((number, now.as_millis() as u64));
            Ok(())
        },
    );
    let Ok(report) = report;
    (shown, report)
}

/// Obeys a script: the command stands beside the number of frames shown before it.
fn scripted(script: &[(usize, Command)], options: PlayOptions) -> Vec<u64> {
    let shown = Cell::new(0);
    let at = Cell::new(0);
    let (frames, _) = run_with(even(50), 0, options, |number| {
        if number.is_some() {
            shown.set(shown.get() + 1);
            return None;
        }
        let (after, command) = script.get(at.get())?;
        if shown.get() < *after {
            return None;
        }
        at.set(at.get() + 1);
        Some(*command)
    });
    frames.into_iter().map(|(number, _)| number).collect()
}

#[test]
fn frames_are_stepped_through_both_ways() {
    use Command::{Pause, Step, Stop, To};
    let shown = scripted(
        &[
            (3, Step(-1)),
            (4, Step(-1)),
            (5, Step(-1)),
            (6, Step(1)),
            (7, To(33)),
            (8, Step(5)),
            (9, Step(1000)),
            (10, To(20)),
            (11, Pause),
            (13, Stop),
        ],
        PlayOptions::default(),
    );
    assert_eq!(shown, [0, 1, 2, 1, 0, 0, 1, 33, 38, 49, 20, 21, 22]);
    let held = PlayOptions {
        hold_at: Some(17),
        ..PlayOptions::default()
    };
    let shown = scripted(
        &[(1, Step(-1)), (2, Pause), (4, Pause), (4, Pause), (5, Stop)],
        held,
    );
    assert_eq!(shown, [17, 16, 17, 18, 19]);
}

#[test]
fn backwards_shows_each_frame_in_its_time() {
    let reverse = PlayOptions {
        reverse: true,
        from: 3,
        to: 24,
        ..PlayOptions::default()
    };
    let (shown, report) = run(even(50), 0, reverse, 9);
    let expected: Vec<_> = (0..21).map(|n| (23 - n, n * 40)).collect();
    assert_eq!(shown, expected);
    assert_eq!((report.first, report.last), (Some(23), Some(3)));
    let shown = scripted(
        &[
            (2, Command::Step(7)),
            (3, Command::Pause),
            (5, Command::Stop),
        ],
        PlayOptions {
            reverse: true,
            to: 40,
            ..reverse
        },
    );
    assert_eq!(shown, [39, 38, 39, 38, 37]);
}

#[test]
fn a_long_group_is_decoded_in_pieces_backwards() {
    let clock = Cell::new(Duration::ZERO);
    let mut tape = Tape {
        times: even(200),
        every: 200,
        at: 0,
        now: 0,
        decoded: vec![],
        cost: Duration::ZERO,
        clock: &clock,
    };
    let reverse = PlayOptions {
        reverse: true,
        ..PlayOptions::default()
    };
    let mut walk = Walk::new(&reverse, 200);
    walk.begin(&mut tape).unwrap();
    for expected in (0..200).rev() {
        assert_eq!(
            walk.next(&mut tape).unwrap().map(|(n, _)| n),
            Some(expected)
        );
        assert!(walk.kept.len() < MOST_KEPT);
    }
    assert_eq!(walk.next(&mut tape).unwrap(), None);
}

/// A clock that oversleeps by 300 µs each time, as systems do.
struct Sleepy(Duration);

impl Clock for Sleepy {
    fn now(&self) -> Duration {
        self.0
    }
    fn wait(&mut self, time: Duration) {
        self.0 += time + Duration::from_micros(300);
    }
}

#[test]
fn an_hour_drifts_by_less_than_a_millisecond() {
    // 90 fps, times rounded to the nanosecond as a source does
    let time = |n: u64| (n as f64 * 1e9 / 90.0).round() as i64;
    for speed in [1.0, 0.7] {
        let mut pacer = Pacer::new(speed);
        let mut clock = Sleepy(Duration::from_secs(5));
        let start = clock.now();
        for n in 0..90 * 3600 {
            let due = pacer.due(time(n), clock.now());
            while let Pace::Wait(left) = pacer.pace(due, None, clock.now()) {
                clock.wait(left.min(LONGEST_WAIT));
            }
            let shown = clock.now() - start;
            let right = time(n) as f64 * 1e-9 / speed;
            let late = shown.as_secs_f64() - right;
            // each is late by one oversleep, none by the sum of them
            assert!((-1e-6..1e-3).contains(&late), "frame {n}: {late} s");
        }
    }
}

fn even(count: i64) -> Vec<i64> {
    (0..count).map(|n| 777 + n * 40 * MS).collect()
}

#[test]
fn frames_are_shown_at_their_times() {
    let (shown, report) = run(even(25), 0, PlayOptions::default(), 9);
    let expected: Vec<_> = (0..25).map(|n| (n, n * 40)).collect();
    assert_eq!(shown, expected);
    assert_eq!((report.shown, report.skipped, report.rounds), (25, 0, 1));
    let fast = PlayOptions {
        speed: 4.0,
        ..PlayOptions::default()
    };
    let (shown, _) = run(even(25), 0, fast, 9);
    assert_eq!(shown, (0..25).map(|n| (n, n * 10)).collect::<Vec<_>>());
}

#[test]
fn decoding_time_does_not_add_up() {
    let (shown, _) = run(even(25), 30, PlayOptions::default(), 9);
    assert_eq!(shown[0], (0, 30));
    assert_eq!(shown[24], (24, 30 + 24 * 40));
}

#[test]
fn late_frames_are_decoded_and_not_shown() {
    let (shown, report) = run(even(101), 60, PlayOptions::default(), 9);
    assert_eq!(report.shown + report.skipped, 101);
    assert!(report.skipped > 30, "{report:?}");
    // decoding needs 60 ms a frame for 40 ms of film: it cannot keep up, but goes on showing
    let gap = shown.windows(2).map(|pair| pair[1].0 - pair[0].0).max();
    assert_eq!(gap, Some(MOST_SKIPPED + 1), "{shown:?}");
}

#[test]
fn a_range_is_decoded_from_its_key_frame() {
    let range = PlayOptions {
        from: 14,
        to: 17,
        ..PlayOptions::default()
    };
    let (shown, _) = run(even(25), 0, range, 9);
    assert_eq!(shown, [(14, 0), (15, 40), (16, 80)]);
}

#[test]
fn a_loop_begins_again_at_once_and_ends_on_demand() {
    let looped = PlayOptions {
        looped: true,
        ..PlayOptions::default()
    };
    let (shown, report) = run(even(3), 0, looped, 3);
    let expected = [
        (0, 0),
        (1, 40),
        (2, 80),
        (0, 80),
        (1, 120),
        (2, 160),
        (0, 160),
        (1, 200),
        (2, 240),
    ];
    assert_eq!(shown, expected);
    assert_eq!(report.rounds, 3);
    let (shown, report) = run(vec![], 0, looped, 3);
    assert!(
        shown.is_empty() && report.rounds == 1,
        "an empty loop must end"
    );
}

#[test]
fn odd_times_and_speeds_stop_nothing() {
    let times = vec![5, i64::MIN, i64::MAX, 0, 40 * MS];
    for speed in [1.0, 0.0, -1.0, f64::NAN, f64::INFINITY, 1e-300, 1e300] {
        let options = PlayOptions {
            speed,
            ..PlayOptions::default()
        };
        let (shown, report) = run(times.clone(), 0, options, 9);
        assert_eq!(report.shown, 5, "speed {speed}: {shown:?}");
        assert!(shown.last().unwrap().1 <= 4 * 5000);
    }
}
