//! Counting: what went in, what came out, what was lost and why, and how long all of it took.
//!
//! The sum always balances: `sensor_frames = frames + drops.total() + in_flight`, and nothing is in
//! flight when a pipeline has ended. A frame counts as written when the output has taken it; what
//! the output then could not keep (its last chunk, on a disk that broke) is moved to its drops.

use super::packet::{FrameRecord, Residual};
use super::percentiles::Percentiles;
use super::report::{Report, StageTimes};
use crate::capture::SourceLosses;
use crate::codec::Spent;
use serde::Serialize;

/// Frames that did not reach the output, by cause.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Drops {
    /// The sensor or driver skipped them, or their files are missing.
    pub sensor_gap: u64,
    /// The driver flagged them as damaged, or they were short.
    pub damaged: u64,
    /// Given up to recover a stalled stream.
    pub stall: u64,
    /// Pushed out of the queue by a newer one.
    pub queue: u64,
    /// Given up because they would have been late.
    pub budget: u64,
    /// The output had failed.
    pub sink: u64,
    /// Another stage had failed.
    pub failed: u64,
}

impl Drops {
    /// All of them.
    #[must_use]
    pub fn total(&self) -> u64 {
        self.sensor_gap
            + self.damaged
            + self.stall
            + self.queue
            + self.budget
            + self.sink
            + self.failed
    }
}

/// Why the pipeline itself gave a frame up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DropCause {
    /// See [`Drops::queue`].
    Queue,
    /// See [`Drops::budget`].
    Budget,
    /// See [`Drops::sink`].
    Sink,
    /// See [`Drops::failed`].
    Failed,
}

/// Sums over frames; one for the whole run, one for the interval since the last report.
#[derive(Clone, Debug)]
struct Totals {
    since_ns: i64,
    frames: u64,
    keys: u64,
    degraded: u64,
    late: u64,
    delivered: u64,
    /// Frames the output took and could not keep.
    unkept: u64,
    losses: SourceLosses,
    queue: u64,
    budget: u64,
    sink: u64,
    failed: u64,
    color_frames: u64,
    color_dropped: u64,
    points: u64,
    explained: u64,
    warm: u64,
    lost: u64,
    spheres: u64,
    bytes: u64,
    spent: Spent,
    residual_mean_sum: f64,
    residual_p95_sum: f64,
    residual_p99_sum: f64,
    residual_max: f32,
    first_device_ns: Option<i64>,
    last_device_ns: i64,
    age: Percentiles,
    capture: Percentiles,
    wait: Percentiles,
    model: Percentiles,
    encode: Percentiles,
    sink_time: Percentiles,
}

impl Totals {
    fn new(since_ns: i64) -> Self {
        Self {
            since_ns,
            frames: 0,
            keys: 0,
            degraded: 0,
            late: 0,
            delivered: 0,
            unkept: 0,
            losses: SourceLosses::default(),
            queue: 0,
            budget: 0,
            sink: 0,
            failed: 0,
            color_frames: 0,
            color_dropped: 0,
            points: 0,
            explained: 0,
            warm: 0,
            lost: 0,
            spheres: 0,
            bytes: 0,
            spent: Spent::default(),
            residual_mean_sum: 0.0,
            residual_p95_sum: 0.0,
            residual_p99_sum: 0.0,
            residual_max: 0.0,
            first_device_ns: None,
            last_device_ns: 0,
            age: Percentiles::new(),
            capture: Percentiles::new(),
            wait: Percentiles::new(),
            model: Percentiles::new(),
            encode: Percentiles::new(),
            sink_time: Percentiles::new(),
        }
    }

    fn add(&mut self, record: &FrameRecord, limit_ns: i64) {
        let (model, coded) = (&record.modelled, &record.coded);
        self.frames += 1;
        self.keys += u64::from(record.key);
        self.degraded += u64::from(model.degraded);
        self.late += u64::from(record.age_ns() > limit_ns);
        self.points += u64::from(model.points);
        self.explained += u64::from(model.explained);
        self.warm += u64::from(model.warm);
        self.lost += u64::from(coded.lost);
        self.spheres += u64::from(model.spheres);
        self.bytes += record.bytes;
        self.spent += coded.spent;
        // weighted by the points the numbers speak of
        let weight = f64::from(model.points);
        self.residual_mean_sum += weight * f64::from(coded.residual.mean);
        self.residual_p95_sum += weight * f64::from(coded.residual.p95);
        self.residual_p99_sum += weight * f64::from(coded.residual.p99);
        self.residual_max = self.residual_max.max(coded.residual.max);
        self.first_device_ns.get_or_insert(record.device_ns);
        self.last_device_ns = record.device_ns;
        self.age.record_ns(record.age_ns());
        self.capture.record_ns(record.capture.length_ns());
        self.wait.record_ns(record.wait_ns());
        self.model.record_ns(record.model.length_ns());
        self.encode.record_ns(record.encode.length_ns());
        self.sink_time.record_ns(record.sink.length_ns());
    }

