//! The account against the file: what the sensor made is in the recording or counted, whatever
//! fails where.

use super::*;
use crate::pipeline::recorder::Recorder;
use crate::pipeline::stages::Sink;
use crate::recording::{RecordingReader, RecordingWriter, Target, WriterOptions};
use std::io;
use std::sync::{Arc, Mutex};

/// Takes so many bytes, then fails.
struct Narrow {
    bytes: Arc<Mutex<Vec<u8>>>,
    room: usize,
    kind: io::ErrorKind,
}

impl io::Write for Narrow {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let mut kept = self.bytes.lock().unwrap();
        let take = bytes.len().min(self.room.saturating_sub(kept.len()));
        kept.extend_from_slice(&bytes[..take]);
        if take < bytes.len() {
            return Err(self.kind.into());
        }
        Ok(take)
    }
    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// A recorder whose frames are all key frames of a size that fills chunks soon.
struct Padded(Recorder);

impl Sink for Padded {
    fn frame(&mut self, packet: &Packet) -> Result<(), StageError> {
        let mut padded = packet.clone();
        padded.encoded.key = packet.depth.sequence.is_multiple_of(5);
        padded.encoded.time = packet.depth.time;
        padded.encoded.payload.resize(400, 7);
        let body = padded.encoded.payload.len() - 4;
        let check = crc32fast::hash(&padded.encoded.payload[..body]);
        padded.encoded.payload[body..].copy_from_slice(&check.to_le_bytes());
        self.0.frame(&padded)
    }
    fn idle(&mut self) -> Result<(), StageError> {
        self.0.idle()
    }
    fn finish(&mut self) -> Result<(), StageError> {
        self.0.finish()
    }
    fn account(&mut self, drops: &statistics::Drops) {
        self.0.account(drops);
    }
    fn kept(&self) -> Option<u64> {
        self.0.kept()
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 48, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn written_frames_are_the_frames_in_the_file(
        script in proptest::collection::vec(event(), 0..200),
        room in prop_oneof![Just(usize::MAX), 0usize..90_000],
        kind in prop_oneof![
            Just(io::ErrorKind::BrokenPipe),
            Just(io::ErrorKind::StorageFull),
            Just(io::ErrorKind::Other),
        ],
        model_fails in proptest::option::weighted(0.2, 0u64..200),
        pace in prop_oneof![Just(Pace::Block), Just(Pace::Live)],
        threads in prop_oneof![Just(1usize), Just(3)],
    ) {
        let bytes = Arc::new(Mutex::new(Vec::new()));
        let to = Narrow { bytes: Arc::clone(&bytes), room, kind };
        let target = Target::Pipe { name: "pipe".into(), to: Box::new(to) };
        let mut source = MockSource::new(script.clone());
        let Ok(writer) = RecordingWriter::create(target, &source.camera, &WriterOptions::default())
        else {
            return Ok(()); // not even the beginning had room
        };
        let mut sink = Padded(Recorder::new(writer));
        let mut model = MockModel { fail_at: model_fails, ..MockModel::default() };
        let options = Options { pace, ..options(threads) };
        let stages = Stages {
            source: &mut source,
            color: None,
            model: &mut model,
            encode: &mut MockEncode::default(),
            sink: &mut sink,
            trace: None,
            start: None,
        };
        let stop = AtomicBool::new(false);
        let outcome = run(stages, &options, &FakeClock::default(), &stop, &mut |_| ());
        let report = outcome.report;
        let made: u64 = script[..source.at].iter().map(|event| match event {
            Event::Frame | Event::Damaged | Event::Stall => 1,
            Event::Gap(n) => *n,
            _ => 0,
        }).sum();
        prop_assert_eq!(report.sensor_frames, made);
        prop_assert_eq!(made, report.frames + report.drops.total());

        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.mcap");
        std::fs::write(&path, &*bytes.lock().unwrap()).unwrap();
        let mut reader = RecordingReader::open(&path).unwrap();
        reader.verify();
        let info = reader.info();
        // a pipe cannot be shortened: beyond the whole chunks it may hold frames of the last one
        prop_assert!(info.frames >= report.frames, "{} {}", info.frames, report.frames);
        if !info.cut {
            prop_assert_eq!(info.frames, report.frames);
            if let Some(account) = info.account {
                prop_assert_eq!(account.sensor_frames, made);
                prop_assert_eq!(account.frames, report.frames);
                prop_assert_eq!(account.drops["queue"], report.drops.queue);
            }
        }
        if let Some(frames) = sink.0.kept() {
            prop_assert_eq!(frames, report.frames);
        }
    }
}
