//! EBML elements (RFC 8794): a number, a length, a body, with every length checked.

use crate::capture::CaptureError;
use crate::capture::containers::damaged;
use crate::capture::sequences::input;
use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

/// Length of an element's body.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Body {
    Known(u64),
    /// To the next element of its own or a higher level.
    Unknown,
}

impl Body {
    /// The length, where there must be one.
    pub(super) fn known(self) -> Result<u64, CaptureError> {
        match self {
            Self::Known(length) => Ok(length),
            Self::Unknown => Err(damaged(Path::new("matroska"), "a block without a length")),
        }
    }
}

/// The elements of a file, one after another.
pub(super) struct Elements {
    path: PathBuf,
    file: BufReader<File>,
    at: u64,
    length: u64,
}

impl Elements {
    pub(super) fn open(path: &Path) -> Result<Self, CaptureError> {
        let unreadable = |error: std::io::Error| input(path, error.to_string(), "check the file");
        let file = BufReader::new(File::open(path).map_err(unreadable)?);
        Ok(Self {
            path: path.to_owned(),
            length: file.get_ref().metadata().map_err(unreadable)?.len(),
            file,
            at: 0,
        })
    }

    /// Begins again behind the file's own header.
    pub(super) fn rewind(&mut self) -> Result<(), CaptureError> {
        let moved = self.file.seek(SeekFrom::Start(0));
        moved.map_err(|error| self.damaged(format!("seeking failed: {error}")))?;
        self.at = 0;
        if let Some((_, header)) = self.next()? {
            self.skip(header)?;
        }
        Ok(())
    }

    fn damaged(&self, what: String) -> CaptureError {
        damaged(&self.path, format!("{what}, at byte {}", self.at))
    }

    fn cut(&mut self) -> CaptureError {
        let error = self.damaged("the file is cut or damaged".to_owned());
        self.at = self.length;
        error
    }

    /// The next element; its body is read or skipped next, or entered. `None` at the end.
    pub(super) fn next(&mut self) -> Result<Option<(u32, Body)>, CaptureError> {
        if self.at >= self.length {
            return Ok(None);
        }
        let number = self.number(4, true)?.0 as u32;
        let (length, unknown) = self.number(8, false)?;
        if unknown {
            return Ok(Some((number, Body::Unknown)));
        }
        Ok(Some((number, Body::Known(length))))
    }

    /// A number whose first byte says how long it is; true where all its bits are set.
    fn number(&mut self, most: usize, with_marker: bool) -> Result<(u64, bool), CaptureError> {
        let mut bytes = [0; 8];
        if self.at >= self.length || self.file.read_exact(&mut bytes[..1]).is_err() {
            return Err(self.cut());
        }
        let size = bytes[0].leading_zeros() as usize + 1;
        let room = self.length - self.at >= size as u64;
        if size > most || !room || self.file.read_exact(&mut bytes[1..size]).is_err() {
            return Err(self.cut());
        }
        self.at += size as u64;
        Ok(value(&bytes[..size], with_marker))
    }

    /// Replaces `bytes` by the body.
    pub(super) fn read(
        &mut self,
        body: Body,
        most: u64,
        bytes: &mut Vec<u8>,
    ) -> Result<(), CaptureError> {
        let (length, left) = (body.known()?, self.length - self.at);
        if length > left || length > most {
            let what =
                format!("an element of {length} bytes, {left} are left, the limit is {most}");
            let error = self.damaged(what);
            self.at = self.length;
            return Err(error);
        }
        bytes.clear();
        bytes.resize(length as usize, 0);
        if self.file.read_exact(bytes).is_err() {
            return Err(self.cut());
        }
        self.at += length;
        Ok(())
    }

    /// Passes over a body.
    pub(super) fn skip(&mut self, body: Body) -> Result<(), CaptureError> {
        let length = body.known()?;
        let step = i64::try_from(length).ok();
        let step = step.filter(|_| length <= self.length - self.at);
        if step.is_none_or(|step| self.file.seek_relative(step).is_err()) {
            return Err(self.cut());
        }
        self.at += length;
        Ok(())
    }
}

/// The value of a number's bytes, with or without the bit that ends its leading zeros; true where
/// all other bits are set.
fn value(bytes: &[u8], with_marker: bool) -> (u64, bool) {
    let whole = bytes
        .iter()
        .fold(0, |value, byte| value << 8 | u64::from(*byte));
    let marker = 1u64 << (7 * bytes.len());
    let value = whole & (marker - 1);
    let unknown = value == marker - 1;
    (if with_marker { whole } else { value }, unknown)
}

/// A number at the beginning of `bytes`, without its marker, and what follows it.
pub(super) fn vint(bytes: &[u8]) -> Option<(u64, &[u8])> {
    let size = bytes.first()?.leading_zeros() as usize + 1;
    let (number, rest) = bytes.split_at_checked(size).filter(|_| size <= 8)?;
    Some((value(number, false).0, rest))
}

/// The elements inside `bytes`; `None` once, at the end, where they do not fill it.
pub(super) fn children(mut bytes: &[u8]) -> impl Iterator<Item = Option<(u32, &[u8])>> {
    std::iter::from_fn(move || {
        if bytes.is_empty() {
            return None;
        }
        let step = || {
            let size = bytes.first()?.leading_zeros() as usize + 1;
            let (number, rest) = bytes.split_at_checked(size).filter(|_| size <= 4)?;
            let (length, rest) = vint(rest)?;
            let (body, rest) = rest.split_at_checked(usize::try_from(length).ok()?)?;
            Some((value(number, true).0 as u32, body, rest))
        };
        let found = step();
        bytes = found.map_or(&[], |(_, _, rest)| rest);
        Some(found.map(|(number, body, _)| (number, body)))
    })
}

/// A big-endian integer of up to 8 bytes.
pub(super) fn unsigned(bytes: &[u8]) -> u64 {
    let bytes = &bytes[..bytes.len().min(8)];
    bytes
        .iter()
        .fold(0, |value, byte| value << 8 | u64::from(*byte))
}

pub(super) fn signed16(bytes: [u8; 2]) -> i64 {
    i64::from(i16::from_be_bytes(bytes))
}

/// Text, which may end in zeros.
pub(super) fn text(bytes: &[u8]) -> String {
    let text = String::from_utf8_lossy(bytes);
    text.trim_end_matches('\0').to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_those_of_the_rfc() {
        assert_eq!(vint(&[0x82, 9]), Some((2, &[9][..])));
        assert_eq!(vint(&[0x40, 0x02]), Some((2, &[][..])));
        assert_eq!(vint(&[0x10, 0, 0, 2]), Some((2, &[][..])));
        assert_eq!(vint(&[0, 1, 2]), None);
        assert_eq!(vint(&[0x40]), None);
        assert_eq!(value(&[0xff], false), (127, true));
        assert_eq!(value(&[0x1a, 0x45, 0xdf, 0xa3], true), (0x1a45_dfa3, false));
        assert_eq!(unsigned(&[1, 0]), 256);
        assert_eq!(signed16([0xff, 0xfe]), -2);
    }

    #[test]
    fn children_end_at_damage() {
        let whole = [0xae, 0x81, 7, 0x42, 0x86, 0x80];
        let found: Vec<_> = children(&whole).collect();
        assert_eq!(found, [Some((0xae, &[7][..])), Some((0x4286, &[][..]))]);
        let found: Vec<_> = children(&whole[..5]).collect();
        assert_eq!(found, [Some((0xae, &[7][..])), None]);
    }
}
