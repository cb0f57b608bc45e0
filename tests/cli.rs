//! The program from outside: what a script sees.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "a test fails by panicking"
)]

mod program;

use program::{json, run, run_bytes};
use std::path::Path;

/// A small, quick synthetic camera that does not wait for the clock.
fn camera(frames: u32) -> String {
    format!("synthetic:room,size=80x60,paced=false,frames={frames}")
}

/// A recording of `frames` synthetic frames.
#[track_caller]
fn record(path: &Path, frames: u32) {
    let device = camera(frames);
    run(["--device", &device, "-q", "-o", path.to_str().unwrap()], 0);
}

#[test]
fn help_names_the_commands_and_the_exit_codes() {
    let (help, _) = run(["--help"], 0);
    for word in [
        "replay",
        "play",
        "export",
        "info",
        "bench",
        "devices",
        "synthesize",
        "experiment",
        "completions",
        "Exit codes",
    ] {
        assert!(help.contains(word), "no `{word}` in {help}");
    }
    run(["replay", "--help"], 0);
    let (version, _) = run(["--version"], 0);
    assert!(version.contains(env!("CARGO_PKG_VERSION")), "{version}");
}

#[test]
fn wrong_usage_ends_with_2_and_says_how() {
    for (arguments, says) in [
        (vec![], "Usage"),
        (vec!["--nonsense"], "nonsense"),
        (vec!["replay"], "INPUT"),
        (vec!["-n", "5"], "--device"),
        (vec!["--device", "synthetic:nowhere"], "nowhere"),
        (
            vec!["--device", "synthetic:room", "--max-error", "5 apples"],
            "5mm",
        ),
        (
            vec!["--device", "synthetic:room", "--budget", "soon"],
            "33ms",
        ),
        (
            vec!["--device", "synthetic:room", "--threads", "0"],
            "threads",
        ),
        (
            vec!["--device", "synthetic:room", "--intrinsics", "1,2,3,4"],
            "--intrinsics",
        ),
        (
            vec![
                "--device",
                "synthetic:room",
                "--lossless",
                "--max-error",
                "5mm",
            ],
            "--max-error",
        ),
        (
            vec!["--device", "synthetic:room", "-o", "-", "--stats", "json"],
            "standard output",
        ),
        (vec!["replay", "x", "--from", "5", "--to", "5"], "--from"),
        (vec!["replay", "x", "--intrinsics", "1,2,3"], "intrinsics"),
        (vec!["-q", "-v", "devices"], "--verbose"),
    ] {
        let (_, stderr) = run(&arguments, 2);
        assert!(stderr.contains(says), "{arguments:?}: {stderr}");
    }
}

#[test]
fn a_missing_input_ends_with_4_and_names_it() {
    for command in ["replay", "bench", "info", "play"] {
        let (stdout, stderr) = run([command, "/nowhere/at/all"], 4);
        assert!(stderr.contains("/nowhere/at/all"), "{command}: {stderr}");
        assert!(stdout.is_empty(), "{command}: {stdout}");
    }
    let folder = tempfile::tempdir().unwrap();
    run(["replay".as_ref(), folder.path().as_os_str()], 4);
}

#[test]
fn a_missing_device_ends_with_3() {
    let (_, stderr) = run(["--device", "/dev/video987"], 3);
    assert!(stderr.contains("/dev/video987"), "{stderr}");
}

#[test]
fn completions_are_scripts_for_each_shell() {
    for (shell, has) in [
        ("bash", "complete"),
        ("zsh", "#compdef"),
        ("fish", "complete -c"),
    ] {
        let (script, _) = run(["completions", shell], 0);
        assert!(
            script.contains(has) && script.contains("saint-live"),
            "{shell}"
        );
    }
}

