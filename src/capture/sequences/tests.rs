//! Every layout gives the frames it was written from.

use super::camera_json::write_camera_json;
use super::exr::{write_exr_depth, write_exr_metres};
use super::png::write_png_depth;
use super::*;
use crate::capture::Next;
use crate::frame::{Camera, DepthFrame, FrameTime, Intrinsics};
use std::fs;
use tempfile::TempDir;

pub(super) const W: u32 = 4;
pub(super) const H: u32 = 3;

pub(super) fn camera() -> Camera {
    Camera {
        width: W,
        height: H,
        intrinsics: Intrinsics {
            fx: 5.0,
            fy: 5.5,
            cx: 1.5,
            cy: 1.0,
        },
        depth_unit_m: 0.0005,
        invalid: vec![0, 2047],
        depth_min_m: 0.25,
        depth_max_m: 12.0,
        fps: Some(10.0),
        name: "ours".to_owned(),
    }
}

/// Depth of a frame: every number gives other pixels.
pub(super) fn depth(number: u64) -> Vec<u16> {
    (0..W * H)
        .map(|pixel| (number as u32 * 100 + pixel) as u16)
        .collect()
}

pub(super) fn png(path: &Path, number: u64) {
    fs::create_dir_all(path.parent().unwrap()).unwrap();
    write_png_depth(path, W, H, &depth(number)).unwrap();
}

fn exr(path: &Path, number: u64) {
    fs::create_dir_all(path.parent().unwrap()).unwrap();
    let time = FrameTime {
        device_ns: number as i64 * 7,
        wall_ns: 0,
    };
    let frame = DepthFrame {
        sequence: number,
        time,
        depth: depth(number),
    };
    write_exr_depth(path, &camera(), &frame).unwrap();
}

/// A PNG folder of ours with frames 0, 1, 3.
pub(super) fn png_folder() -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    for number in [0, 1, 3] {
        png(
            &folder.path().join(format!("depth/{number:06}.png")),
            number,
        );
    }
    write_camera_json(folder.path(), &camera()).unwrap();
    folder
}

pub(super) fn opened(path: &Path) -> Box<dyn FrameSource> {
    open(path, &SequenceOptions::default()).unwrap_or_else(|error| panic!("{error}"))
}

pub(super) fn given() -> SequenceOptions {
    SequenceOptions {
        calibration: Some(Calibration::from_intrinsics(camera().intrinsics)),
        ..SequenceOptions::default()
    }
}

/// Reads to the end: numbers and device times; the depth must be that of the number.
fn numbers(source: &mut dyn FrameSource) -> Vec<(u64, i64)> {
    let mut frame = DepthFrame::default();
    let mut list = Vec::new();
    while source.next(&mut frame).unwrap() == Next::Frame {
        assert_eq!(frame.depth, depth(frame.sequence));
        list.push((frame.sequence, frame.time.device_ns));
    }
    assert_eq!(source.next(&mut frame).unwrap(), Next::End);
    list
}

pub(super) fn failure(path: &Path, options: &SequenceOptions) -> String {
    match open(path, options) {
        Ok(_) => panic!("{} opened", path.display()),
        Err(error) => error.to_string(),
    }
}

pub(super) fn assert_says(message: &str, words: &[&str]) {
    for word in words {
        assert!(message.contains(word), "{message:?} does not say {word:?}");
    }
}

#[test]
fn png_folder_with_camera_json() {
    let folder = png_folder();
    let mut source = opened(folder.path());
    let name = folder.path().file_name().unwrap().to_str().unwrap();
    let expected = Camera {
        name: name.to_owned(),
        ..camera()
    };
    assert_eq!(source.camera(), &expected);
    assert!(!source.is_live());
    assert_eq!(source.len_hint(), Some(3));
    let frames = numbers(source.as_mut());
    assert_eq!(frames, [(0, 0), (1, 100_000_000), (3, 300_000_000)]);
    assert_eq!(source.losses().sensor_gap, 1);
    assert_eq!(source.len_hint(), Some(0));
    // The depth folder itself is the same sequence.
    let mut inner = opened(&folder.path().join("depth"));
    assert_eq!(inner.camera(), &expected);
    assert_eq!(numbers(inner.as_mut()), frames);
}

