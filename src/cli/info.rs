//! `info`: what is in a recording or model.

use super::args::InfoArgs;
use super::failure::{Failure, Kind};
use super::{message, model_file};
use saint_live::frame::FrameTime;
use saint_live::model::file::is_model;
use saint_live::recording::{Account, Info, RecordingError, RecordingReader};
use serde::Serialize;
use std::fmt::Write as _;

/// What is shown as JSON: of several cameras the first, as everywhere, then all of them.
#[derive(Serialize)]
struct Shown<'a> {
    #[serde(flatten)]
    first: &'a Info,
    #[serde(skip_serializing_if = "<[Info]>::is_empty")]
    cameras: &'a [Info],
}

/// Reads the whole file, so that every damage is known, and says what is in it.
pub fn run(args: &InfoArgs) -> Result<(), Failure> {
    if is_model(&args.file) {
        return model_file::info(&args.file, args.json);
    }
    let mut reader = RecordingReader::open(&args.file)?;
    reader.verify();
    let infos = match reader.cameras() {
        [] | [_] => vec![reader.info()],
        names => {
            let each = names.iter().map(|name| {
                let mut reader = RecordingReader::open_camera(&args.file, name)?;
                reader.verify();
                Ok(reader.info())
            });
            each.collect::<Result<Vec<_>, RecordingError>>()?
        }
    };
    if args.json {
        let shown = Shown {
            first: &infos[0],
            cameras: if infos.len() > 1 { &infos } else { &[] },
        };
        let text = serde_json::to_string(&shown).map_err(|e| Failure::new(Kind::Failure, e))?;
        super::write_data(format!("{text}\n").as_bytes())?;
    } else {
        for info in &infos {
            super::write_data(describe(info).as_bytes())?;
        }
    }
    // damage of the file is the same for all its cameras
    let info = &infos[0];
    let cut = info.cut.then(|| info.damaged.len().saturating_sub(1));
    for (n, damage) in info.damaged.iter().enumerate() {
        let (path, at, frame, what) = (&info.path, damage.offset, damage.frame, &damage.what);
        message::say(&if cut == Some(n) {
            format!("{path}: cut at byte {at}, after {frame} whole frames: {what}")
        } else {
            format!("{path}: damaged at byte {at}, before frame {frame}: {what}")
        });
    }
    if !info.damaged.is_empty() {
        let path = &info.path;
        message::say(&format!(
            "`saint-live repair {path} -o OUT.mcap` writes what is whole to a new file"
        ));
    }
    Ok(())
}

/// One camera's stream in a few lines.
fn describe(info: &Info) -> String {
    let mut text = String::new();
    let camera = &info.camera;
    let k = &camera.intrinsics;
    // writing to a String cannot fail
    let _ = writeln!(
        text,
        "{}: {} bytes, {}",
        info.path, info.bytes, info.generator
    );
    let _ = writeln!(
        text,
        "camera    {}: {}x{}, fx {:.2} fy {:.2} cx {:.2} cy {:.2}, 1 unit = {} mm",
        camera.name,
        info.width,
        info.height,
        k.fx,
        k.fy,
        k.cx,
        k.cy,
        camera.depth_unit_m * 1e3
    );
    let raw = info.contact_map == "none";
    let kind = match raw {
        true => "raw".to_owned(),
        false => format!("{} key", info.key_frames),
    };
    let _ = writeln!(
        text,
        "stream    {} frames ({kind}) in {:.2} s, lost before coding {}",
        info.frames, info.duration_s, info.lost_frames
    );
    let _ = writeln!(text, "time      {}", times(info));
    if let Some(account) = &info.account {
        let _ = writeln!(text, "sensor    {}", balance(account));
    }
    if let (Some(fps), Some(rate), Some(bits)) = (info.fps, info.bitrate_bps, info.bits_per_frame) {
        let _ = writeln!(
            text,
            "rate      {fps:.2} fps, {:.3} Mbit/s, {:.0} bytes a frame",
            rate * 1e-6,
            bits / 8.0
        );
    }
    if let Some(account) = info.account.as_ref().filter(|a| a.spent_bits.total() > 0) {
        let _ = writeln!(text, "bits      {}", account.spent_bits);
    }
    if !raw {
        let _ = writeln!(text, "contacts  {} map", info.contact_map);
    }
    for channel in &info.channels {
        let _ = writeln!(
            text,
            "channel   {}: {} messages, {} bytes, {} {}",
            channel.topic, channel.messages, channel.bytes, channel.encoding, channel.schema
        );
    }
    for (name, value) in &info.notes {
        let _ = writeln!(text, "note      {name}: {value}");
    }
    text
}

/// Both clocks, which is which, and whether time ever ran backwards.
fn times(info: &Info) -> String {
    let device = |time: FrameTime| time.device_ns as f64 * 1e-9;
    let wall = match (info.first.wall_ns, info.last.wall_ns) {
        (0, _) | (_, 0) => "wall clock not known".to_owned(),
        (first, last) => format!("wall clock {} to {}", date(first), date(last)),
    };
    let order = if info.monotonic {
        "ascending"
    } else {
        "NOT ascending"
    };
    format!(
        "device clock {:.3} to {:.3} s, {order}; {wall}",
        device(info.first),
        device(info.last)
    )
}

/// Where the sensor's frames went.
fn balance(account: &Account) -> String {
    let mut text = format!(
        "{} frames, {} of them written",
        account.sensor_frames, account.frames
    );
    for (cause, count) in account.drops.iter().filter(|(_, count)| **count > 0) {
        let _ = write!(text, ", {count} dropped ({})", cause.replace('_', " "));
    }
    text
}

/// Nanoseconds since 1970 as a date of UTC.
///
/// Days to year, month and day in the Gregorian calendar, counted from 1 March of year 0, so that
/// a leap day is a year's last.
fn date(unix_ns: i64) -> String {
    let (second, ns) = (
        unix_ns.div_euclid(1_000_000_000),
        unix_ns.rem_euclid(1_000_000_000),
    );
    let (day, second) = (
        second.div_euclid(86_400) + 719_468,
        second.rem_euclid(86_400),
    );
    let (era, day) = (day.div_euclid(146_097), day.rem_euclid(146_097));
    let year = (day - day / 1460 + day / 36_524 - day / 146_096) / 365;
    let day = day - (365 * year + year / 4 - year / 100);
    let month = (5 * day + 2) / 153;
    let day_of_month = day - (153 * month + 2) / 5 + 1;
    let (year, month) = match month {
        0..10 => (era * 400 + year, month + 3),
        _ => (era * 400 + year + 1, month - 9),
    };
    format!(
        "{year:04}-{month:02}-{day_of_month:02}T{:02}:{:02}:{:02}.{:03}Z",
        second / 3600,
        second / 60 % 60,
        second % 60,
        ns / 1_000_000
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dates_are_those_of_the_calendar() {
        for (second, expected) in [
            (0, "1970-01-01T00:00:00.000Z"),
            (951_782_400, "2000-02-29T00:00:00.000Z"),
            (951_868_799, "2000-02-29T23:59:59.000Z"),
            (4_107_542_400, "2100-03-01T00:00:00.000Z"),
            (1_700_000_000, "2023-11-14T22:13:20.000Z"),
            (-1, "1969-12-31T23:59:59.000Z"),
        ] {
            assert_eq!(date(second * 1_000_000_000), expected);
        }
    }
}
