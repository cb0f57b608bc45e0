//! Frames through fit, encoder and decoder: the mask exactly, depth within its bound.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "a test fails by panicking"
)]

mod frames;

use frames::{Chance, PICTURES, Picture, camera, check, draw, options};
use glam::Vec3;
use saint_live::codec::{CodecError, CodecOptions, Decoder, EncodedFrame, Encoder, Tolerance};
use saint_live::contact_map::assign::BlockContacts;
use saint_live::contact_map::labels::{Contacts, INVALID, NO_SPHERE, SaintFrame};
use saint_live::fit::contact_distance::ContactDistance;
use saint_live::fit::live::{FitOptions, Modeler};
use saint_live::fit::sphere::Sphere;
use saint_live::frame::DepthFrame;

/// Bounds tried: the default, tight, below half a unit, and so wide that anything touches.
fn contacts() -> [ContactDistance; 4] {
    [
        ContactDistance::default(),
        ContactDistance::constant(0.005),
        ContactDistance::constant(0.0003),
        ContactDistance::constant(2.0),
    ]
}

/// Which frames of a chain are coded plainly.
type Plain = fn(u64) -> bool;

/// Five frames: a key frame and four that refer to each other.
fn chain(size: (u32, u32), picture: Picture, contact: ContactDistance, lossless: bool, seed: u64) {
    coded(size, picture, options(contact, lossless, 30), seed, |_| {
        false
    });
}

fn coded(size: (u32, u32), picture: Picture, with: CodecOptions, seed: u64, plain: Plain) {
    let camera = camera(size.0, size.1);
    let Tolerance { contact, lossless } = with.tolerance;
    let fit = FitOptions {
        contact_distance: with.contact,
        ..FitOptions::default()
    };
    let mut modeler = Modeler::new(&camera, &fit);
    let mut encoder = Encoder::new(&camera, with).unwrap();
    let mut decoder = Decoder::new();
    let (mut saint, mut encoded) = (SaintFrame::default(), EncodedFrame::default());
    for number in 0..5 {
        let frame = draw(&camera, picture, number, seed);
        let report = modeler.model(&frame, &mut saint, &|| false);
        let coded = if plain(number) {
            encoder.encode_plainly(&frame, &saint, &mut encoded)
        } else {
            encoder.encode(&frame, &saint, report.degraded, &mut encoded)
        };
        let coded = coded.unwrap();
        let what = format!("{picture:?} {size:?} {contact} lossless {lossless} frame {number}");
        assert_eq!(coded.valid_pixels, report.valid_pixels, "{what}");
        let spent = coded.spent();
        assert_eq!(spent.total(), 8 * encoded.payload.len() as u64, "{what}");
        assert!(spent.mask >= u64::from(coded.mask_bits), "{what}");
        assert_eq!(encoded.key, number == 0, "{what}");
        let decoded = decoder
            .decode(&encoded.payload)
            .unwrap_or_else(|error| panic!("{what}: {error}"));
        check(&what, &camera, &frame, decoded, &with.tolerance);
        let (width, height) = (size.0 as usize, size.1 as usize);
        let mut blocks = vec![Vec::new(); width.div_ceil(8) * height.div_ceil(8)];
        for (i, (&raw, &back)) in frame.depth.iter().zip(&decoded.depth_m).enumerate() {
            if back > 0.0 {
                let block = i / width / 8 * width.div_ceil(8) + i % width / 8;
                let depth_m = (f64::from(raw) * camera.depth_unit_m) as f32;
                blocks[block].push(depth_m - back);
            }
        }
        for (first, every) in [(0, 1), (number as usize, 3)] {
            let mut errors = Vec::new();
            encoder.errors(&frame, (first, every), |error| errors.push(error));
            let some = blocks.iter().skip(first).step_by(every);
            assert_eq!(
                errors,
                some.flatten().copied().collect::<Vec<_>>(),
                "{what}"
            );
        }
        let stale = DepthFrame {
            sequence: number + 1,
            ..frame
        };
        encoder.errors(&stale, (0, 1), |_| panic!("{what}: not the last frame"));
    }
}

