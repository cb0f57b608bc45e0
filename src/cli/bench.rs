//! `bench`: quality, size and time on recorded frames held in memory.
//!
//! *Cold*: every frame by a modeler and an encoder that have seen nothing. *Cut*: every frame after
//! one of another scene. *Warm*: the steady state, frame after frame; a short input is played forth
//! and back, so that motion stays continuous. Times are of one frame from the first to the last
//! stage, without queues.

use super::args::{BenchArgs, MapArgs};
use super::engine::{self, Engine};
use super::failure::{Failure, Kind};
use super::machine::{self, Machine};
use super::source::{self, InputOptions};
use super::{message, signals, status};
use hdrhistogram::Histogram;
use saint_live::capture::Next;
use saint_live::codec::{Decoder, EncodedFrame, Spent};
use saint_live::contact_map::labels::SaintFrame;
use saint_live::deproject::Validity;
use saint_live::frame::{Camera, DepthFrame};
use saint_live::pipeline::clock::{Clock, Monotonic};
use saint_live::pipeline::percentiles::Percentiles;
use saint_live::pipeline::stages::Encode;
use std::sync::atomic::{AtomicBool, Ordering};

mod profile;
mod results;
mod throughput;

use profile::Passes;
use results::{Errors, Results, StageTimes, table};

/// Most frames measured cold.
const COLD_FRAMES: usize = 30;
/// Most bytes of depth held in memory.
const MAX_LOADED: usize = 1 << 30;
/// Largest error told apart, µm.
const LARGEST_UM: u64 = 100_000_000;

/// Runs the bench and prints its results.
pub fn run(args: &BenchArgs, quiet: bool) -> Result<(), Failure> {
    let stop = signals::stop_flag()?;
    let engine = Engine::resolve(&args.engine, &MapArgs::default())?;
    engine.start_workers()?;
    let (camera, mut frames) = load(args)?;
    let cold = cold(&camera, &engine, &frames)?;
    let bar = (!quiet).then(|| status::progress(args.frames));
    let warm = warm(&camera, &engine, &mut frames, args.frames, &stop, &|| {
        if let Some(bar) = &bar {
            bar.inc(1);
        }
    })?;
    if let Some(bar) = bar {
        bar.finish_and_clear();
    }
    // what follows needs memory that a stream does not
    let rss_mb = machine::resident_mb();
    let mut passes = Passes::new(&camera);
    for (n, payload) in (0..).zip(&warm.payloads) {
        passes.measure(&frames[forth_and_back(n, frames.len())], payload)?;
    }
    let throughput = throughput::measure(&camera, &engine, &frames, args.frames, &stop)?;
    let loaded: usize = frames.iter().map(|f| f.depth.len() * 2).sum();
    let per_frame = |sum: u64| sum as f64 / warm.frames.max(1) as f64;
    let share = |part: u64, of: u64| {
        if of == 0 {
            0.0
        } else {
            part as f64 / of as f64
        }
    };
    let um = |q: f64| warm.errors.value_at_quantile(q) as f64 * 1e-3;
    let results = Results {
        input: args.input.display().to_string(),
        width: camera.width,
        height: camera.height,
        camera: camera.name,
        frames: warm.frames,
        frames_loaded: frames.len(),
        points_per_frame: per_frame(warm.points),
        spheres_per_frame: per_frame(warm.spheres),
        coverage: share(warm.explained, warm.points),
        warm_points: share(warm.warm, warm.points),
        points_kept: share(warm.points - warm.lost, warm.points),
        residual_mm: Errors {
            mean: warm.error_sum_mm / (warm.points - warm.lost).max(1) as f64,
            p95: um(0.95),
            p99: um(0.99),
            max: warm.error_max_mm,
        },
        bits_per_valid_px: share(warm.bytes * 8, warm.points),
        bytes_per_frame: per_frame(warm.bytes),
        key_bits_per_valid_px: share(cold.bytes * 8, cold.points),
        spent_bits: warm.spent,
        encode_ms: (&warm.encode).into(),
        decode_ms: (&warm.decode).into(),
        stage_ms: StageTimes {
            model: (&warm.model).into(),
            encode: (&warm.encode).into(),
            decode: (&warm.decode).into(),
        },
        cold_ms: (&cold.first).into(),
        cut_ms: (&cold.cut).into(),
        warm_ms: (&warm.both).into(),
        throughput,
        profile_ms: passes.profile(&warm.model, &warm.encode, &warm.decode),
        rss_mb,
        loaded_mb: loaded as f64 * 1e-6,
        threads: engine.threads,
        machine: Machine::this(),
        version: env!("CARGO_PKG_VERSION"),
    };
    if args.json {
        let mut text =
            serde_json::to_string(&results).map_err(|e| Failure::new(Kind::Failure, e))?;
        text.push('\n');
        super::write_data(text.as_bytes())
    } else {
        super::write_data(table(&results).as_bytes())
    }
}

