//! `check`: is every byte and every frame of a recording as it was written?

use super::args::CheckArgs;
use super::failure::{Failure, Kind};
use super::{message, signals, status};
use saint_live::recording::{CheckReport, Finding, RecordingReader, check};
use std::fmt::Write as _;
use std::path::Path;
use std::sync::atomic::Ordering;

/// Gaps that are listed for people; JSON has more.
const GAPS_SHOWN: usize = 10;

/// Checks the file and ends with 4 where anything is wrong.
pub fn run(args: &CheckArgs, quiet: bool) -> Result<(), Failure> {
    let stop = signals::stop_flag()?;
    let frames = RecordingReader::open(&args.file)?.frames();
    let bar = (!quiet && !args.json).then(|| status::progress(frames));
    let report = check(&args.file, !args.quick, &mut |done| {
        if let Some(bar) = &bar {
            bar.set_position(done);
        }
        !stop.load(Ordering::Relaxed)
    })?;
    if let Some(bar) = bar {
        bar.finish_and_clear();
    }
    if stop.load(Ordering::Relaxed) {
        message::say("stopped before the end; what follows is not the whole file");
    }
    if args.json {
        let mut text =
            serde_json::to_string(&report).map_err(|e| Failure::new(Kind::Failure, e))?;
        text.push('\n');
        super::write_data(text.as_bytes())?;
    } else if !quiet || !report.is_sound() {
        super::write_data(describe(&report).as_bytes())?;
    }
    if report.is_sound() {
        return Ok(());
    }
    Err(Failure::new(Kind::Input, verdict(&report, &args.file)))
}

/// One line that says it all, for the exit message.
fn verdict(report: &CheckReport, file: &Path) -> String {
    let (path, count) = (file.display(), report.fault_count);
    let (what, remedy) = match report.faults.first() {
        Some(first) => (sentence(first), "writes what is whole to a new file"),
        None => (String::new(), ""),
    };
    let more = match count {
        0 | 1 => String::new(),
        n => format!(" ({} more)", n - 1),
    };
    format!("{path}: {what}{more}; `saint-live repair {path} -o OUT.mcap` {remedy}")
}

fn describe(report: &CheckReport) -> String {
    let mut text = String::new();
    // writing to a String cannot fail
    for fault in &report.faults {
        let _ = writeln!(text, "fault     {}", sentence(fault));
    }
    let shown = report.gaps.len().min(GAPS_SHOWN);
    for gap in &report.gaps[..shown] {
        let camera = named(&gap.camera);
        let what = match gap.missing {
            0 => "a pause".to_owned(),
            n => format!("{n} frames missing, lost before they were recorded"),
        };
        let _ = writeln!(
            text,
            "gap       {camera}after frame {}: {what} ({:.0} ms)",
            gap.after, gap.step_ms
        );
    }
    if report.gap_count > shown as u64 {
        let more = report.gap_count - shown as u64;
        let _ = writeln!(text, "gap       {more} more (--json lists them)");
    }
    let how = if report.decoded {
        "decoded"
    } else {
        "not decoded"
    };
    let _ = writeln!(
        text,
        "{}: {} frames ({} key, {how}), {} bytes: {}",
        report.path,
        report.frames,
        report.key_frames,
        report.bytes,
        match report.fault_count {
            0 => "sound".to_owned(),
            1 => "1 fault".to_owned(),
            n => format!("{n} faults"),
        }
    );
    text
}

fn named(camera: &str) -> String {
    match camera {
        "" => String::new(),
        name => format!("{name}: "),
    }
}

/// A fault as people read it: which frames, where, what.
fn sentence(fault: &Finding) -> String {
    let camera = named(fault.camera.as_deref().unwrap_or_default());
    let frames = match (fault.from, fault.to) {
        (Some(from), Some(to)) if from == to => format!("frame {from}: "),
        (Some(from), Some(to)) => format!("frames {from} to {to}: "),
        (Some(from), None) => format!("before frame {from}: "),
        _ => String::new(),
    };
    let place = fault
        .offset
        .map_or(String::new(), |offset| format!(" (at byte {offset})"));
    format!("{camera}{frames}{}{place}", fault.what)
}
