//! Several cameras at once: a pipeline each, one recording.

use super::super::args::{LiveArgs, StatsArg};
use super::super::engine::{self, Engine};
use super::super::failure::{Failure, Kind};
use super::super::source::{self, Color};
use super::super::status::Display;
use super::super::values::Length;
use super::super::{message, report, signals, sink};
use super::{Run, pace_of};
use saint_live::capture::FrameSource;
use saint_live::pipeline::clock::Monotonic;
use saint_live::pipeline::color::ColorSource;
use saint_live::pipeline::recorder::Recorder;
use saint_live::pipeline::report::Report;
use saint_live::pipeline::start::{self, Place};
use saint_live::pipeline::{self, Stages};
use saint_live::recording::CameraStream;
use saint_live::rig::{POSE_NOTE, Rig, RigCamera};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::thread::{self, ScopedJoinHandle};
use std::time::Duration;

/// How often the status line of all cameras is rewritten.
const STATUS: Duration = Duration::from_millis(250);

/// One camera, opened.
struct Opened<'a> {
    name: String,
    run: Run<'a>,
    source: Box<dyn FrameSource>,
    color: Option<Color>,
}

/// `saint-live --rig FILE`, or `--device` more than once.
pub(super) fn capture(args: &LiveArgs, quiet: bool) -> Result<(), Failure> {
    let rig = resolve(args)?;
    if args.stream.run.stats == Some(StatsArg::Csv) || args.stream.run.trace.is_some() {
        return Err(Failure::usage(
            "--stats csv and --trace are for one camera; several give --stats json or text",
        ));
    }
    let engine = Engine::resolve(&args.engine, &args.map)?;
    let mut cameras = Vec::new();
    for camera in &rig.cameras {
        let opened = open(args, camera, &engine, quiet);
        cameras.push(opened.map_err(|e| e.at(&format!("camera `{}`", camera.name)))?);
    }
    let streams: Vec<CameraStream> = cameras
        .iter()
        .map(|camera| CameraStream {
            name: camera.name.clone(),
            camera: camera.source.camera().clone(),
            notes: camera.run.all_notes(camera.source.as_ref()),
        })
        .collect();
    let outputs = sink::open_rig(&args.stream, &streams)?;
    let stop = signals::stop_flag()?;
    let board = Board::new(&cameras);
    let together = start::together(cameras.len());
    let results = thread::scope(|scope| {
        let threads: Vec<_> = cameras
            .into_iter()
            .zip(outputs)
            .zip(together)
            .enumerate()
            .map(|(number, ((camera, output), start))| {
                let (board, stop) = (&board, &*stop);
                let name = format!("camera-{number}");
                let work = move || {
                    // with one thread a camera, all of it is computed here
                    let _own = (camera.run.engine.threads == 1).then(Engine::own_worker);
                    stream(camera, output, start, number, board, stop)
                };
                thread::Builder::new().name(name).spawn_scoped(scope, work)
            })
            .collect();
        if !quiet && std::io::IsTerminal::is_terminal(&std::io::stderr()) {
            board.show_until_done(&threads);
        }
        threads.into_iter().map(joined).collect::<Vec<_>>()
    });
    // an output that failed, failed for all: tell that rather than what followed from it
    let (output, others): (Vec<_>, Vec<_>) = results
        .into_iter()
        .filter_map(Result::err)
        .partition(Failure::is_output);
    output.into_iter().chain(others).next().map_or(Ok(()), Err)
}

fn resolve(args: &LiveArgs) -> Result<Rig, Failure> {
    match &args.rig {
        Some(path) => Ok(Rig::read(path)?),
        None if args.capture.color_device.is_some() || args.capture.camera.intrinsics.is_some() => {
            Err(Failure::usage(
                "with several cameras, colour and intrinsics belong to one of them: write a rig \
                 file and give it with --rig",
            ))
        }
        None => Rig::of_devices(&args.device).map_err(Failure::usage),
    }
}

