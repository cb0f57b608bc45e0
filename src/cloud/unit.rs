//! The unit of a file's coordinates.

use std::fmt;
use std::str::FromStr;

/// Unit of the coordinates in a file. Behind the reader everything is metres.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum LengthUnit {
    /// 10⁻⁶ m.
    Micrometre,
    /// 10⁻³ m.
    Millimetre,
    /// 10⁻² m.
    Centimetre,
    /// 1 m.
    #[default]
    Metre,
    /// 10³ m.
    Kilometre,
    /// 0.0254 m.
    Inch,
    /// 0.3048 m.
    Foot,
}

/// Text that names no unit.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("unit {0:?} is unknown; use um, mm, cm, m, km, in or ft")]
pub struct UnknownUnit(String);

impl LengthUnit {
    const ALL: [(Self, &'static str, f64); 7] = [
        (Self::Micrometre, "um", 1e-6),
        (Self::Millimetre, "mm", 1e-3),
        (Self::Centimetre, "cm", 1e-2),
        (Self::Metre, "m", 1.0),
        (Self::Kilometre, "km", 1e3),
        (Self::Inch, "in", 0.0254),
        (Self::Foot, "ft", 0.3048),
    ];

    /// Metres in one of it.
    #[must_use]
    pub fn metres(self) -> f64 {
        let found = Self::ALL.iter().find(|(unit, ..)| *unit == self);
        found.map_or(1.0, |(.., metres)| *metres)
    }

    /// The unit a cloud may really be in, where its largest extent (metres, read in this unit)
    /// is out of all proportion: a scan in metres is seldom wider than 50 m, one in millimetres
    /// seldom smaller than 2 mm. A guess to be told, never to be acted on.
    #[must_use]
    pub fn suspected(self, extent_m: f64) -> Option<Self> {
        match self {
            Self::Metre if extent_m > 50.0 => Some(Self::Millimetre),
            Self::Millimetre if extent_m < 0.002 => Some(Self::Metre),
            _ => None,
        }
    }
}

impl fmt::Display for LengthUnit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let found = Self::ALL.iter().find(|(unit, ..)| unit == self);
        f.write_str(found.map_or("m", |(_, name, _)| name))
    }
}

impl FromStr for LengthUnit {
    type Err = UnknownUnit;

    fn from_str(text: &str) -> Result<Self, UnknownUnit> {
        let found = Self::ALL.iter().find(|(_, name, _)| *name == text);
        found
            .map(|(unit, ..)| *unit)
            .ok_or_else(|| UnknownUnit(text.to_owned()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_read_back() {
        for (unit, name, metres) in LengthUnit::ALL {
            assert_eq!(name.parse(), Ok(unit));
            assert_eq!((unit.to_string().as_str(), unit.metres()), (name, metres));
        }
        assert!("parsec".parse::<LengthUnit>().is_err());
    }

    #[test]
    fn a_kidney_of_107_metres_is_suspect() {
        let metre = LengthUnit::Metre;
        assert_eq!(metre.suspected(107.0), Some(LengthUnit::Millimetre));
        assert_eq!(metre.suspected(0.15), None);
        assert_eq!(LengthUnit::Millimetre.suspected(0.0002), Some(metre));
    }
}
