//! The arguments as they are typed.

use super::values::{Length, bitrate, duration, factor, length, split};
use clap::{Args, Parser, Subcommand, ValueEnum};
use clap_complete::Shell;
use saint_live::fit::contact_distance::ContactDistance;
use saint_live::recording::Split;
use std::path::PathBuf;
use std::time::Duration;

mod capture;
mod clouds;
mod line;
mod recording;

pub use capture::{CameraArgs, CaptureArgs, LiveArgs, RecordArg, RecordArgs};
pub use clouds::{CloudMapArg, CloudSchemeArg, ExperimentArgs, ExperimentName, ModelArgs};
pub use recording::{CheckArgs, PlayArgs, RepairArgs};

const AFTER_HELP: &str = "\
Exit codes: 0 done (also after Ctrl-C, with the file complete), 1 failure, 2 usage, 3 device, \
4 bad or damaged input, 5 output failed (what was written is valid), 6 budget missed under \
--strict, 130 second Ctrl-C.

Examples:
  saint-live --device /dev/video0 -o scene.mcap     capture until Ctrl-C
  saint-live --device synthetic:room -n 300         no camera needed
  saint-live replay recordings/static_room -o x.mcap --max-error 5mm
  saint-live export x.mcap --to ply -o frames/
  saint-live model kidney.ply --unit mm --contact-distance 1mm -o kidney.mcap";

/// Turns a live depth camera into a stream of spheres and contact maps.
#[derive(Debug, Parser)]
#[command(name = "saint-live", version, after_help = AFTER_HELP)]
#[command(arg_required_else_help = true)]
pub struct Arguments {
    /// What to do; without one, a camera is captured.
    #[command(subcommand)]
    pub command: Option<Command>,
    #[command(flatten)]
    pub live: LiveArgs,
    /// Say only what went wrong.
    #[arg(short, long, global = true, conflicts_with = "verbose")]
    pub quiet: bool,
    /// Say more; twice for even more.
    #[arg(short, long, global = true, action = clap::ArgAction::Count)]
    pub verbose: u8,
}

/// The commands beside live capture.
#[derive(Debug, Subcommand)]
#[allow(clippy::large_enum_variant)] // parsed once
pub enum Command {
    /// List the cameras of this machine.
    Devices(DevicesArgs),
    /// Model recorded depth frames: a folder of images, a recording, another program's file.
    Replay(ReplayArgs),
    /// Capture a camera's raw depth, lossless and unmodelled, to replay it later.
    Record(RecordArgs),
    /// Play a recording in the terminal, each sphere in its colour.
    Play(PlayArgs),
    /// Write the frames of a recording as files other programs read.
    Export(ExportArgs),
    /// Say what is in a recording.
    Info(InfoArgs),
    /// Look for damage in a recording: checksums, order, gaps, every frame decoded.
    Check(CheckArgs),
    /// Write what is whole in a cut or damaged recording to a new file.
    Repair(RepairArgs),
    /// Measure quality, size and time on recorded frames held in memory.
    Bench(BenchArgs),
    /// Measure a claim of the paper: tables on standard output, a curve with -o.
    Experiment(ExperimentArgs),
    /// Write a recording of a synthetic scene (EXR folder).
    Synthesize(SynthesizeArgs),
    /// Model static clouds of points: objects, or a scene of several.
    Model(ModelArgs),
    /// Print a completion script for a shell.
    Completions {
        /// The shell.
        shell: Shell,
    },
}

