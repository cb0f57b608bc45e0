//! Payloads that were cut, damaged or made up: an error or a frame, never a panic.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "a test fails by panicking"
)]

mod frames;

use frames::{Chance, Picture, camera, draw, options};
use saint_live::codec::header::{Header, SECTIONS, Stream, Tolerance};
use saint_live::codec::{CodecError, DecodedFrame, Decoder, Effort, EncodedFrame, Encoder};
use saint_live::contact_map::labels::{INVALID, NO_SPHERE, SaintFrame};
use saint_live::fit::contact_distance::ContactDistance;
use saint_live::fit::live::{FitOptions, Modeler};
use saint_live::fit::motion::Motion;
use saint_live::frame::FrameTime;

/// A key frame, two P frames, and the bytes of their headers. `moved`: the camera moves.
fn chain(lossless: bool, moved: bool, effort: Effort) -> Vec<(Vec<u8>, usize)> {
    let camera = camera(44, 29);
    let mut modeler = Modeler::new(&camera, &FitOptions::default());
    let mut with = options(ContactDistance::default(), lossless, 30);
    with.effort = effort;
    let mut encoder = Encoder::new(&camera, with).unwrap();
    let (mut saint, mut encoded) = (SaintFrame::default(), EncodedFrame::default());
    (0..3)
        .map(|number| {
            let frame = draw(&camera, Picture::BallsAndHoles, number, 3);
            modeler.model(&frame, &mut saint, &|| false);
            if moved {
                saint.motion = Motion {
                    turn: [90, -300, 40],
                    shift: [200, 50, -400],
                };
            }
            let report = encoder.encode(&frame, &saint, false, &mut encoded).unwrap();
            (encoded.payload.clone(), report.header_bytes as usize - 4)
        })
        .collect()
}

fn payloads(lossless: bool) -> Vec<(Vec<u8>, usize)> {
    chain(lossless, false, Effort::Live)
}

/// What any decoded frame holds, whatever the bytes.
#[track_caller]
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

/// The same bytes with a checksum that matches.
fn sealed(body: &[u8]) -> Vec<u8> {
    [body, &crc32fast::hash(body).to_le_bytes()].concat()
}

/// A decoder that has decoded what comes before payload `n`.
fn decoder_before(payloads: &[(Vec<u8>, usize)], n: usize) -> Decoder {
    let mut decoder = Decoder::new();
    for (payload, _) in &payloads[..n] {
        decoder.decode(payload).unwrap();
    }
    decoder
}

#[test]
fn every_prefix_and_every_extra_byte_is_an_error() {
    let payloads = payloads(false);
    for n in 0..2 {
        let whole = &payloads[n].0;
        let body = &whole[..whole.len() - 4];
        for length in 0..whole.len() {
            let mut decoder = decoder_before(&payloads, n);
            assert!(decoder.decode(&whole[..length]).is_err(), "{length} bytes");
        }
        for length in 0..body.len() {
            let mut decoder = decoder_before(&payloads, n);
            let cut = sealed(&body[..length]);
            assert!(decoder.decode(&cut).is_err(), "{length} sealed bytes");
        }
        let mut decoder = decoder_before(&payloads, n);
        assert!(decoder.decode(&[&whole[..], &[0]].concat()).is_err());
        let mut decoder = decoder_before(&payloads, n);
        assert!(decoder.decode(&sealed(&[body, &[0]].concat())).is_err());
    }
}

#[test]
fn every_flipped_bit_is_an_error() {
    let payloads = payloads(false);
    let mut decoder = Decoder::new();
    let whole = &payloads[0].0;
    let mut damaged = whole.clone();
    for at in 0..whole.len() {
        for bit in 0..8 {
            damaged[at] ^= 1 << bit;
            assert!(decoder.decode(&damaged).is_err(), "bit {bit} of byte {at}");
            damaged[at] ^= 1 << bit;
        }
    }
    decoder.decode(whole).unwrap();
}

