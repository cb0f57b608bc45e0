//! Names of the topics: one set for each camera.
//!
//! A recording of one camera uses the plain names (`saint`, `color`). Where there are several,
//! each camera has a name of its own that stands before a slash: `left/saint`, `left/color`.

use super::{CALIBRATION_TOPIC, CAMERA_TOPIC, COLOR_TOPIC, SAINT_TOPIC, STATISTICS_TOPIC};

/// What a channel of a camera carries.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Role {
    Saint,
    Calibration,
    Camera,
    Color,
    Statistics,
}

impl Role {
    fn name(self) -> &'static str {
        match self {
            Self::Saint => SAINT_TOPIC,
            Self::Calibration => CALIBRATION_TOPIC,
            Self::Camera => CAMERA_TOPIC,
            Self::Color => COLOR_TOPIC,
            Self::Statistics => STATISTICS_TOPIC,
        }
    }

    /// Its topic for the camera of this name; the empty name stands for the only camera.
    pub fn topic(self, camera: &str) -> String {
        if camera.is_empty() {
            self.name().to_owned()
        } else {
            format!("{camera}/{}", self.name())
        }
    }
}

/// A topic's camera and what is left: `left/saint` is (`left`, `saint`).
pub(super) fn split(topic: &str) -> (&str, &str) {
    topic.rsplit_once('/').unwrap_or(("", topic))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_and_topics_belong_together() {
        for (camera, topic) in [
            ("", "saint"),
            ("left", "left/saint"),
            ("rig/left", "rig/left/saint"),
        ] {
            assert_eq!(Role::Saint.topic(camera), topic);
            assert_eq!(split(topic), (camera, "saint"));
        }
    }
}
