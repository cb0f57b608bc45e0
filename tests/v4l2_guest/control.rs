//! `control DEVICE ID VALUE`: sets one V4L2 control (numbers in hexadecimal). The test driver
//! `vivid` makes its errors when told so by such controls.

use std::fs::OpenOptions;
use std::os::fd::AsRawFd;

/// `struct v4l2_control` of `<linux/videodev2.h>`.
#[repr(C)]
struct Control {
    id: u32,
    value: i32,
}

/// `VIDIOC_S_CTRL`: read and write, type 'V', number 28.
const SET: u64 = (3 << 30) | ((size_of::<Control>() as u64) << 16) | (0x56 << 8) | 28;

unsafe extern "C" {
    fn ioctl(fd: i32, request: u64, argument: *mut Control) -> i32;
}

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [device, id, value] = arguments.as_slice() else {
        panic!("control DEVICE ID VALUE");
    };
    let number = |text: &str| u32::from_str_radix(text, 16).expect("a hexadecimal number");
    let node = OpenOptions::new().read(true).write(true).open(device).expect("the device opens");
    let mut control = Control { id: number(id), value: number(value) as i32 };
    // The structure is live and of the size the request names.
    let result = unsafe { ioctl(node.as_raw_fd(), SET, &raw mut control) };
    if result != 0 {
        panic!("control {id}: {}", std::io::Error::last_os_error());
    }
    println!("control {id} set on {device}");
}
