//! Points with their SAINT features as NumPy arrays in one `.npz` file, for training loops.
//!
//! | array | shape | type | holds |
//! |---|---|---|---|
//! | `points` | n, 3 | f4 | positions about `origin`, metres |
//! | `normals` | n, 3 | f4 | unit normals of the local spheres, towards the camera; 0 where there is none |
//! | `features` | n, 15 | f4 | [`COLUMNS`] |
//! | `columns` | 15 | S17 | their names |
//! | `sphere` | n | i4 | row of the point's sphere in `spheres`, −1 for none |
//! | `spheres` | m, 4 | f4 | centre about `origin` and radius, metres; 0 where a number is not in use |
//! | `pixel` | n | i4 | `y * width + x`; absent for polar maps, which have no pixels |
//! | `object` | n | i4 | number of the point's object; models of static clouds only |
//! | `origin` | 3 | f8 | what positions count from, metres |
//!
//! A model's normals point away from their object's centroid, as there is no camera, and
//! neighbours are of the same object.
//!
//! The file is an uncompressed ZIP of `.npy` files, as `numpy.savez` writes it:
//! `torch.from_numpy(np.load("000000.npz")["features"])`.

use super::{ExportCloud, ExportFrame, is_measured, sphere_of};
use crate::features::{COLUMNS, FeatureOptions, Features};
use crate::fit::cloud::UNASSIGNED;
use crate::loss::Ball;
use glam::DVec3;
use std::io::{Cursor, Write};
use zip::ZipWriter;
use zip::result::ZipError;
use zip::write::SimpleFileOptions;

/// What goes into a file.
#[derive(Default)]
pub(crate) struct Content {
    /// Positions in the source's coordinates, metres.
    pub points: Vec<DVec3>,
    /// Of each point, its place in `spheres` or `UNASSIGNED`.
    pub owners: Vec<u32>,
    pub spheres: Vec<Ball>,
    /// Number and points of each object of a scene, all points in turn; empty where there is
    /// but one cloud.
    pub objects: Vec<(u32, usize)>,
    /// Of each point its pixel, as bytes.
    pub pixels: Option<Vec<u8>>,
    pub origin: DVec3,
    pub view: Option<DVec3>,
}

/// Replaces `file` by the measured pixels of a frame. A sphere's row is its slot.
///
/// # Errors
/// More data than a ZIP file can hold.
pub fn points(frame: &ExportFrame<'_>, file: &mut Vec<u8>) -> Result<(), String> {
    let mut content = Content {
        // the camera stands at the zero of the optical frame
        view: Some(DVec3::ZERO),
        ..Content::default()
    };
    for point in frame.points() {
        content.points.push(point.position.as_dvec3());
        content
            .owners
            .push(point.sphere.map_or(UNASSIGNED, u32::from));
    }
    content.spheres = frame
        .spheres
        .iter()
        .map(|slot| slot.map_or(Ball::default(), |s| ball(s.center_radius())))
        .collect();
    let measured = frame.depth_m.iter().enumerate();
    content.pixels = Some(
        measured
            .filter(|(_, z)| is_measured(**z))
            .flat_map(|(pixel, _)| (pixel as i32).to_le_bytes())
            .collect(),
    );
    write(&content, file)
}

/// Replaces `file` by the points of a polar frame.
///
/// # Errors
/// More data than a ZIP file can hold.
pub fn cloud_points(cloud: &ExportCloud<'_>, file: &mut Vec<u8>) -> Result<(), String> {
    let map = cloud.map;
    let mut content = Content {
        origin: map.origin,
        view: Some(DVec3::ZERO),
        ..Content::default()
    };
    for (s, patch) in map.patches.iter().enumerate() {
        let grid = patch.grid(f64::from(map.step_m));
        let owner = u16::try_from(s).ok().and_then(sphere_of);
        for &cell in map.claims(s) {
            content.points.push(grid.point(cell) + map.origin);
            content.owners.push(owner.map_or(UNASSIGNED, u32::from));
        }
        let (center, radius) = patch.center_radius();
        content.spheres.push(ball((center + map.origin, radius)));
    }
    write(&content, file)
}

fn ball((center, radius): (DVec3, f64)) -> Ball {
    Ball { center, radius }
}

