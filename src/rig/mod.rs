//! Several cameras that look at one scene: who they are, and where they stand.
//!
//! A rig is a TOML file, one table `[[camera]]` for each camera:
//!
//! ```toml
//! [[camera]]
//! name = "left"                        # letters, digits, - and _; topics are left/saint, ...
//! device = "123622270300"              # anything --device takes
//! intrinsics = "left.yaml"             # as --intrinsics; file names count from the rig file
//! translation = [0.0, 0.0, 0.0]        # the camera in the common frame, metres
//! rotation = [0.0, 0.0, 0.0, 1.0]      # quaternion x, y, z, w
//!
//! [[camera]]
//! name = "right"
//! device = "bus:usb-0000:00:14.0-2"
//! matrix = [[0.0, 0.0, 1.0, 1.2], [0.0, 1.0, 0.0, 0.0], [-1.0, 0.0, 0.0, 0.5], [0.0, 0.0, 0.0, 1.0]]
//! color_device = "/dev/video6"
//! color_camera = "right_color.toml"    # see ColorCamera
//! ```
//!
//! Poses lead from the camera's frame into the common one: [`Pose`].

mod color_camera;
mod pose;

pub use color_camera::ColorCamera;
pub use pose::Pose;

use serde::Deserialize;
use std::fs;
use std::path::{Path, PathBuf};

/// Cameras in one rig at most: each has threads and buffers of its own.
pub const MAX_CAMERAS: usize = 16;

/// Note of a recording's camera that holds its [`Pose`] as JSON.
pub const POSE_NOTE: &str = "pose";
/// Note of a recording's camera that holds its [`ColorCamera`] as JSON.
pub const COLOR_CAMERA_NOTE: &str = "color_camera";

/// One camera of a rig.
#[derive(Clone, Debug, PartialEq)]
pub struct RigCamera {
    /// Its name, which starts its topics.
    pub name: String,
    /// What `--device` takes.
    pub device: String,
    /// Where it stands; `None` where the file does not say.
    pub pose: Option<Pose>,
    /// What `--intrinsics` takes; a file name is complete.
    pub intrinsics: Option<String>,
    /// Metres per depth integer.
    pub depth_unit_m: Option<f64>,
    /// Image size.
    pub size: Option<(u32, u32)>,
    /// Frames per second.
    pub fps: Option<u32>,
    /// What `--pixel-format` takes.
    pub pixel_format: Option<String>,
    /// What `--color-device` takes.
    pub color_device: Option<String>,
    /// The colour camera's lens and place.
    pub color_camera: Option<ColorCamera>,
}

/// Cameras with names that differ.
#[derive(Clone, Debug, PartialEq)]
pub struct Rig {
    /// In the order of the file.
    pub cameras: Vec<RigCamera>,
}

/// Why a rig cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum RigError {
    /// The file cannot be read: bad input.
    #[error("cannot read {}: {source}; name a file that exists and may be read", .path.display())]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The file says something wrong: bad input.
    #[error("{}: {what}", .path.display())]
    Wrong {
        /// The file.
        path: PathBuf,
        /// What and where.
        what: String,
    },
}

/// The file as it is written.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RigFile {
    camera: Vec<CameraTable>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct CameraTable {
    name: String,
    device: String,
    matrix: Option<[[f64; 4]; 4]>,
    translation: Option<[f64; 3]>,
    rotation: Option<[f64; 4]>,
    intrinsics: Option<String>,
    /// Millimetres, as sensors state it.
    depth_unit_mm: Option<f64>,
    size: Option<[u32; 2]>,
    fps: Option<u32>,
    pixel_format: Option<String>,
    color_device: Option<String>,
    color_camera: Option<PathBuf>,
}

