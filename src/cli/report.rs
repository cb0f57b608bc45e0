//! Numbers as sentences: the status line and the summary.

use saint_live::pipeline::report::Report;
use saint_live::pipeline::statistics::Drops;

/// A count that fits a status line: `840`, `212k`, `1.3M`.
pub fn short(count: f64) -> String {
    if count >= 1e6 {
        format!("{:.1}M", count * 1e-6)
    } else if count >= 1e4 {
        format!("{:.0}k", count * 1e-3)
    } else {
        format!("{count:.0}")
    }
}

/// `30.0 fps  age p50 9 p99 17 ms  dropped 0  212k pts → 840 spheres  3.1 Mbit/s  err p95 2.1 mm`
///
/// Frame rate and sizes of `now`, ages and drops of the whole run.
pub fn status(now: &Report, run: &Report) -> String {
    format!(
        "{:.1} fps  age p50 {:.0} p99 {:.0} ms  dropped {}  {} pts → {:.0} spheres  {:.1} Mbit/s  err p95 {:.1} mm",
        now.fps,
        run.age_ms.p50,
        run.age_ms.p99,
        run.drops.total(),
        short(now.points_per_frame),
        now.spheres_per_frame,
        now.mbit_per_s,
        now.residual_mm.p95,
    )
}

/// What was lost, by cause; nothing where nothing was.
fn causes(drops: &Drops) -> String {
    let causes = [
        ("sensor gap", drops.sensor_gap),
        ("damaged", drops.damaged),
        ("stall", drops.stall),
        ("queue", drops.queue),
        ("budget", drops.budget),
        ("output", drops.sink),
        ("failed", drops.failed),
    ];
    let lost: Vec<_> = causes
        .iter()
        .filter(|(_, count)| *count > 0)
        .map(|(cause, count)| format!("{cause} {count}"))
        .collect();
    if lost.is_empty() {
        String::new()
    } else {
        format!(" ({})", lost.join(", "))
    }
}

/// `90.0 fps  age p50 3 p99 12 ms  dropped 0  182 KB a frame`: a raw capture.
pub fn raw_status(now: &Report, run: &Report) -> String {
    format!(
        "{:.1} fps  age p50 {:.0} p99 {:.0} ms  dropped {}  {:.0} KB a frame",
        now.fps,
        run.age_ms.p50,
        run.age_ms.p99,
        run.drops.total(),
        now.bytes as f64 / now.frames.max(1) as f64 / 1e3,
    )
}

/// A raw capture in a few lines.
pub fn raw_summary(run: &Report) -> String {
    let (age, stage) = (&run.age_ms, &run.stage_ms);
    let mut lines = vec![
        taken(run),
        format!(
            "age ms     p50 {:.1}  p99 {:.1}  max {:.1}; packing p50 {:.2} p99 {:.2}  writing p50 {:.2} p99 {:.2}",
            age.p50,
            age.p99,
            age.max,
            stage.encode.p50,
            stage.encode.p99,
            stage.sink.p50,
            stage.sink.p99,
        ),
    ];
    lines.extend(color(run));
    lines.join("\n")
}

/// Frames, rate, losses by cause.
fn taken(run: &Report) -> String {
    format!(
        "{} of {} frames in {:.1} s ({:.1} fps), dropped {}{}",
        run.frames,
        run.sensor_frames,
        run.elapsed_s,
        run.fps,
        run.drops.total(),
        causes(&run.drops),
    )
}

/// Colour images, where there were any.
fn color(run: &Report) -> Option<String> {
    (run.color_frames + run.color_dropped > 0).then(|| {
        format!(
            "colour     {} images, dropped {}",
            run.color_frames, run.color_dropped
        )
    })
}

/// The run in a few lines.
pub fn summary(run: &Report) -> String {
    let (age, stage, error) = (&run.age_ms, &run.stage_ms, &run.residual_mm);
    let mut lines = vec![
        format!("{}, degraded {}", taken(run), run.degraded),
        format!(
            "age ms     p50 {:.1}  p95 {:.1}  p99 {:.1}  p99.9 {:.1}  max {:.1}",
            age.p50, age.p95, age.p99, age.p999, age.max
        ),
        format!(
            "stages ms  model p50 {:.2} p99 {:.2}  encode p50 {:.2} p99 {:.2}  sink p50 {:.2} p99 {:.2}",
            stage.model.p50,
            stage.model.p99,
            stage.encode.p50,
            stage.encode.p99,
            stage.sink.p50,
            stage.sink.p99,
        ),
        format!(
            "model      {} points → {:.0} spheres a frame, coverage {:.2} %, warm {:.1} %, lost points {}",
            short(run.points_per_frame),
            run.spheres_per_frame,
            run.coverage * 100.0,
            run.warm * 100.0,
            run.lost_points,
        ),
        format!(
            "payload    {} bytes, {:.3} bits per point, {:.2} Mbit/s; error mm mean {:.2} p95 {:.2} p99 {:.2} max {:.2}",
            run.bytes,
            run.bits_per_valid_px,
            run.mbit_per_s,
            error.mean,
            error.p95,
            error.p99,
            error.max,
        ),
    ];
    if run.spent_bits.total() > 0 {
        lines.push(format!("bits       {}", run.spent_bits));
    }
    lines.extend(color(run));
    lines.join("\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_status_line_reads_as_documented() {
        let mut report = Report {
            fps: 30.0,
            points_per_frame: 212_345.0,
            spheres_per_frame: 840.0,
            mbit_per_s: 3.1,
            ..Report::default()
        };
        report.age_ms.p50 = 9.2;
        report.age_ms.p99 = 17.1;
        report.residual_mm.p95 = 2.1;
        assert_eq!(
            status(&report, &report),
            "30.0 fps  age p50 9 p99 17 ms  dropped 0  212k pts → 840 spheres  3.1 Mbit/s  err p95 2.1 mm"
        );
    }

    #[test]
    fn the_summary_names_only_causes_that_happened() {
        let mut report = Report::default();
        report.drops.queue = 3;
        let text = summary(&report);
        assert!(text.contains("dropped 3 (queue 3)"), "{text}");
        assert!(!text.contains("stall"), "{text}");
    }
}
