//! Parts of a model as files other programs read.
//!
//! Points with features as NumPy arrays; points as PLY (`x y z`, `red green blue`, `int sphere`, `int object`) or PCD (`x y z`, `rgb`,
//! `sphere`, `object`), spheres as PLY (`x y z radius`, the rest as of points). Sphere numbers are
//! the object's own. Coordinates are the source's, in metres: double precision where an object
//! lies away from the file's zero, single otherwise.

use super::Geometry;
use crate::export::{color, npz};
use crate::loss::Ball;
use glam::DVec3;
use pcd_rs::{DataKind, PcdSerialize, Schema, ValueKind, WriterInit};
use std::io::{Cursor, Seek, Write};

/// A part and its object's number in the scene.
pub type Placed<'a> = (u32, &'a Geometry);

/// Colour of a sphere; objects begin at different places of the colour circle.
fn color_of(object: u32, sphere: u32) -> color::Rgb {
    // 65534 and 65535 are no numbers of spheres
    let number = object.wrapping_mul(7919).wrapping_add(sphere) % 65_534;
    color::of_sphere(u16::try_from(number).ok())
}

fn single(parts: &[Placed<'_>]) -> bool {
    parts.iter().all(|(_, g)| g.origin() == DVec3::ZERO)
}

fn begin(file: &mut Vec<u8>, count: usize, single: bool, radius: bool) {
    let real = if single { "float" } else { "double" };
    let mut header = format!(
        "ply\nformat binary_little_endian 1.0\ncomment unit m\nelement vertex {count}\n\
         property {real} x\nproperty {real} y\nproperty {real} z\n"
    );
    if radius {
        header.push_str(&format!("property {real} radius\n"));
    }
    header.push_str(
        "property uchar red\nproperty uchar green\nproperty uchar blue\n\
         property int sphere\nproperty int object\nend_header\n",
    );
    file.extend_from_slice(header.as_bytes());
}

fn put_real(file: &mut Vec<u8>, value: f64, single: bool) {
    if single {
        file.extend_from_slice(&(value as f32).to_le_bytes());
    } else {
        file.extend_from_slice(&value.to_le_bytes());
    }
}

fn put_owner(file: &mut Vec<u8>, object: u32, sphere: u32) {
    file.extend_from_slice(&color_of(object, sphere));
    file.extend_from_slice(&sphere.to_le_bytes());
    file.extend_from_slice(&object.to_le_bytes());
}

/// The points as binary PLY.
#[must_use]
pub fn ply_points(parts: &[Placed<'_>]) -> Vec<u8> {
    let points: Vec<_> = parts.iter().map(|(_, g)| g.points()).collect();
    let single = single(parts);
    let count = points.iter().map(Vec::len).sum();
    let mut file = Vec::with_capacity(512 + count * if single { 23 } else { 35 });
    begin(&mut file, count, single, false);
    for (&(object, geometry), points) in parts.iter().zip(&points) {
        for &(p, sphere) in points {
            for v in (p + geometry.origin()).to_array() {
                put_real(&mut file, v, single);
            }
            put_owner(&mut file, object, sphere);
        }
    }
    file
}

/// The spheres as binary PLY.
#[must_use]
pub fn ply_spheres(parts: &[Placed<'_>]) -> Vec<u8> {
    let spheres: Vec<_> = parts.iter().map(|(_, g)| g.spheres()).collect();
    let single = single(parts);
    let mut file = Vec::new();
    begin(&mut file, spheres.iter().map(Vec::len).sum(), single, true);
    for (&(object, geometry), spheres) in parts.iter().zip(&spheres) {
        for (number, &(center, radius)) in spheres.iter().enumerate() {
            for v in (center + geometry.origin()).to_array() {
                put_real(&mut file, v, single);
            }
            put_real(&mut file, radius, single);
            put_owner(&mut file, object, number as u32);
        }
    }
    file
}

/// One point as a PCD file holds it.
struct Record {
    position: DVec3,
    rgb: u32,
    sphere: u32,
    object: u32,
}

impl PcdSerialize for Record {
    fn is_dynamic() -> bool {
        false
    }

    fn write_spec() -> Schema {
        Schema::from_iter([
            ("x", ValueKind::F64, 1),
            ("y", ValueKind::F64, 1),
            ("z", ValueKind::F64, 1),
            ("rgb", ValueKind::U32, 1),
            ("sphere", ValueKind::U32, 1),
            ("object", ValueKind::U32, 1),
        ])
    }

    fn write_chunk<W: Write + Seek>(&self, writer: &mut W, _: &Schema) -> pcd_rs::Result<()> {
        for v in self.position.to_array() {
            writer.write_all(&v.to_le_bytes())?;
        }
        for v in [self.rgb, self.sphere, self.object] {
            writer.write_all(&v.to_le_bytes())?;
        }
        Ok(())
    }

    fn write_line<W: Write + Seek>(&self, writer: &mut W, _: &Schema) -> pcd_rs::Result<()> {
        let [x, y, z] = self.position.to_array();
        let (rgb, sphere, object) = (self.rgb, self.sphere, self.object);
        writeln!(writer, "{x} {y} {z} {rgb} {sphere} {object}")?;
        Ok(())
    }
}

/// The points as binary PCD, coordinates in double precision.
///
/// # Errors
/// What the encoder says.
pub fn pcd_points(parts: &[Placed<'_>]) -> Result<Vec<u8>, String> {
    let points: Vec<_> = parts.iter().map(|(_, g)| g.points()).collect();
    let header = WriterInit {
        width: points.iter().map(Vec::len).sum::<usize>() as u64,
        height: 1,
        viewpoint: pcd_rs::ViewPoint::default(),
        data_kind: DataKind::Binary,
        schema: None,
        version: None,
    };
    let mut file = Vec::new();
    let mut writer = header
        .build_from_writer::<Record, _>(Cursor::new(&mut file))
        .map_err(|e| e.to_string())?;
    for (&(object, geometry), points) in parts.iter().zip(&points) {
        for &(p, sphere) in points {
            let [red, green, blue] = color_of(object, sphere);
            let record = Record {
                position: p + geometry.origin(),
                rgb: u32::from_be_bytes([0, red, green, blue]),
                sphere,
                object,
            };
            writer.push(&record).map_err(|e| e.to_string())?;
        }
    }
    writer.finish().map_err(|e| e.to_string())?;
    Ok(file)
}

/// The points with normals and features as NumPy arrays ([`npz`]). The origin is the first
/// object's.
///
/// # Errors
/// More data than the file can hold.
pub fn npz_points(parts: &[Placed<'_>]) -> Result<Vec<u8>, String> {
    let mut content = npz::Content {
        origin: parts.first().map_or(DVec3::ZERO, |(_, g)| g.origin()),
        ..npz::Content::default()
    };
    for &(object, geometry) in parts {
        let first = content.spheres.len() as u32;
        let points = geometry.points();
        content.objects.push((object, points.len()));
        for (p, sphere) in points {
            content.points.push(p + geometry.origin());
            content.owners.push(first + sphere);
        }
        let ball = |(center, radius): (DVec3, f64)| Ball {
            center: center + geometry.origin(),
            radius,
        };
        content
            .spheres
            .extend(geometry.spheres().into_iter().map(ball));
    }
    let mut file = Vec::new();
    npz::write(&content, &mut file)?;
    Ok(file)
}
