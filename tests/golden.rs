//! Payloads of format version 3 that must decode to the same bits for ever.
//!
//! `golden/*.bin` are chains of payloads (each a u32 little-endian length and its bytes),
//! `golden/expected.txt` the checksums of what they decode to. They were written once by the ignored
//! test [`regenerate`]; a change of this library that changes them breaks recordings. Until the
//! version is released, one command writes them anew:
//! `cargo test --test golden -- --ignored regenerate`.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stderr,
    reason = "a test fails by panicking and says what it skips"
)]

mod frames;

use frames::{Chance, Picture, camera, draw};
use saint_live::capture::CaptureError;
use saint_live::capture::synthetic::{Scene, SyntheticOptions, generate};
use saint_live::codec::{CodecOptions, Decoder, Effort, EncodedFrame, Encoder, Tolerance};
use saint_live::contact_map::labels::SaintFrame;
use saint_live::fit::contact_distance::ContactDistance;
use saint_live::fit::live::{FitOptions, Modeler};
use saint_live::fit::motion::Motion;
use saint_live::frame::{Camera, DepthFrame};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::Command;

const CHAINS: [&str; 17] = [
    "room-64x48",
    "walk-53x39",
    "exact-walk-43x30",
    "carried-50x37",
    "balls-50x37",
    "slope-lossless-50x37",
    "checkerboard-lossless-9x64",
    "noise-24x20",
    "wild-26x15",
    "empty-17x9",
    "plain-balls-50x37",
    "plain-noise-lossless-24x20",
    "fast-room-64x48",
    "fast-carried-50x37",
    "fast-wild-26x15",
    "fast-slope-lossless-50x37",
    "fast-plain-balls-50x37",
];

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden")
}

/// The payloads of a file.
fn chain(name: &str) -> Vec<Vec<u8>> {
    let bytes = std::fs::read(folder().join(format!("{name}.bin"))).unwrap();
    payloads(name, &bytes)
}

fn payloads(name: &str, chain: &[u8]) -> Vec<Vec<u8>> {
    let (mut payloads, mut rest) = (Vec::new(), chain);
    while let Some((length, behind)) = rest.split_first_chunk::<4>() {
        let (payload, behind) = behind.split_at(u32::from_le_bytes(*length) as usize);
        payloads.push(payload.to_vec());
        rest = behind;
    }
    assert!(rest.is_empty() && !payloads.is_empty(), "{name}");
    payloads
}

/// What each frame of a chain decodes to: depth (f32) and labels (u16), little endian.
fn decoded(payloads: &[Vec<u8>]) -> Vec<(Vec<u8>, Vec<u8>)> {
    let mut decoder = Decoder::new();
    payloads
        .iter()
        .map(|payload| {
            let frame = decoder.decode(payload).unwrap();
            (
                frame.depth_m.iter().flat_map(|d| d.to_le_bytes()).collect(),
                frame.labels.iter().flat_map(|l| l.to_le_bytes()).collect(),
            )
        })
        .collect()
}

/// One line for each frame: chain, frame, CRC-32 of its depth and of its labels.
fn checksums() -> String {
    let mut text = String::new();
    for name in CHAINS {
        for (number, (depth, labels)) in decoded(&chain(name)).iter().enumerate() {
            let (d, l) = (crc32fast::hash(depth), crc32fast::hash(labels));
            writeln!(text, "{name} {number} {d:08x} {l:08x}").unwrap();
        }
    }
    text
}

#[test]
fn golden_payloads_decode_to_the_same_bits() {
    let expected = std::fs::read_to_string(folder().join("expected.txt")).unwrap();
    for (found, expected) in checksums().lines().zip(expected.lines()) {
        assert_eq!(found, expected, "chain, frame, CRC of depth, CRC of labels");
    }
    assert_eq!(checksums().lines().count(), expected.lines().count());
}

