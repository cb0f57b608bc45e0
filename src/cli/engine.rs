//! The live engine behind the pipeline's traits: options from flags, reports from results.

use super::args::{DomainArg, EffortArg, EngineArgs, MapArgs, PackingArg, SchemeArg};
use super::failure::{Failure, Kind};
use saint_live::codec::{CodecOptions, Domain, Effort, EncodedFrame, Encoder, Spent, polar};
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

mod rate;
mod residual;

use rate::Rate;
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
        let quality = args.quality.map(|quality| {
            ContactDistance::default().scaled(2f64.powf((50.0 - f64::from(quality)) / 12.5))
        });
        let contact = args
            .contact_distance
            .or(quality)
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
    /// Bits per second to keep to.
    pub bitrate: Option<f64>,
    /// Threads, at least 1.
    pub threads: usize,
}

impl Engine {
    /// Options from flags.
    pub fn resolve(args: &EngineArgs, map: &MapArgs) -> Result<Self, Failure> {
        let fit = Fit::resolve(args)?;
        let contact = fit.contact_distance();
        if args.bitrate.is_some() {
            let live = matches!(fit, Fit::Live(_)) && map.contact_map == DomainArg::Sensor;
            if !live {
                return Err(Failure::usage(
                    "--bitrate goes with --scheme live and --contact-map sensor only",
                ));
            }
        }
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
        let every = args.keyframe_every.unwrap_or(KEYFRAME_EVERY);
        let mut codec = CodecOptions::fitted(contact, every);
        codec.tolerance.lossless = args.lossless;
        codec.smooth_mask = args.smooth_mask;
        codec.effort = match args.effort {
            EffortArg::Live => Effort::Live,
            EffortArg::Usual => Effort::Usual,
            EffortArg::Max => Effort::Max,
        };
        if let Some(most) = args.max_error {
            codec.tolerance.contact = ContactDistance::constant(most.0);
        }
        let cores = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
        Ok(Self {
            fit,
            codec,
            polar_step_m,
            bitrate: args.bitrate,
            threads: args.threads.map_or(cores, usize::from),
        })
    }

    /// Threads that model and encode of one of `cameras` work with, each. Where frames wait for us,
    /// each keeps a core busy by itself: on two cores a second worker would only take turns with it.
    /// Where we wait for frames the other core is free while a frame is modelled or encoded. The
    /// paper's own schemes take so long that encode does not count.
    pub fn stage_threads(&self, cameras: usize, frames_wait: bool) -> usize {
        let share = self.threads / cameras.max(1);
        let beside = usize::from(frames_wait && matches!(self.fit, Fit::Live(_)));
        share.saturating_sub(beside).max(1)
    }

    /// Makes the calling thread a pool of one worker; where it is in one already, that stays.
    pub fn own_worker() -> Option<rayon::ThreadPool> {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(1);
        pool.use_current_thread().build().ok()
    }

    /// Makes the calling thread the first worker of the process's common pool. Once per process.
    pub fn start_workers(&self) -> Result<(), Failure> {
        let workers = self.stage_threads(1, false);
        rayon::ThreadPoolBuilder::new()
            .num_threads(workers)
            .thread_name(|n| format!("model-{n}"))
            .use_current_thread()
            .build_global()
            .map_err(|error| {
                Failure::new(
                    Kind::Failure,
                    format_args!("cannot start {workers} threads: {error}"),
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
        if let Some(bits_per_s) = self.bitrate {
            // the two distances are where it starts
            notes.insert("bitrate".to_owned(), bits_per_s.to_string());
        }
        notes.insert(CONTACT_MAP_NOTE.to_owned(), domain.name().to_owned());
        notes
    }
}

/// The stages of one camera, bound by the rate control where there is one.
pub fn stages(camera: &Camera, engine: &Engine) -> Result<(Box<dyn Model>, EncodeStage), Failure> {
    let mut encode = EncodeStage::new(camera, engine)?;
    let model: Box<dyn Model> = match (&engine.fit, engine.bitrate) {
        (Fit::Live(options), Some(bits_per_s)) => {
            let (plan, rate) = rate::link(bits_per_s, &engine.codec);
            encode.rate = Some(rate);
            Box::new(plan.of(Modeler::new(camera, options)))
        }
        (Fit::Live(options), None) => Box::new(Modeler::new(camera, options)),
        (Fit::Framewise(parameters), _) => Box::new(
            FrameFit::new(camera, parameters).map_err(|error| Failure::new(Kind::Usage, error))?,
        ),
    };
    Ok((model, encode))
}

/// The encode stage.
pub struct EncodeStage {
    coding: Coding,
    /// Looks at errors; not where they are measured otherwise.
    sampler: Option<Sampler>,
    rate: Option<Rate>,
}

enum Coding {
    Sensor(Box<Encoder>),
    Polar(Box<PolarMapper>),
}

impl EncodeStage {
    fn new(camera: &Camera, engine: &Engine) -> Result<Self, Failure> {
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
            sampler: Some(Sampler::new(camera)),
            rate: None,
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
        let (lost, spent) = match &mut self.coding {
            Coding::Sensor(encoder) => {
                if let Some(distance) = self.rate.as_mut().and_then(Rate::next) {
                    encoder.set_contact_distance(distance);
                }
                let report = if modelled.hurried {
                    encoder.encode_plainly(depth, saint, encoded)?
                } else {
                    encoder.encode(depth, saint, modelled.degraded, encoded)?
                };
                if let Some(rate) = &mut self.rate {
                    rate.observe(encoded);
                }
                (report.lost_pixels, report.spent())
            }
            Coding::Polar(mapper) => {
                let (map, lost) = mapper.map(depth, saint)?;
                encoded.sequence = depth.sequence;
                encoded.time = depth.time;
                encoded.key = true;
                encoded.payload.clear();
                polar::encode(&map, &mut encoded.payload)?;
                (lost, Spent::default())
            }
        };
        let residual = match (&mut self.sampler, &self.coding) {
            (Some(sampler), Coding::Sensor(encoder)) => sampler.of_payload(depth, encoder),
            (Some(sampler), Coding::Polar(_)) => sampler.of_spheres(depth, saint),
            (None, _) => Residual::default(),
        };
        Ok(CodingReport {
            lost,
            residual,
            spent,
        })
    }

    fn start_over(&mut self) -> bool {
        match &mut self.coding {
            Coding::Sensor(encoder) => encoder.request_key(),
            Coding::Polar(_) => return false,
        }
        if let Some(rate) = &mut self.rate {
            rate.start_over();
        }
        true
    }
}
