//! Calibration of a RealSense D400 camera, asked over its UVC extension unit: the depth unit and
//! the rectified intrinsics of each image size.
//!
//! The messages are those librealsense documents: a command of 24 bytes in a block of 1024 is
//! written, a block with the reply is read back. All integers are little-endian.

use super::node::VideoNode;
use super::usb::{self, UsbDevice};
use crate::frame::Intrinsics;
use std::io;

/// Bytes of a command or reply block.
const BLOCK: usize = 1024;
/// Where a reply keeps the length of its data.
const LENGTH_AT: usize = 1020;
/// Marks a command block.
const MAGIC: u16 = 0xcdab;
const COMMAND_BYTES: u16 = 20;

const GET_CALIBRATION: u32 = 0x15;
const GET_ADVANCED: u32 = 0x2c;
const GET_RECTIFIED: u32 = 0x7e;
const DEPTH_COEFFICIENTS: u32 = 25;
const DEPTH_TABLE: u32 = 9;

/// Where the coefficients table keeps its four floats per image size.
const RECTIFIED_AT: usize = 256;
/// Bytes per item of the newer list: width, height, then four floats.
const RECTIFIED_ITEM: usize = 20;
/// Image sizes in the order of the coefficients table; `(0, 0)` is unused.
const TABLE_SIZES: [(u32, u32); 16] = [
    (1920, 1080),
    (1280, 720),
    (640, 480),
    (848, 480),
    (640, 360),
    (424, 240),
    (320, 240),
    (480, 270),
    (1280, 800),
    (960, 540),
    (0, 0),
    (0, 0),
    (640, 400),
    (576, 576),
    (720, 720),
    (1152, 1152),
];

/// What the camera knows of itself.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Calibration {
    /// Metres per depth integer.
    pub depth_unit_m: Option<f64>,
    /// Intrinsics at the size asked for.
    pub intrinsics: Option<Intrinsics>,
}

/// Asks a camera for its calibration at an image size. `None` when it has no RealSense unit.
///
/// The unit is found by its GUID in the USB descriptors, so no other camera gets our commands.
#[must_use]
pub fn read_calibration(
    node: &VideoNode,
    usb: &UsbDevice,
    size: (u32, u32),
) -> Option<Calibration> {
    let unit = usb::extension_unit(&usb.descriptors, usb.interface, &usb::REALSENSE_UNIT)?;
    let ask = |opcode, parameter| {
        let answer = exchange(node, unit, opcode, parameter);
        if let Err(error) = &answer {
            tracing::debug!(opcode, %error, "the camera did not answer a calibration command");
        }
        answer.ok()
    };
    let unit_m = ask(GET_ADVANCED, DEPTH_TABLE).and_then(|data| depth_unit_m(&data));
    let listed = ask(GET_RECTIFIED, 0).and_then(|data| from_list(&data, size));
    let intrinsics = listed.or_else(|| {
        let table = ask(GET_CALIBRATION, DEPTH_COEFFICIENTS)?;
        from_table(&table, size)
    });
    Some(Calibration {
        depth_unit_m: unit_m,
        intrinsics,
    })
}

/// A command block.
fn command(opcode: u32, parameter: u32) -> [u8; BLOCK] {
    let mut block = [0; BLOCK];
    block[0..2].copy_from_slice(&COMMAND_BYTES.to_le_bytes());
    block[2..4].copy_from_slice(&MAGIC.to_le_bytes());
    block[4..8].copy_from_slice(&opcode.to_le_bytes());
    block[8..12].copy_from_slice(&parameter.to_le_bytes());
    block
}

/// The data of a reply; `None` when it answers another command, reports an error, or lies about
/// its length.
fn reply_data(block: &[u8; BLOCK], opcode: u32) -> Option<&[u8]> {
    let length = usize::try_from(u32_at(block, LENGTH_AT)?).ok()?;
    if u32_at(block, 0)? != opcode || length > LENGTH_AT - 4 {
        return None;
    }
    block.get(4..4 + length)
}