/// Damage behind a checksum that matches reaches the parsers of the sections.
#[test]
fn sealed_damage_gives_an_error_or_a_frame() {
    for (lossless, moved, effort) in [
        (false, false, Effort::Live),
        (true, false, Effort::Usual),
        (false, true, Effort::Live),
    ] {
        let payloads = chain(lossless, moved, effort);
        let mut chance = Chance(41);
        let (mut errors, mut decoded) = (0, 0);
        for _ in 0..2000 {
            let n = chance.below(3) as usize;
            let (whole, header) = &payloads[n];
            let mut body = whole[..whole.len() - 4].to_vec();
            for _ in 0..=chance.below(4) {
                let at = header + chance.below((body.len() - header) as u64) as usize;
                body[at] = match chance.below(3) {
                    0 => 0,
                    1 => 255,
                    _ => chance.next() as u8,
                };
            }
            let mut decoder = decoder_before(&payloads, n);
            match decoder.decode(&sealed(&body)) {
                Ok(frame) => {
                    assert_eq!(frame.camera.pixels(), 44 * 29);
                    sound(frame);
                    decoded += 1;
                }
                Err(_) => {
                    // it waits for a key frame, and goes on from there
                    let next = decoder.decode(&payloads[1].0).map(|_| ());
                    assert!(matches!(next, Err(CodecError::MissingReference { .. })));
                    errors += 1;
                }
            }
            // whatever it met, the next frames that refer to it do not make it panic
            let _ = decoder.decode(&payloads[n.min(1) + 1].0).map(|_| ());
            decoder.decode(&payloads[0].0).unwrap();
        }
        assert!(errors + decoded == 2000 && decoded > 0);
    }
}

/// Where the blocks of the last frame are looked for follows from motion and spheres: any of both,
/// in every P frame, leaves all pixels inside the image.
#[test]
fn absurd_motions_and_spheres_stay_inside_the_image() {
    let chains = [Effort::Live, Effort::Usual].map(|effort| chain(false, true, effort));
    let mut chance = Chance(77);
    let extremes = [-32_768, -32_767, -1, 0, 1, 32_767];
    let mut decoded = 0;
    for round in 0..1200 {
        let payloads = &chains[round / 2 % 2];
        let mut decoder = decoder_before(payloads, 1);
        for n in 1..3 {
            let (whole, header) = &payloads[n];
            let body = &whole[..whole.len() - 4];
            let (mut read, ..) = Header::read(body, 0).unwrap();
            let mut step = || match chance.below(3) {
                0 => extremes[chance.below(6) as usize],
                _ => chance.below(65_536) as i32 - 32_768,
            };
            read.motion = Motion {
                turn: [step(), step(), step()],
                shift: [step(), step(), step()],
            };
            let mut sections = body[*header..].to_vec();
            if round % 2 == 1 {
                // the section of spheres: any inverse depth, slope and bulge, at any exponent
                let start = read.sections[0];
                for _ in 0..3 {
                    let at = start + chance.below(read.sections[1].max(1) as u64) as usize;
                    sections[at] = chance.next() as u8;
                }
            }
            let mut bytes = Vec::new();
            read.write(&mut bytes);
            bytes.extend_from_slice(&sections);
            match decoder.decode(&sealed(&bytes)) {
                Ok(frame) => {
                    sound(frame);
                    decoded += 1;
                }
                Err(_) => break,
            }
        }
    }
    assert!(decoded > 300, "{decoded} frames decoded");
}

