//! Stages made for the tests: scripted, exact, without time of their own.

use crate::capture::{CaptureError, FrameSource, Next, SourceLosses};
use crate::codec::EncodedFrame;
use crate::contact_map::labels::{Contacts, SaintFrame};
use crate::frame::{Camera, ColorFrame, DepthFrame, FrameTime, Intrinsics};
use crate::pipeline::StageError;
use crate::pipeline::color::ColorSource;
use crate::pipeline::packet::{CodingReport, ModelReport, Packet};
use crate::pipeline::stages::{Encode, Model, Sink};

/// What a mock source does when asked.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Event {
    Frame,
    Gap(u64),
    Damaged,
    Stall,
    Waiting,
    Error,
    Panic,
}

pub(super) struct MockSource<'a> {
    pub(super) camera: Camera,
    pub(super) script: Vec<Event>,
    pub(super) at: usize,
    pub(super) sequence: u64,
    pub(super) losses: SourceLosses,
    pub(super) period_ns: i64,
    /// Called before each frame is given (synchronises a test with the other stages).
    pub(super) before: Box<dyn FnMut(u64) + Send + 'a>,
}

impl<'a> MockSource<'a> {
    pub(super) fn new(script: Vec<Event>) -> Self {
        Self {
            camera: Camera {
                width: 2,
                height: 1,
                intrinsics: Intrinsics {
                    fx: 1.0,
                    fy: 1.0,
                    cx: 0.0,
                    cy: 0.0,
                },
                depth_unit_m: 0.001,
                invalid: vec![],
                depth_min_m: 0.0,
                depth_max_m: 10.0,
                fps: Some(100.0),
                name: "mock".into(),
            },
            script,
            at: 0,
            sequence: 0,
            losses: SourceLosses::default(),
            period_ns: 10_000_000,
            before: Box::new(|_| ()),
        }
    }

    pub(super) fn frames(n: usize) -> Self {
        Self::new(vec![Event::Frame; n])
    }
}

impl FrameSource for MockSource<'_> {
    fn camera(&self) -> &Camera {
        &self.camera
    }
    fn is_live(&self) -> bool {
        false
    }
    fn losses(&self) -> SourceLosses {
        self.losses
    }
    fn next(&mut self, frame: &mut DepthFrame) -> Result<Next, CaptureError> {
        let Some(event) = self.script.get(self.at).copied() else {
            return Ok(Next::End);
        };
        self.at += 1;
        match event {
            Event::Frame => {
                (self.before)(self.sequence);
                frame.sequence = self.sequence;
                frame.time = FrameTime {
                    device_ns: self.sequence as i64 * self.period_ns,
                    wall_ns: 0,
                };
                frame.depth.clear();
                frame.depth.extend([self.sequence as u16, 7]);
                self.sequence += 1;
                return Ok(Next::Frame);
            }
            Event::Gap(n) => {
                self.losses.sensor_gap += n;
                self.sequence += n;
            }
            Event::Damaged => {
                self.losses.damaged += 1;
                self.sequence += 1;
            }
            Event::Stall => {
                self.losses.stall += 1;
                self.sequence += 1;
            }
            Event::Waiting => {}
            Event::Error => {
                return Err(CaptureError::Usage("the mock was told to fail".into()));
            }
            Event::Panic => panic!("the mock was told to panic"),
        }
        Ok(Next::Waiting(None))
    }
}

/// What the model does for a frame (number, deadline); true where it was cut short.
pub(super) type Work<'a> = Box<dyn FnMut(u64, &dyn Fn() -> bool) -> bool + Send + 'a>;

/// Sums what it sees, so that its output depends on every frame before (order matters).
#[derive(Default)]
pub(super) struct MockModel<'a> {
    pub(super) state: u16,
    pub(super) fail_at: Option<u64>,
    pub(super) panic_at: Option<u64>,
    pub(super) work: Option<Work<'a>>,
    /// Frames seen before it last started over, where it can.
    pub(super) rehearsed: Option<u32>,
    pub(super) seen: u32,
}