    fn drops(&self) -> Drops {
        Drops {
            sensor_gap: self.losses.sensor_gap,
            damaged: self.losses.damaged,
            stall: self.losses.stall,
            queue: self.queue,
            budget: self.budget,
            sink: self.sink + self.unkept,
            failed: self.failed,
        }
    }

    fn report(&self, now_ns: i64) -> Report {
        let elapsed_s = (now_ns - self.since_ns).max(0) as f64 * 1e-9;
        let frames = self.frames as f64;
        let per = |sum: f64, of: f64| if of > 0.0 { sum / of } else { 0.0 };
        let media_s = self
            .first_device_ns
            .map_or(0.0, |first| (self.last_device_ns - first) as f64 * 1e-9);
        let media_fps = per((frames - 1.0).max(0.0), media_s);
        let fps = per(frames, elapsed_s);
        let bits = self.bytes as f64 * 8.0;
        let rate = if media_fps > 0.0 { media_fps } else { fps };
        let points = self.points as f64;
        Report {
            elapsed_s,
            frames: self.frames - self.unkept,
            key_frames: self.keys,
            sensor_frames: self.delivered
                + self.losses.sensor_gap
                + self.losses.damaged
                + self.losses.stall,
            fps,
            age_ms: self.age.summary(),
            stage_ms: StageTimes {
                capture: self.capture.summary(),
                wait: self.wait.summary(),
                model: self.model.summary(),
                encode: self.encode.summary(),
                sink: self.sink_time.summary(),
            },
            drops: self.drops(),
            degraded: self.degraded,
            quality: 1.0 - per(self.degraded as f64, frames),
            late: self.late,
            points_per_frame: per(points, frames),
            spheres_per_frame: per(self.spheres as f64, frames),
            coverage: per(self.explained as f64, points),
            warm: per(self.warm as f64, points),
            lost_points: self.lost,
            residual_mm: Residual {
                mean: per(self.residual_mean_sum, points) as f32,
                p95: per(self.residual_p95_sum, points) as f32,
                p99: per(self.residual_p99_sum, points) as f32,
                max: self.residual_max,
            },
            bytes: self.bytes,
            spent_bits: self.spent,
            bits_per_valid_px: per(bits, points),
            mbit_per_s: per(bits, frames) * rate * 1e-6,
            color_frames: self.color_frames,
            color_dropped: self.color_dropped,
            priority: None,
        }
    }
}

/// Running statistics of a pipeline.
#[derive(Clone, Debug)]
pub struct Statistics {
    total: Totals,
    interval: Totals,
    limit_ns: i64,
}

impl Statistics {
    /// Nothing counted yet at `now_ns`; a written frame older than `limit_ns` is late.
    #[must_use]
    pub fn new(now_ns: i64, limit_ns: i64) -> Self {
        Self {
            total: Totals::new(now_ns),
            interval: Totals::new(now_ns),
            limit_ns,
        }
    }

    /// Rates count from `now_ns` on.
    pub fn begin(&mut self, now_ns: i64) {
        self.total.since_ns = now_ns;
        self.interval.since_ns = now_ns;
    }

    /// The source delivered a frame.
    pub fn delivered(&mut self) {
        self.total.delivered += 1;
        self.interval.delivered += 1;
    }

    /// The source's own losses so far.
    pub fn losses(&mut self, now: SourceLosses) {
        let before = self.total.losses;
        self.interval.losses.sensor_gap += now.sensor_gap.saturating_sub(before.sensor_gap);
        self.interval.losses.damaged += now.damaged.saturating_sub(before.damaged);
        self.interval.losses.stall += now.stall.saturating_sub(before.stall);
        self.total.losses = now;
    }

    /// A frame was given up inside the pipeline.
    pub fn dropped(&mut self, cause: DropCause) {
        for totals in [&mut self.total, &mut self.interval] {
            match cause {
                DropCause::Queue => totals.queue += 1,
                DropCause::Budget => totals.budget += 1,
                DropCause::Sink => totals.sink += 1,
                DropCause::Failed => totals.failed += 1,
            }
        }
    }

    /// Frames given up so far, by cause.
    #[must_use]
    pub fn drops(&self) -> Drops {
        self.total.drops()
    }

    /// Takes over what another account has counted as dropped so far.
    pub fn take_over(&mut self, now: &Drops) {
        let before = self.drops();
        self.losses(SourceLosses {
            sensor_gap: now.sensor_gap,
            damaged: now.damaged,
            stall: now.stall,
        });
        for (cause, now, before) in [
            (DropCause::Queue, now.queue, before.queue),
            (DropCause::Budget, now.budget, before.budget),
            (DropCause::Sink, now.sink, before.sink),
            (DropCause::Failed, now.failed, before.failed),
        ] {
            for _ in before..now {
                self.delivered();
                self.dropped(cause);
            }
        }
    }