#[test]
fn hard_pictures_of_odd_sizes_keep_mask_and_bound() {
    for size in [(2, 2), (17, 9), (8, 8), (9, 64), (40, 2)] {
        for picture in PICTURES {
            for contact in contacts() {
                for lossless in [false, true] {
                    chain(size, picture, contact, lossless, 1);
                }
            }
        }
    }
}

#[test]
fn a_large_odd_size_keeps_mask_and_bound() {
    chain(
        (641, 481),
        Picture::BallsAndHoles,
        ContactDistance::default(),
        false,
        2,
    );
}

fn small_scene(chance: &mut Chance) -> ((u32, u32), Picture, ContactDistance) {
    let size = (2 + chance.below(40) as u32, 2 + chance.below(30) as u32);
    let picture = PICTURES[chance.below(8) as usize];
    (size, picture, contacts()[chance.below(4) as usize])
}

#[test]
fn random_small_frames_keep_mask_and_bound() {
    let mut chance = Chance(99);
    for seed in 0..150 {
        let (size, picture, contact) = small_scene(&mut chance);
        chain(size, picture, contact, chance.below(4) == 0, seed);
    }
}

/// Frames coded plainly stand between others, as key frames and as P frames.
#[test]
fn plain_frames_keep_mask_and_bound() {
    let mut chance = Chance(31);
    let patterns: [Plain; 4] = [|_| true, |n| n == 0, |n| n == 2, |n| n % 2 == 1];
    for seed in 0..160 {
        let (size, picture, contact) = small_scene(&mut chance);
        let with = options(contact, chance.below(4) == 0, 30);
        coded(
            size,
            picture,
            with,
            seed,
            patterns[chance.below(4) as usize],
        );
    }
}

/// A bound wider or tighter than what the spheres are fitted to is kept as well.
#[test]
fn a_bound_other_than_the_contact_distance_is_kept() {
    let mut chance = Chance(17);
    for seed in 0..120 {
        let (size, picture, contact) = small_scene(&mut chance);
        let mut with = CodecOptions::fitted(contact, 30);
        if chance.below(2) == 0 {
            with.tolerance.contact = contacts()[chance.below(4) as usize];
        }
        coded(size, picture, with, seed, |_| false);
    }
}

#[test]
fn the_default_bound_is_two_and_a_half_contact_distances() {
    let contact = ContactDistance::default();
    let with = CodecOptions::fitted(contact, 30);
    assert!(!with.tolerance.lossless);
    for z in [0.3, 1.0, 2.0, 5.0, 9.0] {
        let (bound, distance) = (with.tolerance.contact.at(z), contact.at(z));
        assert!((bound - 2.5 * distance).abs() < 1e-12, "{bound} at {z} m");
    }
}

/// The same frames give the same bytes, and so does an encoder that went through others before.
#[test]
fn encoding_is_deterministic() {
    let camera = camera(45, 27);
    let with = CodecOptions::fitted(ContactDistance::default(), 30);
    let run = |encoder: &mut Encoder| {
        let mut modeler = Modeler::new(&camera, &FitOptions::default());
        let mut saint = SaintFrame::default();
        encoder.request_key();
        (0..4)
            .map(|number| {
                let frame = draw(&camera, Picture::BallsAndHoles, number, 12);
                modeler.model(&frame, &mut saint, &|| false);
                let mut encoded = EncodedFrame::default();
                encoder.encode(&frame, &saint, false, &mut encoded).unwrap();
                encoded.payload
            })
            .collect::<Vec<_>>()
    };
    let mut encoder = Encoder::new(&camera, with).unwrap();
    let first = run(&mut encoder);
    assert_eq!(first, run(&mut Encoder::new(&camera, with).unwrap()));
    // noise leaves learnt models, numbers and buffers behind; a key frame forgets all of them
    let mut modeler = Modeler::new(&camera, &FitOptions::default());
    let mut saint = SaintFrame::default();
    for number in 0..3 {
        let frame = draw(&camera, Picture::Noise, number, 4);
        modeler.model(&frame, &mut saint, &|| false);
        let mut encoded = EncodedFrame::default();
        encoder.encode(&frame, &saint, false, &mut encoded).unwrap();
    }
    assert_eq!(first, run(&mut encoder));
}

