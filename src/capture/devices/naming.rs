//! Which node a `--device` means: a path, a number, a serial number, a bus id, or `auto`. Pure.

use super::DeviceReport;
use crate::capture::v4l2::node_kind::NodeKind;
use std::path::PathBuf;

/// Video nodes the kernel numbers at most: a larger number is a serial number.
const NODES: u32 = 256;

/// What a `--device` text means.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum DeviceName {
    /// A node, whatever is behind it.
    Path(PathBuf),
    /// The first camera that will do.
    Auto,
    /// The camera of this serial number.
    Serial(String),
    /// The camera plugged in here.
    Bus(String),
    /// A serial number or a bus id.
    Either(String),
}

impl DeviceName {
    /// Reads `/dev/videoN` or another path, `N` (0 to 255), `auto`, `serial:…`, `bus:…`, or a
    /// serial number or bus id as `saint-live devices` shows them.
    #[must_use]
    pub fn parse(text: &str) -> Self {
        let digits = !text.is_empty() && text.bytes().all(|b| b.is_ascii_digit());
        let number = text.parse::<u32>().ok();
        match number.filter(|n| digits && *n < NODES && n.to_string() == text) {
            Some(number) => return Self::Path(format!("/dev/video{number}").into()),
            None if text == "auto" => return Self::Auto,
            None => {}
        }
        if let Some(serial) = text.strip_prefix("serial:") {
            Self::Serial(serial.into())
        } else if let Some(bus) = text.strip_prefix("bus:") {
            Self::Bus(bus.into())
        } else if text.contains('/') || text.is_empty() {
            Self::Path(text.into())
        } else {
            Self::Either(text.into())
        }
    }

    /// True when a node belongs to the camera named. A path is not looked at here.
    fn names(&self, report: &DeviceReport) -> bool {
        let serial = |text: &str| report.serial.as_deref() == Some(text);
        match self {
            Self::Path(path) => *path == report.path,
            Self::Auto => true,
            Self::Serial(text) => serial(text),
            Self::Bus(text) => report.bus == *text,
            Self::Either(text) => serial(text) || report.bus == *text,
        }
    }

    /// The node to open among those present: of the camera named, the first that `will_do`; where
    /// none does but one could not be asked, that one, since opening it tells why.
    ///
    /// # Errors
    /// What is wrong, and what there is.
    pub fn choose(
        &self,
        present: &[DeviceReport],
        will_do: impl Fn(&DeviceReport) -> bool,
        wanted: &str,
    ) -> Result<PathBuf, String> {
        if let Self::Path(path) = self {
            return Ok(path.clone());
        }
        let named: Vec<_> = present.iter().filter(|r| self.names(r)).collect();
        if let Some(found) = named.iter().find(|r| will_do(r)) {
            return Ok(found.path.clone());
        }
        let closed = named.iter().find(|r| r.kind == NodeKind::Unreadable);
        if let (Some(closed), false) = (closed, *self == Self::Auto) {
            return Ok(closed.path.clone());
        }
        let why = |r: &&DeviceReport| match r.kind {
            // the reason names the node already
            NodeKind::Unreadable => r.reason.clone(),
            _ => format!("{}: {}", r.path.display(), r.reason),
        };
        match (present.is_empty(), named.is_empty()) {
            (true, _) => Err("there is no video device".into()),
            (_, false) => {
                let reasons: Vec<_> = named.iter().map(why).collect();
                Err(format!("no {wanted} camera ({})", reasons.join("; ")))
            }
            _ => Err(format!(
                "no camera has this serial number or bus id; there are {}",
                cameras(present)
            )),
        }
    }
}

