//! 7-Scenes folders: `frame-000000.depth.png` beside `.color.png` and `.pose.txt`; millimetres,
//! 65535 where nothing was measured.
//!
//! Layout: Shotton et al., "Scene Coordinate Regression Forests", CVPR 2013, and the dataset's
//! page. The folder holds no intrinsics; the page suggests one pinhole for all of it.

use super::layout::{Format, Layout, name_of};
use super::{ColorFile, DEFAULT_UNIT_M, FrameFile, camera_json};
use crate::capture::CaptureError;
use std::path::{Path, PathBuf};

const PREFIX: &str = "frame-";
const DEPTH: &str = ".depth.png";
const COLOR: &str = ".color.png";

/// The layout of a folder whose visible files are `files`; `None` where it is no such folder.
///
/// # Errors
/// [`CaptureError::Input`] when a `camera.json` beside the images is damaged.
pub(super) fn find(root: &Path, files: &[PathBuf]) -> Result<Option<Layout>, CaptureError> {
    let number = |path: &PathBuf| {
        let name = path.file_name()?.to_str()?;
        let digits = name.strip_prefix(PREFIX)?.strip_suffix(DEPTH)?;
        digits.parse::<u64>().ok()
    };
    let mut frames: Vec<FrameFile> = files
        .iter()
        .filter_map(|path| {
            let name = path.file_name()?.to_str()?;
            let color = root.join(name.replace(DEPTH, COLOR));
            Some(FrameFile {
                number: number(path)?,
                path: path.clone(),
                time: None,
                color: color.is_file().then_some(ColorFile {
                    path: color,
                    time: None,
                }),
            })
        })
        .collect();
    if frames.is_empty() {
        return Ok(None);
    }
    frames.sort_by_key(|frame| frame.number);
    frames.dedup_by_key(|frame| frame.number);
    Ok(Some(Layout {
        input: root.to_owned(),
        format: Format::Png,
        frames,
        sidecar: camera_json::find(root)?,
        unit_m: Some(DEFAULT_UNIT_M),
        invalid: &[0, 65535],
        suggestion: ", for 7-Scenes 585,585,320,240",
        name: name_of(root),
    }))
}
