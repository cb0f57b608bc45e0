//! The live engine behind the pipeline's traits: options from flags, reports from results.

use super::args::{DomainArg, EngineArgs, MapArgs, PackingArg, SchemeArg};
use super::failure::{Failure, Kind};
use saint_live::codec::{CodecOptions, Domain, EncodedFrame, Encoder, Tolerance, polar};
use saint_live::contact_map::labels::SaintFrame;
use saint_live::contact_map::polar_frame::{PolarMapper, default_step_m};
use saint_live::fit::cloud::{FitParameters, Scheme};
use saint_live::fit::contact_distance::ContactDistance;
use saint_live::fit::framewise::FrameFit;
use saint_live::fit::live::{FitOptions, Modeler};
use saint_live::frame::{Camera, DepthFrame};
use saint_live::partition::lattice::Packing;
use saint_live::pipeline::StageError;
use saint_live::pipeline::packet::{CodingReport, ModelReport, Residual};
use saint_live::pipeline::stages::{Encode, Model};
use saint_live::recording::CONTACT_MAP_NOTE;
use std::collections::BTreeMap;

mod residual;

use residual::Sampler;

/// Key frames come at least so often: a second at the usual rate.
const KEYFRAME_EVERY: u32 = 30;

/// How spheres are found, with its options.
#[derive(Clone, Copy, Debug)]
pub enum Fit {
    /// Warm from the frame before.
    Live(FitOptions),
    /// One of the paper's schemes, frame by frame.
    Framewise(FitParameters),
}

impl Fit {
    /// Options from flags.
    fn resolve(args: &EngineArgs) -> Result<Self, Failure> {
        let stray = |flag: &str, scheme: &str| {
            Err(Failure::usage(format_args!(
                "{flag} goes with --scheme {scheme} only"
            )))
        };
        if args.spheres_per_cube.is_some() && args.scheme != SchemeArg::Progressive {
            return stray("--spheres-per-cube", "progressive");
        }
        if args.seed.is_some() && args.scheme != SchemeArg::Random {
            return stray("--seed", "random");
        }
        let bound_m = match (args.max_error, args.lossless) {
            (Some(most), _) => Some(most.0),
            (None, lossless) => lossless.then_some(0.0),
        };
        let contact = args
            .contact_distance
            .or(bound_m.map(ContactDistance::for_bound))
            .unwrap_or_default();
        let packing = match args.packing {
            Some(PackingArg::Cubic) => Packing::Cubic,
            Some(PackingArg::Hex) | None => Packing::Hexagonal,
        };
        let scheme = match args.scheme {
            SchemeArg::Live => {
                let usual = FitOptions::default();
                return Ok(Self::Live(FitOptions {
                    contact_distance: contact,
                    cube_size_m: args.cube_size.map_or(usual.cube_size_m, |size| size.0),
                    max_spheres: args.max_spheres.map_or(usual.max_spheres, usize::from),
                    packing,
                    ..usual
                }));
            }
            SchemeArg::Progressive => Scheme::Progressive,
            SchemeArg::Random => Scheme::Random,
        };
        let usual = FitParameters::default();
        Ok(Self::Framewise(FitParameters {
            contact_distance: contact,
            cube_size_m: args.cube_size.map_or(usual.cube_size_m, |size| size.0),
            max_spheres: args.max_spheres.map_or(usual.max_spheres, usize::from),
            spheres_per_cube: args
                .spheres_per_cube
                .map_or(usual.spheres_per_cube, usize::from),
            packing,
            scheme,
            seed: args.seed.unwrap_or(usual.seed),
        }))
    }

    /// How far a point may lie from its sphere.
    pub fn contact_distance(&self) -> ContactDistance {
        match self {
            Self::Live(options) => options.contact_distance,
            Self::Framewise(parameters) => parameters.contact_distance,
        }
    }

    /// As the command line names it.
    fn scheme(&self) -> String {
        match self {
            Self::Live(_) => "live".to_owned(),
            Self::Framewise(parameters) => parameters.scheme.to_string(),
        }
    }
}

/// Resolved options of model and payload.
#[derive(Clone, Debug)]
pub struct Engine {
    /// Fit.
    pub fit: Fit,
    /// Payload.
    pub codec: CodecOptions,
    /// Side of the polar map's cells, metres, where the contact map is polar.
    pub polar_step_m: Option<f64>,
    /// Threads, at least 1.
    pub threads: usize,
}

