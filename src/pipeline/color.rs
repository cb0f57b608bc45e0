//! The colour camera's own thread: it feeds the sink and never delays depth.

use super::stages::Shared;
use crate::capture::{CaptureError, Next};
use crate::frame::ColorFrame;
use crossbeam_channel::{Receiver, Sender, bounded};
use std::sync::atomic::{AtomicBool, Ordering};

/// Colour images that may wait for the sink; a newer one that finds no room is given up.
const WAITING: usize = 4;

/// A stream of compressed colour images beside the depth stream.
pub trait ColorSource: Send {
    /// Fills `color` with the next image, waiting at most about 200 ms.
    ///
    /// # Errors
    /// Anything that ends the stream.
    fn next(&mut self, color: &mut ColorFrame) -> Result<Next, CaptureError>;
    /// Images lost so far before they came out of here.
    fn lost(&self) -> u64 {
        0
    }
}

/// The two ends the colour thread works with.
pub(super) struct Producer {
    full: Sender<ColorFrame>,
    empty: Receiver<ColorFrame>,
}

/// The two ends the sink works with.
pub(super) struct Consumer {
    pub(super) full: Receiver<ColorFrame>,
    pub(super) empty: Sender<ColorFrame>,
}

/// A queue of colour images whose buffers go round.
pub(super) fn queue() -> (Producer, Consumer) {
    let (full_tx, full_rx) = bounded(WAITING);
    let (empty_tx, empty_rx) = bounded(WAITING + 2);
    let producer = Producer {
        full: full_tx,
        empty: empty_rx,
    };
    let consumer = Consumer {
        full: full_rx,
        empty: empty_tx,
    };
    (producer, consumer)
}

/// Reads `source` until `done`, a stop or an error, which is returned.
pub(super) fn run(
    source: &mut dyn ColorSource,
    queue: &Producer,
    shared: &Shared<'_>,
    done: &AtomicBool,
) -> Option<CaptureError> {
    let mut buffer = ColorFrame::default();
    let mut lost = 0;
    while !done.load(Ordering::Relaxed) && !shared.stopping() {
        let next = source.next(&mut buffer);
        for _ in lost..source.lost() {
            super::stages::locked(&shared.statistics).color(false);
        }
        lost = source.lost();
        match next {
            Ok(Next::Frame) => {
                let empty = queue.empty.try_recv().unwrap_or_default();
                let image = std::mem::replace(&mut buffer, empty);
                if let Err(refused) = queue.full.try_send(image) {
                    super::stages::locked(&shared.statistics).color(false);
                    buffer = refused.into_inner();
                }
            }
            Ok(Next::Waiting(_)) => {}
            Ok(Next::End) => return None,
            Err(error) => return Some(error),
        }
    }
    None
}
