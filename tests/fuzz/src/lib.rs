//! What the fuzzers call: bytes from outside go in; anything but an error or a sound result is a
//! finding.

use saint_live::capture::Next;
use saint_live::capture::containers::rvl;
use saint_live::capture::sequences::{self, SequenceOptions};
use saint_live::cloud::{Cloud, CloudFormat};
use saint_live::codec::header::Header;
use saint_live::codec::{DecodedFrame, Decoder, EncodedFrame, merged, polar};
use saint_live::contact_map::labels::{INVALID, NO_SPHERE};
use saint_live::frame::{DepthFrame, Intrinsics};
use saint_live::intrinsics::Calibration;
use saint_live::model::Geometry;
use saint_live::model::file::ModelFile;
use saint_live::recording::{RecordingReader, Target, check, repair};
use std::cell::RefCell;
use std::path::{Path, PathBuf};

mod mend;

use mend::{mend_chunks, sealed};

/// All targets by name.
pub const TARGETS: [(&str, fn(&[u8])); 5] = [
    ("sensor", sensor),
    ("cloud_payload", cloud_payload),
    ("recording", recording),
    ("cloud_file", cloud_file),
    ("sequence", sequence),
];

/// Larger frames take time only.
const MOST_PIXELS: u64 = 1 << 14;

/// Sensor payloads one after the other, each after its length (u32, little endian), with their
/// checksums repaired.
pub fn sensor(data: &[u8]) {
    let (mut decoder, mut rest) = (Decoder::new(), data);
    while let Some((length, behind)) = rest.split_first_chunk::<4>() {
        let length = u32::from_le_bytes(*length) as usize;
        let (payload, behind) = behind.split_at(length.min(behind.len()));
        rest = behind;
        let body = &payload[..payload.len().saturating_sub(4)];
        let pixels = Header::read(body, 0)
            .ok()
            .and_then(|(header, ..)| header.stream)
            .map_or(0, |s| u64::from(s.width) * u64::from(s.height));
        if pixels > MOST_PIXELS {
            return;
        }
        let _ = decoder.decode(payload).map(sound);
        let _ = decoder.decode(&sealed(body)).map(sound);
    }
}

fn sound(frame: &DecodedFrame) {
    let pixels = frame.camera.pixels();
    assert_eq!((frame.depth_m.len(), frame.labels.len()), (pixels, pixels));
    for (&z, &label) in frame.depth_m.iter().zip(&frame.labels) {
        assert!(z.is_finite() && z >= 0.0, "{z} m");
        assert_eq!(z == 0.0, label == INVALID, "{z} m, label {label}");
        let sphere = frame.spheres.get(usize::from(label));
        let named = matches!(label, NO_SPHERE | INVALID) || matches!(sphere, Some(Some(_)));
        assert!(named, "label {label} names no sphere");
    }
}

/// A polar or a merged payload with its checksum repaired. What decodes is what would be written.
pub fn cloud_payload(data: &[u8]) {
    let data = sealed(&data[..data.len().saturating_sub(4)]);
    let mut again = Vec::new();
    if let Ok(map) = polar::decode(&data) {
        polar::encode(&map, &mut again).unwrap();
        assert_eq!(again, data);
    } else if let Ok(model) = merged::decode(&data) {
        merged::encode(&model, &mut again).unwrap();
        assert_eq!(again, data);
    }
    if let Ok(geometry) = Geometry::decode(&data) {
        let spheres = geometry.spheres().len();
        for (_, sphere) in geometry.points() {
            assert!((sphere as usize) < spheres);
        }
    }
}

