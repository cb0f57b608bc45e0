//! Statistics ready to be shown: as JSON (serde) or as a line of CSV.

use super::Priority;
use super::packet::Residual;
use super::percentiles::Summary;
use super::statistics::Drops;
use crate::codec::Spent;
use serde::Serialize;

/// Stage times, milliseconds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct StageTimes {
    /// Reading the source; for a live device mostly waiting for it.
    pub capture: Summary,
    /// Waiting between capture and model.
    pub wait: Summary,
    /// Fitting.
    pub model: Summary,
    /// Coding.
    pub encode: Summary,
    /// Writing.
    pub sink: Summary,
}

/// A summary of a run or of an interval, ready to be shown.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Report {
    /// Wall time, seconds.
    pub elapsed_s: f64,
    /// Frames written.
    pub frames: u64,
    /// Of those, how many decode alone.
    pub key_frames: u64,
    /// Frames the sensor made: delivered by the source, or lost before it could.
    pub sensor_frames: u64,
    /// Frames written per second of wall time.
    pub fps: f64,
    /// Age of a frame when it was written.
    pub age_ms: Summary,
    /// Time in each stage.
    pub stage_ms: StageTimes,
    /// Frames not written, by cause.
    pub drops: Drops,
    /// Frames whose refinement was cut short by the budget.
    pub degraded: u64,
    /// Level of quality: the share of the frames that were modelled in full, 0 to 1; 1 where there
    /// were none.
    pub quality: f64,
    /// Frames written later than the budget allows.
    pub late: u64,
    /// Mean number of measured points.
    pub points_per_frame: f64,
    /// Mean number of spheres.
    pub spheres_per_frame: f64,
    /// Share of the points a sphere explains, 0 to 1.
    pub coverage: f64,
    /// Share of the points that kept their sphere from the frame before, 0 to 1.
    pub warm: f64,
    /// Points the output does not give back.
    pub lost_points: u64,
    /// Depth error: mean over points, percentiles averaged over frames, largest of all.
    pub residual_mm: Residual,
    /// Payload bytes.
    pub bytes: u64,
    /// Payload bits by what they say; nothing where the contact map is polar.
    pub spent_bits: Spent,
    /// Payload bits per measured point.
    pub bits_per_valid_px: f64,
    /// Payload rate at the rate the frames were taken.
    pub mbit_per_s: f64,
    /// Colour images written.
    pub color_frames: u64,
    /// Colour images given up because the output was busy.
    pub color_dropped: u64,
    /// The priority every thread got, where one was asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub priority: Option<Priority>,
}

impl Report {
    /// Column names of [`Report::csv`].
    pub const CSV_HEADER: &'static str = "elapsed_s,frames,sensor_frames,fps,age_p50_ms,age_p95_ms,age_p99_ms,age_p999_ms,age_max_ms,\
capture_p50_ms,wait_p50_ms,model_p50_ms,model_p99_ms,encode_p50_ms,encode_p99_ms,sink_p50_ms,\
drop_sensor_gap,drop_damaged,drop_stall,drop_queue,drop_budget,drop_sink,drop_failed,degraded,late,\
points_per_frame,spheres_per_frame,coverage,warm,lost_points,residual_mean_mm,residual_p95_mm,residual_p99_mm,residual_max_mm,\
bytes,bits_per_valid_px,mbit_per_s,color_frames,color_dropped,quality,\
mask_bits,palette_bits,sphere_bits,label_bits,residual_bits,header_bits";

    /// The report as one line of comma separated values.
    #[must_use]
    pub fn csv(&self) -> String {
        let (age, stage, drops, residual) =
            (&self.age_ms, &self.stage_ms, &self.drops, &self.residual_mm);
        let real = [
            self.fps,
            age.p50,
            age.p95,
            age.p99,
            age.p999,
            age.max,
            stage.capture.p50,
            stage.wait.p50,
            stage.model.p50,
            stage.model.p99,
            stage.encode.p50,
            stage.encode.p99,
            stage.sink.p50,
        ];
        let counts = [
            drops.sensor_gap,
            drops.damaged,
            drops.stall,
            drops.queue,
            drops.budget,
            drops.sink,
            drops.failed,
            self.degraded,
            self.late,
        ];
        let mut fields = vec![
            format!("{:.3}", self.elapsed_s),
            self.frames.to_string(),
            self.sensor_frames.to_string(),
        ];
        fields.extend(real.iter().map(|v| format!("{v:.3}")));
        fields.extend(counts.iter().map(u64::to_string));
        fields.push(format!("{:.1}", self.points_per_frame));
        fields.push(format!("{:.1}", self.spheres_per_frame));
        fields.push(format!("{:.5}", self.coverage));
        fields.push(format!("{:.5}", self.warm));
        fields.push(self.lost_points.to_string());
        fields.extend(
            [residual.mean, residual.p95, residual.p99, residual.max]
                .iter()
                .map(|v| format!("{v:.3}")),
        );
        fields.push(self.bytes.to_string());
        fields.push(format!("{:.4}", self.bits_per_valid_px));
        fields.push(format!("{:.4}", self.mbit_per_s));
        fields.push(self.color_frames.to_string());
        fields.push(self.color_dropped.to_string());
        fields.push(format!("{:.5}", self.quality));
        fields.extend(self.spent_bits.parts().map(|part| part.1.to_string()));
        fields.join(",")
    }
}
