//! `model`: clouds in, one file out, and what `info` and `export` make of it.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "a test fails by panicking"
)]

mod program;

use program::{info, json, run, run_bytes, text};
use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};
use tempfile::TempDir;

/// Writes a ball of radius 0.1 (file units: metres times `scale`) as XYZ.
fn ball(folder: &TempDir, name: &str, center: [f64; 3], scale: f64) -> PathBuf {
    let mut file = String::new();
    for i in 0..1200 {
        let z = 1.0 - (2.0 * f64::from(i) + 1.0) / 1200.0;
        let (sin, cos) = (2.399_963 * f64::from(i)).sin_cos();
        let ring = (1.0 - z * z).sqrt();
        let p = [ring * cos, ring * sin, z];
        let at = |k: usize| scale * (center[k] + 0.1 * p[k]);
        writeln!(file, "{} {} {}", at(0), at(1), at(2)).unwrap();
    }
    write(folder, name, file.as_bytes())
}

fn write(folder: &TempDir, name: &str, bytes: &[u8]) -> PathBuf {
    let path = folder.path().join(name);
    fs::write(&path, bytes).unwrap();
    path
}

/// Ends with `code` and one line that says all of `says`.
#[track_caller]
fn refused(arguments: &[&str], code: i32, says: &[&str]) {
    let (stdout, stderr) = run(arguments, code);
    assert!(stdout.is_empty(), "{stdout}");
    let errors: Vec<_> = stderr
        .lines()
        .filter(|l| l.starts_with("saint-live: "))
        .collect();
    assert_eq!(errors.len(), 1, "{stderr}");
    for word in says {
        assert!(errors[0].contains(word), "no `{word}` in {stderr}");
    }
}

/// Numbers of the first `count` records of a PLY file of doubles or floats behind its header.
fn header(ply: &Path) -> String {
    let bytes = fs::read(ply).unwrap();
    let end = bytes
        .windows(11)
        .position(|w| w == b"end_header\n")
        .unwrap();
    String::from_utf8(bytes[..end].to_vec()).unwrap()
}

#[test]
fn a_scene_of_two_objects_is_modelled_told_and_exported() {
    let folder = tempfile::tempdir().unwrap();
    let a = ball(&folder, "apple.xyz", [0.0, 0.0, 0.0], 1000.0);
    let b = ball(&folder, "pear.xyz", [448_262.5, 5_411_932.0, 7.0], 1000.0);
    let out = folder.path().join("scene.mcap");
    let arguments = [
        "model",
        text(&a),
        text(&b),
        "--unit",
        "mm",
        "--contact-distance",
        "1mm",
        "--json",
        "-o",
        text(&out),
    ];
    let (stdout, stderr) = run(arguments, 0);
    let told = json(&stdout);
    assert_eq!(told["objects"][1]["name"], "pear");
    assert_eq!(told["objects"][1]["unit"], "mm");
    for part in told["parts"].as_array().unwrap() {
        assert_eq!(
            (&part["spheres"], &part["explained"]),
            (&1.into(), &1.0.into())
        );
        assert!(part["residual"]["max_m"].as_f64().unwrap() < 1e-5, "{part}");
        // cells of half a millimetre, their corners 0.35 mm from the middle
        let chamfer_m = part["chamfer_m"].as_f64().unwrap();
        assert!(chamfer_m > 1e-5 && chamfer_m < 3.6e-4, "{part}");
    }
    assert_eq!(
        told["bytes"].as_u64().unwrap(),
        fs::metadata(&out).unwrap().len()
    );
    for word in [
        "apple",
        "1200 points",
        "as given",
        "100.00 % explained",
        "1 spheres",
        "Chamfer 0.",
    ] {
        assert!(stderr.contains(word), "no `{word}` in {stderr}");
    }

    let listed = info(&out);
    assert_eq!(listed["kind"], "model");
    assert_eq!(listed["parts"], told["parts"]);
    let (shown, _) = run(["info", text(&out)], 0);
    assert!(
        shown.contains("object    apple") && shown.contains("pear"),
        "{shown}"
    );

    let points = folder.path().join("all.ply");
    run(
        ["export", text(&out), "--to", "ply", "-o", text(&points)],
        0,
    );
    let cells: u64 = [0, 1]
        .map(|i| told["parts"][i]["map"]["cells"].as_u64().unwrap())
        .iter()
        .sum();
    assert!(header(&points).contains(&format!("vertex {cells}\nproperty double x")));
    let one = folder.path().join("apple.ply");
    let export = [
        "export",
        text(&out),
        "--to",
        "spheres",
        "--object",
        "apple",
        "-o",
        text(&one),
    ];
    run(export, 0);
    assert!(header(&one).contains("vertex 1\nproperty float x"));
    run(
        [
            "export",
            text(&out),
            "--to",
            "pcd",
            "-q",
            "-o",
            text(folder.path()),
        ],
        0,
    );
    assert!(folder.path().join("model.pcd").is_file());

    // what was exported can be modelled again, far from zero as it is
    let pear = folder.path().join("pear.ply");
    run(
        [
            "export",
            text(&out),
            "--to",
            "ply",
            "--object",
            "pear",
            "-o",
            text(&pear),
        ],
        0,
    );
    let again = ["model", text(&pear), "--json", "--contact-distance", "1mm"];
    let again = json(&run(again, 0).0)["parts"][0].clone();
    assert_eq!(
        (&again["spheres"], &again["explained"]),
        (&1.into(), &1.0.into())
    );

    let exists = ["model", text(&a), "-o", text(&out)];
    refused(&exists, 2, &["scene.mcap", "--overwrite"]);
    let image = ["export", text(&out), "--to", "exr", "-o", "/nowhere"];
    refused(&image, 2, &["scene.mcap", "no grid", "ply"]);
    let stranger = [
        "export",
        text(&out),
        "--to",
        "ply",
        "--object",
        "plum",
        "-o",
        "/nowhere",
    ];
    refused(&stranger, 2, &["no object plum", "apple, pear"]);
    refused(&["play", text(&out)], 4, &["scene.mcap", "model", "export"]);
}

