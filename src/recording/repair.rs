//! A cut or damaged file becomes whole: everything that can be proven right is written anew.
//!
//! Messages are copied as they are, with their times; cameras, notes and statistics come along.
//! Of a damaged chunk those frames are kept that prove themselves (header and payload); a frame
//! whose reference was lost is left out, up to the next key frame. Attachments whose checksum is
//! right and metadata that can be read come along, behind the last frame.

use super::beside::{Beside, Walk};
use super::calibration::camera_text;
use super::channels::Channel;
use super::chunk::Kind;
use super::container::Source;
use super::index::Index;
use super::loaded::{Care, Item, Loaded};
use super::open::generator;
use super::part::{Message, Part};
use super::tally;
use super::topics::Role;
use super::{Damage, RecordingError, Sync, Target, message, raw};
use crate::frame::Camera;
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::Path;

/// Name of the metadata record that says what a repair did.
const RECORD: &str = "saint-live.repair";

/// What a repair has done.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct RepairReport {
    /// The damaged file.
    pub source: String,
    /// The whole one.
    pub target: String,
    /// Frames written, of all cameras.
    pub frames_kept: u64,
    /// Frames known to be lost: damaged, or without the frame they refer to. What a cut took is
    /// not known.
    pub frames_lost: u64,
    /// Messages of other channels written.
    pub messages_kept: u64,
    /// Attachments written.
    pub attachments_kept: u64,
    /// Metadata records of others written.
    pub metadata_kept: u64,
    /// Size of the whole file, bytes.
    pub bytes: u64,
    /// The file was cut.
    pub cut: bool,
    /// The file's index was missing or wrong.
    pub index_rebuilt: bool,
    /// Places that were damaged; for a cut file the last is the cut.
    pub damaged: Vec<Damage>,
}

/// Writes what is whole in `path` to `target`.
///
/// # Errors
/// As [`RecordingReader::open`](super::RecordingReader::open), or a write error of the target.
pub fn repair(path: &Path, target: Target) -> Result<RepairReport, RecordingError> {
    let source = Source::open(path)?;
    let index = Index::read(&source)?;
    let mut places: Vec<_> = index.chunks.iter().chain(&index.damaged).collect();
    places.sort_by_key(|place| place.offset);
    let name = target.name();
    let profile = match index.channels.are_raw() {
        true => raw::PROFILE,
        false => "",
    };
    let mut copy = Copy {
        part: Part::create(target, Sync::End, profile)?,
        origin: path.file_name().map_or_else(
            || path.display().to_string(),
            |n| n.to_string_lossy().into_owned(),
        ),
        channels: BTreeMap::new(),
        cameras: BTreeMap::new(),
        known: known_cameras(&index),
        report: RepairReport {
            source: path.display().to_string(),
            target: name,
            cut: index.cut.is_some(),
            index_rebuilt: index.rebuilt,
            ..RepairReport::default()
        },
    };
    // of two channels of one topic the one that can be read describes the camera
    let all = index.channels.by_id.values();
    let (described, others): (Vec<_>, Vec<_>) = all.partition(|c| c.camera().is_some());
    for channel in described.into_iter().chain(others) {
        copy.channel(channel)?;
    }
    let mut known = index.channels.clone();
    let mut loaded = Loaded::default();
    let mut faults = index.faults.iter().peekable();
    for place in places.iter().copied() {
        while let Some(fault) = faults.next_if(|fault| fault.offset <= place.offset) {
            copy.damage(fault.offset, &fault.what);
        }
        if let Err(what) = loaded.load(&source, place, Care::Whole, &mut known) {
            if !index.damaged.contains(place) {
                copy.damage(place.offset, &what);
            }
            // what is still there is better than nothing; failing again leaves it empty
            let _ = loaded.load(&source, place, Care::Damaged, &mut known);
        }
        for item in &loaded.items {
            if let Some(channel) = known.by_id.get(&item.header.channel_id) {
                copy.message(channel, item, &loaded.bytes)?;
            }
        }
    }
    for fault in faults.chain(&index.cut) {
        copy.damage(fault.offset, &fault.what);
    }
    let mut beside = Walk::new(&source, &places);
    while let Some(found) = beside.next() {
        copy.beside(found)?;
    }
    copy.finish(&index)
}

fn known_cameras(index: &Index) -> BTreeMap<String, Camera> {
    let cameras = index.channels.cameras().into_iter();
    cameras
        .map(|(name, camera, _)| (name.to_owned(), camera))
        .collect()
}

/// How far one camera has come.
#[derive(Default)]
struct Progress {
    /// Number of the frame last kept.
    last: Option<u64>,
    /// Something was lost since: the next frame must decode alone, or say that it refers to `last`.
    broken: bool,
    kept: u64,
    /// Numbers skipped where something was lost, and frames left out.
    skipped: u64,
}

struct Copy {
    part: Part,
    /// Name of the damaged file.
    origin: String,
    /// Numbers in the new file, by topic and whether frames are in them: a damaged description may
    /// leave two channels of one topic.
    channels: BTreeMap<(String, bool), u16>,
    cameras: BTreeMap<String, Progress>,
    /// As the `saint` channels describe them.
    known: BTreeMap<String, Camera>,
    report: RepairReport,
}

