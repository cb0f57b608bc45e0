//! Files that were cut, damaged, or never ours.

use super::*;
use crate::recording::repair;
use std::fs::OpenOptions;
use std::os::unix::fs::FileExt;

#[test]
fn a_cut_at_every_byte_plays_to_the_last_whole_frame() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    let frames = stream(12, 3);
    record(&path, &frames);
    // shortened in place, from the end: a new file for each length takes a hundred times as long
    let file = OpenOptions::new().write(true).open(&path).unwrap();
    let mut before = 12;
    for length in (0..file.metadata().unwrap().len()).rev() {
        file.set_len(length).unwrap();
        let (played, errors) = play(&path);
        assert_eq!(errors.len(), 1, "cut at {length}: {errors:?}");
        assert_eq!(played, frames[..played.len()], "cut at {length}");
        assert!(
            played.len() <= before,
            "cut at {length}: {} frames, {before} with a byte more",
            played.len()
        );
        assert!(
            played.len() + 1 >= before,
            "cut at {length}: a byte cost more than a frame"
        );
        before = played.len();
        if !played.is_empty() {
            let RecordingError::Cut { frame, .. } = errors[0] else {
                panic!("cut at {length}: {errors:?}");
            };
            assert_eq!(frame, played.len() as u64);
            let info = RecordingReader::open(&path).unwrap().info();
            assert!(info.cut && info.index_rebuilt && info.frames == frame);
        }
    }
    assert_eq!(before, 0);
}

#[test]
fn a_flip_of_every_byte_is_found_or_harmless() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    let frames = stream(12, 3);
    record(&path, &frames);
    let bytes = std::fs::read(&path).unwrap();
    let file = OpenOptions::new().write(true).open(&path).unwrap();
    for (at, byte) in bytes.iter().enumerate() {
        let flipped = byte ^ (1 << (at % 8));
        file.write_all_at(&[flipped], at as u64).unwrap();
        let (played, errors) = play(&path);
        assert!(
            played.iter().all(|f| frames.contains(f)),
            "byte {at}: a frame that never was"
        );
        assert!(
            played.len() == 12 || !errors.is_empty(),
            "byte {at}: lost without a word"
        );
        assert!(errors.len() <= 2, "byte {at}: {errors:?}");
        file.write_all_at(&[*byte], at as u64).unwrap();
    }
}

#[test]
fn play_goes_on_at_the_key_frame_after_the_damage() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    let frames = stream(100, 20);
    record(&path, &frames);
    let mut bytes = std::fs::read(&path).unwrap();
    let mut message = Vec::new();
    message::write(&frames[45], &mut message);
    let hit = bytes
        .windows(message.len())
        .position(|w| w == message)
        .unwrap();
    bytes[hit] ^= 0x10;
    std::fs::write(&path, &bytes).unwrap();
    let mut reader = RecordingReader::open(&path).unwrap();
    reader.verify();
    let damaged = reader.info().damaged;
    assert_eq!(damaged.len(), 1);
    let first = damaged[0].frame;
    assert!(first <= 45 && damaged[0].offset < hit as u64);
    let (played, errors) = play(&path);
    assert_eq!(errors.len(), 1);
    assert!(
        errors[0]
            .to_string()
            .contains(&format!("before frame {first}")),
        "{}",
        errors[0]
    );
    let resumed = played[first as usize].sequence - 100;
    assert_eq!(played[..first as usize], frames[..first as usize]);
    assert_eq!(played[first as usize..], frames[resumed as usize..]);
    assert!(resumed > 45 && resumed % 20 == 0, "resumed at {resumed}");
    // the same without the stored index
    bytes.truncate(bytes.len() - 1);
    std::fs::write(&path, &bytes).unwrap();
    let (scanned, errors) = play(&path);
    assert_eq!(scanned, played);
    assert_eq!(errors.len(), 2, "the damage and the cut: {errors:?}");
}

#[test]
fn lengths_beyond_the_file_allocate_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    record(&path, &stream(3, 1));
    let bytes = std::fs::read(&path).unwrap();
    for length in [u64::MAX - 8, 1 << 40] {
        for at in (8..bytes.len() - 9).step_by(7) {
            let mut damaged = bytes.clone();
            damaged[at..at + 8].copy_from_slice(&length.to_le_bytes());
            damaged.pop(); // no stored index: every record is walked
            std::fs::write(&path, &damaged).unwrap();
            let (_, errors) = play(&path);
            assert!(!errors.is_empty());
        }
    }
}

