//! Recordings that meet bad luck: full disks, deleted folders, killed programs, damaged bytes.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stderr,
    reason = "a test fails by panicking, and says where it was skipped"
)]
#![cfg(target_os = "linux")]

mod program;

use program::{info, json, run, text};
use std::fs;
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};
use std::time::Duration;

/// A quick camera that does not wait for the clock.
fn camera(frames: u32) -> String {
    format!("synthetic:room,size=80x60,paced=false,frames={frames}")
}

#[track_caller]
fn record(path: &Path, frames: u32) {
    run(["--device", &camera(frames), "-q", "-o", text(path)], 0);
}

fn program() -> &'static str {
    env!("CARGO_BIN_EXE_saint-live")
}

/// Runs a shell script with the program as `$0`; `None` where the machine does not allow it.
fn shell(before: &str, script: &str, arguments: &[&str]) -> Option<Output> {
    let mut words = before.split_whitespace().chain(["sh", "-c"]);
    let mut command = Command::new(words.next()?);
    command
        .args(words)
        .arg(script)
        .arg(program())
        .args(arguments);
    let output = command.output().ok()?;
    // the script says so where it could not even begin
    (output.status.code() != Some(77)).then_some(output)
}

fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// The number before `word` in `text`.
#[track_caller]
fn number_before(text: &str, word: &str) -> u64 {
    let (before, _) = text
        .split_once(word)
        .unwrap_or_else(|| panic!("no `{word}`: {text}"));
    let number = before.trim_end().rsplit([' ', '(']).next();
    number
        .and_then(|n| n.parse().ok())
        .unwrap_or_else(|| panic!("no number before `{word}`: {text}"))
}

#[test]
fn check_and_repair_tell_what_a_script_needs() {
    let folder = tempfile::tempdir().unwrap();
    let (path, mended) = (folder.path().join("x.mcap"), folder.path().join("y.mcap"));
    record(&path, 90);
    let (said, _) = run(["check", text(&path)], 0);
    assert!(
        said.contains("90 frames") && said.contains("sound"),
        "{said}"
    );
    let (said, _) = run(["check", text(&path), "--json", "--quick"], 0);
    let report = json(&said);
    assert_eq!(
        (&report["decoded"], &report["fault_count"]),
        (&false.into(), &0.into())
    );

    let mut bytes = fs::read(&path).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 4;
    fs::write(&path, &bytes).unwrap();
    let (said, why) = run(["check", text(&path), "--json"], 4);
    let fault = &json(&said)["faults"][0];
    let (from, to) = (
        fault["from"].as_u64().unwrap(),
        fault["to"].as_u64().unwrap(),
    );
    assert!(from < to && to < 90, "{said}");
    for words in [&format!("frames {from} to {to}")[..], "repair", text(&path)] {
        assert!(why.contains(words), "{why}");
    }

    let (_, said) = run(["repair", text(&path), "-o", text(&mended)], 0);
    let (kept, lost) = (
        number_before(&said, " frames kept"),
        number_before(&said, " lost, "),
    );
    assert_eq!(kept + lost, 90, "{said}");
    assert!(lost <= to - from + 1, "{said}");
    let whole = info(&mended);
    assert_eq!(
        (whole["frames"].as_u64(), &whole["cut"]),
        (Some(kept), &false.into())
    );
    run(["check", text(&mended)], 0);
    run(["replay", text(&mended), "-q"], 0);
    // what was known of the sensor's frames is still known
    assert_eq!(whole["account"]["sensor_frames"], 90, "{whole}");
    let (before, after) = (info(&path), whole);
    for key in ["first", "last", "camera"] {
        assert_eq!(before[key], after[key], "{key}");
    }

    let (_, said) = run(["repair", text(&path), "-o", text(&mended)], 2);
    assert!(said.contains("--overwrite"), "{said}");
    let (_, said) = run(["repair", text(&path), "-o", text(&path), "--overwrite"], 2);
    assert!(said.contains("input and output"), "{said}");
    run(
        [
            "repair",
            "/nowhere.mcap",
            "-o",
            text(&mended),
            "--overwrite",
        ],
        4,
    );
    assert_eq!(
        info(&mended)["frames"].as_u64(),
        Some(kept),
        "the earlier file was touched"
    );
}

