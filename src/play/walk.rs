//! The order in which the frames of a playback come.

use super::{Frames, PlayOptions};

/// Frames kept at the most while a recording is played backwards.
pub(super) const MOST_KEPT: usize = 64;

/// The order in which frames come. Backwards, the frames from a key frame on are decoded once, in
/// order, and put aside; of a longer group the last [`MOST_KEPT`] are, and the others later.
pub(super) struct Walk<K> {
    reverse: bool,
    from: u64,
    to: u64,
    /// Frame that the source decodes next.
    at: u64,
    /// Backwards: the frame shown last, or the end.
    above: u64,
    pub(super) kept: Vec<(u64, i64, K)>,
}

impl<K> Walk<K> {
    pub fn new(options: &PlayOptions, frames: u64) -> Self {
        Self {
            reverse: options.reverse,
            from: options.from,
            to: options.to.min(frames),
            at: 0,
            above: 0,
            kept: Vec::new(),
        }
    }

    /// Goes to where the playback begins.
    pub fn begin<F: Frames<Kept = K>>(&mut self, frames: &mut F) -> Result<(), F::Error> {
        self.kept.clear();
        self.above = self.to;
        if !self.reverse {
            self.at = frames.seek(self.from)?;
        }
        Ok(())
    }

    /// The next frame: its number and time, ns.
    pub fn next<F: Frames<Kept = K>>(
        &mut self,
        frames: &mut F,
    ) -> Result<Option<(u64, i64)>, F::Error> {
        if self.reverse {
            return self.back(frames);
        }
        while let Some((number, time_ns)) = frames.advance()? {
            self.at = number + 1;
            if number >= self.to {
                break;
            }
            if number >= self.from {
                return Ok(Some((number, time_ns)));
            }
        }
        Ok(None)
    }

    fn back<F: Frames<Kept = K>>(
        &mut self,
        frames: &mut F,
    ) -> Result<Option<(u64, i64)>, F::Error> {
        while self.kept.is_empty() && self.above > self.from {
            let target = self.above - 1;
            let key = frames.seek(target)?;
            while let Some((number, time_ns)) = frames.advance()? {
                if number > target {
                    break;
                }
                if number >= self.from {
                    if self.kept.len() == MOST_KEPT {
                        self.kept.remove(0);
                    }
                    self.kept.push((number, time_ns, frames.keep()));
                }
                if number == target {
                    break;
                }
            }
            // frames that cannot be decoded are passed over
            self.above = self.kept.first().map_or(key.min(target), |kept| kept.0);
        }
        let Some((number, time_ns, kept)) = self.kept.pop() else {
            return Ok(None);
        };
        frames.put_back(kept);
        Ok(Some((number, time_ns)))
    }

    /// Decodes the frame of this number, or the next that can be decoded; gives its number.
    pub fn go<F: Frames<Kept = K>>(
        &mut self,
        frames: &mut F,
        frame: u64,
    ) -> Result<Option<u64>, F::Error> {
        let Some(last) = self.to.checked_sub(1).filter(|last| *last >= self.from) else {
            return Ok(None);
        };
        let target = frame.clamp(self.from, last);
        self.kept.clear();
        self.above = target;
        if self.reverse || self.at != target {
            self.at = frames.seek(target)?;
        }
        while let Some((number, _)) = frames.advance()? {
            self.at = number + 1;
            if number >= target {
                return Ok(Some(number));
            }
        }
        Ok(None)
    }
}