#[test]
fn a_synthetic_camera_runs_live() {
    let device = "synthetic:room,size=80x60,fps=100";
    let (stdout, stderr) = run(["--device", device, "-n", "5", "--stats", "json"], 0);
    let last = json(stdout.lines().last().unwrap());
    assert_eq!(last["final"], true, "{stdout}");
    let written = last["frames"].as_u64().unwrap();
    let drops: u64 = last["drops"]
        .as_object()
        .unwrap()
        .values()
        .map(|v| v.as_u64().unwrap())
        .sum();
    assert_eq!(
        last["sensor_frames"].as_u64().unwrap(),
        written + drops,
        "{stdout}"
    );
    assert!(
        written >= 1 && last["points_per_frame"].as_f64().unwrap() > 1000.0,
        "{stdout}"
    );
    let first = stderr.lines().next().unwrap();
    assert!(
        first.contains("80x60") && first.contains("fx") && first.contains("mm"),
        "{first}"
    );
    assert!(stderr.contains("coverage"), "{stderr}");
}

#[test]
fn statistics_have_a_header_and_one_field_each_as_csv() {
    let device = camera(4);
    let (stdout, _) = run(["--device", &device, "-q", "--stats", "csv"], 0);
    let lines: Vec<_> = stdout.lines().collect();
    assert!(lines.len() >= 2, "{stdout}");
    let fields = |line: &str| line.split(',').count();
    assert!(
        lines.iter().all(|line| fields(line) == fields(lines[0])),
        "{stdout}"
    );
}

#[test]
fn quiet_says_nothing_when_all_is_well() {
    let device = camera(3);
    let (stdout, stderr) = run(["--device", &device, "-q"], 0);
    assert_eq!((stdout.as_str(), stderr.as_str()), ("", ""));
}

#[test]
fn an_existing_output_is_kept_unless_overwritten() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("x.mcap");
    std::fs::write(&path, "precious").unwrap();
    let device = camera(3);
    let name = path.to_str().unwrap();
    let (_, stderr) = run(["--device", &device, "-o", name], 2);
    assert!(
        stderr.contains(name) && stderr.contains("--overwrite"),
        "{stderr}"
    );
    assert_eq!(std::fs::read(&path).unwrap(), b"precious");
    run(["--device", &device, "-o", name, "--overwrite"], 0);
    let (info, _) = run(["info", name, "--json"], 0);
    assert_eq!(json(&info)["frames"], 3, "{info}");
}

#[test]
fn an_unwritable_output_ends_with_5() {
    let device = camera(3);
    let (_, stderr) = run(["--device", &device, "-o", "/nowhere/x.mcap"], 5);
    assert!(stderr.contains("/nowhere/x.mcap"), "{stderr}");
}

#[test]
fn threads_do_not_change_the_recording() {
    let folder = tempfile::tempdir().unwrap();
    let device = camera(12);
    let payloads = |threads: &str| {
        let path = folder.path().join(format!("{threads}.mcap"));
        let name = path.to_str().unwrap();
        run(
            ["--device", &device, "-q", "--threads", threads, "-o", name],
            0,
        );
        let mut reader = saint_live::recording::RecordingReader::open(&path).unwrap();
        let mut frame = saint_live::codec::EncodedFrame::default();
        let mut all = Vec::new();
        while reader.next_frame(&mut frame).unwrap() {
            all.push(frame.payload.clone());
        }
        all
    };
    let one = payloads("1");
    assert_eq!(one.len(), 12);
    assert!(
        one == payloads("3"),
        "payloads differ between 1 and 3 threads"
    );
}

/// The statistics of a short run that asks for priority, as the user `setpriv` makes of us.
fn prioritised(path: &Path, setpriv: Option<&[&str]>) -> Option<String> {
    let binary = assert_cmd::cargo::cargo_bin("saint-live");
    let mut command = match setpriv {
        Some(rights) => {
            let mut command = std::process::Command::new("setpriv");
            command.args(rights).arg(binary);
            command
        }
        None => std::process::Command::new(binary),
    };
    let output = command
        .args(["--device", &camera(12), "--realtime-priority", "-q"])
        .args(["--threads", "3", "--stats", "json", "-o"])
        .arg(path)
        .output()
        .ok()?;
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success() || setpriv.is_some(), "{said}");
    let last = String::from_utf8(output.stdout).ok()?;
    let last = json(last.lines().last()?);
    assert_eq!(last["frames"], 12, "{last}");
    Some(last["priority"].as_str().unwrap().to_owned())
}