#[test]
fn parts_hold_all_frames_and_play_alone() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.mcap");
    let device = camera(150);
    let arguments = [
        "--device",
        &device,
        "-o",
        text(&path),
        "--split",
        "2s",
        "--sync",
        "chunk",
    ];
    let (_, said) = run(arguments, 0);
    assert!(
        said.contains("3 parts up to") && said.contains("scene-003.mcap"),
        "{said}"
    );
    let parts = program::files(folder.path(), "mcap");
    let frames = parts.iter().map(|part| {
        run(["check", text(part)], 0);
        info(part)["frames"].as_u64().unwrap()
    });
    assert_eq!(frames.collect::<Vec<_>>(), [60, 60, 30]);
    let (_, said) = run(arguments, 2);
    assert!(said.contains("scene-001.mcap"), "{said}");
    let (_, said) = run(["--device", &device, "-o", "-", "--split", "2s"], 2);
    assert!(said.contains("--split"), "{said}");
    run(["--device", &device, "--split", "2s"], 2);
}

/// The file on a disk of `kilobytes` that fills up, and what the program said.
fn on_a_small_disk(kilobytes: u32) -> Option<(tempfile::TempDir, Output)> {
    let folder = tempfile::tempdir().unwrap();
    let script = "mount -t tmpfs -o size=${1}k none \"$2\" || exit 77; \
         \"$0\" --device synthetic:room,size=160x120,paced=false -t 60s --lossless -q --stats json -o \"$2/x.mcap\"; \
         code=$?; cp \"$2/x.mcap\" \"$3\"; exit $code";
    let disk = folder.path().join("disk");
    fs::create_dir(&disk).unwrap();
    let copy = folder.path().join("x.mcap");
    let size = kilobytes.to_string();
    // a mount of its own, gone with the process
    let output = shell("unshare -m", script, &[&size, text(&disk), text(&copy)])?;
    Some((folder, output))
}

#[test]
fn a_full_disk_leaves_a_whole_file() {
    for kilobytes in [300, 700] {
        let Some((folder, output)) = on_a_small_disk(kilobytes) else {
            eprintln!("skipped: this user may not mount a small disk");
            return;
        };
        let said = stderr(&output);
        assert_eq!(output.status.code(), Some(5), "{said}");
        assert!(said.contains("no space left"), "{said}");
        let kept = number_before(&said, " frames");
        assert!(kept > 10, "{said}");
        let path = folder.path().join("x.mcap");
        let facts = info(&path);
        assert_eq!(
            (facts["frames"].as_u64(), &facts["cut"]),
            (Some(kept), &false.into())
        );
        run(["check", text(&path)], 0);
        let last = String::from_utf8_lossy(&output.stdout).into_owned();
        let last = json(last.lines().last().unwrap());
        assert_balance(&last, kept);
    }
}

#[track_caller]
fn assert_balance(report: &serde_json::Value, in_the_file: u64) {
    let drops = report["drops"].as_object().unwrap().values();
    let dropped: u64 = drops.map(|v| v.as_u64().unwrap()).sum();
    let number = |key: &str| report[key].as_u64().unwrap();
    assert_eq!(number("frames"), in_the_file, "{report}");
    assert_eq!(number("sensor_frames"), in_the_file + dropped, "{report}");
}

#[test]
fn a_file_size_limit_is_a_write_error() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("x.mcap");
    let script = "ulimit -f 256 || exit 77; \
         exec \"$0\" --device synthetic:room,size=160x120,paced=false -t 60s --lossless --stats json -q -o \"$1\"";
    let output = shell("env", script, &[text(&path)]).unwrap();
    let said = stderr(&output);
    assert_eq!(output.status.code(), Some(5), "{said}");
    assert!(said.contains("--split"), "{said}");
    let kept = number_before(&said, " frames");
    assert_eq!(info(&path)["frames"].as_u64(), Some(kept), "{said}");
    let last = String::from_utf8_lossy(&output.stdout).into_owned();
    assert_balance(&json(last.lines().last().unwrap()), kept);
}