/// Spheres, contact map and payload.
#[derive(Clone, Debug, Args)]
#[command(next_help_heading = "Model and payload")]
pub struct EngineArgs {
    /// Largest depth error of any pixel in the output.
    #[arg(long, value_name = "LENGTH", value_parser = length, conflicts_with = "lossless")]
    pub max_error: Option<Length>,
    /// Give every depth integer back exactly.
    #[arg(long)]
    pub lossless: bool,
    /// 1 to 100: scales the contact distance, 50 is the usual one, 62 about half, 38 about twice.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u8).range(1..=100),
        conflicts_with_all = ["contact_distance", "max_error", "lossless", "bitrate"])]
    pub quality: Option<u8>,
    /// Bits per second to keep to, by scaling the contact distance once a key-frame interval: 2M, 800k.
    #[arg(long, value_name = "RATE", value_parser = bitrate,
        conflicts_with_all = ["max_error", "lossless"])]
    pub bitrate: Option<f64>,
    /// `usual` saves 2 to 4 % of the bits for a quarter more time, 4 to 7 % without loss for twice the
    /// time; `max` looks for fewer bits in several ways, some six times as long: to encode recordings
    /// anew.
    #[arg(long, value_enum, default_value_t)]
    pub effort: EffortArg,
    /// Smooth the mask of measured pixels where it is noise. Few pixels are lost or invented along
    /// edges; the lost ones are counted.
    #[arg(long, conflicts_with = "lossless")]
    pub smooth_mask: bool,
    /// How far from its sphere a point may lie: 5mm, or 12mm+4e-3z2 (the default: the larger of
    /// 12 mm and 0.004 times the squared depth).
    #[arg(long, value_name = "LENGTH[+Kz2]")]
    pub contact_distance: Option<ContactDistance>,
    /// How spheres are found. `live` starts from the frame before and keeps to the budget; the
    /// paper's own two fit every frame from nothing, which takes seconds, whatever the budget.
    #[arg(long, value_enum, default_value_t = SchemeArg::Live)]
    pub scheme: SchemeArg,
    /// Distance of neighbouring cell centres.
    #[arg(long, value_name = "LENGTH", value_parser = length)]
    pub cube_size: Option<Length>,
    /// Most spheres fitted in one cell, with `--scheme progressive` [default: 25].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
    pub spheres_per_cube: Option<u16>,
    /// Seed of the draws, with `--scheme random`: same seed, same output [default: 0].
    #[arg(long, value_name = "N")]
    pub seed: Option<u64>,
    /// Lattice of the cells.
    #[arg(long, value_enum)]
    pub packing: Option<PackingArg>,
    /// Most spheres at a time.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=65000))]
    pub max_spheres: Option<u16>,
    /// A payload that decodes alone at least every N frames [default: 30].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub keyframe_every: Option<u32>,
    /// Threads; 1 does everything in one, with the same output.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub threads: Option<u16>,
}

/// How long the encoder looks for fewer bits.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum EffortArg {
    /// Once through each frame, for speed.
    #[default]
    Live,
    /// Once through each frame, with mixed contexts.
    Usual,
    /// Each frame in several ways.
    Max,
}

/// How spheres are found.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum SchemeArg {
    /// Progressive, from moments of 8x8 pixels, warm from the frame before.
    #[default]
    Live,
    /// The paper's: cell by cell, small spheres to large.
    Progressive,
    /// The paper's: through randomly drawn points, the best kept.
    Random,
}

/// Contact map of the payload.
#[derive(Clone, Copy, Debug, Default, Args)]
#[command(next_help_heading = "Model and payload")]
pub struct MapArgs {
    /// Grid of the contact map: the sensor's (depth images come back, every measurement), or
    /// each sphere's own latitude and longitude as in the paper (points come back, those of no
    /// sphere are lost).
    #[arg(long, value_enum, default_value_t = DomainArg::Sensor)]
    pub contact_map: DomainArg,
    /// Side of a cell of the polar map on the sphere [default: half the contact distance].
    #[arg(long, value_name = "LENGTH", value_parser = length)]
    pub map_resolution: Option<Length>,
}

/// Grid of the contact map.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum DomainArg {
    /// The camera's pixels.
    #[default]
    Sensor,
    /// Latitude and longitude on each sphere.
    Polar,
}

/// Lattice of the cells.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum PackingArg {
    /// Face-centred cubic: the densest.
    Hex,
    /// Plain cubes.
    Cubic,
}

