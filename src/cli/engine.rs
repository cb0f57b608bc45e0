//! The live engine behind the pipeline's traits: options from flags, reports from results.

use super::args::{EngineArgs, PackingArg};
use super::failure::{Failure, Kind};
use saint_live::codec::{CodecOptions, EncodedFrame, Encoder, Tolerance};
use saint_live::contact_map::labels::SaintFrame;
use saint_live::fit::contact_distance::ContactDistance;
use saint_live::fit::live::{FitOptions, FitReport, Modeler};
use saint_live::frame::{Camera, DepthFrame};
use saint_live::partition::lattice::Packing;
use saint_live::pipeline::StageError;
use saint_live::pipeline::packet::{CodingReport, ModelReport, Residual};
use saint_live::pipeline::stages::{Encode, Model};
use std::collections::BTreeMap;

mod residual;

use residual::Sampler;

/// Key frames come at least so often: a second at the usual rate.
const KEYFRAME_EVERY: u32 = 30;

/// Resolved options of model and payload.
#[derive(Clone, Debug)]
pub struct Engine {
    /// Fit.
    pub fit: FitOptions,
    /// Payload.
    pub codec: CodecOptions,
    /// Threads, at least 1.
    pub threads: usize,
}

impl Engine {
    /// Options from flags.
    pub fn resolve(args: &EngineArgs) -> Self {
        let mut fit = FitOptions::default();
        if let Some(distance) = args.contact_distance {
            fit.contact_distance = distance;
        }
        if let Some(size) = args.cube_size {
            fit.cube_size_m = size.0;
        }
        if let Some(most) = args.max_spheres {
            fit.max_spheres = usize::from(most);
        }
        match args.packing {
            Some(PackingArg::Hex) => fit.packing = Packing::Hexagonal,
            Some(PackingArg::Cubic) => fit.packing = Packing::Cubic,
            None => {}
        }
        // a bound on the error is a contact distance, too: what lies farther off is not modelled
        let bound = args.max_error.map(|most| ContactDistance::constant(most.0));
        if let (Some(bound), None) = (bound, args.contact_distance) {
            fit.contact_distance = ContactDistance::for_bound(bound.floor_m);
        }
        let codec = CodecOptions {
            keyframe_every: args.keyframe_every.unwrap_or(KEYFRAME_EVERY),
            tolerance: Tolerance {
                contact: bound.unwrap_or(fit.contact_distance),
                lossless: args.lossless,
            },
        };
        let cores = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
        Self {
            fit,
            codec,
            threads: args.threads.map_or(cores, usize::from),
        }
    }

    /// Starts the worker threads of the model stage. Once per process.
    pub fn start_workers(&self) -> Result<(), Failure> {
        let mut pool = rayon::ThreadPoolBuilder::new()
            .num_threads(self.threads)
            .thread_name(|n| format!("model-{n}"));
        if self.threads == 1 {
            pool = pool.use_current_thread();
        }
        pool.build_global().map_err(|error| {
            Failure::new(
                Kind::Failure,
                format_args!("cannot start {} threads: {error}", self.threads),
            )
        })
    }

    /// The facts a recording keeps about how it was made.
    pub fn notes(&self, source: &str) -> BTreeMap<String, String> {
        BTreeMap::from([
            ("source".to_owned(), source.to_owned()),
            (
                "contact_distance".to_owned(),
                self.fit.contact_distance.to_string(),
            ),
            (
                "max_error".to_owned(),
                if self.codec.tolerance.lossless {
                    "0".to_owned()
                } else {
                    self.codec.tolerance.contact.to_string()
                },
            ),
            (
                "keyframe_every".to_owned(),
                self.codec.keyframe_every.to_string(),
            ),
        ])
    }
}

/// The model stage.
pub struct LiveModel(Modeler);

impl LiveModel {
    /// A modeler for frames of `camera`.
    pub fn new(camera: &Camera, engine: &Engine) -> Self {
        Self(Modeler::new(camera, &engine.fit))
    }
}

/// What the pipeline keeps of the fit's report.
fn model_report(fit: &FitReport) -> ModelReport {
    ModelReport {
        points: fit.valid_pixels,
        explained: fit.explained_pixels,
        spheres: fit.spheres,
        warm: fit.warm_pixels,
        degraded: fit.degraded,
    }
}

impl Model for LiveModel {
    fn model(
        &mut self,
        depth: &DepthFrame,
        saint: &mut SaintFrame,
        deadline: &dyn Fn() -> bool,
    ) -> Result<ModelReport, StageError> {
        Ok(model_report(&self.0.model(depth, saint, deadline)))
    }
}

/// The encode stage.
pub struct LiveEncode {
    encoder: Encoder,
    /// Looks at errors; not where they are measured otherwise, or are none.
    sampler: Option<Sampler>,
}

impl LiveEncode {
    /// An encoder for frames of `camera`.
    pub fn new(camera: &Camera, engine: &Engine) -> Result<Self, Failure> {
        let encoder =
            Encoder::new(camera, engine.codec).map_err(|error| Failure::new(Kind::Input, error))?;
        Ok(Self {
            encoder,
            sampler: (!engine.codec.tolerance.lossless).then(|| Sampler::new(camera)),
        })
    }

    /// The same without a look at the errors, which takes time that is not the codec's.
    pub fn unsampled(mut self) -> Self {
        self.sampler = None;
        self
    }
}

impl Encode for LiveEncode {
    fn encode(
        &mut self,
        depth: &DepthFrame,
        saint: &SaintFrame,
        modelled: &ModelReport,
        encoded: &mut EncodedFrame,
    ) -> Result<CodingReport, StageError> {
        self.encoder
            .encode(depth, saint, modelled.degraded, encoded)?;
        let residual = match &mut self.sampler {
            Some(sampler) => sampler.residual(depth, saint),
            None => Residual::default(),
        };
        Ok(CodingReport { lost: 0, residual })
    }
}