/// The bound does not rest on the fit: any labels and any spheres give the frame back.
#[test]
fn labels_that_make_no_sense_keep_mask_and_bound() {
    let mut chance = Chance(7);
    for round in 0..60 {
        let camera = camera(2 + chance.below(30) as u32, 2 + chance.below(30) as u32);
        let contact = contacts()[chance.below(4) as usize];
        let with = options(contact, chance.below(2) == 0, 30);
        let mut encoder = Encoder::new(&camera, with).unwrap();
        let mut decoder = Decoder::new();
        let mut encoded = EncodedFrame::default();
        for number in 0..4 {
            let picture = PICTURES[chance.below(8) as usize];
            let frame = draw(&camera, picture, number, round);
            let mut float = |scale: f32| {
                let part = chance.below(2001) as f32 / 1000.0 - 1.0;
                part * scale
            };
            let spheres = (0..12)
                .map(|n| {
                    let sphere = Sphere {
                        a: float([1e-6, 0.3, 1e3, 1e30][n % 4]),
                        m: Vec3::new(float(1.0), float(1.0), float([1.0, 1e-3, 1e6][n % 3])),
                        far: n % 5 == 0,
                    };
                    (n != 3).then_some(sphere)
                })
                .collect();
            let label = |chance: &mut Chance| match chance.below(16) {
                15 => INVALID,
                14 => NO_SPHERE,
                label => label as u16,
            };
            let contacts = if number % 2 == 0 {
                let labels = (0..camera.pixels()).map(|_| label(&mut chance));
                Contacts::Labels(labels.collect())
            } else {
                let blocks = camera.width.div_ceil(8) * camera.height.div_ceil(8);
                let block = |_| BlockContacts {
                    palette: std::array::from_fn(|_| label(&mut chance)),
                    pixels: std::array::from_fn(|_| chance.below(1 << 32) << chance.below(33)),
                    ..BlockContacts::default()
                };
                Contacts::Blocks((0..blocks).map(block).collect())
            };
            let saint = SaintFrame {
                spheres,
                contacts,
                ..SaintFrame::default()
            };
            encoder.encode(&frame, &saint, false, &mut encoded).unwrap();
            let what = format!("round {round} frame {number} {picture:?} {contact}");
            let decoded = decoder
                .decode(&encoded.payload)
                .unwrap_or_else(|error| panic!("{what}: {error}"));
            check(&what, &camera, &frame, decoded, &with.tolerance);
        }
    }
}

#[test]
fn what_is_no_frame_of_the_camera_is_refused() {
    let with = options(ContactDistance::default(), false, 30);
    for (width, height) in [(1, 9), (9, 1), (0, 0), (8193, 2), (8192, 8192)] {
        let refused = Encoder::new(&camera(width, height), with);
        assert!(
            matches!(refused, Err(CodecError::Limit(_))),
            "{width}x{height}"
        );
    }
    let camera = camera(8, 8);
    let mut encoder = Encoder::new(&camera, with).unwrap();
    let frame = draw(&camera, Picture::Noise, 0, 0);
    let saint = SaintFrame {
        contacts: Contacts::Labels(vec![NO_SPHERE; 63]),
        ..SaintFrame::default()
    };
    let refused = encoder.encode(&frame, &saint, false, &mut EncodedFrame::default());
    let (found, expected) = (63, 64);
    assert_eq!(refused, Err(CodecError::Size { found, expected }));
    let saint = SaintFrame {
        contacts: Contacts::Blocks(vec![BlockContacts::default(); 2]),
        ..SaintFrame::default()
    };
    let refused = encoder.encode(&frame, &saint, false, &mut EncodedFrame::default());
    let (found, expected) = (128, 64);
    assert_eq!(refused, Err(CodecError::Size { found, expected }));
}
