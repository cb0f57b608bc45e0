mod cameras;
mod damage;
mod whole;

use super::*;
use crate::codec::EncodedFrame;
use crate::frame::{Camera, ColorFrame, FrameTime, Intrinsics};
use proptest::prelude::*;
use std::io::{self, Write};
use std::path::Path;
use std::sync::{Arc, Mutex};

const FRAME_NS: i64 = 33_333_333;
const WALL_NS: i64 = 1_700_000_000_000_000_000;

fn camera() -> Camera {
    Camera {
        width: 4,
        height: 3,
        intrinsics: Intrinsics {
            fx: 3.5,
            fy: 3.25,
            cx: 1.5,
            cy: 1.0,
        },
        depth_unit_m: 0.001,
        invalid: vec![65535],
        depth_min_m: 0.1,
        depth_max_m: 10.0,
        fps: Some(30.0),
        name: "test".into(),
    }
}

/// Bytes that end with their checksum, as every payload does.
fn payload(n: u64) -> Vec<u8> {
    let mut bytes: Vec<u8> = (0..5 + n % 7).map(|i| (n * 31 + i * 7) as u8).collect();
    bytes.extend(crc32fast::hash(&bytes).to_le_bytes());
    bytes
}

/// `count` frames, a key frame each `every`, payloads that differ.
fn stream(count: u64, every: u64) -> Vec<EncodedFrame> {
    let frame = |n: u64| EncodedFrame {
        sequence: 100 + n,
        time: FrameTime {
            device_ns: 5_000 + n as i64 * FRAME_NS,
            wall_ns: WALL_NS + n as i64 * FRAME_NS + 77,
        },
        key: n.is_multiple_of(every),
        payload: payload(n),
    };
    (0..count).map(frame).collect()
}

fn file(path: &Path) -> Target {
    Target::File {
        path: path.to_owned(),
        overwrite: false,
    }
}

fn create(target: Target) -> RecordingWriter {
    RecordingWriter::create(target, &camera(), &WriterOptions::default()).unwrap()
}

fn record(path: &Path, frames: &[EncodedFrame]) -> RecordingSummary {
    let mut writer = create(file(path));
    for frame in frames {
        writer.frame(frame).unwrap();
    }
    writer.finish().unwrap()
}

/// Every frame that comes, and every error on the way.
fn play(path: &Path) -> (Vec<EncodedFrame>, Vec<RecordingError>) {
    let mut reader = match RecordingReader::open(path) {
        Ok(reader) => reader,
        Err(error) => return (vec![], vec![error]),
    };
    let (mut frames, mut errors) = (vec![], vec![]);
    let mut frame = EncodedFrame::default();
    loop {
        match reader.next_frame(&mut frame) {
            Ok(true) => frames.push(frame.clone()),
            Ok(false) => return (frames, errors),
            Err(error) => errors.push(error),
        }
        assert!(
            errors.len() < 100,
            "errors without end: {:?}",
            errors.last()
        );
    }
}

/// Takes at most `room` bytes, then fails as told.
struct Narrow {
    bytes: Arc<Mutex<Vec<u8>>>,
    room: usize,
    kind: io::ErrorKind,
}

impl Write for Narrow {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let mut kept = self.bytes.lock().unwrap();
        let take = bytes.len().min(self.room - kept.len());
        kept.extend_from_slice(&bytes[..take]);
        if take == 0 && !bytes.is_empty() {
            return Err(self.kind.into());
        }
        Ok(take)
    }
    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

fn narrow(room: usize, kind: io::ErrorKind) -> (Target, Arc<Mutex<Vec<u8>>>) {
    let bytes = Arc::new(Mutex::new(Vec::new()));
    let to = Narrow {
        bytes: Arc::clone(&bytes),
        room,
        kind,
    };
    let target = Target::Pipe {
        name: "pipe".into(),
        to: Box::new(to),
    };
    (target, bytes)
}

