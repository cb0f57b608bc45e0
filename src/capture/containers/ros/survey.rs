//! What is in a log of messages: topics with depth, and the cameras and units that belong to them.

use super::messages::{CompressedImage, Image, camera_info, float32};
use super::{Kind, Message, MessageLog, image};
use crate::capture::CaptureError;
use crate::capture::containers::{About, Stored};
use crate::capture::sequences::camera::Said;
use crate::capture::sequences::{DEFAULT_UNIT_M, input};
use crate::frame::Camera;
use crate::intrinsics::Calibration;
use crate::recording::raw::CAMERA_NOTE;
use std::collections::BTreeMap;
use std::path::Path;

/// Depth topics that begin this long after the first one are not looked for, ns.
const LOOK_NS: u64 = 1_000_000_000;
/// Bytes of messages that are looked through for a camera at most.
const MOST_BYTES: u64 = 1 << 30;
/// Topics kept of each sort at most; a real log has some dozen.
const MOST_TOPICS: usize = 1024;
/// How RealSense ends the topic of the depth unit.
const UNIT_TOPIC: &str = "/option/depth_units/value";

/// A topic with depth.
#[derive(Clone, Debug)]
struct Candidate {
    compressed: bool,
    stored: Stored,
    notes: BTreeMap<String, String>,
}

/// Everything found.
#[derive(Debug, Default)]
pub(super) struct Survey {
    depth: BTreeMap<String, Candidate>,
    /// Image topics without depth, with their encodings.
    others: BTreeMap<String, String>,
    cameras: BTreeMap<String, (Calibration, bool)>,
    units: BTreeMap<String, f64>,
    wanted: Option<String>,
}

/// The topic that is read.
pub(super) struct Found {
    pub(super) topic: String,
    pub(super) notes: BTreeMap<String, String>,
    pub(super) about: About,
}

impl Survey {
    /// Looks through the log until the topic `wanted` (or the best of the first second) and its
    /// camera are known. Damage ends the look where there is depth before it.
    pub(super) fn of(
        log: &mut dyn MessageLog,
        wanted: Option<&str>,
        path: &Path,
    ) -> Result<Self, CaptureError> {
        let mut survey = Self {
            wanted: wanted.map(str::to_owned),
            ..Self::default()
        };
        let (mut first_ns, mut bytes) = (None, 0u64);
        loop {
            let message = match log.next() {
                Ok(Some(message)) => message,
                Ok(None) => break,
                Err(_) if !survey.depth.is_empty() => break,
                Err(error) => return Err(error),
            };
            bytes += message.data.len() as u64;
            let is_depth = survey.look(&message);
            if is_depth {
                first_ns.get_or_insert(message.log_ns);
            }
            let looked =
                first_ns.is_some_and(|first| message.log_ns.saturating_sub(first) >= LOOK_NS);
            let enough = survey.best().is_some_and(|(topic, candidate)| {
                let known =
                    candidate.notes.contains_key(CAMERA_NOTE) || survey.camera_of(topic).is_some();
                known && (looked || wanted.is_some())
            });
            if enough || bytes >= MOST_BYTES {
                break;
            }
        }
        tracing::debug!("{}: {survey:?}", path.display());
        Ok(survey)
    }

    /// Keeps what a message says; true for a depth image.
    fn look(&mut self, message: &Message<'_>) -> bool {
        let channel = message.channel;
        let (topic, layout) = (&channel.topic, channel.layout);
        let room = |count: usize| count < MOST_TOPICS;
        let (encoding, stored, compressed) = match channel.kind {
            Kind::Image => {
                let Some(read) = Image::read(message.data, layout) else {
                    return false;
                };
                (read.encoding, image::stored(read.encoding), false)
            }
            Kind::CompressedImage => {
                let Some(read) = CompressedImage::read(message.data, layout) else {
                    return false;
                };
                (read.format, image::compressed_stored(read.format), true)
            }
            Kind::CameraInfo => {
                if let Some(camera) = camera_info(message.data, layout)
                    && room(self.cameras.len())
                {
                    self.cameras.entry(topic.clone()).or_insert(camera);
                }
                return false;
            }
            Kind::Float32 => {
                let is_unit = lower(topic).ends_with(UNIT_TOPIC);
                let unit = float32(message.data, layout).map(decimal);
                if let Some(unit) = unit.filter(|unit| (1e-7..1.0).contains(unit))
                    && is_unit
                    && room(self.units.len())
                {
                    self.units.insert(topic.clone(), unit);
                }
                return false;
            }
            Kind::Other => return false,
        };
        match stored {
            Some(stored) if room(self.depth.len()) => {
                self.depth
                    .entry(topic.clone())
                    .or_insert_with(|| Candidate {
                        compressed,
                        stored,
                        notes: channel.metadata.clone(),
                    });
            }
            None if room(self.others.len()) => {
                self.others
                    .entry(topic.clone())
                    .or_insert_with(|| encoding.to_owned());
            }
            _ => {}
        }
        stored.is_some()
    }

    /// The topic asked for, else the best: named "depth", as the sensor saw it, not compressed.
    fn best(&self) -> Option<(&String, &Candidate)> {
        if let Some(wanted) = &self.wanted {
            return self.depth.get_key_value(wanted);
        }
        self.depth.iter().min_by_key(|(topic, candidate)| {
            let name = lower(topic);
            let foreign = name.contains("aligned") || name.contains("registered");
            (!name.contains("depth"), foreign, candidate.compressed)
        })
    }