impl Engine {
    /// Options from flags.
    pub fn resolve(args: &EngineArgs, map: &MapArgs) -> Result<Self, Failure> {
        let fit = Fit::resolve(args)?;
        let contact = fit.contact_distance();
        let polar_step_m = match map.contact_map {
            DomainArg::Polar if args.lossless || args.max_error.is_some() => {
                return Err(Failure::usage(
                    "--contact-map polar gives no bound to every pixel; instead of --max-error or --lossless choose --contact-distance and --map-resolution",
                ));
            }
            DomainArg::Polar => Some(
                map.map_resolution
                    .map_or(default_step_m(&contact), |step| step.0),
            ),
            DomainArg::Sensor if map.map_resolution.is_some() => {
                return Err(Failure::usage(
                    "--map-resolution goes with --contact-map polar only",
                ));
            }
            DomainArg::Sensor => None,
        };
        let codec = CodecOptions {
            keyframe_every: args.keyframe_every.unwrap_or(KEYFRAME_EVERY),
            tolerance: Tolerance {
                contact: args
                    .max_error
                    .map_or(contact, |most| ContactDistance::constant(most.0)),
                lossless: args.lossless,
            },
        };
        let cores = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
        Ok(Self {
            fit,
            codec,
            polar_step_m,
            threads: args.threads.map_or(cores, usize::from),
        })
    }

    /// Starts the worker threads of the model stage. Once per process. One thread is the caller's
    /// own.
    pub fn start_workers(&self) -> Result<(), Failure> {
        self.start_pool(self.threads == 1)
    }

    /// Starts the worker threads that the model stages of several cameras share.
    pub fn start_shared_workers(&self) -> Result<(), Failure> {
        self.start_pool(false)
    }

    fn start_pool(&self, callers_own: bool) -> Result<(), Failure> {
        let mut pool = rayon::ThreadPoolBuilder::new()
            .num_threads(self.threads)
            .thread_name(|n| format!("model-{n}"));
        if callers_own {
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
        let mut notes = BTreeMap::from([
            ("source".to_owned(), source.to_owned()),
            ("scheme".to_owned(), self.fit.scheme()),
            (
                "contact_distance".to_owned(),
                self.fit.contact_distance().to_string(),
            ),
        ]);
        let domain = match self.polar_step_m {
            Some(step_m) => {
                let step = ContactDistance::constant(step_m).to_string();
                notes.insert("map_resolution".to_owned(), step);
                Domain::Polar
            }
            None => {
                let bound = if self.codec.tolerance.lossless {
                    "0".to_owned()
                } else {
                    self.codec.tolerance.contact.to_string()
                };
                notes.insert("max_error".to_owned(), bound);
                notes.insert(
                    "keyframe_every".to_owned(),
                    self.codec.keyframe_every.to_string(),
                );
                Domain::Sensor
            }
        };
        notes.insert(CONTACT_MAP_NOTE.to_owned(), domain.name().to_owned());
        notes
    }
}

/// The model stage for frames of `camera`.
pub fn model_stage(camera: &Camera, engine: &Engine) -> Result<Box<dyn Model>, Failure> {
    Ok(match &engine.fit {
        Fit::Live(options) => Box::new(Modeler::new(camera, options)),
        Fit::Framewise(parameters) => Box::new(
            FrameFit::new(camera, parameters).map_err(|error| Failure::new(Kind::Usage, error))?,
        ),
    })
}

/// The encode stage.
pub struct EncodeStage {
    coding: Coding,
    /// Looks at errors; not where they are measured otherwise, or are none.
    sampler: Option<Sampler>,
}

enum Coding {
    Sensor(Box<Encoder>),
    Polar(Box<PolarMapper>),
}

impl EncodeStage {
    /// For frames of `camera`.
    pub fn new(camera: &Camera, engine: &Engine) -> Result<Self, Failure> {
        let coding = match engine.polar_step_m {
            Some(step_m) => Coding::Polar(Box::new(PolarMapper::new(camera, step_m as f32))),
            None => Coding::Sensor(
                Encoder::new(camera, engine.codec)
                    .map(Box::new)
                    .map_err(|error| Failure::new(Kind::Input, error))?,
            ),
        };
        Ok(Self {
            coding,
            sampler: (!engine.codec.tolerance.lossless).then(|| Sampler::new(camera)),
        })
    }

    /// The same without a look at the errors, which takes time that is not the codec's.
    pub fn unsampled(mut self) -> Self {
        self.sampler = None;
        self
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
        let lost = match &mut self.coding {
            Coding::Sensor(encoder) => {
                encoder.encode(depth, saint, modelled.degraded, encoded)?;
                0
            }
            Coding::Polar(mapper) => {
                let (map, lost) = mapper.map(depth, saint)?;
                encoded.sequence = depth.sequence;
                encoded.time = depth.time;
                encoded.key = true;
                encoded.payload.clear();
                polar::encode(&map, &mut encoded.payload)?;
                lost
            }
        };
        let residual = match &mut self.sampler {
            Some(sampler) => sampler.residual(depth, saint),
            None => Residual::default(),
        };
        Ok(CodingReport { lost, residual })
    }
}
