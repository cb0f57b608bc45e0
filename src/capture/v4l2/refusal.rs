//! What the system says when it refuses, in words with a remedy.

use crate::capture::CaptureError;
use crate::capture::devices::access;
use std::io;
use std::path::Path;

/// Whether a camera can be expected to work again after an error.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outlook {
    /// No frame yet: ask again.
    Again,
    /// The camera is gone; the same one may come back.
    Gone,
    /// The stream broke; a new one may work.
    Restart,
}

/// Judges an error of a running stream.
#[must_use]
pub fn outlook(error: &io::Error) -> Outlook {
    match error.raw_os_error() {
        Some(libc::EAGAIN) => Outlook::Again,
        Some(libc::ENODEV | libc::ENXIO | libc::ENOENT | libc::ESHUTDOWN) => Outlook::Gone,
        _ => Outlook::Restart,
    }
}

/// An error of the system as the user should read it. `doing` completes "could not".
#[must_use]
pub fn device_error(device: &Path, doing: &str, error: &io::Error) -> CaptureError {
    let (what, remedy) = explain(doing, error);
    let remedy = match error.raw_os_error() {
        Some(libc::EACCES | libc::EPERM) => access::permission_remedy(device),
        Some(libc::EBUSY) => match access::holders(device) {
            names if names.is_empty() => remedy.to_string(),
            names => format!("{remedy}; it is open in {}", names.join(", ")),
        },
        _ => remedy.to_string(),
    };
    CaptureError::Device {
        device: device.display().to_string(),
        what,
        remedy,
    }
}

fn explain(doing: &str, error: &io::Error) -> (String, &'static str) {
    let reason = match error.raw_os_error() {
        Some(libc::ENOENT) => "there is no such device",
        Some(libc::EACCES | libc::EPERM) => "permission denied",
        Some(libc::EBUSY) => "another program is using the camera",
        Some(libc::ENODEV | libc::ENXIO | libc::ESHUTDOWN) => "the camera was unplugged",
        Some(libc::EINVAL) => "the driver refused it as invalid (EINVAL)",
        Some(libc::ENOTTY | libc::EISDIR) => "it is not a V4L2 video device",
        Some(libc::ENOSPC) => "the USB bus has no bandwidth left for this stream",
        Some(libc::EIO) => "the camera reports an input/output error (EIO)",
        _ => {
            return (
                format!("could not {doing}: {error}"),
                "unplug the camera and plug it in again; `dmesg` may say more",
            );
        }
    };
    let remedy = match error.raw_os_error() {
        Some(libc::ENOENT) => "plug the camera in; `saint-live devices` lists what there is",
        Some(libc::EBUSY) => "close the program that holds it (`fuser -v` on the device names it)",
        Some(libc::ENODEV | libc::ENXIO | libc::ESHUTDOWN) => {
            "check the cable and plug it in again"
        }
        Some(libc::EINVAL) => {
            "choose --pixel-format, --size and --fps from what `saint-live devices` lists"
        }
        Some(libc::ENOTTY | libc::EISDIR) => "give a /dev/videoN; `saint-live devices` lists them",
        Some(libc::ENOSPC) => {
            "ask for a smaller --size or --fps, or use a port on another USB controller"
        }
        _ => "unplug the camera and plug it in again, in another port if it repeats",
    };
    (format!("could not {doing}: {reason}"), remedy)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn text(errno: i32) -> String {
        let error = io::Error::from_raw_os_error(errno);
        device_error(Path::new("/dev/video7"), "start the stream", &error).to_string()
    }

    #[test]
    fn each_refusal_names_the_device_the_reason_and_a_remedy() {
        for (errno, reason, remedy) in [
            (libc::ENOENT, "no such device", "saint-live devices"),
            (libc::EACCES, "permission denied", "group `video`"),
            (libc::EPERM, "permission denied", "group `video`"),
            (libc::EBUSY, "another program", "fuser"),
            (libc::ENODEV, "unplugged", "plug it in again"),
            (libc::EINVAL, "EINVAL", "--pixel-format"),
            (libc::ENOTTY, "not a V4L2", "/dev/videoN"),
            (libc::EISDIR, "not a V4L2", "/dev/videoN"),
            (libc::ENOSPC, "bandwidth", "--fps"),
            (libc::EIO, "EIO", "another port"),
            (libc::ENOMEM, "os error 12", "dmesg"),
        ] {
            let text = text(errno);
            assert!(
                text.starts_with("/dev/video7: could not start the stream: "),
                "{text}"
            );
            assert!(
                text.contains(reason) && text.contains(remedy),
                "{errno}: {text}"
            );
        }
    }

    #[test]
    fn a_running_stream_is_asked_again_restarted_or_looked_for() {
        for (errno, want) in [
            (libc::EAGAIN, Outlook::Again),
            (libc::ENODEV, Outlook::Gone),
            (libc::EIO, Outlook::Restart),
            (libc::EINVAL, Outlook::Restart),
            (libc::ENOMEM, Outlook::Restart),
        ] {
            assert_eq!(
                outlook(&io::Error::from_raw_os_error(errno)),
                want,
                "{errno}"
            );
        }
    }
}
