//! Schemes and contact maps from outside: what a script sees.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "a test fails by panicking"
)]

use assert_cmd::Command;
use std::path::Path;

/// Runs the program; on a wrong exit code everything it said is printed.
#[track_caller]
fn run(arguments: &[&str], code: i32) -> (String, String) {
    let mut command = Command::cargo_bin("saint-live").unwrap();
    let output = command.args(arguments).output().unwrap();
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    let (stdout, stderr) = (text(&output.stdout), text(&output.stderr));
    assert_eq!(
        output.status.code(),
        Some(code),
        "\ncommand: {command:?}\nstdout: {stdout}\nstderr: {stderr}\n"
    );
    (stdout, stderr)
}

const CAMERA: &str = "synthetic:room,size=80x60,paced=false,frames=3";

#[track_caller]
fn record(file: &str, more: &[&str]) {
    let arguments = [&["--device", CAMERA, "-q", "-o", file], more].concat();
    run(&arguments, 0);
}

fn info(file: &str) -> serde_json::Value {
    serde_json::from_str(&run(&["info", file, "--json"], 0).0).unwrap()
}

/// Number of vertices a PLY file announces.
fn vertices(path: &Path) -> u64 {
    let bytes = std::fs::read(path).unwrap();
    let header = String::from_utf8_lossy(&bytes[..bytes.len().min(400)]).into_owned();
    let count = header.split("element vertex ").nth(1).unwrap();
    count.lines().next().unwrap().parse().unwrap()
}

/// Depth of the recording NAME.mcap into the folder NAME.
fn export(folder: &tempfile::TempDir, name: &str) {
    let file = folder.path().join(format!("{name}.mcap"));
    let images = folder.path().join(name);
    run(
        &[
            "export",
            file.to_str().unwrap(),
            "-q",
            "--to",
            "exr",
            "-o",
            images.to_str().unwrap(),
        ],
        0,
    );
}

#[test]
fn each_scheme_records_frames_and_says_so() {
    let folder = tempfile::tempdir().unwrap();
    for scheme in ["live", "progressive", "random"] {
        let file = folder.path().join(format!("{scheme}.mcap"));
        let file = file.to_str().unwrap();
        record(file, &["--scheme", scheme]);
        let info = info(file);
        assert_eq!(info["frames"], 3, "{info}");
        assert_eq!(info["notes"]["scheme"], scheme, "{info}");
        assert_eq!(info["contact_map"], "sensor", "{info}");
        export(&folder, scheme);
    }
    // a recording's chunks close by the clock; what is in them does not depend on it
    let again = folder.path().join("again.mcap");
    record(
        again.to_str().unwrap(),
        &["--scheme", "random", "--seed", "0"],
    );
    export(&folder, "again");
    let picture = |name: &str| std::fs::read(folder.path().join(name).join("000002.exr")).unwrap();
    assert_eq!(picture("again"), picture("random"));
}

#[test]
fn polar_recordings_give_points_and_no_images() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let file = path("polar.mcap");
    record(
        &file,
        &["--contact-map", "polar", "--map-resolution", "4mm"],
    );
    let info = info(&file);
    assert_eq!(info["contact_map"], "polar", "{info}");
    assert_eq!(info["key_frames"], 3, "{info}");
    assert_eq!(info["notes"]["map_resolution"], "4mm", "{info}");
    assert!(run(&["info", &file], 0).0.contains("polar map"));

    run(
        &["export", &file, "-q", "--to", "ply", "-o", &path("points")],
        0,
    );
    let points = vertices(&folder.path().join("points/000002.ply"));
    assert!(points > 2000, "{points} points");
    run(
        &[
            "export",
            &file,
            "-q",
            "--to",
            "spheres",
            "-o",
            &path("spheres"),
        ],
        0,
    );
    assert!(vertices(&folder.path().join("spheres/000000.ply")) > 3);
    run(
        &["export", &file, "-q", "--to", "pcd", "-o", &path("pcd")],
        0,
    );
    run(&["play", &file, "--stats", "--speed", "100"], 0);
    for format in ["exr", "png", "png16"] {
        let (_, stderr) = run(
            &["export", &file, "-q", "--to", format, "-o", &path(format)],
            2,
        );
        assert!(
            stderr.contains("polar") && stderr.contains("ply"),
            "{stderr}"
        );
        assert!(!folder.path().join(format).exists(), "{format}");
    }
    let (_, stderr) = run(&["replay", &file, "-q"], 4);
    assert!(stderr.contains("polar"), "{stderr}");
}

#[test]
fn flags_that_do_not_go_together_are_told() {
    for (flags, says) in [
        (&["--spheres-per-cube", "9"][..], "progressive"),
        (&["--scheme", "progressive", "--seed", "1"], "random"),
        (&["--map-resolution", "4mm"], "polar"),
        (
            &["--contact-map", "polar", "--lossless"],
            "--map-resolution",
        ),
        (
            &["--contact-map", "polar", "--max-error", "5mm"],
            "--contact-distance",
        ),
        (&["--scheme", "best"], "progressive"),
    ] {
        let (_, stderr) = run(&[&["--device", CAMERA], flags].concat(), 2);
        assert!(stderr.contains(says), "{flags:?}: {stderr}");
    }
}