/// The second decoder, written from `src/codec/FORMAT.md`, agrees to the bit.
#[test]
fn the_reference_decoder_agrees() {
    let numpy = Command::new("python3")
        .args(["-c", "import numpy"])
        .output();
    if !numpy.is_ok_and(|run| run.status.success()) {
        eprintln!("skipped: the reference decoder needs python3 with numpy");
        return;
    }
    for name in CHAINS {
        compare(
            name,
            &std::fs::read(folder().join(format!("{name}.bin"))).unwrap(),
        );
    }
    // what today's encoder writes, in other sizes and scenes than the files
    for (name, scene, size, lossless, bound_m) in [
        ("moving camera", Scene::Walk, (61, 45), false, None),
        ("moving camera, lossless", Scene::Walk, (38, 27), true, None),
        (
            "moving camera, 5 mm",
            Scene::Walk,
            (55, 34),
            false,
            Some(0.005),
        ),
        (
            "spheres, 20 mm",
            Scene::Spheres,
            (42, 53),
            false,
            Some(0.02),
        ),
    ] {
        let (camera, frames) = synthetic(scene, size, 4);
        let bound = bound_m.map(ContactDistance::constant);
        let mut with = CodecOptions::fitted(ContactDistance::default(), 30);
        with.tolerance = Tolerance {
            contact: bound.unwrap_or(with.tolerance.contact),
            lossless,
        };
        for effort in [Effort::Live, Effort::Usual] {
            with.effort = effort;
            compare(name, &encode(name, &camera, &frames, with));
        }
    }
}

/// Both decoders give the same planes for a chain.
fn compare(name: &str, chain: &[u8]) {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/reference_decoder.py");
    let out = tempfile::tempdir().unwrap();
    let (input, planes) = (out.path().join("chain"), out.path().join("planes"));
    std::fs::write(&input, chain).unwrap();
    let run = Command::new("python3")
        .args([&script, &input, &planes])
        .output()
        .unwrap();
    assert!(
        run.status.success(),
        "{name}: {}\n{}",
        run.status,
        String::from_utf8_lossy(&run.stderr)
    );
    let found = std::fs::read(&planes).unwrap();
    let mut rest = found.as_slice();
    for (number, (depth, labels)) in decoded(&payloads(name, chain)).iter().enumerate() {
        for (what, size, expected) in [("depth", 4, depth), ("label", 2, labels)] {
            let (this, behind) = rest.split_at(expected.len().min(rest.len()));
            rest = behind;
            let first = this.iter().zip(expected).position(|(a, b)| a != b);
            let at = first.map(|byte| byte / size);
            assert_eq!(at, None, "{name} frame {number}: first {what} that differs");
            assert_eq!(this.len(), expected.len(), "{name} frame {number}: {what}");
        }
    }
    assert!(rest.is_empty(), "{name}");
}

/// Frames of the synthetic sensor.
fn synthetic(scene: Scene, (width, height): (u32, u32), count: u64) -> (Camera, Vec<DepthFrame>) {
    let options = SyntheticOptions {
        width,
        height,
        ..SyntheticOptions::unpaced(scene)
    };
    let (mut of, mut frames) = (camera(2, 2), Vec::new());
    generate(options, count, &mut |camera, frame| {
        of = camera.clone();
        frames.push(frame.clone());
        Ok::<(), CaptureError>(())
    })
    .unwrap();
    (of, frames)
}

