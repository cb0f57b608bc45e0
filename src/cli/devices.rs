//! `devices`: the cameras of this machine.

use super::args::DevicesArgs;
use super::failure::{Failure, Kind};
use saint_live::capture::devices::list_devices;
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
            "{} {} {} [{}{}{}]: {}",
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
                .map_or(String::new(), |serial| format!(" {serial}")),
            device.reason
        );
        if device.depth {
            for format in &device.formats {
                let sizes: Vec<_> = format
                    .sizes
                    .iter()
                    .map(|size| {
                        let rates: Vec<_> = size.fps.iter().map(|f| format!("{f:.0}")).collect();
                        format!("{}x{}@{}", size.width, size.height, rates.join("/"))
                    })
                    .collect();
                let _ = writeln!(text, "      {} {}", format.pixel_format, sizes.join(" "));
            }
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
