//! When a chunk is closed: what stands in closed chunks survives whatever comes later.

use super::message::FrameHeader;
use std::time::{Duration, Instant};

/// A chunk is closed when its frames span this much stream time, ns.
pub(super) const STREAM_NS: u64 = 500_000_000;
/// A chunk is closed when it is this old.
pub(super) const AGE: Duration = Duration::from_millis(500);
/// A chunk is closed when it holds this many bytes.
const BYTES: usize = 4 << 20;

/// What the rule wants to know of a message.
#[derive(Clone, Copy)]
pub(super) enum Kind<'a> {
    /// A frame of the camera of this name.
    Frame(&'a str, FrameHeader),
    Other,
}

/// The chunk that is open.
#[derive(Default)]
pub(super) struct Chunk {
    /// When its first message came; `None` while it is empty.
    since: Option<Instant>,
    /// Its first frame: camera and device time, ns. Other cameras may have a clock of their own.
    first: Option<(String, i64)>,
    /// Bytes of its messages.
    pub bytes: usize,
    pub messages: usize,
}

impl Chunk {
    pub fn is_open(&self) -> bool {
        self.since.is_some()
    }

    pub fn open(&mut self, now: Instant) {
        self.since.get_or_insert(now);
    }

    /// Whether the chunk must be closed before a message of `bytes` goes in.
    pub fn is_full(&self, kind: Kind<'_>, bytes: usize, now: Instant) -> bool {
        let Some(since) = self.since else {
            return false;
        };
        let (span, key) = match (kind, &self.first) {
            (Kind::Frame(camera, header), Some((first, ns))) if camera == first => {
                (header.time.device_ns.abs_diff(*ns), header.key)
            }
            _ => (0, false),
        };
        // at a key frame a little early, so that a lost chunk costs few frames
        let early = key && span >= STREAM_NS / 2;
        span >= STREAM_NS || self.is_old(now, since) || self.bytes + bytes > BYTES || early
    }

    /// Whether the chunk has waited long enough, at `now`.
    pub fn is_due(&self, now: Instant) -> bool {
        self.since.is_some_and(|since| self.is_old(now, since))
    }

    fn is_old(&self, now: Instant, since: Instant) -> bool {
        now.saturating_duration_since(since) >= AGE
    }

    /// A message has gone in.
    pub fn add(&mut self, kind: Kind<'_>, bytes: usize) {
        if let (Kind::Frame(camera, header), None) = (kind, &self.first) {
            self.first = Some((camera.to_owned(), header.time.device_ns));
        }
        self.bytes += bytes;
        self.messages += 1;
    }
}