/// Frames and the camera they are of.
fn scene(name: &str) -> (Camera, Vec<DepthFrame>) {
    let (picture, size) = match name.trim_start_matches("fast-") {
        "room-64x48" => return synthetic(Scene::Walk, (64, 48), 4),
        "walk-53x39" => return synthetic(Scene::Walk, (53, 39), 4),
        "exact-walk-43x30" => return synthetic(Scene::Walk, (43, 30), 4),
        "carried-50x37" => (Picture::NoisySlope, (50, 37)),
        "balls-50x37" | "plain-balls-50x37" => (Picture::BallsAndHoles, (50, 37)),
        "slope-lossless-50x37" => (Picture::NoisySlope, (50, 37)),
        "checkerboard-lossless-9x64" => (Picture::Checkerboard, (9, 64)),
        "noise-24x20" | "plain-noise-lossless-24x20" => (Picture::Noise, (24, 20)),
        "wild-26x15" => (Picture::BallsAndHoles, (26, 15)),
        "empty-17x9" => (Picture::Invalid, (17, 9)),
        _ => panic!("no chain {name}"),
    };
    let of = camera(size.0, size.1);
    let frames = (0..4).map(|k| draw(&of, picture, k, 7)).collect();
    (of, frames)
}

fn encode(name: &str, camera: &Camera, frames: &[DepthFrame], with: CodecOptions) -> Vec<u8> {
    let mut modeler = Modeler::new(camera, &FitOptions::default());
    let mut encoder = Encoder::new(camera, with).unwrap();
    let (mut saint, mut encoded) = (SaintFrame::default(), EncodedFrame::default());
    let mut bytes = Vec::new();
    for (number, frame) in frames.iter().enumerate() {
        if name.contains("carried") && number > 0 {
            // the same labels on spheres that moved with the camera, a few of them changed
            saint.motion = Motion {
                turn: [41, -97, 13],
                shift: [30, -7, 55],
            };
            let mover = saint.motion.mover();
            for (slot, sphere) in saint.spheres.iter_mut().enumerate() {
                *sphere = sphere.and_then(|s| mover.sphere(&s));
                if let Some(sphere) = sphere.as_mut().filter(|_| slot % 3 == number % 3) {
                    sphere.m *= 1.01;
                    sphere.a += 0.002;
                }
            }
        } else {
            modeler.model(frame, &mut saint, &|| false);
        }
        if name.contains("wild") {
            bend(&mut saint, number);
        }
        // a key frame and a P frame
        let report = if name.contains("plain") && number % 2 == 0 {
            encoder.encode_plainly(frame, &saint, &mut encoded)
        } else {
            encoder.encode(frame, &saint, number == 2, &mut encoded)
        };
        let report = report.unwrap();
        eprintln!(
            "{name} {number}: key {}, {:?}, {report:?}",
            encoded.key, saint.motion
        );
        bytes.extend((encoded.payload.len() as u32).to_le_bytes());
        bytes.extend_from_slice(&encoded.payload);
    }
    bytes
}

/// Spheres and motions that no fit gives: hollows, rays that miss, surfaces through the camera.
fn bend(saint: &mut SaintFrame, number: usize) {
    let mut chance = Chance(number as u64);
    for sphere in saint.spheres.iter_mut().flatten() {
        match chance.below(4) {
            0 => sphere.far = true,
            1 => sphere.a = chance.below(100) as f32 * 0.3 - 15.0,
            2 => sphere.m.z = chance.below(100) as f32 * 0.01,
            _ => {}
        }
    }
    if number > 0 {
        let mut step = || chance.below(65_535) as i32 - 32_767;
        saint.motion = Motion {
            turn: [step(), step(), step()],
            shift: [step(), step(), step()],
        };
    }
}

/// Writes the golden files anew. Only for a new version of the format, beside the old ones.
#[test]
#[ignore = "overwrites the golden files"]
fn regenerate() {
    for name in CHAINS {
        let (camera, frames) = scene(name);
        // the fourth frame is a key frame again
        let mut with = CodecOptions::fitted(ContactDistance::default(), 3);
        with.tolerance.lossless = name.contains("lossless") || name.starts_with("exact");
        if !name.starts_with("fast") {
            with.effort = Effort::Usual;
        }
        let bytes = encode(name, &camera, &frames, with);
        std::fs::write(folder().join(format!("{name}.bin")), bytes).unwrap();
    }
    std::fs::write(folder().join("expected.txt"), checksums()).unwrap();
}
