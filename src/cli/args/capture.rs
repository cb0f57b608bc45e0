//! Arguments of the commands that take frames from a camera: live capture and `record`.

use super::{EngineArgs, MapArgs, RunArgs, StreamArgs};
use crate::cli::values::{Length, duration_or_zero, length, length_or_zero, size};
use clap::{Args, ValueEnum};
use std::path::PathBuf;
use std::time::Duration;

/// Live capture.
#[derive(Clone, Debug, Args)]
pub struct LiveArgs {
    /// Depth camera: /dev/videoN, N, a serial number, a bus id (`devices` lists them), auto, or
    /// synthetic:SCENE[,key=value...]. Given more than once, all are recorded together.
    #[arg(short, long, value_name = "DEVICE")]
    pub device: Vec<String>,
    /// Record the cameras of this TOML file together: names, devices, poses.
    #[arg(long, value_name = "FILE",
        conflicts_with_all = ["device", "intrinsics", "depth_unit", "color_device"])]
    pub rig: Option<PathBuf>,
    /// Lens of the colour camera and its pose in the depth camera's frame (TOML): makes `export
    /// --to ply` give points their colours.
    #[arg(long, value_name = "FILE", requires = "color_device")]
    pub color_camera: Option<PathBuf>,
    #[command(flatten)]
    pub capture: CaptureArgs,
    #[command(flatten)]
    pub engine: EngineArgs,
    #[command(flatten)]
    pub map: MapArgs,
    #[command(flatten)]
    pub stream: StreamArgs,
}

/// What a camera is asked for.
#[derive(Clone, Debug, Args)]
pub struct CaptureArgs {
    /// Colour camera recorded beside it, named as --device. When it fails, depth goes on.
    #[arg(long, value_name = "DEVICE")]
    pub color_device: Option<String>,
    /// Image size to ask the camera for.
    #[arg(short, long, value_name = "WxH", value_parser = size)]
    pub size: Option<(u32, u32)>,
    /// Frames per second to ask the camera for.
    #[arg(long)]
    pub fps: Option<u32>,
    /// Format to ask the camera for: Z16, Y16, Y14, Y12, Y10, Y10B.
    #[arg(long, value_name = "FOURCC")]
    pub pixel_format: Option<String>,
    /// End with exit code 3 when an unplugged, silent or broken camera has sent nothing for this
    /// long (0 ends at an unplug). Without it the camera is waited for, whatever node it comes
    /// back as.
    #[arg(long, value_name = "TIME", value_parser = duration_or_zero)]
    pub give_up: Option<Duration>,
    /// Wait for an unplugged camera to come back: the default.
    #[arg(long, hide = true, conflicts_with = "give_up")]
    pub reconnect: bool,
    #[command(flatten)]
    pub camera: CameraArgs,
}

/// `record`.
#[derive(Debug, Args)]
pub struct RecordArgs {
    /// Depth camera: /dev/videoN, N, a serial number, a bus id (`devices` lists them), auto, or
    /// synthetic:SCENE[,key=value...].
    #[arg(short, long, value_name = "DEVICE")]
    pub device: String,
    /// File (mcap; `-` is standard output) or folder (png16, exr) to write.
    #[arg(short, long, value_name = "PATH")]
    pub output: PathBuf,
    /// Form of the output. mcap is one file, fast enough for any camera, and is read by ROS 2
    /// tools; png16 and exr are a file for each frame.
    #[arg(long, value_enum, default_value_t = RecordArg::Mcap)]
    pub to: RecordArg,
    #[command(flatten)]
    pub capture: CaptureArgs,
    #[command(flatten)]
    pub run: RunArgs,
}

/// Form of a raw capture.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum RecordArg {
    /// RVL images in an MCAP file.
    #[default]
    Mcap,
    /// 16-bit PNG files, camera.json and timestamps.txt.
    Png16,
    /// EXR files, metres, camera and time inside.
    Exr,
}

/// What the user knows of the camera.
#[derive(Clone, Debug, Default, Args)]
#[command(next_help_heading = "Camera")]
pub struct CameraArgs {
    /// Metres per depth integer, as a length (1mm, 0.1mm).
    #[arg(long, value_name = "LENGTH", value_parser = length)]
    pub depth_unit: Option<Length>,
    /// Nearer depths are not measurements.
    #[arg(long, value_name = "LENGTH", value_parser = length_or_zero)]
    pub depth_min: Option<Length>,
    /// Farther depths are not measurements.
    #[arg(long, value_name = "LENGTH", value_parser = length)]
    pub depth_max: Option<Length>,
    /// Depth integers that mean "no measurement", beside 0.
    #[arg(long, value_name = "CODES", value_delimiter = ',')]
    pub invalid: Option<Vec<u16>>,
    /// Intrinsics: a file (camera.json, ROS or OpenCV YAML, Open3D or RealSense JSON) or fx,fy,cx,cy.
    #[arg(long, value_name = "FILE|fx,fy,cx,cy", allow_hyphen_values = true)]
    pub intrinsics: Option<String>,
}