#[test]
fn what_is_written_comes_back() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    let mut frames = stream(95, 30);
    frames.remove(40); // the sensor lost one
    let noted = CameraStream {
        name: String::new(),
        camera: camera(),
        notes: [("tolerance".to_owned(), "5 mm".to_owned())].into(),
    };
    let options = WriterOptions::default();
    let mut writer = RecordingWriter::create_rig(file(&path), &[noted], &options).unwrap();
    let picture = |frame: &EncodedFrame| ColorFrame {
        sequence: frame.sequence,
        time: frame.time,
        format: "jpeg".into(),
        data: vec![0xFF, 0xD8, frame.sequence as u8],
    };
    for (n, frame) in frames.iter().enumerate() {
        writer.frame(frame).unwrap();
        if n % 10 == 3 {
            writer.color(&picture(frame)).unwrap();
        }
    }
    let statistics = serde_json::json!({"fps": 30.0});
    writer.statistics(&statistics, frames[93].time).unwrap();
    let summary = writer.finish().unwrap();
    assert_eq!(
        (summary.frames, summary.key_frames, summary.color_frames),
        (94, 4, 10)
    );
    assert_eq!(summary.bytes, std::fs::metadata(&path).unwrap().len());

    let mut reader = RecordingReader::open(&path).unwrap();
    assert_eq!(reader.camera(), &camera());
    assert_eq!(
        (reader.frames(), reader.key_frames()),
        (94, &[0, 30, 59, 89][..])
    );
    let mut frame = EncodedFrame::default();
    let mut pictures = vec![];
    for expected in &frames {
        assert!(reader.next_frame(&mut frame).unwrap());
        assert_eq!(&frame, expected);
        pictures.extend(reader.take_colors());
    }
    assert!(!reader.next_frame(&mut frame).unwrap());
    let expected: Vec<_> = frames.iter().skip(3).step_by(10).map(picture).collect();
    let close = |a: &ColorFrame, b: &ColorFrame| {
        (a.sequence, &a.format, &a.data) == (b.sequence, &b.format, &b.data) && a.time == b.time
    };
    assert_eq!(pictures.len(), expected.len());
    assert!(
        pictures.iter().zip(&expected).all(|(a, b)| close(a, b)),
        "{pictures:?}"
    );

    let info = reader.info();
    assert!(!info.cut && !info.index_rebuilt && info.damaged.is_empty());
    assert_eq!((info.frames, info.key_frames, info.lost_frames), (94, 4, 1));
    assert_eq!((info.width, info.height), (4, 3));
    assert!((info.duration_s - 94.0 * FRAME_NS as f64 * 1e-9).abs() < 1e-9);
    let bits: usize = frames.iter().map(|f| f.payload.len() * 8).sum();
    assert!((info.bits_per_frame.unwrap() - bits as f64 / 94.0).abs() < 1e-9);
    let topics: Vec<_> = info
        .channels
        .iter()
        .map(|c| (c.topic.as_str(), c.messages))
        .collect();
    let expected = [
        ("calibration", 1),
        ("camera", 1),
        ("color", 10),
        ("saint", 94),
        ("statistics", 1),
    ];
    assert_eq!(topics, expected);
    assert_eq!(info.notes["tolerance"], "5 mm");
    assert!(info.generator.starts_with("saint-live "));
}

#[test]
fn stored_index_and_scan_agree() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    record(&path, &stream(100, 25));
    let stored = RecordingReader::open(&path).unwrap().info();
    let mut bytes = std::fs::read(&path).unwrap();
    let end = bytes.len() - mcap::MAGIC.len() - 1;
    bytes[end] ^= 1; // the summary's CRC
    std::fs::write(&path, &bytes).unwrap();
    let mut scanned = RecordingReader::open(&path).unwrap().info();
    assert!(scanned.index_rebuilt && !scanned.cut);
    scanned.index_rebuilt = false;
    assert_eq!(scanned, stored);
}

