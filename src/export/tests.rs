use super::*;
use crate::capture::Next;
use crate::capture::sequences::{SequenceOptions, open};
use crate::frame::{DepthFrame, Intrinsics};
use glam::DVec3;
use std::fs;
use std::path::Path;

const WIDTH: usize = 16;
const HEIGHT: usize = 12;

fn camera() -> Camera {
    Camera {
        width: WIDTH as u32,
        height: HEIGHT as u32,
        intrinsics: Intrinsics {
            fx: 15.0,
            fy: 14.5,
            cx: 7.3,
            cy: 5.9,
        },
        depth_unit_m: 0.001,
        invalid: vec![1500, 65535],
        depth_min_m: 0.1,
        depth_max_m: 20.0,
        fps: Some(30.0),
        name: "test".into(),
    }
}

/// A frame with every kind of pixel: on a sphere, on none, unmeasured, not finite.
struct Scene {
    camera: Camera,
    depth: Vec<f32>,
    labels: Vec<u16>,
    spheres: Vec<Option<Sphere>>,
}

impl Scene {
    fn new() -> Self {
        let pixels = WIDTH * HEIGHT;
        let mut depth: Vec<f32> = (0..pixels).map(|i| 0.5 + 0.0101 * i as f32).collect();
        let mut labels: Vec<u16> = (0..pixels).map(|i| (i / 40 % 4) as u16).collect();
        (depth[3], labels[3]) = (0.0, INVALID);
        (depth[4], labels[4]) = (f32::NAN, INVALID);
        (depth[5], labels[5]) = (-1.0, INVALID);
        labels[6] = NO_SPHERE;
        let sphere = |x: f64, r: f64| Sphere::from_center_radius(DVec3::new(x, 0.25, 3.0), r);
        Self {
            camera: camera(),
            depth,
            labels,
            spheres: vec![
                sphere(-0.5, 0.75),
                None,
                sphere(0.25, 1.5),
                sphere(1.0, 0.1),
            ],
        }
    }

    fn frame(&self) -> ExportFrame<'_> {
        ExportFrame {
            camera: &self.camera,
            sequence: 42,
            time: FrameTime {
                device_ns: 123_456_789,
                wall_ns: 1_700_000_000_123_456_789,
            },
            depth_m: &self.depth,
            labels: &self.labels,
            spheres: &self.spheres,
        }
    }

    /// x, y, z, sphere of every measured pixel, in f64 by the pinhole equations.
    fn truth(&self) -> Vec<([f64; 3], i32)> {
        let lens = self.camera.intrinsics;
        let points = (0..WIDTH * HEIGHT)
            .filter(|i| self.depth[*i] > 0.0)
            .map(|i| {
                let (u, v, z) = (
                    (i % WIDTH) as f64,
                    (i / WIDTH) as f64,
                    f64::from(self.depth[i]),
                );
                let position = [(u - lens.cx) / lens.fx * z, (v - lens.cy) / lens.fy * z, z];
                let sphere = match self.labels[i] {
                    NO_SPHERE => -1,
                    label => i32::from(label),
                };
                (position, sphere)
            });
        points.collect()
    }
}

fn assert_points(found: &[([f32; 3], [u8; 3], i32)], scene: &Scene) {
    let truth = scene.truth();
    assert_eq!(found.len(), truth.len());
    for ((position, rgb, sphere), (expected, number)) in found.iter().zip(&truth) {
        for (a, b) in position.iter().zip(expected) {
            assert!(
                (f64::from(*a) - b).abs() < 1e-6,
                "{position:?} for {expected:?}"
            );
        }
        assert_eq!(sphere, number);
        assert_eq!(*rgb, color::of_sphere(u16::try_from(*number).ok()));
    }
}

