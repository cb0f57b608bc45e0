use super::*;
use crate::capture::sequences::{self, SequenceOptions};
use crate::capture::{FrameSource, Next};
use crate::frame::{DepthFrame, Intrinsics};
use crate::recording::{RecordingReader, Split, check, repair};
use std::time::Duration;

fn camera() -> Camera {
    Camera {
        width: 5,
        height: 3,
        intrinsics: Intrinsics {
            fx: 1.0 / 3.0,
            fy: 5.1,
            cx: 2.2,
            cy: 1e-7,
        },
        depth_unit_m: 0.000_1,
        invalid: vec![7, 65535],
        depth_min_m: 0.1,
        depth_max_m: 4.3,
        fps: Some(90.0),
        name: "a \"camera\"".to_owned(),
    }
}

fn frames() -> Vec<DepthFrame> {
    let frame = |sequence: u64, device_ns, wall_ns, depth: [u16; 15]| DepthFrame {
        sequence,
        time: FrameTime { device_ns, wall_ns },
        depth: depth.to_vec(),
    };
    let wall = 1_700_000_000_123_456_789;
    vec![
        frame(u64::from(u32::MAX) * 3 + 2, 55, wall, [0; 15]),
        // numbers pass a multiple of 2³², the wall clock drifts
        frame(
            u64::from(u32::MAX) * 3 + 3,
            11_111_166,
            wall + 11_111_113,
            [65535; 15],
        ),
        frame(
            u64::from(u32::MAX) * 3 + 9,
            22_222_277,
            wall + 22_222_220,
            std::array::from_fn(|n| [0, 1, 65535, 900][n % 4]),
        ),
    ]
}

fn written(frames: &[DepthFrame]) -> (tempfile::TempDir, std::path::PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("raw.mcap");
    let target = Target::File {
        path: path.clone(),
        overwrite: false,
    };
    let mut writer = RawWriter::create(target, &camera(), &WriterOptions::default()).unwrap();
    let mut message = Vec::new();
    for frame in frames {
        image_message(&camera(), &frame.depth, &mut message);
        writer.frame(frame.sequence, frame.time, &message).unwrap();
    }
    let summary = writer.finish().unwrap();
    assert_eq!(summary.frames, frames.len() as u64);
    assert_eq!(summary.bytes, std::fs::metadata(&path).unwrap().len());
    (folder, path)
}

fn read(mut source: Box<dyn FrameSource>) -> Vec<DepthFrame> {
    let mut out = Vec::new();
    let mut frame = DepthFrame::default();
    while source.next(&mut frame).unwrap() == Next::Frame {
        out.push(frame.clone());
    }
    out
}

#[test]
fn camera_numbers_times_and_integers_come_back() {
    let (_folder, path) = written(&frames());
    let source = sequences::open(&path, &SequenceOptions::default()).unwrap();
    assert_eq!(source.camera(), &camera());
    assert_eq!(read(source), frames());
}

#[test]
fn a_device_clock_without_a_wall_clock_comes_back() {
    let mut without = frames();
    for (n, frame) in without.iter_mut().enumerate() {
        frame.time = FrameTime {
            device_ns: -5 + 7 * n as i64,
            wall_ns: 0,
        };
    }
    let (_folder, path) = written(&without);
    let source = sequences::open(&path, &SequenceOptions::default()).unwrap();
    assert_eq!(read(source), without);
}

#[test]
fn an_empty_capture_is_a_file_without_images() {
    let (_folder, path) = written(&[]);
    assert!(sequences::open(&path, &SequenceOptions::default()).is_err());
}

fn image(frame: &DepthFrame, number: u8) -> ColorFrame {
    ColorFrame {
        sequence: u64::from(number),
        time: frame.time,
        format: "jpeg".to_owned(),
        data: vec![number; 9],
    }
}

#[test]
fn colour_comes_back_beside_its_frames() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("raw.mcap");
    let target = Target::File {
        path: path.clone(),
        overwrite: false,
    };
    let frames = frames();
    let mut writer = RawWriter::create(target, &camera(), &WriterOptions::default()).unwrap();
    let mut message = Vec::new();
    // two before the first frame, of which the newer one waits for it
    writer.color(&image(&frames[0], 1)).unwrap();
    writer.color(&image(&frames[0], 2)).unwrap();
    for (frame, number) in frames.iter().zip([3, 4, 5]) {
        image_message(&camera(), &frame.depth, &mut message);
        writer.frame(frame.sequence, frame.time, &message).unwrap();
        if number > 3 {
            writer.color(&image(frame, number)).unwrap();
        }
    }
    writer.finish().unwrap();
    let mut source = sequences::open(&path, &SequenceOptions::default()).unwrap();
    let (mut frame, mut colors) = (DepthFrame::default(), Vec::new());
    while source.next(&mut frame).unwrap() == Next::Frame {
        colors.push(source.take_color());
    }
    // an image stands behind the frame it was taken with: the frame after it brings it
    assert_eq!(
        colors,
        [None, Some(image(&frames[0], 2)), Some(image(&frames[1], 4))]
    );
}

