//! What a file is, told by its first bytes, and how its compressed parts are unpacked.

use super::ros::RosImages;
use super::{Container, damaged, matroska, mcap, rosbag, sens};
use crate::capture::CaptureError;
use crate::capture::sequences::{SequenceOptions, input};
use crate::recording::{SAINT_ENCODING, SAINT_TOPIC};
use std::fs::File;
use std::io::Read;
use std::path::Path;

/// Largest window of a Zstandard frame, bytes; writers use at most 8 MiB unless asked for more.
const MAX_WINDOW: u64 = 32 << 20;

/// The formats, by their first bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Format {
    Bag,
    Mcap,
    Matroska,
    Sens,
}

impl Format {
    fn of(path: &Path) -> Option<Self> {
        let mut start = Vec::new();
        let file = File::open(path).ok()?;
        if !file.metadata().ok()?.is_file() {
            return None;
        }
        file.take(12).read_to_end(&mut start).ok()?;
        if start.starts_with(b"#ROSBAG V") {
            Some(Self::Bag)
        } else if start.starts_with(::mcap::MAGIC) {
            Some(Self::Mcap)
        } else if start.starts_with(&matroska::MAGIC) {
            Some(Self::Matroska)
        } else if path.extension().is_some_and(|name| name == "sens") {
            // it has no magic, only a version
            Some(Self::Sens)
        } else {
            None
        }
    }
}

/// True for a file that is read here: a ROS bag, an MCAP file, a Matroska file, a `.sens` file.
#[must_use]
pub fn is_container(path: &Path) -> bool {
    Format::of(path).is_some()
}

/// True for an MCAP file that is no recording of spheres: depth images may be in it.
#[must_use]
pub fn holds_depth_images(path: &Path) -> bool {
    mcap::first_channel_is(path, SAINT_TOPIC, SAINT_ENCODING) == Some(false)
}

/// Opens the file by its format.
pub(super) fn container(
    path: &Path,
    options: &SequenceOptions,
) -> Result<Box<dyn Container>, CaptureError> {
    let format = Format::of(path);
    let has_topics = matches!(format, Some(Format::Bag | Format::Mcap));
    if let Some(topic) = options.topic.as_ref().filter(|_| !has_topics) {
        return Err(CaptureError::Usage(format!(
            "--topic {topic}: {} has no topics",
            path.display()
        )));
    }
    Ok(match format {
        Some(Format::Bag) => Box::new(RosImages::open(path, options, || {
            Ok(Box::new(rosbag::BagLog::open(path)?))
        })?),
        Some(Format::Mcap) => Box::new(RosImages::open(path, options, || {
            Ok(Box::new(mcap::McapLog::open(path)?))
        })?),
        Some(Format::Matroska) => Box::new(matroska::MatroskaImages::open(path)?),
        Some(Format::Sens) => Box::new(sens::SensImages::open(path)?),
        None => {
            let what = "it is no ROS bag, MCAP, Matroska or .sens file";
            return Err(input(path, what, "give one of these"));
        }
    })
}

/// Unpacks `data` into `out` (empty); stops after one byte more than `size`.
pub(super) fn unpack(
    compression: &str,
    data: &[u8],
    size: u64,
    out: &mut Vec<u8>,
) -> Result<(), String> {
    let most = size.saturating_add(1);
    let read = match compression {
        "" | "none" => {
            out.extend_from_slice(data);
            return Ok(());
        }
        "lz4" => lz4_flex::frame::FrameDecoder::new(data)
            .take(most)
            .read_to_end(out),
        "bz2" => bzip2::read::BzDecoder::new(data)
            .take(most)
            .read_to_end(out),
        "zlib" => flate2::read::ZlibDecoder::new(data)
            .take(most)
            .read_to_end(out),
        "zstd" => ruzstd::decoding::StreamingDecoder::new_with_max_window_size(data, MAX_WINDOW)
            .map_err(|error| format!("Zstandard: {error}"))?
            .take(most)
            .read_to_end(out),
        other => return Err(format!("unknown compression \"{other}\"")),
    };
    read.map(|_| ())
        .map_err(|error| format!("{compression}: {error}"))
}

/// Unpacks one image of `pixels` 16-bit integers.
pub(super) fn unpack_image(
    path: &Path,
    compression: &str,
    data: &[u8],
    pixels: usize,
    scratch: &mut Vec<u8>,
) -> Result<(), CaptureError> {
    scratch.clear();
    let size = pixels as u64 * 2;
    unpack(compression, data, size, scratch).map_err(|what| damaged(path, what))?;
    if scratch.len() as u64 != size {
        let what = format!("an image of {} bytes, but {size} are needed", scratch.len());
        return Err(damaged(path, what));
    }
    Ok(())
}
