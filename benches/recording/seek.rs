//! How long until a frame somewhere in a long recording is decoded.

use crate::stages::{FPS, encode_stage, input, model_stage, time_ns};
use saint_live::codec::{EncodedFrame, PayloadDecoder};
use saint_live::contact_map::labels::SaintFrame;
use saint_live::pipeline::packet::ModelReport;
use saint_live::pipeline::stages::{Encode, Model};
use saint_live::recording::{RecordingReader, RecordingWriter, Target, WriterOptions};
use std::path::Path;
use std::time::{Duration, Instant};

const SEEKS: u64 = 300;

/// Writes a recording of this length and looks for frames in it.
pub fn run(length: Duration) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("long.mcap");
    let frames = length.as_secs() * FPS;
    write(&path, frames);
    let bytes = std::fs::metadata(&path).unwrap().len();
    println!("{frames} frames, {bytes} bytes");

    let mut open = Vec::new();
    for _ in 0..20 {
        let start = Instant::now();
        let reader = RecordingReader::open(&path).unwrap();
        open.push(start.elapsed());
        assert_eq!(reader.frames(), frames);
    }
    report("open", &mut open);
    let mut reader = RecordingReader::open(&path).unwrap();
    let (mut any, mut worst, mut state) = (Vec::new(), Vec::new(), 1u64);
    for _ in 0..SEEKS {
        // SplitMix64's multiplier; any spread will do
        state = state.wrapping_mul(0xBF58_476D_1CE4_E5B9).rotate_left(17) + 1;
        let frame = state % frames;
        any.push(seek(&mut reader, frame));
        // the last frame before a key frame needs the most decoding
        let late = (frame / u64::from(FPS as u32) * FPS + FPS - 1).min(frames - 1);
        worst.push(seek(&mut reader, late));
    }
    report("seek and decode, any frame", &mut any);
    report("seek and decode, last P frame of its group", &mut worst);
}

fn write(path: &Path, frames: u64) {
    let (camera, depths) = input();
    let mut model = model_stage(&camera);
    let mut encode = encode_stage(&camera);
    let modelled: Vec<(SaintFrame, ModelReport)> = depths
        .iter()
        .map(|depth| {
            let mut saint = SaintFrame::default();
            let report = Model::model(&mut model, depth, &mut saint, &|| false).unwrap();
            (saint, report)
        })
        .collect();
    let target = Target::File {
        path: path.to_owned(),
        overwrite: false,
    };
    let mut writer = RecordingWriter::create(target, &camera, &WriterOptions::default()).unwrap();
    let mut encoded = EncodedFrame::default();
    for n in 0..frames {
        let at = n as usize % depths.len();
        let mut depth = depths[at].clone();
        depth.sequence = n;
        depth.time.device_ns = time_ns(n);
        let (saint, report) = &modelled[at];
        Encode::encode(&mut encode, &depth, saint, report, &mut encoded).unwrap();
        writer.frame(&encoded).unwrap();
    }
    writer.finish().unwrap();
}

/// Time until `frame` is decoded, everything it refers to included.
fn seek(reader: &mut RecordingReader, frame: u64) -> Duration {
    let start = Instant::now();
    let mut decoder = PayloadDecoder::new();
    let mut encoded = EncodedFrame::default();
    let place = reader.seek(frame).unwrap();
    for _ in 0..=place.decode_through {
        assert!(reader.next_frame(&mut encoded).unwrap());
        decoder.decode(&encoded.payload).unwrap();
    }
    assert_eq!(encoded.sequence, frame);
    start.elapsed()
}

fn report(what: &str, times: &mut [Duration]) {
    times.sort();
    let at = |share: f64| times[((times.len() - 1) as f64 * share) as usize].as_secs_f64() * 1e3;
    println!(
        "{what}: min {:.2} ms, p50 {:.2} ms, p99 {:.2} ms, max {:.2} ms ({} times)",
        at(0.0),
        at(0.5),
        at(0.99),
        at(1.0),
        times.len()
    );
}
