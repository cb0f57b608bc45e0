//! What the bench prints.

use super::super::machine::Machine;
use super::profile::Profile;
use super::throughput::Throughput;
use saint_live::codec::Spent;
use saint_live::pipeline::percentiles::Percentiles;
use serde::Serialize;

/// Percentiles of a time, milliseconds.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Times {
    pub p50: f64,
    pub p99: f64,
}

impl From<&Percentiles> for Times {
    fn from(times: &Percentiles) -> Self {
        let summary = times.summary();
        Self {
            p50: summary.p50,
            p99: summary.p99,
        }
    }
}

#[derive(Debug, Serialize)]
pub struct StageTimes {
    pub model: Times,
    pub encode: Times,
    pub decode: Times,
}

#[derive(Debug, Serialize)]
pub struct Errors {
    pub mean: f64,
    pub p95: f64,
    pub p99: f64,
    pub max: f64,
}

/// What the bench prints.
#[derive(Debug, Serialize)]
pub struct Results {
    pub input: String,
    pub camera: String,
    pub width: u32,
    pub height: u32,
    /// Frames measured, and different frames among them.
    pub frames: u64,
    pub frames_loaded: usize,
    pub points_per_frame: f64,
    pub spheres_per_frame: f64,
    /// Share of the points a sphere explains.
    pub coverage: f64,
    /// Share of the points that kept their sphere.
    pub warm_points: f64,
    /// Share of the points the output gives back.
    pub points_kept: f64,
    pub residual_mm: Errors,
    pub bits_per_valid_px: f64,
    pub bytes_per_frame: f64,
    pub key_bits_per_valid_px: f64,
    /// Bits of all frames measured, by what they say.
    pub spent_bits: Spent,
    pub encode_ms: Times,
    pub decode_ms: Times,
    pub stage_ms: StageTimes,
    /// Model and encode together.
    pub cold_ms: Times,
    /// The same after a scene cut.
    pub cut_ms: Times,
    pub warm_ms: Times,
    /// Where there is more than one thread.
    pub throughput: Option<Throughput>,
    pub profile_ms: Profile,
    pub rss_mb: f64,
    pub loaded_mb: f64,
    pub threads: usize,
    pub machine: Machine,
    pub version: &'static str,
}

/// The results for people.
pub fn table(r: &Results) -> String {
    let e = &r.residual_mm;
    format!(
        "\
{} ({}x{}), {} frames ({} loaded), {} threads, {} ({} cores)
points      {:.0} a frame, coverage {:.3} %, kept {:.3} %, warm {:.1} %
spheres     {:.0} a frame
size        {:.4} bits per valid pixel ({:.0} bytes a frame); key frames {:.4}
bits        {}
error mm    mean {:.3}  p95 {:.3}  p99 {:.3}  max {:.3}
warm ms     p50 {:.2}  p99 {:.2}   (model {:.2}, encode {:.2}; decode {:.2})
cold ms     p50 {:.2}  p99 {:.2}   (scene cut: p50 {:.2}  p99 {:.2})
{}{}memory MB   {:.1}, of which frames {:.1}
",
        r.camera,
        r.width,
        r.height,
        r.frames,
        r.frames_loaded,
        r.threads,
        r.machine.cpu,
        r.machine.cores,
        r.points_per_frame,
        r.coverage * 100.0,
        r.points_kept * 100.0,
        r.warm_points * 100.0,
        r.spheres_per_frame,
        r.bits_per_valid_px,
        r.bytes_per_frame,
        r.key_bits_per_valid_px,
        r.spent_bits,
        e.mean,
        e.p95,
        e.p99,
        e.max,
        r.warm_ms.p50,
        r.warm_ms.p99,
        r.stage_ms.model.p50,
        r.stage_ms.encode.p50,
        r.decode_ms.p50,
        r.cold_ms.p50,
        r.cold_ms.p99,
        r.cut_ms.p50,
        r.cut_ms.p99,
        r.profile_ms.line(),
        r.throughput
            .as_ref()
            .map_or(String::new(), Throughput::line),
        r.rss_mb,
        r.loaded_mb,
    )
}
