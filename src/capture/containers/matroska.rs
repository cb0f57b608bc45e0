//! Azure Kinect recordings: Matroska with a track `DEPTH` of 16-bit big-endian integers.
//!
//! Elements as in RFC 9559, of which only those that matter here are read: info, tracks, tags,
//! attachments, and the blocks of one track. The reader is our own because the calibration is an
//! attachment, and because arithmetic on a file's numbers has to be checked.

mod ebml;
mod kinect;

use super::{About, Container, DepthImage, Stamp, Stored, damaged};
use crate::capture::CaptureError;
use crate::capture::sequences::{input, pixel_count};
use ebml::{Body, Elements, children, signed16, text, unsigned, vint};
use std::path::{Path, PathBuf};

/// How every Matroska file begins.
pub(super) const MAGIC: [u8; 4] = [0x1a, 0x45, 0xdf, 0xa3];
/// Largest list of tracks or tags, and largest calibration file, bytes.
const MAX_DESCRIPTION: u64 = 16 << 20;
/// A codec that is told by a BITMAPINFOHEADER.
const VFW: &str = "V_MS/VFW/FOURCC";
/// The depth track's.
const CODEC: &[u8; 4] = b"b16g";

/// Element numbers.
mod id {
    pub(super) const SEGMENT: u32 = 0x1853_8067;
    pub(super) const INFO: u32 = 0x1549_a966;
    pub(super) const TIMESTAMP_SCALE: u32 = 0x2a_d7b1;
    pub(super) const TRACKS: u32 = 0x1654_ae6b;
    pub(super) const TRACK_ENTRY: u32 = 0xae;
    pub(super) const TRACK_NUMBER: u32 = 0xd7;
    pub(super) const TRACK_UID: u32 = 0x73c5;
    pub(super) const NAME: u32 = 0x536e;
    pub(super) const CODEC_ID: u32 = 0x86;
    pub(super) const CODEC_PRIVATE: u32 = 0x63a2;
    pub(super) const CONTENT_ENCODINGS: u32 = 0x6d80;
    pub(super) const VIDEO: u32 = 0xe0;
    pub(super) const PIXEL_WIDTH: u32 = 0xb0;
    pub(super) const PIXEL_HEIGHT: u32 = 0xba;
    pub(super) const TAGS: u32 = 0x1254_c367;
    pub(super) const TAG: u32 = 0x7373;
    pub(super) const SIMPLE_TAG: u32 = 0x67c8;
    pub(super) const TAG_NAME: u32 = 0x45a3;
    pub(super) const TAG_STRING: u32 = 0x4487;
    pub(super) const ATTACHMENTS: u32 = 0x1941_a469;
    pub(super) const ATTACHED_FILE: u32 = 0x61a7;
    pub(super) const FILE_NAME: u32 = 0x466e;
    pub(super) const FILE_DATA: u32 = 0x465c;
    pub(super) const CLUSTER: u32 = 0x1f43_b675;
    pub(super) const TIMESTAMP: u32 = 0xe7;
    pub(super) const SIMPLE_BLOCK: u32 = 0xa3;
    pub(super) const BLOCK_GROUP: u32 = 0xa0;
    pub(super) const BLOCK: u32 = 0xa1;
}

/// A track of 16-bit big-endian integers.
#[derive(Clone, Debug, Default)]
struct Track {
    number: u64,
    uid: u64,
    name: String,
    width: u64,
    height: u64,
    /// Compressed or encrypted blocks.
    encoded: bool,
}

/// What stands outside the clusters.
#[derive(Debug)]
struct Description {
    scale_ns: u64,
    tracks: Vec<Track>,
    other_codecs: Vec<String>,
    tags: Vec<(String, String)>,
    calibration: Option<Vec<u8>>,
}

/// The depth track of a file, read from its beginning.
pub(super) struct MatroskaImages {
    path: PathBuf,
    elements: Elements,
    about: About,
    track: Track,
    scale_ns: u64,
    /// Time of the file's zero on the device's clock, ns.
    start_ns: i64,
    cluster: u64,
    block: Vec<u8>,
}

