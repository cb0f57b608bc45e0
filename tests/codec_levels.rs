//! Coarse to fine: what a decoder that stops early makes of a payload, whole or cut; and streams
//! whose contact distance, mask or effort is not the usual one.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "a test fails by panicking"
)]

mod frames;

use frames::{Chance, Picture, camera, check, draw};
use saint_live::codec::header::{Header, SECTIONS};
use saint_live::codec::{
    CodecError, CodecOptions, DecodedFrame, Decoder, Effort, EncodedFrame, Encoder, Level,
};
use saint_live::contact_map::labels::{INVALID, NO_SPHERE, SaintFrame};
use saint_live::deproject::BLOCK;
use saint_live::fit::contact_distance::ContactDistance;
use saint_live::fit::live::{FitOptions, Modeler};

const SIZE: (u32, u32) = (90, 53);

/// A key frame and five P frames, with what was encoded.
fn stream(picture: Picture) -> Vec<(EncodedFrame, SaintFrame)> {
    let camera = camera(SIZE.0, SIZE.1);
    let fit = FitOptions::default();
    let mut modeler = Modeler::new(&camera, &fit);
    let mut encoder =
        Encoder::new(&camera, CodecOptions::fitted(fit.contact_distance, 30)).unwrap();
    (0..6)
        .map(|number| {
            let frame = draw(&camera, picture, number, 5);
            let (mut saint, mut encoded) = (SaintFrame::default(), EncodedFrame::default());
            let fitted = modeler.model(&frame, &mut saint, &|| false);
            encoder
                .encode(&frame, &saint, fitted.degraded, &mut encoded)
                .unwrap();
            (encoded, saint)
        })
        .collect()
}

/// Where the first `sections` sections of a payload end.
fn end_of(payload: &[u8], sections: usize) -> usize {
    let (header, _, end) = Header::read(payload, 0).unwrap();
    end - header.sections[sections..].iter().sum::<usize>()
}

fn decode_all(level: Level, payloads: &[&[u8]]) -> Vec<DecodedFrame> {
    let mut decoder = Decoder::at(level);
    payloads
        .iter()
        .map(|payload| decoder.decode(payload).unwrap().clone())
        .collect()
}

#[test]
fn a_prefix_decodes_to_the_coarser_frame() {
    for picture in [Picture::NoisySlope, Picture::BallsAndHoles, Picture::Noise] {
        let frames = stream(picture);
        let whole: Vec<&[u8]> = frames.iter().map(|f| &f.0.payload[..]).collect();
        for (level, sections) in [(Level::Blocks, 2), (Level::Spheres, 3)] {
            let cut: Vec<&[u8]> = whole.iter().map(|p| &p[..end_of(p, sections)]).collect();
            assert_eq!(
                decode_all(level, &whole),
                decode_all(level, &cut),
                "{picture:?} {level:?}"
            );
            // one byte less is too little, unless the section is empty
            let (last, before) = (cut[0], end_of(whole[0], sections - 1));
            if last.len() > before {
                let short = Decoder::at(level)
                    .decode(&last[..last.len() - 1])
                    .map(|_| ());
                assert!(
                    matches!(short, Err(CodecError::Truncated { .. })),
                    "{short:?}"
                );
            }
            // a finer decoder refuses it
            let refused = Decoder::new().decode(cut[0]).map(|_| ());
            assert!(matches!(refused, Err(CodecError::Truncated { .. })));
        }
        assert_eq!(SECTIONS, 4);
    }
}

#[test]
fn spheres_show_what_the_full_frame_shows_where_they_explain_it() {
    let frames = stream(Picture::BallsAndHoles);
    let whole: Vec<&[u8]> = frames.iter().map(|f| &f.0.payload[..]).collect();
    let (full, spheres) = (
        decode_all(Level::Full, &whole),
        decode_all(Level::Spheres, &whole),
    );
    let mut same = 0;
    for (full, coarse) in full.iter().zip(&spheres) {
        assert_eq!(full.spheres, coarse.spheres);
        for i in 0..full.depth_m.len() {
            let measured = full.labels[i] != INVALID;
            assert!(measured || coarse.labels[i] == INVALID, "invented at {i}");
            assert_ne!(coarse.labels[i], NO_SPHERE);
            assert_eq!(coarse.labels[i] == INVALID, coarse.depth_m[i] == 0.0);
            same += u32::from(measured && full.depth_m[i] == coarse.depth_m[i]);
        }
    }
    let measured: usize = full
        .iter()
        .map(|f| f.labels.iter().filter(|l| **l != INVALID).count())
        .sum();
    assert!(same as usize * 2 > measured, "{same} of {measured}");
}

#[test]
fn blocks_show_one_sphere_each() {
    let frames = stream(Picture::NoisySlope);
    let whole: Vec<&[u8]> = frames.iter().map(|f| &f.0.payload[..]).collect();
    for frame in decode_all(Level::Blocks, &whole) {
        let (w, h) = (SIZE.0 as usize, SIZE.1 as usize);
        for (y, x) in (0..h).flat_map(|y| (0..w).map(move |x| (y, x))) {
            let corner = y / BLOCK * BLOCK * w + x / BLOCK * BLOCK;
            assert_eq!(frame.labels[y * w + x], frame.labels[corner]);
        }
        assert!(frame.depth_m.iter().filter(|z| **z > 0.0).count() > w * h / 2);
    }
}

