//! USB facts about a camera that V4L2 does not pass on: its ids, its serial number, the extension
//! unit of a vendor, depth formats the kernel does not know. Read from sysfs, parsed here.

use std::fs;
use std::path::{Path, PathBuf};

/// A UVC extension unit: where vendor commands go.
pub const REALSENSE_UNIT: [u8; 16] = [
    0xcb, 0x6c, 0x60, 0xc9, 0x4c, 0x59, 0x25, 0x4d, 0xaf, 0x47, 0xcc, 0xc4, 0x96, 0x43, 0x59, 0x95,
];

/// The streaming format `D16` (a DirectX number, 80, as a GUID): depth that Linux does not list.
pub const D16_FORMAT: [u8; 16] = [
    0x50, 0, 0, 0, 0, 0, 0x10, 0, 0x80, 0, 0, 0xaa, 0, 0x38, 0x9b, 0x71,
];

const INTERFACE: u8 = 4;
const VIDEO_SPECIFIC: u8 = 0x24;
const VIDEO_CLASS: u8 = 0x0e;
const CONTROL: u8 = 1;
const STREAMING: u8 = 2;
const EXTENSION_UNIT: u8 = 6;
const UNCOMPRESSED_FORMAT: u8 = 4;

/// A USB device that carries a video node.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct UsbDevice {
    /// `vendor:product`, hexadecimal.
    pub id: String,
    /// Product name.
    pub product: String,
    /// Serial number, where it has one.
    pub serial: Option<String>,
    /// Number of the video control interface the node belongs to.
    pub interface: u8,
    /// Device and configuration descriptors, as the device sent them.
    pub descriptors: Vec<u8>,
}

/// The USB device behind `/dev/videoN`; `None` for a node that is not on USB.
#[must_use]
pub fn behind(node: &Path) -> Option<UsbDevice> {
    let name = fs::canonicalize(node).ok()?;
    let name = name.file_name()?;
    let sysfs = Path::new("/sys/class/video4linux")
        .join(name)
        .join("device");
    let interface = fs::canonicalize(sysfs).ok()?;
    let number = fs::read_to_string(interface.join("bInterfaceNumber")).ok()?;
    let mut device = read_device(interface.parent()?)?;
    device.interface = u8::from_str_radix(number.trim(), 16).ok()?;
    Some(device)
}

fn read_device(folder: &Path) -> Option<UsbDevice> {
    let text = |name: &str| {
        let text = fs::read(folder.join(name)).ok()?;
        Some(String::from_utf8_lossy(&text).trim().to_string())
    };
    Some(UsbDevice {
        id: format!("{}:{}", text("idVendor")?, text("idProduct")?),
        product: text("product").unwrap_or_default(),
        serial: text("serial").filter(|s| !s.is_empty()),
        interface: 0,
        descriptors: fs::read(folder.join("descriptors")).ok()?,
    })
}

/// USB cameras whose only depth is `D16`, which ends without a usable node.
#[must_use]
pub fn d16_cameras() -> Vec<UsbDevice> {
    let folders = fs::read_dir("/sys/bus/usb/devices").into_iter().flatten();
    let mut folders: Vec<PathBuf> = folders.flatten().map(|f| f.path()).collect();
    folders.sort();
    let cameras = folders.iter().filter_map(|folder| read_device(folder));
    cameras
        .filter(|d| streams_format(&d.descriptors, &D16_FORMAT))
        .collect()
}

/// The id of an extension unit in a video control interface, by the unit's GUID.
#[must_use]
pub fn extension_unit(descriptors: &[u8], interface: u8, guid: &[u8; 16]) -> Option<u8> {
    video_specific(descriptors)
        .filter(|d| d.subclass == CONTROL && d.interface == interface)
        .find(|d| d.body.get(2) == Some(&EXTENSION_UNIT) && d.body.get(4..20) == Some(guid))
        .and_then(|d| d.body.get(3).copied())
}

