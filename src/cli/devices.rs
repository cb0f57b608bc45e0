//! `devices`: the cameras of this machine.

use super::args::DevicesArgs;
use super::failure::{Failure, Kind};
use saint_live::capture::devices::list_devices;
use saint_live::capture::v4l2::offer::OfferedFormat;
use std::fmt::Write as _;

/// Lists every video node, what it offers and whether it is depth.
pub fn run(args: &DevicesArgs) -> Result<(), Failure> {
    let list = list_devices();
    if args.json {
        let mut text = serde_json::to_string(&list).map_err(|e| Failure::new(Kind::Failure, e))?;
        text.push('\n');
        return super::write_data(text.as_bytes());
    }
    let mut text = String::new();
    for device in &list.devices {
        // writing to a String cannot fail
        let _ = writeln!(
            text,
            "{} {} {} [{}{}{}{}]: {}",
            if device.depth { "*" } else { " " },
            device.path.display(),
            device.card,
            device.driver,
            device
                .usb_id
                .as_ref()
                .map_or(String::new(), |id| format!(" {id}")),
            device
                .serial
                .as_ref()
                .map_or(String::new(), |serial| format!(" serial {serial}")),
            match device.bus.as_str() {
                "" => String::new(),
                bus => format!(" bus {bus}"),
            },
            device.reason
        );
        if device.busy == Some(true) || !device.held_by.is_empty() {
            let busy = match device.busy {
                Some(true) => "in use",
                _ => "open",
            };
            let holders = match device.held_by.as_slice() {
                [] => "a program this user may not see".to_owned(),
                names => names.join(", "),
            };
            let _ = writeln!(text, "      {busy} by {holders}");
        }
        for format in &device.formats {
            let _ = writeln!(text, "      {}", offer(format));
        }
    }
    for camera in &list.without_node {
        let _ = writeln!(
            text,
            "! {} {}: {}",
            camera.usb_id, camera.product, camera.reason
        );
    }
    if text.is_empty() {
        text.push_str("no cameras; plug one in, or use --device synthetic:room\n");
    }
    super::write_data(text.as_bytes())
}

/// A format with its sizes and rates.
fn offer(format: &OfferedFormat) -> String {
    let mut text = format.pixel_format.to_string();
    for size in &format.sizes {
        let rates: Vec<_> = size.fps.iter().map(|f| format!("{f:.0}")).collect();
        let rates = rates.join("/");
        // writing to a String cannot fail
        let _ = write!(text, " {}x{}", size.width, size.height);
        if !rates.is_empty() {
            let _ = write!(text, "@{rates}");
        }
    }
    if let Some(range) = format.size_range {
        let ((least_x, least_y), (most_x, most_y)) = (range.min, range.max);
        let _ = write!(text, " {least_x}x{least_y} to {most_x}x{most_y}");
    }
    text
}
