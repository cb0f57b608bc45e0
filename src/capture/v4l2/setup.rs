//! From options to a running stream: find the node, agree on a format, learn the calibration.

use super::depth_format::{DepthFormat, Rows};
use super::fourcc::FourCc;
use super::negotiation::{self, Mismatch, Plan, Wish};
use super::node::VideoNode;
use super::node_kind::NodeKind;
use super::reconnect::Identity;
use super::ring::Ring;
use super::usb::{self, UsbDevice};
use super::{V4l2Options, realsense, refusal};
use crate::capture::CaptureError;
use crate::capture::devices::{self, DeviceReport};
use crate::frame::{Camera, Intrinsics};
use std::io;
use std::path::{Path, PathBuf};

/// Buffers asked of the driver: one filling, one full. More only age the frames.
const DRIVER_BUFFERS: u32 = 2;
/// Metres per integer when neither user nor camera says.
const USUAL_UNIT_M: f64 = 0.001;
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
    let path = find_node(&options.device)?;
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
    let mut camera = camera(options, &report, usb.as_ref(), &node, &plan)?;
    let (ring, rows, fps) = start(node, &plan, &wish).map_err(|r| r.at(&path))?;
    camera.fps = fps.or(plan.fps);
    Ok(Opened {
        identity: identity(&report),
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
    let stride = negotiation::check_granted(plan, wish, &granted).map_err(Refused::Mismatch)?;
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

/// The node a `--device` names: a path, a number, or `auto` for the first depth camera.
fn find_node(device: &str) -> Result<PathBuf, CaptureError> {
    if !device.is_empty() && device.bytes().all(|b| b.is_ascii_digit()) {
        return Ok(PathBuf::from(format!("/dev/video{device}")));
    }
    if device != "auto" {
        return Ok(PathBuf::from(device));
    }
    let mut others = Vec::new();
    for path in devices::video_nodes() {
        let report = devices::describe(&path);
        if report.depth {
            return Ok(path);
        }
        others.push(match report.kind {
            // The reason names the node already.
            NodeKind::Unreadable => report.reason,
            _ => format!("{}: {}", path.display(), report.reason),
        });
    }
    Err(CaptureError::Device {
        device: "auto".into(),
        what: match others.len() {
            0 => format!("there is no video device{}", d16_note()),
            _ => format!("no depth camera ({}){}", others.join("; "), d16_note()),
        },
        remedy: "plug a depth camera in, or name its node with --device".into(),
    })
}

fn missing_node(path: &Path, error: &io::Error) -> CaptureError {
    match (refusal::device_error(path, "open it", error), d16_note()) {
        (
            CaptureError::Device {
                device,
                what,
                remedy,
            },
            note,
        ) => CaptureError::Device {
            device,
            what: what + &note,
            remedy,
        },
        (other, _) => other,
    }
}

/// Says so when a camera is plugged in whose depth the kernel does not know.
fn d16_note() -> String {
    let cameras = usb::d16_cameras();
    let names: Vec<String> = cameras
        .iter()
        .map(|c| format!("`{}` ({})", c.product, c.id))
        .collect();
    match names.len() {
        0 => String::new(),
        _ => format!(
            " (the USB camera {} is plugged in, but names its depth D16, which this kernel does \
             not know: use the camera's own software, or a newer kernel)",
            names.join(", ")
        ),
    }
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
        true => d16_note(),
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

/// The camera's geometry: what the user gave, else what the camera says of itself.
fn camera(
    options: &V4l2Options,
    report: &DeviceReport,
    usb: Option<&UsbDevice>,
    node: &VideoNode,
    plan: &Plan,
) -> Result<Camera, CaptureError> {
    let size = (plan.width, plan.height);
    let wanted = options.intrinsics.is_none() || options.depth_unit_m.is_none();
    let own = match usb {
        Some(usb) if wanted => realsense::read_calibration(node, usb, size).unwrap_or_default(),
        _ => realsense::Calibration::default(),
    };
    let intrinsics = match options.intrinsics {
        Some(given) => fit_to_size(given, options.intrinsics_size.unwrap_or(size), size)?,
        None => own.intrinsics.ok_or_else(|| {
            CaptureError::Usage(format!(
                "{}: the camera `{}` does not say its intrinsics at {}x{}; give them with \
                 --intrinsics FILE (ROS, OpenCV, Open3D or RealSense) or --intrinsics fx,fy,cx,cy",
                report.path.display(),
                report.card,
                size.0,
                size.1
            ))
        })?,
    };
    Ok(Camera {
        width: plan.width,
        height: plan.height,
        intrinsics,
        depth_unit_m: depth_unit_m(options, own.depth_unit_m, report, plan.format)?,
        invalid: options.invalid.clone(),
        depth_min_m: options.depth_min_m,
        depth_max_m: options.depth_max_m,
        fps: plan.fps,
        name: report.card.clone(),
    })
}

fn depth_unit_m(
    options: &V4l2Options,
    own: Option<f64>,
    report: &DeviceReport,
    format: DepthFormat,
) -> Result<f64, CaptureError> {
    let device = report.path.display();
    let (unit, source) = match (options.depth_unit_m, own) {
        (Some(given), _) => (given, "as given"),
        (None, Some(own)) => (own, "as the camera says"),
        // Packed 10-bit is raw disparity on the Kinect: no unit makes metres of it.
        (None, None) if format == DepthFormat::Y10Packed => {
            return Err(CaptureError::Usage(format!(
                "{device}: {} is raw disparity on most cameras (Kinect), not depth; if this one \
                 sends depth, give its unit with --depth-unit",
                format.fourcc()
            )));
        }
        (None, None) => (USUAL_UNIT_M, "assumed, --depth-unit changes it"),
    };
    tracing::info!("{device}: depth unit {unit} m ({source})");
    Ok(unit)
}

/// Intrinsics given at one size, at another of the same shape.
fn fit_to_size(
    given: Intrinsics,
    from: (u32, u32),
    to: (u32, u32),
) -> Result<Intrinsics, CaptureError> {
    if from == to {
        return Ok(given);
    }
    let shape = |(w, h): (u32, u32)| f64::from(w) / f64::from(h.max(1));
    // Another shape is a crop, which scaling cannot tell.
    if from.0 == 0 || from.1 == 0 || (shape(from) / shape(to) - 1.0).abs() > 0.01 {
        return Err(CaptureError::Usage(format!(
            "the intrinsics are for {}x{}, the camera sends {}x{}, another shape; give those of \
             that size, or ask for the other with --size",
            from.0, from.1, to.0, to.1
        )));
    }
    Ok(given.rescaled(from, to))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::capture::v4l2::negotiation::OfferedFormat;

    fn message(error: &CaptureError) -> String {
        error.to_string()
    }

    fn report(kind: NodeKind, codes: &[&[u8; 4]]) -> DeviceReport {
        let format = |code: &&[u8; 4]| OfferedFormat {
            pixel_format: FourCc(**code),
            description: String::new(),
            sizes: Vec::new(),
            size_range: None,
        };
        DeviceReport {
            path: "/dev/video3".into(),
            driver: "uvcvideo".into(),
            card: "Camera".into(),
            bus: "nowhere".into(),
            usb_id: None,
            serial: None,
            kind,
            depth: kind == NodeKind::Depth,
            reason: "the reason".into(),
            formats: codes.iter().map(format).collect(),
        }
    }

    #[test]
    fn nodes_without_depth_are_refused_with_the_reason() {
        let check = |kind, codes: &[&[u8; 4]], asked| check_kind(&report(kind, codes), asked);
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
            let text = message(&error);
            assert!(
                text.starts_with("/dev/video3: not a depth camera: the reason"),
                "{text}"
            );
        }
    }

    #[test]
    fn intrinsics_follow_the_size_and_not_another_shape() {
        let given = Intrinsics {
            fx: 600.0,
            fy: 600.0,
            cx: 319.5,
            cy: 239.5,
        };
        assert_eq!(fit_to_size(given, (640, 480), (640, 480)).unwrap(), given);
        let half = fit_to_size(given, (640, 480), (320, 240)).unwrap();
        assert_eq!((half.fx, half.cx), (300.0, 159.5));
        for other in [(848, 480), (640, 0), (0, 480)] {
            let error = fit_to_size(given, other, (640, 480)).unwrap_err();
            assert!(message(&error).contains("640x480"), "{other:?}");
        }
    }

    #[test]
    fn the_unit_is_the_users_then_the_cameras_then_a_millimetre() {
        let unit = |given, own, format| {
            let options = V4l2Options {
                depth_unit_m: given,
                ..V4l2Options::default()
            };
            depth_unit_m(&options, own, &report(NodeKind::Depth, &[]), format)
        };
        assert_eq!(unit(Some(0.5), Some(0.1), DepthFormat::Z16).unwrap(), 0.5);
        assert_eq!(unit(None, Some(0.1), DepthFormat::Z16).unwrap(), 0.1);
        assert_eq!(unit(None, None, DepthFormat::Y12).unwrap(), 0.001);
        let error = unit(None, None, DepthFormat::Y10Packed).unwrap_err();
        assert!(message(&error).contains("--depth-unit"));
        assert_eq!(unit(Some(0.5), None, DepthFormat::Y10Packed).unwrap(), 0.5);
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
    fn a_number_is_a_node() {
        assert_eq!(find_node("3").unwrap(), Path::new("/dev/video3"));
        assert_eq!(find_node("/dev/depth").unwrap(), Path::new("/dev/depth"));
    }
}
