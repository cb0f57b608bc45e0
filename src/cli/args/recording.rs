//! Arguments of the commands that look after a recording: `play`, `check`, `repair`.

use super::{LevelArg, RangeArgs};
use crate::cli::values::factor;
use clap::Args;
use std::path::PathBuf;

const PLAY_KEYS: &str = "\
Keys: space holds and goes on, left and right (or , and .) step one frame, up and down one second, \
Home and End go to the ends, q ends.";

/// `play`.
#[derive(Debug, Args)]
#[command(after_help = PLAY_KEYS)]
pub struct PlayArgs {
    /// The recording.
    pub file: PathBuf,
    #[command(flatten)]
    pub range: RangeArgs,
    /// Show this frame, counted from 0. A terminal holds it for you to step from; else it is the
    /// only one.
    #[arg(long, value_name = "N", conflicts_with_all = ["from", "to"])]
    pub frame: Option<u64>,
    /// How much of each payload is decoded.
    #[arg(long, value_enum, default_value_t)]
    pub level: LevelArg,
    /// From the last frame to the first.
    #[arg(long)]
    pub reverse: bool,
    /// Times the recorded pace.
    #[arg(long, default_value_t = 1.0, value_parser = factor)]
    pub speed: f64,
    /// Begin again at the end, until stopped.
    #[arg(long = "loop")]
    pub repeat: bool,
    /// Show no picture, print what was played as one JSON object.
    #[arg(long)]
    pub stats: bool,
}

/// `check`.
#[derive(Debug, Args)]
pub struct CheckArgs {
    /// The recording.
    pub file: PathBuf,
    /// Checksums and order only; decode nothing.
    #[arg(long)]
    pub quick: bool,
    /// As one JSON object.
    #[arg(long)]
    pub json: bool,
}

/// `repair`.
#[derive(Debug, Args)]
pub struct RepairArgs {
    /// The cut or damaged recording; it stays as it is.
    pub file: PathBuf,
    /// The new file.
    #[arg(short, long, value_name = "FILE")]
    pub output: PathBuf,
    /// Replace an output file that exists.
    #[arg(long)]
    pub overwrite: bool,
    /// Say what was kept and lost as one JSON object.
    #[arg(long)]
    pub json: bool,
}
