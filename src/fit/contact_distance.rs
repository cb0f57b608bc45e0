//! How far from its sphere a point may lie and still touch it (paper 4.1: *contact distance*).
//!
//! Deviation. Paper 4.1 uses one constant. A stereo or structured-light sensor's noise grows with
//! the square of depth, so a constant below the sensor's step fits noise far away and wastes
//! detail near by. Here the distance is `max(floor, k·z²)`; `k = 0` is the paper's constant.

use std::fmt;
use std::str::FromStr;

/// Contact distance as a function of depth: `max(floor_m, per_z2 · z²)`, metres.
///
/// As text: `5mm`, `0.005` (metres), `5mm+1.4e-3z2` (floor, then the factor of z² in 1/m).
/// The `+` joins the two parts; the larger of them holds, they are not added.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ContactDistance {
    /// Never smaller than this, metres.
    pub floor_m: f64,
    /// Growth with the square of depth, 1/m. 0 for a constant distance.
    pub per_z2: f64,
}

/// Text that is no contact distance.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ContactDistanceError {
    /// A part that is not a number with a known unit.
    #[error(
        "contact distance {text:?}: {part:?} is not a length; write 5mm, 0.005 (metres) or 5mm+1.4e-3z2"
    )]
    NotALength {
        /// The whole text.
        text: String,
        /// The part that could not be read.
        part: String,
    },
    /// A value outside what can be modelled.
    #[error(
        "contact distance {text:?}: the floor must be above 0 and at most 1000 m and the factor of z2 between 0 and 1 per metre"
    )]
    OutOfRange {
        /// The whole text.
        text: String,
    },
}

impl ContactDistance {
    /// The same distance everywhere, metres (the paper's).
    #[must_use]
    pub const fn constant(floor_m: f64) -> Self {
        Self {
            floor_m,
            per_z2: 0.0,
        }
    }

    /// Contact distance at depth `z_m` (metres, planar z), metres.
    #[inline]
    #[must_use]
    pub fn at(&self, z_m: f64) -> f64 {
        self.floor_m.max(self.per_z2 * z_m * z_m)
    }

    /// The distance to fit with where every pixel must come back within `bound_m` metres, 0 for
    /// exactly: wide, since the residual section gives pixels back anyway and spheres that follow
    /// noise cost more bits than they save. (5 mm on Kinect, D435 and D455 sequences: 0.60, 0.89
    /// and 0.65 bits per pixel; fitted to 9 mm + 5e-3·z²: 0.65, 1.03 and 0.71.)
    #[must_use]
    pub fn for_bound(bound_m: f64) -> Self {
        Self {
            floor_m: (1.8 * bound_m).max(0.03),
            per_z2: 1e-2,
        }
    }

    /// This share of the distance.
    #[must_use]
    pub fn scaled(&self, share: f64) -> Self {
        Self {
            floor_m: self.floor_m * share,
            per_z2: self.per_z2 * share,
        }
    }

    /// True where depth plays no part.
    #[must_use]
    pub fn is_constant(&self) -> bool {
        self.per_z2 == 0.0
    }
}

impl Default for ContactDistance {
    /// 12 mm, growing with 2.8 standard deviations of Kinect and RealSense readings, which are
    /// 1.4e-3·z² (Khoshelham and Elberink, *Sensors* 2012, find 1.425e-3). One standard deviation
    /// would leave a third of a flat wall's readings off it whatever the surface; at 2.6 one in a
    /// hundred stays outside.
    fn default() -> Self {
        Self {
            floor_m: 0.012,
            per_z2: 4e-3,
        }
    }
}

impl From<f64> for ContactDistance {
    fn from(floor_m: f64) -> Self {
        Self::constant(floor_m)
    }
}

/// Metres in `text`: a number with `um`, `mm`, `cm`, `m` or nothing (metres) after it.
fn length_m(text: &str) -> Option<f64> {
    let text = text.trim();
    for (unit, per_metre) in [("um", 1e6), ("mm", 1e3), ("cm", 1e2), ("m", 1.0)] {
        if let Some(number) = text.strip_suffix(unit) {
            // divided, not multiplied by 1e-3: "5mm" is then exactly the double nearest 0.005
            return number.trim().parse::<f64>().ok().map(|v| v / per_metre);
        }
    }
    text.parse().ok()
}