#[test]
fn what_is_no_recording_is_said() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    let open = |path: &Path| RecordingReader::open(path).err().unwrap();
    assert!(matches!(open(&path), RecordingError::Unreadable { .. }));
    assert!(matches!(
        open(folder.path()),
        RecordingError::NotARecording { .. }
    ));
    for bytes in [&b""[..], b"PNG and so on", &[0x89]] {
        std::fs::write(&path, bytes).unwrap();
        assert!(matches!(open(&path), RecordingError::NotARecording { .. }));
    }
    let mut foreign = Vec::new();
    let mut writer = mcap::WriteOptions::new()
        .compression(None)
        .create(io::Cursor::new(&mut foreign))
        .unwrap();
    writer
        .add_channel(0, "lidar", "cdr", &Default::default())
        .unwrap();
    writer.finish().unwrap();
    drop(writer);
    std::fs::write(&path, &foreign).unwrap();
    let error = open(&path).to_string();
    assert!(error.contains("channels: lidar"), "{error}");
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 16, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn any_bytes_are_read_without_panic(tail in proptest::collection::vec(any::<u8>(), 0..400), keep in 0usize..4000) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.mcap");
        record(&path, &stream(5, 2));
        let mut bytes = std::fs::read(&path).unwrap();
        bytes.truncate(keep.max(8));
        bytes.extend(tail);
        std::fs::write(&path, &bytes).unwrap();
        let (played, _) = play(&path);
        prop_assert!(played.len() <= 5 + 400);
    }
}

#[test]
fn attachments_and_metadata_survive_a_repair() {
    let folder = tempfile::tempdir().unwrap();
    let (path, mended) = (folder.path().join("a.mcap"), folder.path().join("b.mcap"));
    let frames = stream(12, 3);
    record(&path, &frames);
    // another program's additions stand between the chunks and the end mark
    let attach = |name: &str, data: &[u8]| {
        let text = |text: &[u8]| [&(text.len() as u32).to_le_bytes()[..], text].concat();
        let mut body = [7u64.to_le_bytes(), 8u64.to_le_bytes()].concat();
        body.extend([text(name.as_bytes()), text(b"text/plain")].concat());
        body.extend((data.len() as u64).to_le_bytes());
        body.extend(data);
        body.extend(crc32fast::hash(&body).to_le_bytes());
        [&[9], &(body.len() as u64).to_le_bytes()[..], &body].concat()
    };
    let note = {
        let text = |text: &str| [&(text.len() as u32).to_le_bytes()[..], text.as_bytes()].concat();
        let map = [text("where"), text("kitchen")].concat();
        let body = [
            text("notes"),
            (map.len() as u32).to_le_bytes().to_vec(),
            map,
        ]
        .concat();
        [&[12], &(body.len() as u64).to_le_bytes()[..], &body].concat()
    };
    let bytes = std::fs::read(&path).unwrap();
    let end = find_record(&bytes, mcap::records::op::DATA_END);
    let mut broken = attach("broken", b"changed on its way");
    let last = broken.len() - 5;
    broken[last] ^= 1;
    let added = [attach("whole", b"kept"), broken, note].concat();
    let whole = [&bytes[..end], &added, &bytes[end..]].concat();
    for cut in [0, 9] {
        // without the end mark and with it; the index is off by what was added in any case
        std::fs::write(&path, &whole[..whole.len() - cut]).unwrap();
        let target = Target::File {
            path: mended.clone(),
            overwrite: true,
        };
        let report = repair(&path, target).unwrap();
        assert_eq!(report.frames_kept, 12);
        assert_eq!((report.attachments_kept, report.metadata_kept), (1, 1));
        let told = report
            .damaged
            .iter()
            .filter(|d| d.offset > 8 && (d.offset as usize) < whole.len());
        assert!(told.count() >= 1, "{:?}", report.damaged);
        let bytes = std::fs::read(&mended).unwrap();
        let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
        let index = &summary.attachment_indexes[..];
        assert_eq!((index.len(), index[0].name.as_str()), (1, "whole"));
        let attachment = mcap::read::attachment(&bytes, &index[0]).unwrap();
        assert_eq!((&*attachment.data, attachment.log_time), (&b"kept"[..], 7));
        let names: Vec<_> = summary
            .metadata_indexes
            .iter()
            .map(|m| m.name.as_str())
            .collect();
        assert!(names.contains(&"notes"), "{names:?}");
        assert_eq!(play(&mended).0, frames);
    }
}

/// Where the first record of this kind stands.
fn find_record(bytes: &[u8], code: u8) -> usize {
    let mut at = mcap::MAGIC.len();
    while bytes[at] != code {
        at += 9 + u64::from_le_bytes(bytes[at + 1..at + 9].try_into().unwrap()) as usize;
    }
    at
}
