//! A small synthetic input held in memory, and the live engine behind the pipeline's traits.

use saint_live::capture::synthetic::{SyntheticOptions, SyntheticSource};
use saint_live::capture::{FrameSource, Next};
use saint_live::codec::{CodecOptions, EncodedFrame, Encoder};
use saint_live::contact_map::labels::SaintFrame;
use saint_live::fit::live::{FitOptions, Modeler};
use saint_live::frame::{Camera, DepthFrame};
use saint_live::pipeline::StageError;
use saint_live::pipeline::packet::{CodingReport, ModelReport};
use saint_live::pipeline::stages::{Encode, Model};

/// Frames per second of the input.
pub const FPS: u64 = 30;
/// A key frame each second, as the program has it.
const KEYFRAME_EVERY: u32 = 30;

/// Two seconds of the juggling scene, 160x120.
pub fn input() -> (Camera, Vec<DepthFrame>) {
    let text = format!("juggle,size=160x120,paced=false,fps={FPS},frames=60");
    let mut source = SyntheticSource::open(SyntheticOptions::parse(&text).unwrap()).unwrap();
    let camera = source.camera().clone();
    let mut frames = Vec::new();
    let mut frame = DepthFrame::default();
    while source.next(&mut frame).unwrap() == Next::Frame {
        frames.push(frame.clone());
    }
    (camera, frames)
}

/// Time of frame `n`, ns.
pub fn time_ns(n: u64) -> i64 {
    (n * 1_000_000_000 / FPS) as i64
}

pub struct ModelStage(pub Modeler);

impl ModelStage {
    pub fn new(camera: &Camera) -> Self {
        Self(Modeler::new(camera, &FitOptions::default()))
    }
}

impl Model for ModelStage {
    fn model(
        &mut self,
        depth: &DepthFrame,
        saint: &mut SaintFrame,
        deadline: &dyn Fn() -> bool,
    ) -> Result<ModelReport, StageError> {
        let fit = self.0.model(depth, saint, deadline);
        Ok(ModelReport {
            points: fit.valid_pixels,
            explained: fit.explained_pixels,
            spheres: fit.spheres,
            warm: fit.warm_pixels,
            degraded: fit.degraded,
        })
    }
}

pub struct EncodeStage(pub Encoder);

impl EncodeStage {
    pub fn new(camera: &Camera) -> Self {
        let options = CodecOptions::fitted(FitOptions::default().contact_distance, KEYFRAME_EVERY);
        Self(Encoder::new(camera, options).unwrap())
    }
}

impl Encode for EncodeStage {
    fn encode(
        &mut self,
        depth: &DepthFrame,
        saint: &SaintFrame,
        modelled: &ModelReport,
        encoded: &mut EncodedFrame,
    ) -> Result<CodingReport, StageError> {
        self.0.encode(depth, saint, modelled.degraded, encoded)?;
        Ok(CodingReport::default())
    }
}
