//! One `/dev/videoN`: what it says of itself, and how it is set up.
//!
//! Talks to the kernel through the ioctls and structures `v4l` publishes rather than through its
//! `Device`, which panics on answers a driver may give (an unknown colour space, a name that is
//! not UTF-8).

use super::fourcc::FourCc;
use super::grant::Granted;
use super::offer::{FrameSize, OfferedFormat, SizeRange};
use std::fs::{File, OpenOptions};
use std::io;
use std::os::fd::AsRawFd;
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;
use v4l::v4l_sys as sys;
use v4l::v4l2::vidioc;

/// A C structure of the V4L2 interface.
///
/// # Safety
/// All bytes zero must be a valid value, and the structure must hold no pointer the kernel
/// follows while it is zero or as this module fills it.
#[allow(unsafe_code)]
pub(super) unsafe trait KernelStruct: Sized {
    /// The structure with all bytes zero.
    fn zeroed() -> Self {
        // SAFETY: the implementor promises that zero is a valid value.
        #[allow(unsafe_code)]
        unsafe {
            std::mem::zeroed()
        }
    }
}

macro_rules! kernel_structs {
    ($($name:ty),* $(,)?) => {
        $(
            // SAFETY: plain integers, arrays and unions of them; pointers appear only in unions
            // read by memory modes this crate never asks for.
            #[allow(unsafe_code)]
            unsafe impl KernelStruct for $name {}
        )*
    };
}

kernel_structs!(
    sys::v4l2_capability,
    sys::v4l2_fmtdesc,
    sys::v4l2_frmsizeenum,
    sys::v4l2_frmivalenum,
    sys::v4l2_format,
    sys::v4l2_streamparm,
    sys::v4l2_requestbuffers,
    sys::v4l2_buffer,
    u32,
);

/// Formats, sizes or rates a driver may list; more is a driver that does not stop.
const MAX_LISTED: u32 = 256;

/// Who a node is.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Capability {
    /// Driver, `uvcvideo`.
    pub driver: String,
    /// What the camera calls itself.
    pub card: String,
    /// Where it is plugged in.
    pub bus: String,
    /// `V4L2_CAP_*` of this node (not of its whole device).
    pub flags: u32,
}

/// An open node. Closed on drop.
#[derive(Debug)]
pub struct VideoNode {
    file: File,
}

impl VideoNode {
    /// Opens a node without configuring anything.
    ///
    /// # Errors
    /// As the system gives them (ENOENT, EACCES, ENODEV, …).
    pub fn open(path: &Path) -> io::Result<Self> {
        let file = OpenOptions::new()
            .read(true)
            .write(true)
            .custom_flags(libc::O_NONBLOCK)
            .open(path)?;
        Ok(Self { file })
    }

    /// The descriptor, for `poll` and `mmap`.
    pub(super) fn fd(&self) -> i32 {
        self.file.as_raw_fd()
    }

    /// One ioctl, repeated when a signal interrupted it.
    pub(super) fn request<T: KernelStruct>(
        &self,
        code: vidioc::_IOC_TYPE,
        argument: &mut T,
    ) -> io::Result<()> {
        // The request's number holds the size of its argument: the kernel touches no more.
        if (code >> 16) & 0x3fff != size_of::<T>() as vidioc::_IOC_TYPE {
            return Err(io::Error::from(io::ErrorKind::InvalidInput));
        }
        loop {
            // SAFETY: `argument` is a live structure of exactly the size the request moves, and
            // `KernelStruct` promises that the kernel follows no pointer in it.
            #[allow(unsafe_code)]
            let result =
                unsafe { v4l::v4l2::ioctl(self.fd(), code, std::ptr::from_mut(argument).cast()) };
            match result {
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                other => return other,
            }
        }
    }

    /// Who this node is. Fails with ENOTTY on anything but a V4L2 node.
    ///
    /// # Errors
    /// As the driver gives them.
    pub fn capability(&self) -> io::Result<Capability> {
        let mut answer = sys::v4l2_capability::zeroed();
        self.request(vidioc::VIDIOC_QUERYCAP, &mut answer)?;
        let flags = match answer.capabilities & sys::V4L2_CAP_DEVICE_CAPS {
            0 => answer.capabilities,
            _ => answer.device_caps,
        };
        Ok(Capability {
            driver: kernel_text(&answer.driver),
            card: kernel_text(&answer.card),
            bus: kernel_text(&answer.bus_info),
            flags,
        })
    }

