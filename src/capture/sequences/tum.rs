//! TUM RGB-D folders: `depth.txt` and `rgb.txt` list times and files; 5000 units a metre.
//!
//! Layout: <https://cvg.cit.tum.de/data/datasets/rgbd-dataset/file_formats>. The folder holds no
//! intrinsics, and the three cameras of the dataset differ, so none are assumed.

use super::layout::{Format, Layout, name_of};
use super::timestamps::{frame_time, nanoseconds, read_text};
use super::{ColorFile, FrameFile, camera_json, input};
use crate::capture::CaptureError;
use std::path::{Path, PathBuf};

/// The list of depth images; its presence makes a folder a TUM folder.
pub(super) const DEPTH_LIST: &str = "depth.txt";
const COLOR_LIST: &str = "rgb.txt";
const UNIT_M: f64 = 1.0 / 5000.0;
/// Farthest a colour image may be from its depth image, as in the dataset's own tools.
const COLOR_WITHIN_NS: u64 = 20_000_000;

/// Reads the lists of a TUM folder.
///
/// # Errors
/// [`CaptureError::Input`] names the list and the line, or says that no listed file exists.
pub(super) fn find(root: &Path) -> Result<Layout, CaptureError> {
    let list = root.join(DEPTH_LIST);
    let depth = entries(root, &list)?;
    let colors = match root.join(COLOR_LIST) {
        path if path.is_file() => entries(root, &path)?,
        _ => Vec::new(),
    };
    let Some((zero_ns, _)) = depth.first() else {
        return Err(input(
            &list,
            "it lists no images",
            "give a complete TUM folder",
        ));
    };
    // The line is the frame number: a listed file that is missing is a gap.
    let frames: Vec<FrameFile> = (0..)
        .zip(&depth)
        .filter(|(_, (_, path))| path.is_file())
        .map(|(number, (ns, path))| FrameFile {
            path: path.clone(),
            number,
            time: Some(frame_time(*ns, *zero_ns)),
            color: nearest(&colors, *ns).map(|(ns, path)| ColorFile {
                path: path.clone(),
                time: Some(frame_time(*ns, *zero_ns)),
            }),
        })
        .collect();
    if frames.is_empty() {
        let what = format!("none of the {} files it lists exists", depth.len());
        return Err(input(&list, what, "unpack the whole archive"));
    }
    Ok(Layout {
        input: root.to_owned(),
        format: Format::Png,
        frames,
        sidecar: camera_json::find(root)?,
        unit_m: Some(UNIT_M),
        invalid: &[0],
        suggestion: ", for TUM 517.3,516.5,318.6,255.3 (fr1), 520.9,521.0,325.1,249.7 (fr2) or \
                     535.4,539.2,320.1,247.6 (fr3)",
        name: name_of(root),
    })
}

/// Times (ns) and files of a list, in the order of time.
fn entries(root: &Path, list: &Path) -> Result<Vec<(i64, PathBuf)>, CaptureError> {
    let text = read_text(list)?;
    let mut entries = Vec::new();
    for (line, text) in (1..).zip(text.lines()) {
        let text = text.trim();
        if text.is_empty() || text.starts_with('#') {
            continue;
        }
        let entry = text
            .split_once(char::is_whitespace)
            .and_then(|(time, file)| Some((nanoseconds(time)?, root.join(file.trim()))));
        let Some(entry) = entry else {
            let what = format!("line {line} \"{text}\" is not \"timestamp filename\"");
            return Err(input(list, what, "correct the line"));
        };
        entries.push(entry);
    }
    entries.sort();
    Ok(entries)
}

fn nearest(colors: &[(i64, PathBuf)], ns: i64) -> Option<&(i64, PathBuf)> {
    let after = colors.partition_point(|(time, _)| *time < ns);
    let around = &colors[after.saturating_sub(1)..(after + 1).min(colors.len())];
    around
        .iter()
        .min_by_key(|(time, _)| time.abs_diff(ns))
        .filter(|(time, _)| time.abs_diff(ns) <= COLOR_WITHIN_NS)
}
