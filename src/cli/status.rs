//! What is shown while a stream runs: status line or progress bar on a terminal, statistics on
//! standard output.

use super::args::StatsArg;
use super::failure::Failure;
use super::{message, report};
use indicatif::{ProgressBar, ProgressStyle};
use saint_live::pipeline::Meter;
use saint_live::pipeline::report::Report;
use serde::Serialize;
use std::io::{self, IsTerminal, Write};
use std::sync::atomic::{AtomicBool, Ordering};

/// The status line is rewritten this often, ns.
const STATUS_NS: i64 = 250_000_000;
/// Statistics are printed this often, ns.
const STATS_NS: i64 = 1_000_000_000;

/// A report as a line of JSON.
#[derive(Serialize)]
struct Line<'a> {
    #[serde(rename = "final")]
    last: bool,
    #[serde(skip_serializing_if = "Option::is_none")]
    camera: Option<&'a str>,
    #[serde(flatten)]
    report: &'a Report,
}

/// Which numbers of a run are told as sentences.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Words {
    #[default]
    Modelled,
    Raw,
}

impl Words {
    fn status(self, now: &Report, run: &Report) -> String {
        match self {
            Self::Modelled => report::status(now, run),
            Self::Raw => report::raw_status(now, run),
        }
    }

    fn summary(self, run: &Report) -> String {
        match self {
            Self::Modelled => report::summary(run),
            Self::Raw => report::raw_summary(run),
        }
    }
}

/// The display of one run.
pub struct Display {
    words: Words,
    /// Rewrite a line, or move a bar.
    shown: bool,
    bar: Option<ProgressBar>,
    stats: Option<StatsArg>,
    /// The camera the statistics are of, among several.
    camera: Option<String>,
    header_due: bool,
    status_ns: i64,
    stats_ns: i64,
    before: Report,
    failure: Option<Failure>,
}

/// A progress bar over `frames` frames on standard error.
pub fn progress(frames: u64) -> ProgressBar {
    let bar = ProgressBar::new(frames);
    // the template is ours; where it were refused, indicatif's own look would do
    if let Ok(style) = ProgressStyle::with_template("{bar:24} {pos}/{len} {eta}  {msg}") {
        bar.set_style(style);
    }
    bar
}

impl Display {
    /// A display; with `frames` to come it is a bar.
    pub fn new(quiet: bool, stats: Option<StatsArg>, frames: Option<u64>) -> Self {
        let shown = !quiet && io::stderr().is_terminal();
        Self {
            words: Words::default(),
            shown,
            bar: frames.filter(|_| shown).map(progress),
            stats,
            camera: None,
            header_due: stats == Some(StatsArg::Csv),
            status_ns: 0,
            stats_ns: 0,
            before: Report::default(),
            failure: None,
        }
    }

    /// The display of a raw capture, which has no model to tell of.
    pub fn of_raw(quiet: bool, stats: Option<StatsArg>, frames: Option<u64>) -> Self {
        Self {
            words: Words::Raw,
            ..Self::new(quiet, stats, frames)
        }
    }

    /// The statistics of one camera among several, which show nothing else.
    pub fn of_camera(name: &str, stats: Option<StatsArg>) -> Self {
        Self {
            camera: Some(name.to_owned()),
            ..Self::new(true, stats, None)
        }
    }

    /// Shows what is due. `stop` is raised where standard output fails.
    pub fn observe(&mut self, meter: &Meter<'_, '_>, stop: &AtomicBool) {
        let now = meter.now_ns();
        if self.stats_ns == 0 {
            (self.stats_ns, self.status_ns) = (now, now);
        }
        if self.stats.is_some() && now - self.stats_ns >= STATS_NS {
            self.stats_ns = now;
            let interval = meter.interval();
            if interval.frames > 0 || interval.drops.total() > 0 {
                self.print(&interval, false);
            }
        }
        if self.shown && now - self.status_ns >= STATUS_NS {
            self.status_ns = now;
            self.show(&meter.total());
        }
        if self.failure.is_some() {
            stop.store(true, Ordering::Relaxed);
        }
    }

    /// Rewrites the line.
    fn show(&mut self, total: &Report) {
        if total.frames == 0 {
            return;
        }
        // the rate of the last moment, the rest of the run
        let mut now = *total;
        let elapsed = total.elapsed_s - self.before.elapsed_s;
        if elapsed > 0.0 && self.before.frames > 0 {
            now.fps = (total.frames - self.before.frames) as f64 / elapsed;
        }
        // smoothed over about a second
        if self.before.frames == 0 || elapsed >= 1.0 {
            self.before = *total;
        }
        let line = self.words.status(&now, total);
        match &self.bar {
            Some(bar) => {
                bar.set_position(total.sensor_frames);
                bar.set_message(line);
            }
            None => message::status(&line),
        }
    }

    fn print(&mut self, report: &Report, last: bool) {
        let text = match self.stats {
            None => return,
            Some(StatsArg::Json) => {
                let camera = self.camera.as_deref();
                let line = Line {
                    last,
                    camera,
                    report,
                };
                match serde_json::to_string(&line) {
                    Ok(text) => text,
                    Err(error) => {
                        self.failure = Some(Failure::new(super::failure::Kind::Failure, error));
                        return;
                    }
                }
            }
            Some(StatsArg::Csv) if self.header_due => {
                self.header_due = false;
                format!("{}\n{}", Report::CSV_HEADER, report.csv())
            }
            Some(StatsArg::Csv) => report.csv(),
            Some(StatsArg::Text) => match &self.camera {
                Some(name) => format!("{name}  {}", self.words.status(report, report)),
                None => self.words.status(report, report),
            },
        };
        let mut out = io::stdout().lock();
        if let Err(error) = writeln!(out, "{text}").and_then(|()| out.flush()) {
            self.failure.get_or_insert_with(|| Failure::stdout(&error));
        }
    }

    /// Shows the whole run; the last line of statistics is its total.
    pub fn finish(mut self, quiet: bool, total: &Report) -> Result<(), Failure> {
        if let Some(bar) = &self.bar {
            bar.finish_and_clear();
        }
        if self.shown && self.bar.is_none() {
            self.show(total);
        }
        message::end_status();
        self.print(total, true);
        if !quiet {
            message::say(&self.words.summary(total));
        }
        self.failure.map_or(Ok(()), Err)
    }
}
