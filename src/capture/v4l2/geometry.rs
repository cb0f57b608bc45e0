//! A camera's unit and intrinsics: what the user gave, else what the camera says of itself.

use super::V4l2Options;
use super::depth_format::DepthFormat;
use super::negotiation::Plan;
use super::node::VideoNode;
use super::realsense;
use super::usb::UsbDevice;
use crate::capture::CaptureError;
use crate::capture::devices::DeviceReport;
use crate::frame::{Camera, Intrinsics};

/// Metres per integer when neither user nor camera says.
const USUAL_UNIT_M: f64 = 0.001;

/// Where a camera's geometry comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Origin {
    pub intrinsics: &'static str,
    pub depth_unit: &'static str,
}

const GIVEN: &str = "given by the user";
const TOLD: &str = "told by the camera";
const ASSUMED: &str = "assumed";

/// The camera's geometry: what the user gave, else what the camera says of itself.
pub(super) fn camera(
    options: &V4l2Options,
    report: &DeviceReport,
    usb: Option<&UsbDevice>,
    node: &VideoNode,
    plan: &Plan,
) -> Result<(Camera, Origin), CaptureError> {
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
    let (depth_unit_m, depth_unit) = depth_unit_m(options, own.depth_unit_m, report, plan.format)?;
    let origin = Origin {
        intrinsics: options.intrinsics.map_or(TOLD, |_| GIVEN),
        depth_unit,
    };
    let camera = Camera {
        width: plan.width,
        height: plan.height,
        intrinsics,
        depth_unit_m,
        invalid: options.invalid.clone(),
        depth_min_m: options.depth_min_m,
        depth_max_m: options.depth_max_m,
        fps: plan.fps,
        name: report.card.clone(),
    };
    Ok((camera, origin))
}

fn depth_unit_m(
    options: &V4l2Options,
    own: Option<f64>,
    report: &DeviceReport,
    format: DepthFormat,
) -> Result<(f64, &'static str), CaptureError> {
    let device = report.path.display();
    let unit = match (options.depth_unit_m, own) {
        (Some(given), _) => (given, GIVEN),
        (None, Some(own)) => (own, TOLD),
        // Packed 10-bit is raw disparity on the Kinect: no unit makes metres of it.
        (None, None) if format == DepthFormat::Y10Packed => {
            return Err(CaptureError::Usage(format!(
                "{device}: {} is raw disparity on most cameras (Kinect), not depth; if this one \
                 sends depth, give its unit with --depth-unit",
                format.fourcc()
            )));
        }
        (None, None) => (USUAL_UNIT_M, ASSUMED),
    };
    if unit.1 == ASSUMED {
        tracing::warn!(
            "{device}: the camera does not say its depth unit: {} mm is assumed, --depth-unit \
             changes it",
            unit.0 * 1e3
        );
    }
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
    use crate::capture::v4l2::node_kind::NodeKind;

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
            assert!(error.to_string().contains("640x480"), "{other:?}");
        }
    }

    #[test]
    fn the_unit_is_the_users_then_the_cameras_then_a_millimetre() {
        let unit = |given, own, format| {
            let options = V4l2Options {
                depth_unit_m: given,
                ..V4l2Options::default()
            };
            depth_unit_m(
                &options,
                own,
                &DeviceReport::sample(NodeKind::Depth, &[]),
                format,
            )
        };
        let z16 = DepthFormat::Z16;
        assert_eq!(unit(Some(0.5), Some(0.1), z16).unwrap(), (0.5, GIVEN));
        assert_eq!(unit(None, Some(0.1), z16).unwrap(), (0.1, TOLD));
        assert_eq!(
            unit(None, None, DepthFormat::Y12).unwrap(),
            (0.001, ASSUMED)
        );
        let error = unit(None, None, DepthFormat::Y10Packed).unwrap_err();
        assert!(error.to_string().contains("--depth-unit"));
        let packed = unit(Some(0.5), None, DepthFormat::Y10Packed);
        assert_eq!(packed.unwrap(), (0.5, GIVEN));
    }
}
