//! Polar payloads of format version 2 that must decode to the same bits for ever, and the second
//! decoder, written from `src/codec/FORMAT.md` alone, that agrees with this one.
//!
//! `golden/*.spol` are payloads, `golden/polar.txt` the checksums of what they hold. Until the
//! version is released, one command writes them anew:
//! `cargo test --test golden_polar -- --ignored regenerate`.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stderr,
    reason = "a test fails by panicking and says what it skips"
)]

use saint_live::capture::CaptureError;
use saint_live::capture::synthetic::{Scene, SyntheticOptions, generate};
use saint_live::codec::polar;
use saint_live::contact_map::labels::SaintFrame;
use saint_live::contact_map::merged::ClaimMap;
use saint_live::contact_map::polar::{MAX_STEPS, Patch, PatchCell};
use saint_live::contact_map::polar_frame::PolarMapper;
use saint_live::fit::live::{FitOptions, Modeler};
use std::path::{Path, PathBuf};
use std::process::Command;

const PAYLOADS: [&str; 4] = ["room-96x72", "lattice", "wild", "nothing"];

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden")
}

fn payload(name: &str) -> Vec<u8> {
    std::fs::read(folder().join(format!("{name}.spol"))).unwrap()
}

/// Origin, step, and each sphere's floats, number of claims, rows and columns; little endian.
fn listed(map: &ClaimMap) -> Vec<u8> {
    let mut out: Vec<u8> = map
        .origin
        .to_array()
        .iter()
        .flat_map(|v| v.to_le_bytes())
        .collect();
    out.extend(map.step_m.to_le_bytes());
    for (s, patch) in map.patches.iter().enumerate() {
        for v in patch
            .anchor
            .to_array()
            .iter()
            .chain(&patch.normal.to_array())
        {
            out.extend(v.to_le_bytes());
        }
        out.extend(patch.curvature.to_le_bytes());
        out.extend((map.claims(s).len() as u32).to_le_bytes());
        for cell in map.claims(s) {
            out.extend(cell.row.to_le_bytes());
            out.extend(cell.column.to_le_bytes());
        }
    }
    out
}

fn checksums() -> String {
    let line = |name: &&str| {
        let map = polar::decode(&payload(name)).unwrap();
        format!("{name} {:08x}\n", crc32fast::hash(&listed(&map)))
    };
    PAYLOADS.iter().map(line).collect()
}

#[test]
fn golden_payloads_hold_the_same_bits() {
    let expected = std::fs::read_to_string(folder().join("polar.txt")).unwrap();
    assert_eq!(checksums(), expected);
}

#[test]
fn payloads_are_written_the_same() {
    for name in ["lattice", "wild", "nothing"] {
        let mut bytes = Vec::new();
        polar::encode(&map(name), &mut bytes).unwrap();
        assert_eq!(bytes, payload(name), "{name}");
    }
}

#[test]
fn the_reference_decoder_agrees() {
    let python = Command::new("python3").arg("--version").output();
    if !python.is_ok_and(|run| run.status.success()) {
        eprintln!("skipped: the reference decoder needs python3");
        return;
    }
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/reference_polar.py");
    let folder = tempfile::tempdir().unwrap();
    let (input, out) = (folder.path().join("payload"), folder.path().join("out"));
    let mut today = Vec::new();
    polar::encode(&map("room-96x72"), &mut today).unwrap();
    let written = PAYLOADS.map(|name| (name, payload(name)));
    for (name, bytes) in written.into_iter().chain([("today's", today)]) {
        std::fs::write(&input, &bytes).unwrap();
        let run = Command::new("python3")
            .args([&script, &input, &out])
            .output()
            .unwrap();
        let said = String::from_utf8_lossy(&run.stderr);
        assert!(run.status.success(), "{name}: {}\n{said}", run.status);
        let expected = listed(&polar::decode(&bytes).unwrap());
        let found = std::fs::read(&out).unwrap();
        let first = found.iter().zip(&expected).position(|(a, b)| a != b);
        assert_eq!(first, None, "{name}: first byte that differs");
        assert_eq!(found.len(), expected.len(), "{name}");
    }
}

fn map(name: &str) -> ClaimMap {
    match name {
        "room-96x72" => room(),
        "lattice" => lattice(),
        "wild" => wild(),
        "nothing" => claims(1.0, &[]),
        _ => panic!("no payload {name}"),
    }
}

