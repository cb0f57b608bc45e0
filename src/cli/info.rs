//! `info`: what is in a recording or model.

use super::args::InfoArgs;
use super::failure::{Failure, Kind};
use super::{message, model_file};
use saint_live::model::file::is_model;
use saint_live::recording::RecordingReader;
use std::fmt::Write as _;

/// Reads the whole file, so that every damage is known, and says what is in it.
pub fn run(args: &InfoArgs) -> Result<(), Failure> {
    if is_model(&args.file) {
        return model_file::info(&args.file, args.json);
    }
    let mut reader = RecordingReader::open(&args.file)?;
    reader.verify();
    let info = reader.info();
    if args.json {
        let mut text = serde_json::to_string(&info).map_err(|e| Failure::new(Kind::Failure, e))?;
        text.push('\n');
        super::write_data(text.as_bytes())?;
    } else {
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
        let _ = writeln!(
            text,
            "stream    {} frames ({} key) in {:.2} s, lost before coding {}",
            info.frames, info.key_frames, info.duration_s, info.lost_frames
        );
        if let (Some(fps), Some(rate), Some(bits)) =
            (info.fps, info.bitrate_bps, info.bits_per_frame)
        {
            let _ = writeln!(
                text,
                "rate      {fps:.2} fps, {:.3} Mbit/s, {:.0} bytes a frame",
                rate * 1e-6,
                bits / 8.0
            );
        }
        let _ = writeln!(text, "contacts  {} map", info.contact_map);
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
        super::write_data(text.as_bytes())?;
    }
    for damage in &info.damaged {
        message::say(&format!(
            "{}: damaged at byte {}, before frame {}: {}",
            info.path, damage.offset, damage.frame, damage.what
        ));
    }
    Ok(())
}
