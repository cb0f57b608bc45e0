//! Colour images as ROS 2 has them: `sensor_msgs/msg/CompressedImage` in CDR.
//!
//! CDR, little endian (OMG DDS-RTPS 2.3, §10): 4 bytes of encapsulation (`00 01 00 00`), then the
//! fields in order, each aligned to its own size counted from after those 4 bytes. A string is a
//! u32 length that counts its closing zero byte; a byte sequence is a u32 length and the bytes.

use crate::frame::{ColorFrame, FrameTime};

/// Name of the schema.
pub const SCHEMA: &str = "sensor_msgs/msg/CompressedImage";
/// How a ros2msg definition ends that begins with a header: the messages the header refers to.
macro_rules! header_definition {
    () => {
        "\
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"
    };
}
pub(super) use header_definition;

/// The message definition, with the two it refers to, as ros2msg has it.
pub const DEFINITION: &str = concat!(
    "std_msgs/Header header\nstring format\nuint8[] data\n",
    header_definition!()
);
const ENCAPSULATION: [u8; 4] = [0, 1, 0, 0];
/// Bytes of the stamp, the first field.
const STAMP: usize = 8;
const FRAME_ID: &str = "color";

/// Replaces `message` by the image as CDR. The stamp is `stamp_ns` (Unix epoch), as in `log_time`.
pub fn write(frame: &ColorFrame, stamp_ns: u64, message: &mut Vec<u8>) {
    message.clear();
    message.reserve(frame.data.len() + 64);
    message.extend_from_slice(&ENCAPSULATION);
    let seconds = i32::try_from(stamp_ns / 1_000_000_000).unwrap_or(i32::MAX);
    message.extend_from_slice(&seconds.to_le_bytes());
    message.extend_from_slice(&((stamp_ns % 1_000_000_000) as u32).to_le_bytes());
    string(message, FRAME_ID);
    string(message, &frame.format);
    length(message, frame.data.len());
    message.extend_from_slice(&frame.data);
}

pub(super) fn length(message: &mut Vec<u8>, length: usize) {
    message.resize(message.len().next_multiple_of(4), 0);
    // the writer has checked the message against MAX_MESSAGE, far below u32::MAX
    message.extend_from_slice(&(length as u32).to_le_bytes());
}

pub(super) fn string(message: &mut Vec<u8>, text: &str) {
    length(message, text.len() + 1);
    message.extend_from_slice(text.as_bytes());
    message.push(0);
}

/// Reads an image back; its number and exact time come from the message around it. `None` where
/// the bytes are no such message.
#[must_use]
pub fn read(message: &[u8], sequence: u64, time: FrameTime) -> Option<ColorFrame> {
    let body = message.strip_prefix(&ENCAPSULATION)?;
    let mut at = STAMP;
    let _frame_id = sized(body, &mut at)?;
    let format = sized(body, &mut at)?.strip_suffix(&[0])?;
    let data = sized(body, &mut at)?;
    Some(ColorFrame {
        sequence,
        time,
        format: String::from_utf8(format.to_vec()).ok()?,
        data: data.to_vec(),
    })
}

/// The next length-prefixed bytes, after alignment; moves `at` behind them.
fn sized<'a>(body: &'a [u8], at: &mut usize) -> Option<&'a [u8]> {
    let start = at.next_multiple_of(4);
    let length = u32::from_le_bytes(body.get(start..start + 4)?.try_into().ok()?) as usize;
    let bytes = body.get(start + 4..)?.get(..length)?;
    *at = start + 4 + length;
    Some(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn image(format: &str, data: &[u8]) -> ColorFrame {
        ColorFrame {
            sequence: 7,
            time: FrameTime {
                device_ns: 1_500_000_123,
                wall_ns: 1_500_000_123,
            },
            format: format.into(),
            data: data.to_vec(),
        }
    }

    #[test]
    fn bytes_are_those_of_the_cdr_rules() {
        let mut message = Vec::new();
        write(
            &image("jpeg", &[0xFF, 0xD8, 0xFF]),
            1_500_000_123,
            &mut message,
        );
        let expected = [
            &[0, 1, 0, 0][..],
            &1i32.to_le_bytes(),
            &500_000_123u32.to_le_bytes(),
            &6u32.to_le_bytes(),
            b"color\0",
            &[0, 0], // 18 bytes so far: align to 20
            &5u32.to_le_bytes(),
            b"jpeg\0",
            &[0, 0, 0], // 29 bytes so far: align to 32
            &3u32.to_le_bytes(),
            &[0xFF, 0xD8, 0xFF],
        ]
        .concat();
        assert_eq!(message, expected);
    }

    #[test]
    fn an_image_comes_back_and_no_prefix_passes() {
        for format in ["jpeg", "png", "jp"] {
            let frame = image(format, &[1, 2, 3, 4, 5]);
            let mut message = Vec::new();
            write(&frame, 1_500_000_123, &mut message);
            assert_eq!(read(&message, 7, frame.time).as_ref(), Some(&frame));
            for cut in 0..message.len() {
                assert_eq!(read(&message[..cut], 7, frame.time), None, "cut at {cut}");
            }
        }
    }
}