/// Each camera once: name, serial number, bus id.
fn cameras(present: &[DeviceReport]) -> String {
    let mut names: Vec<String> = Vec::new();
    for report in present {
        let serial = report.serial.as_ref();
        let serial = serial.map_or(String::new(), |serial| format!(" serial {serial}"));
        let bus = match report.bus.is_empty() {
            true => String::new(),
            false => format!(" bus {}", report.bus),
        };
        let name = format!("`{}`{serial}{bus}", report.card);
        if !names.contains(&name) {
            names.push(name);
        }
    }
    names.join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn node(number: u32, serial: Option<&str>, bus: &str, kind: NodeKind) -> DeviceReport {
        DeviceReport {
            path: format!("/dev/video{number}").into(),
            driver: "uvcvideo".into(),
            card: "D435".into(),
            bus: bus.into(),
            usb_id: None,
            serial: serial.map(String::from),
            kind,
            depth: kind == NodeKind::Depth,
            reason: format!("kind {kind:?}"),
            busy: None,
            held_by: Vec::new(),
            formats: Vec::new(),
        }
    }

    fn present() -> Vec<DeviceReport> {
        vec![
            node(0, Some("0042"), "usb-1", NodeKind::Color),
            node(1, Some("0042"), "usb-1", NodeKind::Metadata),
            node(2, Some("0042"), "usb-1", NodeKind::Depth),
            node(4, Some("123622270300"), "usb-2", NodeKind::Depth),
            node(6, None, "usb-3", NodeKind::Depth),
            node(8, Some("77"), "", NodeKind::Unreadable),
        ]
    }

    fn chosen(text: &str) -> Result<String, String> {
        let name = DeviceName::parse(text);
        let path = name.choose(&present(), |r| r.depth, "depth")?;
        Ok(path.display().to_string())
    }

    #[test]
    fn a_text_is_a_node_a_serial_number_or_a_bus_id() {
        let parse = DeviceName::parse;
        assert_eq!(parse("3"), DeviceName::Path("/dev/video3".into()));
        assert_eq!(parse("255"), DeviceName::Path("/dev/video255".into()));
        assert_eq!(parse("256"), DeviceName::Either("256".into()));
        assert_eq!(parse("03"), DeviceName::Either("03".into()));
        assert_eq!(parse("/dev/depth"), DeviceName::Path("/dev/depth".into()));
        assert_eq!(parse("./video9"), DeviceName::Path("./video9".into()));
        assert_eq!(parse("auto"), DeviceName::Auto);
        assert_eq!(parse("serial:3"), DeviceName::Serial("3".into()));
        assert_eq!(parse("bus:usb-1"), DeviceName::Bus("usb-1".into()));
    }

    #[test]
    fn a_camera_is_found_by_serial_number_and_by_bus_at_its_depth_node() {
        for (text, node) in [
            ("0042", 2),
            ("usb-1", 2),
            ("123622270300", 4),
            ("serial:123622270300", 4),
            ("bus:usb-3", 6),
            ("auto", 2),
            ("77", 77), // a number: the node, if it is one
            ("serial:77", 8),
        ] {
            assert_eq!(chosen(text), Ok(format!("/dev/video{node}")), "{text}");
        }
    }

    #[test]
    fn a_camera_that_is_not_there_or_not_depth_is_told_with_what_is() {
        let error = chosen("4711").unwrap_err();
        assert!(
            error.contains("serial 0042 bus usb-1, `D435` serial 123622270300"),
            "{error}"
        );
        assert_eq!(
            error.matches("0042").count(),
            1,
            "each camera once: {error}"
        );
        let name = DeviceName::parse("0042");
        let error = name
            .choose(&present()[..2], |r| r.depth, "depth")
            .unwrap_err();
        assert_eq!(
            error,
            "no depth camera (/dev/video0: kind Color; /dev/video1: kind Metadata)"
        );
        let none = DeviceName::Auto.choose(&[], |_| true, "depth").unwrap_err();
        assert_eq!(none, "there is no video device");
        let closed = DeviceName::Auto.choose(&present()[5..], |r| r.depth, "depth");
        assert!(closed.unwrap_err().contains("kind Unreadable"));
    }
}
