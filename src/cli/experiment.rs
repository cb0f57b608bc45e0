//! `experiment`: the paper's claims, measured on the user's data.

use super::args::{ExperimentArgs, ExperimentName};
use super::failure::{Failure, Kind};
use super::machine::Machine;
use super::message;
use saint_live::experiment::{
    Effort, ExperimentError, Report, Subject, Table, features, loss, map_resolution, multi_scale,
    packing, schemes, storage,
};
use serde::Serialize;
use std::fmt::Write as _;
use std::time::Instant;

mod data;
mod peers;
mod plot;

impl From<ExperimentError> for Failure {
    fn from(error: ExperimentError) -> Self {
        let kind = match &error {
            ExperimentError::Parameters(_) => Kind::Usage,
            ExperimentError::Points(_) | ExperimentError::Data(_) => Kind::Input,
        };
        Self::new(kind, error)
    }
}

/// What `--json` prints.
#[derive(Serialize)]
struct Printed<'a> {
    #[serde(flatten)]
    report: &'a Report,
    machine: Machine,
    seconds: f64,
}

/// Runs one experiment: tables on standard output, the curve into a file.
pub fn run(args: &ExperimentArgs, quiet: bool) -> Result<(), Failure> {
    if let Some(path) = &args.output {
        plot::check(path, args.overwrite)?;
    }
    let start = Instant::now();
    let report = measure(args, quiet)?;
    let seconds = start.elapsed().as_secs_f64();
    if let Some(path) = &args.output {
        plot::write(path, &report.curve)?;
        if !quiet {
            message::say(&format!("wrote {}", path.display()));
        }
    }
    let machine = Machine::this();
    let text = if args.json {
        let printed = Printed {
            report: &report,
            machine,
            seconds,
        };
        let mut text =
            serde_json::to_string(&printed).map_err(|e| Failure::new(Kind::Failure, e))?;
        text.push('\n');
        text
    } else {
        readable(&report, &machine, seconds)
    };
    super::write_data(text.as_bytes())
}

fn measure(args: &ExperimentArgs, quiet: bool) -> Result<Report, Failure> {
    let effort = Effort { seeds: args.seeds };
    let subjects = || -> Result<Vec<Subject>, Failure> {
        let subjects = data::subjects(args)?;
        if !quiet {
            subjects.iter().for_each(|s| message::say(&s.describe()));
        }
        Ok(subjects)
    };
    let report = match args.name {
        ExperimentName::MultiScale => multi_scale::run(&subjects()?, effort),
        ExperimentName::MapResolution => map_resolution::run(&subjects()?, effort),
        ExperimentName::Storage => {
            let aim = args.chamfer.unwrap_or(storage::CHAMFER_PERCENT);
            let tools = storage::Tools {
                zstd: &peers::zstd,
                draco: &peers::draco,
            };
            storage::run(&subjects()?, effort, aim, tools)
        }
        ExperimentName::Packing => packing::run(&subjects()?, effort),
        ExperimentName::Schemes => schemes::run(&subjects()?, effort),
        ExperimentName::Loss => loss::run(&data::sequences(args)?, effort),
        ExperimentName::Features => features::run(&subjects()?, effort),
    };
    Ok(report?)
}

/// The report for people.
fn readable(report: &Report, machine: &Machine, seconds: f64) -> String {
    let mut text = String::new();
    // writing to a String cannot fail
    let _ = writeln!(text, "experiment {}", report.experiment);
    let _ = writeln!(text, "paper      {}", report.claim);
    let _ = writeln!(text, "method     {}", report.method);
    for line in &report.data {
        let _ = writeln!(text, "data       {line}");
    }
    let _ = writeln!(
        text,
        "runs       {} seeds, mean ± standard deviation; {}, {} cores; {seconds:.1} s",
        report.seeds, machine.cpu, machine.cores
    );
    for table in &report.tables {
        let _ = writeln!(text, "\n{}", table.title);
        write_table(&mut text, table);
    }
    let _ = writeln!(text);
    for finding in &report.findings {
        let _ = writeln!(text, "{finding}");
    }
    text
}

/// Names to the left, numbers to the right.
fn write_table(text: &mut String, table: &Table) {
    let cells: Vec<Vec<String>> = table
        .rows
        .iter()
        .map(|row| row.iter().map(ToString::to_string).collect())
        .collect();
    let length = |s: &str| s.chars().count();
    let width = |c: usize| {
        let column = cells.iter().filter_map(|row| row.get(c));
        column
            .map(|s| length(s))
            .chain([length(table.columns[c])])
            .max()
            .unwrap_or(0)
    };
    let widths: Vec<usize> = (0..table.columns.len()).map(width).collect();
    let is_name = |c: usize| table.rows.iter().all(|row| row[c].value().is_none());
    let head: Vec<String> = table.columns.iter().map(|c| (*c).to_owned()).collect();
    for row in std::iter::once(&head).chain(&cells) {
        let mut line = String::new();
        for (c, cell) in row.iter().enumerate() {
            let room = " ".repeat(widths[c].saturating_sub(length(cell)));
            let (before, after) = if is_name(c) {
                ("", &*room)
            } else {
                (&*room, "")
            };
            let _ = write!(line, "{before}{cell}{after}  ");
        }
        let _ = writeln!(text, "{}", line.trim_end());
    }
}