/// Sections of chance bytes: nothing in them means what an encoder would say.
#[test]
fn random_sections_give_an_error_or_a_frame() {
    let chains = [Effort::Live, Effort::Usual].map(|effort| chain(false, true, effort));
    let mut chance = Chance(123);
    let mut decoded = 0;
    for round in 0..1200 {
        let payloads = &chains[round / 3 % 2];
        let n = round % 3;
        let (whole, header) = &payloads[n];
        let (mut read, ..) = Header::read(whole, 0).unwrap();
        let mut bodies = whole[*header..whole.len() - 4].to_vec();
        let mut sections = Vec::new();
        for (k, length) in read.sections.iter_mut().enumerate() {
            let mut section: Vec<u8> = bodies.drain(..*length).collect();
            // one section or all of them
            if round % 5 == k || round % 5 == 4 {
                // few zero bits keep a section from running past its end early
                let ones = [0, 0xF0, 0xFE][round % 7 % 3];
                let length = chance.below(600);
                section = (0..length).map(|_| chance.next() as u8 | ones).collect();
            }
            *length = section.len();
            sections.extend(section);
        }
        let mut bytes = Vec::new();
        read.write(&mut bytes);
        bytes.extend(sections);
        let mut decoder = decoder_before(payloads, n);
        if let Ok(frame) = decoder.decode(&sealed(&bytes)) {
            sound(frame);
            decoded += 1;
        }
        let _ = decoder.decode(&payloads[2].0).map(sound);
    }
    assert!(decoded > 100, "{decoded} frames decoded");
}

#[test]
fn sealed_damage_of_the_header_is_survived() {
    let payloads = payloads(false);
    let mut chance = Chance(5);
    for _ in 0..2000 {
        let n = chance.below(2) as usize;
        let (whole, header) = &payloads[n];
        let mut body = whole[..whole.len() - 4].to_vec();
        let at = chance.below(*header as u64) as usize;
        body[at] = chance.next() as u8;
        // frames far larger than ours only take time
        let size = Header::read(&body, 0)
            .ok()
            .and_then(|(h, ..)| h.stream)
            .map_or(0, |s| u64::from(s.width) * u64::from(s.height));
        if size > 1 << 16 {
            continue;
        }
        let mut decoder = decoder_before(&payloads, n);
        if let Ok(frame) = decoder.decode(&sealed(&body)) {
            sound(frame);
        }
    }
}

#[test]
fn a_p_frame_needs_the_very_frame_before_it() {
    let payloads = payloads(false);
    let missing = |result: Result<_, CodecError>| {
        assert!(matches!(result, Err(CodecError::MissingReference { .. })));
    };
    missing(Decoder::new().decode(&payloads[1].0).map(|_| ()));
    // the key frame, then the second P frame: one is left out
    missing(
        decoder_before(&payloads, 1)
            .decode(&payloads[2].0)
            .map(|_| ()),
    );
    // one twice
    missing(
        decoder_before(&payloads, 2)
            .decode(&payloads[1].0)
            .map(|_| ()),
    );
    decoder_before(&payloads, 2).decode(&payloads[2].0).unwrap();
}

#[test]
fn absurd_cameras_are_refused_before_memory_is_taken() {
    let usual = Stream::new(
        &camera(44, 29),
        Tolerance {
            contact: ContactDistance::default(),
            lossless: false,
        },
    );
    let spoil: [fn(&mut Stream); 12] = [
        |s| s.width = u32::MAX,
        |s| s.height = u32::MAX,
        |s| (s.width, s.height) = (8192, 8192),
        |s| s.width = 0,
        |s| s.height = 1,
        |s| s.intrinsics.fx = 0.0,
        |s| s.intrinsics.fy = f64::NAN,
        |s| s.intrinsics.cx = f64::INFINITY,
        |s| s.depth_unit_m = 0.0,
        |s| s.depth_unit_m = -1.0,
        |s| s.tolerance.contact.floor_m = f64::NAN,
        |s| s.tolerance.contact.per_z2 = 1e9,
    ];
    for (n, spoil) in spoil.into_iter().enumerate() {
        let mut stream = usual;
        spoil(&mut stream);
        let header = Header {
            stream: Some(stream),
            sequence: 0,
            reference: 0,
            time: FrameTime::default(),
            motion: Motion::default(),
            degraded: false,
            plain: false,
            fast: false,
            sections: [0; SECTIONS],
        };
        let mut body = Vec::new();
        header.write(&mut body);
        let refused = Decoder::new().decode(&sealed(&body)).map(|_| ());
        assert!(
            matches!(refused, Err(CodecError::Limit(_))),
            "case {n}: {refused:?}"
        );
    }
}