#[test]
fn a_changed_contact_distance_begins_a_stream_that_keeps_its_bound() {
    let camera = camera(SIZE.0, SIZE.1);
    let usual = ContactDistance::default();
    let mut modeler = Modeler::new(&camera, &FitOptions::default());
    let mut encoder = Encoder::new(&camera, CodecOptions::fitted(usual, 30)).unwrap();
    let mut decoder = Decoder::new();
    let (mut saint, mut encoded) = (SaintFrame::default(), EncodedFrame::default());
    for number in 0..12 {
        let contact = usual.scaled([1.0, 0.4, 3.0, 3.0][number as usize / 3]);
        modeler.set_contact_distance(&contact);
        encoder.set_contact_distance(contact);
        let frame = draw(&camera, Picture::BallsAndHoles, number, 9);
        modeler.model(&frame, &mut saint, &|| false);
        encoder.encode(&frame, &saint, false, &mut encoded).unwrap();
        assert_eq!(encoded.key, matches!(number, 0 | 3 | 6), "frame {number}");
        let decoded = decoder.decode(&encoded.payload).unwrap();
        let tolerance = CodecOptions::fitted(contact, 30).tolerance;
        check(
            &format!("frame {number}"),
            &camera,
            &frame,
            decoded,
            &tolerance,
        );
    }
}

#[test]
fn a_smoothed_mask_counts_what_it_changes() {
    let camera = camera(SIZE.0, SIZE.1);
    let contact = ContactDistance::default();
    let mut modeler = Modeler::new(&camera, &FitOptions::default());
    let options = CodecOptions {
        smooth_mask: true,
        ..CodecOptions::fitted(contact, 30)
    };
    let mut encoder = Encoder::new(&camera, options).unwrap();
    let mut decoder = Decoder::new();
    let (mut saint, mut encoded) = (SaintFrame::default(), EncodedFrame::default());
    let mut changed = 0;
    for number in 0..8 {
        let mut frame = draw(&camera, Picture::BallsAndHoles, number, 3);
        // single readings far from all others: smoothing drops them, the coder may take them back
        let mut chance = Chance(number);
        for _ in 0..400 {
            let at = chance.below(frame.depth.len() as u64) as usize;
            let (hole, raw) = (chance.below(3) == 0, 300 + chance.below(60_000) as u16);
            frame.depth[at] = if hole { camera.invalid[0] } else { raw };
        }
        modeler.model(&frame, &mut saint, &|| false);
        let report = encoder.encode(&frame, &saint, false, &mut encoded).unwrap();
        let decoded = decoder.decode(&encoded.payload).unwrap();
        let (mut lost, mut invented) = (0, 0);
        for (raw, z) in frame.depth.iter().zip(&decoded.depth_m) {
            let measured = !camera.invalid.contains(raw);
            lost += u32::from(measured && *z == 0.0);
            invented += u32::from(!measured && *z != 0.0);
        }
        // what is invented stands beside what was measured, not in the air
        let (width, unit) = (camera.width as usize, camera.depth_unit_m as f32);
        for (i, z) in decoded.depth_m.iter().enumerate() {
            let (x, y) = (i % width, i / width);
            if *z == 0.0 || !camera.invalid.contains(&frame.depth[i]) {
                continue;
            }
            let rows = y.saturating_sub(8)..(y + 9).min(camera.height as usize);
            let square = rows.flat_map(|y| {
                (x.saturating_sub(8)..(x + 9).min(width)).map(move |x| y * width + x)
            });
            let measured = square
                .map(|i| frame.depth[i])
                .filter(|raw| !camera.invalid.contains(raw))
                .map(|raw| f32::from(raw) * unit);
            let (near, far) = measured.fold((f32::MAX, 0f32), |r, z| (r.0.min(z), r.1.max(z)));
            assert!(
                (0.85 * near..1.15 * far).contains(z),
                "{z} m at {x},{y} between {near} and {far} m"
            );
        }
        assert_eq!(
            (report.lost_pixels, report.invented_pixels),
            (lost, invented)
        );
        // all that is kept is within its bound
        let mut kept = frame.clone();
        for (raw, z) in kept.depth.iter_mut().zip(&decoded.depth_m) {
            if *z == 0.0 {
                *raw = camera.invalid[0];
            } else if camera.invalid.contains(raw) {
                *raw = (f64::from(*z) / camera.depth_unit_m).round() as u16;
            }
        }
        let what = format!("frame {number}");
        check(&what, &camera, &kept, decoded, &options.tolerance);
        changed += lost + invented;
    }
    // one pixel in twenty is a hole
    assert!(changed > 300, "{changed}");
}

#[test]
fn more_effort_takes_no_more_bytes_and_keeps_the_bound() {
    let camera = camera(SIZE.0, SIZE.1);
    let contact = ContactDistance::default();
    let bytes = [Effort::Live, Effort::Max].map(|effort| {
        let mut modeler = Modeler::new(&camera, &FitOptions::default());
        let options = CodecOptions {
            effort,
            ..CodecOptions::fitted(contact, 4)
        };
        let mut encoder = Encoder::new(&camera, options).unwrap();
        let mut decoder = Decoder::new();
        let (mut saint, mut encoded) = (SaintFrame::default(), EncodedFrame::default());
        (0..6)
            .map(|number| {
                let frame = draw(&camera, Picture::BallsAndHoles, number, 3);
                modeler.model(&frame, &mut saint, &|| false);
                encoder.encode(&frame, &saint, false, &mut encoded).unwrap();
                let decoded = decoder.decode(&encoded.payload).unwrap();
                check(
                    &format!("{effort:?} {number}"),
                    &camera,
                    &frame,
                    decoded,
                    &options.tolerance,
                );
                encoded.payload.len()
            })
            .sum::<usize>()
    });
    assert!(bytes[1] <= bytes[0], "{bytes:?}");
}
