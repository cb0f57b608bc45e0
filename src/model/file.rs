//! The model file: one MCAP with the scene's description and its parts (`codec/FORMAT.md`,
//! chapter 5).
//!
//! Small and whole: written at once from memory, read at once into it. A file that was cut or
//! damaged gives the parts before the damage, which are the coarser scales.

use super::{Geometry, Part, Scene};
use crate::codec::polar::PolarCodecError;
use crate::recording::{RecordingError, Target};
use mcap::read::{LinearReader, MessageStream, Options};
use mcap::records::{MessageHeader, Record, op};
use mcap::{MAGIC, McapError};
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{Cursor, Read};
use std::path::{Path, PathBuf};

/// Profile in the MCAP header: what tells a model from a recording.
pub const PROFILE: &str = "saint-live.model";
/// Topic of the parts.
pub const TOPIC: &str = "model";
/// Message encoding of [`TOPIC`].
pub const ENCODING: &str = "saint-live.model/1";
/// Topic of the description, JSON.
pub const SCENE_TOPIC: &str = "scene";
/// Bytes in front of a part's payload.
const HEADER: usize = 8;
/// Opcode and length of an MCAP record, bytes.
const RECORD_PREFIX: usize = 9;
/// Largest file that is read, bytes.
const MAX_FILE: u64 = 8 << 30;

const SCHEMA: &str = "\
One object at one scale, little endian: u32 object, u32 scale (places in the lists of the `scene`
message), then a payload that src/codec/FORMAT.md of saint-live describes in chapters 2 and 4.
";

/// Why a model file cannot be written or read.
#[derive(Debug, thiserror::Error)]
pub enum ModelFileError {
    /// The file cannot be read or written, as for recordings.
    #[error(transparent)]
    File(#[from] RecordingError),
    /// The input is no model.
    #[error("{}: {what}", .path.display())]
    NotAModel {
        /// The file.
        path: PathBuf,
        /// Why not, and what to do.
        what: String,
    },
    /// A part's payload contradicts its format.
    #[error("{}: {part}: {source}", .path.display())]
    Part {
        /// The file.
        path: PathBuf,
        /// Which one.
        part: String,
        /// What is wrong.
        source: PolarCodecError,
    },
    /// No such object or scale.
    #[error("{}: has no {what} {wanted}; it has {}", .path.display(), .known.join(", "))]
    NoSuch {
        /// The file.
        path: PathBuf,
        /// `object` or `scale`.
        what: &'static str,
        /// The one asked for.
        wanted: String,
        /// Those there are.
        known: Vec<String>,
    },
}

/// True where the file is a model by its first bytes; false also where it cannot be read.
#[must_use]
pub fn is_model(path: &Path) -> bool {
    let mut begin = [0; 64];
    let read = File::open(path).and_then(|mut file| {
        let mut held = 0;
        while held < begin.len() {
            match file.read(&mut begin[held..])? {
                0 => break,
                more => held += more,
            }
        }
        Ok(held)
    });
    read.is_ok_and(|held| has_profile(&begin[..held]))
}

fn has_profile(bytes: &[u8]) -> bool {
    let records = LinearReader::new_with_options(bytes, Options::IgnoreEndMagic.into());
    let first = records.ok().and_then(|mut records| records.next());
    matches!(first, Some(Ok(Record::Header(header))) if header.profile == PROFILE)
}

/// The bytes of a model file.
///
/// # Errors
/// What the container says; `target` is the name in its message.
pub fn encode(scene: &Scene, parts: &[Part], target: &str) -> Result<Vec<u8>, ModelFileError> {
    let refused = |what: &dyn std::fmt::Display| RecordingError::Container {
        target: target.to_owned(),
        what: what.to_string(),
    };
    let text = serde_json::to_vec(scene).map_err(|e| refused(&e))?;
    let write = || -> Result<Vec<u8>, McapError> {
        let mut writer = mcap::WriteOptions::new()
            .profile(PROFILE)
            .library(scene.generator.as_str())
            .chunk_size(None) // closed here, one a scale
            .compression(None)
            .create(Cursor::new(Vec::new()))?;
        let none = BTreeMap::new();
        let described = writer.add_schema("saint-live.scene", "", b"")?;
        let described = writer.add_channel(described, SCENE_TOPIC, "json", &none)?;
        let coded = writer.add_schema("saint-live.model", "text", SCHEMA.as_bytes())?;
        let coded = writer.add_channel(coded, TOPIC, ENCODING, &none)?;
        let header = |channel_id, sequence: usize| MessageHeader {
            channel_id,
            sequence: sequence as u32,
            log_time: 0,
            publish_time: 0,
        };
        writer.write_to_known_channel(&header(described, 0), &text)?;
        let mut message = Vec::new();
        let mut scale = None;
        for (number, part) in parts.iter().enumerate() {
            if scale != Some(part.info.scale) {
                writer.flush()?;
                scale = Some(part.info.scale);
            }
            message.clear();
            message.extend_from_slice(&part.info.object.to_le_bytes());
            message.extend_from_slice(&part.info.scale.to_le_bytes());
            message.extend_from_slice(&part.payload);
            writer.write_to_known_channel(&header(coded, number), &message)?;
        }
        writer.finish()?;
        Ok(writer.into_inner().into_inner())
    };
    Ok(write().map_err(|e| refused(&e))?)
}

/// Writes a model file; says its size.
///
/// # Errors
/// The output exists or cannot be written.
pub fn write(scene: &Scene, parts: &[Part], target: Target) -> Result<u64, ModelFileError> {
    let bytes = encode(scene, parts, &target.name())?;
    target.put(&bytes)?;
    Ok(bytes.len() as u64)
}

/// A model file in memory.
#[derive(Clone, Debug, PartialEq)]
pub struct ModelFile {
    /// Its path, for messages.
    pub path: PathBuf,
    /// Its size.
    pub bytes: u64,
    /// The description.
    pub scene: Scene,
    /// The parts that are whole, in the order of the file.
    pub parts: Vec<Part>,
    /// What is wrong behind them.
    pub damage: Option<String>,
}

impl ModelFile {
    /// Reads a file. Damage behind a whole description is no error but kept.
    ///
    /// # Errors
    /// The file cannot be read or is no model.
    pub fn read(path: &Path) -> Result<Self, ModelFileError> {
        let unreadable = |source| RecordingError::Unreadable {
            path: path.to_owned(),
            source,
        };
        let mut file = File::open(path).map_err(unreadable)?;
        let length = file.metadata().map_err(unreadable)?.len();
        if length > MAX_FILE {
            return Err(ModelFileError::NotAModel {
                path: path.to_owned(),
                what: format!("has {length} bytes, the limit of a model is {MAX_FILE}"),
            });
        }
        let mut bytes = Vec::with_capacity(length as usize);
        file.read_to_end(&mut bytes).map_err(unreadable)?;
        Self::parse(&bytes, path)
    }

