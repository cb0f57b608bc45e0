//! The messages of a raw capture, as ROS 2 has them in CDR.

use super::super::color;
use crate::capture::containers::rvl;
use crate::frame::{Camera, FrameTime};

const FORMAT: &str = "16UC1; compressedDepth rvl";
const FRAME_ID: &str = "depth";
pub(super) const INFO_SCHEMA: &str = "sensor_msgs/msg/CameraInfo";
/// The message definition, with those it refers to, as ros2msg has it.
pub(super) const INFO_DEFINITION: &str = concat!(
    "\
std_msgs/Header header
uint32 height
uint32 width
string distortion_model
float64[] d
float64[9] k
float64[9] r
float64[12] p
uint32 binning_x
uint32 binning_y
sensor_msgs/RegionOfInterest roi
================================================================================
MSG: sensor_msgs/RegionOfInterest
uint32 x_offset
uint32 y_offset
uint32 height
uint32 width
bool do_rectify
",
    color::header_definition!()
);
/// Where the stamp lies in a message.
const STAMP: std::ops::Range<usize> = 4..12;

/// Puts the time into a message, ns.
pub(super) fn stamp(message: &mut [u8], log_time: u64) {
    let seconds = i32::try_from(log_time / 1_000_000_000).unwrap_or(i32::MAX);
    let nanoseconds = (log_time % 1_000_000_000) as u32;
    let (stamp_s, stamp_ns) = message[STAMP].split_at_mut(4);
    stamp_s.copy_from_slice(&seconds.to_le_bytes());
    stamp_ns.copy_from_slice(&nanoseconds.to_le_bytes());
}
/// Replaces `message` by the image message of a frame of `camera`, its stamp zero. `O(pixels)`.
pub fn image_message(camera: &Camera, depth: &[u16], message: &mut Vec<u8>) {
    message.clear();
    begin(message);
    color::string(message, FORMAT);
    color::length(message, 0);
    let data = message.len();
    // transport of inverse depth, not used by integers
    message.extend_from_slice(&[0; 12]);
    message.extend_from_slice(&camera.width.to_le_bytes());
    message.extend_from_slice(&camera.height.to_le_bytes());
    rvl::encode(depth, message);
    // 3 bytes a pixel of 16 million pixels at most
    let length = (message.len() - data) as u32;
    message[data - 4..data].copy_from_slice(&length.to_le_bytes());
}

/// Encapsulation (CDR, little endian) and header.
fn begin(message: &mut Vec<u8>) {
    message.extend_from_slice(&[0, 1, 0, 0]);
    message.extend_from_slice(&[0; 8]);
    color::string(message, FRAME_ID);
}

/// The camera message, its stamp zero.
pub(super) fn info_message(camera: &Camera) -> Vec<u8> {
    let mut message = Vec::new();
    begin(&mut message);
    color::length(&mut message, camera.height as usize);
    color::length(&mut message, camera.width as usize);
    color::string(&mut message, "plumb_bob");
    // no distortion: an empty sequence
    color::length(&mut message, 0);
    let k = camera.intrinsics;
    let pinhole = [k.fx, 0.0, k.cx, 0.0, k.fy, k.cy, 0.0, 0.0, 1.0];
    let upright = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
    let projection = [
        k.fx, 0.0, k.cx, 0.0, 0.0, k.fy, k.cy, 0.0, 0.0, 0.0, 1.0, 0.0,
    ];
    // 8-byte fields are aligned to 8, counted from behind the encapsulation
    let aligned = (message.len() - 4).next_multiple_of(8) + 4;
    message.resize(aligned, 0);
    for value in pinhole.iter().chain(&upright).chain(&projection) {
        message.extend_from_slice(&f64::to_le_bytes(*value));
    }
    // binning and region: the whole image
    message.extend_from_slice(&[0; 6 * 4 + 1]);
    message
}

/// Unpacks an image message into `depth`; says why that is not possible.
pub(in crate::recording) fn unpack(
    camera: &Camera,
    message: &[u8],
    depth: &mut Vec<u16>,
) -> Result<(), String> {
    let read = color::read(message, 0, FrameTime::default());
    let image = read.ok_or("its fields end too early")?;
    let body = image.data.split_at_checked(20);
    let (head, body) = body.ok_or("its image ends too early")?;
    let size = [camera.width, camera.height].map(u32::to_le_bytes);
    if image.format != FORMAT || head[12..16] != size[0] || head[16..20] != size[1] {
        return Err(format!(
            "it is no {FORMAT} of {}x{} pixels",
            camera.width, camera.height
        ));
    }
    let pixels = camera.width as usize * camera.height as usize;
    rvl::decode(body, pixels, depth).map_err(|error| error.to_string())
}
