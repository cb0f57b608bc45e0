//! Any payload of ours: which kind it is, and one decoder for all kinds.
//!
//! | first bytes | kind | read by |
//! |---|---|---|
//! | `SL` | sensor map, key or P frame | [`super::Decoder`] |
//! | `SPOL` | polar map, decodes alone | [`super::polar`] |

use super::{CodecError, DecodedFrame, Decoder, Level, header, polar};
use crate::contact_map::merged::ClaimMap;

/// In which domain a payload's contact map lies.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Domain {
    /// The camera's ray grid: a depth image comes back.
    #[default]
    Sensor,
    /// Each sphere's own latitude and longitude: points come back.
    Polar,
}

impl Domain {
    /// Domain of a payload by its first bytes. `None` for bytes of no known kind.
    #[must_use]
    pub fn of(payload: &[u8]) -> Option<Self> {
        if payload.starts_with(&polar::MAGIC) {
            Some(Self::Polar)
        } else if payload.starts_with(&header::MAGIC) {
            Some(Self::Sensor)
        } else {
            None
        }
    }

    /// `sensor` or `polar`.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Sensor => "sensor",
            Self::Polar => "polar",
        }
    }
}

/// A decoded payload.
#[derive(Clone, Copy, Debug)]
pub enum Payload<'a> {
    /// A depth frame with labels and spheres.
    Sensor(&'a DecodedFrame),
    /// Spheres with the cells they claim.
    Polar(&'a ClaimMap),
}

/// Decodes payloads of both domains, in any mixture.
#[derive(Debug, Default)]
pub struct PayloadDecoder {
    sensor: Decoder,
    polar: ClaimMap,
}

impl PayloadDecoder {
    /// A decoder that waits for a payload that decodes alone.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// A decoder of coarser sensor frames. Polar payloads have one level only.
    #[must_use]
    pub fn at(level: Level) -> Self {
        Self {
            sensor: Decoder::at(level),
            polar: ClaimMap::default(),
        }
    }

    /// Decodes one payload. Safe on any bytes.
    ///
    /// # Errors
    /// [`CodecError`]; a polar payload leaves the sensor frames' reference as it was.
    pub fn decode(&mut self, payload: &[u8]) -> Result<Payload<'_>, CodecError> {
        match Domain::of(payload) {
            Some(Domain::Polar) => {
                self.polar = polar::decode(payload)?;
                Ok(Payload::Polar(&self.polar))
            }
            // what is of no known kind gets the sensor decoder's complaint
            Some(Domain::Sensor) | None => Ok(Payload::Sensor(self.sensor.decode(payload)?)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn kinds_are_told_by_their_first_bytes() {
        let mut bytes = Vec::new();
        let map = ClaimMap {
            step_m: 0.01,
            starts: vec![0],
            ..ClaimMap::default()
        };
        polar::encode(&map, &mut bytes).unwrap();
        assert_eq!(Domain::of(&bytes), Some(Domain::Polar));
        let mut decoder = PayloadDecoder::new();
        assert!(matches!(decoder.decode(&bytes), Ok(Payload::Polar(m)) if *m == map));
        for length in 0..bytes.len() {
            assert!(decoder.decode(&bytes[..length]).is_err(), "{length} bytes");
        }
        assert_eq!(Domain::of(b"SL"), Some(Domain::Sensor));
        assert_eq!(Domain::of(b"PNG"), None);
        assert!(matches!(
            decoder.decode(b"what is this"),
            Err(CodecError::Corrupt { at: 0, .. })
        ));
    }
}
