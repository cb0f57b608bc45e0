//! The bundled recordings through the whole program and back: nothing lost, errors within bounds.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "a test fails by panicking"
)]

mod program;

use program::{files, info, json, read_exr, read_png16, repository, run, run_bytes, text};
use std::path::Path;

/// Frames of each recording that are checked pixel by pixel.
const FRAMES: usize = 3;

/// Replays, exports to EXR, and holds every pixel against the original. `bound_m` gives the
/// largest error along the ray at a depth, metres.
fn round_trip(recording: &str, flags: &[&str], bound_m: fn(f64) -> f64) {
    let folder = tempfile::tempdir().unwrap();
    let input = repository("recordings").join(recording);
    let (mcap, exr) = (folder.path().join("x.mcap"), folder.path().join("exr"));
    let to = FRAMES.to_string();
    let mut arguments = vec![
        "replay",
        text(&input),
        "-o",
        text(&mcap),
        "--to",
        &to,
        "--stats",
        "json",
        "-q",
    ];
    arguments.extend(flags);
    let (stats, _) = run(&arguments, 0);
    let stats = json(stats.lines().last().unwrap());
    let told = info(&mcap);
    assert_eq!(told["frames"], FRAMES, "{told}");
    run(["export", text(&mcap), "--to", "exr", "-o", text(&exr)], 0);

    let number = |pointer: &str| told.pointer(pointer).and_then(|v| v.as_f64()).unwrap();
    let lens = ["fx", "fy", "cx", "cy"].map(|k| number(&format!("/camera/intrinsics/{k}")));
    let (near, far) = (number("/camera/depth_min_m"), number("/camera/depth_max_m"));
    let (mut valid, mut lost, mut invented) = (0_u64, 0, 0);
    let (mut worst, mut sum) = (f64::MIN, 0.0);
    let decoded = files(&exr, "exr");
    assert_eq!(decoded.len(), FRAMES);
    for (original, decoded) in files(&input, "exr").iter().zip(&decoded) {
        let (a, b) = (read_exr(original), read_exr(decoded));
        assert_eq!(a.values.len(), b.values.len());
        for (i, (za, zb)) in a.values.iter().zip(&b.values).enumerate() {
            let (za, zb) = (f64::from(*za), f64::from(*zb));
            let measured = za.is_finite() && za > 0.0 && (near..=far).contains(&za);
            match (measured, zb > 0.0) {
                (true, true) => {
                    let x = ((i % a.width) as f64 - lens[2]) / lens[0];
                    let y = ((i / a.width) as f64 - lens[3]) / lens[1];
                    let ray = (x * x + y * y + 1.0).sqrt();
                    let error = (za - zb).abs() * ray;
                    // an EXR file holds f32 metres
                    let excess = error - bound_m(za) - za * ray * f64::from(f32::EPSILON);
                    worst = worst.max(excess);
                    sum += error;
                    valid += 1;
                }
                (true, false) => lost += 1,
                (false, true) => invented += 1,
                (false, false) => {}
            }
        }
    }
    assert!(valid > 100_000, "{recording}: {valid} pixels compared");
    let counted = stats["lost_points"].as_u64().unwrap_or(0);
    assert!(
        worst <= 0.0 && lost == counted && invented == 0,
        "{recording} {flags:?}: worst {:.4} mm over its bound, mean {:.4} mm, {lost} pixels lost ({counted} counted), {invented} invented",
        worst * 1e3,
        sum / valid as f64 * 1e3
    );
}

/// The default bound is 2.5 contact distances: spheres are fitted to the contact distance, and a
/// reading is coded by itself only beyond the bound.
#[test]
fn every_pixel_is_within_the_default_bound_unless_told_otherwise() {
    for recording in ["static_room", "moving_camera", "moving_object"] {
        round_trip(recording, &[], |z| 2.5 * f64::max(12e-3, 4e-3 * z * z));
    }
}

#[test]
fn every_pixel_is_within_max_error() {
    for recording in ["static_room", "moving_camera", "moving_object"] {
        round_trip(recording, &["--max-error", "5mm"], |_| 5e-3);
    }
    round_trip("moving_object", &["--max-error", "1mm"], |_| 1e-3);
}

#[test]
fn lossless_is_exact() {
    for recording in ["static_room", "moving_camera", "moving_object"] {
        round_trip(recording, &["--lossless"], |_| 0.0);
    }
}