#[test]
fn a_range_keeps_numbers_and_times() {
    let folder = png_folder();
    let options = |first, count| SequenceOptions {
        first,
        count,
        ..SequenceOptions::default()
    };
    let mut source = open(folder.path(), &options(1, Some(2))).unwrap();
    assert_eq!(source.len_hint(), Some(2));
    assert_eq!(
        numbers(source.as_mut()),
        [(1, 100_000_000), (3, 300_000_000)]
    );
    assert_says(
        &failure(folder.path(), &options(3, None)),
        &["no frame is left of 3"],
    );
    assert_says(
        &failure(folder.path(), &options(0, Some(0))),
        &["keeping 0"],
    );
}

#[test]
fn timestamps_are_exact_and_give_the_rate() {
    let folder = png_folder();
    fs::remove_file(folder.path().join("camera.json")).unwrap();
    let list = "# frame seconds\n0 1305031102.160407\n1 1305031102.19433\n";
    fs::write(folder.path().join("timestamps.txt"), list).unwrap();
    let mut source = open(folder.path(), &given()).unwrap();
    let fps = source.camera().fps.unwrap();
    assert!((fps - 1e9 / 33_923_000.0).abs() < 1e-9, "{fps}");
    assert_eq!(source.camera().depth_unit_m, 0.001);
    // Frame 3 is not listed: two periods after frame 1.
    assert_eq!(
        numbers(source.as_mut()),
        [(0, 0), (1, 33_923_000), (3, 101_769_000)]
    );
    let mut frame = DepthFrame::default();
    let mut source = open(folder.path(), &given()).unwrap();
    source.next(&mut frame).unwrap();
    assert_eq!(frame.time.wall_ns, 1_305_031_102_160_407_000);
    fs::write(folder.path().join("timestamps.txt"), "0 1.0\n1 soon\n").unwrap();
    let message = failure(folder.path(), &given());
    assert_says(&message, &["timestamps.txt", "line 2", "1 soon"]);
}

#[test]
fn colour_is_passed_through_by_number() {
    let folder = png_folder();
    let colour = folder.path().join("colour");
    fs::create_dir(&colour).unwrap();
    fs::write(colour.join("000001.jpg"), [0xff, 0xd8, 1, 2, 3]).unwrap();
    fs::write(colour.join("000003.png"), b"\x89PNG rest").unwrap();
    fs::write(colour.join("000000.jpg"), b"text").unwrap();
    let mut source = opened(folder.path());
    let mut frame = DepthFrame::default();
    let mut seen = Vec::new();
    while source.next(&mut frame).unwrap() == Next::Frame {
        let color = source.take_color();
        assert_eq!(source.take_color(), None, "taken once");
        seen.push(color.map(|c| (c.sequence, c.time, c.format, c.data)));
    }
    let time = |device_ns| FrameTime {
        device_ns,
        wall_ns: 0,
    };
    let jpeg = (
        1,
        time(100_000_000),
        "jpeg".to_owned(),
        vec![0xff, 0xd8, 1, 2, 3],
    );
    let png = (
        3,
        time(300_000_000),
        "png".to_owned(),
        b"\x89PNG rest".to_vec(),
    );
    assert_eq!(seen, [None, Some(jpeg), Some(png)]);
}

#[test]
fn what_the_exr_depth_measures_is_named() {
    let parsed = ["planar", "ray", "inverse"].map(|name| name.parse::<ExrDepth>().unwrap());
    assert_eq!(parsed, [ExrDepth::Planar, ExrDepth::Ray, ExrDepth::Inverse]);
    let message = "Z".parse::<ExrDepth>().unwrap_err().to_string();
    assert_says(&message, &["\"Z\"", "planar, ray or inverse"]);
}