    /// Of the frames that were written the output has only kept so many: the others are dropped
    /// by it. Their points and bytes stay in the sums, which speak of what was modelled.
    pub fn kept(&mut self, frames: u64) {
        self.total.unkept = self.total.frames.saturating_sub(frames);
    }

    /// A frame was written.
    pub fn written(&mut self, record: &FrameRecord) {
        self.total.add(record, self.limit_ns);
        self.interval.add(record, self.limit_ns);
    }

    /// A colour image was written, or given up.
    pub fn color(&mut self, written: bool) {
        for totals in [&mut self.total, &mut self.interval] {
            if written {
                totals.color_frames += 1;
            } else {
                totals.color_dropped += 1;
            }
        }
    }

    /// The run so far.
    #[must_use]
    pub fn total(&self, now_ns: i64) -> Report {
        self.total.report(now_ns)
    }

    /// The time since the last call (or the start), which then begins anew.
    #[must_use]
    pub fn interval(&mut self, now_ns: i64) -> Report {
        let report = self.interval.report(now_ns);
        self.interval = Totals::new(now_ns);
        report
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pipeline::packet::{ModelReport, Span};

    fn record(n: u64, age_ns: i64) -> FrameRecord {
        FrameRecord {
            sequence: n,
            device_ns: n as i64 * 20_000_000,
            stamp_ns: 0,
            sink: Span {
                start_ns: age_ns - 1,
                end_ns: age_ns,
            },
            modelled: ModelReport {
                hurried: false,
                points: 1000,
                explained: 990,
                spheres: 10,
                warm: 500,
                degraded: n == 3,
            },
            bytes: 125,
            ..FrameRecord::default()
        }
    }

    #[test]
    fn totals_and_intervals_say_what_happened() {
        let mut statistics = Statistics::new(0, 25_000_000);
        for n in 0..11 {
            statistics.delivered();
            statistics.written(&record(n, 10_000_000));
        }
        let first = statistics.interval(1_000_000_000);
        statistics.delivered();
        statistics.written(&record(11, 30_000_000));
        statistics.losses(SourceLosses {
            sensor_gap: 2,
            damaged: 1,
            stall: 0,
        });
        let second = statistics.interval(2_000_000_000);
        let total = statistics.total(2_000_000_000);
        assert_eq!((first.frames, second.frames, total.frames), (11, 1, 12));
        assert_eq!((first.late, second.late, total.late), (0, 1, 1));
        assert_eq!((second.drops.sensor_gap, total.drops.total()), (2, 3));
        assert_eq!(total.sensor_frames, 15);
        assert_eq!(total.degraded, 1);
        assert!((total.fps - 6.0).abs() < 1e-9, "{}", total.fps);
        // 125 bytes a frame, taken at 50 per second
        assert!(
            (total.mbit_per_s - 0.05).abs() < 1e-9,
            "{}",
            total.mbit_per_s
        );
        assert!((total.coverage - 0.99).abs() < 1e-9);
        assert!((total.bits_per_valid_px - 1.0).abs() < 1e-9);
        assert!(
            (total.age_ms.p50 - 10.0).abs() < 0.1,
            "{}",
            total.age_ms.p50
        );
        assert!(
            (total.age_ms.max - 30.0).abs() < 0.1,
            "{}",
            total.age_ms.max
        );
    }

    #[test]
    fn frames_the_output_lost_again_are_dropped_frames() {
        let mut statistics = Statistics::new(0, 1);
        for n in 0..10 {
            statistics.delivered();
            statistics.written(&record(n, 1));
        }
        statistics.kept(7);
        let total = statistics.total(1);
        assert_eq!((total.frames, total.drops.sink), (7, 3));
        assert_eq!(total.sensor_frames, total.frames + total.drops.total());
    }

    #[test]
    fn another_account_is_taken_over_once() {
        let mut statistics = Statistics::new(0, 1);
        let mut drops = Drops {
            sensor_gap: 1,
            damaged: 2,
            stall: 3,
            queue: 4,
            budget: 5,
            sink: 6,
            failed: 7,
        };
        statistics.take_over(&drops);
        drops.queue += 1;
        statistics.take_over(&drops);
        let total = statistics.total(1);
        assert_eq!(total.drops, drops);
        assert_eq!(total.sensor_frames, drops.total());
    }

    #[test]
    fn csv_has_one_field_per_column() {
        let line = Statistics::new(0, 0).total(0).csv();
        assert_eq!(
            line.split(',').count(),
            Report::CSV_HEADER.split(',').count()
        );
    }

    #[test]
    fn an_empty_report_is_finite() {
        let text = serde_json::to_string(&Statistics::new(0, 0).total(0)).unwrap();
        assert!(!text.contains("null"), "{text}");
    }
}
