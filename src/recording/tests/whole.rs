//! Check and repair, parts, and what a disk does to a file.

use super::*;
use crate::recording::{CheckReport, Split, Sync, check, repair};
use std::fs::OpenOptions;
use std::os::unix::fs::FileExt;
use std::time::Duration;

/// Checked without decoding: the payloads of these tests are no frames.
pub(super) fn checked(path: &Path) -> Result<CheckReport, RecordingError> {
    check(path, false, &mut |_| true)
}

fn camera_of(path: &Path) -> Camera {
    RecordingReader::open(path).unwrap().camera().clone()
}

#[test]
fn a_flip_of_every_byte_is_found_by_check() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    record(&path, &stream(4, 2));
    assert!(checked(&path).unwrap().is_sound());
    let bytes = std::fs::read(&path).unwrap();
    let file = OpenOptions::new().write(true).open(&path).unwrap();
    for (at, byte) in bytes.iter().enumerate() {
        file.write_all_at(&[byte ^ (1 << (at % 8))], at as u64)
            .unwrap();
        if let Ok(report) = checked(&path) {
            assert!(!report.is_sound(), "byte {at} of {}", bytes.len());
        }
        file.write_all_at(&[*byte], at as u64).unwrap();
    }
    assert!(checked(&path).unwrap().is_sound());
}

#[test]
fn check_names_the_frames() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    let mut frames = stream(100, 30);
    frames.drain(70..73); // the sensor lost three
    record(&path, &frames);
    let report = checked(&path).unwrap();
    assert!(report.is_sound() && report.frames == 97, "{report:?}");
    let gaps: Vec<_> = report.gaps.iter().map(|g| (g.after, g.missing)).collect();
    assert_eq!((gaps, report.gap_count), (vec![(69, 3)], 1));
    // one byte of frame 40's payload
    damage(&path, &frames[40]);
    let report = checked(&path).unwrap();
    assert_eq!(
        (report.fault_count, report.frames),
        (1, 97 - 30),
        "{report:?}"
    );
    let fault = &report.faults[0];
    assert_eq!((fault.from, fault.to), (Some(30), Some(59)), "{fault:?}");
}

/// Flips a bit in the payload of a frame, where it stands in the file.
fn damage(path: &Path, frame: &EncodedFrame) {
    let mut bytes = std::fs::read(path).unwrap();
    let mut message = Vec::new();
    message::write(frame, &mut message);
    let hit = bytes
        .windows(message.len())
        .position(|window| window == message);
    bytes[hit.unwrap() + message::HEADER + 1] ^= 0x10;
    std::fs::write(path, bytes).unwrap();
}

#[test]
fn order_and_headers_are_checked() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    let change = |n: usize, change: &dyn Fn(&mut EncodedFrame)| {
        let mut frames = stream(12, 6);
        change(&mut frames[n]);
        std::fs::remove_file(&path).ok();
        record(&path, &frames);
        let report = checked(&path).unwrap();
        let first = report.faults.first().cloned();
        (report.fault_count, first.and_then(|f| f.from), report.gaps)
    };
    assert_eq!(change(3, &|f| f.sequence = 102).1, Some(3));
    assert_eq!(change(5, &|f| f.time.device_ns = 0).1, Some(5));
    assert_eq!(change(7, &|f| f.payload[2] ^= 1).1, Some(7));
    let (faults, _, gaps) = change(11, &|f| f.time.device_ns += 10 * FRAME_NS);
    assert_eq!((faults, gaps[0].after, gaps[0].missing), (0, 10, 0));
    let monotonic = RecordingReader::open(&path).unwrap().info().monotonic;
    assert!(monotonic);
}