impl Copy {
    fn damage(&mut self, offset: u64, what: &str) {
        for camera in self.cameras.values_mut() {
            camera.broken = true;
        }
        self.report.damaged.push(Damage {
            offset,
            frame: self.cameras.values().map(|camera| camera.kept).sum(),
            what: what.to_owned(),
        });
    }

    fn channel(&mut self, channel: &Channel) -> Result<u16, RecordingError> {
        let frames = channel.frames_of().is_some();
        let place = (channel.topic.clone(), frames);
        if let Some(id) = self.channels.get(&place) {
            return Ok(*id);
        }
        let mut metadata = channel.metadata.clone();
        if frames {
            metadata.insert("repaired_from".to_owned(), self.origin.clone());
        }
        let schema = &channel.schema;
        let id = self.part.add_channel(
            &channel.topic,
            &channel.encoding,
            (&schema.name, &schema.encoding, &schema.text),
            &metadata,
        )?;
        self.channels.insert(place, id);
        Ok(id)
    }

    fn message(
        &mut self,
        channel: &Channel,
        item: &Item,
        bytes: &[u8],
    ) -> Result<(), RecordingError> {
        let mut kind = Kind::Other;
        if let Some(camera) = channel.frames_of() {
            let progress = self.cameras.entry(camera.to_owned()).or_default();
            let Some((header, payload)) = &item.frame else {
                // an image of a channel that does not tell times would pass for one of another
                progress.broken = true;
                return Ok(());
            };
            let reference = match header.key {
                true => None,
                false => bytes.get(payload.clone()).and_then(message::reference),
            };
            let follows = match reference {
                // an image stands alone
                _ if channel.is_raw() => true,
                Some(reference) => progress.last == Some(reference),
                None => header.key || !progress.broken,
            };
            if !follows {
                progress.broken = true;
                return Ok(());
            }
            if let Some(last) = progress.last.filter(|_| progress.broken) {
                progress.skipped += header.sequence.saturating_sub(last + 1);
            }
            progress.last = Some(header.sequence);
            progress.broken = false;
            progress.kept += 1;
            kind = Kind::Frame(camera, *header);
            self.describe_camera(camera, item)?;
        } else {
            self.report.messages_kept += 1;
        }
        let channel_id = self.channel(channel)?;
        self.part.put(&Message {
            channel: channel_id,
            topic: &channel.topic,
            sequence: item.header.sequence,
            log_time: item.header.log_time,
            publish_time: item.header.publish_time,
            kind,
            data: bytes.get(item.data.clone()).unwrap_or_default(),
        })
    }

    /// The camera's own message, where it was lost: the `saint` channel knows the camera, too.
    fn describe_camera(&mut self, camera: &str, item: &Item) -> Result<(), RecordingError> {
        let topic = Role::Camera.topic(camera);
        if self.part.tally.channels.contains_key(&topic) {
            return Ok(());
        }
        let place = (topic, false);
        let (Some(facts), Some(channel)) = (self.known.get(camera), self.channels.get(&place))
        else {
            return Ok(());
        };
        self.part.put(&Message {
            channel: *channel,
            topic: &place.0,
            sequence: 0,
            log_time: item.header.log_time,
            publish_time: item.header.publish_time,
            kind: Kind::Other,
            data: camera_text(facts).as_bytes(),
        })
    }

    fn beside(&mut self, found: Result<Beside, (u64, String)>) -> Result<(), RecordingError> {
        match found {
            Ok(Beside::Attachment(attachment)) => {
                self.part.attachment(&attachment)?;
                self.report.attachments_kept += 1;
            }
            // written anew
            Ok(Beside::Metadata(known)) if known.name == tally::RECORD => {}
            Ok(Beside::Metadata(other)) => {
                self.part.metadata(&other.name, other.metadata)?;
                self.report.metadata_kept += 1;
            }
            Err((offset, what)) => self.damage(offset, &what),
        }
        Ok(())
    }

    fn finish(mut self, index: &Index) -> Result<RepairReport, RecordingError> {
        let report = &mut self.report;
        for (name, camera) in &self.cameras {
            report.frames_kept += camera.kept;
            report.frames_lost += match index.tally.streams.get(name) {
                // the index knows how many there were
                Some(tally) if !index.rebuilt => tally.frames - camera.kept.min(tally.frames),
                _ => camera.skipped,
            };
        }
        let facts = [
            ("source", report.source.clone()),
            ("frames_kept", report.frames_kept.to_string()),
            ("frames_lost", report.frames_lost.to_string()),
            ("cut", report.cut.to_string()),
            ("generator", generator()),
        ];
        let facts = facts.map(|(name, value)| (name.to_owned(), value));
        self.part.metadata(RECORD, BTreeMap::from(facts))?;
        self.part.finish()?;
        self.report.bytes = self.part.kept_bytes;
        Ok(self.report)
    }
}