    /// The camera of `topic`: the one whose own place in the tree of topics is nearest above it.
    fn camera_of(&self, topic: &str) -> Option<&(Calibration, bool)> {
        let place = |info: &'_ String| {
            let base = info.strip_suffix("/camera_info")?;
            let base = base.strip_suffix("/info").unwrap_or(base);
            is_above(base, topic).then_some(base.len())
        };
        let mut near: Vec<_> = self
            .cameras
            .iter()
            .filter_map(|(info, camera)| Some((place(info)?, camera)))
            .collect();
        near.sort_by_key(|(length, _)| *length);
        near.pop().map(|(_, camera)| camera)
    }

    fn unit_of(&self, topic: &str) -> Option<f64> {
        let above = self.units.iter().find(|(name, _)| {
            let base = name.len().saturating_sub(UNIT_TOPIC.len());
            name.get(..base).is_some_and(|base| is_above(base, topic))
        });
        above.map(|(_, unit)| *unit)
    }

    /// Picks the topic to read.
    ///
    /// # Errors
    /// There is no topic with depth, or not the one asked for; the topics that are there are named.
    pub(super) fn choose(self, path: &Path) -> Result<Found, CaptureError> {
        let list = |topics: Vec<String>| match topics.len() {
            0 => "none".to_owned(),
            _ => topics.join(", "),
        };
        let depth_topics = list(self.depth.keys().cloned().collect());
        let Some((topic, candidate)) = self.best() else {
            let others = self.others.iter();
            let others = others.map(|(topic, encoding)| format!("{topic} ({encoding})"));
            let (what, remedy) = match &self.wanted {
                Some(wanted) => (
                    format!("no depth images on topic {wanted}; depth topics: {depth_topics}"),
                    "name one of them with --topic",
                ),
                None => (
                    format!(
                        "no depth images (16UC1, mono16, 32FC1, compressedDepth); other images: {}",
                        list(others.collect())
                    ),
                    "give a recording with a depth topic",
                ),
            };
            return Err(input(path, what, remedy));
        };
        let shown = path.display();
        if self.depth.len() > 1 {
            tracing::info!("{shown}: topic {topic} of {depth_topics}; --topic chooses another");
        }
        let mut about = About::default();
        let camera = candidate.notes.get(CAMERA_NOTE);
        if let Some(camera) = camera.and_then(|text| serde_json::from_str::<Camera>(text).ok()) {
            about.said = Said::from(camera);
        } else {
            about.said.name = Some(topic.clone());
            if let Some((calibration, distorted)) = self.camera_of(topic) {
                about.calibration = Some(calibration.clone());
                if *distorted {
                    tracing::warn!(
                        "{shown}: lens distortion is not applied; the depth images must be rectified"
                    );
                }
            }
            about.said.depth_unit_m = self.unit_of(topic);
            // ROS enhancement proposal 118: depth integers are millimetres
            about.unit_m = (candidate.stored == Stored::Integers).then_some(DEFAULT_UNIT_M);
        }
        Ok(Found {
            topic: topic.clone(),
            notes: candidate.notes.clone(),
            about,
        })
    }
}

/// The shortest decimal that is this float: 0.001, not 0.0010000000474974513.
fn decimal(value: f32) -> f64 {
    value.to_string().parse().unwrap_or(f64::from(value))
}

fn lower(topic: &str) -> String {
    topic.to_ascii_lowercase().replace(' ', "_")
}

/// True where `base` is `topic` or a path above it.
fn is_above(base: &str, topic: &str) -> bool {
    topic
        .strip_prefix(base)
        .is_some_and(|rest| rest.is_empty() || rest.starts_with('/'))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::Intrinsics;

    fn camera(fx: f64) -> (Calibration, bool) {
        let (fy, cx, cy) = (fx, 1.0, 1.0);
        let calibration = Calibration::from_intrinsics(Intrinsics { fx, fy, cx, cy });
        (calibration, false)
    }

    #[test]
    fn the_camera_is_the_nearest_above() {
        let survey = Survey {
            cameras: [
                ("/cam/color/camera_info", 1.0),
                ("/cam/depth/camera_info", 2.0),
                ("/device_0/sensor_0/Depth_0/info/camera_info", 3.0),
                ("/device_0/sensor_1/Color_0/info/camera_info", 4.0),
            ]
            .map(|(topic, fx)| (topic.to_owned(), camera(fx)))
            .into(),
            units: [(
                "/device_0/sensor_0/option/Depth_Units/value".to_owned(),
                1e-4,
            )]
            .into(),
            ..Survey::default()
        };
        let fx = |topic| survey.camera_of(topic).map(|camera| camera.0.intrinsics.fx);
        assert_eq!(fx("/cam/depth/image_rect_raw"), Some(2.0));
        assert_eq!(fx("/cam/depth/image_rect_raw/compressedDepth"), Some(2.0));
        assert_eq!(fx("/cam/depthless/image"), None);
        assert_eq!(fx("/device_0/sensor_0/Depth_0/image/data"), Some(3.0));
        assert_eq!(
            survey.unit_of("/device_0/sensor_0/Depth_0/image/data"),
            Some(1e-4)
        );
        assert_eq!(
            survey.unit_of("/device_0/sensor_1/Depth_0/image/data"),
            None
        );
        assert_eq!(decimal(0.001f32), 0.001);
    }
}
