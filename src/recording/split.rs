//! A recording in parts: when a part ends and what its file is called.

use super::{RecordingError, Target};
use std::io;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Times of frames are rounded by their source; so much is forgiven, ns.
const ROUNDING_NS: u128 = 1_000_000;

/// When a part of a recording ends. A new part begins with a key frame, so each plays alone.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Split {
    /// Before the key frame whose group of frames would make the file larger than this, bytes.
    /// The size of the group is not known yet; the largest one so far, and a quarter more, stands
    /// for it.
    Bytes(u64),
    /// At the first key frame after this much stream time.
    Time(Duration),
}

/// What a part has grown to.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Grown {
    /// Size of the file if it ended now, bytes.
    pub bytes: u64,
    /// Most bytes between two key frames.
    pub group: u64,
    /// Stream time it spans, ns.
    pub span_ns: u64,
}

impl Split {
    /// Whether the part ends before the key frame that comes now.
    pub(super) fn is_due(self, grown: Grown) -> bool {
        match self {
            Self::Bytes(most) => grown.bytes + grown.group + grown.group / 4 > most,
            // 30 frames of 33.333333 ms are a second
            Self::Time(most) => u128::from(grown.span_ns) + ROUNDING_NS >= most.as_nanos(),
        }
    }
}

/// `scene.mcap` becomes `scene-001.mcap`, `scene-002.mcap`, …
pub(super) struct Names {
    stem: String,
    extension: String,
    folder: PathBuf,
    overwrite: bool,
    next: u32,
}

impl Names {
    /// Names after `target`. Without leave to overwrite, no numbered file may be there; with it
    /// those of an earlier recording are removed, so that two never mix.
    pub fn new(target: &Target) -> Result<Self, RecordingError> {
        let (path, overwrite) = match target {
            Target::File { path, overwrite } if path.metadata().map_or(true, |m| m.is_file()) => {
                (path, *overwrite)
            }
            other => {
                return Err(RecordingError::NoParts {
                    target: other.name(),
                });
            }
        };
        let part = |part: Option<&std::ffi::OsStr>| part.map(|p| p.to_string_lossy().into_owned());
        let names = Self {
            stem: part(path.file_stem()).unwrap_or_default(),
            extension: part(path.extension()).map_or(String::new(), |e| format!(".{e}")),
            folder: path.parent().map(PathBuf::from).unwrap_or_default(),
            overwrite,
            next: 1,
        };
        names.make_way()?;
        Ok(names)
    }

    fn make_way(&self) -> Result<(), RecordingError> {
        let here = self.folder.as_os_str().is_empty();
        let folder = if here { Path::new(".") } else { &self.folder };
        let Ok(entries) = std::fs::read_dir(folder) else {
            return Ok(()); // opening the first part will say what is wrong
        };
        let paths = entries.flatten().map(|entry| entry.path());
        let mut parts: Vec<_> = paths.filter(|path| self.is_part(path)).collect();
        parts.sort();
        for path in parts {
            if !self.overwrite {
                return Err(RecordingError::Exists { path });
            }
            let removed = std::fs::remove_file(&path);
            removed.map_err(|source: io::Error| RecordingError::Unwritable { path, source })?;
        }
        Ok(())
    }

    fn is_part(&self, path: &Path) -> bool {
        let name = path.file_name().and_then(|name| name.to_str());
        let number = name
            .and_then(|name| name.strip_prefix(&self.stem)?.strip_prefix('-'))
            .and_then(|rest| rest.strip_suffix(&self.extension));
        number.is_some_and(|n| n.len() >= 3 && n.bytes().all(|b| b.is_ascii_digit()))
    }

    /// Where the next part goes, and its number.
    pub fn next(&mut self) -> (Target, u32) {
        let number = self.next;
        self.next += 1;
        let name = format!("{}-{number:03}{}", self.stem, self.extension);
        let target = Target::File {
            path: self.folder.join(name),
            overwrite: self.overwrite,
        };
        (target, number)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_end_at_their_limits() {
        let grown = Grown {
            bytes: 900,
            group: 80,
            span_ns: 2_000_000_000,
        };
        assert!(!Split::Bytes(1000).is_due(grown));
        assert!(Split::Bytes(999).is_due(grown));
        assert!(!Split::Time(Duration::from_millis(2002)).is_due(grown));
        assert!(Split::Time(Duration::from_millis(2001)).is_due(grown));
    }

    #[test]
    fn names_are_numbered_and_never_mix() {
        let folder = tempfile::tempdir().unwrap();
        let target = |overwrite| Target::File {
            path: folder.path().join("a.b.mcap"),
            overwrite,
        };
        let mut names = Names::new(&target(false)).unwrap();
        for expected in ["a.b-001.mcap", "a.b-002.mcap"] {
            let (part, _) = names.next();
            assert!(part.name().ends_with(expected), "{}", part.name());
            std::fs::write(part.name(), "").unwrap();
        }
        for other in ["a.b-01.mcap", "a.b-001.txt", "a.b-x001.mcap"] {
            std::fs::write(folder.path().join(other), "").unwrap();
        }
        assert!(matches!(
            Names::new(&target(false)),
            Err(RecordingError::Exists { .. })
        ));
        Names::new(&target(true)).unwrap();
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 3);
    }
}