/// A recording or a model file, as it is and with the checksums of its chunks repaired: opened,
/// sought in, checked, repaired.
pub fn recording(data: &[u8]) {
    let mut mended = data.to_vec();
    mend_chunks(&mut mended);
    for bytes in [data, &mended] {
        let _ = ModelFile::parse(bytes, Path::new("fuzz")).map(|file| {
            for part in &file.parts {
                let _ = file.decode(part);
            }
        });
        with_file("mcap", bytes, |path| {
            if let Ok(mut reader) = RecordingReader::open(path) {
                let mut frame = EncodedFrame::default();
                for _ in 0..64 {
                    if !matches!(reader.next_frame(&mut frame), Ok(true)) {
                        break;
                    }
                }
                let _ = reader.seek(reader.frames() / 2);
                let _ = reader.next_frame(&mut frame);
                reader.take_colors();
                reader.verify();
                let _ = reader.info();
            }
            let mut left = 64;
            let _ = check(path, false, &mut |_| {
                left -= 1;
                left > 0
            });
            let to = Target::Pipe {
                name: "nowhere".to_owned(),
                to: Box::new(std::io::sink()),
            };
            let _ = repair(path, to);
        });
    }
}

/// A point cloud file; the first byte says which kind.
pub fn cloud_file(data: &[u8]) {
    let Some((kind, bytes)) = data.split_first() else {
        return;
    };
    let format = match kind % 5 {
        0 => CloudFormat::Ply,
        1 => CloudFormat::Pcd,
        2 => CloudFormat::Obj,
        3 => CloudFormat::Xyz,
        _ => CloudFormat::Npy,
    };
    if let Ok(cloud) = Cloud::parse(bytes, format) {
        // a point takes at least a byte
        assert!(cloud.positions.len() <= bytes.len());
    }
}

/// Endings of the files that [`sequence`] tries, by the first byte.
pub const ENDINGS: [&str; 7] = ["exr", "png", "bag", "mcap", "mkv", "sens", "rvl"];

/// A depth image or another program's recording; the first byte says which.
pub fn sequence(data: &[u8]) {
    let Some((kind, bytes)) = data.split_first() else {
        return;
    };
    let ending = ENDINGS[usize::from(*kind) % ENDINGS.len()];
    if ending == "rvl" {
        let mut depth = Vec::new();
        if rvl::decode(bytes, 1000, &mut depth).is_ok() {
            assert_eq!(depth.len(), 1000);
        }
        return;
    }
    let lens = Intrinsics {
        fx: 60.0,
        fy: 60.0,
        cx: 30.0,
        cy: 20.0,
    };
    let given = SequenceOptions {
        calibration: Some(Calibration::from_intrinsics(lens)),
        ..SequenceOptions::default()
    };
    with_file(ending, bytes, |path| {
        for options in [&SequenceOptions::default(), &given] {
            let Ok(mut source) = sequences::open(path, options) else {
                continue;
            };
            let mut frame = DepthFrame::default();
            for _ in 0..16 {
                match source.next(&mut frame) {
                    Ok(Next::Frame) => {
                        assert_eq!(frame.depth.len(), source.camera().pixels());
                        source.take_color();
                    }
                    Ok(Next::End) => break,
                    Ok(Next::Waiting(_)) | Err(_) => {}
                }
            }
        }
        if ending == "png" {
            let _ = Calibration::read(path);
        }
    });
}

/// Runs `body` on a file of these bytes.
fn with_file(ending: &str, bytes: &[u8], body: impl FnOnce(&Path)) {
    thread_local! {
        static FOLDER: RefCell<Option<(tempfile::TempDir, PathBuf)>> = const { RefCell::new(None) };
    }
    let path = FOLDER.with_borrow_mut(|folder| {
        let (_, path) = folder.get_or_insert_with(|| {
            let memory = Path::new("/dev/shm");
            let folder = if memory.is_dir() {
                tempfile::tempdir_in(memory)
            } else {
                tempfile::tempdir()
            }
            .unwrap();
            let path = folder.path().join("input");
            (folder, path)
        });
        path.with_extension(ending)
    });
    std::fs::write(&path, bytes).unwrap();
    body(&path);
}
