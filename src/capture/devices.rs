//! The cameras this machine has: every `/dev/video*`, what it offers, and which one is depth.

pub(super) mod access;
pub mod naming;

use super::v4l2::depth_format::DepthFormat;
use super::v4l2::fourcc::FourCc;
use super::v4l2::node::{Capability, VideoNode};
use super::v4l2::node_kind::{NodeKind, classify};
use super::v4l2::offer::OfferedFormat;
use super::v4l2::refusal;
use super::v4l2::usb::{self, UsbDevice};
use serde::Serialize;
use std::fs;
use std::path::{Path, PathBuf};

/// One video node as the system describes it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct DeviceReport {
    /// `/dev/videoN`.
    pub path: PathBuf,
    /// Kernel driver; empty for a node that could not be asked.
    pub driver: String,
    /// What the camera calls itself.
    pub card: String,
    /// Where it is plugged in.
    pub bus: String,
    /// USB `vendor:product`, hexadecimal.
    pub usb_id: Option<String>,
    /// Serial number, where USB gives one.
    pub serial: Option<String>,
    /// What it carries.
    pub kind: NodeKind,
    /// True for the nodes `--device` takes without further options.
    pub depth: bool,
    /// Why it is of this kind, or why it could not be asked.
    pub reason: String,
    /// True while a program streams from it; `None` where that is not known.
    pub busy: Option<bool>,
    /// Other programs that have it open, as far as this user may see: `name (pid 123)`.
    pub held_by: Vec<String>,
    /// What it offers.
    pub formats: Vec<OfferedFormat>,
}

#[cfg(test)]
impl DeviceReport {
    /// A node for tests, of this kind and with these formats.
    pub(super) fn sample(kind: NodeKind, codes: &[&[u8; 4]]) -> Self {
        let format = |code: &&[u8; 4]| OfferedFormat {
            pixel_format: FourCc(**code),
            description: String::new(),
            sizes: Vec::new(),
            size_range: None,
        };
        Self {
            path: "/dev/video3".into(),
            driver: "uvcvideo".into(),
            card: "Camera".into(),
            bus: "nowhere".into(),
            usb_id: None,
            serial: None,
            kind,
            depth: kind == NodeKind::Depth,
            reason: "the reason".into(),
            busy: None,
            held_by: Vec::new(),
            formats: codes.iter().map(format).collect(),
        }
    }
}

/// A camera that is plugged in and has no node to read depth from.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct NodelessCamera {
    /// USB `vendor:product`, hexadecimal.
    pub usb_id: String,
    /// Product name.
    pub product: String,
    /// Why.
    pub reason: String,
}

/// Everything found.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct DeviceList {
    /// Nodes by number.
    pub devices: Vec<DeviceReport>,
    /// Depth cameras the kernel gives no depth node.
    pub without_node: Vec<NodelessCamera>,
}

/// Asks every `/dev/video*` what it is. Configures nothing and disturbs no running stream.
#[must_use]
pub fn list_devices() -> DeviceList {
    DeviceList {
        devices: describe_all()
            .into_iter()
            .map(|report| DeviceReport {
                busy: is_busy(&report),
                held_by: access::holders(&report.path),
                ..report
            })
            .collect(),
        without_node: usb::d16_cameras().iter().map(nodeless).collect(),
    }
}

/// What every node is, by number. Leaves `busy` and `held_by` open.
#[must_use]
pub fn describe_all() -> Vec<DeviceReport> {
    video_nodes().iter().map(|path| describe(path)).collect()
}

/// Whether a program streams from a node with images.
fn is_busy(report: &DeviceReport) -> Option<bool> {
    if report.formats.is_empty() {
        return None;
    }
    VideoNode::open(&report.path).ok()?.is_busy()
}

/// All `/dev/video*`, by number.
pub(super) fn video_nodes() -> Vec<PathBuf> {
    let entries = fs::read_dir("/dev").into_iter().flatten().flatten();
    let mut nodes: Vec<(u32, PathBuf)> = entries
        .filter_map(|e| Some((node_number(&e.file_name().to_string_lossy())?, e.path())))
        .collect();
    nodes.sort();
    nodes.into_iter().map(|(_, path)| path).collect()
}

