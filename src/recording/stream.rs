//! One camera's part of a recording: its channels, its clock, its tally.

use super::tally::Tally;
use crate::frame::{Camera, FrameTime};
use std::collections::BTreeMap;

/// A camera that is recorded beside others.
#[derive(Clone, Debug)]
pub struct CameraStream {
    /// Its name: its topics are `NAME/saint`, `NAME/color` and so on.
    pub name: String,
    /// The camera.
    pub camera: Camera,
    /// Extra facts about its stream, as [`WriterOptions::notes`](super::WriterOptions::notes).
    pub notes: BTreeMap<String, String>,
}

/// What stands before the topics of a camera: nothing where it is the only one.
pub(super) fn prefix(name: &str) -> String {
    if name.is_empty() {
        String::new()
    } else {
        format!("{name}/")
    }
}

/// The writer's side of one camera.
pub(super) struct Stream {
    pub prefix: String,
    pub camera: Camera,
    pub saint: u16,
    pub calibration: u16,
    pub camera_channel: u16,
    pub statistics: Option<u16>,
    pub color: Option<u16>,
    /// Traffic by topic without the prefix.
    pub tally: Tally,
    /// Added to the device clock to make a log time; set by the first image.
    clock_offset: Option<i64>,
    /// The camera's messages are out.
    pub described: bool,
}

impl Stream {
    pub fn new(name: &str, camera: &Camera) -> Self {
        Self {
            prefix: prefix(name),
            camera: camera.clone(),
            saint: 0,
            calibration: 0,
            camera_channel: 0,
            statistics: None,
            color: None,
            tally: Tally::default(),
            clock_offset: None,
            described: false,
        }
    }

    /// Full name of one of its topics.
    pub fn topic(&self, name: &str) -> String {
        format!("{}{name}", self.prefix)
    }

    /// The first image decides how the device clock is moved to the wall clock.
    pub fn set_clock(&mut self, time: FrameTime) {
        self.clock_offset.get_or_insert(match time.wall_ns {
            0 => 0,
            wall => wall.saturating_sub(time.device_ns),
        });
    }

    /// MCAP's log time: the device clock, moved.
    pub fn log_time(&self, time: FrameTime) -> u64 {
        let moved = time
            .device_ns
            .saturating_add(self.clock_offset.unwrap_or(0));
        u64::try_from(moved).unwrap_or(0)
    }
}