impl Rig {
    /// Reads a rig file.
    ///
    /// # Errors
    /// [`RigError`] names the file, the line where TOML is wrong, or the camera.
    pub fn read(path: &Path) -> Result<Self, RigError> {
        let text = read_text(path)?;
        let file: RigFile = toml::from_str(&text).map_err(|e| wrong(path, e.to_string()))?;
        let folder = path.parent().unwrap_or(Path::new(""));
        let mut cameras: Vec<RigCamera> = Vec::new();
        for table in file.camera {
            let name = table.name.clone();
            check_name(&name).map_err(|what| wrong(path, what))?;
            if cameras.iter().any(|camera| camera.name == name) {
                return Err(wrong(
                    path,
                    format!("two cameras are called `{name}`; rename one"),
                ));
            }
            cameras.push(camera(table, folder, path)?);
        }
        let rig = Self { cameras };
        rig.check().map_err(|what| wrong(path, what))?;
        Ok(rig)
    }

    /// Cameras named `cam0`, `cam1`, … without poses, as several `--device` give them.
    ///
    /// # Errors
    /// Too many.
    pub fn of_devices(devices: &[String]) -> Result<Self, String> {
        let camera = |(number, device): (usize, &String)| RigCamera {
            name: format!("cam{number}"),
            device: device.clone(),
            pose: None,
            intrinsics: None,
            depth_unit_m: None,
            size: None,
            fps: None,
            pixel_format: None,
            color_device: None,
            color_camera: None,
        };
        let rig = Self {
            cameras: devices.iter().enumerate().map(camera).collect(),
        };
        rig.check()?;
        Ok(rig)
    }

    fn check(&self) -> Result<(), String> {
        match self.cameras.len() {
            0 => Err("no camera; add a table [[camera]]".into()),
            1..=MAX_CAMERAS => Ok(()),
            more => Err(format!(
                "{more} cameras, at most {MAX_CAMERAS} are recorded at once"
            )),
        }
    }
}

fn camera(table: CameraTable, folder: &Path, path: &Path) -> Result<RigCamera, RigError> {
    let of_camera = |what: String| wrong(path, format!("camera `{}`: {what}", table.name));
    let pose = read_pose(table.matrix, table.translation, table.rotation).map_err(of_camera)?;
    let unit_mm = table.depth_unit_mm;
    if let Some(unit) = unit_mm.filter(|unit| !(unit.is_finite() && *unit > 0.0)) {
        return Err(of_camera(format!(
            "depth_unit_mm is {unit}, not a positive number"
        )));
    }
    let color_camera = match &table.color_camera {
        Some(file) => Some(ColorCamera::read(&folder.join(file))?),
        None => None,
    };
    Ok(RigCamera {
        pose,
        // four numbers are intrinsics themselves, anything else is a file's name
        intrinsics: table
            .intrinsics
            .map(|text| match text.matches(',').count() {
                3 => text,
                _ => folder.join(text).display().to_string(),
            }),
        depth_unit_m: unit_mm.map(|unit| unit * 1e-3),
        size: table.size.map(|[width, height]| (width, height)),
        fps: table.fps,
        pixel_format: table.pixel_format,
        color_device: table.color_device,
        color_camera,
        name: table.name,
        device: table.device,
    })
}

/// A pose in either of its two forms.
fn read_pose(
    matrix: Option<[[f64; 4]; 4]>,
    translation: Option<[f64; 3]>,
    rotation: Option<[f64; 4]>,
) -> Result<Option<Pose>, String> {
    match (matrix, translation, rotation) {
        (None, None, None) => Ok(None),
        (Some(rows), None, None) => Pose::from_rows(rows).map(Some),
        (Some(_), ..) => Err("matrix and translation or rotation: give one of the two".into()),
        (None, translation, rotation) => {
            let rotation = rotation.unwrap_or([0.0, 0.0, 0.0, 1.0]);
            Pose::from_quaternion(translation.unwrap_or_default(), rotation).map(Some)
        }
    }
}

fn check_name(name: &str) -> Result<(), String> {
    let fits = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
    if (1..=64).contains(&name.len()) && name.chars().all(fits) {
        return Ok(());
    }
    Err(format!(
        "`{name}` is no camera name; use 1 to 64 letters, digits, - and _"
    ))
}

fn read_text(path: &Path) -> Result<String, RigError> {
    fs::read_to_string(path).map_err(|source| RigError::Unreadable {
        path: path.to_owned(),
        source,
    })
}

fn wrong(path: &Path, what: String) -> RigError {
    RigError::Wrong {
        path: path.to_owned(),
        what,
    }
}

#[cfg(test)]
mod tests;
