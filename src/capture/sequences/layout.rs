//! What an input is: which files, in which order, with which times, colour and sidecar.

use super::numbering::{self, Pattern, time_name};
use super::timestamps::{Timestamps, frame_time};
use super::{ColorFile, FrameFile, camera_json, input, seven_scenes, tum};
use crate::capture::CaptureError;
use crate::intrinsics::Calibration;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

const WHAT_TO_GIVE: &str =
    "give a folder of depth images, one image or a pattern like depth_%06d.exr";
/// Names of the folder of colour images beside `depth/`.
const COLOR_FOLDERS: [&str; 3] = ["colour", "color", "rgb"];

/// How the depth is stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Format {
    Png,
    Exr,
}

impl Format {
    fn of(path: &Path) -> Option<Self> {
        let extension = path.extension()?.to_str()?.to_ascii_lowercase();
        match extension.as_str() {
            "png" => Some(Self::Png),
            "exr" => Some(Self::Exr),
            _ => None,
        }
    }
}

/// A sequence before any image is opened.
#[derive(Debug)]
pub(super) struct Layout {
    /// The input as given.
    pub(super) input: PathBuf,
    pub(super) format: Format,
    /// At least one, numbers growing.
    pub(super) frames: Vec<FrameFile>,
    /// From `camera.json` beside the images.
    pub(super) sidecar: Option<Calibration>,
    /// Metres per depth integer by the layout's own convention.
    pub(super) unit_m: Option<f64>,
    /// Integers that mean "no measurement" by the layout's own convention.
    pub(super) invalid: &'static [u16],
    /// Intrinsics to suggest when there are none.
    pub(super) suggestion: &'static str,
    pub(super) name: String,
}

/// Decides what `input_path` is.
///
/// # Errors
/// [`CaptureError::Input`] when it does not exist, holds no depth images or is something else.
pub(super) fn find(input_path: &Path) -> Result<Layout, CaptureError> {
    if input_path.is_dir() {
        if input_path.join(tum::DEPTH_LIST).is_file() {
            return tum::find(input_path);
        }
        if let Some(layout) = seven_scenes::find(input_path, &files_in(input_path)?)? {
            return Ok(layout);
        }
        let inner = input_path.join("depth");
        let folder = if inner.is_dir() {
            inner.as_path()
        } else {
            input_path
        };
        let (format, files) = depth_images(folder)?;
        return numbered(input_path, folder, format, numbering::number(files));
    }
    let folder = match input_path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    };
    let name = input_path.file_name().unwrap_or_default().to_string_lossy();
    let pattern = Pattern::parse(&name).filter(|_| !input_path.exists());
    if let Some(error) = std::fs::metadata(input_path)
        .err()
        .filter(|_| pattern.is_none())
    {
        return Err(input(input_path, error.to_string(), WHAT_TO_GIVE));
    }
    let Some(format) = Format::of(input_path) else {
        return Err(input(
            input_path,
            "neither an .exr nor a .png image nor a folder",
            WHAT_TO_GIVE,
        ));
    };
    let Some(pattern) = pattern else {
        let file = vec![input_path.to_owned()];
        return numbered(input_path, folder, format, numbering::number(file));
    };
    let mut files: Vec<(u64, PathBuf)> = files_in(folder)?
        .into_iter()
        .filter_map(|path| Some((pattern.number(path.file_name()?.to_str()?)?, path)))
        .collect();
    files.sort_unstable();
    if files.is_empty() {
        let what = "no file matches the pattern";
        return Err(input(
            input_path,
            what,
            "check the folder and the number of digits",
        ));
    }
    numbered(input_path, folder, format, files)
}

