//! Several cameras in one recording, and colour beside depth, as a user does it.
#![allow(
    clippy::panic,
    clippy::unwrap_used,
    reason = "a test fails by panicking"
)]

mod program;

use program::{files, info, json, repository, run, text};
use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

/// The points of a binary PLY of ours: properties by name, as numbers.
fn ply(path: &Path) -> Vec<BTreeMap<String, f64>> {
    let bytes = fs::read(path).unwrap();
    let end = b"end_header\n";
    let at = bytes.windows(end.len()).position(|w| w == end).unwrap() + end.len();
    let header = String::from_utf8(bytes[..at].to_vec()).unwrap();
    let mut count = 0;
    let mut properties = Vec::new();
    for line in header.lines() {
        match line.split(' ').collect::<Vec<_>>()[..] {
            ["element", "vertex", n] => count = n.parse().unwrap(),
            ["property", kind, name] => properties.push((kind.to_owned(), name.to_owned())),
            _ => {}
        }
    }
    let mut rest = &bytes[at..];
    let mut take = |kind: &str| {
        let (bytes, after) = rest.split_at(if kind == "uchar" { 1 } else { 4 });
        rest = after;
        match kind {
            "uchar" => f64::from(bytes[0]),
            "int" => f64::from(i32::from_le_bytes(bytes.try_into().unwrap())),
            _ => f64::from(f32::from_le_bytes(bytes.try_into().unwrap())),
        }
    };
    let mut point = || {
        properties
            .iter()
            .map(|(k, n)| (n.clone(), take(k)))
            .collect()
    };
    let points: Vec<BTreeMap<String, f64>> = (0..count).map(|_| point()).collect();
    assert!(rest.is_empty());
    points
}

#[test]
fn two_cameras_of_one_room_make_one_room() {
    let folder = tempfile::tempdir().unwrap();
    let recording = folder.path().join("rig.mcap");
    let camera = "synthetic:room,size=160x120,noise=off,paced=false";
    let side = format!("{camera},at=1.3/-0.2/0.6,yaw=-40");
    let to = [
        ["-o", text(&recording)],
        ["-n", "4"],
        ["--max-error", "2mm"],
        ["--contact-distance", "5mm+5e-3z2"],
    ]
    .concat();
    let (stats, _) = run(
        [&["-d", camera, "-d", &side, "--stats", "json"], &to[..]].concat(),
        0,
    );
    let last: Vec<_> = stats
        .lines()
        .map(json)
        .filter(|l| l["final"] == true)
        .collect();
    let mut names: Vec<_> = last.iter().map(|l| l["camera"].as_str().unwrap()).collect();
    names.sort_unstable();
    assert_eq!(names, ["cam0", "cam1"]);
    assert!(last.iter().all(|line| line["frames"] == 4), "{stats}");

    let about = info(&recording);
    let cameras = about["cameras"].as_array().unwrap();
    assert_eq!(cameras.len(), 2);
    assert!(
        cameras
            .iter()
            .all(|c| c["frames"] == 4 && c["notes"]["clock"].is_string())
    );
    assert_eq!(cameras[1]["channels"][0]["topic"], "cam1/calibration");

    let union = folder.path().join("union");
    run(
        [
            "export",
            text(&recording),
            "--merge",
            "--to",
            "ply",
            "-o",
            text(&union),
        ],
        0,
    );
    let clouds = files(&union, "ply");
    assert_eq!(clouds.len(), 4);
    let points = ply(&clouds[0]);
    for number in [0.0, 1.0] {
        let own: Vec<_> = points.iter().filter(|p| p["camera"] == number).collect();
        assert!(
            own.len() > 10_000,
            "{} points of camera {number}",
            own.len()
        );
        // floor at y = 1.1 m, walls at x = -1.9 and 2.1 m: nothing lies behind them
        let outside = own
            .iter()
            .filter(|p| p["y"] > 1.11 || p["x"] < -1.91 || p["x"] > 2.11);
        assert_eq!(outside.count(), 0, "camera {number}");
        let floor = own.iter().filter(|p| (p["y"] - 1.1).abs() < 0.005).count();
        assert!(
            floor > own.len() / 200,
            "{floor} floor points of camera {number}"
        );
    }
    let balls = folder.path().join("balls.ply");
    let one = [
        "--from",
        "1",
        "-n",
        "1",
        "--merge",
        "--to",
        "spheres",
        "-o",
        text(&balls),
    ];
    run([&["export", text(&recording)], &one[..]].concat(), 0);
    // both see the ball of 27 cm on the floor: its spheres are at one place
    let near = |camera: f64| {
        let balls = ply(&balls).into_iter();
        let mut of = balls.filter(|s| s["camera"] == camera && (s["radius"] - 0.27).abs() < 0.02);
        of.any(|s| (s["y"] - 0.83).abs() < 0.02 && (s["z"] - 2.4).abs() < 0.02)
    };
    assert!(near(0.0) && near(1.0), "a ball is missing");

    // one camera alone, and what cannot be merged
    let alone = folder.path().join("alone");
    let exr = ["--camera", "cam1", "--to", "exr", "-o", text(&alone)];
    run([&["export", text(&recording)], &exr[..]].concat(), 0);
    assert_eq!(files(&alone, "exr").len(), 4);
    let none = folder.path().join("none");
    for (more, says) in [
        (&["--merge", "--to", "exr"][..], "exr cannot hold"),
        (&["--camera", "top", "--to", "ply"], "cam0, cam1"),
    ] {
        let all = [&["export", text(&recording), "-o", text(&none)], more].concat();
        let (_, said) = run(all, 2);
        assert!(said.contains(says), "{said}");
    }
}

