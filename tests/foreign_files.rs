//! Depth recordings of other programs, as other writers made them (`foreign/make.py`), and what
//! damage does to them.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "a test fails by panicking"
)]

mod watched;

use saint_live::capture::sequences::{self, SequenceOptions};
use saint_live::capture::{CaptureError, FrameSource, Next};
use saint_live::frame::{Camera, DepthFrame, Intrinsics};
use saint_live::intrinsics::Calibration;
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;
use watched::LARGEST;

const WIDTH: usize = 32;
const HEIGHT: usize = 24;
const K: Intrinsics = Intrinsics {
    fx: 28.5,
    fy: 28.25,
    cx: 15.75,
    cy: 11.5,
};
const START_NS: i64 = 1_700_000_000_250_000_000;
const PERIOD_NS: i64 = 33_333_333;

/// The scene of `make.py`, millimetres.
fn scene(k: usize, hole: u16) -> Vec<u16> {
    let pixel = |x: usize, y: usize| {
        let (dx, dy) = (x as i32 - 25, y as i32 - 5);
        if dx * dx + dy * dy < 9 {
            hole
        } else if (8 + k..16 + k).contains(&x) && (6..18).contains(&y) {
            (650 + k) as u16
        } else {
            (900 + 7 * x + 11 * y + 3 * k) as u16
        }
    };
    (0..WIDTH * HEIGHT)
        .map(|at| pixel(at % WIDTH, at / WIDTH))
        .collect()
}

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/foreign")
}

fn open(name: &str, options: &SequenceOptions) -> Result<Box<dyn FrameSource>, CaptureError> {
    sequences::open(&folder().join(name), options)
}

/// All frames, then the error that ended them, where one did.
fn read(mut source: Box<dyn FrameSource>) -> (Camera, Vec<DepthFrame>, Option<CaptureError>) {
    let mut frames = Vec::new();
    let error = loop {
        let mut frame = DepthFrame::default();
        match source.next(&mut frame) {
            Ok(Next::Frame) => frames.push(frame),
            Ok(_) => break None,
            Err(error) => break Some(error),
        }
        assert!(frames.len() < 100, "it never ends");
    };
    (source.camera().clone(), frames, error)
}

fn with_intrinsics() -> SequenceOptions {
    SequenceOptions {
        calibration: Some(Calibration::from_intrinsics(K)),
        ..SequenceOptions::default()
    }
}

fn check(name: &str, options: &SequenceOptions, numbers: [u64; 3], start_ns: i64, wall: bool) {
    let (camera, frames, error) = read(open(name, options).unwrap());
    assert!(error.is_none(), "{name}: {error:?}");
    assert_eq!(camera.intrinsics, K, "{name}");
    assert_eq!((camera.width, camera.height), (32, 24), "{name}");
    assert_eq!(frames.len(), 3, "{name}");
    let hole = if camera.invalid.contains(&65535) {
        65535
    } else {
        0
    };
    for (k, frame) in frames.iter().enumerate() {
        let per_mm = 0.001 / camera.depth_unit_m;
        let want: Vec<u16> = scene(k, hole)
            .iter()
            .map(|mm| (f64::from(*mm) * per_mm).round() as u16)
            .collect();
        assert_eq!(frame.depth, want, "{name}, frame {k}");
        assert_eq!(frame.sequence, numbers[k], "{name}");
        let since = frame.time.device_ns - start_ns;
        // Matroska and ScanNet keep coarser times
        assert!(
            (since - k as i64 * PERIOD_NS).abs() < 1_000_000,
            "{name}, frame {k}: {since} ns"
        );
        let wall_ns = if wall {
            START_NS + k as i64 * PERIOD_NS
        } else {
            0
        };
        assert_eq!(frame.time.wall_ns, wall_ns, "{name}");
    }
}

