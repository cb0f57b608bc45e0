//! Every kind of bad input is one error that names file, frame and remedy.

use super::camera_json::write_camera_json;
use super::exr::write_exr_depth;
use super::png::write_png_depth;
use super::tests::{H, W, assert_says, camera, depth, failure, given, opened, png, png_folder};
use super::*;
use crate::capture::Next;
use crate::frame::{Camera, DepthFrame};
use std::fs;

#[test]
fn inputs_that_are_no_sequence() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    let none = SequenceOptions::default();
    assert_says(
        &failure(&root.join("nowhere"), &none),
        &["nowhere", "No such file", "; give"],
    );
    assert_says(&failure(root, &none), &["none of its 0 files", "; give"]);
    fs::write(root.join("a.txt"), "x").unwrap();
    assert_says(
        &failure(&root.join("a.txt"), &none),
        &["a.txt", "neither an .exr"],
    );
    fs::create_dir(root.join("depth")).unwrap();
    assert_says(&failure(root, &none), &["depth: none of its 0 files"]);
    png(&root.join("depth/000001.png"), 1);
    assert_says(
        &failure(root, &none),
        &["intrinsics are missing", "--intrinsics FILE"],
    );
    fs::write(root.join("camera.json"), "{\"fx\": 1}").unwrap();
    assert_says(
        &failure(root, &none),
        &["camera.json", "no fx, fy, cx, cy", "repair"],
    );
    let tall = Camera {
        height: 9,
        ..camera()
    };
    write_camera_json(root, &tall).unwrap();
    assert_says(
        &failure(root, &none),
        &["4x9", "4x3", "another aspect", "--intrinsics"],
    );
}

#[test]
fn two_cameras_in_one_folder() {
    let folder = tempfile::tempdir().unwrap();
    let mut camera = camera();
    for number in 0..2 {
        camera.intrinsics.fx += number as f64;
        let frame = DepthFrame {
            sequence: number,
            depth: depth(number),
            ..DepthFrame::default()
        };
        let path = folder.path().join(format!("{number}.exr"));
        write_exr_depth(&path, &camera, &frame).unwrap();
    }
    let mut frame = DepthFrame::default();
    let mut source = opened(folder.path());
    assert_eq!(source.next(&mut frame).unwrap(), Next::Frame);
    let message = source.next(&mut frame).unwrap_err().to_string();
    assert_says(
        &message,
        &["1.exr (frame 1)", "fx: 6.0", "fx: 5.0", "--intrinsics"],
    );
    let mut source = open(folder.path(), &given()).unwrap();
    assert_eq!(source.next(&mut frame).unwrap(), Next::Frame);
    assert_eq!(source.next(&mut frame).unwrap(), Next::Frame);
}

#[test]
fn damaged_images_name_file_and_frame() {
    let folder = png_folder();
    let second = folder.path().join("depth/000001.png");
    let whole = fs::read(&second).unwrap();
    let grey8 = image::GrayImage::new(W, H);
    let colour = image::RgbImage::new(W, H);
    type Damage<'a> = (&'a dyn Fn(), &'a [&'a str]);
    let cut = || fs::write(&second, &whole[..whole.len() / 2]).unwrap();
    let empty = || fs::write(&second, []).unwrap();
    let eight = || grey8.save(&second).unwrap();
    let rgb = || colour.save(&second).unwrap();
    let small = || write_png_depth(&second, 2, 2, &[1; 4]).unwrap();
    let gone = || fs::remove_file(&second).unwrap();
    let damages: [Damage<'_>; 6] = [
        (&cut, &["damaged"]),
        (&empty, &["damaged"]),
        (&eight, &["8-bit", "16 bits"]),
        (&rgb, &["Rgb8", "16-bit grey"]),
        (&small, &["2x2", "4x3", "one size"]),
        (&gone, &["No such file"]),
    ];
    for (damage, words) in damages {
        fs::write(&second, &whole).unwrap();
        let mut source = opened(folder.path());
        let mut frame = DepthFrame::default();
        assert_eq!(source.next(&mut frame).unwrap(), Next::Frame);
        damage();
        let message = source.next(&mut frame).unwrap_err().to_string();
        assert_says(&message, &["000001.png", "(frame 1)", "; "]);
        assert_says(&message, words);
        // The frames after it are still there for a caller that wants them.
        assert_eq!(source.next(&mut frame).unwrap(), Next::Frame);
        assert_eq!((frame.sequence, &frame.depth), (3, &depth(3)));
        assert_eq!(source.next(&mut frame).unwrap(), Next::End);
    }
    fs::write(folder.path().join("depth/000000.png"), b"not a png").unwrap();
    let message = failure(folder.path(), &SequenceOptions::default());
    assert_says(&message, &["000000.png", "(frame 0)"]);
}
