//! Several cameras in one recording: each comes back whole, by the index and by a scan.

use super::*;
use std::collections::BTreeMap;

fn side(name: &str, width: u32) -> CameraStream {
    CameraStream {
        name: name.into(),
        camera: Camera { width, ..camera() },
        notes: BTreeMap::from([("side".to_owned(), name.to_owned())]),
    }
}

/// Two cameras whose device clocks are an hour apart, frames in turn; the right one starts late.
fn rig(path: &Path) -> [Vec<EncodedFrame>; 2] {
    let left = stream(90, 30);
    let mut right = stream(60, 20);
    for frame in &mut right {
        frame.time.device_ns += 3_600_000_000_000;
        frame.payload.push(200);
    }
    let cameras = [side("left", 4), side("right", 5)];
    let mut writer = RecordingWriter::create_rig(file(path), &cameras).unwrap();
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
    assert_eq!((summary.frames, summary.color_frames), (150, 60));
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
    let [left, right] = rig(&path);
    assert_eq!(frames_of(&path, "left"), (left.clone(), 0));
    assert_eq!(frames_of(&path, "right"), (right, 60));

    let first = RecordingReader::open(&path).unwrap();
    assert_eq!(first.cameras(), ["left", "right"]);
    assert_eq!((first.camera().width, first.frames()), (4, 90));
    assert_eq!(first.notes()["side"], "left");
    let info = RecordingReader::open_camera(&path, "right").unwrap().info();
    assert!(!info.index_rebuilt && !info.cut);
    assert_eq!((info.width, info.frames, info.key_frames), (5, 60, 3));
    let topics: Vec<_> = info.channels.iter().map(|c| c.topic.as_str()).collect();
    let want = ["calibration", "camera", "color", "saint"].map(|t| format!("right/{t}"));
    assert_eq!(topics, want);
    assert_eq!(info.channels[3].messages, 60);

    let Err(error) = RecordingReader::open_camera(&path, "top") else {
        panic!("there is no camera `top`");
    };
    assert!(error.to_string().contains("left, right"), "{error}");
}

#[test]
fn a_cut_file_gives_each_camera_its_first_frames() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("rig.mcap");
    let [left, right] = rig(&path);
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