/// Reads up to the number of frames asked for.
fn load(args: &BenchArgs) -> Result<(Camera, Vec<DepthFrame>), Failure> {
    let options = InputOptions {
        camera: args.camera.clone(),
        ..InputOptions::default()
    };
    let mut source = source::recorded(&args.input, &options)?;
    let camera = source.camera().clone();
    let most = (MAX_LOADED / (2 * camera.pixels()).max(1)).max(1);
    let wanted = usize::try_from(args.frames).unwrap_or(usize::MAX).min(most);
    let mut frames = Vec::new();
    while frames.len() < wanted {
        let mut frame = DepthFrame::default();
        match source.next(&mut frame)? {
            Next::Frame => frames.push(frame),
            Next::Waiting(_) => {}
            Next::End => break,
        }
    }
    if frames.is_empty() {
        return Err(Failure::new(
            Kind::Input,
            format_args!("{}: holds no frame", args.input.display()),
        ));
    }
    if frames.len() == most && (most as u64) < args.frames {
        message::say(&format!(
            "only {most} frames fit in memory; they are repeated"
        ));
    }
    Ok((camera, frames))
}

/// What frames gave that have nothing to go by.
struct Cold {
    /// The first frame of a stream: buffers are taken, too.
    first: Percentiles,
    /// The first frame of another scene in a running stream.
    cut: Percentiles,
    bytes: u64,
    points: u64,
}

fn stage_failed(error: saint_live::pipeline::StageError) -> Failure {
    Failure::new(Kind::Failure, error)
}

/// Some of the frames out of nothing, and after a cut.
fn cold(camera: &Camera, engine: &Engine, frames: &[DepthFrame]) -> Result<Cold, Failure> {
    let mut cold = Cold {
        first: Percentiles::new(),
        cut: Percentiles::new(),
        bytes: 0,
        points: 0,
    };
    let (mut saint, mut encoded) = (SaintFrame::default(), EncodedFrame::default());
    let step = frames.len().div_ceil(COLD_FRAMES);
    for frame in frames.iter().step_by(step) {
        let (mut model, encode) = engine::stages(camera, engine)?;
        let mut encode = encode.unsampled();
        let mut pass = |frame: &DepthFrame, times: Option<&mut Percentiles>| {
            let start = Monotonic.now_ns();
            let report = model.model(frame, &mut saint, &|| false)?;
            encode.encode(frame, &saint, &report, &mut encoded)?;
            if let Some(times) = times {
                times.record_ns(Monotonic.now_ns() - start);
            }
            Ok((encoded.payload.len() as u64, u64::from(report.points)))
        };
        let (bytes, points) = pass(frame, Some(&mut cold.first)).map_err(stage_failed)?;
        cold.bytes += bytes;
        cold.points += points;
        // half a turn makes another scene of it
        let mut turned = frame.clone();
        turned.depth.reverse();
        turned.sequence += 1;
        pass(&turned, Some(&mut cold.cut)).map_err(stage_failed)?;
    }
    Ok(cold)
}

/// What the steady state gave.
struct Warm {
    model: Percentiles,
    encode: Percentiles,
    decode: Percentiles,
    both: Percentiles,
    /// Of all frames, the first one too.
    payloads: Vec<Vec<u8>>,
    errors: Histogram<u64>,
    error_sum_mm: f64,
    error_max_mm: f64,
    frames: u64,
    points: u64,
    explained: u64,
    warm: u64,
    lost: u64,
    spheres: u64,
    bytes: u64,
    spent: Spent,
}

impl Warm {
    fn new() -> Result<Self, Failure> {
        let errors = Histogram::new_with_bounds(1, LARGEST_UM, 3)
            .map_err(|error| Failure::new(Kind::Failure, error))?;
        Ok(Self {
            model: Percentiles::new(),
            encode: Percentiles::new(),
            decode: Percentiles::new(),
            both: Percentiles::new(),
            payloads: Vec::new(),
            errors,
            error_sum_mm: 0.0,
            error_max_mm: 0.0,
            frames: 0,
            points: 0,
            explained: 0,
            warm: 0,
            lost: 0,
            spheres: 0,
            bytes: 0,
            spent: Spent::default(),
        })
    }