#[test]
fn repair_makes_a_cut_file_whole() {
    let folder = tempfile::tempdir().unwrap();
    let (path, mended) = (folder.path().join("a.mcap"), folder.path().join("b.mcap"));
    let frames = stream(90, 15);
    let mut writer = create(file(&path));
    for frame in &frames {
        writer.frame(frame).unwrap();
    }
    let statistics = serde_json::json!({"fps": 30.0});
    writer.statistics(&statistics, frames[40].time).unwrap();
    writer.finish().unwrap();
    let length = std::fs::metadata(&path).unwrap().len();
    for cut in [length - 1, length * 2 / 3, length / 2] {
        OpenOptions::new()
            .write(true)
            .open(&path)
            .unwrap()
            .set_len(cut)
            .unwrap();
        let (whole, _) = play(&path);
        let target = Target::File {
            path: mended.clone(),
            overwrite: true,
        };
        let report = repair(&path, target).unwrap();
        assert!(report.cut && report.index_rebuilt, "{report:?}");
        let (kept, errors) = play(&mended);
        assert!(errors.is_empty(), "{errors:?}");
        assert_eq!(kept, whole);
        assert_eq!(kept.len() as u64, report.frames_kept);
        assert_eq!(report.bytes, std::fs::metadata(&mended).unwrap().len());
        assert!(checked(&mended).unwrap().is_sound());
        let info = RecordingReader::open(&mended).unwrap().info();
        assert_eq!(info.notes["repaired_from"], "a.mcap");
        assert_eq!((info.camera, info.cut), (camera(), false));
        assert_eq!(camera_messages(&mended), camera_messages(&path));
    }
}

/// Messages on the cameras' channels.
fn camera_messages(path: &Path) -> Vec<(String, u64)> {
    let info = RecordingReader::open(path).unwrap().info();
    let channels = info.channels.into_iter();
    channels
        .filter(|c| c.topic == CALIBRATION_TOPIC || c.topic == CAMERA_TOPIC)
        .map(|c| (c.topic, c.messages))
        .collect()
}

#[test]
fn repair_leaves_out_what_is_damaged_and_what_needs_it() {
    let folder = tempfile::tempdir().unwrap();
    let (path, mended) = (folder.path().join("a.mcap"), folder.path().join("b.mcap"));
    let frames = stream(100, 20);
    record(&path, &frames);
    damage(&path, &frames[45]);
    let report = repair(&path, file(&mended)).unwrap();
    let (kept, errors) = play(&mended);
    assert!(errors.is_empty() && checked(&mended).unwrap().is_sound());
    assert_eq!(kept.len() as u64, report.frames_kept);
    assert_eq!(report.frames_kept + report.frames_lost, 100);
    assert_eq!(report.damaged.len(), 1);
    assert!(!report.cut && !report.index_rebuilt);
    // from the damaged chunk to the next key frame
    let lost: Vec<_> = (0..100).filter(|n| !kept.contains(&frames[*n])).collect();
    assert!(lost.contains(&45) && lost.len() <= 20, "{lost:?}");
    assert_eq!(lost.last(), Some(&59));
}

#[test]
fn a_lost_beginning_does_not_lose_the_camera() {
    let folder = tempfile::tempdir().unwrap();
    let (path, mended) = (folder.path().join("a.mcap"), folder.path().join("b.mcap"));
    let frames = stream(100, 15);
    record(&path, &frames);
    let mut bytes = std::fs::read(&path).unwrap();
    bytes.truncate(bytes.len() - 20); // no index
    let mut message = Vec::new();
    message::write(&frames[3], &mut message);
    let third = bytes.windows(message.len()).position(|w| w == message);
    // from the first record on, the head of the file and its first frames are gone
    bytes[8..third.unwrap()].fill(0);
    std::fs::write(&path, bytes).unwrap();
    assert_eq!(camera_of(&path), camera());
    let (played, errors) = play(&path);
    assert_eq!(errors.len(), 2, "the damage and the cut: {errors:?}");
    assert_eq!(played, frames[15..]);
    let report = repair(&path, file(&mended)).unwrap();
    assert_eq!(report.frames_kept, 85);
    assert_eq!(play(&mended).0, frames[15..]);
    assert!(checked(&mended).unwrap().is_sound());
    assert_eq!(camera_messages(&mended)[1], ("camera".to_owned(), 1));
}

#[test]
fn a_damaged_length_costs_one_place() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    let frames = stream(150, 15);
    record(&path, &frames);
    let bytes = std::fs::read(&path).unwrap();
    let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
    let chunk = &summary.chunk_indexes[4];
    for length in [0u64, 100, 1000, 1 << 20, u64::MAX / 3] {
        let mut damaged = bytes.clone();
        damaged.truncate(bytes.len() - 20);
        let at = chunk.chunk_start_offset as usize + 1;
        damaged[at..at + 8].copy_from_slice(&length.to_le_bytes());
        std::fs::write(&path, damaged).unwrap();
        let (played, _) = play(&path);
        assert_eq!(played.len(), 135, "length {length}");
        assert_eq!(played[..45], frames[..45]);
        assert_eq!(played[45..], frames[60..]);
    }
}

