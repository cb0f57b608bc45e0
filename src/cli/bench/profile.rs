//! Where a warm frame's time goes, as far as the library's own boundaries show it: cleaning (which
//! the fit and the encoder each do once) and decoding to each level are measured by themselves,
//! beside the frame's own times.

use super::super::failure::{Failure, Kind};
use saint_live::codec::{Decoder, Level};
use saint_live::deproject::{Rays, Validity};
use saint_live::frame::{Camera, DepthFrame};
use saint_live::pipeline::clock::{Clock, Monotonic};
use saint_live::pipeline::percentiles::Percentiles;
use serde::Serialize;

/// Medians of one frame, milliseconds.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Profile {
    /// Invalid codes and ranges taken out, once.
    pub clean: f64,
    /// The model stage, its cleaning included.
    pub model: f64,
    /// The encode stage, its cleaning included.
    pub encode: f64,
    /// Decoding as far as one sphere for each block.
    pub decode_blocks: f64,
    /// Decoding as far as each pixel's sphere.
    pub decode_spheres: f64,
    /// Decoding to depth.
    pub decode: f64,
}

impl Profile {
    /// A line of the table.
    pub fn line(&self) -> String {
        let whole = (self.model + self.encode).max(f64::MIN_POSITIVE);
        let decode = self.decode.max(f64::MIN_POSITIVE);
        let percent = |part: f64, of: f64| (part / of).clamp(0.0, 1.0) * 1e2;
        format!(
            "shares %    fit {:.0}, coding {:.0}, cleaning (in both) {:.0}; of decoding: blocks {:.0}, pixels' spheres {:.0}, rest {:.0}\n",
            percent(self.model - self.clean, whole),
            percent(self.encode - self.clean, whole),
            percent(2.0 * self.clean, whole),
            percent(self.decode_blocks, decode),
            percent(self.decode_spheres - self.decode_blocks, decode),
            percent(self.decode - self.decode_spheres, decode),
        )
    }
}

/// Measures the passes.
pub struct Passes {
    rays: Rays,
    validity: Validity,
    plane: Vec<u16>,
    clean: Percentiles,
    blocks: (Decoder, Percentiles),
    spheres: (Decoder, Percentiles),
}

impl Passes {
    pub fn new(camera: &Camera) -> Self {
        let decoder = |level| (Decoder::at(level), Percentiles::new());
        Self {
            rays: Rays::new(camera),
            validity: Validity::new(camera),
            plane: Vec::new(),
            clean: Percentiles::new(),
            blocks: decoder(Level::Blocks),
            spheres: decoder(Level::Spheres),
        }
    }

    /// Goes through a frame and its payload.
    pub fn measure(&mut self, frame: &DepthFrame, payload: &[u8]) -> Result<(), Failure> {
        let start = Monotonic.now_ns();
        self.validity.clean(&self.rays, frame, &mut self.plane);
        self.clean.record_ns(Monotonic.now_ns() - start);
        for (decoder, times) in [&mut self.blocks, &mut self.spheres] {
            let start = Monotonic.now_ns();
            decoder
                .decode(payload)
                .map_err(|error| Failure::new(Kind::Failure, error))?;
            times.record_ns(Monotonic.now_ns() - start);
        }
        Ok(())
    }

    /// With the times of the whole stages.
    pub fn profile(
        &self,
        model: &Percentiles,
        encode: &Percentiles,
        decode: &Percentiles,
    ) -> Profile {
        let median = |times: &Percentiles| times.summary().p50;
        Profile {
            clean: median(&self.clean),
            model: median(model),
            encode: median(encode),
            decode_blocks: median(&self.blocks.1),
            decode_spheres: median(&self.spheres.1),
            decode: median(decode),
        }
    }
}