#[test]
fn a_read_only_disk_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let script = "mount -t tmpfs -o ro none \"$1\" || exit 77; \
         exec \"$0\" --device synthetic:room,size=80x60 -n 3 -o \"$1/x.mcap\"";
    let Some(output) = shell("unshare -m", script, &[text(folder.path())]) else {
        eprintln!("skipped: this user may not mount a disk");
        return;
    };
    let said = stderr(&output);
    assert_eq!(output.status.code(), Some(5), "{said}");
    assert!(
        said.contains("x.mcap") && said.contains("Read-only"),
        "{said}"
    );
}

/// A camera of 100 frames a second in real time, written to `path`.
fn live(path: &Path) -> Child {
    Command::new(program())
        .args([
            "--device",
            "synthetic:room,size=80x60,fps=100",
            "-q",
            "--stats",
            "json",
            "-o",
        ])
        .arg(path)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap()
}

/// Waits until the file holds frames.
fn wait_for_frames(path: &Path) {
    for _ in 0..600 {
        if fs::metadata(path).is_ok_and(|facts| facts.len() > 20_000) {
            return;
        }
        std::thread::sleep(Duration::from_millis(50));
    }
    panic!("{} does not grow", path.display());
}

#[test]
fn a_vanished_folder_ends_the_recording() {
    let folder = tempfile::tempdir().unwrap();
    let inner = folder.path().join("inner");
    fs::create_dir(&inner).unwrap();
    let path = inner.join("x.mcap");
    let child = live(&path);
    wait_for_frames(&path);
    fs::remove_dir_all(&inner).unwrap();
    let output = child.wait_with_output().unwrap();
    let said = stderr(&output);
    assert_eq!(output.status.code(), Some(5), "{said}");
    assert!(
        said.contains("deleted") && said.contains("x.mcap"),
        "{said}"
    );
    let last = String::from_utf8_lossy(&output.stdout).into_owned();
    assert_balance(&json(last.lines().last().unwrap()), 0);
}

#[test]
fn a_killed_program_leaves_a_file_that_can_be_mended() {
    for milliseconds in [0, 130, 370, 610] {
        let folder = tempfile::tempdir().unwrap();
        let (path, mended) = (folder.path().join("x.mcap"), folder.path().join("y.mcap"));
        let mut child = live(&path);
        wait_for_frames(&path);
        std::thread::sleep(Duration::from_millis(milliseconds));
        child.kill().unwrap();
        child.wait().unwrap();
        let cut = info(&path);
        assert_eq!(cut["cut"], true, "{cut}");
        let frames = cut["frames"].as_u64().unwrap();
        assert!(frames > 0, "{cut}");
        run(["check", text(&path)], 4);
        run(["repair", text(&path), "-o", text(&mended), "-q"], 0);
        let whole = info(&mended);
        assert_eq!(
            (whole["frames"].as_u64(), &whole["cut"]),
            (Some(frames), &false.into())
        );
        run(["check", text(&mended)], 0);
    }
}

#[test]
fn one_frame_and_the_way_back_are_exact() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("x.mcap");
    record(&path, 70);
    let play = |arguments: &[&str]| {
        let (said, _) = run(["play", text(&path)].iter().chain(arguments), 0);
        let played = json(&said);
        let number = |key: &str| played[key].as_u64().unwrap();
        (
            number("shown") + number("skipped"),
            number("first"),
            number("last"),
        )
    };
    for frame in ["0", "29", "30", "43", "69"] {
        let number = frame.parse().unwrap();
        assert_eq!(play(&["--frame", frame]), (1, number, number));
    }
    assert_eq!(
        play(&["--reverse", "--speed", "0.9", "--from", "66"]),
        (4, 69, 66)
    );
    assert_eq!(play(&["--from", "31", "--to", "33"]), (2, 31, 32));
    let (_, said) = run(["play", text(&path), "--frame", "70"], 2);
    assert!(said.contains("0 to 69"), "{said}");
    run(["play", text(&path), "--frame", "3", "--from", "1"], 2);
}