#[test]
fn priority_is_harmless_with_and_without_the_right_to_it() {
    let folder = tempfile::tempdir().unwrap();
    let with = folder.path().join("with.mcap");
    let got = prioritised(&with, None).unwrap();
    assert!(["usual", "nice", "realtime"].contains(&&*got), "{got}");
    let plain = folder.path().join("plain.mcap");
    record(&plain, 12);
    let payloads = |path: &Path| {
        let mut reader = saint_live::recording::RecordingReader::open(path).unwrap();
        let mut frame = saint_live::codec::EncodedFrame::default();
        let mut all = Vec::new();
        while reader.next_frame(&mut frame).unwrap() {
            all.push(frame.payload.clone());
        }
        all
    };
    assert!(payloads(&with) == payloads(&plain), "payloads differ");
    // the same user without the capability, where that can be had
    let bare = folder.path().join("bare.mcap");
    let rights = ["--bounding-set=-sys_nice", "--inh-caps=-sys_nice", "--"];
    // skipped where `setpriv` is missing or may not take it away
    if let Some(got) = prioritised(&bare, Some(&rights)) {
        assert!(got == "usual" || got == "nice", "{got}");
    }
}

#[test]
fn a_recording_goes_to_standard_output() {
    let folder = tempfile::tempdir().unwrap();
    let device = camera(3);
    let output = run_bytes(["--device", &device, "-o", "-"], 0);
    let path = folder.path().join("piped.mcap");
    std::fs::write(&path, &output.stdout).unwrap();
    let (info, _) = run(["info".as_ref(), path.as_os_str(), "--json".as_ref()], 0);
    assert_eq!(json(&info)["frames"], 3, "{info}");
}

#[test]
fn info_and_play_and_replay_read_what_was_recorded() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("x.mcap");
    record(&path, 6);
    let name = path.to_str().unwrap();
    let (info, _) = run(["info", name, "--json"], 0);
    let info = json(&info);
    assert_eq!(
        (&info["frames"], &info["width"], &info["height"]),
        (&6.into(), &80.into(), &60.into())
    );
    assert_eq!(info["cut"], false);
    for key in ["duration_s", "channels"] {
        assert!(!info[key].is_null(), "no {key}: {info}");
    }
    let (text, _) = run(["info", name], 0);
    assert!(
        text.contains("6 frames") && text.contains("80x60"),
        "{text}"
    );
    let (played, _) = run(["play", name, "--stats", "--speed", "50"], 0);
    let played = json(&played);
    let (shown, skipped) = (played["shown"].as_u64(), played["skipped"].as_u64());
    assert_eq!(shown.zip(skipped).map(|(a, b)| a + b), Some(6), "{played}");
    let (stats, _) = run(
        [
            "replay", name, "--from", "2", "--to", "5", "--stats", "json", "-q",
        ],
        0,
    );
    assert_eq!(json(stats.lines().last().unwrap())["frames"], 3, "{stats}");
    let (stats, _) = run(
        [
            "replay", name, "--loop", "-n", "20", "--stats", "json", "-q",
        ],
        0,
    );
    assert_eq!(json(stats.lines().last().unwrap())["frames"], 20, "{stats}");
}

#[test]
fn a_cut_recording_plays_to_its_last_whole_frame_and_ends_with_4() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("x.mcap");
    record(&path, 90);
    let bytes = std::fs::read(&path).unwrap();
    std::fs::write(&path, &bytes[..bytes.len() / 2]).unwrap();
    let name = path.to_str().unwrap();
    let (info, _) = run(["info", name, "--json"], 0);
    assert_eq!(json(&info)["cut"], true, "{info}");
    let again = folder.path().join("again.mcap");
    let (_, stderr) = run(["replay", name, "-o", again.to_str().unwrap()], 4);
    assert!(stderr.contains("cut"), "{stderr}");
    let (whole, _) = run(["info", again.to_str().unwrap(), "--json"], 0);
    let frames = json(&whole)["frames"].as_u64().unwrap();
    assert!((1..90).contains(&frames), "{whole}");
    assert_eq!(json(&info)["frames"].as_u64(), Some(frames), "{info}");
}

