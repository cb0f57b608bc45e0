//! Recordings with wrong bytes: an answer, no panic, and no memory for what is not there.

#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

mod watched;

use saint_live::capture::sequences::{self, SequenceOptions};
use saint_live::capture::synthetic::{SyntheticOptions, SyntheticSource};
use saint_live::capture::{FrameSource, Next};
use saint_live::codec::{CodecOptions, EncodedFrame, Encoder, PayloadDecoder};
use saint_live::contact_map::labels::SaintFrame;
use saint_live::fit::live::{FitOptions, Modeler};
use saint_live::frame::{Camera, ColorFrame, DepthFrame};
use saint_live::recording::raw::{RawWriter, image_message};
use saint_live::recording::{
    RecordingError, RecordingReader, RecordingWriter, Target, WriterOptions, check, repair,
};
use std::path::Path;
use std::sync::atomic::Ordering;
use watched::LARGEST;

/// Mutated files of each sort.
const ROUNDS: u64 = 120;
/// No reader needs more at once for a file of some ten kilobytes: the piece in which a damaged
/// file is searched is the largest.
const MOST: usize = 2 << 20;

fn target(path: &Path) -> Target {
    Target::File {
        path: path.to_owned(),
        overwrite: true,
    }
}

fn frames() -> (Camera, Vec<DepthFrame>) {
    let text = "juggle,size=40x30,paced=false,frames=12";
    let mut source = SyntheticSource::open(SyntheticOptions::parse(text).unwrap()).unwrap();
    let (camera, mut all) = (source.camera().clone(), Vec::new());
    let mut frame = DepthFrame::default();
    while source.next(&mut frame).unwrap() == Next::Frame {
        all.push(frame.clone());
    }
    (camera, all)
}

fn color(depth: &DepthFrame) -> ColorFrame {
    ColorFrame {
        sequence: depth.sequence,
        time: depth.time,
        format: "jpeg".into(),
        data: vec![7; 50],
    }
}

fn recording(path: &Path) {
    let (camera, depths) = frames();
    let mut modeler = Modeler::new(&camera, &FitOptions::default());
    let options = CodecOptions::fitted(FitOptions::default().contact_distance, 4);
    let mut encoder = Encoder::new(&camera, options).unwrap();
    let mut writer =
        RecordingWriter::create(target(path), &camera, &WriterOptions::default()).unwrap();
    let (mut saint, mut encoded) = (SaintFrame::default(), EncodedFrame::default());
    for depth in &depths {
        modeler.model(depth, &mut saint, &|| false);
        encoder.encode(depth, &saint, false, &mut encoded).unwrap();
        writer.color(&color(depth)).unwrap();
        writer.frame(&encoded).unwrap();
    }
    let statistics = serde_json::json!({"fps": 30});
    writer.statistics(&statistics, depths[0].time).unwrap();
    writer.finish().unwrap();
}

fn capture(path: &Path) {
    let (camera, depths) = frames();
    let mut writer = RawWriter::create(target(path), &camera, &WriterOptions::default()).unwrap();
    let mut image = Vec::new();
    for depth in &depths {
        image_message(&camera, &depth.depth, &mut image);
        writer.frame(depth.sequence, depth.time, &image).unwrap();
        writer.color(&color(depth)).unwrap();
    }
    writer.finish().unwrap();
}

/// Everything the program does with a recording.
fn use_recording(path: &Path, mended: &Path) {
    if let Ok(mut reader) = RecordingReader::open(path) {
        reader.verify();
        let _ = reader.info();
        let _ = reader.seek(reader.frames() / 2);
        let mut decoder = PayloadDecoder::new();
        let mut encoded = EncodedFrame::default();
        for _ in 0..40 {
            match reader.next_frame(&mut encoded) {
                Ok(true) => {
                    let _ = decoder.decode(&encoded.payload);
                    let _ = reader.take_colors();
                }
                Ok(false) => break,
                Err(RecordingError::Damaged { .. } | RecordingError::Cut { .. }) => {}
                Err(_) => break,
            }
        }
    }
    let _ = check(path, true, &mut |_| true);
    let _ = repair(path, target(mended));
}

fn use_capture(path: &Path, _: &Path) {
    if let Ok(mut source) = sequences::open(path, &SequenceOptions::default()) {
        let mut frame = DepthFrame::default();
        for _ in 0..40 {
            if matches!(source.next(&mut frame), Ok(Next::End)) {
                break;
            }
            let _ = source.take_color();
        }
    }
}

/// SplitMix64.
fn chance(state: &mut u64) -> u64 {
    *state = state.wrapping_add(0x9E37_79B9_7F4A_7C15);
    let mut z = *state;
    z = (z ^ z >> 30).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    z = (z ^ z >> 27).wrapping_mul(0x94D0_49BB_1331_11EB);
    z ^ z >> 31
}

/// Wrong bytes, wrong lengths, a cut, a piece of the file in another place.
fn mutate(bytes: &mut Vec<u8>, state: &mut u64) {
    for _ in 0..=chance(state) % 3 {
        let at = (chance(state) % bytes.len() as u64) as usize;
        let most = bytes.len() - at;
        let put = |bytes: &mut Vec<u8>, value: &[u8]| {
            let n = value.len().min(most);
            bytes[at..at + n].copy_from_slice(&value[..n]);
        };
        match chance(state) % 6 {
            0 => bytes[at] = chance(state) as u8,
            1 => put(
                bytes,
                &(chance(state) as u32 >> (chance(state) % 24)).to_le_bytes(),
            ),
            2 => put(
                bytes,
                &(chance(state) >> (chance(state) % 60)).to_le_bytes(),
            ),
            3 => put(bytes, &[0xFF; 4]),
            4 => bytes.truncate(at.max(1)),
            _ => {
                let from = (chance(state) % bytes.len() as u64) as usize;
                let piece = bytes[from..(from + 64).min(bytes.len())].to_vec();
                put(bytes, &piece);
            }
        }
    }
}

/// One test: the allocator watches all threads.
#[test]
fn wrong_bytes_take_no_memory_and_never_panic() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    type Make = fn(&Path);
    type Use = fn(&Path, &Path);
    let sorts: [(&str, Make, Use); 2] = [
        ("recording", recording, use_recording),
        ("capture", capture, use_capture),
    ];
    for (name, make, user) in sorts {
        let (whole, broken, mended) =
            (path("whole.mcap"), path("broken.mcap"), path("mended.mcap"));
        make(&whole);
        let bytes = std::fs::read(&whole).unwrap();
        for round in 0..ROUNDS {
            let (mut bytes, mut state) = (bytes.clone(), round);
            mutate(&mut bytes, &mut state);
            std::fs::write(&broken, &bytes).unwrap();
            LARGEST.store(0, Ordering::Relaxed);
            user(&broken, &mended);
            let largest = LARGEST.load(Ordering::Relaxed);
            assert!(
                largest <= MOST,
                "{name}, round {round}: {largest} bytes at once for a file of {}",
                bytes.len()
            );
        }
    }
}