#[test]
fn scales_decode_each_from_one_file() {
    let folder = tempfile::tempdir().unwrap();
    let row: Vec<_> = (0..4)
        .map(|i| {
            ball(
                &folder,
                &format!("{i}"),
                [f64::from(i) * 0.15, 0.0, 0.0],
                1.0,
            )
        })
        .collect();
    let all: Vec<u8> = row.iter().flat_map(|p| fs::read(p).unwrap()).collect();
    let cloud = write(&folder, "row.xyz", &all);
    let out = folder.path().join("row.mcap");
    let (stdout, _) = run(
        [
            "model",
            text(&cloud),
            "--scales",
            "4,1,2",
            "--json",
            "-o",
            text(&out),
        ],
        0,
    );
    let told = json(&stdout);
    assert_eq!(told["scales"], json("[1, 2, 4]"));
    let distance = |part: usize| {
        let text = told["parts"][part]["contact_distance"].as_str().unwrap();
        let number = text.trim_end_matches("mm");
        let digits = number.trim_start_matches(['0', '.']).replace('.', "");
        assert!(digits.len() <= 3, "{text}");
        number.parse::<f64>().unwrap()
    };
    assert!(distance(0) > distance(1) && distance(1) > distance(2));
    for (part, scale) in ["1", "2", "4"].iter().enumerate() {
        let file = folder.path().join(format!("{scale}.ply"));
        run(
            [
                "export",
                text(&out),
                "--to",
                "spheres",
                "--scale",
                scale,
                "-o",
                text(&file),
            ],
            0,
        );
        let count = &told["parts"][part]["spheres"];
        assert!(count.as_u64().unwrap() <= scale.parse().unwrap());
        assert!(header(&file).contains(&format!("vertex {count}\n")));
    }
    let wrong = [
        "export",
        text(&out),
        "--to",
        "ply",
        "--scale",
        "3",
        "-o",
        "/nowhere",
    ];
    refused(&wrong, 2, &["no scale 3", "1, 2, 4"]);
}

#[test]
fn seed_and_threads_say_what_the_bytes_are() {
    let folder = tempfile::tempdir().unwrap();
    let a = ball(&folder, "a.xyz", [0.0; 3], 1.0);
    let b = ball(&folder, "b.xyz", [0.12, 0.0, 0.0], 1.0);
    for scheme in ["random", "progressive"] {
        let model = |more: &[&str]| {
            let fixed = [
                "model",
                text(&a),
                text(&b),
                "-q",
                "--scheme",
                scheme,
                "-o",
                "-",
            ];
            run_bytes(fixed.iter().chain(more), 0).stdout
        };
        let one = model(&["--threads", "1", "--seed", "5"]);
        assert!(one == model(&["--threads", "3", "--seed", "5"]), "{scheme}");
        assert!(one == model(&["--seed", "5"]), "{scheme}");
    }
}

#[test]
fn both_contact_maps_are_counted() {
    let folder = tempfile::tempdir().unwrap();
    let row: Vec<u8> = (0..3)
        .map(|i| ball(&folder, &format!("{i}"), [f64::from(i), 0.0, 0.0], 1.0))
        .flat_map(|p| fs::read(p).unwrap())
        .collect();
    let cloud = write(&folder, "row.xyz", &row);
    let map = |more: &[&str]| {
        let fixed = ["model", text(&cloud), "--contact-distance", "1mm", "--json"];
        let (stdout, stderr) = run(fixed.iter().chain(more), 0);
        (json(&stdout)["parts"][0]["map"].clone(), stderr)
    };
    let (claims, _) = map(&[]);
    assert_eq!(
        (&claims["kind"], &claims["lost"]),
        (&"claims".into(), &0.into())
    );
    let (merged, said) = map(&["--contact-map", "merged", "--map-resolution", "32"]);
    assert_eq!(
        (&merged["kind"], &merged["resolution"]),
        (&"merged".into(), &32.0.into())
    );
    let number = |name: &str| merged[name].as_u64().unwrap();
    assert!(
        number("lost") > 1000 && number("collisions") > 1000,
        "{merged}"
    );
    assert_eq!(
        number("cells") + number("shared") + number("lost"),
        number("points")
    );
    assert!(
        said.contains(&format!("{} collisions", number("collisions"))),
        "{said}"
    );
    for wrong in [
        ["--contact-map", "claims", "--map-resolution", "32"],
        ["--contact-map", "merged", "--map-resolution", "1mm"],
    ] {
        let cloud = text(&cloud);
        let all = [&["model", cloud][..], &wrong[..]].concat();
        refused(&all, 2, &["--map-resolution"]);
    }
}

