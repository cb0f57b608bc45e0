//! Times of recorded frames: decimal seconds, kept exact as integer nanoseconds.

use super::input;
use crate::capture::CaptureError;
use crate::frame::FrameTime;
use std::collections::BTreeMap;
use std::path::Path;

/// Seconds since 1970 are above this (September 2001); a recording's own clock is below.
const EPOCH_FROM_NS: i64 = 1_000_000_000_000_000_000;
/// Integers with so many digits are nanoseconds already.
pub(super) const NANOSECOND_DIGITS: usize = 16;
/// What the word of a wall clock begins with.
const WALL: &str = "wall=";
/// Text files beside a sequence are small: an hour at 90 Hz is 10 MB.
const MAX_TEXT_BYTES: u64 = 1 << 26;

/// Decimal seconds (or a long integer of nanoseconds) as nanoseconds, without rounding through
/// a float. `None` if `text` is not such a number or does not fit.
pub(super) fn nanoseconds(text: &str) -> Option<i64> {
    let (negative, text) = match text.strip_prefix('-') {
        Some(rest) => (true, rest),
        None => (false, text),
    };
    let (whole, fraction) = text.split_once('.').unwrap_or((text, ""));
    let plain = |part: &str| part.bytes().all(|c| c.is_ascii_digit());
    if whole.is_empty() || !plain(whole) || !plain(fraction) {
        return None;
    }
    let value: i64 = whole.parse().ok()?;
    let ns = if fraction.is_empty() && whole.len() >= NANOSECOND_DIGITS {
        value
    } else {
        let digits = &fraction[..fraction.len().min(9)];
        let part: i64 = format!("{digits:0<9}").parse().ok()?;
        value.checked_mul(1_000_000_000)?.checked_add(part)?
    };
    Some(if negative { -ns } else { ns })
}

/// A line of `timestamps.txt` that gives both clocks back exactly.
#[must_use]
pub fn timestamp_line(number: u64, time: FrameTime) -> String {
    let seconds = |ns: i64| {
        let sign = if ns < 0 { "-" } else { "" };
        let ns = ns.unsigned_abs();
        format!("{sign}{}.{:09}", ns / 1_000_000_000, ns % 1_000_000_000)
    };
    let (device, wall) = (seconds(time.device_ns), seconds(time.wall_ns));
    format!("{number} {device} {WALL}{wall}\n")
}

/// Frame times out of a recording's clock: Unix times give the wall clock too, and a device
/// clock that starts at `zero_ns`.
pub(in crate::capture) fn frame_time(ns: i64, zero_ns: i64) -> FrameTime {
    if zero_ns >= EPOCH_FROM_NS {
        FrameTime {
            device_ns: ns.saturating_sub(zero_ns),
            wall_ns: ns,
        }
    } else {
        FrameTime {
            device_ns: ns,
            wall_ns: 0,
        }
    }
}

/// Reads a text file beside the sequence, of bounded size.
pub(super) fn read_text(path: &Path) -> Result<String, CaptureError> {
    let io = |error: std::io::Error| input(path, error.to_string(), "check the file");
    let bytes = std::fs::metadata(path).map_err(io)?.len();
    if bytes > MAX_TEXT_BYTES {
        let what = format!("{bytes} bytes, but at most {MAX_TEXT_BYTES} are read");
        return Err(input(path, what, "shorten it"));
    }
    std::fs::read_to_string(path).map_err(io)
}

/// `timestamps.txt`: lines `frame seconds`, or `seconds` alone in the order of the frames. A third
/// word `wall=seconds` is the wall clock of the frame; the second is then the device's.
#[derive(Debug, Default)]
pub(super) struct Timestamps {
    by_number: BTreeMap<u64, i64>,
    /// Frames whose both clocks are listed.
    both: BTreeMap<u64, FrameTime>,
    by_position: Vec<i64>,
    zero_ns: i64,
}

