//! Pixel formats that can carry depth, and how each becomes a row of integers.

use super::fourcc::FourCc;

/// A pixel format with one integer per pixel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DepthFormat {
    /// `Z16 `: 16-bit little-endian depth. The only one that says it is depth.
    Z16,
    /// `Y16 `: 16-bit little-endian grey, used for depth by some cameras.
    Y16,
    /// `Y14 `: 14 bits in a 16-bit little-endian word.
    Y14,
    /// `Y12 `: 12 bits in a 16-bit little-endian word.
    Y12,
    /// `Y10 `: 10 bits in a 16-bit little-endian word.
    Y10,
    /// `Y10B`: 10 bits, packed as a bit stream, most significant bit first.
    Y10Packed,
}

/// A frame with fewer bytes than its rows need.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the frame has {got} bytes and needs {need}")]
pub struct ShortFrame {
    /// Bytes the rows need.
    pub need: usize,
    /// Bytes there are.
    pub got: usize,
}

/// Rows of one image in a driver's buffer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Rows {
    /// Pixels per row.
    pub width: usize,
    /// Number of rows.
    pub height: usize,
    /// Bytes from one row's start to the next one's.
    pub stride: usize,
}

impl DepthFormat {
    /// All of them, the most explicit first.
    pub const ALL: [Self; 6] = [
        Self::Z16,
        Self::Y16,
        Self::Y14,
        Self::Y12,
        Self::Y10,
        Self::Y10Packed,
    ];

    /// Its V4L2 code.
    #[must_use]
    pub fn fourcc(self) -> FourCc {
        FourCc(match self {
            Self::Z16 => *b"Z16 ",
            Self::Y16 => *b"Y16 ",
            Self::Y14 => *b"Y14 ",
            Self::Y12 => *b"Y12 ",
            Self::Y10 => *b"Y10 ",
            Self::Y10Packed => *b"Y10B",
        })
    }

    /// The format of a V4L2 code, `None` for one that cannot carry depth.
    #[must_use]
    pub fn from_fourcc(code: FourCc) -> Option<Self> {
        Self::ALL.into_iter().find(|f| f.fourcc() == code)
    }

    /// Bytes one row of pixels takes without padding.
    #[must_use]
    pub fn row_bytes(self, width: usize) -> usize {
        match self {
            Self::Y10Packed => (width * 10).div_ceil(8),
            _ => width * 2,
        }
    }

    /// Bytes a frame must have: whole rows, the last without its padding.
    #[must_use]
    pub fn frame_bytes(self, rows: Rows) -> usize {
        match rows.height {
            0 => 0,
            h => rows.stride * (h - 1) + self.row_bytes(rows.width),
        }
    }

    /// Fills `depth` with the frame's integers, row-major, `width * height` of them.
    ///
    /// Bits above the format's depth are cleared: V4L2 says they are zero, not every camera does.
    ///
    /// # Errors
    /// [`ShortFrame`] when `bytes` does not hold all rows; `depth` is untouched then.
    pub fn unpack(self, bytes: &[u8], rows: Rows, depth: &mut Vec<u16>) -> Result<(), ShortFrame> {
        let need = self.frame_bytes(rows);
        if bytes.len() < need {
            return Err(ShortFrame {
                need,
                got: bytes.len(),
            });
        }
        depth.resize(rows.width * rows.height, 0);
        if rows.width == 0 || rows.stride == 0 {
            return Ok(());
        }
        let row_bytes = self.row_bytes(rows.width);
        let sources = bytes.chunks(rows.stride).map(|row| &row[..row_bytes]);
        for (row, source) in depth.chunks_exact_mut(rows.width).zip(sources) {
            match self {
                Self::Z16 | Self::Y16 => words(source, 0xffff, row),
                Self::Y14 => words(source, 0x3fff, row),
                Self::Y12 => words(source, 0x0fff, row),
                Self::Y10 => words(source, 0x03ff, row),
                Self::Y10Packed => packed_10_bit(source, row),
            }
        }
        Ok(())
    }
}

fn words(source: &[u8], mask: u16, row: &mut [u16]) {
    for (to, from) in row.iter_mut().zip(source.chunks_exact(2)) {
        *to = u16::from_le_bytes([from[0], from[1]]) & mask;
    }
}