    /// Reads the bytes of a file. Safe on any bytes.
    ///
    /// # Errors
    /// They are no model.
    pub fn parse(bytes: &[u8], path: &Path) -> Result<Self, ModelFileError> {
        let foreign = |what: String| ModelFileError::NotAModel {
            path: path.to_owned(),
            what,
        };
        if !has_profile(bytes) {
            let what = "is no model file; give one written by `saint-live model`";
            return Err(foreign(what.to_owned()));
        }

        let sound = before_ill_chunk(bytes);
        let messages = MessageStream::new_with_options(sound, Options::IgnoreEndMagic.into());
        let messages = messages.map_err(|e| foreign(e.to_string()))?;
        let mut scene: Option<Scene> = None;
        let mut parts: Vec<Part> = Vec::new();
        let mut damage = None;
        for message in messages {
            let message = match message {
                Ok(message) => message,
                Err(error) => {
                    damage = Some(error.to_string());
                    break;
                }
            };
            let (topic, encoding) = (&message.channel.topic, &message.channel.message_encoding);
            if topic == SCENE_TOPIC && encoding == "json" && scene.is_none() {
                let read = serde_json::from_slice(&message.data);
                scene = Some(read.map_err(|e| foreign(format!("its description: {e}")))?);
            }
            if topic == TOPIC && encoding == ENCODING {
                let part = scene
                    .as_ref()
                    .map(|scene| part(scene, parts.len(), &message.data));
                match part.unwrap_or_else(|| Err("a part stands before the description".into())) {
                    Ok(part) => parts.push(part),
                    Err(what) => {
                        damage = Some(what);
                        break;
                    }
                }
            }
        }
        if sound.len() < bytes.len() {
            let at = sound.len();
            damage = Some(format!(
                "the records of the chunk at byte {at} do not end with it"
            ));
        }
        let Some(scene) = scene else {
            let why = damage.unwrap_or_else(|| "it holds no description".to_owned());
            return Err(foreign(format!("is no whole model: {why}; make it again")));
        };
        if damage.is_none() && parts.len() != scene.parts.len() {
            damage = Some(format!(
                "{} parts are there, {} are described",
                parts.len(),
                scene.parts.len()
            ));
        }
        Ok(Self {
            path: path.to_owned(),
            bytes: bytes.len() as u64,
            scene,
            parts,
            damage,
        })
    }