/// The depth unit, from the camera's depth table: its first integer, micrometres.
fn depth_unit_m(table: &[u8]) -> Option<f64> {
    let micrometres = u32_at(table, 0)?;
    // Known cameras use 100 (D405) to 1000; a unit of 0 or over 0.1 m is no unit.
    (1..=100_000)
        .contains(&micrometres)
        .then(|| f64::from(micrometres) * 1e-6)
}

fn from_table(table: &[u8], size: (u32, u32)) -> Option<Intrinsics> {
    let row = TABLE_SIZES.iter().position(|s| *s == size)?;
    plausible(table.get(RECTIFIED_AT + row * 16..)?, size)
}

fn from_list(list: &[u8], size: (u32, u32)) -> Option<Intrinsics> {
    list.chunks_exact(RECTIFIED_ITEM)
        .find(|item| {
            let width = u16::from_le_bytes([item[0], item[1]]);
            let height = u16::from_le_bytes([item[2], item[3]]);
            (u32::from(width), u32::from(height)) == size
        })
        .and_then(|item| plausible(&item[4..], size))
}

/// Four floats (fx, fy, ppx, ppy), if they can be a lens at this size.
fn plausible(floats: &[u8], (width, height): (u32, u32)) -> Option<Intrinsics> {
    let mut values = [0.0; 4];
    for (to, from) in values.iter_mut().zip(floats.get(..16)?.chunks_exact(4)) {
        *to = f64::from(f32::from_le_bytes([from[0], from[1], from[2], from[3]]));
    }
    let [fx, fy, cx, cy] = values;
    let inside = |v: f64, size: u32| v >= 0.0 && v <= f64::from(size);
    let focal = |f: f64| f.is_finite() && f > 1.0;
    (focal(fx) && focal(fy) && inside(cx, width) && inside(cy, height)).then_some(Intrinsics {
        fx,
        fy,
        cx,
        cy,
    })
}

fn u32_at(bytes: &[u8], at: usize) -> Option<u32> {
    let word = bytes.get(at..at + 4)?;
    Some(u32::from_le_bytes([word[0], word[1], word[2], word[3]]))
}

const SELECTOR: u8 = 1;
const SET_CUR: u8 = 0x01;
const GET_CUR: u8 = 0x81;

/// Sends one command and returns its reply's data.
fn exchange(node: &VideoNode, unit: u8, opcode: u32, parameter: u32) -> io::Result<Vec<u8>> {
    let mut block = command(opcode, parameter);
    query(node, unit, SET_CUR, &mut block)?;
    let mut reply = [0; BLOCK];
    query(node, unit, GET_CUR, &mut reply)?;
    match reply_data(&reply, opcode) {
        Some(data) => Ok(data.to_vec()),
        None => Err(io::Error::from(io::ErrorKind::InvalidData)),
    }
}

/// `struct uvc_xu_control_query` of `<linux/uvcvideo.h>`.
#[repr(C)]
struct UnitQuery {
    unit: u8,
    selector: u8,
    query: u8,
    size: u16,
    data: *mut u8,
}

/// `UVCIOC_CTRL_QUERY`: read and write, type 'u', number 0x21.
const UNIT_QUERY: v4l::v4l2::vidioc::_IOC_TYPE = (3 << 30)
    | ((size_of::<UnitQuery>() as v4l::v4l2::vidioc::_IOC_TYPE) << 16)
    | (0x75 << 8)
    | 0x21;