#[test]
fn clouds_that_are_none_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let refuses = |name: &str, content: &str, says: &[&str]| {
        let path = write(&folder, name, content.as_bytes());
        refused(&["model", text(&path)], 4, &[&[name][..], says].concat());
    };
    refused(
        &["model", "/nowhere.ply"],
        4,
        &["/nowhere.ply", "check the path"],
    );
    refuses("empty.xyz", "", &["holds 0 points", "at least 5"]);
    refuses("one.xyz", "1 2 3\n", &["holds 1 points", "at least 5"]);
    refuses(
        "same.xyz",
        &"1 2 3\n".repeat(50),
        &["holds 50 points", "one place"],
    );
    let line: String = (0..50).map(|i| format!("{i} 0 0\n")).collect();
    refuses("line.xyz", &line, &["on one line"]);
    refuses(
        "nan.xyz",
        &"nan 0 0\n".repeat(9),
        &["of which 0 are finite"],
    );
    refuses(
        "bad.xyz",
        "1 2 3\nfour\n",
        &["line 2", "export the cloud again"],
    );
    refuses("cut.ply", "ply\nformat ascii 1.0\n", &["no whole PLY file"]);
    refuses("x.las", "LASF", &["no kind known", ".ply"]);
    let far = "0 0 0\n1 0 0\n0 1 0\n1 1 0\n1 1 1\n1e12 0 0\n";
    let path = write(&folder, "far.xyz", far.as_bytes());
    let arguments = ["model", text(&path), "--contact-distance", "1mm"];
    refused(&arguments, 4, &["far.xyz", "extends over", "--unit"]);
}

#[test]
fn odd_clouds_are_modelled_and_said_to_be_odd() {
    let folder = tempfile::tempdir().unwrap();
    let mut rows = String::from("nan nan nan\ninf 0 0\n");
    for i in 0..400 {
        writeln!(rows, "{} {} 5", i % 20, i / 20).unwrap();
    }
    rows.push_str("0 0 5\n0 0 5\n");
    let path = write(&folder, "flat.xyz", rows.as_bytes());
    let (stdout, stderr) = run(["model", text(&path), "--json"], 0);
    let told = json(&stdout);
    let object = &told["objects"][0];
    assert_eq!(
        (&object["points"], &object["rejected"]),
        (&402.into(), &2.into())
    );
    assert_eq!(object["duplicates"], 2);
    let part = &told["parts"][0];
    assert_eq!(
        (&part["spheres"], &part["explained"]),
        (&1.into(), &1.0.into())
    );
    assert!(
        stderr.contains("2 not finite") && stderr.contains("2 repeat another"),
        "{stderr}"
    );
    // 19 m is a room, 190 m a hint
    assert!(!stderr.contains("give --unit mm"));
    let wide: String = (0..400)
        .map(|i| format!("{} {} 5\n", i % 20 * 10, i / 20))
        .collect();
    let path = write(&folder, "wide.xyz", wide.as_bytes());
    let (_, stderr) = run(["model", text(&path)], 0);
    assert!(stderr.contains("give --unit mm"), "{stderr}");
}

#[test]
fn a_damaged_model_gives_what_is_whole() {
    let folder = tempfile::tempdir().unwrap();
    let a = ball(&folder, "a.xyz", [0.0; 3], 1.0);
    let b = ball(&folder, "b.xyz", [0.15, 0.0, 0.0], 1.0);
    let both = [fs::read(&a).unwrap(), fs::read(&b).unwrap()].concat();
    let cloud = write(&folder, "both.xyz", &both);
    let out = folder.path().join("m.mcap");
    run(
        [
            "model",
            text(&cloud),
            "--scales",
            "1,2",
            "-q",
            "-o",
            text(&out),
        ],
        0,
    );
    let bytes = fs::read(&out).unwrap();
    // within the last part
    let coarse = json(&run(["info", text(&out), "--json"], 0).0);
    let fine = coarse["parts"][1]["bytes"].as_u64().unwrap() as usize;
    let cut = write(&folder, "cut.mcap", &bytes[..bytes.len() - fine]);
    let ply = folder.path().join("coarse.ply");
    let export = [
        "export",
        text(&cut),
        "--to",
        "spheres",
        "-q",
        "-o",
        text(&ply),
    ];
    refused(&export, 4, &["cut.mcap", "after 1 of 2 parts"]);
    assert!(header(&ply).contains("vertex 1\n"));
    let foreign = write(&folder, "x.mcap", &bytes[..20]);
    refused(&["info", text(&foreign)], 4, &["x.mcap"]);
}