#[test]
fn parts_play_alone_and_hold_everything() {
    let frames = stream(200, 15);
    for split in [Split::Time(Duration::from_secs(2)), Split::Bytes(40_000)] {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.mcap");
        let options = WriterOptions {
            split: Some(split),
            sync: Sync::Chunk,
        };
        let mut writer = RecordingWriter::create(file(&path), &camera(), &options).unwrap();
        for frame in &frames {
            writer.frame(frame).unwrap();
        }
        let summary = writer.finish().unwrap();
        assert_eq!((summary.frames, summary.key_frames), (200, 14));
        let parts = summary.parts;
        assert!(
            parts == 4 || parts > 1 && split == Split::Bytes(40_000),
            "{parts} {split:?}"
        );
        assert!(!path.exists());
        let (mut all, mut bytes) = (vec![], 0);
        for n in 1..=parts {
            let part = folder.path().join(format!("a-{n:03}.mcap"));
            assert!(checked(&part).unwrap().is_sound());
            let info = RecordingReader::open(&part).unwrap().info();
            assert_eq!(info.notes["part"], n.to_string());
            let (played, errors) = play(&part);
            assert!(errors.is_empty() && played[0].key, "part {n}: {errors:?}");
            if let Split::Bytes(most) = split {
                assert!(info.bytes <= most, "part {n}: {} bytes", info.bytes);
            }
            bytes += info.bytes;
            all.extend(played);
        }
        assert_eq!(all, frames);
        assert_eq!(bytes, summary.bytes);
        let again = RecordingWriter::create(file(&path), &camera(), &options);
        assert!(matches!(again, Err(RecordingError::Exists { .. })));
    }
    let (pipe, _) = narrow(1 << 20, io::ErrorKind::Other);
    let options = WriterOptions {
        split: Some(Split::Bytes(1)),
        ..WriterOptions::default()
    };
    let refused = RecordingWriter::create(pipe, &camera(), &options);
    assert!(matches!(refused, Err(RecordingError::NoParts { .. })));
}

#[test]
fn a_deleted_file_is_noticed() {
    let folder = tempfile::tempdir().unwrap();
    let inner = folder.path().join("inner");
    std::fs::create_dir(&inner).unwrap();
    let path = inner.join("a.mcap");
    let mut writer = create(file(&path));
    let frames = stream(200, 15);
    for frame in &frames[..50] {
        writer.frame(frame).unwrap();
    }
    std::fs::remove_dir_all(&inner).unwrap();
    let error = frames[50..].iter().find_map(|f| writer.frame(f).err());
    let error = error.unwrap();
    assert!(matches!(error, RecordingError::Vanished { .. }), "{error}");
    assert_eq!(error.kept_frames(), Some(0));
    assert_eq!(writer.kept_frames(), 0);
}

#[test]
fn a_colour_image_goes_into_the_part_of_its_frame() {
    let folder = tempfile::tempdir().unwrap();
    let options = WriterOptions {
        split: Some(Split::Time(Duration::from_secs(1))),
        ..WriterOptions::default()
    };
    let target = file(&folder.path().join("a.mcap"));
    let mut writer = RecordingWriter::create(target, &camera(), &options).unwrap();
    for frame in &stream(90, 30) {
        let image = ColorFrame {
            sequence: frame.sequence,
            time: frame.time,
            format: "jpeg".into(),
            data: vec![frame.sequence as u8],
        };
        // as the pipeline does it: the image first, so that who reads the frame has it
        writer.color(&image).unwrap();
        writer.frame(frame).unwrap();
    }
    let summary = writer.finish().unwrap();
    assert_eq!((summary.parts, summary.color_frames), (3, 90));
    for (n, part) in ["a-001.mcap", "a-002.mcap", "a-003.mcap"]
        .iter()
        .enumerate()
    {
        let mut reader = RecordingReader::open(&folder.path().join(part)).unwrap();
        let mut frame = EncodedFrame::default();
        let (mut numbers, mut images) = (Vec::new(), Vec::new());
        while reader.next_frame(&mut frame).unwrap() {
            numbers.push(frame.sequence);
            images.extend(reader.take_colors().iter().map(|image| image.sequence));
        }
        let first = 100 + 30 * n as u64;
        assert_eq!(numbers, (first..first + 30).collect::<Vec<_>>());
        assert_eq!(images, numbers, "{part}");
    }
}
