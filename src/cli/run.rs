//! Live capture and replay: the same pipeline behind two kinds of source.

use super::args::{LateArg, LiveArgs, ReplayArgs, RunArgs, StreamArgs};
use super::engine::{self, Engine};
use super::failure::{Failure, Kind};
use super::sink;
use super::source::{self, InputOptions};
use super::status::Display;
use super::{message, signals};
use saint_live::capture::FrameSource;
use saint_live::frame::Camera;
use saint_live::pipeline::budget::{Budget, Late};
use saint_live::pipeline::clock::{Clock, Monotonic};
use saint_live::pipeline::color::ColorSource;
use saint_live::pipeline::recorder::Recorder;
use saint_live::pipeline::report::Report;
use saint_live::pipeline::trace::Trace;
use saint_live::pipeline::{self, Options, Pace, Priority, Stages};
use saint_live::rig::{COLOR_CAMERA_NOTE, ColorCamera};
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::Path;

mod rig;

/// `saint-live --device ...`
pub fn capture(args: &LiveArgs, quiet: bool) -> Result<(), Failure> {
    if args.rig.is_some() || args.device.len() > 1 {
        return rig::capture(args, quiet);
    }
    let device = args.device.first().cloned().unwrap_or_default();
    let engine = Engine::resolve(&args.engine, &args.map)?;
    let mut run = Run::new(engine, &args.stream, device, quiet);
    if let Some(path) = &args.color_camera {
        run.note_color_camera(&ColorCamera::read(path)?)?;
    }
    let mut source = source::live(&run.source, &args.capture)?;
    let color = source::color(&args.capture);
    let pace = pace_of(source.as_ref());
    run.stream(source.as_mut(), color, pace)
}

/// A camera does not wait; a sensor that is asked for each frame does.
fn pace_of(source: &dyn FrameSource) -> Pace {
    if source.is_live() {
        Pace::Live
    } else {
        Pace::Block
    }
}

/// `saint-live replay INPUT`
pub fn replay(args: &ReplayArgs, quiet: bool) -> Result<(), Failure> {
    let name = args.input.display().to_string();
    if let Some(output) = &args.stream.output
        && is_same_file(output, &args.input)
    {
        return Err(Failure::usage(format_args!(
            "{name} is input and output at once; give -o another name"
        )));
    }
    let engine = Engine::resolve(&args.engine, &args.map)?;
    let mut run = Run::new(engine, &args.stream, name, quiet);
    if let Some(path) = &args.color_camera {
        run.note_color_camera(&ColorCamera::read(path)?)?;
    }
    let options = InputOptions {
        camera: args.camera.clone(),
        range: args.range,
        fps: args.fps,
        exr_depth: args.exr_depth,
        topic: args.topic.clone(),
        color: args.color,
    };
    let mut source = if args.repeat {
        source::repeated(&args.input, &options)?
    } else {
        source::recorded(&args.input, &options)?
    };
    let pace = if args.realtime {
        Pace::Realtime
    } else {
        Pace::Block
    };
    run.stream(source.as_mut(), None, pace)
}

/// True where both names lead to one file: writing the one would destroy the other.
pub fn is_same_file(output: &Path, input: &Path) -> bool {
    let whole = |path: &Path| path.canonicalize().ok();
    input.is_file() && whole(output).is_some_and(|path| Some(path) == whole(input))
}

/// A run as it was asked for.
struct Run<'a> {
    engine: Engine,
    stream: &'a StreamArgs,
    source: String,
    quiet: bool,
    /// Facts to record beside the engine's and the source's own.
    notes: BTreeMap<String, String>,
}

impl<'a> Run<'a> {
    fn new(engine: Engine, stream: &'a StreamArgs, source: String, quiet: bool) -> Self {
        Self {
            engine,
            stream,
            source,
            quiet,
            notes: BTreeMap::new(),
        }
    }

    /// Records a fact as JSON.
    fn note(&mut self, name: &str, fact: &impl Serialize) -> Result<(), Failure> {
        let text = serde_json::to_string(fact).map_err(|e| Failure::new(Kind::Failure, e))?;
        self.notes.insert(name.to_owned(), text);
        Ok(())
    }

    /// Says and records what the colour camera is taken for.
    fn note_color_camera(&mut self, camera: &ColorCamera) -> Result<(), Failure> {
        if !self.quiet {
            let k = camera.intrinsics;
            message::say(&format!(
                "colour camera: {}x{}, fx {:.2} fy {:.2} cx {:.2} cy {:.2}, pose as given",
                camera.width, camera.height, k.fx, k.fy, k.cx, k.cy
            ));
        }
        self.note(COLOR_CAMERA_NOTE, camera)
    }

    /// Everything the recording keeps about how it was made.
    fn all_notes(&self, source: &dyn FrameSource) -> BTreeMap<String, String> {
        let mut notes = self.engine.notes(&self.source);
        let facts = source.notes().into_iter();
        notes.extend(facts.map(|(name, fact)| (name.to_owned(), fact)));
        notes.extend(self.notes.clone());
        notes
    }

