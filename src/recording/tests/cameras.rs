//! Several cameras in one recording: each comes back whole, by the index and by a scan.

use super::whole::checked;
use super::*;
use crate::recording::{Split, repair};
use std::time::Duration;

/// Two cameras with clocks of their own, whose key frames come at different times; the right one
/// starts late and has colour.
fn rig(path: &Path, split: Option<Split>) -> [Vec<EncodedFrame>; 2] {
    let cameras = [("left", 4), ("right", 5)].map(|(name, width)| CameraStream {
        name: name.into(),
        camera: Camera { width, ..camera() },
        notes: [("side".to_owned(), name.to_owned())].into(),
    });
    let options = WriterOptions {
        split,
        ..WriterOptions::default()
    };
    let mut writer = RecordingWriter::create_rig(file(path), &cameras, &options).unwrap();
    let left = stream(150, 15);
    let mut right = stream(120, 20);
    for frame in &mut right {
        frame.sequence += 1000;
        frame.time.device_ns += 3_600_000_000_000;
        frame.payload[0] ^= 0xFF;
        let body = frame.payload.len() - 4;
        let check = crc32fast::hash(&frame.payload[..body]);
        frame.payload[body..].copy_from_slice(&check.to_le_bytes());
    }
    for (n, frame) in left.iter().enumerate() {
        writer.frame_of(0, frame).unwrap();
        if let Some(frame) = n.checked_sub(30).map(|n| &right[n]) {
            writer.frame_of(1, frame).unwrap();
            let image = ColorFrame {
                sequence: n as u64,
                time: frame.time,
                format: "jpeg".into(),
                data: vec![n as u8],
            };
            writer.color_of(1, &image).unwrap();
        }
    }
    let summary = writer.finish().unwrap();
    assert_eq!((summary.frames, summary.color_frames), (270, 120));
    [left, right]
}

fn frames_of(path: &Path, name: &str) -> (Vec<EncodedFrame>, usize) {
    let mut reader = RecordingReader::open_camera(path, name).unwrap();
    let (mut frames, mut colors) = (Vec::new(), 0);
    let mut frame = EncodedFrame::default();
    while matches!(reader.next_frame(&mut frame), Ok(true)) {
        frames.push(frame.clone());
        colors += reader.take_colors().len();
    }
    (frames, colors)
}

#[test]
fn each_camera_comes_back_whole() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("rig.mcap");
    let [left, right] = rig(&path, None);
    assert_eq!(frames_of(&path, "left"), (left.clone(), 0));
    assert_eq!(frames_of(&path, "right"), (right, 120));

    let first = RecordingReader::open(&path).unwrap();
    assert_eq!(first.cameras(), ["left", "right"]);
    assert_eq!((first.camera().width, first.frames()), (4, 150));
    assert_eq!(first.notes()["side"], "left");
    let info = RecordingReader::open_camera(&path, "right").unwrap().info();
    assert!(!info.index_rebuilt && !info.cut);
    assert_eq!((info.width, info.frames, info.key_frames), (5, 120, 6));
    let topics: Vec<_> = info.channels.iter().map(|c| c.topic.as_str()).collect();
    let want = ["calibration", "camera", "color", "saint"].map(|t| format!("right/{t}"));
    assert_eq!(topics, want);
    assert_eq!(info.channels[3].messages, 120);

    let Err(error) = RecordingReader::open_camera(&path, "top") else {
        panic!("there is no camera `top`");
    };
    assert!(error.to_string().contains("left, right"), "{error}");
}

#[test]
fn a_cut_file_gives_each_camera_its_first_frames() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("rig.mcap");
    let [left, right] = rig(&path, None);
    let bytes = std::fs::read(&path).unwrap();
    std::fs::write(&path, &bytes[..bytes.len() * 7 / 10]).unwrap();
    for (name, all) in [("left", left), ("right", right)] {
        let reader = RecordingReader::open_camera(&path, name).unwrap();
        assert!(reader.info().cut && reader.info().index_rebuilt);
        let (frames, _) = frames_of(&path, name);
        assert!(!frames.is_empty() && frames.len() < all.len(), "{name}");
        assert_eq!(frames, all[..frames.len()], "{name}");
    }
}

#[test]
fn a_camera_that_is_not_there_takes_no_frame() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("one.mcap");
    let mut writer = create(file(&path));
    let error = writer.frame_of(1, &stream(1, 1)[0]).unwrap_err();
    assert!(error.to_string().contains("no camera number 1"), "{error}");
    writer.frame(&stream(1, 1)[0]).unwrap();
    assert_eq!(writer.finish().unwrap().frames, 1);
}

#[test]
fn cameras_survive_a_scan_and_a_repair() {
    let folder = tempfile::tempdir().unwrap();
    let (path, mended) = (folder.path().join("a.mcap"), folder.path().join("b.mcap"));
    let [left, right] = rig(&path, None);
    assert_eq!(checked(&path).unwrap().frames, 270);
    let mut bytes = std::fs::read(&path).unwrap();
    let end = bytes.len() - 12;
    bytes[end] ^= 1;
    std::fs::write(&path, &bytes).unwrap();
    repair(&path, file(&mended)).unwrap();
    assert!(checked(&mended).unwrap().is_sound());
    for (path, scanned) in [(&path, true), (&mended, false)] {
        let mut reader = RecordingReader::open_camera(path, "right").unwrap();
        assert_eq!(reader.cameras(), ["left", "right"]);
        assert_eq!(reader.camera().width, 5);
        assert_eq!(reader.info().index_rebuilt, scanned);
        assert_eq!(reader.seek(57).unwrap().position, 40);
        assert_eq!(frames_of(path, "left"), (left.clone(), 0));
        assert_eq!(frames_of(path, "right"), (right.clone(), 120));
    }
}

#[test]
fn each_camera_leaves_a_part_at_its_own_key_frame() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    let recorded = rig(&path, Some(Split::Time(Duration::from_secs(1))));
    let mut parts: Vec<_> = std::fs::read_dir(folder.path())
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .collect();
    parts.sort();
    assert!(parts.len() >= 3, "{parts:?}");
    for (name, recorded) in ["left", "right"].iter().zip(recorded) {
        let mut all = vec![];
        for part in &parts {
            let (played, _) = frames_of(part, name);
            assert!(played.first().is_none_or(|frame| frame.key), "{name}");
            all.extend(played);
        }
        assert_eq!(all, recorded, "{name}");
    }
}
