//! Our own rows of the table: model, encode and decode with the state a stream has.

use crate::Sample;
use saint_live::codec::{CodecOptions, Decoder, EncodedFrame, Encoder};
use saint_live::contact_map::labels::SaintFrame;
use saint_live::fit::live::{FitOptions, Modeler};
use saint_live::frame::{Camera, DepthFrame};
use std::error::Error;
use std::time::Instant;

/// A key frame every so many frames, as the program's default.
const KEYFRAME_EVERY: u32 = 30;

/// How far what came back is from what went in, along the optical axis.
#[derive(Clone, Copy, Debug, Default)]
pub struct Errors {
    sum_m: f64,
    points: u64,
    /// Largest, metres.
    pub max_m: f64,
}

impl Errors {
    /// Mean, metres.
    pub fn mean_m(&self) -> f64 {
        self.sum_m / self.points.max(1) as f64
    }
}

/// One way to run our pipeline.
pub struct Ours {
    /// Every frame is fitted and coded as if it were the first.
    cold: bool,
    lossless: bool,
    unit_m: f64,
    modeler: Modeler,
    encoder: Encoder,
    decoder: Decoder,
    saint: SaintFrame,
    encoded: EncodedFrame,
    /// Of all frames.
    pub errors: Errors,
}

impl Ours {
    pub fn new(camera: &Camera, cold: bool, lossless: bool) -> Result<Self, Box<dyn Error>> {
        let fit = FitOptions::default();
        let mut codec = CodecOptions::fitted(fit.contact_distance, KEYFRAME_EVERY);
        codec.tolerance.lossless = lossless;
        Ok(Self {
            cold,
            lossless,
            unit_m: camera.depth_unit_m,
            modeler: Modeler::new(camera, &fit),
            encoder: Encoder::new(camera, codec)?,
            decoder: Decoder::new(),
            saint: SaintFrame::default(),
            encoded: EncodedFrame::default(),
            errors: Errors::default(),
        })
    }

    /// One frame there and back.
    pub(crate) fn run(&mut self, frame: &DepthFrame) -> Result<Sample, Box<dyn Error>> {
        if self.cold {
            self.modeler.reset();
            self.encoder.request_key();
        }
        let start = Instant::now();
        let report = self.modeler.model(frame, &mut self.saint, &|| false);
        self.encoder
            .encode(frame, &self.saint, report.degraded, &mut self.encoded)?;
        let encode = start.elapsed();
        let start = Instant::now();
        let decoded = self.decoder.decode(&self.encoded.payload)?;
        let decode = start.elapsed();
        for (&raw, &z) in frame.depth.iter().zip(&decoded.depth_m) {
            if (raw != 0) != (z > 0.0) {
                return Err("a measurement was lost or invented".into());
            }
            let true_m = f64::from(raw) * self.unit_m;
            if self.lossless && z != true_m as f32 {
                return Err("not lossless".into());
            }
            if raw != 0 {
                let error = (true_m - f64::from(z)).abs();
                self.errors.sum_m += error;
                self.errors.points += 1;
                self.errors.max_m = self.errors.max_m.max(error);
            }
        }
        Ok(Sample {
            encode_ms: encode.as_secs_f64() * 1e3,
            decode_ms: decode.as_secs_f64() * 1e3,
            bytes: self.encoded.payload.len(),
        })
    }
}