impl MatroskaImages {
    /// Reads everything but the clusters, and goes back to the first of them.
    pub(super) fn open(path: &Path) -> Result<Self, CaptureError> {
        let mut elements = Elements::open(path)?;
        let description = Description::read(&mut elements, path)?;
        let track = description.depth_track(path)?;
        let pixels = pixel_count(track.width, track.height);
        pixels.map_err(|what| damaged(path, what))?;
        if track.encoded {
            let remedy = "remux it: mkvmerge --compression -1:none";
            return Err(input(
                path,
                "the depth track's blocks are compressed",
                remedy,
            ));
        }
        let mut about = About {
            // the sensor's integers are millimetres
            unit_m: Some(0.001),
            ..About::default()
        };
        about.said.name = Some(
            format!("{} {}", kinect::CAMERA, track.name)
                .trim()
                .to_owned(),
        );
        if let Some(bytes) = &description.calibration {
            let size = (track.width as u32, track.height as u32);
            match kinect::intrinsics(bytes, size) {
                Ok(intrinsics) => {
                    about.said.intrinsics = Some(intrinsics);
                    tracing::warn!(
                        "{}: lens distortion is not applied, and raw depth of this camera is not rectified",
                        path.display()
                    );
                }
                Err(what) => tracing::warn!("{}: {}: {what}", path.display(), kinect::FILE_NAME),
            }
        }
        let start = description.tag(kinect::START_TAG);
        let start_ns = start.and_then(|text| text.trim().parse().ok()).unwrap_or(0);
        elements.rewind()?;
        Ok(Self {
            path: path.to_owned(),
            elements,
            about,
            track,
            scale_ns: description.scale_ns,
            start_ns,
            cluster: 0,
            block: Vec::new(),
        })
    }

    /// Takes the block in `self.block`; false where it is another track's.
    fn take_block(&self, image: &mut DepthImage) -> Result<bool, String> {
        let early = "a block ends too early";
        let (number, rest) = vint(&self.block).ok_or(early)?;
        if number != self.track.number {
            return Ok(false);
        }
        let (head, data) = rest.split_first_chunk::<3>().ok_or(early)?;
        if head[2] & 0x06 != 0 {
            return Err("laced blocks are not read".to_owned());
        }
        let needed = self.track.width * self.track.height * 2;
        if data.len() as u64 != needed {
            return Err(format!(
                "an image of {} bytes, but {needed} are needed",
                data.len()
            ));
        }
        let (pairs, _) = data.as_chunks::<2>();
        image.integers.clear();
        image
            .integers
            .extend(pairs.iter().map(|pair| u16::from_be_bytes(*pair)));
        image.stored = Stored::Integers;
        (image.width, image.height) = (self.track.width as u32, self.track.height as u32);
        let ticks = i64::try_from(self.cluster).unwrap_or(i64::MAX);
        let ticks = ticks.saturating_add(signed16([head[0], head[1]]));
        let scale = i64::try_from(self.scale_ns).unwrap_or(i64::MAX);
        let ns = ticks.saturating_mul(scale).saturating_add(self.start_ns);
        image.time = Stamp::Clock(ns);
        image.number = None;
        Ok(true)
    }
}

impl Container for MatroskaImages {
    fn about(&self) -> &About {
        &self.about
    }

    fn next(&mut self, image: &mut DepthImage) -> Result<bool, CaptureError> {
        // masters that lead to blocks are entered, the rest is passed over: no stack is needed
        while let Some((element, body)) = self.elements.next()? {
            match element {
                id::SEGMENT | id::CLUSTER | id::BLOCK_GROUP => {}
                id::TIMESTAMP => {
                    self.elements.read(body, 8, &mut self.block)?;
                    self.cluster = unsigned(&self.block);
                }
                id::SIMPLE_BLOCK | id::BLOCK => {
                    let most = self.track.width * self.track.height * 2 + 64;
                    if body.known()? > most {
                        // another track's
                        self.elements.skip(body)?;
                        continue;
                    }
                    self.elements.read(body, most, &mut self.block)?;
                    let taken = self.take_block(image);
                    if taken.map_err(|what| damaged(&self.path, what))? {
                        return Ok(true);
                    }
                }
                _ => self.elements.skip(body)?,
            }
        }
        Ok(false)
    }
}

impl Description {
    fn read(elements: &mut Elements, path: &Path) -> Result<Self, CaptureError> {
        let mut description = Self {
            scale_ns: 1_000_000,
            tracks: Vec::new(),
            other_codecs: Vec::new(),
            tags: Vec::new(),
            calibration: None,
        };
        let mut bytes = Vec::new();
        loop {
            let step = description.step(elements, path, &mut bytes);
            match step {
                Ok(true) => {}
                Ok(false) => break,
                // a cut file is met again where its images end
                Err(_) if !description.tracks.is_empty() => break,
                Err(error) => return Err(error),
            }
        }
        Ok(description)
    }