#[test]
fn the_rig_of_the_readme_is_read_and_a_wrong_one_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let recording = folder.path().join("rig.mcap");
    let rig = repository("recordings/two_views.toml");
    run(
        [
            "--rig",
            text(&rig),
            "-n",
            "2",
            "-s",
            "80x60",
            "-o",
            text(&recording),
        ],
        0,
    );
    let about = info(&recording);
    assert_eq!(
        about["cameras"][1]["channels"][0]["topic"],
        "side/calibration"
    );
    // the file's pose is the one the sensor was put at
    let pose = json(about["cameras"][1]["notes"]["pose"].as_str().unwrap());
    let turn = (30f64).to_radians();
    assert!(
        (pose[0][0].as_f64().unwrap() - turn.cos()).abs() < 1e-9,
        "{pose}"
    );
    assert!(
        (pose[0][2].as_f64().unwrap() + turn.sin()).abs() < 1e-9,
        "{pose}"
    );
    assert_eq!(pose[0][3], 1.3);

    let wrong = folder.path().join("wrong.toml");
    fs::write(&wrong, "[[camera]]\nname = \"a\"\n").unwrap();
    let (_, said) = run(["--rig", text(&wrong)], 4);
    assert!(
        said.contains("wrong.toml") && said.contains("device"),
        "{said}"
    );
    fs::write(
        &wrong,
        "[[camera]]\nname = \"a\"\ndevice = \"synthetic:hall\"\n",
    )
    .unwrap();
    let (_, said) = run(["--rig", text(&wrong)], 2);
    assert!(
        said.contains("camera `a`") && said.contains("hall"),
        "{said}"
    );
}

#[test]
fn a_colour_camera_that_is_not_there_does_not_stop_depth() {
    let device = "synthetic:empty,size=32x24,paced=false";
    let color = ["--color-device", "/nonexistent/video9"];
    let (_, said) = run([&["-d", device, "-n", "3"], &color[..]].concat(), 0);
    assert!(said.contains("depth goes on without it"), "{said}");
    assert!(said.contains("3 of 3 frames"), "{said}");
}

#[test]
fn points_get_the_colours_of_the_image() {
    let folder = tempfile::tempdir().unwrap();
    let input = folder.path().join("input");
    let depth = image::ImageBuffer::from_pixel(64, 48, image::Luma([2000u16]));
    let color = image::RgbImage::from_fn(64, 48, |x, y| image::Rgb([x as u8, y as u8, 99]));
    for (name, images) in [("depth", 0), ("colour", 1)] {
        fs::create_dir_all(input.join(name)).unwrap();
        for n in 0..2 {
            let path = input.join(name).join(format!("{n:04}.png"));
            match images {
                0 => depth.save(path).unwrap(),
                _ => color.save(path).unwrap(),
            }
        }
    }
    // the colour camera stands 0.2 m to the right: at 2 m that is 5 pixels
    let lens = "50,50,31.5,23.5";
    let camera = folder.path().join("color.toml");
    let text_of = "width = 64\nheight = 48\nintrinsics = [50.0, 50.0, 31.5, 23.5]\n\
                   translation = [0.2, 0.0, 0.0]\n";
    fs::write(&camera, text_of).unwrap();
    let recording = folder.path().join("c.mcap");
    let given = [
        "--intrinsics",
        lens,
        "--depth-unit",
        "1mm",
        "--lossless",
        "--fps",
        "30",
    ];
    let colors = [
        "--color",
        "--color-camera",
        text(&camera),
        "-o",
        text(&recording),
    ];
    run([&["replay", text(&input)], &given[..], &colors].concat(), 0);
    let points = folder.path().join("points");
    run(
        [
            "export",
            text(&recording),
            "--to",
            "ply",
            "-o",
            text(&points),
        ],
        0,
    );
    let cloud = ply(&files(&points, "ply")[1]);
    assert_eq!(cloud.len(), 64 * 48);
    for (at, point) in cloud.iter().enumerate() {
        let (x, y) = ((at % 64) as f64, (at / 64) as f64);
        let rgb = [point["red"], point["green"], point["blue"]];
        let want = if x < 5.0 {
            [128.0; 3]
        } else {
            [x - 5.0, y, 99.0]
        };
        assert_eq!(rgb, want, "pixel {x}, {y}");
    }
}
