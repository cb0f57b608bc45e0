//! Files of other programs. The first byte says which kind.

use saint_live::capture::containers::rvl;
use saint_live::capture::sequences::{self, SequenceOptions};
use saint_live::capture::synthetic::SyntheticOptions;
use saint_live::capture::{FrameSource, Next};
use saint_live::cloud::{Cloud, CloudFormat};
use saint_live::frame::{DepthFrame, Intrinsics};
use saint_live::intrinsics::Calibration;
use saint_live::rig::{ColorCamera, Rig};
use std::cell::RefCell;
use std::path::{Path, PathBuf};

/// Depth images, by the first byte.
pub const IMAGES: [&str; 2] = ["exr", "png"];
/// Recordings of other programs, by the first byte.
pub const CONTAINERS: [&str; 5] = ["bag", "mcap", "mkv", "sens", "rvl"];
/// Point clouds, by the first byte.
pub const CLOUDS: [(&str, CloudFormat); 5] = [
    ("ply", CloudFormat::Ply),
    ("pcd", CloudFormat::Pcd),
    ("obj", CloudFormat::Obj),
    ("xyz", CloudFormat::Xyz),
    ("npy", CloudFormat::Npy),
];

/// A depth image.
pub fn image(data: &[u8]) {
    if let Some((&kind, bytes)) = data.split_first() {
        sequence(IMAGES[usize::from(kind) % IMAGES.len()], bytes);
    }
}

/// A recording of another program, or an RVL image.
pub fn container(data: &[u8]) {
    let Some((&kind, bytes)) = data.split_first() else {
        return;
    };
    let ending = CONTAINERS[usize::from(kind) % CONTAINERS.len()];
    if ending == "rvl" {
        let mut depth = Vec::new();
        if rvl::decode(bytes, 1000, &mut depth).is_ok() {
            assert_eq!(depth.len(), 1000);
        }
    } else {
        sequence(ending, bytes);
    }
}

fn sequence(ending: &str, bytes: &[u8]) {
    let lens = Intrinsics {
        fx: 60.0,
        fy: 60.0,
        cx: 30.0,
        cy: 20.0,
    };
    let given = SequenceOptions {
        calibration: Some(Calibration::from_intrinsics(lens)),
        ..SequenceOptions::default()
    };
    let file = InputFile::new(ending, bytes);
    for options in [&SequenceOptions::default(), &given] {
        if let Ok(source) = sequences::open(&file.path, options) {
            drain(source);
        }
    }
    if ending == "png" {
        let _ = Calibration::read(&file.path);
    }
}

/// Takes frames from a source until it ends.
pub fn drain(mut source: Box<dyn FrameSource>) {
    let mut frame = DepthFrame::default();
    for _ in 0..16 {
        match source.next(&mut frame) {
            Ok(Next::Frame) => {
                assert_eq!(frame.depth.len(), source.camera().pixels());
                source.take_color();
            }
            Ok(Next::End) => break,
            Ok(Next::Waiting(_)) | Err(_) => {}
        }
    }
}

/// A point cloud.
pub fn cloud_file(data: &[u8]) {
    let Some((&kind, bytes)) = data.split_first() else {
        return;
    };
    let (_, format) = CLOUDS[usize::from(kind) % CLOUDS.len()];
    if let Ok(cloud) = Cloud::parse(bytes, format) {
        // a point takes at least a byte
        assert!(cloud.positions.len() <= bytes.len());
    }
}

/// What says how cameras see and stand, as all the layouts it may have; or the text of an option.
pub fn camera_file(data: &[u8]) {
    let file = InputFile::new("toml", data);
    let _ = Rig::read(&file.path);
    let _ = ColorCamera::read(&file.path);
    let _ = Calibration::read(&file.path);
    if let Ok(text) = std::str::from_utf8(data) {
        let _ = SyntheticOptions::parse(text);
        if text.contains(',') {
            let _ = Calibration::parse_flag(text);
        }
    }
}

/// A file of these bytes, in memory where the system can.
pub struct InputFile {
    pub path: PathBuf,
}

impl InputFile {
    /// Written anew; there is one of each ending.
    pub fn new(ending: &str, bytes: &[u8]) -> Self {
        thread_local! {
            static FOLDER: RefCell<Option<tempfile::TempDir>> = const { RefCell::new(None) };
        }
        let path = FOLDER.with_borrow_mut(|folder| {
            let folder = folder.get_or_insert_with(|| {
                let memory = Path::new("/dev/shm");
                let made = match memory.is_dir() {
                    true => tempfile::tempdir_in(memory),
                    false => tempfile::tempdir(),
                };
                made.expect("a folder for files")
            });
            folder.path().join("input").with_extension(ending)
        });
        std::fs::write(&path, bytes).expect("a file in it");
        Self { path }
    }
}
