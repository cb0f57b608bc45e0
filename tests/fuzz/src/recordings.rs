//! Recordings and captures: opened, read, sought in, checked and repaired.

use super::files::{InputFile, drain};
use super::mend::mend_chunks;
use super::payloads::is_large;
use saint_live::capture::sequences::{self, SequenceOptions};
use saint_live::codec::{EncodedFrame, PayloadDecoder};
use saint_live::model::file::ModelFile;
use saint_live::recording::{RecordingReader, Target, check, repair};
use std::path::Path;

/// A recording or a model file behind checksums that match.
pub fn recording(data: &[u8]) {
    let mut bytes = data.to_vec();
    mend_chunks(&mut bytes);
    if let Ok(file) = ModelFile::parse(&bytes, Path::new("fuzz")) {
        for part in &file.parts {
            let _ = file.decode(part);
        }
    }
    let file = InputFile::new("mcap", &bytes);
    let mut decode = true;
    if let Ok(mut reader) = RecordingReader::open(&file.path) {
        let mut decoder = PayloadDecoder::new();
        let mut frame = EncodedFrame::default();
        for _ in 0..32 {
            match reader.next_frame(&mut frame) {
                Ok(true) if is_large(&frame.payload) => decode = false,
                Ok(true) if decode => drop(decoder.decode(&frame.payload).map(drop)),
                Ok(true) | Err(_) => {}
                Ok(false) => break,
            }
        }
        let _ = reader.seek(reader.frames() / 2);
        let _ = reader.next_frame(&mut frame);
        reader.take_colors();
        reader.verify();
        let _ = reader.info();
    }
    mended(&file.path, decode);
}

/// A capture of depth images as they came, behind checksums that match.
pub fn raw_capture(data: &[u8]) {
    let mut bytes = data.to_vec();
    mend_chunks(&mut bytes);
    let file = InputFile::new("mcap", &bytes);
    if let Ok(source) = sequences::open(&file.path, &SequenceOptions::default()) {
        drain(source);
    }
    mended(&file.path, true);
}

/// Checked, repaired, and what was repaired checked again: no chunk of it is damaged.
fn mended(path: &Path, decode: bool) {
    let mut left = 64;
    let mut keep_on = |_| {
        left -= 1;
        left > 0
    };
    let _ = check(path, decode, &mut keep_on);
    let whole = path.with_extension("whole.mcap");
    let to = Target::File {
        path: whole.clone(),
        overwrite: true,
    };
    if let Ok(report) = repair(path, to) {
        let again = check(&whole, false, &mut |_| true).expect("a repaired recording");
        assert_eq!(report.frames_kept, again.frames, "{report:?}, {again:?}");
    }
}