    /// Decodes the payloads, for the time it takes and then for what came back. After all of them are
    /// written, since a sender reads none: what it did between two frames would push the encoder's
    /// memory out of the caches, and the other way round.
    fn read(&mut self, camera: &Camera, frames: &[DepthFrame]) -> Result<(), Failure> {
        let failed = |error| Failure::new(Kind::Failure, error);
        let payloads = std::mem::take(&mut self.payloads);
        let mut decoder = Decoder::new();
        for (n, payload) in payloads.iter().enumerate() {
            let start = Monotonic.now_ns();
            decoder.decode(payload).map_err(failed)?;
            if n > 0 {
                self.decode.record_ns(Monotonic.now_ns() - start);
            }
        }
        let validity = Validity::new(camera);
        let mut decoder = Decoder::new();
        for (n, payload) in (0..).zip(&payloads) {
            let decoded = decoder.decode(payload).map_err(failed)?;
            if n > 0 {
                let frame = &frames[forth_and_back(n, frames.len())];
                self.compare(frame, &decoded.depth_m, &validity, camera.depth_unit_m);
            }
        }
        self.payloads = payloads;
        Ok(())
    }

    /// Compares what was measured with what came back.
    fn compare(&mut self, frame: &DepthFrame, depth_m: &[f32], validity: &Validity, unit: f64) {
        for (&raw, &z) in frame.depth.iter().zip(depth_m) {
            if !validity.accepts(raw) {
                continue;
            }
            if !(z.is_finite() && z > 0.0) {
                self.lost += 1;
                continue;
            }
            let error_mm = (f64::from(raw) * unit - f64::from(z)).abs() * 1e3;
            self.errors
                .saturating_record((error_mm * 1e3).round() as u64);
            self.error_sum_mm += error_mm;
            self.error_max_mm = self.error_max_mm.max(error_mm);
        }
    }
}

/// The steady state: `count` frames forth and back, after one round to warm up.
fn warm(
    camera: &Camera,
    engine: &Engine,
    frames: &mut [DepthFrame],
    count: u64,
    stop: &AtomicBool,
    progress: &dyn Fn(),
) -> Result<Warm, Failure> {
    let mut warm = Warm::new()?;
    let (mut model, encode) = engine::stages(camera, engine)?;
    let mut encode = encode.unsampled();
    let (mut saint, mut encoded) = (SaintFrame::default(), EncodedFrame::default());
    // the first frame is a cold one: it warms up and is not counted
    for n in 0..=count {
        if stop.load(Ordering::Relaxed) {
            return Err(Failure::new(
                Kind::Failure,
                "stopped before the bench was done",
            ));
        }
        let frame = &mut frames[forth_and_back(n, frames.len())];
        frame.sequence = n;
        let start = Monotonic.now_ns();
        let report = model
            .model(frame, &mut saint, &|| false)
            .map_err(stage_failed)?;
        let modelled = Monotonic.now_ns();
        let coding = encode
            .encode(frame, &saint, &report, &mut encoded)
            .map_err(stage_failed)?;
        let coded = Monotonic.now_ns();
        warm.payloads.push(encoded.payload.clone());
        if n == 0 {
            continue;
        }
        progress();
        warm.model.record_ns(modelled - start);
        warm.encode.record_ns(coded - modelled);
        warm.both.record_ns(coded - start);
        warm.frames += 1;
        warm.points += u64::from(report.points);
        warm.explained += u64::from(report.explained);
        warm.warm += u64::from(report.warm);
        warm.spheres += u64::from(report.spheres);
        warm.bytes += encoded.payload.len() as u64;
        warm.spent += coding.spent;
    }
    warm.read(camera, frames)?;
    Ok(warm)
}

/// Index of the `n`-th frame when `len` frames are played forth and back: 0 1 2 2 1 0 0 1 ...
fn forth_and_back(n: u64, len: usize) -> usize {
    let at = (n % (2 * len as u64)) as usize;
    if at < len { at } else { 2 * len - 1 - at }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn short_inputs_are_played_forth_and_back() {
        let order: Vec<_> = (0..8).map(|n| forth_and_back(n, 3)).collect();
        assert_eq!(order, [0, 1, 2, 2, 1, 0, 0, 1]);
        assert_eq!(forth_and_back(5, 1), 0);
    }
}