/// A frame of the synthetic sensor.
fn room() -> ClaimMap {
    let options = SyntheticOptions {
        width: 96,
        height: 72,
        ..SyntheticOptions::unpaced(Scene::Room)
    };
    let mut map = None;
    generate(options, 1, &mut |camera, frame| {
        let mut saint = SaintFrame::default();
        Modeler::new(camera, &FitOptions::default()).model(frame, &mut saint, &|| false);
        let mut mapper = PolarMapper::new(camera, 0.02);
        map = Some(mapper.map(frame, &saint).unwrap().0);
        Ok::<(), CaptureError>(())
    })
    .unwrap();
    map.unwrap()
}

fn claims(step_m: f32, spheres: &[(Patch, Vec<(i32, i32)>)]) -> ClaimMap {
    let mut map = ClaimMap {
        origin: [448_262.0, 5_411_932.0, -113.5].into(),
        step_m,
        patches: spheres.iter().map(|s| s.0).collect(),
        starts: vec![0],
        cells: Vec::new(),
    };
    for (_, own) in spheres {
        let cell = |&(row, column): &(i32, i32)| PatchCell { row, column };
        let mut own: Vec<PatchCell> = own.iter().map(cell).collect();
        own.sort();
        own.dedup();
        map.cells.extend(own);
        map.starts.push(map.cells.len() as u32);
    }
    map
}

/// Points of a slanted lattice, ever sparser; a full square; its corners.
fn lattice() -> ClaimMap {
    let patch = Patch {
        anchor: [0.5, -0.25, 2.0].into(),
        normal: [0.0, 0.6, -0.8].into(),
        curvature: 0.125,
    };
    let mut spheres = Vec::new();
    for (n, spread) in [1.3, 2.1, 4.7, 11.0, 40.0].into_iter().enumerate() {
        let lattice = (-20..20).flat_map(|v| {
            (-12..12).map(move |u| {
                let (u, v) = (f64::from(u), f64::from(v));
                let (row, column) = (v + 0.16 * u, 1.1 * u - 0.13 * v);
                (
                    (spread * row).floor() as i32,
                    (spread * column).floor() as i32,
                )
            })
        });
        let curvature = patch.curvature * n as f32;
        spheres.push((Patch { curvature, ..patch }, lattice.collect()));
    }
    let square = (-9..30).flat_map(|row| (3..50).map(move |column| (row, column)));
    spheres.push((patch, square.collect()));
    spheres.push((patch, vec![(-9, 3), (-9, 49), (29, 3), (29, 49)]));
    claims(0.005, &spheres)
}

/// Spheres and claims that no fit gives.
fn wild() -> ClaimMap {
    let patch = |normal: [f32; 3], curvature| Patch {
        anchor: [-0.0, f32::MIN_POSITIVE, 1e30].into(),
        normal: normal.into(),
        curvature,
    };
    let far = [-MAX_STEPS, -MAX_STEPS + 9, -1, 0, MAX_STEPS];
    let corners = far.iter().flat_map(|&row| far.map(|column| (row, column)));
    claims(
        1e-30,
        &[
            (patch([0.0, -1.0, 0.0], f32::MAX), vec![]),
            (patch([0.0, -1.0, 0.0], f32::MAX), vec![]),
            (patch([1.0, -0.0, 0.0], -0.0), corners.collect()),
            (
                patch([-0.577_350_3, 0.577_350_3, -0.577_350_3], 1e-42),
                vec![(7, 7)],
            ),
            (
                patch([0.6, 0.8004, 0.0], -3.5),
                vec![(0, 0), (7, 7), (8, 8), (8, -1)],
            ),
            (patch([0.02, 0.02, 0.999], 3.0), vec![(-1, -1)]),
        ],
    )
}

/// Writes the golden files anew. Only for a new version of the format, beside the old ones.
#[test]
#[ignore = "overwrites the golden files"]
fn regenerate() {
    for name in PAYLOADS {
        let mut bytes = Vec::new();
        polar::encode(&map(name), &mut bytes).unwrap();
        std::fs::write(folder().join(format!("{name}.spol")), bytes).unwrap();
    }
    std::fs::write(folder().join("polar.txt"), checksums()).unwrap();
}
