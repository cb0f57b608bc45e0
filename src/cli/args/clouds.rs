//! The arguments of static clouds and the paper's experiments.

use super::super::values::{Length, MapResolution, factor, length};
use super::{CameraArgs, PackingArg};
use clap::{Args, ValueEnum};
use saint_live::cloud::LengthUnit;
use saint_live::fit::contact_distance::ContactDistance;
use std::path::PathBuf;

/// `model`.
#[derive(Debug, Args)]
pub struct ModelArgs {
    /// Clouds: PLY, PCD, OBJ, XYZ or NumPy files. Each is one object of the scene, named like
    /// its file.
    #[arg(required = true, value_name = "CLOUD")]
    pub clouds: Vec<PathBuf>,
    /// Write the model (MCAP) to this file, or to standard output with `-`.
    #[arg(short, long, value_name = "FILE|-")]
    pub output: Option<PathBuf>,
    /// Replace an output file that exists.
    #[arg(long)]
    pub overwrite: bool,
    /// Unit of the coordinates: um, mm, cm, m, km, in, ft [default: what the file says, or m].
    #[arg(long)]
    pub unit: Option<LengthUnit>,
    /// How spheres are found: through random points, the best kept; or cell by cell.
    #[arg(long, value_enum, default_value_t = CloudSchemeArg::Random)]
    pub scheme: CloudSchemeArg,
    /// Most spheres of an object.
    #[arg(long, value_name = "N", default_value_t = 65_000, value_parser = clap::value_parser!(u32).range(1..=65_000))]
    pub max_spheres: u32,
    /// Numbers of spheres, coarse to fine: one model at each, with the smallest contact distance
    /// at which so many spheres explain 99.9 % of the points.
    #[arg(long, value_name = "N,N,...", value_delimiter = ',', conflicts_with = "max_spheres", value_parser = clap::value_parser!(u32).range(1..=65_000))]
    pub scales: Vec<u32>,
    /// How far from its sphere a point may lie: 1mm [default: half a percent of the object's
    /// diagonal]. With --scales no scale goes below it [default: none].
    #[arg(long, value_name = "LENGTH[+Kz2]")]
    pub contact_distance: Option<ContactDistance>,
    /// Contact map: one that keeps every claim, or one with a single sphere number in each
    /// cell, as in the paper, where spheres displace each other.
    #[arg(long, value_enum, default_value_t = CloudMapArg::Claims)]
    pub contact_map: CloudMapArg,
    /// Cells of the contact map. Claims: side of a cell, a length with its unit [default: half
    /// the contact distance]. Merged: number of cells over 180 degrees [default: 1024].
    #[arg(long, value_name = "LENGTH|N")]
    pub map_resolution: Option<MapResolution>,
    /// Distance of neighbouring cell centres, with `--scheme progressive` [default: an eighth of
    /// the object's diagonal].
    #[arg(long, value_name = "LENGTH", value_parser = length)]
    pub cube_size: Option<Length>,
    /// Most spheres fitted in one cell, with `--scheme progressive`.
    #[arg(long, value_name = "N", default_value_t = 25, value_parser = clap::value_parser!(u16).range(1..))]
    pub spheres_per_cube: u16,
    /// Lattice of the cells, with `--scheme progressive`.
    #[arg(long, value_enum, default_value_t = PackingArg::Hex)]
    pub packing: PackingArg,
    /// Seed of the draws, with `--scheme random`: same seed, same output.
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub seed: u64,
    /// Threads; any number gives the same output.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub threads: Option<u16>,
    /// Print what was done as one JSON object on standard output.
    #[arg(long)]
    pub json: bool,
}

/// The paper's schemes for a whole cloud.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum CloudSchemeArg {
    /// Through randomly drawn points, the best kept: for objects.
    Random,
    /// Cell by cell, small spheres to large: for scenes.
    Progressive,
}

/// Contact map of a cloud.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum CloudMapArg {
    /// Every sphere keeps its cells.
    Claims,
    /// One sparse map of sphere numbers for all spheres.
    Merged,
}

/// `experiment`.
#[derive(Debug, Args)]
pub struct ExperimentArgs {
    /// Which experiment.
    #[arg(value_enum)]
    pub name: ExperimentName,
    /// Clouds (PLY, PCD, OBJ, XYZ, NumPy), and whatever `replay` takes; without any, synthetic objects and frames.
    pub data: Vec<PathBuf>,
    /// Write the curve to this file (SVG).
    #[arg(short, long, value_name = "FILE.svg")]
    pub output: Option<PathBuf>,
    /// Replace an output file that exists.
    #[arg(long)]
    pub overwrite: bool,
    /// Print one JSON object instead of tables.
    #[arg(long)]
    pub json: bool,
    /// Repetitions, each with a seed of its own.
    #[arg(long, value_name = "N", default_value_t = 5, value_parser = clap::value_parser!(u64).range(1..=1000))]
    pub seeds: u64,
    /// Most points of a cloud: of more, every k-th is taken.
    #[arg(long, value_name = "N", default_value_t = 20_000)]
    pub max_points: usize,
    /// Frames taken of a sequence, evenly spread [default: 1; loss: 12].
    #[arg(short = 'n', long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..=1000))]
    pub frames: Option<u64>,
    /// How far from its sphere a point may lie [default: a 500th of a cloud's diagonal; of depth
    /// frames as for live capture].
    #[arg(long, value_name = "LENGTH[+Kz2]")]
    pub contact_distance: Option<ContactDistance>,
    /// Chamfer distance at which sizes are compared, per cent of the diagonal [default: 0.1].
    #[arg(long, value_name = "PERCENT", value_parser = factor)]
    pub chamfer: Option<f64>,
    /// Unit of the clouds' coordinates: um, mm, cm, m, km, in, ft [default: what the file says,
    /// or m].
    #[arg(long)]
    pub unit: Option<LengthUnit>,
    #[command(flatten)]
    pub camera: CameraArgs,
}

/// The experiments.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum ExperimentName {
    /// Models of 5 to 250 spheres (Fig. 5, 7).
    MultiScale,
    /// Error against the contact map's resolution (Fig. 15).
    MapResolution,
    /// Bytes beside gzip, zstd, Draco (Fig. 8-10).
    Storage,
    /// Hexagonal against cubic packing (Fig. 11).
    Packing,
    /// Random against progressive fitting (Fig. 12-14).
    Schemes,
    /// Training with the SAINT loss, and its control (Fig. 18).
    Loss,
    /// Telling objects apart by SAINT features (Fig. 16, 17).
    Features,
}
