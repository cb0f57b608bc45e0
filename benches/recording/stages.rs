//! A small synthetic input held in memory, and the live engine behind the pipeline's traits.

use saint_live::capture::synthetic::{SyntheticOptions, SyntheticSource};
use saint_live::capture::{FrameSource, Next};
use saint_live::codec::{CodecOptions, Encoder};
use saint_live::fit::live::{FitOptions, Modeler};
use saint_live::frame::{Camera, DepthFrame};

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

/// The live fit as the program has it.
pub fn model_stage(camera: &Camera) -> Modeler {
    Modeler::new(camera, &FitOptions::default())
}

/// The codec as the program has it.
pub fn encode_stage(camera: &Camera) -> Encoder {
    let options = CodecOptions::fitted(FitOptions::default().contact_distance, KEYFRAME_EVERY);
    Encoder::new(camera, options).unwrap()
}
