//! The fields of a ROS message, one after another, as ROS 1 and as CDR lay them out.
//!
//! ROS 1: little endian, packed; a string is a u32 length and its bytes. CDR (OMG DDS-RTPS 2.3,
//! §10): 4 bytes that name the byte order and the version, then each field aligned to its own size
//! counted from there (8-byte fields to 4 in version 2); a string's length counts a closing zero.

/// How messages of a channel are laid out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::capture::containers) enum Layout {
    Ros1,
    Cdr,
}

/// Reads field after field; `None` once the bytes are over or are no such field.
#[derive(Clone, Debug)]
pub(in crate::capture::containers) struct Fields<'a> {
    bytes: &'a [u8],
    at: usize,
    layout: Layout,
    big_endian: bool,
    /// Largest alignment.
    align: usize,
}

impl<'a> Fields<'a> {
    pub(in crate::capture::containers) fn new(bytes: &'a [u8], layout: Layout) -> Option<Self> {
        let (bytes, big_endian, align) = match layout {
            Layout::Ros1 => (bytes, false, 1),
            Layout::Cdr => {
                let (head, body) = bytes.split_first_chunk::<4>()?;
                match head {
                    [0, 0, ..] => (body, true, 8),
                    [0, 1, ..] => (body, false, 8),
                    [0, 6, ..] => (body, true, 4),
                    [0, 7, ..] => (body, false, 4),
                    _ => return None,
                }
            }
        };
        Some(Self {
            bytes,
            at: 0,
            layout,
            big_endian,
            align,
        })
    }

    pub(in crate::capture::containers) fn layout(&self) -> Layout {
        self.layout
    }

    /// `N` bytes aligned to their number, in little-endian order.
    fn number<const N: usize>(&mut self) -> Option<[u8; N]> {
        let start = self.at.next_multiple_of(N.min(self.align));
        let mut bytes: [u8; N] = self
            .bytes
            .get(start..start.checked_add(N)?)?
            .try_into()
            .ok()?;
        self.at = start + N;
        if self.big_endian {
            bytes.reverse();
        }
        Some(bytes)
    }

    pub(in crate::capture::containers) fn u8(&mut self) -> Option<u8> {
        self.number::<1>().map(|[byte]| byte)
    }

    pub(in crate::capture::containers) fn u32(&mut self) -> Option<u32> {
        self.number().map(u32::from_le_bytes)
    }

    pub(in crate::capture::containers) fn u16(&mut self) -> Option<u16> {
        self.number().map(u16::from_le_bytes)
    }

    pub(in crate::capture::containers) fn u64(&mut self) -> Option<u64> {
        self.number().map(u64::from_le_bytes)
    }

    /// What is left.
    pub(in crate::capture::containers) fn rest(&self) -> &'a [u8] {
        self.bytes.get(self.at..).unwrap_or_default()
    }

    pub(in crate::capture::containers) fn f32(&mut self) -> Option<f32> {
        self.number().map(f32::from_le_bytes)
    }

    pub(in crate::capture::containers) fn f64(&mut self) -> Option<f64> {
        self.number().map(f64::from_le_bytes)
    }

    pub(in crate::capture::containers) fn f64s<const N: usize>(&mut self) -> Option<[f64; N]> {
        let mut values = [0.0; N];
        for value in &mut values {
            *value = self.f64()?;
        }
        Some(values)
    }

    /// A sequence of bytes.
    pub(in crate::capture::containers) fn bytes(&mut self) -> Option<&'a [u8]> {
        let length = self.u32()? as usize;
        let bytes = self.bytes.get(self.at..self.at.checked_add(length)?)?;
        self.at += length;
        Some(bytes)
    }

    pub(in crate::capture::containers) fn text(&mut self) -> Option<&'a str> {
        let bytes = self.bytes()?;
        let bytes = match self.layout {
            Layout::Ros1 => bytes,
            // some writers leave the closing zero of an empty string out
            Layout::Cdr => bytes.strip_suffix(&[0]).unwrap_or(bytes),
        };
        std::str::from_utf8(bytes).ok()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cdr_is_aligned_and_ros1_is_packed() {
        // u8, u32, text "ab", f64
        let cdr: Vec<u8> = [
            &[0, 1, 0, 0, 7, 0, 0, 0][..],
            &5u32.to_le_bytes(),
            &3u32.to_le_bytes(),
            b"ab\0",
            &[0; 5 - 4], // 15 bytes so far: align to 16
            &1.5f64.to_le_bytes(),
        ]
        .concat();
        let ros: Vec<u8> = [
            &[7][..],
            &5u32.to_le_bytes(),
            &2u32.to_le_bytes(),
            b"ab",
            &1.5f64.to_le_bytes(),
        ]
        .concat();
        for (bytes, layout) in [(cdr, Layout::Cdr), (ros, Layout::Ros1)] {
            let read = |bytes: &[u8]| {
                let mut fields = Fields::new(bytes, layout)?;
                let whole = (fields.u8()?, fields.u32()?, fields.text()?.to_owned());
                Some((whole, fields.f64()?))
            };
            assert_eq!(read(&bytes), Some(((7, 5, "ab".to_owned()), 1.5)));
            for cut in 0..bytes.len() {
                assert_eq!(read(&bytes[..cut]), None, "{layout:?} cut at {cut}");
            }
        }
        assert!(Fields::new(&[9, 9, 0, 0, 1], Layout::Cdr).is_none());
        let mut big = Fields::new(&[0, 0, 0, 0, 0, 0, 1, 2], Layout::Cdr).unwrap();
        assert_eq!(big.u32(), Some(258));
    }
}