#[test]
fn bags_of_realsense_are_read_with_their_own_camera() {
    let options = SequenceOptions::default();
    for name in ["realsense.bag", "realsense-lz4.bag", "realsense-bz2.bag"] {
        // the sensor's own numbers: 43 is missing
        check(name, &options, [41, 42, 44], 0, true);
        let source = open(name, &options).unwrap();
        assert_eq!(source.camera().depth_unit_m, 0.001);
    }
    let mut source = open("realsense.bag", &options).unwrap();
    let mut frame = DepthFrame::default();
    while source.next(&mut frame).unwrap() == Next::Frame {}
    assert_eq!(source.losses().sensor_gap, 1);
}

#[test]
fn ros2_messages_are_read_in_every_encoding() {
    for name in [
        "ros2-zstd.mcap",
        "ros2-lz4-big-endian.mcap",
        "ros2-float.mcap",
        "ros2-png.mcap",
        "ros2-rvl.mcap",
    ] {
        check(name, &SequenceOptions::default(), [0, 1, 2], 0, true);
    }
}

#[test]
fn the_inverse_depth_of_compressed_floats_is_undone() {
    let (camera, frames, _) = read(open("ros2-inverse.mcap", &SequenceOptions::default()).unwrap());
    // q = a/z + b with a = 100·101, cut to an integer: dz = z²/a per step
    for (k, frame) in frames.iter().enumerate() {
        for (raw, mm) in frame.depth.iter().zip(scene(k, 0)) {
            let (got, truth) = (
                f64::from(*raw) * camera.depth_unit_m,
                f64::from(mm) / 1000.0,
            );
            let step = truth * truth / 10_100.0;
            let error = (got - truth).abs();
            assert!(
                error <= 1.01 * step + camera.depth_unit_m,
                "{got} for {truth}"
            );
            assert_eq!(*raw == 0, mm == 0);
        }
    }
}

#[test]
fn the_sensor_s_own_view_is_chosen_and_any_topic_can_be() {
    check(
        "ros2-two-topics.mcap",
        &SequenceOptions::default(),
        [0, 1, 2],
        0,
        true,
    );
    let topic = |topic: &str| SequenceOptions {
        topic: Some(topic.to_owned()),
        ..SequenceOptions::default()
    };
    let aligned = topic("/camera/aligned_depth_to_color/image_raw");
    let (camera, frames, _) = read(open("ros2-two-topics.mcap", &aligned).unwrap());
    assert_eq!(camera.intrinsics.fx, 99.0);
    assert_eq!(frames[2].depth, scene(0, 0));
    let Err(error) = open("ros2-two-topics.mcap", &topic("/nothing")) else {
        panic!("a topic that is not there")
    };
    let error = error.to_string();
    assert!(
        error.contains("/camera/depth/image_rect_raw") && error.contains("--topic"),
        "{error}"
    );
    let Err(error) = open("scannet.sens", &topic("/depth")) else {
        panic!("a file without topics")
    };
    assert!(matches!(error, CaptureError::Usage(_)), "{error}");
}

#[test]
fn azure_kinect_files_are_read_as_both_writers_made_them() {
    check("kinect.mkv", &with_intrinsics(), [0, 1, 2], 0, false);
    // its tag says when on the device's clock the file begins
    check(
        "kinect-remuxed.mkv",
        &with_intrinsics(),
        [0, 1, 2],
        200_011_000,
        false,
    );
    let Err(error) = open("kinect.mkv", &SequenceOptions::default()) else {
        panic!("32x24 is no mode of that camera")
    };
    assert!(error.to_string().contains("--intrinsics"), "{error}");
}

#[test]
fn scannet_and_seven_scenes_are_read() {
    check(
        "scannet.sens",
        &SequenceOptions::default(),
        [0, 1, 2],
        5_000_000_000,
        false,
    );
    check("seven_scenes", &with_intrinsics(), [0, 1, 2], 0, false);
    let source = open("seven_scenes", &with_intrinsics()).unwrap();
    assert_eq!(source.camera().invalid, [0, 65535]);
    let Err(error) = open("seven_scenes", &SequenceOptions::default()) else {
        panic!("7-Scenes folders hold no intrinsics")
    };
    assert!(error.to_string().contains("585,585,320,240"), "{error}");
}

