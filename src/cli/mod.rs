//! The command line: low arguments (`args`) become resolved options, then a command runs.
//!
//! Messages go to standard error, data to standard output.

mod args;
mod bench;
mod check;
mod devices;
mod engine;
mod experiment;
mod export;
mod failure;
mod info;
mod keyboard;
mod machine;
mod message;
mod model;
mod model_file;
mod play;
mod record;
mod repair;
mod report;
mod run;
mod signals;
mod sink;
mod source;
mod status;
mod synthesize;
mod tape;
mod values;

use args::{Arguments, Command};
use clap::CommandFactory;
use failure::Failure;
use std::io::{self, Write};
use std::process::ExitCode;

/// Parses the command line, runs it and gives the exit code.
pub fn main() -> ExitCode {
    // clap itself prints, and ends usage errors with 2
    let arguments = Arguments::read(std::env::args_os()).unwrap_or_else(|error| error.exit());
    message::start(arguments.quiet, arguments.verbose);
    match dispatch(arguments) {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            if !failure.is_silent() {
                message::say(&format!("saint-live: {failure}"));
            }
            ExitCode::from(failure.code())
        }
    }
}

fn dispatch(arguments: Arguments) -> Result<(), Failure> {
    match arguments.command {
        None => run::capture(&arguments.live, arguments.quiet),
        Some(Command::Devices(args)) => devices::run(&args),
        Some(Command::Replay(args)) => run::replay(&args, arguments.quiet),
        Some(Command::Record(args)) => record::run(&args, arguments.quiet),
        Some(Command::Play(args)) => play::run(&args),
        Some(Command::Export(args)) => export::run(&args, arguments.quiet),
        Some(Command::Info(args)) => info::run(&args),
        Some(Command::Check(args)) => check::run(&args, arguments.quiet),
        Some(Command::Repair(args)) => repair::run(&args, arguments.quiet),
        Some(Command::Bench(args)) => bench::run(&args, arguments.quiet),
        Some(Command::Experiment(args)) => experiment::run(&args, arguments.quiet),
        Some(Command::Synthesize(args)) => synthesize::run(&args, arguments.quiet),
        Some(Command::Model(args)) => model::run(&args, arguments.quiet),
        Some(Command::Completions { shell }) => {
            let mut script = Vec::new();
            let mut command = Arguments::command();
            clap_complete::generate(shell, &mut command, "saint-live", &mut script);
            write_data(&script)
        }
    }
}

/// Writes data to standard output; a reader that has gone away is a clean end.
fn write_data(bytes: &[u8]) -> Result<(), Failure> {
    let mut out = io::stdout().lock();
    out.write_all(bytes)
        .and_then(|()| out.flush())
        .map_err(|source| Failure::stdout(&source))
}