/// Adds times, colour and sidecar to numbered files of `folder`.
fn numbered(
    input_path: &Path,
    folder: &Path,
    format: Format,
    files: Vec<(u64, PathBuf)>,
) -> Result<Layout, CaptureError> {
    let in_depth = folder.file_name().is_some_and(|name| name == "depth");
    let root = folder.parent().filter(|_| in_depth).unwrap_or(folder);
    let times = Timestamps::read(&root.join("timestamps.txt"))?;
    let named: Option<Vec<i64>> = files.iter().map(|(_, path)| time_name(path)).collect();
    let colors = colors(root, folder);
    let frames = files
        .into_iter()
        .enumerate()
        .map(|(position, (number, path))| {
            let by_name = || {
                let named = named.as_ref()?;
                Some(frame_time(*named.get(position)?, *named.first()?))
            };
            FrameFile {
                time: times.of(number, position).or_else(by_name),
                color: colors.get(&number).map(|path| ColorFile {
                    path: path.clone(),
                    time: None,
                }),
                number,
                path,
            }
        });
    Ok(Layout {
        input: input_path.to_owned(),
        format,
        frames: frames.collect(),
        sidecar: camera_json::find(folder)?
            .map_or_else(|| camera_json::find(root), |c| Ok(Some(c)))?,
        unit_m: None,
        invalid: &[0],
        suggestion: "",
        name: name_of(root),
    })
}

/// What a sequence in this folder is called.
pub(super) fn name_of(root: &Path) -> String {
    let name = root
        .file_name()
        .map(|name| name.to_string_lossy().into_owned());
    name.unwrap_or_else(|| "sequence".to_owned())
}

/// Visible files of a folder, in no order.
fn files_in(folder: &Path) -> Result<Vec<PathBuf>, CaptureError> {
    let failed = |error: std::io::Error| {
        input(
            folder,
            error.to_string(),
            "check the path and its permissions",
        )
    };
    let mut files = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(failed)? {
        let entry = entry.map_err(failed)?;
        let hidden = entry.file_name().as_encoded_bytes().starts_with(b".");
        if !hidden && !entry.path().is_dir() {
            files.push(entry.path());
        }
    }
    Ok(files)
}

/// The depth images in a folder. EXR wins over PNG (pictures of the same frames), and names with
/// "depth" win over names without (colour in the same folder).
fn depth_images(folder: &Path) -> Result<(Format, Vec<PathBuf>), CaptureError> {
    let files = files_in(folder)?;
    let of = |format| -> Vec<PathBuf> {
        let images = files.iter().filter(|path| Format::of(path) == Some(format));
        images.cloned().collect()
    };
    let (exr, png) = (of(Format::Exr), of(Format::Png));
    let (format, mut images) = match (exr.is_empty(), png.is_empty()) {
        (true, true) => {
            return Err(input(
                folder,
                format!("none of its {} files is an .exr or .png image", files.len()),
                "give the folder that holds the depth images, or their parent",
            ));
        }
        (true, false) => (Format::Png, png),
        (false, no_png) => {
            if !no_png {
                tracing::warn!(
                    "{}: reading the {} EXR images, not the {} PNG images",
                    folder.display(),
                    exr.len(),
                    png.len()
                );
            }
            (Format::Exr, exr)
        }
    };
    let says_depth = |path: &PathBuf| {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        name.to_ascii_lowercase().contains("depth")
    };
    if images.iter().any(says_depth) {
        images.retain(says_depth);
    }
    Ok((format, images))
}

/// Colour images beside the depth, by number.
fn colors(root: &Path, depth_folder: &Path) -> BTreeMap<u64, PathBuf> {
    let folder = COLOR_FOLDERS
        .iter()
        .map(|name| root.join(name))
        .find(|folder| folder.is_dir() && folder != depth_folder);
    let mut files = folder
        .and_then(|folder| files_in(&folder).ok())
        .unwrap_or_default();
    files.retain(|path| {
        let extension = path.extension().unwrap_or_default().to_ascii_lowercase();
        ["png", "jpg", "jpeg"]
            .iter()
            .any(|known| extension == *known)
    });
    numbering::number(files).into_iter().collect()
}