#[test]
fn a_range_of_frames_is_cut_out() {
    for name in [
        "realsense.bag",
        "ros2-zstd.mcap",
        "kinect.mkv",
        "scannet.sens",
    ] {
        let options = SequenceOptions {
            first: 1,
            count: Some(1),
            ..with_intrinsics()
        };
        let (_, frames, error) = read(open(name, &options).unwrap());
        assert!(error.is_none(), "{name}");
        assert_eq!(frames.len(), 1, "{name}");
        assert_eq!(frames[0].depth, scene(1, 0), "{name}");
        let beyond = SequenceOptions {
            first: 3,
            ..with_intrinsics()
        };
        assert!(open(name, &beyond).is_err(), "{name}");
    }
}

const FILES: [&str; 10] = [
    "realsense.bag",
    "realsense-lz4.bag",
    "realsense-bz2.bag",
    "ros2-zstd.mcap",
    "ros2-lz4-big-endian.mcap",
    "ros2-png.mcap",
    "ros2-rvl.mcap",
    "kinect.mkv",
    "kinect-remuxed.mkv",
    "scannet.sens",
];

/// Reads damaged bytes: frames, then perhaps an error. Gives the frames.
fn read_damaged(path: &Path, bytes: &[u8]) -> Vec<DepthFrame> {
    std::fs::write(path, bytes).unwrap();
    match sequences::open(path, &with_intrinsics()) {
        Ok(source) => read(source).1,
        Err(error) => {
            assert!(error.to_string().contains("; "), "no remedy: {error}");
            Vec::new()
        }
    }
}

#[test]
fn cut_files_give_their_whole_frames() {
    let scratch = tempfile::tempdir().unwrap();
    for name in FILES {
        let bytes = std::fs::read(folder().join(name)).unwrap();
        let path = scratch.path().join(name);
        let mut most = 0;
        let stride = if cfg!(debug_assertions) { 37 } else { 1 };
        let last = bytes.len() - 1;
        for cut in (0..last).step_by(stride).chain([last]) {
            let frames = read_damaged(&path, &bytes[..cut]);
            for (k, frame) in frames.iter().enumerate() {
                assert_eq!(frame.depth, scene(k, 0), "{name} cut at {cut}");
            }
            assert!(
                frames.len() >= most,
                "{name} cut at {cut}: a frame went away"
            );
            most = frames.len();
        }
        assert_eq!(most, 3, "{name}: what follows the last frame is not needed");
    }
}

#[test]
fn damaged_files_never_panic_and_take_little_memory() {
    let scratch = tempfile::tempdir().unwrap();
    let mut state = 0x9e37_79b9_7f4a_7c15u64;
    let mut random = move |below: usize| {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state % below as u64) as usize
    };
    for name in FILES {
        let whole = std::fs::read(folder().join(name)).unwrap();
        let path = scratch.path().join(name);
        for _ in 0..250 {
            let mut bytes = whole.clone();
            for _ in 0..=random(3) {
                let at = random(bytes.len());
                match random(4) {
                    0 => bytes[at] = 0xff,
                    1 => bytes[at] = 0,
                    2 => bytes[at] ^= 1 << random(8),
                    _ => {
                        let end = (at + 1 + random(16)).min(bytes.len());
                        bytes[at..end].fill(0xff);
                    }
                }
            }
            read_damaged(&path, &bytes);
            // the largest image that is possible has 16 million pixels
            let largest = LARGEST.load(Ordering::Relaxed);
            assert!(largest <= 40 << 20, "{name}: {largest} bytes at once");
        }
    }
}
