//! Points and spheres as binary PLY (little endian).
//!
//! Written by hand: the `ply-rs-bw` crate keeps each point as a hash map of named properties,
//! which is far from the 50 ms a VGA frame may take. Our tests read the files with that crate.

use super::{ExportCloud, ExportFrame, Point, color};
use crate::fit::sphere::Sphere;
use crate::frame::FrameTime;
use glam::DVec3;

/// Bytes of one point.
const POINT: usize = 19;
/// Where the number of points stands is found by this mark; ten digits are enough for any frame.
const COUNT_DIGITS: usize = 10;

/// Replaces `file` by the frame's points: `float x y z`, `uchar red green blue`, `int sphere`
/// (−1 where no sphere explains the point). One pass over the pixels.
pub fn points(frame: &ExportFrame<'_>, file: &mut Vec<u8>) {
    file.clear();
    file.reserve(512 + frame.depth_m.len() * POINT);
    begin(file, frame.sequence, frame.time);
    write_points(frame.points(), file);
}

/// As [`points`], each pixel in the colour `colors` has for it (row-major, one per pixel).
pub fn painted_points(frame: &ExportFrame<'_>, colors: &[color::Rgb], file: &mut Vec<u8>) {
    file.clear();
    file.reserve(512 + frame.depth_m.len() * POINT);
    begin(file, frame.sequence, frame.time);
    file.extend_from_slice(b"comment colours of the colour camera, grey where it does not see\n");
    let measured = frame.depth_m.iter().zip(colors);
    let measured = measured.filter(|(z, _)| super::is_measured(**z));
    write_colored(frame.points().zip(measured.map(|(_, color)| *color)), file);
}

/// As [`points`], of a polar frame.
pub fn cloud_points(cloud: &ExportCloud<'_>, file: &mut Vec<u8>) {
    file.clear();
    file.reserve(512 + cloud.map.cells.len() * POINT);
    begin(file, cloud.sequence, cloud.time);
    write_points(cloud.points(), file);
}

fn write_points(points: impl Iterator<Item = Point>, file: &mut Vec<u8>) {
    write_colored(
        points.map(|point| (point, color::of_sphere(point.sphere))),
        file,
    );
}

fn write_colored(points: impl Iterator<Item = (Point, color::Rgb)>, file: &mut Vec<u8>) {
    file.extend_from_slice(b"element vertex ");
    let count_at = file.len();
    // filled in below; PLY numbers may have leading zeros
    file.extend_from_slice(&[b'0'; COUNT_DIGITS]);
    file.extend_from_slice(
        b"\nproperty float x\nproperty float y\nproperty float z\n\
          property uchar red\nproperty uchar green\nproperty uchar blue\n\
          property int sphere\nend_header\n",
    );
    let mut count = 0u64;
    for (point, rgb) in points {
        let mut record = [0; POINT];
        for (bytes, value) in record[..12]
            .chunks_exact_mut(4)
            .zip(point.position.to_array())
        {
            bytes.copy_from_slice(&value.to_le_bytes());
        }
        record[12..15].copy_from_slice(&rgb);
        record[15..].copy_from_slice(&point.sphere.map_or(-1, i32::from).to_le_bytes());
        file.extend_from_slice(&record);
        count += 1;
    }
    let digits = format!("{count:0width$}", width = COUNT_DIGITS);
    file[count_at..count_at + COUNT_DIGITS].copy_from_slice(digits.as_bytes());
}

/// Replaces `file` by the frame's spheres: centre `float x y z`, `float radius` (metres),
/// `uchar red green blue`, `int sphere`. A plane has a very large radius.
pub fn spheres(frame: &ExportFrame<'_>, file: &mut Vec<u8>) {
    file.clear();
    begin(file, frame.sequence, frame.time);
    let present = |(slot, sphere): (usize, &Option<Sphere>)| {
        let (center, radius) = (*sphere)?.center_radius();
        Some((u16::try_from(slot).ok()?, center, radius))
    };
    write_spheres(frame.spheres.iter().enumerate().filter_map(present), file);
}

/// As [`spheres`], of a polar frame.
pub fn cloud_spheres(cloud: &ExportCloud<'_>, file: &mut Vec<u8>) {
    file.clear();
    begin(file, cloud.sequence, cloud.time);
    write_spheres(cloud.spheres(), file);
}

fn write_spheres(spheres: impl Iterator<Item = (u16, DVec3, f64)> + Clone, file: &mut Vec<u8>) {
    let count = spheres.clone().count();
    let header = format!(
        "element vertex {count}\nproperty float x\nproperty float y\nproperty float z\n\
         property float radius\nproperty uchar red\nproperty uchar green\nproperty uchar blue\n\
         property int sphere\nend_header\n"
    );
    file.extend_from_slice(header.as_bytes());
    for (slot, center, radius) in spheres {
        for value in [center.x, center.y, center.z, radius] {
            file.extend_from_slice(&(value as f32).to_le_bytes());
        }
        file.extend_from_slice(&color::of_sphere(Some(slot)));
        file.extend_from_slice(&i32::from(slot).to_le_bytes());
    }
}

fn begin(file: &mut Vec<u8>, sequence: u64, time: FrameTime) {
    let text = format!(
        "ply\nformat binary_little_endian 1.0\n\
         comment metres, optical frame: x right, y down, z forward\n\
         comment frame {sequence} device_ns {} wall_ns {}\n",
        time.device_ns, time.wall_ns
    );
    file.extend_from_slice(text.as_bytes());
}