#[test]
fn export_writes_each_form_and_never_over_another() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("x.mcap");
    record(&path, 4);
    let name = path.to_str().unwrap();
    for form in ["ply", "spheres", "pcd", "exr", "png", "png16", "npz"] {
        let out = folder.path().join(form);
        let out = out.to_str().unwrap();
        run(["export", name, "--to", form, "-o", out], 0);
        let files = std::fs::read_dir(out).unwrap().count();
        assert!(files >= 4, "{form}: {files} files");
        let (_, stderr) = run(["export", name, "--to", form, "-o", out], 2);
        assert!(stderr.contains("--overwrite"), "{form}: {stderr}");
    }
    let one = folder.path().join("one.png");
    let one = one.to_str().unwrap();
    let (_, stderr) = run(["export", name, "--to", "png", "-o", one], 2);
    assert!(stderr.contains("--from"), "{stderr}");
    run(
        [
            "export", name, "--to", "png", "-o", one, "--from", "2", "-n", "1",
        ],
        0,
    );
    assert!(Path::new(one).is_file());
}

#[test]
fn synthesize_bench_and_trace() {
    let folder = tempfile::tempdir().unwrap();
    let scene = folder.path().join("room");
    let scene = scene.to_str().unwrap();
    run(["synthesize", "room,size=80x60", "-o", scene, "-n", "4"], 0);
    assert_eq!(std::fs::read_dir(scene).unwrap().count(), 4);
    run(["synthesize", "room,size=80x60", "-o", scene, "-n", "4"], 2);
    let (bench, _) = run(["bench", scene, "--json", "-n", "6", "--threads", "2"], 0);
    let bench = json(&bench);
    for key in [
        "/frames",
        "/points_per_frame",
        "/spheres_per_frame",
        "/coverage",
        "/residual_mm/mean",
        "/residual_mm/p99",
        "/residual_mm/max",
        "/bits_per_valid_px",
        "/encode_ms/p50",
        "/encode_ms/p99",
        "/decode_ms/p50",
        "/decode_ms/p99",
        "/stage_ms/model/p50",
        "/rss_mb",
        "/threads",
        "/cold_ms/p50",
        "/cut_ms/p50",
        "/warm_ms/p50",
        "/throughput/fps",
        "/throughput/speed_up",
        "/machine/cpu",
        "/version",
    ] {
        assert!(
            bench.pointer(key).is_some_and(|v| !v.is_null()),
            "no {key}: {bench}"
        );
    }
    assert_eq!(bench["frames"], 6);
    let spent = bench["spent_bits"].as_object().unwrap();
    let bits: f64 = spent.values().map(|part| part.as_f64().unwrap()).sum();
    let payload = 8.0 * 6.0 * bench["bytes_per_frame"].as_f64().unwrap();
    assert!(
        (bits - payload).abs() < 1e-3 * payload,
        "{bits} of {payload}"
    );
    let shares = run(["bench", scene, "-n", "2"], 0).0;
    assert!(shares.contains("bits        mask "), "{shares}");
    let trace = folder.path().join("t.json");
    let trace = trace.to_str().unwrap();
    run(["replay", scene, "--trace", trace, "-q"], 0);
    let events = json(&std::fs::read_to_string(trace).unwrap());
    let spans = events
        .as_array()
        .unwrap()
        .iter()
        .filter(|e| e["ph"] == "X")
        .count();
    assert_eq!(spans, 4 * 4, "{events}");
}

#[test]
fn a_missed_budget_ends_with_6_only_under_strict() {
    let device = camera(5);
    let impossible = [
        "--device",
        &device,
        "-q",
        "--budget",
        "1us",
        "--on-late",
        "wait",
    ];
    run(impossible, 0);
    let (_, stderr) = run(impossible.iter().chain(&["--strict"]), 6);
    assert!(stderr.contains("budget missed"), "{stderr}");
}

