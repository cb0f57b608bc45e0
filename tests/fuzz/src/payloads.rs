//! Payloads of all kinds, behind checksums that match.

use super::mend::sealed;
use saint_live::codec::header::{Header, SECTIONS};
use saint_live::codec::{DecodedFrame, Decoder, Level, merged, polar};
use saint_live::contact_map::labels::{INVALID, NO_SPHERE};
use saint_live::model::Geometry;

/// Larger frames take time only.
pub const MOST_PIXELS: u64 = 1 << 13;

/// True where a payload starts a stream of frames too large to be tried.
pub fn is_large(payload: &[u8]) -> bool {
    Header::read(payload, 0)
        .ok()
        .and_then(|(header, ..)| header.stream)
        .is_some_and(|s| u64::from(s.width) * u64::from(s.height) > MOST_PIXELS)
}

/// Sensor payloads one after the other, each after its length (u32, little endian), at all levels.
/// Their last four bytes give way to a checksum that matches.
pub fn sensor_payload(data: &[u8]) {
    let levels = [Level::Blocks, Level::Spheres, Level::Full];
    let mut decoders = levels.map(Decoder::at);
    let mut rest = data;
    for _ in 0..32 {
        let Some((length, behind)) = rest.split_first_chunk::<4>() else {
            return;
        };
        let length = u32::from_le_bytes(*length) as usize;
        let (payload, behind) = behind.split_at(length.min(behind.len()));
        rest = behind;
        let payload = sealed(&payload[..payload.len().saturating_sub(4)]);
        if is_large(&payload) {
            return;
        }
        // what a finer level reads, a coarser one reads
        let mut before = true;
        for decoder in &mut decoders {
            let decoded = decoder.decode(&payload).map(sound);
            assert!(before || decoded.is_err(), "a finer level goes on");
            before = decoded.is_ok();
        }
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

/// The header of a sensor payload: what is read is written and read again the same.
pub fn header(data: &[u8]) {
    for wanted in 0..=SECTIONS {
        let Ok((header, sections, end)) = Header::read(data, wanted) else {
            continue;
        };
        let lengths = sections.map(<[u8]>::len);
        assert_eq!(lengths[..wanted], header.sections[..wanted]);
        assert!(wanted < SECTIONS || end <= data.len());
        let mut written = Vec::new();
        header.write(&mut written);
        let again = Header::read(&written, 0).expect("a header as it is written");
        assert_eq!(format!("{header:?}"), format!("{:?}", again.0));
    }
}

/// A polar or a merged payload behind a checksum that matches. What decodes can be written; merged, as
/// the same bytes.
pub fn cloud_payload(data: &[u8]) {
    let data = sealed(&data[..data.len().saturating_sub(4)]);
    let mut again = Vec::new();
    if let Ok(map) = polar::decode(&data) {
        polar::encode(&map, &mut again).expect("a map that was read");
        assert_eq!(polar::decode(&again).as_ref(), Ok(&map));
    } else if let Ok(model) = merged::decode(&data) {
        merged::encode(&model, &mut again).expect("a model that was read");
        assert!(again == data, "not the bytes that a writer writes");
    }
    if let Ok(geometry) = Geometry::decode(&data) {
        let spheres = geometry.spheres().len();
        for (_, sphere) in geometry.points() {
            assert!((sphere as usize) < spheres);
        }
    }
}
