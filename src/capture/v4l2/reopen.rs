//! Looking for a camera and starting its stream again, in a thread of its own: a driver may take
//! seconds to answer for a camera that is broken or half unplugged, and nobody may wait for that.

use super::depth_format::Rows;
use super::negotiation::{Plan, Wish};
use super::node::VideoNode;
use super::reconnect::{self, Identity};
use super::ring::Ring;
use super::setup::{self, Refused};
use crate::capture::{CaptureError, devices};
use crossbeam_channel::{Receiver, bounded};
use std::io;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// What to look for, and how to start it.
#[derive(Clone, Debug)]
pub(super) struct Search {
    pub identity: Identity,
    /// The node it had last, taken again where it still is that camera.
    pub path: PathBuf,
    pub plan: Plan,
    pub wish: Wish,
}

/// A camera that streams again.
pub(super) struct Found {
    pub path: PathBuf,
    pub ring: Ring,
    pub rows: Rows,
}

/// What one attempt gave.
pub(super) enum Attempt {
    Found(Found),
    /// It is not plugged in.
    Absent,
    /// It is there, but did not start; the text says why.
    Refused(String),
}

/// One attempt under way.
pub(super) struct Reopening {
    result: Receiver<Attempt>,
}

impl Reopening {
    /// Starts an attempt. The broken stream, where there is one, is closed first.
    pub fn start(search: Search, broken: Option<Ring>) -> io::Result<Self> {
        let (to, result) = bounded(1);
        let work = move || {
            drop(broken);
            // a source that is gone closes the ring with the message
            let _ = to.send(attempt(&search));
        };
        std::thread::Builder::new()
            .name("reopen".into())
            .spawn(work)?;
        Ok(Self { result })
    }

    /// The attempt's result, waiting at most `time` for it.
    pub fn poll(&self, time: Duration) -> Option<Attempt> {
        self.result.recv_timeout(time).ok()
    }
}

fn attempt(search: &Search) -> Attempt {
    let code = search.plan.format.fourcc();
    let offers = |d: &devices::DeviceReport| d.formats.iter().any(|f| f.pixel_format == code);
    let depth: Vec<_> = devices::describe_all().into_iter().filter(offers).collect();
    let present: Vec<Identity> = depth.iter().map(setup::identity).collect();
    let same_node = depth
        .iter()
        .position(|d| d.path == search.path)
        .filter(|at| present[*at] == search.identity);
    let found = same_node.or_else(|| reconnect::find_again(&search.identity, &present));
    let Some(path) = found.map(|at| depth[at].path.clone()) else {
        return Attempt::Absent;
    };
    match start(&path, search) {
        Ok((ring, rows)) => Attempt::Found(Found { path, ring, rows }),
        Err(refused) => Attempt::Refused(match refused.at(&path) {
            // who is told knows the node
            CaptureError::Device { what, remedy, .. } => format!("{what}; {remedy}"),
            other => other.to_string(),
        }),
    }
}

fn start(path: &Path, search: &Search) -> Result<(Ring, Rows), Refused> {
    let node = VideoNode::open(path).map_err(|error| Refused::System {
        doing: "open it again",
        error,
    })?;
    let (ring, rows, _) = setup::start(node, &search.plan, &search.wish)?;
    Ok((ring, rows))
}
