//! Four-character codes: how V4L2 names pixel formats.

use serde::{Serialize, Serializer};
use std::fmt;

/// A V4L2 pixel format code. Shorter names are padded with spaces (`Z16` is `"Z16 "`).
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct FourCc(pub [u8; 4]);

impl FourCc {
    /// The code as the kernel passes it.
    #[must_use]
    pub fn from_kernel(code: u32) -> Self {
        Self(code.to_le_bytes())
    }

    /// The code as the kernel wants it.
    #[must_use]
    pub fn to_kernel(self) -> u32 {
        u32::from_le_bytes(self.0)
    }

    /// Reads a name of one to four printable characters, any case; `None` for anything else.
    #[must_use]
    pub fn parse(name: &str) -> Option<Self> {
        let name = name.trim().as_bytes();
        if name.is_empty() || name.len() > 4 || !name.iter().all(u8::is_ascii_graphic) {
            return None;
        }
        let mut code = [b' '; 4];
        for (to, from) in code.iter_mut().zip(name) {
            *to = from.to_ascii_uppercase();
        }
        Some(Self(code))
    }
}

impl fmt::Display for FourCc {
    /// The printable name without its padding; in hexadecimal when it has other bytes.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match std::str::from_utf8(&self.0) {
            Ok(name) if self.0.iter().all(|b| (0x20..0x7f).contains(b)) => {
                f.write_str(name.trim_end())
            }
            _ => write!(f, "0x{:08x}", self.to_kernel()),
        }
    }
}

impl Serialize for FourCc {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_padded_and_read_back() {
        let z16 = FourCc::parse("z16").unwrap();
        assert_eq!(z16.0, *b"Z16 ");
        assert_eq!(z16.to_string(), "Z16");
        assert_eq!(FourCc::from_kernel(z16.to_kernel()), z16);
        assert_eq!(FourCc::from_kernel(0x5634_3231).to_string(), "124V");
    }

    #[test]
    fn what_is_no_name_is_refused_or_shown_in_hexadecimal() {
        for bad in ["", "   ", "TOOLONG", "Z\u{7f}6", "é"] {
            assert_eq!(FourCc::parse(bad), None, "{bad:?}");
        }
        assert_eq!(FourCc([0x50, 0, 0, 0]).to_string(), "0x00000050");
    }
}