/// The vertices of a PLY file, each property as a double, read by the `ply-rs-bw` crate.
fn read_ply(file: &[u8], properties: &[&str]) -> Vec<Vec<f64>> {
    use ply_rs_bw::ply::Property;
    let parser = ply_rs_bw::parser::Parser::<ply_rs_bw::ply::DefaultElement>::new();
    let ply = parser.read_ply(&mut io::Cursor::new(file)).unwrap();
    let value = |property: &Property| match property {
        Property::Float(value) => f64::from(*value),
        Property::UChar(value) => f64::from(*value),
        Property::Int(value) => f64::from(*value),
        other => panic!("{other:?}"),
    };
    let vertices = ply.payload["vertex"].iter();
    vertices
        .map(|vertex| {
            properties
                .iter()
                .map(|name| value(&vertex[*name]))
                .collect()
        })
        .collect()
}

#[test]
fn ply_points_are_read_back() {
    let scene = Scene::new();
    let mut file = Vec::new();
    ply::points(&scene.frame(), &mut file);
    let rows = read_ply(&file, &["x", "y", "z", "red", "green", "blue", "sphere"]);
    let points: Vec<_> = rows
        .iter()
        .map(|r| {
            let position = [r[0] as f32, r[1] as f32, r[2] as f32];
            (position, [r[3] as u8, r[4] as u8, r[5] as u8], r[6] as i32)
        })
        .collect();
    assert_points(&points, &scene);
}

#[test]
fn ply_spheres_are_read_back() {
    let scene = Scene::new();
    let mut file = Vec::new();
    ply::spheres(&scene.frame(), &mut file);
    let rows = read_ply(&file, &["x", "y", "z", "radius", "sphere"]);
    let truth = [(-0.5, 0.75, 0.0), (0.25, 1.5, 2.0), (1.0, 0.1, 3.0)];
    assert_eq!(rows.len(), truth.len());
    for (row, (x, radius, number)) in rows.iter().zip(truth) {
        let expected = [x, 0.25, 3.0, radius, number];
        for (a, b) in row.iter().zip(expected) {
            assert!((a - b).abs() < 1e-4, "{row:?} for {expected:?}");
        }
    }
}

#[test]
fn pcd_points_are_read_back() {
    use pcd_rs::{DynReader, Field};
    let scene = Scene::new();
    let mut file = Vec::new();
    pcd::points(&scene.frame(), &mut file).unwrap();
    let reader = DynReader::from_reader(io::Cursor::new(&file)).unwrap();
    let names: Vec<_> = reader
        .meta()
        .field_defs
        .iter()
        .map(|f| f.name.clone())
        .collect();
    assert_eq!(names, ["x", "y", "z", "rgb", "sphere"]);
    let points: Vec<_> = reader
        .map(|record| match &record.unwrap().0[..] {
            [
                Field::F32(x),
                Field::F32(y),
                Field::F32(z),
                Field::U32(rgb),
                Field::I32(n),
            ] => {
                let [_, red, green, blue] = rgb[0].to_be_bytes();
                ([x[0], y[0], z[0]], [red, green, blue], n[0])
            }
            other => panic!("{other:?}"),
        })
        .collect();
    assert_points(&points, &scene);
}

/// One array of an .npz file: its NumPy type, shape and bytes, read by the `zip` crate.
fn read_npz(file: &[u8], name: &str) -> (String, String, Vec<u8>) {
    let mut zip = zip::ZipArchive::new(io::Cursor::new(file)).unwrap();
    let mut bytes = Vec::new();
    let mut member = zip.by_name(&format!("{name}.npy")).unwrap();
    io::Read::read_to_end(&mut member, &mut bytes).unwrap();
    assert_eq!(bytes[..8], *b"\x93NUMPY\x01\x00");
    let length = usize::from(u16::from_le_bytes([bytes[8], bytes[9]]));
    assert_eq!((10 + length) % 64, 0, "NumPy wants its data aligned");
    let header = String::from_utf8(bytes[10..10 + length].to_vec()).unwrap();
    assert!(header.ends_with('\n') && header.contains("'fortran_order': False"));
    let between = |from: &str, to: &str| {
        let rest = header.split(from).nth(1).unwrap();
        rest.split(to).next().unwrap().to_owned()
    };
    let (kind, shape) = (between("'descr': '", "'"), between("'shape': (", ")"));
    (kind, shape, bytes[10 + length..].to_vec())
}

