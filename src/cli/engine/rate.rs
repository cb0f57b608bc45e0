//! Rate control between the stages: the encoder decides, the model stage follows at the same frame.

use saint_live::codec::rate::{Decision, RateControl};
use saint_live::codec::{CodecOptions, EncodedFrame};
use saint_live::contact_map::labels::SaintFrame;
use saint_live::fit::contact_distance::ContactDistance;
use saint_live::fit::live::Modeler;
use saint_live::frame::DepthFrame;
use saint_live::pipeline::StageError;
use saint_live::pipeline::packet::ModelReport;
use saint_live::pipeline::stages::Model;
use std::sync::{Arc, Mutex, PoisonError};

/// The encoder's end.
pub struct Rate {
    start: RateControl,
    control: RateControl,
    sent: Arc<Mutex<Option<Decision>>>,
    own: Schedule,
}

/// The model stage's end.
pub struct Plan {
    received: Arc<Mutex<Option<Decision>>>,
    own: Schedule,
}

/// Frames counted and the distance from which on.
struct Schedule {
    usual: ContactDistance,
    frames: u64,
    next: Option<Decision>,
}

impl Schedule {
    /// Back to before the first frame.
    fn start_over(&mut self) {
        (self.frames, self.next) = (0, None);
    }

    /// Counts a frame; the distance where it changes with it.
    fn step(&mut self) -> Option<ContactDistance> {
        let frame = self.frames;
        self.frames += 1;
        let due = self.next.take_if(|d| d.from <= frame)?;
        Some(self.usual.scaled(due.scale))
    }
}

/// Both ends of a rate control that aims at `bits_per_s`.
pub fn link(bits_per_s: f64, codec: &CodecOptions) -> (Plan, Rate) {
    let shared = Arc::new(Mutex::new(None));
    let own = || Schedule {
        usual: codec.contact,
        frames: 0,
        next: None,
    };
    let plan = Plan {
        received: Arc::clone(&shared),
        own: own(),
    };
    let control = RateControl::new(bits_per_s, codec.keyframe_every);
    let rate = Rate {
        start: control.clone(),
        control,
        sent: shared,
        own: own(),
    };
    (plan, rate)
}

impl Rate {
    /// The distance from the next frame on, where it changes.
    pub fn next(&mut self) -> Option<ContactDistance> {
        self.own.step()
    }

    /// Forgets all frames. Too few were made up for a rehearsal to decide anything by them, so both
    /// ends still have the usual distance.
    pub fn start_over(&mut self) {
        self.control.clone_from(&self.start);
        self.own.start_over();
    }

    /// Takes the frame that was encoded.
    pub fn observe(&mut self, frame: &EncodedFrame) {
        let decided = self
            .control
            .observe(frame.time.device_ns, frame.payload.len());
        if decided.is_some() {
            self.own.next = decided;
            *self.sent.lock().unwrap_or_else(PoisonError::into_inner) = decided;
        }
    }
}

impl Plan {
    /// The model stage that follows it.
    pub fn of(self, modeler: Modeler) -> Planned {
        Planned {
            plan: self,
            modeler,
        }
    }

    /// The distance from the next frame on, where it changes.
    fn next(&mut self) -> Option<ContactDistance> {
        let mut received = self.received.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(decision) = received.take() {
            self.own.next = Some(decision);
        }
        self.own.step()
    }
}

/// The live fit with a contact distance that changes.
pub struct Planned {
    plan: Plan,
    modeler: Modeler,
}

impl Model for Planned {
    fn model(
        &mut self,
        depth: &DepthFrame,
        saint: &mut SaintFrame,
        deadline: &dyn Fn() -> bool,
    ) -> Result<ModelReport, StageError> {
        if let Some(distance) = self.plan.next() {
            self.modeler.set_contact_distance(&distance);
        }
        Model::model(&mut self.modeler, depth, saint, deadline)
    }

    fn start_over(&mut self) -> bool {
        self.plan.own.start_over();
        self.modeler.reset();
        true
    }
}