pub(super) fn node_number(name: &str) -> Option<u32> {
    let number = name.strip_prefix("video")?;
    number
        .bytes()
        .all(|b| b.is_ascii_digit())
        .then(|| number.parse().ok())?
}

/// What one node is.
#[must_use]
pub fn describe(path: &Path) -> DeviceReport {
    let usb = usb::behind(path);
    let asked = VideoNode::open(path)
        .map_err(|error| refusal::device_error(path, "open it", &error))
        .and_then(|node| {
            let capability = node.capability();
            let capability =
                capability.map_err(|error| refusal::device_error(path, "ask it", &error))?;
            Ok((capability, node.formats()))
        });
    match asked {
        Ok((capability, formats)) => report(path, capability, formats, usb),
        Err(error) => DeviceReport {
            path: path.into(),
            driver: String::new(),
            card: sysfs_name(path),
            bus: String::new(),
            usb_id: usb.as_ref().map(|u| u.id.clone()),
            serial: usb.and_then(|u| u.serial),
            kind: NodeKind::Unreadable,
            depth: false,
            reason: error.to_string(),
            busy: None,
            held_by: Vec::new(),
            formats: Vec::new(),
        },
    }
}

pub(super) fn report(
    path: &Path,
    capability: Capability,
    formats: Vec<OfferedFormat>,
    usb: Option<UsbDevice>,
) -> DeviceReport {
    let codes: Vec<FourCc> = formats.iter().map(|f| f.pixel_format).collect();
    let (kind, reason) = classify(capability.flags, &codes);
    DeviceReport {
        path: path.into(),
        driver: capability.driver,
        card: capability.card,
        bus: capability.bus,
        usb_id: usb.as_ref().map(|u| u.id.clone()),
        serial: usb.and_then(|u| u.serial),
        kind,
        depth: kind == NodeKind::Depth,
        reason,
        busy: None,
        held_by: Vec::new(),
        formats,
    }
}

/// The name the kernel gives a node we may not open.
fn sysfs_name(path: &Path) -> String {
    let Some(node) = path.file_name() else {
        return String::new();
    };
    let name = Path::new("/sys/class/video4linux").join(node).join("name");
    let name = fs::read(name).unwrap_or_default();
    String::from_utf8_lossy(&name).trim().to_string()
}

fn nodeless(camera: &UsbDevice) -> NodelessCamera {
    NodelessCamera {
        usb_id: camera.id.clone(),
        product: camera.product.clone(),
        reason: format!(
            "it names its depth D16, which this kernel does not know as {}: no node shows it",
            DepthFormat::Z16.fourcc()
        ),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_video_nodes_have_a_number() {
        assert_eq!(node_number("video0"), Some(0));
        assert_eq!(node_number("video12"), Some(12));
        for other in [
            "video",
            "videos",
            "video1a",
            "v4l-subdev0",
            "video99999999999",
        ] {
            assert_eq!(node_number(other), None, "{other}");
        }
    }

    #[test]
    fn a_node_that_cannot_be_asked_is_listed_with_the_reason() {
        let missing = describe(Path::new("/nonexistent/video7"));
        assert_eq!(missing.kind, NodeKind::Unreadable);
        assert!(
            missing.reason.contains("no such device"),
            "{}",
            missing.reason
        );
        let null = describe(Path::new("/dev/null"));
        assert!(null.reason.contains("not a V4L2"), "{}", null.reason);
        assert!(!null.depth);
    }

    #[test]
    fn a_report_says_depth_for_z16_and_serializes_its_code_as_a_name() {
        let capability = Capability {
            driver: "uvcvideo".into(),
            card: "Depth".into(),
            bus: "usb-1".into(),
            flags: 0x0400_0001,
        };
        let format = OfferedFormat {
            pixel_format: DepthFormat::Z16.fourcc(),
            description: "16-bit depth".into(),
            sizes: Vec::new(),
            size_range: None,
        };
        let report = report(Path::new("/dev/video0"), capability, vec![format], None);
        assert!(report.depth);
        let json = serde_json::to_value(&report).unwrap();
        assert_eq!(json["kind"], "depth");
        assert_eq!(json["formats"][0]["pixel_format"], "Z16");
    }
}