#[test]
fn npz_arrays_are_read_back() {
    use crate::features::{COLUMNS, PAPER_COLUMNS};
    let scene = Scene::new();
    let truth = scene.truth();
    let n = truth.len();
    let mut file = Vec::new();
    npz::points(&scene.frame(), &mut file).unwrap();
    let floats = |name: &str, shape: &str| -> Vec<f32> {
        let (kind, found, bytes) = read_npz(&file, name);
        assert_eq!((kind.as_str(), found.as_str()), ("<f4", shape), "{name}");
        let value = |b: &[u8]| f32::from_le_bytes(b.try_into().unwrap());
        bytes.chunks_exact(4).map(value).collect()
    };
    let ints = |name: &str| -> Vec<i32> {
        let (kind, shape, bytes) = read_npz(&file, name);
        assert_eq!((kind.as_str(), shape), ("<i4", format!("{n},")), "{name}");
        let value = |b: &[u8]| i32::from_le_bytes(b.try_into().unwrap());
        bytes.chunks_exact(4).map(value).collect()
    };
    let points = floats("points", &format!("{n}, 3,"));
    for (found, (position, _)) in points.chunks_exact(3).zip(&truth) {
        for (a, b) in found.iter().zip(position) {
            assert!((f64::from(*a) - b).abs() < 1e-6);
        }
    }
    let owners = ints("sphere");
    assert!(
        owners
            .iter()
            .zip(&truth)
            .all(|(found, (_, sphere))| found == sphere)
    );
    let measured = (0..WIDTH * HEIGHT).filter(|i| scene.depth[*i] > 0.0);
    assert!(ints("pixel").iter().map(|p| *p as usize).eq(measured));
    let spheres = floats("spheres", "4, 4,");
    assert_eq!(spheres[4..8], [0.0; 4], "a slot that is not in use");
    assert!((spheres[0] + 0.5).abs() < 1e-5 && (spheres[3] - 0.75).abs() < 1e-5);
    // the paper's columns follow from the other arrays
    let features = floats("features", &format!("{n}, {},", COLUMNS.len()));
    for (i, row) in features.chunks_exact(COLUMNS.len()).enumerate() {
        let own = spheres
            .chunks_exact(4)
            .nth(owners[i].max(0) as usize)
            .unwrap();
        if owners[i] < 0 || own[3] == 0.0 {
            continue;
        }
        assert_eq!(row[..4], *own);
        let (x, y) = (points[3 * i] - own[0], points[3 * i + 1] - own[1]);
        assert!(
            (row[4] - x.hypot(y)).abs() < 1e-5,
            "{} {}",
            row[4],
            x.hypot(y)
        );
        let turn = (row[5] - y.atan2(x)).abs() % std::f32::consts::TAU;
        let off = turn.min(std::f32::consts::TAU - turn);
        assert!(off < 1e-3, "{turn}");
        assert!(row[PAPER_COLUMNS..].iter().all(|v| v.is_finite()));
    }
    let (kind, shape, names) = read_npz(&file, "columns");
    let width: usize = kind.strip_prefix("|S").unwrap().parse().unwrap();
    assert_eq!(shape, format!("{},", COLUMNS.len()));
    for (found, column) in names.chunks_exact(width).zip(&COLUMNS) {
        assert_eq!(
            String::from_utf8_lossy(found).trim_end_matches('\0'),
            column.name
        );
    }
    assert_eq!(floats("normals", &format!("{n}, 3,")).len(), 3 * n);
    assert_eq!(read_npz(&file, "origin").2, [0; 24]);
}

#[test]
fn a_picture_is_coloured_by_sphere_and_black_where_nothing_is() {
    let scene = Scene::new();
    let mut file = Vec::new();
    png::picture(&scene.frame(), &mut file).unwrap();
    let picture = image::load_from_memory(&file).unwrap().to_rgb8();
    assert_eq!(picture.dimensions(), (WIDTH as u32, HEIGHT as u32));
    for (i, pixel) in picture.pixels().enumerate() {
        let plain = color::of_sphere(sphere_of(scene.labels[i]));
        let expected = match scene.depth[i] {
            z if z > 0.0 => color::shaded(plain, z),
            _ => [0, 0, 0],
        };
        assert_eq!(pixel.0, expected, "pixel {i}");
    }
}