impl Model for MockModel<'_> {
    fn model(
        &mut self,
        depth: &DepthFrame,
        saint: &mut SaintFrame,
        deadline: &dyn Fn() -> bool,
    ) -> Result<ModelReport, StageError> {
        if self.fail_at == Some(depth.sequence) {
            return Err("the model was told to fail".into());
        }
        assert!(
            self.panic_at != Some(depth.sequence),
            "the model was told to panic"
        );
        let degraded = match &mut self.work {
            Some(work) => work(depth.sequence, deadline),
            None => false,
        };
        self.seen += 1;
        self.state = self.state.wrapping_mul(31).wrapping_add(depth.depth[0]);
        saint.contacts = Contacts::Labels(vec![self.state, depth.depth[1]]);
        Ok(ModelReport {
            hurried: false,
            points: 2,
            explained: 2,
            spheres: 1,
            warm: 0,
            degraded,
        })
    }

    fn start_over(&mut self) -> bool {
        self.state = 0;
        let seen = std::mem::take(&mut self.seen);
        self.rehearsed = self.rehearsed.map(|earlier| earlier + seen);
        self.rehearsed.is_some()
    }
}

#[derive(Default)]
pub(super) struct MockEncode {
    pub(super) panic_at: Option<u64>,
    /// As the model's.
    pub(super) rehearsed: Option<u32>,
    pub(super) seen: u32,
}

impl Encode for MockEncode {
    fn encode(
        &mut self,
        depth: &DepthFrame,
        saint: &SaintFrame,
        _: &ModelReport,
        encoded: &mut EncodedFrame,
    ) -> Result<CodingReport, StageError> {
        assert!(
            self.panic_at != Some(depth.sequence),
            "the encoder was told to panic"
        );
        self.seen += 1;
        encoded.sequence = depth.sequence;
        encoded.payload.clear();
        for label in saint.labels(2, 1) {
            encoded.payload.extend(label.to_le_bytes());
        }
        Ok(CodingReport::default())
    }

    fn start_over(&mut self) -> bool {
        let seen = std::mem::take(&mut self.seen);
        self.rehearsed = self.rehearsed.map(|earlier| earlier + seen);
        self.rehearsed.is_some()
    }
}

#[derive(Default)]
pub(super) struct MockSink<'a> {
    pub(super) sequences: Vec<u64>,
    pub(super) bytes: Vec<u8>,
    pub(super) colors: Vec<Vec<u8>>,
    pub(super) fail_at: Option<u64>,
    pub(super) finished: u32,
    pub(super) after: Option<Box<dyn FnMut(u64) + Send + 'a>>,
}

impl Sink for MockSink<'_> {
    fn frame(&mut self, packet: &Packet) -> Result<(), StageError> {
        if self.fail_at == Some(packet.depth.sequence) {
            return Err(Box::new(std::io::Error::from(
                std::io::ErrorKind::BrokenPipe,
            )));
        }
        self.sequences.push(packet.depth.sequence);
        self.bytes.extend(&packet.encoded.payload);
        if let Some(after) = &mut self.after {
            after(packet.depth.sequence);
        }
        Ok(())
    }
    fn color(&mut self, color: &ColorFrame) -> Result<(), StageError> {
        self.colors.push(color.data.clone());
        Ok(())
    }
    fn finish(&mut self) -> Result<(), StageError> {
        self.finished += 1;
        Ok(())
    }
}

pub(super) struct MockColor {
    pub(super) left: u32,
}

impl ColorSource for MockColor {
    fn next(&mut self, color: &mut ColorFrame) -> Result<Next, CaptureError> {
        if self.left == 0 {
            return Err(CaptureError::Usage("the colour camera went away".into()));
        }
        self.left -= 1;
        color.data.clear();
        color.data.push(self.left as u8);
        Ok(Next::Frame)
    }
}
