//! The channels of a file, and what they say of its cameras.

use super::container::{parse, records};
use super::topics::{self, Role};
use super::{SAINT_ENCODING, description, raw};
use crate::frame::Camera;
use mcap::records::Record;
use std::collections::BTreeMap;

/// A schema as the file has it.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct Schema {
    pub name: String,
    pub encoding: String,
    pub text: Vec<u8>,
}

/// One channel.
#[derive(Clone, Debug)]
pub(super) struct Channel {
    pub topic: String,
    pub encoding: String,
    pub schema: Schema,
    pub metadata: BTreeMap<String, String>,
}

impl Channel {
    /// True where it carries the depth images of a raw capture.
    pub fn is_raw(&self) -> bool {
        self.topic == raw::IMAGE_TOPIC
            && self.encoding == "cdr"
            && self.metadata.contains_key(raw::CAMERA_NOTE)
    }

    /// The camera whose frames it carries, where it does; that of a raw capture has no name.
    pub fn frames_of(&self) -> Option<&str> {
        if self.is_raw() {
            return Some("");
        }
        let (camera, _) = topics::split(&self.topic);
        (self.encoding == SAINT_ENCODING && self.topic == Role::Saint.topic(camera))
            .then_some(camera)
    }

    /// The camera whose frames it carries, as it describes it.
    pub fn camera(&self) -> Option<Camera> {
        self.frames_of()?;
        serde_json::from_str(self.metadata.get(self.camera_note())?).ok()
    }

    fn camera_note(&self) -> &'static str {
        if self.is_raw() {
            raw::CAMERA_NOTE
        } else {
            "camera"
        }
    }

    /// True where it belongs to `camera`; to the only one, which has no name, all belong.
    pub fn belongs_to(&self, camera: &str) -> bool {
        camera.is_empty() || topics::split(&self.topic).0 == camera
    }

    /// True where it carries the colour images of `camera`.
    pub fn is_color_of(&self, camera: &str) -> bool {
        let raw = camera.is_empty() && self.topic == raw::COLOR_TOPIC;
        self.encoding == "cdr" && (raw || self.topic == Role::Color.topic(camera))
    }

    /// True where it carries the statistics of `camera`.
    pub fn is_statistics_of(&self, camera: &str) -> bool {
        self.encoding == "json" && self.topic == Role::Statistics.topic(camera)
    }
}

/// The channels met so far.
#[derive(Clone, Debug, Default)]
pub(super) struct Channels {
    schemas: BTreeMap<u16, Schema>,
    pub by_id: BTreeMap<u16, Channel>,
}

impl Channels {
    /// Takes schema and channel records, and ours that repeats them; the first definition of a
    /// number stays.
    pub fn learn(&mut self, record: &Record<'_>) {
        match record {
            Record::Schema { header, data } => {
                self.schemas.entry(header.id).or_insert_with(|| Schema {
                    name: header.name.clone(),
                    encoding: header.encoding.clone(),
                    text: data.to_vec(),
                });
            }
            Record::Channel(channel) if !self.by_id.contains_key(&channel.id) => {
                let schema = self.schemas.get(&channel.schema_id).cloned();
                let facts = Channel {
                    topic: channel.topic.clone(),
                    encoding: channel.message_encoding.clone(),
                    schema: schema.unwrap_or_default(),
                    metadata: channel.metadata.clone(),
                };
                self.by_id.insert(channel.id, facts);
            }
            Record::Unknown { opcode, data } if *opcode == description::OPCODE => {
                for (code, body, _) in records(data).flatten() {
                    match parse(code, body) {
                        Ok(record @ Record::Channel(_)) => self.learn(&record),
                        _ => return,
                    }
                }
            }
            _ => {}
        }
    }

    /// True where they are those of a raw capture.
    pub fn are_raw(&self) -> bool {
        self.by_id.values().any(Channel::is_raw)
    }

    /// The cameras in the order of the recording, each with what the channel of its frames says:
    /// name, camera and notes.
    pub fn cameras(&self) -> Vec<(&str, Camera, BTreeMap<String, String>)> {
        let saint = self.by_id.values().filter_map(|channel| {
            let name = channel.frames_of()?;
            let camera = channel.camera()?;
            let mut notes = channel.metadata.clone();
            notes.remove(channel.camera_note());
            Some((name, camera, notes))
        });
        saint.collect()
    }

    /// The topics, for messages.
    pub fn topics(&self) -> String {
        let topics: Vec<_> = self.by_id.values().map(|c| c.topic.as_str()).collect();
        if topics.is_empty() {
            "none".to_owned()
        } else {
            topics.join(", ")
        }
    }
}