#[test]
fn a_preview_takes_the_middle_pixels() {
    let scene = Scene::new();
    let mut small = png::Picture::default();
    png::draw(&scene.frame(), (4, 3), &mut small);
    let mut full = png::Picture::default();
    png::draw(&scene.frame(), (WIDTH as u32, HEIGHT as u32), &mut full);
    for v in 0..3 {
        for u in 0..4 {
            let (at, source) = ((v * 4 + u) * 3, ((v * 4 + 2) * WIDTH + u * 4 + 2) * 3);
            assert_eq!(small.rgb[at..at + 3], full.rgb[source..source + 3]);
        }
    }
    png::draw(&scene.frame(), (0, 7), &mut small);
    assert!(small.rgb.is_empty());
    png::draw(&scene.frame(), (50, 50), &mut small);
    assert_eq!(small.rgb.len(), 7500);
}

/// Exports one frame into `folder` and reads it as an input; gives camera, frame.
fn replayed(scene: &Scene, format: Format, folder: &Path) -> (Camera, DepthFrame) {
    let output = Output::Folder(folder.to_owned());
    let mut files = FileSequence::create(format, output, false).unwrap();
    files.frame(&scene.frame(), 0).unwrap();
    assert_eq!(files.finish().unwrap().files, 1);
    let mut source = open(folder, &SequenceOptions::default()).unwrap();
    let mut frame = DepthFrame::default();
    assert_eq!(source.next(&mut frame).unwrap(), Next::Frame);
    (source.camera().clone(), frame)
}

#[test]
fn depth_images_are_inputs_again() {
    for format in [Format::Exr, Format::Png16] {
        let folder = tempfile::tempdir().unwrap();
        let scene = Scene::new();
        let (camera, frame) = replayed(&scene, format, folder.path());
        assert_eq!(camera.intrinsics, scene.camera.intrinsics, "{format:?}");
        for (i, (code, depth)) in frame.depth.iter().zip(&scene.depth).enumerate() {
            let back = f64::from(*code) * camera.depth_unit_m;
            let measured = is_measured(*depth);
            assert_eq!(*code != 0, measured, "{format:?} pixel {i}");
            if measured {
                let off = (back - f64::from(*depth)).abs();
                // half a unit; one and a half where the nearest code means "no measurement"
                let near_invalid = format == Format::Png16 && (depth - 1.5).abs() < 0.0005;
                let bound = if near_invalid { 0.001_501 } else { 0.000_501 };
                assert!(off <= bound, "{format:?} pixel {i}: {back} for {depth}");
            }
        }
    }
}

#[test]
fn exr_holds_the_decoded_depth_exactly() {
    use ::exr::prelude::*;
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.exr");
    let scene = Scene::new();
    exr::depth(&scene.frame(), &path).unwrap();
    let image = read_first_flat_layer_from_file(&path).unwrap();
    let channel = &image.layer_data.channel_data.list[0];
    assert!(channel.name.eq("Z"));
    let values: Vec<f32> = channel.sample_data.values_as_f32().collect();
    let expected: Vec<f32> = scene
        .depth
        .iter()
        .map(|z| if is_measured(*z) { *z } else { 0.0 })
        .collect();
    assert_eq!(values, expected);
}

#[test]
fn no_depth_becomes_a_code_that_means_none() {
    let camera = camera();
    assert_eq!(png16::code(&camera, 1.5), 1499); // 1500 means "no measurement" here
    assert_eq!(png16::code(&camera, 65.535), 65534);
    assert_eq!(png16::code(&camera, 65.6), 0);
    for none in [0.0, -1.0, 0.0004, f32::NAN, f32::INFINITY] {
        assert_eq!(png16::code(&camera, none), 0, "{none}");
    }
}

fn listing(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder).unwrap();
    let mut names: Vec<_> = entries
        .map(|e| e.unwrap().file_name().into_string().unwrap())
        .collect();
    names.sort();
    names
}