fn query(node: &VideoNode, unit: u8, query: u8, block: &mut [u8; BLOCK]) -> io::Result<()> {
    let mut request = UnitQuery {
        unit,
        selector: SELECTOR,
        query,
        size: BLOCK as u16,
        data: block.as_mut_ptr(),
    };
    loop {
        // SAFETY: the request's number holds the size of `UnitQuery`; the kernel reads or writes
        // `size` bytes at `data`, which is a live block of that many.
        #[allow(unsafe_code)]
        let result = unsafe {
            v4l::v4l2::ioctl(
                node.fd(),
                UNIT_QUERY,
                std::ptr::from_mut(&mut request).cast(),
            )
        };
        match result {
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            other => return other,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn floats(values: [f32; 4]) -> Vec<u8> {
        values.iter().flat_map(|v| v.to_le_bytes()).collect()
    }

    fn reply(opcode: u32, data: &[u8], length: u32) -> [u8; BLOCK] {
        let mut block = [0; BLOCK];
        block[..4].copy_from_slice(&opcode.to_le_bytes());
        block[4..4 + data.len()].copy_from_slice(data);
        block[LENGTH_AT..].copy_from_slice(&length.to_le_bytes());
        block
    }

    #[test]
    fn the_request_number_is_the_kernels() {
        assert_eq!(UNIT_QUERY, 0xc010_7521);
    }

    #[test]
    fn a_command_is_laid_out_as_documented() {
        let block = command(GET_CALIBRATION, DEPTH_COEFFICIENTS);
        assert_eq!(block[..12], [20, 0, 0xab, 0xcd, 0x15, 0, 0, 0, 25, 0, 0, 0]);
        assert!(block[12..].iter().all(|b| *b == 0));
    }

    #[test]
    fn a_reply_is_read_to_its_length_and_no_further() {
        assert_eq!(reply_data(&reply(7, &[1, 2, 3], 2), 7), Some(&[1, 2][..]));
        assert_eq!(reply_data(&reply(7, &[], 0), 7), Some(&[][..]));
        assert_eq!(reply_data(&reply(7, &[1], 1), 8), None, "another command's");
        assert!(reply_data(&reply(7, &[], 1016), 7).is_some());
        assert_eq!(reply_data(&reply(7, &[], 1017), 7), None);
        assert_eq!(reply_data(&reply(7, &[], u32::MAX), 7), None);
    }

    #[test]
    fn intrinsics_come_from_the_row_of_their_size() {
        let mut table = vec![0; RECTIFIED_AT + 16 * 16];
        table[RECTIFIED_AT + 3 * 16..][..16]
            .copy_from_slice(&floats([425.5, 425.25, 424.5, 240.25]));
        let lens = from_table(&table, (848, 480)).unwrap();
        assert_eq!(
            (lens.fx, lens.fy, lens.cx, lens.cy),
            (425.5, 425.25, 424.5, 240.25)
        );
        assert_eq!(from_table(&table, (640, 480)), None, "an empty row");
        assert_eq!(from_table(&table, (800, 600)), None, "no such row");
        assert_eq!(
            from_table(&table[..RECTIFIED_AT + 50], (848, 480)),
            None,
            "cut"
        );
        assert_eq!(from_table(&[], (848, 480)), None);
    }

    #[test]
    fn the_newer_list_is_searched_by_size() {
        let mut list = Vec::new();
        for (width, height, fx) in [(1280u16, 720u16, 630.0), (640, 480, 380.0)] {
            list.extend(width.to_le_bytes());
            list.extend(height.to_le_bytes());
            list.extend(floats([fx, fx, 320.0, 240.0]));
        }
        assert_eq!(from_list(&list, (640, 480)).map(|i| i.fx), Some(380.0));
        assert_eq!(from_list(&list, (848, 480)), None);
        assert_eq!(
            from_list(&list[..30], (640, 480)),
            None,
            "a cut item is no item"
        );
    }

    #[test]
    fn a_lens_or_unit_that_cannot_be_is_no_lens_and_no_unit() {
        for bad in [
            [f32::NAN, 1.0, 1.0, 1.0],
            [f32::INFINITY, 300.0, 1.0, 1.0],
            [300.0, 0.0, 1.0, 1.0],
            [300.0, 300.0, -1.0, 1.0],
            [300.0, 300.0, 1.0, 481.0],
            [300.0, 300.0, f32::NAN, 1.0],
        ] {
            assert_eq!(plausible(&floats(bad), (640, 480)), None, "{bad:?}");
        }
        assert_eq!(depth_unit_m(&1000u32.to_le_bytes()), Some(0.001));
        assert!((depth_unit_m(&100u32.to_le_bytes()).unwrap() - 1e-4).abs() < 1e-12);
        assert_eq!(depth_unit_m(&0u32.to_le_bytes()), None);
        assert_eq!(depth_unit_m(&u32::MAX.to_le_bytes()), None);
        assert_eq!(depth_unit_m(&[1, 2]), None);
    }
}
