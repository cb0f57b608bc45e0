//! PCD: header and compression by the `pcd-rs` crate, plain records straight from the bytes.

use super::number::{Layout, Number};
use super::text;
use glam::DVec3;
use pcd_rs::{DataKind, PcdDeserialize, PcdMeta, Schema, ValueKind};
use std::io::{BufRead, Cursor};

/// Most bytes one byte of LZF can stand for: a match of 264 bytes takes three.
const LZF_LIMIT: u64 = 88;

/// Reads the points.
pub fn read(bytes: &[u8]) -> Result<Vec<DVec3>, String> {
    let mut rest = bytes;
    let meta = PcdMeta::from_reader(&mut rest).map_err(|e| e.to_string())?;
    let (layout, columns) = layout(&meta.field_defs)?;
    match meta.data {
        DataKind::Ascii => text::columns(rest, columns, meta.num_points),
        DataKind::Binary => layout.read(rest, meta.num_points),
        DataKind::BinaryCompressed => read_compressed(bytes, rest, &layout, meta.num_points),
    }
}

/// Byte layout of a record, and the columns of x, y and z in a line of text.
fn layout(fields: &Schema) -> Result<(Layout, [usize; 3]), String> {
    let mut axes = [None; 3];
    let mut columns = [0; 3];
    let (mut record, mut column) = (0usize, 0usize);
    for field in fields {
        let number = number(field.kind);
        let count = usize::try_from(field.count).unwrap_or(usize::MAX);
        if let Some(axis) = ["x", "y", "z"].iter().position(|a| *a == field.name) {
            axes[axis] = Some((number, record));
            columns[axis] = column;
        }
        let grown = count
            .checked_mul(number.size())
            .and_then(|bytes| record.checked_add(bytes))
            .filter(|bytes| *bytes < 1 << 20);
        record = grown.ok_or_else(|| format!("its field `{}` has {count} values", field.name))?;
        column += count;
    }
    let [Some(x), Some(y), Some(z)] = axes else {
        return Err("it has no fields x, y and z".to_owned());
    };
    let layout = Layout {
        record,
        axes: [x, y, z],
        big_endian: false,
    };
    Ok((layout, columns))
}

fn number(kind: ValueKind) -> Number {
    match kind {
        ValueKind::U8 => Number::U8,
        ValueKind::U16 => Number::U16,
        ValueKind::U32 => Number::U32,
        ValueKind::U64 => Number::U64,
        ValueKind::I8 => Number::I8,
        ValueKind::I16 => Number::I16,
        ValueKind::I32 => Number::I32,
        ValueKind::I64 => Number::I64,
        ValueKind::F32 => Number::F32,
        ValueKind::F64 => Number::F64,
    }
}

fn read_compressed(
    bytes: &[u8],
    rest: &[u8],
    layout: &Layout,
    points: u64,
) -> Result<Vec<DVec3>, String> {
    // the crate trusts these three; they must agree first
    let word = |at: usize| {
        let four = rest.get(at..).and_then(|b| b.first_chunk());
        four.map_or(0, |b| u64::from(u32::from_le_bytes(*b)))
    };
    let (packed, plain) = (word(0), word(4));
    let wanted = points.checked_mul(layout.record as u64);
    if packed > rest.len().saturating_sub(8) as u64 {
        return Err(format!(
            "{packed} compressed bytes are announced and {} follow",
            rest.len().saturating_sub(8)
        ));
    }
    if wanted != Some(plain) || plain > packed.saturating_mul(LZF_LIMIT) {
        return Err(format!(
            "{points} points of {} bytes cannot be the {plain} bytes it announces, packed into {packed}",
            layout.record
        ));
    }
    let reader = pcd_rs::Reader::<Position, _>::from_reader(Cursor::new(bytes));
    let positions = reader.map_err(|e| e.to_string())?;
    let positions: Result<Vec<_>, _> = positions.map(|p| p.map(|p| p.0)).collect();
    positions.map_err(|e| e.to_string())
}

/// The position of a record, whatever else it holds.
struct Position(DVec3);

impl PcdDeserialize for Position {
    fn is_dynamic() -> bool {
        true
    }

    fn read_spec() -> Vec<(Option<String>, ValueKind, Option<usize>)> {
        Vec::new()
    }

    fn read_chunk<R: BufRead>(reader: &mut R, fields: &Schema) -> pcd_rs::Result<Self> {
        let refused = |what: &str| pcd_rs::Error::new_parse_error(0, what);
        let (layout, _) = layout(fields).map_err(|what| refused(&what))?;
        let mut record = vec![0; layout.record];
        reader.read_exact(&mut record)?;
        let position = layout.read(&record, 1).map_err(|what| refused(&what))?;
        let position = position.first().copied();
        position
            .map(Position)
            .ok_or_else(|| refused("a record is empty"))
    }

    fn read_line<R: BufRead>(_: &mut R, _: &Schema) -> pcd_rs::Result<Self> {
        Err(pcd_rs::Error::new_parse_error(
            0,
            "lines are read elsewhere",
        ))
    }
}