/// Opens one camera of a rig: what the rig says of it, else what the command line says.
fn open<'a>(
    args: &'a LiveArgs,
    camera: &RigCamera,
    engine: &Engine,
    quiet: bool,
) -> Result<Opened<'a>, Failure> {
    let mut own = args.capture.clone();
    own.size = camera.size.or(own.size);
    own.fps = camera.fps.or(own.fps);
    own.pixel_format = camera.pixel_format.clone().or(own.pixel_format);
    own.camera.intrinsics = camera.intrinsics.clone();
    own.camera.depth_unit = camera.depth_unit_m.map(Length).or(own.camera.depth_unit);
    own.color_device.clone_from(&camera.color_device);
    let mut run = Run::new(engine.clone(), &args.stream, camera.device.clone(), quiet);
    if let Some(pose) = camera
        .pose
        .or_else(|| source::synthetic_pose(&camera.device))
    {
        run.note(POSE_NOTE, &pose)?;
    }
    if let Some(color) = &camera.color_camera {
        run.note_color_camera(color)?;
    }
    let source = source::live(&camera.device, &own)?;
    if !quiet {
        source::introduce(source.as_ref());
    }
    Ok(Opened {
        name: camera.name.clone(),
        run,
        color: source::color(&own),
        source,
    })
}

/// Runs one camera's pipeline to its end.
fn stream(
    camera: Opened<'_>,
    mut output: Recorder,
    start: Place,
    number: usize,
    board: &Board,
    stop: &AtomicBool,
) -> Result<(), Failure> {
    let Opened {
        name,
        run,
        mut source,
        mut color,
    } = camera;
    let place = format!("camera `{name}`");
    let pace = pace_of(source.as_ref());
    let facts = source.camera().clone();
    let (mut model, mut encode) = engine::stages(&facts, &run.engine)?;
    let mut display = Display::of_camera(&name, run.stream.run.stats);
    let stages = Stages {
        source: source.as_mut(),
        color: color.as_mut().map(|color| color as &mut dyn ColorSource),
        model: model.as_mut(),
        encode: &mut encode,
        sink: &mut output,
        trace: None,
        start: Some(start),
    };
    let options = run.options(&facts, pace, board.names.len());
    let outcome = pipeline::run(stages, &options, &Monotonic, stop, &mut |meter| {
        board.set(number, meter.total());
        display.observe(meter, stop);
    });
    board.set(number, outcome.report);
    let shown = display.finish(true, &outcome.report);
    if !run.quiet {
        message::say(&format!("{place}: {}", report::summary(&outcome.report)));
    }
    if let Some(error) = &outcome.color {
        message::say(&format!("{place}: colour ended early: {error}"));
    }
    run.say_written(&output);
    let result = outcome
        .result
        .map_err(|error| Failure::from(error).at(&place));
    if let Err(failure) = &result {
        // the others go on: tell it now
        message::say(&format!("saint-live: {failure}; the other cameras go on"));
    }
    result?;
    shown?;
    if outcome.report.frames == 0 && run.stream.run.frames != Some(0) {
        run.nothing_written(&outcome.report, pace)?;
    }
    run.judge(&outcome.report)
        .map_err(|failure| failure.at(&place))
}

fn joined(
    thread: std::io::Result<ScopedJoinHandle<'_, Result<(), Failure>>>,
) -> Result<(), Failure> {
    let thread = thread.map_err(|e| Failure::new(Kind::Failure, format_args!("no thread: {e}")))?;
    thread.join().unwrap_or_else(|_| {
        Err(Failure::new(
            Kind::Failure,
            "a camera's thread ended unexpectedly",
        ))
    })
}

/// What the cameras do, for one status line.
struct Board {
    names: Vec<String>,
    reports: Mutex<Vec<Report>>,
}

impl Board {
    fn new(cameras: &[Opened<'_>]) -> Self {
        Self {
            names: cameras.iter().map(|camera| camera.name.clone()).collect(),
            reports: Mutex::new(vec![Report::default(); cameras.len()]),
        }
    }

    fn reports(&self) -> MutexGuard<'_, Vec<Report>> {
        self.reports.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn set(&self, number: usize, report: Report) {
        if let Some(place) = self.reports().get_mut(number) {
            *place = report;
        }
    }

    fn line(&self) -> String {
        let reports = self.reports();
        let cameras = self.names.iter().zip(&*reports).map(|(name, report)| {
            format!(
                "{name} {:.1} fps age p50 {:.0} ms dropped {}",
                report.fps,
                report.age_ms.p50,
                report.drops.total()
            )
        });
        cameras.collect::<Vec<_>>().join(" | ")
    }

    fn show_until_done<T>(&self, threads: &[std::io::Result<ScopedJoinHandle<'_, T>>]) {
        let running = || threads.iter().flatten().any(|thread| !thread.is_finished());
        let done = AtomicBool::new(false);
        while !done.load(Ordering::Relaxed) {
            thread::sleep(STATUS);
            message::status(&self.line());
            done.store(!running(), Ordering::Relaxed);
        }
        message::end_status();
    }
}