/// True when a streaming interface lists an uncompressed format of this GUID.
#[must_use]
pub fn streams_format(descriptors: &[u8], guid: &[u8; 16]) -> bool {
    video_specific(descriptors)
        .filter(|d| d.subclass == STREAMING)
        .any(|d| d.body.get(2) == Some(&UNCOMPRESSED_FORMAT) && d.body.get(5..21) == Some(guid))
}

/// A class-specific descriptor of a video interface.
struct VideoDescriptor<'a> {
    interface: u8,
    subclass: u8,
    body: &'a [u8],
}

/// Walks the descriptors; ends at the first whose length makes no sense.
fn video_specific(descriptors: &[u8]) -> impl Iterator<Item = VideoDescriptor<'_>> {
    let mut rest = descriptors;
    // Interface number, class and subclass the descriptors that follow belong to.
    let mut current = (0, 0, 0);
    std::iter::from_fn(move || {
        loop {
            let length = usize::from(*rest.first()?);
            if length < 2 || length > rest.len() {
                return None;
            }
            let (body, after) = rest.split_at(length);
            rest = after;
            match (body[1], body) {
                (INTERFACE, &[_, _, number, _, _, class, subclass, ..]) => {
                    current = (number, class, subclass);
                }
                (VIDEO_SPECIFIC, _) if current.1 == VIDEO_CLASS => {
                    return Some(VideoDescriptor {
                        interface: current.0,
                        subclass: current.2,
                        body,
                    });
                }
                _ => {}
            }
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn interface(number: u8, subclass: u8) -> Vec<u8> {
        vec![9, 4, number, 0, 0, VIDEO_CLASS, subclass, 0, 0]
    }

    fn unit(id: u8, guid: &[u8; 16]) -> Vec<u8> {
        let mut unit = vec![28, VIDEO_SPECIFIC, EXTENSION_UNIT, id];
        unit.extend(guid);
        unit.extend([0; 8]);
        unit
    }

    fn format(guid: &[u8; 16]) -> Vec<u8> {
        let mut format = vec![27, VIDEO_SPECIFIC, UNCOMPRESSED_FORMAT, 1, 3];
        format.extend(guid);
        format.extend([0; 6]);
        format
    }

    fn camera() -> Vec<u8> {
        let mut all = vec![18, 1];
        all.extend([0; 16]);
        all.extend(interface(0, CONTROL));
        all.extend(unit(3, &REALSENSE_UNIT));
        all.extend(interface(1, STREAMING));
        all.extend(format(&D16_FORMAT));
        all.extend(interface(2, CONTROL));
        all.extend(unit(5, &[9; 16]));
        all
    }

    #[test]
    fn a_unit_is_found_by_its_guid_in_its_own_interface() {
        let all = camera();
        assert_eq!(extension_unit(&all, 0, &REALSENSE_UNIT), Some(3));
        assert_eq!(extension_unit(&all, 2, &REALSENSE_UNIT), None);
        assert_eq!(extension_unit(&all, 2, &[9; 16]), Some(5));
        assert!(streams_format(&all, &D16_FORMAT));
        assert!(!streams_format(&all, &REALSENSE_UNIT));
    }

    #[test]
    fn cut_or_senseless_descriptors_end_the_walk() {
        let all = camera();
        for end in 0..all.len() {
            let cut = &all[..end];
            let found = extension_unit(cut, 0, &REALSENSE_UNIT);
            assert_eq!(found.is_some(), end >= 18 + 9 + 28, "{end}");
            assert_eq!(
                streams_format(cut, &D16_FORMAT),
                end >= 18 + 9 + 28 + 9 + 27,
                "{end}"
            );
        }
        assert_eq!(extension_unit(&[0; 64], 0, &REALSENSE_UNIT), None);
        assert_eq!(extension_unit(&[1; 64], 0, &REALSENSE_UNIT), None);
    }
}
