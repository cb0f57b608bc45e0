//! What goes wrong says so once, names the file and the remedy, ends with its exit code, and keeps
//! what was written before.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "a test fails by panicking"
)]

mod program;

use program::{files, info, repository, run, text, write_exr};
use std::fs;
use std::path::{Path, PathBuf};
use tempfile::TempDir;

/// Small frames of the synthetic room in a new folder.
fn scene(folder: &TempDir, frames: u32, size: &str) -> PathBuf {
    let out = folder.path().join(format!("scene_{size}"));
    let scene = format!("room,size={size}");
    let count = frames.to_string();
    run(
        ["synthesize", &scene, "-o", text(&out), "-n", &count, "-q"],
        0,
    );
    out
}

/// Replays `input` into a recording; it must end with 4 after `kept` frames, and say all of `says`.
#[track_caller]
fn breaks_off(folder: &TempDir, input: &Path, kept: u64, says: &[&str]) {
    let out = folder.path().join("kept.mcap");
    let (_, stderr) = run(["replay", text(input), "-q", "-o", text(&out)], 4);
    one_error(&stderr, says);
    let told = info(&out);
    assert_eq!(
        (&told["frames"], &told["cut"]),
        (&kept.into(), &false.into())
    );
}

/// One line begins with the program's name, and says everything.
#[track_caller]
fn one_error(stderr: &str, says: &[&str]) {
    let errors: Vec<_> = stderr
        .lines()
        .filter(|l| l.starts_with("saint-live: "))
        .collect();
    assert_eq!(errors.len(), 1, "{stderr}");
    for word in says {
        assert!(errors[0].contains(word), "no `{word}` in {stderr}");
    }
}

#[track_caller]
fn refused(arguments: &[&str], code: i32, says: &[&str]) {
    let (stdout, stderr) = run(arguments, code);
    assert!(stdout.is_empty(), "{stdout}");
    one_error(&stderr, says);
}

#[test]
fn no_frames_at_all() {
    let folder = tempfile::tempdir().unwrap();
    let empty = text(folder.path());
    refused(&["replay", "/nowhere"], 4, &["/nowhere", "give a folder"]);
    refused(&["replay", empty], 4, &[empty, "give the folder"]);
    refused(&["replay", "/dev/null"], 4, &["/dev/null", "give a folder"]);
    let readme = repository("recordings/README.md");
    refused(&["info", text(&readme)], 4, &["README.md", "MCAP"]);
    let export = ["export", "/nowhere.mcap", "--to", "ply", "-o", "/nowhere/x"];
    refused(&export, 4, &["/nowhere.mcap", "check the path"]);
}

#[test]
fn images_of_another_size() {
    let folder = tempfile::tempdir().unwrap();
    let input = scene(&folder, 3, "80x60");
    let other = scene(&folder, 1, "64x48");
    fs::copy(other.join("000000.exr"), input.join("000003.exr")).unwrap();
    breaks_off(
        &folder,
        &input,
        3,
        &[
            "000003.exr",
            "frame 3",
            "64x48",
            "80x60",
            "keep images of one size",
        ],
    );
}

#[test]
fn a_truncated_exr_image() {
    let folder = tempfile::tempdir().unwrap();
    let input = scene(&folder, 4, "80x60");
    let bytes = fs::read(input.join("000002.exr")).unwrap();
    fs::write(input.join("000002.exr"), &bytes[..bytes.len() / 2]).unwrap();
    breaks_off(&folder, &input, 2, &["000002.exr", "frame 2", "replace it"]);
}

