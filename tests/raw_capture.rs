//! `record` and its replay: what was captured raw is modelled as it would have been live.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "a test fails by panicking"
)]

mod program;

use program::{info, json, run, text};
use saint_live::codec::EncodedFrame;
use saint_live::recording::RecordingReader;
use std::path::Path;

/// A camera whose frames do not depend on the machine's time: numbers, times, noise, gaps.
const CAMERA: &str =
    "synthetic:juggle,size=96x64,noise=stereo,unit=0.0005,fps=90,frames=7,paced=false";

fn frames(recording: &Path) -> Vec<EncodedFrame> {
    let mut reader = RecordingReader::open(recording).unwrap();
    let mut all = Vec::new();
    let mut frame = EncodedFrame::default();
    while reader.next_frame(&mut frame).unwrap() {
        all.push(frame.clone());
    }
    all
}

#[test]
fn replay_of_a_raw_capture_equals_live_bit_for_bit() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    for mode in [&[][..], &["--lossless"], &["--max-error", "5mm"]] {
        let live = path("live.mcap");
        let out = ["-d", CAMERA, "-q", "--overwrite", "-o", text(&live)];
        run([&out[..], mode].concat(), 0);
        let live = frames(&live);
        assert_eq!(live.len(), 7);
        for form in ["mcap", "png16", "exr"] {
            let raw = path(form);
            let arguments = ["record", "-q", "-d", CAMERA, "--overwrite", "--to", form];
            run([&arguments[..], &["-o", text(&raw)]].concat(), 0);
            let again = path("again.mcap");
            let arguments = [
                "replay",
                text(&raw),
                "-q",
                "--overwrite",
                "-o",
                text(&again),
            ];
            run([&arguments[..], mode].concat(), 0);
            let again = frames(&again);
            assert_eq!(again.len(), live.len(), "{form}");
            for (live, again) in live.iter().zip(&again) {
                assert_eq!(again.sequence, live.sequence, "{form}");
                assert_eq!(again.time, live.time, "{form}");
                assert_eq!(again.payload, live.payload, "{form} {mode:?}");
            }
        }
    }
}

#[test]
fn a_capture_goes_to_a_pipe_and_is_never_overwritten_unasked() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("raw.mcap");
    let file = ["record", "-d", CAMERA, "-o", text(&path)];
    let (_, said) = run(file, 0);
    assert!(
        said.contains("7 of 7 frames") && said.contains("dropped 0"),
        "{said}"
    );
    let (_, said) = run(file, 2);
    assert!(said.contains("exists"), "{said}");
    let piped = program::run_bytes(["record", "-q", "-d", CAMERA, "-o", "-"], 0).stdout;
    assert_eq!(piped, std::fs::read(&path).unwrap());
    for form in ["png16", "exr"] {
        let into = folder.path().join(form);
        let images = [
            "record",
            "-q",
            "-d",
            CAMERA,
            "--to",
            form,
            "-o",
            text(&into),
        ];
        run(images, 0);
        let (_, said) = run(images, 2);
        assert!(said.contains("not empty"), "{said}");
    }
}

#[test]
fn a_full_disk_ends_with_5() {
    let full = Path::new("/dev/full");
    assert!(full.exists(), "no /dev/full on this machine");
    let (_, said) = run(["record", "-q", "-d", CAMERA, "-o", "/dev/full"], 5);
    assert!(said.contains("/dev/full"), "{said}");
}

#[test]
fn a_capture_counts_names_parts_and_refuses_what_it_cannot_take() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let (raw, trace) = (path("raw.mcap"), path("trace.json"));
    let file = ["record", "-d", CAMERA, "-q", "-o", text(&raw)];
    let more = [
        "--stats",
        "json",
        "--trace",
        text(&trace),
        "--sync",
        "chunk",
    ];
    let (out, _) = run([&file[..], &more].concat(), 0);
    let last = json(out.lines().last().unwrap());
    assert_eq!((&last["final"], &last["frames"]), (&true.into(), &7.into()));
    assert_eq!(last["drops"]["queue"], 0);
    assert!(
        std::fs::read_to_string(&trace)
            .unwrap()
            .contains("\"encode\"")
    );

    // what looks after recordings looks after captures
    assert_eq!(info(&raw)["frames"], 7);
    let (said, _) = run(["-q", "check", text(&raw), "--json"], 0);
    assert_eq!(json(&said)["frames"], 7);
    let (_, said) = run(["play", text(&raw)], 4);
    assert!(
        said.contains("raw capture") && said.contains("replay"),
        "{said}"
    );
    let bytes = std::fs::read(&raw).unwrap();
    std::fs::write(&raw, &bytes[..bytes.len() - 40]).unwrap();
    run(["check", text(&raw)], 4);
    let (mended, again) = (path("mended.mcap"), path("again.mcap"));
    run(["repair", text(&raw), "-o", text(&mended)], 0);
    run(["replay", text(&mended), "-q", "-o", text(&again)], 0);
    assert_eq!(frames(&again).len(), 7);

    let parts = path("part.mcap");
    let arguments = [
        "record",
        "-d",
        CAMERA,
        "-o",
        text(&parts),
        "--split",
        "40ms",
    ];
    let (_, said) = run(arguments, 0);
    assert!(said.contains("wrote 2 parts up to"), "{said}");
    let images = path("images");
    for wrong in [
        &["--split", "1s"][..],
        &["--color-device", "9"],
        &["--sync", "chunk"],
    ] {
        let arguments = ["record", "-d", CAMERA, "--to", "exr", "-o", text(&images)];
        let (_, said) = run([&arguments[..], wrong].concat(), 2);
        assert!(said.contains("--to mcap only"), "{said}");
    }
    let (_, said) = run(["record", "-d", CAMERA, "-o", "-", "--stats", "json"], 2);
    assert!(said.contains("standard output"), "{said}");
}