#[test]
fn other_mcap_readers_open_it() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    record(&path, &stream(70, 30));
    let bytes = std::fs::read(&path).unwrap();
    let options = mcap::read::Options::ValidateChunkCrcs.into();
    let messages = mcap::MessageStream::new_with_options(&bytes, options).unwrap();
    let mut times = vec![];
    let mut saint = 0;
    for message in messages {
        let message = message.unwrap();
        saint += u64::from(message.channel.topic == SAINT_TOPIC);
        times.push(message.log_time);
        if message.channel.topic == CALIBRATION_TOPIC {
            let json: serde_json::Value = serde_json::from_slice(&message.data).unwrap();
            assert_eq!(json["K"][0], 3.5);
            assert_eq!(json["timestamp"]["sec"], 1_700_000_000u64);
        }
    }
    assert_eq!(saint, 70);
    assert!(times.is_sorted());
    let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
    assert!(summary.chunk_indexes.len() >= 5, "two chunks a second");
    for chunk in summary.chunk_indexes {
        assert!(chunk.message_end_time - chunk.message_start_time < 500_000_000);
    }
}

#[test]
fn seek_finds_the_key_frame_before() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    let frames = stream(100, 15);
    record(&path, &frames);
    let mut reader = RecordingReader::open(&path).unwrap();
    let mut frame = EncodedFrame::default();
    for wanted in [99, 0, 14, 15, 16, 61, 60, 59] {
        let seek = reader.seek(wanted).unwrap();
        assert_eq!(seek.position, wanted / 15 * 15);
        for n in seek.position..=wanted {
            assert!(reader.next_frame(&mut frame).unwrap());
            assert_eq!(frame, frames[n as usize]);
        }
        assert_eq!(seek.decode_through, wanted % 15);
    }
    let error = reader.seek(100).unwrap_err();
    assert!(matches!(
        error,
        RecordingError::NoSuchFrame {
            frame: 100,
            frames: 100,
            ..
        }
    ));
    for n in 0..100u64 {
        let seconds = n as f64 * FRAME_NS as f64 * 1e-9;
        assert_eq!(reader.frame_at(seconds), n);
        assert_eq!(reader.frame_at(seconds + 1e-3), n + 1);
    }
    assert_eq!((reader.frame_at(-1.0), reader.frame_at(1e30)), (0, 100));
}

#[test]
fn nothing_is_overwritten_unasked() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    std::fs::write(&path, b"precious").unwrap();
    let options = WriterOptions::default();
    let refused = RecordingWriter::create(file(&path), &camera(), &options)
        .err()
        .unwrap();
    assert!(matches!(refused, RecordingError::Exists { .. }));
    assert!(refused.to_string().contains("--overwrite"), "{refused}");
    assert_eq!(std::fs::read(&path).unwrap(), b"precious");
    let target = Target::File {
        path: path.clone(),
        overwrite: true,
    };
    create(target).finish().unwrap();
    assert_eq!(play(&path).1.len(), 0);
    let missing = file(&folder.path().join("no/such/folder.mcap"));
    let refused = RecordingWriter::create(missing, &camera(), &options)
        .err()
        .unwrap();
    assert!(
        matches!(refused, RecordingError::Unwritable { .. }),
        "{refused}"
    );
}

#[test]
#[allow(clippy::print_stderr)] // a test that is skipped says so
fn a_full_disk_says_what_is_kept() {
    let path = Path::new("/dev/full");
    if !path.exists() {
        eprintln!("skipped: no /dev/full");
        return;
    }
    let options = WriterOptions::default();
    let error = RecordingWriter::create(file(path), &camera(), &options)
        .err()
        .unwrap();
    assert!(
        matches!(
            error,
            RecordingError::DiskFull {
                frames: 0,
                bytes: 0,
                ..
            }
        ),
        "{error}"
    );
    assert!(
        error.to_string().contains("no space left; 0 frames"),
        "{error}"
    );
}