#[test]
fn a_truncated_png_image() {
    let folder = tempfile::tempdir().unwrap();
    let (exr, mcap, png) = (
        scene(&folder, 4, "80x60"),
        folder.path().join("x.mcap"),
        folder.path().join("png"),
    );
    run(["replay", text(&exr), "-q", "-o", text(&mcap)], 0);
    run(
        [
            "export",
            text(&mcap),
            "--to",
            "png16",
            "-q",
            "-o",
            text(&png),
        ],
        0,
    );
    let third = files(&png, "png").remove(3);
    let bytes = fs::read(&third).unwrap();
    fs::write(&third, &bytes[..bytes.len() / 2]).unwrap();
    breaks_off(
        &folder,
        &png,
        3,
        &["000003.png", "frame 3", "give undamaged"],
    );
}

#[test]
fn intrinsics_that_are_missing_or_wrong() {
    let folder = tempfile::tempdir().unwrap();
    write_exr(&folder.path().join("000000.exr"), 64, &[2.0; 64 * 48]);
    let input = text(folder.path());
    refused(
        &["replay", input],
        4,
        &[input, "--intrinsics FILE", "fx,fy,cx,cy"],
    );
    refused(
        &["replay", input, "--intrinsics", "1,2,3"],
        2,
        &["4 numbers", "got 3"],
    );
    refused(
        &["replay", input, "--intrinsics", "/no.json"],
        4,
        &["/no.json", "check the path"],
    );
    run(["replay", input, "-q", "--intrinsics", "60,60,32,24"], 0);
}

#[test]
fn samples_that_are_no_depth_are_told_and_left_out() {
    let folder = tempfile::tempdir().unwrap();
    let strange = [
        2.0,
        f32::NAN,
        2.5,
        f32::INFINITY,
        1.5,
        f32::NEG_INFINITY,
        -1.0,
        0.0,
    ];
    let values: Vec<f32> = strange.into_iter().cycle().take(64 * 48).collect();
    write_exr(&folder.path().join("000000.exr"), 64, &values);
    let input = text(folder.path());
    let arguments = [
        "replay",
        input,
        "--intrinsics",
        "60,60,32,24",
        "--stats",
        "json",
    ];
    let (stats, stderr) = run(arguments, 0);
    assert!(stderr.contains("1152 not finite, 384 negative"), "{stderr}");
    let last = program::json(stats.lines().last().unwrap());
    assert_eq!(last["points_per_frame"], 1152.0, "{last}");
}

#[test]
fn frames_without_a_measurement_are_frames() {
    let folder = tempfile::tempdir().unwrap();
    for frame in 0..3 {
        write_exr(
            &folder.path().join(format!("{frame:06}.exr")),
            64,
            &[f32::NAN; 64 * 48],
        );
    }
    let mcap = folder.path().join("x.mcap");
    let lens = ["--intrinsics", "60,60,32,24"];
    run(
        [
            "replay",
            text(folder.path()),
            "-q",
            "-o",
            text(&mcap),
            lens[0],
            lens[1],
        ],
        0,
    );
    assert_eq!(info(&mcap)["frames"], 3);
    for form in ["ply", "spheres", "pcd", "exr", "png", "png16", "npz"] {
        let out = folder.path().join(form);
        run(
            ["export", text(&mcap), "--to", form, "-q", "-o", text(&out)],
            0,
        );
        let end = if form == "spheres" {
            "ply"
        } else {
            form.trim_end_matches("16")
        };
        assert_eq!(files(&out, end).len(), 3, "{form}");
    }
}

#[test]
fn devices_that_are_none() {
    refused(
        &["--device", "/dev/null"],
        3,
        &["/dev/null", "not a V4L2 video device", "saint-live devices"],
    );
    refused(
        &["--device", "/tmp"],
        3,
        &["/tmp", "not a V4L2 video device"],
    );
    refused(
        &["--device", "/dev/video987"],
        3,
        &["/dev/video987", "no such device", "plug the camera in"],
    );
}