    /// Reads the next element outside the clusters; false at the end, or where clusters of unknown
    /// length hide it.
    fn step(
        &mut self,
        elements: &mut Elements,
        path: &Path,
        bytes: &mut Vec<u8>,
    ) -> Result<bool, CaptureError> {
        let Some((element, body)) = elements.next()? else {
            return Ok(false);
        };
        match element {
            id::SEGMENT => {}
            id::INFO | id::TRACKS | id::TAGS | id::ATTACHMENTS => {
                elements.read(body, MAX_DESCRIPTION, bytes)?;
                let parsed = self.take(element, bytes);
                parsed.ok_or_else(|| damaged(path, "a damaged description of the tracks"))?;
            }
            _ if body == Body::Unknown => return Ok(false),
            _ => elements.skip(body)?,
        }
        Ok(true)
    }

    /// Keeps what an element says; `None` where it is damaged.
    fn take(&mut self, element: u32, bytes: &[u8]) -> Option<()> {
        for child in children(bytes) {
            let (child, bytes) = child?;
            match (element, child) {
                (id::INFO, id::TIMESTAMP_SCALE) => self.scale_ns = unsigned(bytes).max(1),
                (id::TRACKS, id::TRACK_ENTRY) => self.take_track(bytes)?,
                (id::TAGS, id::TAG) => self.take_tag(bytes)?,
                (id::ATTACHMENTS, id::ATTACHED_FILE) => {
                    let (mut name, mut data) = (String::new(), None);
                    for child in children(bytes) {
                        match child? {
                            (id::FILE_NAME, bytes) => name = text(bytes),
                            (id::FILE_DATA, bytes) => data = Some(bytes),
                            _ => {}
                        }
                    }
                    if name == kinect::FILE_NAME {
                        self.calibration = data.map(<[u8]>::to_vec);
                    }
                }
                _ => {}
            }
        }
        Some(())
    }

    fn take_track(&mut self, bytes: &[u8]) -> Option<()> {
        let (mut track, mut codec, mut fourcc) = (Track::default(), String::new(), None);
        for child in children(bytes) {
            match child? {
                (id::TRACK_NUMBER, bytes) => track.number = unsigned(bytes),
                (id::TRACK_UID, bytes) => track.uid = unsigned(bytes),
                (id::NAME, bytes) => track.name = text(bytes),
                (id::CODEC_ID, bytes) => codec = text(bytes),
                // a BITMAPINFOHEADER, its compression at byte 16
                (id::CODEC_PRIVATE, bytes) => fourcc = bytes.get(16..20),
                (id::CONTENT_ENCODINGS, _) => track.encoded = true,
                (id::VIDEO, bytes) => {
                    for child in children(bytes) {
                        match child? {
                            (id::PIXEL_WIDTH, bytes) => track.width = unsigned(bytes),
                            (id::PIXEL_HEIGHT, bytes) => track.height = unsigned(bytes),
                            _ => {}
                        }
                    }
                }
                _ => {}
            }
        }
        if codec == VFW && fourcc.is_some_and(|fourcc| fourcc == CODEC) {
            self.tracks.push(track);
        } else {
            self.other_codecs.push(codec);
        }
        Some(())
    }

    fn take_tag(&mut self, bytes: &[u8]) -> Option<()> {
        for child in children(bytes) {
            let (id::SIMPLE_TAG, bytes) = child? else {
                continue;
            };
            let (mut name, mut value) = (String::new(), String::new());
            for child in children(bytes) {
                match child? {
                    (id::TAG_NAME, bytes) => name = text(bytes),
                    (id::TAG_STRING, bytes) => value = text(bytes),
                    _ => {}
                }
            }
            self.tags.push((name, value));
        }
        Some(())
    }

    fn tag(&self, name: &str) -> Option<&str> {
        let found = self.tags.iter().find(|(tag, _)| tag == name);
        found.map(|(_, value)| value.as_str())
    }

    /// The track that the tags or its name call depth, else the only one of its codec.
    fn depth_track(&self, path: &Path) -> Result<Track, CaptureError> {
        let tagged: Option<u64> = self.tag(kinect::DEPTH_TAG).and_then(|uid| uid.parse().ok());
        let by_tag = self.tracks.iter().find(|track| Some(track.uid) == tagged);
        let by_name = || {
            self.tracks
                .iter()
                .find(|track| track.name == kinect::DEPTH_NAME)
        };
        let only = || self.tracks.first().filter(|_| self.tracks.len() == 1);
        by_tag
            .or_else(by_name)
            .or_else(only)
            .cloned()
            .ok_or_else(|| {
                let what = format!(
                    "no depth track: {} tracks of b16g, others: {}",
                    self.tracks.len(),
                    self.other_codecs.join(", ")
                );
                input(path, what, "give a recording of an Azure Kinect with depth")
            })
    }
}