impl Timestamps {
    /// Reads the file; a missing file has no times.
    ///
    /// # Errors
    /// [`CaptureError::Input`] with the line that is not a time.
    pub(super) fn read(path: &Path) -> Result<Self, CaptureError> {
        let mut times = Self::default();
        if !path.is_file() {
            return Ok(times);
        }
        let mut zero = None;
        for (line, text) in (1..).zip(read_text(path)?.lines()) {
            let text = text.split('#').next().unwrap_or_default();
            let words: Vec<&str> = text
                .split([' ', '\t', ','])
                .filter(|w| !w.is_empty())
                .collect();
            let entry = match words[..] {
                [] => continue,
                [time] => nanoseconds(time.trim()).map(|ns| (None, ns)),
                [number, time, ..] => number
                    .parse::<u64>()
                    .ok()
                    .zip(nanoseconds(time.trim()))
                    .map(|(number, ns)| (Some(number), ns)),
            };
            let Some((number, ns)) = entry else {
                return Err(input(
                    path,
                    format!("line {line} \"{}\" is not \"frame seconds\"", text.trim()),
                    "correct the line or remove the file",
                ));
            };
            zero.get_or_insert(ns);
            match number {
                Some(number) => {
                    times.by_number.insert(number, ns);
                    let wall = words.get(2).and_then(|word| word.strip_prefix(WALL));
                    if let Some(wall_ns) = wall.and_then(nanoseconds) {
                        let device_ns = ns;
                        times.both.insert(number, FrameTime { device_ns, wall_ns });
                    }
                }
                None => times.by_position.push(ns),
            }
        }
        times.zero_ns = zero.unwrap_or(0);
        Ok(times)
    }

    /// Time of the frame with this number at this position, where the file has one.
    pub(super) fn of(&self, number: u64, position: usize) -> Option<FrameTime> {
        if let Some(time) = self.both.get(&number) {
            return Some(*time);
        }
        let ns = self
            .by_number
            .get(&number)
            .or_else(|| self.by_position.get(position))?;
        Some(frame_time(*ns, self.zero_ns))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn seconds_stay_exact() {
        assert_eq!(
            nanoseconds("1305031102.160407"),
            Some(1_305_031_102_160_407_000)
        );
        assert_eq!(
            nanoseconds("1305031102.19433"),
            Some(1_305_031_102_194_330_000)
        );
        assert_eq!(nanoseconds("0.033"), Some(33_000_000));
        assert_eq!(nanoseconds("-1.5"), Some(-1_500_000_000));
        assert_eq!(nanoseconds("7"), Some(7_000_000_000));
        assert_eq!(nanoseconds("0.1234567899"), Some(123_456_789));
        assert_eq!(
            nanoseconds("1403636579763555584"),
            Some(1_403_636_579_763_555_584)
        );
        for not in ["", ".5", "1e9", "x", "1.2.3", "99999999999.0", "1.x", "-"] {
            assert_eq!(nanoseconds(not), None, "{not}");
        }
    }

    #[test]
    fn a_line_of_both_clocks_comes_back() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("timestamps.txt");
        let times = [
            (0, 12_345_678_901_234, 1_700_000_000_000_000_001),
            (7, -1, 0),
            (9, 1_700_000_000_000_000_000, 1_700_000_000_000_000_003),
        ]
        .map(|(number, device_ns, wall_ns)| (number, FrameTime { device_ns, wall_ns }));
        let lines: String = times
            .iter()
            .map(|(number, time)| timestamp_line(*number, *time))
            .collect();
        std::fs::write(&path, lines).unwrap();
        let read = Timestamps::read(&path).unwrap();
        for (number, time) in times {
            assert_eq!(read.of(number, 99), Some(time));
        }
    }

    #[test]
    fn unix_times_give_both_clocks() {
        let zero = nanoseconds("1305031102.160407").unwrap();
        let time = frame_time(zero + 5, zero);
        assert_eq!((time.device_ns, time.wall_ns), (5, zero + 5));
        let own = frame_time(1_000, 1_000);
        assert_eq!((own.device_ns, own.wall_ns), (1_000, 0));
    }
}
