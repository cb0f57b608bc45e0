//! What travels from stage to stage: one frame with all its buffers, and its record.

use super::rehearsal::Act;
use crate::codec::{EncodedFrame, Spent};
use crate::contact_map::labels::SaintFrame;
use crate::frame::{ColorFrame, DepthFrame};
use serde::Serialize;

/// When a stage worked on a frame, ns on the pipeline's clock. Both 0 where it did not.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Span {
    /// Begin.
    pub start_ns: i64,
    /// End.
    pub end_ns: i64,
}

impl Span {
    /// Length, ns.
    #[must_use]
    pub fn length_ns(&self) -> i64 {
        self.end_ns - self.start_ns
    }
}

/// Distance between measured points and the points the output gives back, along z, millimetres.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Residual {
    /// Mean.
    pub mean: f32,
    /// 95th percentile.
    pub p95: f32,
    /// 99th percentile.
    pub p99: f32,
    /// Largest.
    pub max: f32,
}

/// What the model stage says of a frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct ModelReport {
    /// Pixels that hold a measurement.
    pub points: u32,
    /// Of those, how many a sphere explains.
    pub explained: u32,
    /// Spheres in use.
    pub spheres: u32,
    /// Points that kept their sphere from the frame before.
    pub warm: u32,
    /// True where the deadline cut the refinement short.
    pub degraded: bool,
    /// True where there is no time to code what no sphere explains but plainly.
    pub hurried: bool,
}

impl ModelReport {
    /// Pixels that hold a measurement no sphere explains.
    #[must_use]
    pub fn left(&self) -> u32 {
        self.points.saturating_sub(self.explained)
    }
}

/// What the encode stage says of a frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct CodingReport {
    /// Measurements the payload does not give back.
    pub lost: u32,
    /// Error of those it does give back.
    pub residual: Residual,
    /// Where the payload's bits go; nothing where its contact map is polar.
    pub spent: Spent,
}

/// Everything that is known of one frame's way through the pipeline.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct FrameRecord {
    /// The source's frame number.
    pub sequence: u64,
    /// The source's time stamp, ns.
    pub device_ns: i64,
    /// When the frame's age began, ns on the pipeline's clock (see [`super::Pace`]).
    pub stamp_ns: i64,
    /// Reading it from the source.
    pub capture: Span,
    /// Fitting it.
    pub model: Span,
    /// Coding it.
    pub encode: Span,
    /// Writing it.
    pub sink: Span,
    /// The model stage's report.
    pub modelled: ModelReport,
    /// The encode stage's report.
    pub coded: CodingReport,
    /// Payload bytes.
    pub bytes: u64,
    /// True where the payload decodes alone.
    pub key: bool,
}

impl FrameRecord {
    /// Age at the end of the sink, ns, never negative.
    #[must_use]
    pub fn age_ns(&self) -> i64 {
        (self.sink.end_ns - self.stamp_ns).max(0)
    }

    /// Time spent waiting between capture and model, ns.
    #[must_use]
    pub fn wait_ns(&self) -> i64 {
        (self.model.start_ns - self.capture.end_ns).max(0)
    }
}

/// A frame on its way. Packets are made once and go round; stages fill the buffers in place.
#[derive(Clone, Debug, Default)]
pub struct Packet {
    /// As the sensor gave it (capture fills it).
    pub depth: DepthFrame,
    /// The colour image recorded beside it, where the source has one.
    pub color: Option<ColorFrame>,
    /// Spheres and contact map (model fills it).
    pub saint: SaintFrame,
    /// Payload (encode fills it).
    pub encoded: EncodedFrame,
    /// Times and counts.
    pub record: FrameRecord,
    /// Where the frame is made up for a rehearsal: its part there.
    pub act: Option<Act>,
}