#[test]
fn exr_folder_file_and_pattern() {
    let folder = tempfile::tempdir().unwrap();
    for number in [2, 9, 10] {
        exr(&folder.path().join(format!("frame{number}.exr")), number);
    }
    png(&folder.path().join("picture.png"), 1);
    let mut source = opened(folder.path());
    assert_eq!(source.camera(), &camera());
    assert_eq!(numbers(source.as_mut()), [(2, 14), (9, 63), (10, 70)]);
    assert_eq!(source.losses().sensor_gap, 6);
    let mut source = opened(&folder.path().join("frame%d.exr"));
    assert_eq!(numbers(source.as_mut()), [(2, 14), (9, 63), (10, 70)]);
    let mut source = opened(&folder.path().join("frame9.exr"));
    assert_eq!(numbers(source.as_mut()), [(9, 63)]);
    let message = failure(&folder.path().join("frame%04d.exr"), &given());
    assert_says(&message, &["frame%04d.exr", "no file matches"]);
}

#[test]
fn depth_and_colour_in_one_folder() {
    let folder = tempfile::tempdir().unwrap();
    png(&folder.path().join("frame-000004.depth.png"), 4);
    png(&folder.path().join("frame-000005.depth.png"), 5);
    png(&folder.path().join("frame-000004.color.png"), 7);
    png(&folder.path().join(".frame-000006.depth.png"), 6);
    let mut source = open(folder.path(), &given()).unwrap();
    assert_eq!(numbers(source.as_mut()), [(4, 0), (5, 33_333_333)]);
}

#[test]
fn single_png_finds_the_camera_above_its_folder() {
    let folder = png_folder();
    let mut source = opened(&folder.path().join("depth/000003.png"));
    assert_eq!(source.camera().intrinsics, camera().intrinsics);
    assert_eq!(numbers(source.as_mut()), [(3, 0)]);
}

#[test]
fn tum_folder() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    for (number, name) in [(0, "5.00"), (1, "5.04"), (3, "5.12")] {
        png(&root.join(format!("depth/{name}.png")), number);
    }
    let list = "# depth maps\n# timestamp filename\n5.12 depth/5.12.png\n5.00 depth/5.00.png\n\
                5.04 depth/5.04.png\n5.08 depth/5.08.png\n";
    fs::write(root.join("depth.txt"), list).unwrap();
    fs::write(
        root.join("rgb.txt"),
        "5.03 rgb/a.jpg\n5.05 rgb/b.jpg\n5.2 rgb/c.jpg\n",
    )
    .unwrap();
    fs::create_dir(root.join("rgb")).unwrap();
    fs::write(root.join("rgb/b.jpg"), [0xff, 0xd8]).unwrap();
    let message = failure(root, &SequenceOptions::default());
    assert_says(
        &message,
        &[
            "intrinsics are missing",
            "--intrinsics",
            "517.3,516.5,318.6,255.3",
        ],
    );

    let mut source = open(root, &given()).unwrap();
    assert_eq!(source.camera().depth_unit_m, 1.0 / 5000.0);
    assert!((source.camera().fps.unwrap() - 25.0).abs() < 1e-6);
    let times = [(0, 5_000_000_000), (1, 5_040_000_000), (3, 5_120_000_000)];
    assert_eq!(numbers(source.as_mut()), times);
    assert_eq!(source.losses().sensor_gap, 1);

    fs::write(root.join("rgb/a.jpg"), [0xff, 0xd8, 7]).unwrap();
    let mut source = open(root, &given()).unwrap();
    let mut frame = DepthFrame::default();
    let mut colors = Vec::new();
    while source.next(&mut frame).unwrap() == Next::Frame {
        colors.push(
            source
                .take_color()
                .map(|color| (color.time.device_ns, color.data.len())),
        );
    }
    assert_eq!(colors, [None, Some((5_030_000_000, 3)), None]);

    fs::write(root.join("depth.txt"), "5.00\n").unwrap();
    assert_says(&failure(root, &given()), &["depth.txt", "line 1"]);
    fs::write(root.join("depth.txt"), "5.00 none.png\n").unwrap();
    assert_says(&failure(root, &given()), &["none of the 1 files"]);
    fs::write(root.join("depth.txt"), "# only words\n").unwrap();
    assert_says(&failure(root, &given()), &["lists no images"]);
}

