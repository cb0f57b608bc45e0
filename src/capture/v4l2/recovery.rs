//! A camera that is silent, broken or away: its stream is started anew, or it is waited for.

use super::loss::{Silence, judge_silence};
use super::refusal::{self, Outlook};
use super::reopen::{Attempt, Found, Reopening, Search};
use super::{Link, POLL, Step, V4l2Source};
use crate::capture::CaptureError;
use std::io;
use std::time::{Duration, Instant};

/// Pause before a driver without a frame is asked again.
const RETRY: Duration = Duration::from_millis(20);
/// Pause before the camera is looked for again.
const LOOK_AGAIN: Duration = Duration::from_millis(200);
/// A stream broken oftener than this in a row is started anew without haste.
const HASTY_RESTARTS: u32 = 3;

impl V4l2Source {
    /// No frame within the timeout.
    pub(super) fn silent(&mut self) -> Result<Step, CaptureError> {
        let silent = self.last_frame.elapsed();
        let text = format!("no frame for {:.1} s", silent.as_secs_f64());
        match judge_silence(silent, self.restarts, self.give_up) {
            Silence::Wait => Ok(Step::Waiting(None)),
            Silence::Tell => Ok(Step::Waiting(Some(self.told("no frame comes, waiting")))),
            Silence::Restart => {
                self.restarts += 1;
                self.reopen();
                Ok(Step::Waiting(Some(
                    self.told(&format!("{text}, starting the stream again")),
                )))
            }
            Silence::GiveUp => Err(self.given_up(&text)),
        }
    }

    /// The driver reported an error instead of a frame.
    pub(super) fn broken(&mut self, error: &io::Error) -> Result<Step, CaptureError> {
        let text = match refusal::outlook(error) {
            Outlook::Again => {
                std::thread::sleep(RETRY);
                return Ok(Step::Again);
            }
            Outlook::Gone => {
                self.trouble = self.unplugged();
                format!("{}; waiting for it", self.trouble)
            }
            Outlook::Restart => {
                self.trouble = error.to_string();
                format!("{error}; starting the stream again")
            }
        };
        self.restarts += 1;
        if self.restarts > HASTY_RESTARTS {
            std::thread::sleep(LOOK_AGAIN.min(POLL));
        }
        self.reopen();
        Ok(Step::Waiting(Some(self.told(&text))))
    }

    /// Closes the node and looks for the camera: nothing of a broken stream is kept. Frames the
    /// driver had ready are lost with it.
    fn reopen(&mut self) {
        let search = Search {
            identity: self.identity.clone(),
            path: self.path.clone(),
            plan: self.plan,
            wish: self.wish,
        };
        let lost = Link::Lost(Instant::now() + LOOK_AGAIN);
        let broken = match std::mem::replace(&mut self.link, lost) {
            Link::Streaming(ring) => {
                self.losses.stall += ring.finished();
                Some(ring)
            }
            _ => None,
        };
        match Reopening::start(search, broken) {
            Ok(opening) => self.link = Link::Opening(opening),
            Err(error) => tracing::warn!("{}: no thread: {error}", self.path.display()),
        }
    }

    /// The camera is away: looks for it, whatever its node's number is now.
    pub(super) fn come_back(&mut self, pause: Duration) -> Result<Step, CaptureError> {
        let until = match &self.link {
            Link::Streaming(_) => return Ok(Step::Again),
            Link::Opening(opening) => match opening.poll(pause) {
                Some(Attempt::Found(found)) => {
                    self.found(found);
                    return Ok(Step::Again);
                }
                Some(Attempt::Absent) => {
                    self.trouble = self.unplugged();
                    Instant::now() + LOOK_AGAIN
                }
                Some(Attempt::Refused(text)) => {
                    self.trouble = text;
                    Instant::now() + LOOK_AGAIN
                }
                None => return self.still_away(),
            },
            Link::Lost(until) => {
                let left = until.saturating_duration_since(Instant::now());
                std::thread::sleep(left.min(pause));
                *until
            }
        };
        self.link = Link::Lost(until);
        if Instant::now() >= until {
            self.reopen();
        }
        self.still_away()
    }

    /// Whether to go on waiting for a camera that is away.
    fn still_away(&self) -> Result<Step, CaptureError> {
        if self
            .give_up
            .is_some_and(|limit| self.last_frame.elapsed() >= limit)
        {
            return Err(self.given_up(&self.trouble));
        }
        let told = !self.trouble.is_empty();
        let text = told.then(|| self.told(&format!("{}; waiting for it", self.trouble)));
        Ok(Step::Waiting(text))
    }

    fn found(&mut self, found: Found) {
        tracing::warn!(
            "{}: `{}` streams again after {:.1} s",
            found.path.display(),
            self.camera.name,
            self.last_frame.elapsed().as_secs_f64()
        );
        self.path = found.path;
        self.rows = found.rows;
        self.link = Link::Streaming(found.ring);
        self.counter.restart();
        self.trouble.clear();
    }

    fn unplugged(&self) -> String {
        let Self { camera, frames, .. } = self;
        format!("`{}` was unplugged after {frames} frames", camera.name)
    }

    fn told(&self, text: &str) -> String {
        format!("{}: {text}", self.path.display())
    }

    fn given_up(&self, text: &str) -> CaptureError {
        CaptureError::Device {
            device: self.path.display().to_string(),
            what: format!(
                "{text}; given up {:.1} s after the last of {} frames",
                self.last_frame.elapsed().as_secs_f64(),
                self.frames
            ),
            remedy: "unplug the camera, plug it in again and start again (without --give-up it \
                     is waited for); `dmesg` may say more"
                .into(),
        }
    }
}