#[cfg(target_os = "linux")]
#[test]
fn a_signal_finishes_the_file() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("x.mcap");
    let mut child = std::process::Command::new(env!("CARGO_BIN_EXE_saint-live"))
        .args([
            "--device",
            "synthetic:room,size=80x60,fps=100",
            "--stats",
            "json",
            "-o",
        ])
        .arg(&path)
        .stdout(std::process::Stdio::piped())
        .stderr(std::process::Stdio::null())
        .spawn()
        .unwrap();
    // the first statistics come after a second of frames
    let mut line = String::new();
    let mut out = std::io::BufReader::new(child.stdout.take().unwrap());
    std::io::BufRead::read_line(&mut out, &mut line).unwrap();
    let id = child.id().to_string();
    std::process::Command::new("kill")
        .args(["-INT", &id])
        .status()
        .unwrap();
    let mut rest = String::new();
    std::io::Read::read_to_string(&mut out, &mut rest).unwrap();
    assert_eq!(child.wait().unwrap().code(), Some(0), "{line}{rest}");
    let last = json(rest.lines().last().unwrap());
    assert_eq!(last["final"], true, "{rest}");
    let (info, _) = run(["info".as_ref(), path.as_os_str(), "--json".as_ref()], 0);
    let info = json(&info);
    assert_eq!(info["cut"], false, "{info}");
    assert_eq!(info["frames"], last["frames"], "{info}");
}

#[test]
fn a_reader_that_goes_away_is_a_clean_end() {
    let mut child = std::process::Command::new(env!("CARGO_BIN_EXE_saint-live"))
        .args([
            "--device",
            "synthetic:room,size=80x60,paced=false",
            "-n",
            "100000",
            "-q",
            "-o",
            "-",
        ])
        .stdout(std::process::Stdio::piped())
        .stderr(std::process::Stdio::piped())
        .spawn()
        .unwrap();
    drop(child.stdout.take());
    let output = child.wait_with_output().unwrap();
    assert_eq!(
        output.status.code(),
        Some(0),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
}

/// Bits per second of a recording.
fn rate(path: &Path) -> f64 {
    let info = json(&run(["info", path.to_str().unwrap(), "--json"], 0).0);
    info["bitrate_bps"].as_f64().unwrap()
}

#[test]
fn a_bit_rate_is_kept_and_the_threads_do_not_matter() {
    let folder = tempfile::tempdir().unwrap();
    let device = "synthetic:room,size=160x120,paced=false,frames=240";
    let record = |name: &str, flags: &[&str]| {
        let path = folder.path().join(name);
        let mut arguments = vec!["--device", device, "-q", "--budget", "10s", "-o"];
        arguments.push(path.to_str().unwrap());
        arguments.extend(flags);
        run(arguments, 0);
        run(["check", path.to_str().unwrap()], 0);
        path
    };
    let points = |path: &Path| {
        let out = path.with_extension("pcd");
        let file = [path, &out].map(|p| p.to_str().unwrap().to_owned());
        let arguments = [
            "export", &file[0], "--to", "pcd", "--from", "230", "-n", "1",
        ];
        run([&arguments[..], &["-o", &file[1]]].concat(), 0);
        std::fs::read(out).unwrap()
    };
    let usual = rate(&record("usual.mcap", &[]));
    for (name, factor) in [("less", 0.7), ("twice", 2.0)] {
        let target = format!("{}", (usual * factor) as u64);
        let files = ["1", "2"].map(|threads| {
            let name = format!("{name}{threads}.mcap");
            record(&name, &["--bitrate", &target, "--threads", threads])
        });
        let ratio = rate(&files[0]) / (usual * factor);
        assert!((0.75..1.35).contains(&ratio), "{name}: {ratio}");
        assert_eq!(points(&files[0]), points(&files[1]), "{name}");
    }
}