    /// The pipeline's options for one of so many cameras.
    fn options(&self, camera: &Camera, pace: Pace, cameras: usize) -> Options {
        Options {
            threads: self.engine.threads,
            stage_threads: self.engine.stage_threads(cameras, pace == Pace::Block),
            priority: if self.stream.realtime_priority {
                Priority::Realtime
            } else {
                Priority::Usual
            },
            pace,
            budget: self.budget(camera, pace),
            frames: self.stream.run.frames,
            duration: self.stream.run.duration,
        }
    }

    /// The contract: one frame period live, none for a replay that asks for none.
    fn budget(&self, camera: &Camera, pace: Pace) -> Budget {
        let asked = self.stream.budget.is_some() || self.stream.on_late.is_some();
        if pace == Pace::Block && !asked && !self.stream.strict {
            return Budget::UNLIMITED;
        }
        let late = match self.stream.on_late {
            Some(LateArg::Drop) => Late::Drop,
            Some(LateArg::Wait) => Late::Wait,
            Some(LateArg::Degrade) | None => Late::Degrade,
        };
        let period = Budget::one_period(camera.fps, late);
        Budget {
            limit: self.stream.budget.unwrap_or(period.limit),
            late,
        }
    }

    /// Runs the pipeline, shows it, and says how it ended.
    fn stream(
        &self,
        source: &mut dyn FrameSource,
        mut color: Option<source::Color>,
        pace: Pace,
    ) -> Result<(), Failure> {
        let stop = signals::stop_flag()?;
        let camera = source.camera().clone();
        if !self.quiet {
            source::introduce(source);
        }
        if self.engine.threads == 1 {
            // everything is computed here
            self.engine.start_workers()?;
        }
        let (mut model, mut encode) = engine::stages(&camera, &self.engine)?;
        let mut output = sink::open(self.stream, &camera, self.all_notes(source))?;
        let trace = trace(&self.stream.run)?;
        let options = self.options(&camera, pace, 1);
        // a live stream has no end to measure progress by, unless one was set
        let expected = match (source.len_hint(), self.stream.run.frames) {
            (Some(hint), Some(most)) => Some(hint.min(most)),
            (hint, most) => hint.or(most),
        };
        let expected = expected.filter(|_| pace != Pace::Live);
        let mut display = Display::new(self.quiet, self.stream.run.stats, expected);
        let stages = Stages {
            source,
            color: color.as_mut().map(|color| color as &mut dyn ColorSource),
            model: model.as_mut(),
            encode: &mut encode,
            sink: &mut output,
            trace,
            start: None,
        };
        let outcome = pipeline::run(stages, &options, &Monotonic, &stop, &mut |meter| {
            display.observe(meter, &stop);
        });
        let shown = display.finish(self.quiet, &outcome.report);
        if let Some(error) = &outcome.color {
            message::say(&format!("saint-live: colour ended early: {error}"));
        }
        self.say_written(&output);
        outcome.result?;
        shown?;
        if outcome.report.frames == 0 && self.stream.run.frames != Some(0) {
            self.nothing_written(&outcome.report, pace)?;
        }
        self.judge(&outcome.report)
    }

    /// Says what was written, where this side of the recording closed it.
    fn say_written(&self, output: &Recorder) {
        if let (Some(summary), false) = (&output.summary, self.quiet) {
            message::wrote(
                &summary.target,
                summary.parts,
                summary.frames,
                summary.bytes,
            );
        }
    }

    /// A replay without a single frame is a bad input; a camera stopped at once is not.
    fn nothing_written(&self, report: &Report, pace: Pace) -> Result<(), Failure> {
        if pace == Pace::Live || report.sensor_frames > 0 {
            return Ok(());
        }
        Err(Failure::new(
            Kind::Input,
            format_args!(
                "{}: holds no frame; name a folder with depth images",
                self.source
            ),
        ))
    }

    /// `--strict`: the budget is a promise.
    fn judge(&self, report: &Report) -> Result<(), Failure> {
        let missed = report.late + report.degraded + report.drops.budget + report.drops.queue;
        if !self.stream.strict || missed == 0 {
            return Ok(());
        }
        Err(Failure::new(
            Kind::Budget,
            format_args!(
                "budget missed: {} frames late, {} degraded, {} dropped, of {}; allow more time with --budget or take fewer frames",
                report.late,
                report.degraded,
                report.drops.budget + report.drops.queue,
                report.sensor_frames,
            ),
        ))
    }
}

/// Opens the timeline that `--trace` names.
pub fn trace(args: &RunArgs) -> Result<Option<Trace>, Failure> {
    let Some(path) = &args.trace else {
        return Ok(None);
    };
    if path.exists() && !args.overwrite {
        return Err(Failure::usage(format_args!(
            "{} exists already; give another name or --overwrite",
            path.display()
        )));
    }
    Trace::create(path, Monotonic.now_ns())
        .map(Some)
        .map_err(|source| {
            Failure::new(
                Kind::Output,
                format_args!("cannot write {}: {source}", path.display()),
            )
        })
}
