//! `experiment` from outside: each one on tiny data, and what it refuses.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "a test fails by panicking"
)]

mod program;

use program::{json, run, text};
use std::path::Path;

/// A PLY file of a bowl in millimetres, some points of it twice.
fn bowl(path: &Path) {
    let mut ply = "ply\nformat ascii 1.0\ncomment unit mm\nelement vertex 900\nproperty float x\nproperty float y\nproperty float z\nend_header\n".to_owned();
    for i in 0..900 {
        let (x, y) = (f64::from(i % 29) * 4.0, f64::from(i % 31) * 4.0);
        let z = 0.004 * ((x - 58.0).powi(2) + (y - 62.0).powi(2));
        ply.push_str(&format!("{x} {y} {z}\n"));
    }
    std::fs::write(path, ply).unwrap();
}

#[test]
fn each_experiment_prints_tables_and_writes_its_curve() {
    let folder = tempfile::tempdir().unwrap();
    let cloud = folder.path().join("bowl.ply");
    bowl(&cloud);
    let frames = program::repository("recordings/moving_object");
    for name in [
        "multi-scale",
        "map-resolution",
        "storage",
        "packing",
        "schemes",
        "features",
        "loss",
    ] {
        let svg = folder.path().join(format!("{name}.svg"));
        let mut arguments = vec![
            "experiment",
            name,
            text(&frames),
            "-o",
            text(&svg),
            "--json",
        ];
        arguments.extend(["--seeds", "2", "--max-points", "450", "-q"]);
        match name {
            "loss" => arguments.extend(["-n", "2"]),
            _ => arguments.push(text(&cloud)),
        }
        let report = json(&run(&arguments, 0).0);
        assert_eq!(report["experiment"], name);
        assert!(report["seeds"].as_u64().unwrap() >= 2);
        assert!(report["machine"]["cpu"].is_string());
        assert!(!report["findings"].as_array().unwrap().is_empty());
        let tables = report["tables"].as_array().unwrap();
        for table in tables {
            let width = table["columns"].as_array().unwrap().len();
            let rows = table["rows"].as_array().unwrap();
            assert!(!rows.is_empty(), "{name}: {}", table["title"]);
            for row in rows {
                assert_eq!(row.as_array().unwrap().len(), width, "{name}");
            }
        }
        let picture = std::fs::read_to_string(&svg).unwrap();
        assert!(
            picture.starts_with("<svg") && picture.contains("polyline"),
            "{name}"
        );
        if name != "loss" {
            let data = report["data"].to_string();
            // 112 x 120 x 28 mm
            assert!(data.contains("bowl: 450 points, diagonal 0.166"), "{data}");
        }
    }
}

#[test]
fn a_newcomer_needs_no_data() {
    let arguments = [
        "experiment",
        "schemes",
        "--seeds",
        "1",
        "--max-points",
        "300",
    ];
    let (tables, stderr) = run(arguments, 0);
    for word in [
        "paper",
        "method",
        "pattern %",
        "progressive",
        "synthetic walk",
    ] {
        assert!(tables.contains(word), "no {word} in {tables}");
    }
    assert!(stderr.contains("contact distance"), "{stderr}");
}

#[test]
fn wrong_requests_are_told_before_anything_is_measured() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let (cloud, empty, there) = (at("bowl.ply"), at("empty.ply"), at("there.svg"));
    bowl(&cloud);
    std::fs::write(&empty, "ply\nformat ascii 1.0\nelement vertex 0\nproperty float x\nproperty float y\nproperty float z\nend_header\n").unwrap();
    std::fs::write(&there, "").unwrap();
    for (arguments, code, word) in [
        (vec!["colour"], 2, "possible values"),
        (vec!["packing", "-o", "curve.bmp"], 2, ".svg"),
        (vec!["packing", "-o", text(&there)], 2, "--overwrite"),
        (vec!["loss", text(&cloud)], 2, "depth frames"),
        (vec!["packing", text(&empty)], 4, "at least 50"),
        (vec!["packing", "nowhere.ply"], 4, "nowhere.ply"),
        (vec!["features", text(&cloud)], 4, "at least two"),
        (vec!["packing", "--seeds", "0"], 2, "--seeds"),
    ] {
        let mut all = vec!["experiment"];
        all.extend(arguments);
        let (_, stderr) = run(&all, code);
        assert!(stderr.contains(word), "{all:?}: {stderr}");
    }
}
