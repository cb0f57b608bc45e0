//! RVL: run lengths and differences of depth integers in groups of three bits, fast and lossless.
//!
//! A. D. Wilson, "Fast Lossless Depth Image Compression", ISS 2017; laid out as ROS's
//! `compressedDepth rvl` has it. Runs of zeros and of non-zeros alternate; a non-zero integer is
//! the zigzag difference from the one before it. A number is a chain of nibbles, lowest three bits
//! first, bit 3 set where another follows. Eight nibbles are a 32-bit little-endian word, the first
//! one highest; the last word is filled with zeros.

/// Why bytes are no image.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum RvlError {
    /// The bytes end before the last pixel.
    #[error("the RVL data end at pixel {at} of {pixels}")]
    Cut {
        /// Pixels that were whole.
        at: usize,
        /// Pixels of the image.
        pixels: usize,
    },
    /// A run is longer than the image.
    #[error("an RVL run of {run} pixels at pixel {at} of {pixels}")]
    Run {
        /// Length of the run.
        run: u32,
        /// Where it begins.
        at: usize,
        /// Pixels of the image.
        pixels: usize,
    },
}

/// Nibbles on their way into words.
struct Writer<'a> {
    bytes: &'a mut Vec<u8>,
    /// Up to 16 nibbles, the newest lowest.
    word: u64,
    held: u32,
}

impl Writer<'_> {
    /// One number of at most 18 bits (six nibbles), or a run length of any size.
    #[inline]
    fn put(&mut self, mut value: u32) {
        loop {
            let nibble = u64::from(value & 7);
            value >>= 3;
            let more = u64::from(value != 0);
            self.word = self.word << 4 | more << 3 | nibble;
            self.held += 1;
            if self.held == 8 {
                self.bytes.extend((self.word as u32).to_le_bytes());
                self.held = 0;
            }
            if more == 0 {
                return;
            }
        }
    }

    fn finish(self) {
        if self.held > 0 {
            let word = (self.word as u32) << (4 * (8 - self.held));
            self.bytes.extend(word.to_le_bytes());
        }
    }
}

/// Appends `depth` to `bytes`. `O(pixels)`; at most 3 bytes a pixel and a word.
pub fn encode(depth: &[u16], bytes: &mut Vec<u8>) {
    bytes.reserve(depth.len() + 4);
    let mut out = Writer {
        bytes,
        word: 0,
        held: 0,
    };
    let (mut rest, mut last) = (depth, 0u16);
    while !rest.is_empty() {
        let holes = rest.iter().take_while(|d| **d == 0).count();
        rest = &rest[holes..];
        let run = rest.iter().take_while(|d| **d != 0).count();
        out.put(holes as u32);
        out.put(run as u32);
        for &raw in &rest[..run] {
            let difference = i32::from(raw) - i32::from(last);
            out.put((difference << 1 ^ difference >> 31) as u32);
            last = raw;
        }
        rest = &rest[run..];
    }
    out.finish();
}

/// Nibbles out of words.
struct Reader<'a> {
    bytes: &'a [u8],
    word: u32,
    held: u32,
}

impl Reader<'_> {
    #[inline]
    fn nibble(&mut self) -> Option<u32> {
        if self.held == 0 {
            let (word, rest) = self.bytes.split_first_chunk::<4>()?;
            self.word = u32::from_le_bytes(*word);
            self.bytes = rest;
            self.held = 8;
        }
        let nibble = self.word >> 28;
        self.word <<= 4;
        self.held -= 1;
        Some(nibble)
    }

    /// One number; bits above the 32nd are lost, as no writer makes them.
    #[inline]
    fn get(&mut self) -> Option<u32> {
        let (mut value, mut shift) = (0u32, 0u32);
        loop {
            let nibble = self.nibble()?;
            value |= (nibble & 7).checked_shl(shift).unwrap_or(0);
            shift += 3;
            if nibble & 8 == 0 {
                return Some(value);
            }
        }
    }
}

/// Replaces `depth` by the `pixels` integers that `bytes` hold. Bytes after them are ignored.
///
/// # Errors
/// [`RvlError`] where the bytes are no such image.
pub fn decode(bytes: &[u8], pixels: usize, depth: &mut Vec<u16>) -> Result<(), RvlError> {
    depth.clear();
    depth.reserve(pixels);
    let mut from = Reader {
        bytes,
        word: 0,
        held: 0,
    };
    let mut last = 0u16;
    while depth.len() < pixels {
        let at = depth.len();
        let cut = || RvlError::Cut { at, pixels };
        let holes = from.get().ok_or_else(cut)?;
        let run = from.get().ok_or_else(cut)?;
        let room = pixels - at;
        let both = u64::from(holes) + u64::from(run);
        if both > room as u64 || both == 0 {
            let run = holes.max(run);
            return Err(RvlError::Run { run, at, pixels });
        }
        depth.resize(at + holes as usize, 0);
        for _ in 0..run {
            let zigzag = from.get().ok_or(RvlError::Cut {
                at: depth.len(),
                pixels,
            })?;
            let difference = (zigzag >> 1) as i32 ^ -((zigzag & 1) as i32);
            last = last.wrapping_add(difference as u16);
            depth.push(last);
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn words_are_those_of_the_definition() {
        // 2 zeros, 3 non-zeros: 8, 7, 8 -> zigzag 16, 1, 2
        let mut bytes = Vec::new();
        encode(&[0, 0, 8, 7, 8], &mut bytes);
        // nibbles 2, 3, (8|0, 2), 1, 2, and two of filling
        assert_eq!(bytes, 0x2382_1200u32.to_le_bytes());
    }

    #[test]
    fn damaged_bytes_are_refused() {
        let mut out = Vec::new();
        assert_eq!(
            decode(&[], 3, &mut out),
            Err(RvlError::Cut { at: 0, pixels: 3 })
        );
        // empty runs for ever
        assert!(matches!(
            decode(&[0; 64], 3, &mut out),
            Err(RvlError::Run { .. })
        ));
        // a run of 4 in an image of 3
        let four = 0x0400_0000u32.to_le_bytes();
        let error = decode(&four, 3, &mut out).unwrap_err();
        assert!(matches!(error, RvlError::Run { run: 4, .. }), "{error}");
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(128))]

        #[test]
        fn every_image_comes_back(
            depth in proptest::collection::vec(prop_oneof![Just(0u16), any::<u16>(), 900u16..1100], 1..300),
        ) {
            let (mut bytes, mut back) = (Vec::new(), vec![9; 5]);
            encode(&depth, &mut bytes);
            prop_assert!(bytes.len() <= 3 * depth.len() + 8);
            decode(&bytes, depth.len(), &mut back).unwrap();
            prop_assert_eq!(&back, &depth);
            for cut in 0..bytes.len() {
                // a cut may only take the filling away
                if decode(&bytes[..cut], depth.len(), &mut back).is_ok() {
                    prop_assert_eq!(&back, &depth);
                }
            }
        }

        #[test]
        fn any_bytes_are_an_image_or_an_error(
            bytes in proptest::collection::vec(any::<u8>(), 0..200), pixels in 0usize..500,
        ) {
            let mut out = Vec::new();
            if decode(&bytes, pixels, &mut out).is_ok() {
                prop_assert_eq!(out.len(), pixels);
            }
        }
    }
}
