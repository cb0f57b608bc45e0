//! Which colour images to ask a camera for, and the `nokhwa` camera that gives them.

use super::CaptureError;
use super::devices::{self, DeviceReport};
use super::v4l2::fourcc::FourCc;
use super::v4l2::negotiation::plan_size_and_rate;
use super::v4l2::node::VideoNode;
use super::v4l2::node_kind::NodeKind;
use super::v4l2::refusal;
use nokhwa::Camera;
use nokhwa::utils::{
    CameraFormat, CameraIndex, FrameFormat, RequestedFormat, RequestedFormatType, Resolution,
};
use std::path::Path;

/// What to ask the camera for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct ColorPlan {
    pub format: FrameFormat,
    pub size: (u32, u32),
    pub fps: u32,
}

pub(super) fn refuse(path: &Path, what: String, remedy: String) -> CaptureError {
    CaptureError::Device {
        device: path.display().to_string(),
        what,
        remedy,
    }
}

/// Chooses format, size and rate of a node; on refusal, what is wrong and what to do.
pub(super) fn plan(
    report: &DeviceReport,
    size: Option<(u32, u32)>,
    fps: Option<u32>,
) -> Result<ColorPlan, (String, String)> {
    const REMEDY: &str = "`saint-live devices` lists the colour cameras and what they offer";
    if report.kind == NodeKind::Unreadable {
        return Err((report.reason.clone(), REMEDY.into()));
    }
    let wanted = [
        (FourCc(*b"MJPG"), FrameFormat::MJPEG),
        (FourCc(*b"YUYV"), FrameFormat::YUYV),
    ];
    let offer = wanted.into_iter().find_map(|(code, format)| {
        let offer = report.formats.iter().find(|f| f.pixel_format == code)?;
        Some((offer, format))
    });
    let Some((offer, format)) = offer else {
        let what = format!("no colour in MJPG or YUYV: {}", report.reason);
        return Err((what, REMEDY.into()));
    };
    // nokhwa knows whole frame rates alone.
    let mut whole = offer.clone();
    for listed in &mut whole.sizes {
        listed
            .fps
            .retain(|rate| rate.fract() == 0.0 && *rate >= 1.0);
    }
    let (size, usual) =
        plan_size_and_rate(size, None, &whole).map_err(|m| (m.what, REMEDY.to_string()))?;
    // The rate asked for is depth's. Colour has rates of its own: the nearest one, of two the higher.
    let listed = whole.sizes.iter().find(|s| (s.width, s.height) == size);
    let rates = listed.map_or(&[][..], |s| &s.fps);
    let fps = match fps.map(f64::from) {
        Some(asked) => {
            let off = |rate: &f64| ((rate - asked).abs(), -rate);
            let nearer = |a: &&f64, b: &&f64| {
                let (a, b) = (off(a), off(b));
                a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1))
            };
            Some(rates.iter().min_by(nearer).copied().unwrap_or(asked))
        }
        None => usual,
    };
    Ok(ColorPlan {
        format,
        size,
        fps: fps.map_or(30, |f| f as u32),
    })
}

/// Puts the node into the format planned: nokhwa cannot open one left in a format it does not
/// know, and does not tell when the driver gives another.
pub(super) fn prepare(path: &Path, plan: &ColorPlan) -> Result<(), CaptureError> {
    let system = |doing, error| refusal::device_error(path, doing, &error);
    let node = VideoNode::open(path).map_err(|e| system("open it", e))?;
    let code = match plan.format {
        FrameFormat::MJPEG => FourCc(*b"MJPG"),
        _ => FourCc(*b"YUYV"),
    };
    let got = node
        .set_format(code, plan.size.0, plan.size.1)
        .map_err(|e| system("set the colour format", e))?;
    let padded = code == FourCc(*b"YUYV") && got.stride > plan.size.0 * 2;
    if (got.format, got.width, got.height) != (code, plan.size.0, plan.size.1) || padded {
        let what = format!(
            "asked for {code} {}x{}, the driver gave {} {}x{} with {} bytes a row",
            plan.size.0, plan.size.1, got.format, got.width, got.height, got.stride
        );
        return Err(refuse(path, what, "choose another size for colour".into()));
    }
    Ok(())
}

pub(super) fn open_camera(path: &Path, plan: &ColorPlan) -> Result<Camera, CaptureError> {
    let remedy = || "close other programs that use it; `saint-live devices` lists all".to_string();
    let number = path
        .file_name()
        .and_then(|name| devices::node_number(&name.to_string_lossy()));
    let Some(number) = number else {
        let remedy = "name the colour camera by its /dev/videoN".into();
        return Err(refuse(path, "not a video node".into(), remedy));
    };
    let resolution = Resolution::new(plan.size.0, plan.size.1);
    let format = CameraFormat::new(resolution, plan.format, plan.fps);
    let formats = [plan.format];
    let request = RequestedFormat::with_formats(RequestedFormatType::Exact(format), &formats);
    let opened = Camera::new(CameraIndex::Index(number), request).and_then(|mut camera| {
        camera.open_stream()?;
        Ok(camera)
    });
    opened.map_err(|error| refuse(path, format!("could not open colour: {error}"), remedy()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::capture::v4l2::offer::{FrameSize, OfferedFormat};

    fn camera(kind: NodeKind, codes: &[&[u8; 4]]) -> DeviceReport {
        let format = |code: &&[u8; 4]| OfferedFormat {
            pixel_format: FourCc(**code),
            description: String::new(),
            sizes: vec![FrameSize {
                width: 640,
                height: 480,
                fps: vec![30.0, 29.97, 15.0],
            }],
            size_range: None,
        };
        DeviceReport {
            path: "/dev/video2".into(),
            driver: "uvcvideo".into(),
            card: "Webcam".into(),
            bus: String::new(),
            usb_id: None,
            serial: None,
            kind,
            depth: false,
            reason: "the reason".into(),
            busy: None,
            held_by: Vec::new(),
            formats: codes.iter().map(format).collect(),
        }
    }

    #[test]
    fn mjpg_is_preferred_and_rates_are_whole() {
        let webcam = camera(NodeKind::Color, &[b"YUYV", b"MJPG"]);
        let want = ColorPlan {
            format: FrameFormat::MJPEG,
            size: (640, 480),
            fps: 30,
        };
        assert_eq!(plan(&webcam, None, None), Ok(want));
        let raw = camera(NodeKind::Color, &[b"YUYV"]);
        assert_eq!(
            plan(&raw, None, Some(15)).unwrap().format,
            FrameFormat::YUYV
        );
        for (asked, nearest) in [(60, 30), (6, 15), (22, 15), (23, 30)] {
            assert_eq!(plan(&raw, None, Some(asked)).unwrap().fps, nearest);
        }
        assert!(
            plan(&raw, Some((1, 1)), None)
                .unwrap_err()
                .0
                .contains("640x480")
        );
    }

    #[test]
    fn a_node_without_colour_is_refused_with_what_it_is() {
        let depth = camera(NodeKind::Depth, &[b"Z16 "]);
        assert!(
            plan(&depth, None, None)
                .unwrap_err()
                .0
                .contains("the reason")
        );
    }
}
