//! From options to a running stream: find the node, agree on a format, start.

use super::depth_format::{DepthFormat, Rows};
use super::fourcc::FourCc;
use super::negotiation::{self, Mismatch, Plan, Wish};
use super::node::VideoNode;
use super::node_kind::NodeKind;
use super::reconnect::Identity;
use super::ring::Ring;
use super::usb;
use super::{V4l2Options, geometry, grant, refusal};
use crate::capture::CaptureError;
use crate::capture::devices::naming::DeviceName;
use crate::capture::devices::{self, DeviceReport};
use crate::frame::Camera;
use std::io;
use std::path::{Path, PathBuf};

/// Buffers asked of the driver. The thread that drains it hands over the newest frame, so more
/// buffers do not age frames; they bridge the time it may have to wait for a processor.
const DRIVER_BUFFERS: u32 = 6;
/// The driver whose frame numbers begin at 0 with each stream, lost frames counted.
const FROM_ZERO: &str = "uvcvideo";
/// Pixels per row and rows a frame may have at most.
const MAX_SIDE: u32 = 16_384;

/// A camera agreed with and streaming.
pub(super) struct Opened {
    pub path: PathBuf,
    pub ring: Ring,
    pub rows: Rows,
    pub plan: Plan,
    pub wish: Wish,
    pub camera: Camera,
    pub identity: Identity,
    /// The driver numbers the first frame of each stream 0.
    pub from_zero: bool,
    /// Where the camera is and what was taken for its geometry.
    pub notes: Vec<(&'static str, String)>,
}

/// Why a stream did not start.
#[derive(Debug)]
pub(super) enum Refused {
    System {
        doing: &'static str,
        error: io::Error,
    },
    Mismatch(Mismatch),
}

impl Refused {
    pub fn at(&self, path: &Path) -> CaptureError {
        match self {
            Self::System { doing, error } => refusal::device_error(path, doing, error),
            Self::Mismatch(mismatch) => disagreement(path, mismatch),
        }
    }
}

fn refused(doing: &'static str) -> impl Fn(io::Error) -> Refused {
    move |error| Refused::System { doing, error }
}

fn disagreement(path: &Path, mismatch: &Mismatch) -> CaptureError {
    CaptureError::Device {
        device: path.display().to_string(),
        what: mismatch.what.clone(),
        remedy: mismatch.remedy.clone(),
    }
}

/// Opens the camera the options name and starts its stream.
pub(super) fn open(options: &V4l2Options) -> Result<Opened, CaptureError> {
    let wish = read_wish(options)?;
    let path = find_node(&options.device, wish.format)?;
    let system = |doing, error: io::Error| match error.raw_os_error() {
        Some(libc::ENOENT) => missing_node(&path, &error),
        _ => refusal::device_error(&path, doing, &error),
    };
    let node = VideoNode::open(&path).map_err(|e| system("open it", e))?;
    let capability = node.capability().map_err(|e| system("ask it", e))?;
    let formats = node.formats();
    let usb = usb::behind(&path);
    let report = devices::report(&path, capability, formats, usb.clone());
    check_kind(&report, wish.format)?;
    let plan = negotiation::plan(&wish, &report.formats).map_err(|m| disagreement(&path, &m))?;
    check_side(&path, &plan)?;
    let (mut camera, origin) = geometry::camera(options, &report, usb.as_ref(), &node, &plan)?;
    let (ring, rows, fps) = start(node, &plan, &wish).map_err(|r| r.at(&path))?;
    camera.fps = fps.or(plan.fps);
    let serial = report.serial.as_ref();
    let clock = "CLOCK_MONOTONIC of the capturing machine, start of exposure where the driver says";
    let notes = [
        ("device", path.display().to_string()),
        ("driver", report.driver.clone()),
        ("bus", report.bus.clone()),
        ("serial", serial.cloned().unwrap_or_default()),
        ("pixel_format", plan.format.fourcc().to_string()),
        ("intrinsics_from", origin.intrinsics.to_owned()),
        ("depth_unit_from", origin.depth_unit.to_owned()),
        ("clock", clock.to_owned()),
    ];
    Ok(Opened {
        identity: identity(&report),
        from_zero: report.driver == FROM_ZERO,
        notes: (notes.into_iter())
            .filter(|(_, value)| !value.is_empty())
            .collect(),
        path,
        ring,
        rows,
        plan,
        wish,
        camera,
    })
}

pub(super) fn identity(report: &DeviceReport) -> Identity {
    Identity {
        card: report.card.clone(),
        bus: report.bus.clone(),
        serial: report.serial.clone(),
    }
}

/// Sets format and rate, compares what was granted, and starts the stream.
pub(super) fn start(
    node: VideoNode,
    plan: &Plan,
    wish: &Wish,
) -> Result<(Ring, Rows, Option<f64>), Refused> {
    let mut granted = node
        .set_format(plan.format.fourcc(), plan.width, plan.height)
        .map_err(refused("set the format"))?;
    if let Some(fps) = plan.fps {
        granted.fps = match node.set_rate(fps) {
            Ok(fps) => fps,
            // A driver without a say in its rate streams all the same.
            Err(_) if wish.fps.is_none() => None,
            Err(error) => return Err(refused("set the frame rate")(error)),
        };
    }
    let stride = grant::check_granted(plan, wish, &granted).map_err(Refused::Mismatch)?;
    let rows = Rows {
        width: plan.width as usize,
        height: plan.height as usize,
        stride: stride as usize,
    };
    let ring = Ring::start(node, DRIVER_BUFFERS).map_err(refused("start the stream"))?;
    Ok((ring, rows, granted.fps))
}

fn read_wish(options: &V4l2Options) -> Result<Wish, CaptureError> {
    let format = match &options.pixel_format {
        None => None,
        Some(name) => Some(read_format(name)?),
    };
    if options.fps == Some(0) {
        return Err(CaptureError::Usage("--fps must be at least 1".into()));
    }
    if let Some(unit) = options.depth_unit_m
        && !(unit.is_finite() && unit > 0.0)
    {
        let text = format!("--depth-unit must be a positive number of metres, not {unit}");
        return Err(CaptureError::Usage(text));
    }
    Ok(Wish {
        format,
        size: options.size,
        fps: options.fps,
    })
}

fn read_format(name: &str) -> Result<DepthFormat, CaptureError> {
    FourCc::parse(name)
        .and_then(DepthFormat::from_fourcc)
        .ok_or_else(|| {
            let known: Vec<String> = DepthFormat::ALL
                .iter()
                .map(|f| f.fourcc().to_string())
                .collect();
            CaptureError::Usage(format!(
                "--pixel-format {name} cannot carry depth; choose one of {}",
                known.join(", ")
            ))
        })
}

/// The node a `--device` names, at which depth is (or the format asked for).
fn find_node(device: &str, asked: Option<DepthFormat>) -> Result<PathBuf, CaptureError> {
    let name = DeviceName::parse(device);
    if let DeviceName::Path(path) = name {
        return Ok(path);
    }
    let present = devices::describe_all();
    let will_do = |report: &DeviceReport| match asked {
        None => report.depth,
        Some(format) => (report.formats.iter()).any(|f| f.pixel_format == format.fourcc()),
    };
    name.choose(&present, will_do, "depth").map_err(|none| {
        let (note, remedy) = d16_note().unzip();
        CaptureError::Device {
            device: device.into(),
            what: none + &note.unwrap_or_default(),
            remedy: remedy
                .unwrap_or("plug a depth camera in, or choose one that `saint-live devices` lists")
                .into(),
        }
    })
}

/// A node that does not exist, perhaps because the kernel does not know the camera's format.
fn missing_node(path: &Path, error: &io::Error) -> CaptureError {
    match d16_note() {
        None => refusal::device_error(path, "open it", error),
        Some((note, remedy)) => CaptureError::Device {
            device: path.display().to_string(),
            what: format!("could not open it: there is no such device{note}"),
            remedy: remedy.into(),
        },
    }
}

/// Says so when a camera is plugged in whose depth the kernel does not know, and what to do.
fn d16_note() -> Option<(String, &'static str)> {
    let cameras = usb::d16_cameras();
    let names: Vec<String> = cameras
        .iter()
        .map(|c| format!("`{}` ({})", c.product, c.id))
        .collect();
    (!names.is_empty()).then(|| {
        let note = format!(
            " (the USB camera {} is plugged in, but names its depth D16, which this kernel does \
             not know)",
            names.join(", ")
        );
        (note, "use the camera's own software, or a newer kernel")
    })
}

/// Refuses a node that is not depth, and names its camera's depth node where there is one.
fn check_kind(report: &DeviceReport, asked: Option<DepthFormat>) -> Result<(), CaptureError> {
    let offers_asked = asked.is_some_and(|format| {
        report
            .formats
            .iter()
            .any(|f| f.pixel_format == format.fourcc())
    });
    let without_images = matches!(report.kind, NodeKind::Metadata | NodeKind::Other);
    let no_hint = matches!(report.kind, NodeKind::Color | NodeKind::Infrared);
    if !without_images && (offers_asked || !no_hint) {
        return Ok(());
    }
    let sibling = devices::video_nodes().into_iter().find(|path| {
        let other = devices::describe(path);
        other.depth && other.bus == report.bus && other.path != report.path
    });
    let note = match report.formats.is_empty() && report.kind == NodeKind::Other {
        true => d16_note().map(|(note, _)| note).unwrap_or_default(),
        false => String::new(),
    };
    Err(CaptureError::Device {
        device: report.path.display().to_string(),
        what: format!("not a depth camera: {}{note}", report.reason),
        remedy: match sibling {
            Some(path) => format!("its depth is at {}", path.display()),
            None => "`saint-live devices` shows which node is depth".into(),
        },
    })
}

fn check_side(path: &Path, plan: &Plan) -> Result<(), CaptureError> {
    let sides = 1..=MAX_SIDE;
    if sides.contains(&plan.width) && sides.contains(&plan.height) {
        return Ok(());
    }
    let mismatch = Mismatch {
        what: format!("frames of {}x{} pixels", plan.width, plan.height),
        remedy: format!("choose a --size of 1 to {MAX_SIDE} pixels a side"),
    };
    Err(disagreement(path, &mismatch))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nodes_without_depth_are_refused_with_the_reason() {
        let check =
            |kind, codes: &[&[u8; 4]], asked| check_kind(&DeviceReport::sample(kind, codes), asked);
        assert!(check(NodeKind::Depth, &[b"Z16 "], None).is_ok());
        assert!(
            check(NodeKind::Grey, &[b"Y16 "], None).is_ok(),
            "left to the format's plan"
        );
        assert!(check(NodeKind::Color, &[b"YUYV", b"Y16 "], Some(DepthFormat::Y16)).is_ok());
        for (kind, asked) in [
            (NodeKind::Metadata, None),
            (NodeKind::Color, None),
            (NodeKind::Color, Some(DepthFormat::Y16)),
            (NodeKind::Infrared, None),
            (NodeKind::Other, Some(DepthFormat::Z16)),
        ] {
            let error = check(kind, &[b"YUYV"], asked).unwrap_err();
            let text = error.to_string();
            assert!(
                text.starts_with("/dev/video3: not a depth camera: the reason"),
                "{text}"
            );
        }
    }

    #[test]
    fn wishes_that_cannot_be_are_usage_errors() {
        let wish = |edit: fn(&mut V4l2Options)| {
            let mut options = V4l2Options::default();
            edit(&mut options);
            read_wish(&options)
        };
        assert!(wish(|_| {}).is_ok());
        let y12 = wish(|o| o.pixel_format = Some("y12".into())).unwrap();
        assert_eq!(y12.format, Some(DepthFormat::Y12));
        for edit in [
            (|o| o.pixel_format = Some("YUYV".into())) as fn(&mut V4l2Options),
            |o| o.pixel_format = Some("Z16 depth".into()),
            |o| o.fps = Some(0),
            |o| o.depth_unit_m = Some(0.0),
            |o| o.depth_unit_m = Some(f64::NAN),
        ] {
            assert!(matches!(wish(edit), Err(CaptureError::Usage(_))));
        }
    }

    #[test]
    fn a_number_is_a_node_and_a_name_that_nobody_has_is_refused() {
        let find = |device| find_node(device, None);
        assert_eq!(find("3").unwrap(), Path::new("/dev/video3"));
        assert_eq!(find("/dev/depth").unwrap(), Path::new("/dev/depth"));
        let error = find("no-such-serial-number").unwrap_err().to_string();
        assert!(error.starts_with("no-such-serial-number: "), "{error}");
    }
}
