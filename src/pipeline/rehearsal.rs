//! A rehearsal: made-up frames go through the stages before the first real one.
//!
//! A first frame pays for what is not there yet: every buffer's pages, the program's own pages, and
//! what a frame costs on this machine, by which the budget divides its time. Live, that frame is
//! late already. So frames of the camera's size are made up and take the way of real ones, in the
//! same packets and threads, before the source is asked. Then each stage starts over
//! ([`Model::start_over`], [`Encode::start_over`]), and the real frames come out to the byte as they
//! would have without.
//!
//! Nothing of it is counted or written; only the cost models learn.

use super::error::Stage;
use super::mailbox::MailboxSender;
use super::packet::Packet;
use super::stages::{Encode, Model, Shared};
use super::start::Place;
use crate::contact_map::labels::Contacts;
use crate::deproject::Validity;
use crate::frame::{Camera, DepthFrame, FrameTime};
use crossbeam_channel::{Receiver, RecvTimeoutError};
use std::time::Duration;

/// Longest wait for a packet between two looks at whether the run has failed.
const NAP: Duration = Duration::from_millis(50);

/// What a made-up frame is there for, in their order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Act {
    /// From nothing. It takes all memory for the first time, so that its cost tells nothing.
    Cold,
    /// Warm from the one before: what a frame costs.
    Warm,
    /// No time at all: fitted to nothing and coded plainly. Most memory, and what the worst costs. The
    /// last one.
    Plain,
}

/// The acts.
const ACTS: [Act; 3] = [Act::Cold, Act::Warm, Act::Plain];

/// The made-up frames of one camera.
pub(super) struct Rehearsal {
    camera: Camera,
    start: Option<Place>,
}

impl Rehearsal {
    /// A rehearsal of stages that can start over; `None` where one of them cannot.
    pub(super) fn of(
        camera: &Camera,
        model: &mut dyn Model,
        encode: &mut dyn Encode,
        start: Option<Place>,
    ) -> Option<Self> {
        (model.start_over() && encode.start_over()).then(|| Self {
            camera: camera.clone(),
            start,
        })
    }

    /// Waits until the streams that begin together have all rehearsed.
    pub(super) fn wait_for_all(&mut self, shared: &Shared<'_>) {
        if let Some(place) = self.start.take() {
            place.wait(&|| shared.stopping());
        }
    }

    /// Fills `packet` with the frame of an act.
    fn prepare(&self, act: Act, packet: &mut Packet) {
        scene(&self.camera, act as u32, &mut packet.depth);
        packet.act = Some(act);
    }

    /// All acts, one after the other in the caller's thread.
    pub(super) fn alone(
        &self,
        model: &mut dyn Model,
        encode: &mut dyn Encode,
        packet: &mut Packet,
        shared: &Shared<'_>,
    ) {
        for act in ACTS {
            self.prepare(act, packet);
            if !(shared.model_step(model, packet) && shared.encode_step(encode, packet)) {
                return;
            }
        }
    }

    /// Sends all acts through the stages' threads and waits until every packet is back. Returns the
    /// packets, their buffers taken; where a stage fails meanwhile, those that came back.
    #[allow(clippy::vec_box, reason = "packets go round in their boxes")]
    pub(super) fn in_threads(
        &self,
        captured: &MailboxSender<Box<Packet>>,
        empties: &Receiver<Box<Packet>>,
        shared: &Shared<'_>,
    ) -> Vec<Box<Packet>> {
        let mut home = Vec::new();
        let packets = empties.capacity().unwrap_or(0);
        for act in ACTS {
            let Some(mut packet) = receive(empties, shared) else {
                return home;
            };
            self.prepare(act, &mut packet);
            if captured.put_wait(packet).is_err() {
                return home;
            }
        }
        while home.len() < packets {
            let Some(packet) = receive(empties, shared) else {
                return home;
            };
            home.push(packet);
        }
        // the payload of a real frame may be longer than that of a made-up one
        let coded = home.iter().filter(|p| p.act != Some(Act::Plain));
        let room = coded.map(|p| p.encoded.payload.len()).max();
        let room = 2 * room.unwrap_or(0);
        let spheres = home.iter().map(|p| p.saint.spheres.capacity()).max();
        let mut maps = home.iter().map(|p| &p.saint.contacts);
        let contacts = maps.find(|c| **c != Contacts::default()).cloned();
        for packet in &mut home {
            if let Some(contacts) = &contacts {
                packet.saint.contacts.clone_from(contacts);
            }
            cover(packet, self.camera.pixels(), room, spheres.unwrap_or(0));
        }
        // the last one is used first, by the frame that is likeliest to be coded plainly
        home.sort_by_key(|p| p.encoded.payload.capacity());
        home
    }
}

