//! Points as PCD 0.7, binary, unorganised: `x y z` (F4), `rgb` (U4, 0x00RRGGBB as PCL packs it),
//! `sphere` (I4, −1 where no sphere explains the point).

use super::{ExportCloud, ExportFrame, Point, color};
use pcd_rs::{DataKind, PcdSerialize, Schema, ValueKind, WriterInit};
use std::io::{Cursor, Seek, Write};

/// One point as the file holds it.
struct Record {
    position: [f32; 3],
    rgb: u32,
    sphere: i32,
}

impl Record {
    fn of(point: &Point) -> Self {
        let [red, green, blue] = color::of_sphere(point.sphere);
        Self {
            position: point.position.to_array(),
            rgb: u32::from_be_bytes([0, red, green, blue]),
            sphere: point.sphere.map_or(-1, i32::from),
        }
    }
}

// By hand, not derived: the crate's dynamic records take five allocations a point, its derive
// macro a feature for these 20 bytes.
impl PcdSerialize for Record {
    fn is_dynamic() -> bool {
        false
    }

    fn write_spec() -> Schema {
        Schema::from_iter([
            ("x", ValueKind::F32, 1),
            ("y", ValueKind::F32, 1),
            ("z", ValueKind::F32, 1),
            ("rgb", ValueKind::U32, 1),
            ("sphere", ValueKind::I32, 1),
        ])
    }

    fn write_chunk<W: Write + Seek>(&self, writer: &mut W, _: &Schema) -> pcd_rs::Result<()> {
        let mut bytes = [0; 20];
        let [x, y, z] = self.position.map(f32::to_le_bytes);
        let fields = [x, y, z, self.rgb.to_le_bytes(), self.sphere.to_le_bytes()];
        for (place, field) in bytes.chunks_exact_mut(4).zip(fields) {
            place.copy_from_slice(&field);
        }
        writer.write_all(&bytes)?;
        Ok(())
    }

    fn write_line<W: Write + Seek>(&self, writer: &mut W, _: &Schema) -> pcd_rs::Result<()> {
        let [x, y, z] = self.position;
        writeln!(writer, "{x} {y} {z} {} {}", self.rgb, self.sphere)?;
        Ok(())
    }
}

/// Replaces `file` by the frame's points.
///
/// # Errors
/// What the encoder says.
pub fn points(frame: &ExportFrame<'_>, file: &mut Vec<u8>) -> Result<(), String> {
    write(frame.points(), file)
}

/// As [`points`], of a polar frame.
///
/// # Errors
/// What the encoder says.
pub fn cloud_points(cloud: &ExportCloud<'_>, file: &mut Vec<u8>) -> Result<(), String> {
    write(cloud.points(), file)
}

fn write(points: impl Iterator<Item = Point>, file: &mut Vec<u8>) -> Result<(), String> {
    file.clear();
    let records: Vec<_> = points.map(|point| Record::of(&point)).collect();
    let header = WriterInit {
        width: records.len() as u64,
        height: 1,
        viewpoint: pcd_rs::ViewPoint::default(),
        data_kind: DataKind::Binary,
        schema: None,
        version: None,
    };
    let mut writer = header
        .build_from_writer::<Record, _>(Cursor::new(file))
        .map_err(|e| e.to_string())?;
    for record in &records {
        writer.push(record).map_err(|e| e.to_string())?;
    }
    writer.finish().map_err(|e| e.to_string())
}
