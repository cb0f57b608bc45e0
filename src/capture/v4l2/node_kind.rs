//! What a video node is for: depth, colour, infrared, metadata. Pure.

use super::depth_format::DepthFormat;
use super::fourcc::FourCc;
use serde::Serialize;
use v4l::v4l_sys as sys;

/// What a `/dev/videoN` carries.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum NodeKind {
    /// Depth by name (Z16).
    Depth,
    /// Integers of 10 to 16 bits: infrared, or depth that does not say so.
    Grey,
    /// Colour images.
    Color,
    /// Infrared images of 8 bits or packed pairs.
    Infrared,
    /// Frame headers beside the images of another node.
    Metadata,
    /// Something else.
    Other,
    /// It could not be opened or asked.
    Unreadable,
}

/// Infrared formats that are not depth: two packed images, or 8 bits.
const INFRARED: [[u8; 4]; 6] = [*b"GREY", *b"Y8I ", *b"Y12I", *b"Y16I", *b"INZI", *b"Y8  "];

/// Names a node by its capabilities (`V4L2_CAP_*`) and formats; the text says why.
#[must_use]
pub fn classify(flags: u32, formats: &[FourCc]) -> (NodeKind, String) {
    if flags & sys::V4L2_CAP_META_CAPTURE != 0 {
        let why = "metadata node: headers of another node's frames, no images".into();
        return (NodeKind::Metadata, why);
    }
    if flags & sys::V4L2_CAP_VIDEO_CAPTURE == 0 {
        let why = match flags & sys::V4L2_CAP_VIDEO_CAPTURE_MPLANE {
            0 => "not a capture node (output, codec or radio)".into(),
            _ => "multi-planar capture node (a processor's camera port), not a depth camera".into(),
        };
        return (NodeKind::Other, why);
    }
    if flags & sys::V4L2_CAP_STREAMING == 0 {
        return (
            NodeKind::Other,
            "the driver cannot stream mapped buffers".into(),
        );
    }
    let names = || {
        let names: Vec<String> = formats.iter().map(FourCc::to_string).collect();
        names.join(", ")
    };
    if formats.is_empty() {
        let why = "no image format the kernel knows (a camera that names its depth D16 alone \
                   ends so)";
        (NodeKind::Other, why.into())
    } else if formats.contains(&DepthFormat::Z16.fourcc()) {
        (NodeKind::Depth, "depth (Z16)".into())
    } else if formats
        .iter()
        .all(|f| DepthFormat::from_fourcc(*f).is_some() || INFRARED.contains(&f.0))
    {
        match formats
            .iter()
            .find(|f| DepthFormat::from_fourcc(**f).is_some())
        {
            Some(grey) => {
                let why = format!(
                    "{}: infrared, or depth that does not say so (then use --pixel-format {grey})",
                    names()
                );
                (NodeKind::Grey, why)
            }
            None => (NodeKind::Infrared, format!("infrared camera ({})", names())),
        }
    } else {
        (NodeKind::Color, format!("colour camera ({})", names()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CAMERA: u32 = sys::V4L2_CAP_VIDEO_CAPTURE | sys::V4L2_CAP_STREAMING;

    fn kind(flags: u32, formats: &[&[u8; 4]]) -> NodeKind {
        let formats: Vec<FourCc> = formats.iter().map(|f| FourCc(**f)).collect();
        let (kind, why) = classify(flags, &formats);
        assert!(!why.is_empty());
        kind
    }

    #[test]
    fn nodes_are_named_by_what_they_carry() {
        assert_eq!(kind(CAMERA, &[b"Z16 "]), NodeKind::Depth);
        assert_eq!(kind(CAMERA, &[b"GREY", b"Z16 "]), NodeKind::Depth);
        assert_eq!(kind(CAMERA, &[b"YUYV", b"MJPG"]), NodeKind::Color);
        assert_eq!(kind(CAMERA, &[b"GREY", b"Y8I "]), NodeKind::Infrared);
        assert_eq!(kind(CAMERA, &[b"GREY", b"Y16 "]), NodeKind::Grey);
        assert_eq!(kind(CAMERA, &[]), NodeKind::Other);
        let meta = sys::V4L2_CAP_META_CAPTURE | sys::V4L2_CAP_STREAMING;
        assert_eq!(kind(meta, &[]), NodeKind::Metadata);
        assert_eq!(
            kind(sys::V4L2_CAP_VIDEO_CAPTURE, &[b"Z16 "]),
            NodeKind::Other
        );
        assert_eq!(kind(sys::V4L2_CAP_STREAMING, &[]), NodeKind::Other);
    }

    #[test]
    fn a_webcam_with_a_grey_mode_stays_a_colour_camera() {
        assert_eq!(kind(CAMERA, &[b"YUYV", b"GREY", b"Y16 "]), NodeKind::Color);
    }
}