/// The next packet; `None` once the run is over or the stages have gone.
fn receive(empties: &Receiver<Box<Packet>>, shared: &Shared<'_>) -> Option<Box<Packet>> {
    loop {
        match empties.recv_timeout(NAP) {
            Ok(packet) => return Some(packet),
            Err(RecvTimeoutError::Timeout) if !shared.stopping() => {}
            Err(_) => return None,
        }
    }
}

/// Takes the memory a packet's buffers will need, and touches it.
fn cover(packet: &mut Packet, pixels: usize, payload: usize, spheres: usize) {
    packet.depth.depth.resize(pixels, 0);
    packet.saint.spheres.clear();
    packet.saint.spheres.resize(spheres, None);
    packet.encoded.payload.clear();
    packet.encoded.payload.resize(payload, 0);
}

impl Shared<'_> {
    /// Models a made-up frame.
    pub(super) fn rehearse_model(
        &self,
        act: Act,
        model: &mut dyn Model,
        packet: &mut Packet,
    ) -> bool {
        let report = self.guarded(Stage::Model, 0, || {
            let last = act == Act::Plain;
            let start_over = |model: &mut dyn Model| match !last || model.start_over() {
                true => Ok(()),
                false => Err("it was rehearsed and does not start over"),
            };
            start_over(model)?;
            let mut report = model.model(&packet.depth, &mut packet.saint, &|| last)?;
            report.hurried = last;
            start_over(model)?;
            Ok(report)
        });
        packet.record.modelled = report.unwrap_or_default();
        report.is_some()
    }

    /// Codes a made-up frame and learns what that costs.
    pub(super) fn rehearse_encode(
        &self,
        act: Act,
        encode: &mut dyn Encode,
        packet: &mut Packet,
    ) -> bool {
        let start = self.clock.now_ns();
        let coded = self.guarded(Stage::Encode, 0, || {
            encode.encode(
                &packet.depth,
                &packet.saint,
                &packet.record.modelled,
                &mut packet.encoded,
            )?;
            let end = self.clock.now_ns();
            if act == Act::Plain && !encode.start_over() {
                return Err("it was rehearsed and does not start over".into());
            }
            Ok(end)
        });
        let Some(end) = coded else {
            return false;
        };
        if act != Act::Cold {
            self.learn_coding(packet, start, end);
        }
        true
    }
}

/// Boxes across the image, and down.
const BOXES: (u32, u32) = (7, 5);

/// A tilted wall with boxes and bumps before it, noise, and holes; `turn` moves the boxes a little.
fn scene(camera: &Camera, turn: u32, out: &mut DepthFrame) {
    let (width, height) = (camera.width.max(1), camera.height.max(1));
    let validity = Validity::new(camera);
    let near = camera.depth_min_m.max(0.5);
    // half of the range at most, and not so far that all is noise
    let span = (0.5 * (camera.depth_max_m - near)).clamp(0.0, 3.0);
    let mut random = 1u32;
    out.sequence = u64::from(turn);
    out.time = FrameTime::default();
    out.depth.clear();
    out.depth.reserve(camera.pixels());
    for y in 0..height {
        let v = f64::from(y) / f64::from(height);
        for x in 0..width {
            // a step of a linear congruential generator (Numerical Recipes): its high bits are noise
            random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            let u = f64::from((x + 2 * turn) % width) / f64::from(width);
            let (across, down) = (u * f64::from(BOXES.0), v * f64::from(BOXES.1));
            let number = across as u32 + BOXES.0 * down as u32;
            let (dx, dy) = (across.fract() - 0.5, down.fract() - 0.5);
            let wall = 0.75 + 0.2 * v - 0.1 * u;
            let share = match number % 3 {
                // a box with a tilted front
                0 if dx.abs().max(dy.abs()) < 0.3 => 0.2 + 0.01 * f64::from(number) + 0.1 * dx,
                // a bump
                1 => wall - 0.15 * (0.16 - dx * dx - dy * dy).max(0.0).sqrt(),
                _ => wall,
            };
            let z = near + span * share;
            let noise = f64::from(random >> 16) / 32768.0 - 1.0;
            let raw = (z + 0.001 * z * z * noise) / camera.depth_unit_m;
            let raw = raw.round().clamp(1.0, 65535.0) as u16;
            // the shadow beside a box, and single pixels
            let shadow = number.is_multiple_of(3) && (0.3..0.34).contains(&dx) && dy.abs() < 0.3;
            let hole = shadow || random >> 24 == 0 || !validity.accepts(raw);
            out.depth.push(if hole { 0 } else { raw });
        }
    }
}

#[cfg(test)]
mod tests;
