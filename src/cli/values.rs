//! Values with units: `5mm`, `33ms`, `640x480`.

use saint_live::recording::Split;
use std::str::FromStr;
use std::time::Duration;

/// A length, metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Length(pub f64);

/// Cells of a contact map, as typed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum MapResolution {
    /// Side of a cell.
    Side(Length),
    /// Cells over 180 degrees.
    Cells(u32),
}

impl FromStr for MapResolution {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if let Ok(cells) = text.trim().parse::<u32>() {
            return match cells {
                1..=32_768 => Ok(Self::Cells(cells)),
                _ => Err("a number of cells is 1 to 32768".to_owned()),
            };
        }
        let has_unit = text.trim().ends_with('m');
        match length(text) {
            Ok(side) if has_unit => Ok(Self::Side(side)),
            _ => Err("a length with its unit (0.5mm), or a whole number of cells".to_owned()),
        }
    }
}

/// A number followed by one of `units`, in the unit that has the factor 1.
fn number_with_unit(text: &str, units: &[(&str, f64)], bare: Option<f64>) -> Option<f64> {
    let text = text.trim();
    for (unit, per_one) in units {
        if let Some(number) = text.strip_suffix(unit)
            && let Ok(value) = number.trim_end().parse::<f64>()
        {
            return Some(value / per_one);
        }
    }
    let value = text.parse::<f64>().ok()?;
    bare.map(|factor| value / factor)
}

/// Reads a length above 0: `5mm`, `0.5cm`, `0.005m`, or metres without a unit.
pub fn length(text: &str) -> Result<Length, String> {
    // longer units first: "mm" also ends in "m"; divided, so that 5mm is the double nearest 0.005
    let units = [("um", 1e6), ("mm", 1e3), ("cm", 1e2), ("m", 1.0)];
    match number_with_unit(text, &units, Some(1.0)) {
        Some(value) if value.is_finite() && value > 0.0 => Ok(Length(value)),
        Some(value) => Err(format!("{value} m is not a length above 0")),
        None => Err("a length is a number with a unit: 5mm, 0.5cm, 0.005m".to_owned()),
    }
}

/// Reads a length that may be 0.
pub fn length_or_zero(text: &str) -> Result<Length, String> {
    match text.trim().parse::<f64>() {
        Ok(0.0) => Ok(Length(0.0)),
        _ => length(text),
    }
}

/// Reads a time above 0: `33ms`, `500us`, `2s`, `1.5min`, `1h`, or seconds without a unit.
pub fn duration(text: &str) -> Result<Duration, String> {
    let units = [
        ("min", 1.0 / 60.0),
        ("ms", 1e3),
        ("us", 1e6),
        ("s", 1.0),
        ("h", 1.0 / 3600.0),
    ];
    match number_with_unit(text, &units, Some(1.0)) {
        Some(seconds) if seconds > 0.0 => {
            Duration::try_from_secs_f64(seconds).map_err(|_| format!("{seconds} s is too long"))
        }
        Some(seconds) => Err(format!("{seconds} s is not a time above 0")),
        None => Err("a time is a number with a unit: 33ms, 2s, 1.5min".to_owned()),
    }
}

/// Reads a time as [`duration`] does, or 0.
pub fn duration_or_zero(text: &str) -> Result<Duration, String> {
    match text.trim_end_matches(|unit: char| unit.is_ascii_alphabetic()) {
        "0" => Ok(Duration::ZERO),
        _ => duration(text),
    }
}

/// Reads a bit rate: `2M`, `800k`, `1.5Mbit`, or bits per second without a unit.
pub fn bitrate(text: &str) -> Result<f64, String> {
    let text = text
        .trim()
        .trim_end_matches("bit/s")
        .trim_end_matches("bit");
    match number_with_unit(text, &[("k", 1e-3), ("M", 1e-6)], Some(1.0)) {
        Some(rate) if rate.is_finite() && rate >= 1000.0 => Ok(rate),
        Some(rate) => Err(format!("{rate} bits per second are too few; at least 1k")),
        None => Err("a bit rate is a number with a unit: 2M, 800k".to_owned()),
    }
}