    /// Whether a program streams from the node; `None` where the driver does not say.
    ///
    /// Asks for no buffers, which only their owner may: nothing is changed either way.
    #[must_use]
    pub fn is_busy(&self) -> Option<bool> {
        let mut ask = sys::v4l2_requestbuffers::zeroed();
        ask.type_ = sys::v4l2_buf_type_V4L2_BUF_TYPE_VIDEO_CAPTURE;
        ask.memory = sys::v4l2_memory_V4L2_MEMORY_MMAP;
        match self.request(vidioc::VIDIOC_REQBUFS, &mut ask) {
            Ok(()) => Some(false),
            Err(error) if error.raw_os_error() == Some(libc::EBUSY) => Some(true),
            Err(_) => None,
        }
    }

    /// All formats with their sizes and rates. Empty for a node without images.
    #[must_use]
    pub fn formats(&self) -> Vec<OfferedFormat> {
        let mut formats = Vec::new();
        for index in 0..MAX_LISTED {
            let mut listed = sys::v4l2_fmtdesc::zeroed();
            listed.index = index;
            listed.type_ = sys::v4l2_buf_type_V4L2_BUF_TYPE_VIDEO_CAPTURE;
            if self.request(vidioc::VIDIOC_ENUM_FMT, &mut listed).is_err() {
                break;
            }
            let (sizes, size_range) = self.sizes(listed.pixelformat);
            formats.push(OfferedFormat {
                pixel_format: FourCc::from_kernel(listed.pixelformat),
                description: kernel_text(&listed.description),
                sizes,
                size_range,
            });
        }
        formats
    }

    fn sizes(&self, pixel_format: u32) -> (Vec<FrameSize>, Option<SizeRange>) {
        let mut sizes = Vec::new();
        for index in 0..MAX_LISTED {
            let mut listed = sys::v4l2_frmsizeenum::zeroed();
            listed.index = index;
            listed.pixel_format = pixel_format;
            if self
                .request(vidioc::VIDIOC_ENUM_FRAMESIZES, &mut listed)
                .is_err()
            {
                break;
            }
            if listed.type_ != sys::v4l2_frmsizetypes_V4L2_FRMSIZE_TYPE_DISCRETE {
                // SAFETY: all members of the union are plain integers; `type_` names this one.
                #[allow(unsafe_code)]
                let range = unsafe { listed.__bindgen_anon_1.stepwise };
                let range = SizeRange {
                    min: (range.min_width, range.min_height),
                    max: (range.max_width, range.max_height),
                    step: (range.step_width.max(1), range.step_height.max(1)),
                };
                return (sizes, Some(range));
            }
            // SAFETY: all members of the union are plain integers; `type_` names this one.
            #[allow(unsafe_code)]
            let size = unsafe { listed.__bindgen_anon_1.discrete };
            sizes.push(FrameSize {
                width: size.width,
                height: size.height,
                fps: self.rates(pixel_format, size.width, size.height),
            });
        }
        (sizes, None)
    }

    /// Frame rates of a format at a size, frames/s. Of a range, its two ends.
    fn rates(&self, pixel_format: u32, width: u32, height: u32) -> Vec<f64> {
        let mut rates = Vec::new();
        for index in 0..MAX_LISTED {
            let mut listed = sys::v4l2_frmivalenum::zeroed();
            listed.index = index;
            listed.pixel_format = pixel_format;
            listed.width = width;
            listed.height = height;
            if self
                .request(vidioc::VIDIOC_ENUM_FRAMEINTERVALS, &mut listed)
                .is_err()
            {
                break;
            }
            if listed.type_ != sys::v4l2_frmivaltypes_V4L2_FRMIVAL_TYPE_DISCRETE {
                // SAFETY: all members of the union are plain integers; `type_` names this one.
                #[allow(unsafe_code)]
                let range = unsafe { listed.__bindgen_anon_1.stepwise };
                rates.extend(rate(range.max).into_iter().chain(rate(range.min)));
                break;
            }
            // SAFETY: all members of the union are plain integers; `type_` names this one.
            #[allow(unsafe_code)]
            let interval = unsafe { listed.__bindgen_anon_1.discrete };
            rates.extend(rate(interval));
        }
        rates
    }