#[test]
fn parts_of_a_capture_are_whole_by_themselves() {
    let folder = tempfile::tempdir().unwrap();
    let target = Target::File {
        path: folder.path().join("raw.mcap"),
        overwrite: false,
    };
    let options = WriterOptions {
        split: Some(Split::Time(Duration::from_millis(20))),
        ..WriterOptions::default()
    };
    let frames = frames();
    let mut writer = RawWriter::create(target, &camera(), &options).unwrap();
    let mut message = Vec::new();
    for frame in &frames {
        image_message(&camera(), &frame.depth, &mut message);
        writer.frame(frame.sequence, frame.time, &message).unwrap();
    }
    let summary = writer.finish().unwrap();
    assert_eq!((summary.parts, summary.frames), (2, 3));
    let mut all = Vec::new();
    for part in ["raw-001.mcap", "raw-002.mcap"] {
        let path = folder.path().join(part);
        all.extend(read(
            sequences::open(&path, &SequenceOptions::default()).unwrap(),
        ));
    }
    assert_eq!(all, frames);
}

#[test]
fn a_capture_is_looked_into_checked_and_repaired_like_a_recording() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("raw.mcap");
    let mended = folder.path().join("mended.mcap");
    let target = |path: &std::path::Path| Target::File {
        path: path.to_owned(),
        overwrite: true,
    };
    // half a second in each chunk
    let all: Vec<DepthFrame> = (0..200)
        .map(|n| DepthFrame {
            sequence: u64::from(u32::MAX) - 5 + n,
            time: FrameTime {
                device_ns: n as i64 * 10_000_000,
                wall_ns: 1_700_000_000_000_000_000 + n as i64 * 10_000_001,
            },
            depth: (0..15).map(|at| (n * 7 + at * 90) as u16).collect(),
        })
        .collect();
    let mut writer =
        RawWriter::create(target(&path), &camera(), &WriterOptions::default()).unwrap();
    let mut message = Vec::new();
    for frame in &all {
        image_message(&camera(), &frame.depth, &mut message);
        writer.frame(frame.sequence, frame.time, &message).unwrap();
        writer.color(&image(frame, 3)).unwrap();
    }
    writer.finish().unwrap();

    let info = |path| RecordingReader::open(path).unwrap().info();
    let whole = info(&path);
    assert_eq!(
        (whole.frames, whole.width, whole.contact_map.as_str()),
        (200, 5, "none")
    );
    assert_eq!((whole.first, whole.last), (all[0].time, all[199].time));
    assert!(whole.monotonic && !whole.cut && whole.camera == camera());
    let found = check(&path, true, &mut |_| true).unwrap();
    assert_eq!((found.frames, found.gap_count), (200, 0));
    assert!(found.is_sound(), "{:?}", found.faults);

    let bytes = std::fs::read(&path).unwrap();
    let mut broken = bytes.clone();
    let hit = bytes.len() * 2 / 5;
    broken[hit] ^= 1;
    for (name, bytes) in [
        ("cut", &bytes[..bytes.len() * 7 / 10]),
        ("flipped", &broken),
    ] {
        std::fs::write(&path, bytes).unwrap();
        let found = check(&path, true, &mut |_| true).unwrap();
        assert!(!found.is_sound(), "{name}");
        let report = repair(&path, target(&mended)).unwrap();
        assert_eq!(report.frames_kept, found.frames, "{name}");
        assert!(
            report.frames_kept >= 90 && report.frames_kept < 200,
            "{report:?}"
        );
        assert!(
            check(&mended, true, &mut |_| true).unwrap().is_sound(),
            "{name}"
        );
        let source = sequences::open(&mended, &SequenceOptions::default()).unwrap();
        assert_eq!(source.camera(), &camera());
        let kept = read(source);
        assert_eq!(kept.len() as u64, report.frames_kept);
        assert!(kept.iter().all(|frame| all.contains(frame)), "{name}");
    }
}

#[test]
fn a_flip_of_every_byte_of_a_capture_is_found() {
    let (_folder, path) = written(&frames());
    let bytes = std::fs::read(&path).unwrap();
    for at in 0..bytes.len() {
        let mut broken = bytes.clone();
        broken[at] ^= 1 << (at % 8);
        std::fs::write(&path, &broken).unwrap();
        let sound = check(&path, true, &mut |_| true).is_ok_and(|found| found.is_sound());
        assert!(!sound, "byte {at}");
    }
}