/// Reads where a recording is split: a size (`4GB`, `500MB`, `64MiB`) or a time (`10min`).
pub fn split(text: &str) -> Result<Split, String> {
    let units = [
        ("KiB", 1.0 / 1024.0),
        ("MiB", 1.0 / (1 << 20) as f64),
        ("GiB", 1.0 / (1 << 30) as f64),
        ("kB", 1e-3),
        ("MB", 1e-6),
        ("GB", 1e-9),
    ];
    match number_with_unit(text, &units, None) {
        Some(bytes) if bytes.is_finite() && bytes >= 1.0 => Ok(Split::Bytes(bytes.round() as u64)),
        Some(bytes) => Err(format!("{bytes} bytes are no size")),
        None if text.trim().parse::<f64>().is_err() => match duration(text) {
            Ok(time) => Ok(Split::Time(time)),
            Err(_) => Err("a part is a size or a time: 4GB, 500MB, 10min".to_owned()),
        },
        None => Err("say the unit: 4GB, 500MB, 10min, 30s".to_owned()),
    }
}

/// Reads an image size: `640x480`.
pub fn size(text: &str) -> Result<(u32, u32), String> {
    let read = || {
        let (width, height) = text.split_once(['x', 'X'])?;
        let size = (width.parse().ok()?, height.parse().ok()?);
        (size.0 > 0 && size.1 > 0).then_some(size)
    };
    read().ok_or_else(|| "a size is WIDTHxHEIGHT in pixels: 640x480".to_owned())
}

/// Reads a positive, finite factor.
pub fn factor(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if value.is_finite() && value > 0.0 => Ok(value),
        _ => Err("a number above 0".to_owned()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lengths_are_metres() {
        for (text, want) in [
            ("5mm", 0.005),
            ("0.005m", 0.005),
            ("0.005", 0.005),
            ("2 cm", 0.02),
            ("700um", 0.0007),
            ("1e-3m", 0.001),
        ] {
            assert_eq!(length(text), Ok(Length(want)), "{text}");
        }
        for text in ["", "mm", "5 apples", "-1mm", "0", "nan", "inf", "5mmm"] {
            assert!(length(text).is_err(), "{text}");
        }
        assert_eq!(length_or_zero("0"), Ok(Length(0.0)));
        assert_eq!(length_or_zero("3mm"), Ok(Length(0.003)));
    }

    #[test]
    fn map_resolutions_are_lengths_or_counts() {
        let read = |text: &str| text.parse::<MapResolution>();
        assert_eq!(read("0.5mm"), Ok(MapResolution::Side(Length(0.0005))));
        assert_eq!(read("512"), Ok(MapResolution::Cells(512)));
        for text in ["0", "40000", "0.5", "-1mm", "mm", "1e3"] {
            assert!(read(text).is_err(), "{text}");
        }
    }

    #[test]
    fn durations_are_times() {
        for (text, want) in [
            ("33ms", Duration::from_millis(33)),
            ("2s", Duration::from_secs(2)),
            ("2", Duration::from_secs(2)),
            ("1.5min", Duration::from_secs(90)),
            ("1h", Duration::from_secs(3600)),
            ("500us", Duration::from_micros(500)),
        ] {
            let got = duration(text).unwrap();
            assert!(
                got.abs_diff(want) < Duration::from_nanos(2),
                "{text}: {got:?}"
            );
        }
        for text in ["", "ms", "-1s", "0s", "nan", "1e300s", "3 days"] {
            assert!(duration(text).is_err(), "{text}");
            assert_eq!(duration_or_zero(text).is_ok(), text == "0s", "{text}");
        }
        assert_eq!(duration_or_zero("0"), Ok(Duration::ZERO));
        assert_eq!(duration_or_zero("2s"), Ok(Duration::from_secs(2)));
    }

    #[test]
    fn parts_are_sizes_or_times() {
        assert_eq!(split("4GB"), Ok(Split::Bytes(4_000_000_000)));
        assert_eq!(split("64MiB"), Ok(Split::Bytes(64 << 20)));
        assert_eq!(split("10min"), Ok(Split::Time(Duration::from_secs(600))));
        for text in ["", "5", "0MB", "-1GB", "nanGB", "5 apples", "MB", "0s"] {
            assert!(split(text).is_err(), "{text}");
        }
    }

    #[test]
    fn sizes_are_two_numbers() {
        assert_eq!(size("640x480"), Ok((640, 480)));
        for text in ["640", "x", "0x1", "640x480x3", "-1x5"] {
            assert!(size(text).is_err(), "{text}");
        }
    }
}