#[test]
fn lossless_stays_exact_through_png_and_a_second_recording() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let input = repository("recordings/moving_object");
    let export = |from: &Path, to: &Path| {
        run(
            ["export", text(from), "--to", "png16", "-o", text(to), "-q"],
            0,
        );
    };
    let replay = |from: &Path, to: &Path| {
        let arguments = [
            "replay",
            text(from),
            "--lossless",
            "--to",
            "4",
            "-q",
            "-o",
            text(to),
        ];
        run(arguments, 0);
    };
    replay(&input, &at("1.mcap"));
    export(&at("1.mcap"), &at("png"));
    replay(&at("png"), &at("2.mcap"));
    replay(&at("2.mcap"), &at("3.mcap"));
    export(&at("3.mcap"), &at("again"));
    let (once, thrice) = (files(&at("png"), "png"), files(&at("again"), "png"));
    assert_eq!((once.len(), thrice.len()), (4, 4));
    for ((a, b), original) in once.iter().zip(&thrice).zip(files(&input, "exr")) {
        let codes = read_png16(a);
        assert_eq!(codes, read_png16(b), "{} and {}", a.display(), b.display());
        let plane = read_exr(&original);
        let measured = plane.values.iter().filter(|z| **z > 0.0).count();
        assert_eq!(codes.iter().filter(|c| **c != 0).count(), measured);
    }
}

#[test]
fn a_piped_recording_decodes_like_a_file() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let input = repository("recordings/moving_object");
    let replay = ["replay", text(&input), "--to", "4", "-q", "-o"];
    let piped = run_bytes(replay.iter().chain(&["-"]), 0);
    std::fs::write(at("piped.mcap"), &piped.stdout).unwrap();
    run(replay.iter().chain(&[text(&at("file.mcap"))]), 0);
    let told = info(&at("piped.mcap"));
    assert_eq!((&told["frames"], &told["cut"]), (&4.into(), &false.into()));
    for name in ["piped", "file"] {
        let mcap = at(&format!("{name}.mcap"));
        run(
            [
                "export",
                text(&mcap),
                "--to",
                "png16",
                "-o",
                text(&at(name)),
            ],
            0,
        );
    }
    for (a, b) in files(&at("piped"), "png")
        .iter()
        .zip(files(&at("file"), "png"))
    {
        assert_eq!(read_png16(a), read_png16(&b));
    }
}

#[test]
fn a_picture_is_black_where_nothing_was_measured_and_there_alone() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let input = repository("recordings/moving_object");
    run(
        [
            "replay",
            text(&input),
            "--to",
            "2",
            "-q",
            "-o",
            text(&at("x.mcap")),
        ],
        0,
    );
    for form in ["png", "png16"] {
        let out = at(&format!("{form}.png"));
        let one = ["--from", "1", "-n", "1"];
        let arguments = [
            "export",
            text(&at("x.mcap")),
            "--to",
            form,
            "-o",
            text(&out),
        ]
        .map(str::to_owned);
        run(arguments.iter().map(String::as_str).chain(one), 0);
    }
    let picture = image::open(at("png.png")).unwrap().into_rgb8();
    let depth = read_png16(&at("png16.png"));
    assert_eq!(picture.dimensions(), (320, 240));
    let black: Vec<bool> = picture.pixels().map(|p| p.0 == [0, 0, 0]).collect();
    let hole: Vec<bool> = depth.iter().map(|code| *code == 0).collect();
    assert_eq!(black, hole);
    let colours: std::collections::BTreeSet<_> = picture.pixels().map(|p| p.0).collect();
    assert!(colours.len() > 50, "{} colours", colours.len());
}

#[test]
fn the_recordings_are_what_their_readme_says_makes_them() {
    let folder = tempfile::tempdir().unwrap();
    let readme = std::fs::read_to_string(repository("recordings/README.md")).unwrap();
    let mut made = 0;
    for line in readme
        .lines()
        .filter(|line| line.contains("-- synthesize "))
    {
        let mut words = line
            .split_whitespace()
            .skip_while(|word| *word != "synthesize")
            .skip(1);
        let scene = words.next().unwrap();
        let recording = words.find(|word| word.starts_with("recordings/")).unwrap();
        let count: usize = words.last().unwrap().parse().unwrap();
        let bundled = files(&repository(recording), "exr");
        assert_eq!(bundled.len(), count, "{recording}");
        let out = folder.path().join(format!("{made}"));
        run(["synthesize", scene, "-o", text(&out), "-n", "2", "-q"], 0);
        for (a, b) in files(&out, "exr").iter().zip(&bundled) {
            assert_eq!(read_exr(a).values, read_exr(b).values, "{}", b.display());
        }
        made += 1;
    }
    assert_eq!(made, 3);
}