    /// The parts of one scale, by the number of spheres it was made for (the finest there is
    /// where none is given), and of one object by name (all where none is given).
    ///
    /// # Errors
    /// [`ModelFileError::NoSuch`] lists what there is.
    pub fn select(
        &self,
        scale: Option<u32>,
        object: Option<&str>,
    ) -> Result<Vec<&Part>, ModelFileError> {
        let no_such = |what, wanted: String, known| ModelFileError::NoSuch {
            path: self.path.clone(),
            what,
            wanted,
            known,
        };
        let whole = |scale: u32| self.parts.iter().any(|p| p.info.scale == scale);
        let there: Vec<u32> = (0..self.scene.scales.len() as u32)
            .filter(|&s| whole(s))
            .collect();
        let asked = |s: &&u32| scale.is_none_or(|n| self.scene.scales[**s as usize] == n);
        let chosen = there.iter().rev().find(asked).ok_or_else(|| {
            let names = there
                .iter()
                .map(|&s| self.scene.scales[s as usize].to_string());
            let wanted = scale.map_or_else(|| "whole".to_owned(), |n| n.to_string());
            no_such("scale", wanted, names.collect())
        })?;
        let objects = &self.scene.objects;
        if let Some(name) = object
            && !objects.iter().any(|o| o.name == name)
        {
            let names = objects.iter().map(|o| o.name.clone()).collect();
            return Err(no_such("object", name.to_owned(), names));
        }
        let named = |p: &&Part| {
            let own = &objects[p.info.object as usize].name;
            object.is_none_or(|name| own == name)
        };
        let of_scale = self.parts.iter().filter(|p| p.info.scale == *chosen);
        Ok(of_scale.filter(named).collect())
    }

    /// Decodes a part.
    ///
    /// # Errors
    /// [`ModelFileError::Part`].
    pub fn decode(&self, part: &Part) -> Result<Geometry, ModelFileError> {
        Geometry::decode(&part.payload).map_err(|source| ModelFileError::Part {
            path: self.path.clone(),
            part: format!(
                "object {} at scale {}",
                self.scene.objects[part.info.object as usize].name,
                self.scene.scales[part.info.scale as usize]
            ),
            source,
        })
    }
}

/// The bytes before the first chunk whose records do not end with it: the reader of messages takes
/// for granted that they do.
fn before_ill_chunk(bytes: &[u8]) -> &[u8] {
    let mut at = MAGIC.len();
    while let Some((opcode, body)) = record(bytes, at) {
        if opcode == op::CHUNK && !is_filled(body) {
            return &bytes[..at];
        }
        at += RECORD_PREFIX + body.len();
    }
    bytes
}

/// Opcode and body of the record at a place.
fn record(bytes: &[u8], at: usize) -> Option<(u8, &[u8])> {
    let (opcode, behind) = bytes.get(at..)?.split_first()?;
    let (length, behind) = behind.split_first_chunk()?;
    let length = usize::try_from(u64::from_le_bytes(*length)).ok()?;
    Some((*opcode, behind.get(..length)?))
}

/// Whether an uncompressed chunk holds whole records.
fn is_filled(chunk: &[u8]) -> bool {
    // two times, size, checksum; then the compression's name, the bytes' number, the bytes
    let Some((_, named)) = chunk.split_at_checked(28) else {
        return false;
    };
    let Some((&[0, 0, 0, 0], stated)) = named.split_first_chunk() else {
        // the reader of messages refuses compression
        return true;
    };
    let Some((length, records)) = stated.split_first_chunk() else {
        return false;
    };
    let length = u64::from_le_bytes(*length);
    let mut at = 0;
    while let Some((_, body)) = record(records, at) {
        at += RECORD_PREFIX + body.len();
    }
    at == records.len() && at as u64 == length
}

/// The part that `message` holds and the description lists in this place.
fn part(scene: &Scene, place: usize, message: &[u8]) -> Result<Part, String> {
    let number = |at: usize| {
        let four = message.get(at..).and_then(|b| b.first_chunk());
        four.map(|b| u32::from_le_bytes(*b))
    };
    let (Some(object), Some(scale)) = (number(0), number(4)) else {
        return Err(format!("a part of {} bytes has no header", message.len()));
    };
    let info = scene.parts.get(place);
    let info = info.filter(|info| (info.object, info.scale) == (object, scale));
    let known = (object as usize) < scene.objects.len() && (scale as usize) < scene.scales.len();
    let Some(info) = info.filter(|_| known) else {
        return Err(format!(
            "part {place} is of object {object} at scale {scale}, which is not described there"
        ));
    };
    Ok(Part {
        info: info.clone(),
        payload: message[HEADER..].to_vec(),
    })
}