/// Replaces `file` by the arrays.
pub(crate) fn write(content: &Content, file: &mut Vec<u8>) -> Result<(), String> {
    let options = FeatureOptions {
        view: content.view,
        origin: content.origin,
        ..FeatureOptions::default()
    };
    let (points, origin) = (&content.points, content.origin);
    let whole = [(0, points.len())];
    let objects = if content.objects.is_empty() {
        &whole
    } else {
        &content.objects[..]
    };
    let mut features = Features::default();
    let (mut own, mut first) = (Vec::new(), 0);
    for &(object, count) in objects {
        let range = first..(first + count).min(points.len());
        first = range.end;
        own.extend((0..range.len()).flat_map(|_| object.to_le_bytes()));
        let of_object = (&points[range.clone()], &content.owners[range]);
        let found = Features::new(of_object.0, &content.spheres, of_object.1, &options);
        features.values.extend(found.values);
        features.normals.extend(found.normals);
    }
    let about_origin = |p: DVec3| (p - origin).as_vec3().to_array();
    let row = |s: &Ball| match s.radius > 0.0 {
        true => {
            let [x, y, z] = about_origin(s.center);
            [x, y, z, s.radius as f32]
        }
        false => [0.0; 4],
    };
    let (n, m) = (points.len(), content.spheres.len());
    let width = COLUMNS.iter().map(|c| c.name.len()).max().unwrap_or(1);
    let names: Vec<u8> = COLUMNS
        .iter()
        .flat_map(|c| c.name.bytes().chain([0].into_iter().cycle()).take(width))
        .collect();
    let owner = |&o: &u32| i32::try_from(o).unwrap_or(-1).to_le_bytes();
    let mut arrays = vec![
        (
            "points",
            "<f4",
            vec![n, 3],
            floats(points.iter().flat_map(|p| about_origin(*p))),
        ),
        (
            "normals",
            "<f4",
            vec![n, 3],
            floats(features.normals.iter().flatten().copied()),
        ),
        (
            "features",
            "<f4",
            vec![n, COLUMNS.len()],
            floats(features.values.iter().copied()),
        ),
        (
            "sphere",
            "<i4",
            vec![n],
            content.owners.iter().flat_map(owner).collect(),
        ),
        (
            "spheres",
            "<f4",
            vec![m, 4],
            floats(content.spheres.iter().flat_map(row)),
        ),
        (
            "origin",
            "<f8",
            vec![3],
            origin
                .to_array()
                .iter()
                .flat_map(|v| v.to_le_bytes())
                .collect(),
        ),
    ];
    let text = format!("|S{width}");
    arrays.push(("columns", &text, vec![COLUMNS.len()], names));
    if !content.objects.is_empty() {
        arrays.push(("object", "<i4", vec![n], own));
    }
    if let Some(pixels) = &content.pixels {
        arrays.push(("pixel", "<i4", vec![n], pixels.clone()));
    }
    file.clear();
    zip_arrays(&arrays, file).map_err(|e| e.to_string())
}

/// Name, NumPy type, shape, bytes in C order.
type Array<'a> = (&'a str, &'a str, Vec<usize>, Vec<u8>);

fn zip_arrays(arrays: &[Array<'_>], file: &mut Vec<u8>) -> Result<(), ZipError> {
    let stored = SimpleFileOptions::default().compression_method(zip::CompressionMethod::Stored);
    let mut zip = ZipWriter::new(Cursor::new(file));
    for (name, kind, shape, bytes) in arrays {
        // members beyond 4 GB need to be announced
        let stored = stored.large_file(bytes.len() >= u32::MAX as usize - 1024);
        zip.start_file(format!("{name}.npy"), stored)?;
        zip.write_all(&npy_header(kind, shape))?;
        zip.write_all(bytes)?;
    }
    zip.finish()?;
    Ok(())
}

fn floats(values: impl Iterator<Item = f32>) -> Vec<u8> {
    values.flat_map(f32::to_le_bytes).collect()
}

/// The `.npy` header, version 1.0 (NumPy enhancement proposal 1): magic, length, a Python
/// literal, padded so that the data start at a multiple of 64.
fn npy_header(kind: &str, shape: &[usize]) -> Vec<u8> {
    let sizes: Vec<String> = shape.iter().map(|s| format!("{s},")).collect();
    let mut text = format!(
        "{{'descr': '{kind}', 'fortran_order': False, 'shape': ({}), }}",
        sizes.join(" ")
    );
    // 10 bytes before the text, a line feed after it
    let padded = (10 + text.len() + 1).next_multiple_of(64) - 11;
    text.push_str(&" ".repeat(padded - text.len()));
    text.push('\n');
    let mut header = b"\x93NUMPY\x01\x00".to_vec();
    header.extend_from_slice(&(text.len() as u16).to_le_bytes());
    header.extend_from_slice(text.as_bytes());
    header
}
