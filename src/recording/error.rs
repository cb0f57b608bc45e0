//! What can go wrong with a recording, by what the caller does about it.

#[cfg(doc)]
use super::MAX_MESSAGE;
use std::io;
use std::path::PathBuf;

/// Why a recording cannot be written or read; a variant is what the caller does about it.
#[derive(Debug, thiserror::Error)]
pub enum RecordingError {
    /// The output exists and nobody asked to overwrite it: usage, exit 2.
    #[error("{} exists already; give another name or --overwrite", .path.display())]
    Exists {
        /// The file.
        path: PathBuf,
    },
    /// The output cannot be opened for writing: exit 5.
    #[error("cannot write {}: {source}; name a file in a folder that exists and may be written", .path.display())]
    Unwritable {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// No room is left: exit 5.
    #[error(
        "{target}: no space left; {frames} frames ({bytes} bytes) are kept; free some space and record again"
    )]
    DiskFull {
        /// File or pipe.
        target: String,
        /// Whole frames that are safe.
        frames: u64,
        /// Bytes that are safe.
        bytes: u64,
        /// What the system said.
        source: io::Error,
    },
    /// The file may not grow further (a file system's or a user's limit): exit 5.
    #[error(
        "{target}: the file may not grow beyond {bytes} bytes ({source}); {frames} frames are kept; record in parts with --split"
    )]
    FileLimit {
        /// The file.
        target: String,
        /// Whole frames that are safe.
        frames: u64,
        /// Bytes that are safe.
        bytes: u64,
        /// What the system said.
        source: io::Error,
    },
    /// The file was deleted while it was written: exit 5.
    #[error(
        "{target}: was deleted while it was written; its {frames} frames are lost; name a folder that stays and record again"
    )]
    Vanished {
        /// The file.
        target: String,
        /// Frames that were in it.
        frames: u64,
    },
    /// A recording in parts goes to files only: usage, exit 2.
    #[error("{target} takes one recording, not parts; name a file with -o or leave --split out")]
    NoParts {
        /// The pipe or device.
        target: String,
    },
    /// The reading end of the pipe has gone.
    #[error("{target}: the reader has closed the pipe after {frames} frames ({bytes} bytes)")]
    Closed {
        /// File or pipe.
        target: String,
        /// Whole frames that were handed over.
        frames: u64,
        /// Bytes that were handed over.
        bytes: u64,
        /// What the system said.
        source: io::Error,
    },
    /// Any other write error: exit 5.
    #[error("{target}: writing failed ({source}); {frames} frames ({bytes} bytes) are kept")]
    Write {
        /// File or pipe.
        target: String,
        /// Whole frames that are safe.
        frames: u64,
        /// Bytes that are safe.
        bytes: u64,
        /// What the system said.
        source: io::Error,
    },
    /// The writer was used after it had failed or finished: a fault of the caller.
    #[error("{target}: the recording is closed; {frames} frames are kept")]
    Finished {
        /// File or pipe.
        target: String,
        /// Whole frames that are safe.
        frames: u64,
    },
    /// A message is larger than [`MAX_MESSAGE`]; it was not written.
    #[error(
        "{target}: a message of {bytes} bytes on channel {topic} exceeds the limit of {limit}; it was not recorded"
    )]
    TooLarge {
        /// File or pipe.
        target: String,
        /// The channel.
        topic: String,
        /// Its size.
        bytes: usize,
        /// [`MAX_MESSAGE`].
        limit: usize,
    },
    /// The container's own code refused, for a reason that is not the output's.
    #[error("{target}: {what}")]
    Container {
        /// File or pipe.
        target: String,
        /// What it said.
        what: String,
    },
    /// The input cannot be opened or read: exit 4.
    #[error("cannot read {}: {source}; check the path and its permissions", .path.display())]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// The input is no recording of ours: exit 4.
    #[error("{}: {what}", .path.display())]
    NotARecording {
        /// The file.
        path: PathBuf,
        /// Why not, and what to do.
        what: String,
    },
    /// Bytes are missing or wrong from here on: exit 4. Frames before `frame` are whole; asking
    /// for the next frame again goes on at the next key frame after the damage.
    #[error("{}: damaged at byte {offset}, before frame {frame}: {what}; the {frame} frames before it are whole", .path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// Where in the file, bytes.
        offset: u64,
        /// Number of the first frame that is missing.
        frame: u64,
        /// What is wrong.
        what: String,
    },
    /// The file ends before its end mark: exit 4. Every frame before `frame` is whole.
    #[error("{}: cut at byte {offset}, after {frame} whole frames: {what}", .path.display())]
    Cut {
        /// The file.
        path: PathBuf,
        /// Where the whole part ends, bytes.
        offset: u64,
        /// Number of whole frames.
        frame: u64,
        /// What is missing.
        what: String,
    },
    /// The recording has no camera of this name.
    #[error("{}: has no camera `{name}`; it has {known}", .path.display())]
    NoSuchCamera {
        /// The file.
        path: PathBuf,
        /// The name asked for.
        name: String,
        /// The names there are.
        known: String,
    },
    /// A frame was asked for that the recording does not have.
    #[error("{}: frame {frame} was asked for, the recording has {frames} (0 to {})", .path.display(), .frames.saturating_sub(1))]
    NoSuchFrame {
        /// The file.
        path: PathBuf,
        /// The frame asked for.
        frame: u64,
        /// Frames there are.
        frames: u64,
    },
}

impl RecordingError {
    /// Frames that are safe in the output after a write error; `None` for other errors.
    #[must_use]
    pub fn kept_frames(&self) -> Option<u64> {
        match self {
            Self::DiskFull { frames, .. }
            | Self::FileLimit { frames, .. }
            | Self::Closed { frames, .. }
            | Self::Write { frames, .. }
            | Self::Finished { frames, .. } => Some(*frames),
            Self::Vanished { .. } => Some(0),
            _ => None,
        }
    }

    /// Adds what earlier parts of the same recording keep.
    pub(super) fn beside(mut self, earlier_frames: u64, earlier_bytes: u64) -> Self {
        match &mut self {
            Self::DiskFull { frames, bytes, .. }
            | Self::FileLimit { frames, bytes, .. }
            | Self::Closed { frames, bytes, .. }
            | Self::Write { frames, bytes, .. } => {
                *frames += earlier_frames;
                *bytes += earlier_bytes;
            }
            Self::Finished { frames, .. } => *frames += earlier_frames,
            _ => {}
        }
        self
    }
}
