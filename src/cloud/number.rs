//! Numbers of any machine type at fixed places of fixed records: what PLY, PCD and NPY share.

use glam::DVec3;

/// Machine type of one number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Number {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    I64,
    U64,
    F32,
    F64,
}

impl Number {
    /// Its bytes.
    pub fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::I64 | Self::U64 | Self::F64 => 8,
        }
    }

    /// Its value at the beginning of `bytes`; `None` where they are too few.
    #[inline]
    pub fn value(self, bytes: &[u8], big_endian: bool) -> Option<f64> {
        macro_rules! read {
            ($type:ty) => {{
                let raw = *bytes.first_chunk()?;
                if big_endian {
                    <$type>::from_be_bytes(raw) as f64
                } else {
                    <$type>::from_le_bytes(raw) as f64
                }
            }};
        }
        Some(match self {
            Self::I8 => read!(i8),
            Self::U8 => read!(u8),
            Self::I16 => read!(i16),
            Self::U16 => read!(u16),
            Self::I32 => read!(i32),
            Self::U32 => read!(u32),
            Self::I64 => read!(i64),
            Self::U64 => read!(u64),
            Self::F32 => read!(f32),
            Self::F64 => read!(f64),
        })
    }
}

/// Where x, y and z stand in records of one size.
#[derive(Clone, Copy, Debug)]
pub struct Layout {
    /// Bytes of a record, above 0.
    pub record: usize,
    /// Type and byte offset of x, y and z.
    pub axes: [(Number, usize); 3],
    /// True where the highest byte stands first.
    pub big_endian: bool,
}

impl Layout {
    /// Reads `count` records from the beginning of `bytes`.
    ///
    /// # Errors
    /// Fewer bytes than the records take; said before memory is taken.
    pub fn read(&self, bytes: &[u8], count: u64) -> Result<Vec<DVec3>, String> {
        let held = bytes.len() / self.record.max(1);
        let count = usize::try_from(count).unwrap_or(usize::MAX);
        if held < count {
            return Err(format!(
                "{count} points of {} bytes are announced and {} bytes follow, enough for {held}",
                self.record,
                bytes.len()
            ));
        }
        let axis = |record: &[u8], (number, at): (Number, usize)| {
            let value = record
                .get(at..)
                .and_then(|b| number.value(b, self.big_endian));
            value.unwrap_or(f64::NAN)
        };
        let records = bytes.chunks_exact(self.record.max(1)).take(count);
        let [x, y, z] = self.axes;
        if self.axes.iter().all(|a| a.0 == Number::F32) && !self.big_endian {
            // most files: without a choice per number
            let single = |record: &[u8], at: usize| {
                let raw = record.get(at..).and_then(|b| b.first_chunk());
                raw.map_or(f64::NAN, |raw| f64::from(f32::from_le_bytes(*raw)))
            };
            let point = |r: &[u8]| DVec3::new(single(r, x.1), single(r, y.1), single(r, z.1));
            return Ok(records.map(point).collect());
        }
        let point = |r: &[u8]| DVec3::new(axis(r, x), axis(r, y), axis(r, z));
        Ok(records.map(point).collect())
    }
}