impl FromStr for ContactDistance {
    type Err = ContactDistanceError;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let not_a_length = |part: &str| ContactDistanceError::NotALength {
            text: text.to_owned(),
            part: part.to_owned(),
        };
        // the last '+' that does not belong to an exponent such as 1e+2
        let split = text
            .char_indices()
            .rev()
            .find(|&(i, c)| c == '+' && i > 0 && !text[..i].ends_with(['e', 'E']))
            .map(|(i, _)| i);
        let (floor, growth) = match split {
            Some(i) => (&text[..i], Some(&text[i + 1..])),
            None => (text, None),
        };
        let floor_m = length_m(floor).ok_or_else(|| not_a_length(floor))?;
        let per_z2 = match growth {
            None => 0.0,
            Some(part) => {
                let number = part.trim();
                number
                    .strip_suffix("z2")
                    .or_else(|| number.strip_suffix("z²"))
                    .and_then(|number| number.trim_end_matches('*').trim().parse().ok())
                    .ok_or_else(|| not_a_length(part))?
            }
        };
        let sane = floor_m > 0.0 && floor_m <= 1000.0 && (0.0..=1.0).contains(&per_z2);
        if !sane {
            return Err(ContactDistanceError::OutOfRange {
                text: text.to_owned(),
            });
        }
        Ok(Self { floor_m, per_z2 })
    }
}

impl fmt::Display for ContactDistance {
    /// Text that [`FromStr`] reads back to the same value.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        // the fewest digits that read back to the same double: 0.043 mm, not 0.043000000000000003
        let exact = |text: &String| length_m(text) == Some(self.floor_m);
        let millimetres = (0..12).map(|digits| format!("{:.digits$}mm", self.floor_m * 1e3));
        match millimetres.into_iter().find(exact) {
            Some(text) => f.write_str(&text)?,
            None => write!(f, "{}", self.floor_m)?,
        }
        if self.per_z2 != 0.0 {
            write!(f, "+{:e}z2", self.per_z2)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn reads_the_documented_forms() {
        for (text, floor_m, per_z2) in [
            ("5mm", 0.005, 0.0),
            ("0.005", 0.005, 0.0),
            ("1.5 cm", 0.015, 0.0),
            ("2m", 2.0, 0.0),
            ("200um", 0.0002, 0.0),
            ("5mm+1.4e-3z2", 0.005, 1.4e-3),
            ("5e-3+1.4e-3z²", 0.005, 1.4e-3),
            ("1e+2mm", 0.1, 0.0),
            ("1e+2mm+1e-3*z2", 0.1, 1e-3),
        ] {
            let read: ContactDistance = text.parse().unwrap();
            assert_eq!(read, ContactDistance { floor_m, per_z2 }, "{text}");
        }
    }

    #[test]
    fn refuses_nonsense() {
        for text in [
            "",
            "mm",
            "5km",
            "-5mm",
            "0",
            "nan",
            "inf",
            "5mm+",
            "5mm+2",
            "5mm+-1z2",
            "5mm+nanz2",
            "+5z2",
            "5mm+2z2",
        ] {
            assert!(
                text.parse::<ContactDistance>().is_err(),
                "{text:?} was read"
            );
        }
    }

    #[test]
    fn grows_with_depth_above_the_floor() {
        let d = ContactDistance {
            floor_m: 0.005,
            per_z2: 1.4e-3,
        };
        assert_eq!(d.at(1.0), 0.005);
        assert_eq!(d.at(-3.0), d.at(3.0));
        assert!((d.at(4.0) - 1.4e-3 * 16.0).abs() < 1e-15);
    }

    proptest! {
        #[test]
        fn text_round_trips(floor_m in 1e-6f64..100.0, per_z2 in prop_oneof![Just(0.0), 1e-9f64..1.0]) {
            let d = ContactDistance { floor_m, per_z2 };
            prop_assert_eq!(d.to_string().parse::<ContactDistance>().unwrap(), d);
        }
    }
}