/// Output, limits, budget, statistics.
#[derive(Clone, Debug, Args)]
#[command(next_help_heading = "Stream")]
pub struct StreamArgs {
    /// Write a recording (MCAP) to this file, or to standard output with `-`.
    #[arg(short, long, value_name = "FILE|-")]
    pub output: Option<PathBuf>,
    #[command(flatten)]
    pub run: RunArgs,
    /// Age a frame may have when it leaves; one frame period by default. A replay has no budget
    /// unless one is given here or by --on-late, or it is paced by --realtime.
    #[arg(long, value_name = "TIME", value_parser = duration)]
    pub budget: Option<Duration>,
    /// What to do with a frame that would be late.
    #[arg(long, value_enum)]
    pub on_late: Option<LateArg>,
    /// End with exit code 6 where the budget was missed: a frame late, degraded or dropped for it.
    #[arg(long)]
    pub strict: bool,
    /// Ask the system to run the stages' threads before other programs: the round-robin real-time
    /// class, else a better nice value, else as they are (--stats json says which). Not with one thread.
    #[arg(long)]
    pub realtime_priority: bool,
}

/// Output, limits and statistics of every stream, modelled or raw.
#[derive(Clone, Debug, Args)]
#[command(next_help_heading = "Stream")]
pub struct RunArgs {
    /// Replace an output that exists.
    #[arg(long)]
    pub overwrite: bool,
    /// Write numbered parts (scene-001.mcap, ...) of this size or length, each of which plays
    /// alone: 4GB, 500MB, 10min. A part ends before a key frame.
    #[arg(long, value_name = "SIZE|TIME", value_parser = split, requires = "output")]
    pub split: Option<Split>,
    /// When bytes must have reached the disk: `end` waits once, `chunk` twice a second, so that a
    /// power cut takes no more than the last half second.
    #[arg(long, value_enum, default_value_t = SyncArg::End, requires = "output")]
    pub sync: SyncArg,
    /// Stop after taking this many frames.
    #[arg(short = 'n', long, value_name = "N")]
    pub frames: Option<u64>,
    /// Stop after this much stream time.
    #[arg(short = 't', long, value_name = "TIME", value_parser = duration)]
    pub duration: Option<Duration>,
    /// Print statistics on standard output each second and at the end.
    #[arg(long, value_enum, value_name = "FORM")]
    pub stats: Option<StatsArg>,
    /// Write a timeline (Chrome trace events; open it in Perfetto).
    #[arg(long, value_name = "FILE")]
    pub trace: Option<PathBuf>,
}

/// When bytes must have reached the disk.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum SyncArg {
    /// When the file is complete.
    #[default]
    End,
    /// With each chunk of half a second.
    Chunk,
}

/// What to do with a frame that would be late.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum LateArg {
    /// Model it less well.
    Degrade,
    /// Give it up and count it.
    Drop,
    /// Take the time it needs.
    Wait,
}

/// Form of the statistics.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum StatsArg {
    /// One object per line.
    Json,
    /// One line per second under a header.
    Csv,
    /// One readable line per second.
    Text,
}

/// Which frames of an input.
#[derive(Clone, Copy, Debug, Default, Args)]
pub struct RangeArgs {
    /// First frame, counted from 0.
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub from: u64,
    /// The frame after the last.
    #[arg(long, value_name = "N")]
    pub to: Option<u64>,
}

/// `replay`.
#[derive(Debug, Args)]
pub struct ReplayArgs {
    /// Folder, file, printf pattern (depth_%06d.png), recording, or another program's file:
    /// RealSense or ROS .bag, ROS 2 .mcap, Azure Kinect .mkv, ScanNet .sens.
    pub input: PathBuf,
    #[command(flatten)]
    pub range: RangeArgs,
    /// Begin again at the end, until stopped.
    #[arg(long = "loop")]
    pub repeat: bool,
    /// Pace frames by their time stamps and drop like a live camera.
    #[arg(long)]
    pub realtime: bool,
    /// Frames per second of an input that does not say.
    #[arg(long, value_parser = factor)]
    pub fps: Option<f64>,
    /// What the values of EXR files measure.
    #[arg(long, value_enum, default_value_t = ExrDepthArg::Planar)]
    pub exr_depth: ExrDepthArg,
    /// Topic of the depth images in a ROS bag or MCAP file that has several.
    #[arg(long, value_name = "TOPIC")]
    pub topic: Option<String>,
    /// Carry the colour images beside the depth along, bytes untouched, as a channel of their own.
    #[arg(long)]
    pub color: bool,
    /// Lens of the colour camera and its pose in the depth camera's frame (TOML), recorded for
    /// `export --to ply`.
    #[arg(long, value_name = "FILE", requires = "color")]
    pub color_camera: Option<PathBuf>,
    #[command(flatten)]
    pub camera: CameraArgs,
    #[command(flatten)]
    pub engine: EngineArgs,
    #[command(flatten)]
    pub map: MapArgs,
    #[command(flatten)]
    pub stream: StreamArgs,
}