#[test]
fn options_win_over_the_files() {
    let folder = png_folder();
    let options = SequenceOptions {
        calibration: Some(Calibration {
            size: Some((W * 2, H * 2)),
            fps: Some(7.0),
            depth_unit_m: Some(0.5),
            ..Calibration::from_intrinsics(camera().intrinsics)
        }),
        depth_unit_m: Some(0.002),
        depth_min_m: Some(1.0),
        depth_max_m: Some(3.0),
        invalid: Some(vec![9, 4, 9]),
        ..SequenceOptions::default()
    };
    let source = open(folder.path(), &options).unwrap();
    let camera = source.camera();
    assert_eq!(camera.intrinsics.fx, 2.5);
    assert_eq!((camera.depth_unit_m, camera.fps), (0.002, Some(7.0)));
    assert_eq!((camera.depth_min_m, camera.depth_max_m), (1.0, 3.0));
    assert_eq!(camera.invalid, [4, 9]);
    let zero = SequenceOptions {
        depth_unit_m: Some(0.0),
        ..given()
    };
    assert!(matches!(
        open(folder.path(), &zero),
        Err(CaptureError::Usage(_))
    ));
    let empty = SequenceOptions {
        depth_min_m: Some(4.0),
        depth_max_m: Some(4.0),
        ..given()
    };
    assert_says(&failure(folder.path(), &empty), &["4 to 4 m is empty"]);
}

#[test]
fn float_depth_without_a_unit() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("0.exr");
    let mut depth_m = [1.00013f32; 12];
    depth_m[..4].copy_from_slice(&[f32::NAN, f32::INFINITY, -2.0, 1e9]);
    let near = depth_m.map(|z| if z == 1e9 { 16.0 } else { z });
    write_exr_metres(&path, &camera(), 0, FrameTime::default(), &near).unwrap();
    let mut source = opened(&path);
    assert_eq!(source.camera().depth_unit_m, 0.00025);
    let mut frame = DepthFrame::default();
    source.next(&mut frame).unwrap();
    assert_eq!(frame.depth[..5], [0, 0, 0, 64_000, 4001]);
    write_exr_metres(&path, &camera(), 0, FrameTime::default(), &depth_m).unwrap();
    let mut source = opened(&path);
    assert_eq!(source.camera().depth_unit_m, 0.001);
    source.next(&mut frame).unwrap();
    assert_eq!(frame.depth[..5], [0, 0, 0, 0, 1000]);
    let ray = SequenceOptions {
        exr_depth: ExrDepth::Ray,
        ..SequenceOptions::default()
    };
    let mut source = open(&path, &ray).unwrap();
    source.next(&mut frame).unwrap();
    assert!(
        frame.depth[4..].iter().all(|raw| (900..1000).contains(raw)),
        "{:?}",
        frame.depth
    );
}

#[test]
#[allow(clippy::print_stderr, reason = "a skipped test says so")]
fn real_sequences_open() {
    let shared = std::env::var_os("SAINT_SHARED").map_or_else(
        || Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared"),
        PathBuf::from,
    );
    let Ok(folders) = fs::read_dir(shared.join("data/sequences")) else {
        eprintln!("skipped: no recorded sequences at {}", shared.display());
        return;
    };
    for folder in folders {
        let folder = folder.unwrap().path();
        let count = fs::read_dir(folder.join("depth")).unwrap().count();
        let keep = SequenceOptions {
            count: Some(3),
            ..SequenceOptions::default()
        };
        assert_eq!(opened(&folder).len_hint(), Some(count as u64));
        let mut source = open(&folder, &keep).unwrap();
        let mut frame = DepthFrame::default();
        let mut previous = -1;
        while source.next(&mut frame).unwrap() == Next::Frame {
            assert_eq!(frame.depth.len(), source.camera().pixels());
            assert!(frame.depth.iter().filter(|raw| **raw > 0).count() > frame.depth.len() / 4);
            assert!(frame.time.device_ns > previous);
            previous = frame.time.device_ns;
            let has_color = folder.join("colour").is_dir();
            assert_eq!(
                source.take_color().is_some(),
                has_color,
                "{}",
                folder.display()
            );
        }
        assert_eq!(source.losses().sensor_gap, 0);
    }
}