#[test]
fn outputs_that_cannot_be() {
    let folder = tempfile::tempdir().unwrap();
    let input = scene(&folder, 3, "80x60");
    let replay = ["replay", text(&input), "-q", "-o"];
    let to = |output: &'static str| [replay.as_slice(), &[output]].concat();
    refused(&to("/dev/full"), 5, &["/dev/full", "no space left"]);
    refused(
        &to("/nowhere/x.mcap"),
        5,
        &["/nowhere/x.mcap", "a folder that exists"],
    );
    refused(&to("/tmp"), 5, &["/tmp", "directory"]);
    // also root may not write there
    refused(&to("/proc/x.mcap"), 5, &["/proc/x.mcap"]);
    let taken = folder.path().join("taken.mcap");
    fs::write(&taken, "precious").unwrap();
    refused(
        &[replay.as_slice(), &[text(&taken)]].concat(),
        2,
        &["taken.mcap", "--overwrite"],
    );
    assert_eq!(fs::read(&taken).unwrap(), b"precious");
}

#[test]
fn a_recording_is_never_written_over_itself() {
    let folder = tempfile::tempdir().unwrap();
    let input = scene(&folder, 3, "80x60");
    let mcap = folder.path().join("x.mcap");
    run(["replay", text(&input), "-q", "-o", text(&mcap)], 0);
    let before = fs::read(&mcap).unwrap();
    let arguments = [
        "replay",
        text(&mcap),
        "-q",
        "--overwrite",
        "-o",
        text(&mcap),
    ];
    refused(&arguments, 2, &["x.mcap", "another name"]);
    assert_eq!(fs::read(&mcap).unwrap(), before);
    let export = [
        "export",
        text(&mcap),
        "--to",
        "ply",
        "-q",
        "--overwrite",
        "-o",
        text(&mcap),
    ];
    refused(&export, 5, &["x.mcap", "not a directory"]);
    assert_eq!(fs::read(&mcap).unwrap(), before);
}

/// 90 frames, three seconds: three chunks.
fn recording(folder: &TempDir) -> PathBuf {
    let mcap = folder.path().join("x.mcap");
    let device = "synthetic:room,size=80x60,paced=false,frames=90";
    run(["--device", device, "-q", "-o", text(&mcap)], 0);
    mcap
}

#[test]
fn a_cut_recording_gives_its_whole_frames() {
    let folder = tempfile::tempdir().unwrap();
    let mcap = recording(&folder);
    let bytes = fs::read(&mcap).unwrap();
    fs::write(&mcap, &bytes[..bytes.len() * 3 / 4]).unwrap();
    let told = info(&mcap);
    let whole = told["frames"].as_u64().unwrap();
    assert!(told["cut"] == true && (30..90).contains(&whole), "{told}");
    let says = [format!("after {whole} whole frames"), "x.mcap".to_owned()];
    let says: Vec<_> = says.iter().map(String::as_str).collect();
    breaks_off(&folder, &mcap, whole, &says);
    let out = folder.path().join("exr");
    let (_, stderr) = run(
        ["export", text(&mcap), "--to", "exr", "-q", "-o", text(&out)],
        4,
    );
    one_error(&stderr, &says);
    assert_eq!(files(&out, "exr").len() as u64, whole);
    let (_, stderr) = run(["play", text(&mcap), "--stats", "--speed", "1000", "-q"], 4);
    one_error(&stderr, &says);
}

#[test]
fn a_damaged_recording_goes_on_after_the_damage() {
    let folder = tempfile::tempdir().unwrap();
    let mcap = recording(&folder);
    let mut bytes = fs::read(&mcap).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 0x55;
    fs::write(&mcap, &bytes).unwrap();
    let out = folder.path().join("exr");
    let (_, stderr) = run(
        ["export", text(&mcap), "--to", "exr", "-q", "-o", text(&out)],
        4,
    );
    one_error(&stderr, &["x.mcap", "damaged at byte", "checksum"]);
    let count = files(&out, "exr").len();
    assert!((30..90).contains(&count), "{count}");
    fs::write(&mcap, [b"\x89MCAP0\r\n".as_slice(), &[7; 500]].concat()).unwrap();
    refused(&["info", text(&mcap)], 4, &["x.mcap", "damaged at byte 8"]);
}
