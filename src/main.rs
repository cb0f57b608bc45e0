//! The program: reads the command line, runs one command, says why it failed.

mod cli;

use std::process::ExitCode;

fn main() -> ExitCode {
    cli::main()
}