    /// Asks for a format; the driver may grant another one.
    ///
    /// # Errors
    /// As the driver gives them: EBUSY when another program streams from the node.
    pub fn set_format(&self, format: FourCc, width: u32, height: u32) -> io::Result<Granted> {
        let mut ask = sys::v4l2_format::zeroed();
        ask.type_ = sys::v4l2_buf_type_V4L2_BUF_TYPE_VIDEO_CAPTURE;
        // Writing a union member of plain integers is safe; reading it below is not.
        ask.fmt.pix.width = width;
        ask.fmt.pix.height = height;
        ask.fmt.pix.pixelformat = format.to_kernel();
        ask.fmt.pix.field = sys::v4l2_field_V4L2_FIELD_ANY;
        self.request(vidioc::VIDIOC_S_FMT, &mut ask)?;
        // SAFETY: the driver answers a VIDEO_CAPTURE format with this member, plain integers.
        #[allow(unsafe_code)]
        let got = unsafe { ask.fmt.pix };
        Ok(Granted {
            format: FourCc::from_kernel(got.pixelformat),
            width: got.width,
            height: got.height,
            stride: got.bytesperline,
            fps: None,
        })
    }

    /// Asks for a frame rate; returns the one granted, `None` where the driver has no say in it.
    ///
    /// # Errors
    /// As the driver gives them.
    pub fn set_rate(&self, fps: f64) -> io::Result<Option<f64>> {
        let mut ask = sys::v4l2_streamparm::zeroed();
        ask.type_ = sys::v4l2_buf_type_V4L2_BUF_TYPE_VIDEO_CAPTURE;
        // 29.97 needs a fraction; whole rates go as drivers list them.
        let (numerator, denominator) = match fps.fract() == 0.0 {
            true => (1, fps as u32),
            false => (1000, (fps * 1000.0).round() as u32),
        };
        ask.parm.capture.timeperframe = sys::v4l2_fract {
            numerator,
            denominator,
        };
        match self.request(vidioc::VIDIOC_S_PARM, &mut ask) {
            Ok(()) => Ok(granted_rate(&ask)),
            Err(error) if error.raw_os_error() == Some(libc::ENOTTY) => Ok(None),
            Err(error) => Err(error),
        }
    }
}

fn granted_rate(answer: &sys::v4l2_streamparm) -> Option<f64> {
    // SAFETY: the driver answers a VIDEO_CAPTURE request with this member, plain integers.
    #[allow(unsafe_code)]
    let capture = unsafe { answer.parm.capture };
    rate(capture.timeperframe)
}

fn rate(interval: sys::v4l2_fract) -> Option<f64> {
    (interval.numerator > 0 && interval.denominator > 0)
        .then(|| f64::from(interval.denominator) / f64::from(interval.numerator))
}

/// A C string in a fixed field: up to its zero, other bytes than UTF-8 replaced.
fn kernel_text(field: &[u8]) -> String {
    let end = field.iter().position(|b| *b == 0).unwrap_or(field.len());
    String::from_utf8_lossy(&field[..end]).trim().to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_ends_at_its_zero_and_need_not_be_utf8() {
        assert_eq!(kernel_text(b"camera\0junk"), "camera");
        assert_eq!(kernel_text(b"full"), "full");
        assert_eq!(kernel_text(b"caf\xe9\0"), "caf\u{fffd}");
    }

    #[test]
    fn a_rate_is_the_inverse_of_an_interval_and_zero_has_none() {
        let fraction = |numerator, denominator| sys::v4l2_fract {
            numerator,
            denominator,
        };
        assert_eq!(rate(fraction(1, 30)), Some(30.0));
        assert_eq!(
            rate(fraction(333_333, 10_000_000)).map(f64::round),
            Some(30.0)
        );
        assert_eq!(rate(fraction(0, 30)), None);
        assert_eq!(rate(fraction(1, 0)), None);
    }

    #[test]
    fn what_is_no_v4l2_node_says_enotty_and_a_wrong_size_is_refused() {
        let node = VideoNode::open(Path::new("/dev/null")).unwrap();
        let error = node.capability().unwrap_err();
        assert_eq!(error.raw_os_error(), Some(libc::ENOTTY));
        let error = node
            .request(vidioc::VIDIOC_QUERYCAP, &mut 0u32)
            .unwrap_err();
        assert_eq!(error.kind(), io::ErrorKind::InvalidInput);
    }
}