#[test]
fn a_folder_gets_numbered_files_and_is_never_mixed() {
    let base = tempfile::tempdir().unwrap();
    let folder = base.path().join("new/out");
    let output = || Output::Folder(folder.clone());
    let scene = Scene::new();
    let export = |overwrite, frames: &[u64]| -> Result<ExportSummary, ExportError> {
        let mut files = FileSequence::create(Format::Ply, output(), overwrite)?;
        for number in frames {
            files.frame(&scene.frame(), *number)?;
        }
        files.finish()
    };
    let summary = export(false, &[0, 1, 12]).unwrap();
    assert_eq!(listing(&folder), ["000000.ply", "000001.ply", "000012.ply"]);
    let size = fs::metadata(folder.join("000012.ply")).unwrap().len();
    assert_eq!((summary.files, summary.bytes), (3, 3 * size));
    assert!(matches!(
        export(false, &[7]),
        Err(ExportError::Exists { folder: true, .. })
    ));
    fs::write(folder.join("notes.ply"), "mine").unwrap();
    export(true, &[7]).unwrap();
    assert_eq!(listing(&folder), ["000007.ply", "notes.ply"]);
}

#[test]
fn one_file_takes_one_frame_and_no_frame_is_an_error() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.png");
    let scene = Scene::new();
    for (_, format) in Format::NAMES {
        let path = folder
            .path()
            .join(format!("{format:?}.{}", format.extension()));
        let create =
            |overwrite| FileSequence::create(format, Output::File(path.clone()), overwrite);
        let mut files = create(false).unwrap();
        files.frame(&scene.frame(), 3).unwrap();
        let second = files.frame(&scene.frame(), 4);
        assert!(
            matches!(second, Err(ExportError::SingleFile { .. })),
            "{format:?}"
        );
        let bytes = files.finish().unwrap().bytes;
        assert_eq!(bytes, fs::metadata(&path).unwrap().len());
        assert!(matches!(
            create(false),
            Err(ExportError::Exists { folder: false, .. })
        ));
        create(true).unwrap().frame(&scene.frame(), 3).unwrap();
    }
    let files = FileSequence::create(Format::Png, Output::File(path.clone()), false).unwrap();
    assert!(matches!(files.finish(), Err(ExportError::Empty { .. })));
    assert!(!path.exists());
}

#[test]
fn a_target_that_cannot_be_written_is_an_error() {
    let folder = tempfile::tempdir().unwrap();
    let scene = Scene::new();
    for (_, format) in Format::NAMES {
        let path = folder.path().join("missing/a.x");
        let mut files = FileSequence::create(format, Output::File(path), false).unwrap();
        let error = files.frame(&scene.frame(), 0).unwrap_err();
        assert!(error.to_string().contains("missing"), "{error}");
        assert!(matches!(files.finish(), Err(ExportError::Empty { .. })));
    }
    if Path::new("/dev/full").exists() {
        let output = Output::File("/dev/full".into());
        let mut files = FileSequence::create(Format::Ply, output, true).unwrap();
        let error = files.frame(&scene.frame(), 0).unwrap_err();
        assert!(
            matches!(error, ExportError::Write { files: 0, .. }),
            "{error}"
        );
    }
}

#[test]
fn lengths_that_do_not_fit_the_camera_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let scene = Scene::new();
    let output = Output::Folder(folder.path().to_owned());
    let mut files = FileSequence::create(Format::Ply, output, false).unwrap();
    let short = ExportFrame {
        labels: &scene.labels[1..],
        ..scene.frame()
    };
    let error = files.frame(&short, 0).unwrap_err();
    assert!(
        matches!(
            error,
            ExportError::FrameSize {
                labels: 191,
                pixels: 192,
                ..
            }
        ),
        "{error}"
    );
    let mut picture = png::Picture::default();
    png::draw(&short, (4, 4), &mut picture);
    assert!(picture.rgb.iter().all(|c| *c == 0));
}

#[test]
fn format_names_are_those_of_the_command_line() {
    for (name, format) in Format::NAMES {
        assert_eq!(name.parse::<Format>().unwrap(), format);
    }
    let error = "obj".parse::<Format>().unwrap_err().to_string();
    assert!(
        error.contains("\"obj\"") && error.contains("png16"),
        "{error}"
    );
}
