//! NumPy arrays, versions 1 to 3 of the format (numpy/lib/format.py describes it).

use super::number::{Layout, Number};
use glam::DVec3;

/// First six bytes.
pub const MAGIC: &[u8] = b"\x93NUMPY";
/// Longest header that is read, bytes; NumPy itself writes some 80.
const HEADER_LIMIT: usize = 1 << 16;

/// Reads the array's rows as points: the last axis holds x, y, z and what else there is.
pub fn read(bytes: &[u8]) -> Result<Vec<DVec3>, String> {
    let cut = || "it ends within its header".to_owned();
    let rest = bytes.strip_prefix(MAGIC).ok_or("it is no NumPy array")?;
    let ([major, _], rest) = rest.split_first_chunk::<2>().ok_or_else(cut)?;
    let (length, rest) = match major {
        1 => {
            let (length, rest) = rest.split_first_chunk().ok_or_else(cut)?;
            (usize::from(u16::from_le_bytes(*length)), rest)
        }
        2 | 3 => {
            let (length, rest) = rest.split_first_chunk().ok_or_else(cut)?;
            (u32::from_le_bytes(*length) as usize, rest)
        }
        other => {
            return Err(format!(
                "its format version {other} is unknown (1 to 3 are)"
            ));
        }
    };
    if length > HEADER_LIMIT {
        return Err(format!("its header of {length} bytes is beyond the limit"));
    }
    let (header, data) = rest.split_at_checked(length).ok_or_else(cut)?;
    let header = Header::read(std::str::from_utf8(header).map_err(|e| e.to_string())?)?;
    header.points(data)
}

/// The dictionary in front of the data.
#[derive(Debug, PartialEq)]
struct Header {
    number: Number,
    big_endian: bool,
    /// Columns first.
    fortran: bool,
    shape: Vec<u64>,
}

impl Header {
    /// Reads a Python literal such as `{'descr': '<f4', 'fortran_order': False, 'shape': (9, 3), }`.
    fn read(text: &str) -> Result<Self, String> {
        let after = |key: &str| {
            let at = text.find(&format!("'{key}'")).map(|at| at + key.len() + 2);
            let value = at.and_then(|at| text[at..].trim_start().strip_prefix(':'));
            value
                .map(str::trim_start)
                .ok_or_else(|| format!("its header has no `{key}`"))
        };
        let descr = after("descr")?
            .strip_prefix('\'')
            .and_then(|rest| rest.split('\'').next())
            .ok_or("its entries are not plain numbers")?;
        let (number, big_endian) = number(descr).ok_or_else(|| {
            format!("its entries are `{descr}`; save it with astype('float32') or 'float64'")
        })?;
        let fortran = after("fortran_order")?.starts_with("True");
        let shape = after("shape")?
            .strip_prefix('(')
            .and_then(|rest| rest.split(')').next())
            .ok_or("its header has no shape")?;
        let shape: Result<Vec<u64>, _> = shape
            .split(',')
            .map(str::trim)
            .filter(|part| !part.is_empty())
            .map(str::parse)
            .collect();
        Ok(Self {
            number,
            big_endian,
            fortran,
            shape: shape.map_err(|_| "its shape is no list of counts")?,
        })
    }

    fn points(&self, data: &[u8]) -> Result<Vec<DVec3>, String> {
        let wrong = || {
            format!(
                "its shape is {:?}; a cloud is (points, 3 or more), or an image of such",
                self.shape
            )
        };
        let (&columns, outer) = self.shape.split_last().ok_or_else(wrong)?;
        if outer.is_empty() || columns < 3 || (self.fortran && outer.len() > 1) {
            return Err(wrong());
        }
        let count = outer.iter().try_fold(1u64, |n, axis| n.checked_mul(*axis));
        let count = count.ok_or_else(wrong)?;
        let size = self.number.size();
        let columns = usize::try_from(columns).map_err(|_| wrong())?;
        if !self.fortran {
            let layout = Layout {
                record: columns.checked_mul(size).ok_or_else(wrong)?,
                axes: [0, 1, 2].map(|axis| (self.number, axis * size)),
                big_endian: self.big_endian,
            };
            return layout.read(data, count);
        }
        // column after column
        let rows = usize::try_from(count).unwrap_or(usize::MAX);
        let bytes = rows.checked_mul(size).and_then(|b| b.checked_mul(columns));
        if bytes.is_none_or(|bytes| bytes > data.len()) {
            return Err(format!(
                "{rows} points are announced and {} bytes follow",
                data.len()
            ));
        }
        let value = |axis: usize, row: usize| {
            let at = (axis * rows + row) * size;
            let value = self.number.value(&data[at..], self.big_endian);
            value.unwrap_or(f64::NAN)
        };
        let point = |row| DVec3::new(value(0, row), value(1, row), value(2, row));
        Ok((0..rows).map(point).collect())
    }
}

/// Machine type and byte order of a NumPy type string.
fn number(descr: &str) -> Option<(Number, bool)> {
    let (order, name) = descr.split_at_checked(1)?;
    let number = match name {
        "f4" => Number::F32,
        "f8" => Number::F64,
        "i1" => Number::I8,
        "u1" => Number::U8,
        "i2" => Number::I16,
        "u2" => Number::U16,
        "i4" => Number::I32,
        "u4" => Number::U32,
        "i8" => Number::I64,
        "u8" => Number::U64,
        _ => return None,
    };
    match order {
        "<" | "=" => Some((number, false)),
        "|" if number.size() == 1 => Some((number, false)),
        ">" => Some((number, true)),
        _ => None,
    }
}