/// What the values of EXR files measure.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum ExrDepthArg {
    /// Metres along the optical axis.
    #[default]
    Planar,
    /// Metres along the pixel's ray.
    Ray,
    /// One over metres.
    Inverse,
}

/// `export`.
#[derive(Debug, Args)]
pub struct ExportArgs {
    /// The recording or model.
    pub file: PathBuf,
    /// Form of the files.
    #[arg(long, value_enum)]
    pub to: ExportArg,
    /// How much of each payload is decoded.
    #[arg(long, value_enum, default_value_t)]
    pub level: LevelArg,
    /// Folder for one file per frame, or a file name for a single frame.
    #[arg(short, long, value_name = "PATH")]
    pub output: PathBuf,
    /// First frame, counted from 0.
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub from: u64,
    /// Frames to write at most.
    #[arg(short = 'n', long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    pub frames: Option<u64>,
    /// Replace files that exist.
    #[arg(long)]
    pub overwrite: bool,
    /// The camera to export, of a recording of several [default: the first].
    #[arg(long, value_name = "NAME")]
    pub camera: Option<String>,
    /// All cameras in their common frame: one file per frame of the first camera, with the frame
    /// of every other that is nearest in time (ply and spheres).
    #[arg(long, conflicts_with = "camera")]
    pub merge: bool,
    /// Of a model: the scale made for this many spheres [default: the finest].
    #[arg(long, value_name = "N")]
    pub scale: Option<u32>,
    /// Of a model: this object only.
    #[arg(long, value_name = "NAME")]
    pub object: Option<String>,
}

/// How much of a payload is decoded.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum LevelArg {
    /// One sphere for each block of 8x8 pixels.
    Blocks,
    /// Each pixel on its sphere; pixels of none are missing.
    Spheres,
    /// All: each pixel within its bound.
    #[default]
    Full,
}

/// Form of exported files.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum ExportArg {
    /// Points with their sphere's number and colour.
    Ply,
    /// The spheres: centre and radius.
    Spheres,
    /// Points for PCL.
    Pcd,
    /// Depth in metres, with intrinsics and time.
    Exr,
    /// Picture: each pixel in its sphere's colour.
    Png,
    /// 16-bit depth with camera.json.
    Png16,
    /// NumPy arrays: points, normals and SAINT features, for training loops.
    Npz,
}

/// `info`.
#[derive(Debug, Args)]
pub struct InfoArgs {
    /// The recording.
    pub file: PathBuf,
    /// As one JSON object.
    #[arg(long)]
    pub json: bool,
}

/// `devices`.
#[derive(Debug, Args)]
pub struct DevicesArgs {
    /// As one JSON object.
    #[arg(long)]
    pub json: bool,
}

/// `bench`.
#[derive(Debug, Args)]
pub struct BenchArgs {
    /// What `replay` takes.
    pub input: PathBuf,
    /// As one JSON object.
    #[arg(long)]
    pub json: bool,
    /// Frames to measure; the input is repeated where it is shorter.
    #[arg(short = 'n', long, value_name = "N", default_value_t = 100, value_parser = clap::value_parser!(u64).range(1..))]
    pub frames: u64,
    #[command(flatten)]
    pub camera: CameraArgs,
    #[command(flatten)]
    pub engine: EngineArgs,
}

/// `synthesize`.
#[derive(Debug, Args)]
pub struct SynthesizeArgs {
    /// SCENE[,key=value...], as in --device synthetic:SCENE.
    pub scene: String,
    /// Folder to write.
    #[arg(short, long, value_name = "DIR")]
    pub output: PathBuf,
    /// Number of frames.
    #[arg(short = 'n', long, value_name = "N", default_value_t = 30)]
    pub frames: u64,
    /// Write into a folder that is not empty.
    #[arg(long)]
    pub overwrite: bool,
}