fn packed_10_bit(source: &[u8], row: &mut [u16]) {
    for (i, to) in row.iter_mut().enumerate() {
        let bit = i * 10;
        // 10 bits starting at any even bit offset never leave two bytes.
        let first = u16::from(source[bit / 8]);
        let second = u16::from(source[bit / 8 + 1]);
        *to = (((first << 8) | second) >> (6 - bit % 8)) & 0x03ff;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn rows(width: usize, height: usize, stride: usize) -> Rows {
        Rows {
            width,
            height,
            stride,
        }
    }

    /// Writes pixels bit by bit, most significant first: slow and obvious.
    fn pack_bits(pixels: &[u16], bits: usize) -> Vec<u8> {
        let mut bytes = vec![0u8; (pixels.len() * bits).div_ceil(8)];
        for (i, pixel) in pixels.iter().enumerate() {
            for b in 0..bits {
                let at = i * bits + b;
                let bit = (pixel >> (bits - 1 - b)) & 1;
                bytes[at / 8] |= (bit as u8) << (7 - at % 8);
            }
        }
        bytes
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]
        #[test]
        fn packed_rows_read_back(
            width in 1usize..40, height in 1usize..5, padding in 0usize..7, seed in any::<u16>(),
        ) {
            let value = |i: usize| (i as u16).wrapping_mul(977).wrapping_add(seed) & 0x3ff;
            let pixels: Vec<u16> = (0..width * height).map(value).collect();
            let mut bytes = Vec::new();
            for row in pixels.chunks(width) {
                bytes.extend(pack_bits(row, 10));
                bytes.extend(vec![0xee; padding]);
            }
            let stride = DepthFormat::Y10Packed.row_bytes(width) + padding;
            let mut got = Vec::new();
            DepthFormat::Y10Packed.unpack(&bytes, rows(width, height, stride), &mut got).unwrap();
            prop_assert_eq!(got, pixels);
        }

        #[test]
        fn words_honour_stride_and_depth_of_bits(
            width in 1usize..30, height in 1usize..5, padding in 0usize..5, seed in any::<u16>(),
        ) {
            for (format, bits) in [
                (DepthFormat::Z16, 16), (DepthFormat::Y16, 16), (DepthFormat::Y14, 14),
                (DepthFormat::Y12, 12), (DepthFormat::Y10, 10),
            ] {
                let value = |i: usize| (i as u16).wrapping_mul(40503).wrapping_add(seed);
                let mut bytes = Vec::new();
                for i in 0..width * height {
                    bytes.extend(value(i).to_le_bytes());
                    if (i + 1) % width == 0 {
                        bytes.extend(vec![0xee; padding]);
                    }
                }
                let mut got = Vec::new();
                format.unpack(&bytes, rows(width, height, width * 2 + padding), &mut got).unwrap();
                let want: Vec<u16> =
                    (0..width * height).map(|i| (u32::from(value(i)) % (1 << bits)) as u16).collect();
                prop_assert_eq!(got, want);
            }
        }
    }

    #[test]
    fn a_frame_one_byte_short_is_refused_and_the_last_rows_padding_is_not_needed() {
        let shape = rows(4, 3, 16);
        let need = 16 * 2 + 8;
        let mut depth = vec![7; 5];
        let error = DepthFormat::Z16.unpack(&vec![1; need - 1], shape, &mut depth);
        assert_eq!(
            error,
            Err(ShortFrame {
                need,
                got: need - 1
            })
        );
        assert_eq!(depth, vec![7; 5], "a refused frame leaves the buffer alone");
        DepthFormat::Z16
            .unpack(&vec![1; need], shape, &mut depth)
            .unwrap();
        assert_eq!(depth, vec![0x0101; 12]);
    }

    #[test]
    fn an_empty_image_has_no_pixels() {
        for shape in [rows(0, 3, 0), rows(3, 0, 6), rows(0, 0, 0)] {
            let mut depth = vec![1];
            DepthFormat::Z16.unpack(&[], shape, &mut depth).unwrap();
            assert!(depth.is_empty());
        }
    }

    #[test]
    fn codes_map_both_ways() {
        for format in DepthFormat::ALL {
            assert_eq!(DepthFormat::from_fourcc(format.fourcc()), Some(format));
        }
        assert_eq!(DepthFormat::from_fourcc(FourCc(*b"YUYV")), None);
    }
}