#[test]
fn a_failing_pipe_keeps_its_whole_chunks() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    let frames = stream(200, 15);
    let full = record(&path, &frames).bytes as usize;
    let whole = std::fs::read(&path).unwrap();
    for (room, kind) in [
        (full / 2, io::ErrorKind::BrokenPipe),
        (full / 3, io::ErrorKind::StorageFull),
        (full - 10, io::ErrorKind::Other),
    ] {
        let (target, bytes) = narrow(room, kind);
        let mut writer = create(target);
        let mut error = frames.iter().find_map(|frame| writer.frame(frame).err());
        if error.is_some() {
            let again = writer.frame(&frames[0]).unwrap_err();
            assert!(matches!(again, RecordingError::Finished { .. }), "{again}");
        } else {
            error = writer.finish().err();
        }
        let (frames_kept, bytes_kept) = match (error.unwrap(), kind) {
            (RecordingError::Closed { frames, bytes, .. }, io::ErrorKind::BrokenPipe)
            | (RecordingError::DiskFull { frames, bytes, .. }, io::ErrorKind::StorageFull)
            | (RecordingError::Write { frames, bytes, .. }, io::ErrorKind::Other) => {
                (frames, bytes)
            }
            (other, kind) => panic!("{kind}: {other}"),
        };
        assert!(frames_kept > 0);
        let bytes = bytes.lock().unwrap();
        assert_eq!(bytes[..], whole[..room]);
        std::fs::write(&path, &bytes[..bytes_kept as usize]).unwrap();
        let (played, _) = play(&path);
        assert_eq!(played, frames[..frames_kept as usize]);
    }
}

#[test]
fn a_pipe_gets_the_bytes_of_a_file() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    let frames = stream(70, 30);
    record(&path, &frames);
    let (target, bytes) = narrow(usize::MAX / 2, io::ErrorKind::Other);
    let mut writer = create(target);
    for frame in &frames {
        writer.frame(frame).unwrap();
    }
    assert!(writer.kept_frames() >= 30, "chunks go out while recording");
    drop(writer); // finalises too
    assert_eq!(*bytes.lock().unwrap(), std::fs::read(&path).unwrap());
}

#[test]
fn the_limit_on_messages_holds_and_the_recording_goes_on() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    let mut writer = create(file(&path));
    let frames = stream(2, 1);
    writer.frame(&frames[0]).unwrap();
    let huge = EncodedFrame {
        payload: vec![0; MAX_MESSAGE],
        ..frames[1].clone()
    };
    let error = writer.frame(&huge).unwrap_err();
    assert!(matches!(error, RecordingError::TooLarge { .. }), "{error}");
    writer.frame(&frames[1]).unwrap();
    writer.finish().unwrap();
    assert_eq!(play(&path).0, frames);
}

#[test]
fn an_open_depth_range_and_odd_statistics_times_do_no_harm() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    let open = Camera {
        depth_max_m: f64::INFINITY,
        fps: Some(f64::NAN),
        ..camera()
    };
    let options = WriterOptions::default();
    let mut writer = RecordingWriter::create(file(&path), &open, &options).unwrap();
    let frames = stream(30, 30);
    for frame in &frames {
        let empty = serde_json::json!({});
        writer.statistics(&empty, FrameTime::default()).unwrap();
        writer.frame(frame).unwrap();
    }
    writer.finish().unwrap();
    let reader = RecordingReader::open(&path).unwrap();
    assert_eq!(reader.camera().depth_max_m, f64::MAX);
    assert_eq!(reader.camera().fps, None);
    assert_eq!(play(&path).0, frames);
    let bytes = std::fs::read(&path).unwrap();
    let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
    assert_eq!(
        summary.chunk_indexes.len(),
        3,
        "the beginning, and two half seconds"
    );
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 16, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn the_camera_comes_back_to_the_last_bit(fx in 1.0f64..5000.0, cx in -10.0f64..5000.0, unit in 1e-6f64..1.0) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.mcap");
        let mut camera = camera();
        (camera.intrinsics.fx, camera.intrinsics.cx, camera.depth_unit_m) = (fx, cx, unit);
        let mut writer = RecordingWriter::create(file(&path), &camera, &WriterOptions::default()).unwrap();
        writer.finish().unwrap();
        let reader = RecordingReader::open(&path).unwrap();
        prop_assert_eq!(reader.camera(), &camera);
    }
}
