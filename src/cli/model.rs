//! `model`: static clouds as spheres and contact maps.

use super::args::{CloudMapArg, CloudSchemeArg, ModelArgs, PackingArg};
use super::failure::{Failure, Kind};
use super::message;
use super::values::MapResolution;
use saint_live::cloud::{Cloud, CloudError};
use saint_live::fit::cloud::{FitParameters, Scheme};
use saint_live::fit::contact_distance::ContactDistance;
use saint_live::fit::scheme::CloudFit;
use saint_live::model::build::{self, MapChoice, Unfit};
use saint_live::model::file;
use saint_live::model::{ObjectInfo, Part, Scene, scales};
use saint_live::partition::lattice::Packing;
use saint_live::partition::points::LocalPoints;
use saint_live::recording::Target;
use serde::Serialize;
use std::fmt::Write as _;
use std::path::Path;
use std::time::Instant;

/// What `--json` prints.
#[derive(Serialize)]
struct Report<'a> {
    output: Option<String>,
    bytes: u64,
    threads: usize,
    read_s: f64,
    fit_s: f64,
    map_s: f64,
    check_s: f64,
    peak_memory_mb: f64,
    #[serde(flatten)]
    scene: &'a Scene,
}

/// Seconds spent on each step.
#[derive(Default)]
struct Spent {
    read_s: f64,
    fit_s: f64,
    map_s: f64,
    /// The Chamfer distance.
    check_s: f64,
}

fn timed<T>(spent_s: &mut f64, work: impl FnOnce() -> T) -> T {
    let begin = Instant::now();
    let result = work();
    *spent_s += begin.elapsed().as_secs_f64();
    result
}

/// Models the clouds.
pub fn run(args: &ModelArgs, quiet: bool) -> Result<(), Failure> {
    let map = map_choice(args)?;
    let to_stdout = args.output.as_deref() == Some(Path::new("-"));
    if to_stdout && args.json {
        return Err(Failure::usage(
            "--json and -o - both use standard output; give the model a file",
        ));
    }
    if let Some(path) = args
        .output
        .as_deref()
        .filter(|_| !to_stdout && !args.overwrite)
        && path.is_file()
    {
        // told before the work, not after
        return Err(Failure::usage(format_args!(
            "{} exists already; give another name or --overwrite",
            path.display()
        )));
    }
    let threads = args.threads.map_or(0, usize::from);
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .thread_name(|i| format!("model-{i}"))
        .build()
        .map_err(|e| Failure::new(Kind::Failure, format_args!("cannot start threads: {e}")))?;
    let mut spent = Spent::default();
    let (scene, parts) = pool.install(|| model(args, map, quiet, &mut spent))?;
    let mut bytes = 0;
    if let Some(path) = &args.output {
        let target = if to_stdout {
            Target::stdout()?
        } else {
            Target::File {
                path: path.clone(),
                overwrite: args.overwrite,
            }
        };
        bytes = file::write(&scene, &parts, target)?;
    }
    let output = args.output.as_ref().map(|path| path.display().to_string());
    if !quiet {
        for part in &parts {
            message::say(&line(&scene, part));
        }
        let spheres: u64 = parts.iter().map(|p| u64::from(p.info.spheres)).sum();
        let wrote = output.as_ref().map_or_else(
            || "nothing written (no -o)".to_owned(),
            |path| format!("wrote {path}: {bytes} bytes"),
        );
        message::say(&format!(
            "{wrote}; {} parts, {spheres} spheres; read {:.3} s, fit {:.4} s, map {:.4} s, check {:.3} s, peak memory {:.0} MB",
            parts.len(),
            spent.read_s,
            spent.fit_s,
            spent.map_s,
            spent.check_s,
            peak_memory_mb(),
        ));
    }
    if args.json {
        let report = Report {
            output,
            bytes,
            threads: pool.current_num_threads(),
            read_s: spent.read_s,
            fit_s: spent.fit_s,
            map_s: spent.map_s,
            check_s: spent.check_s,
            peak_memory_mb: peak_memory_mb(),
            scene: &scene,
        };
        print_json(&report)?;
    }
    Ok(())
}

/// Reads and models object by object; the points of one are in memory at a time.
fn model(
    args: &ModelArgs,
    map: MapChoice,
    quiet: bool,
    spent: &mut Spent,
) -> Result<(Scene, Vec<Part>), Failure> {
    let scheme = match args.scheme {
        CloudSchemeArg::Random => Scheme::Random,
        CloudSchemeArg::Progressive => Scheme::Progressive,
    };
    let packing = match args.packing {
        PackingArg::Hex => Packing::Hexagonal,
        PackingArg::Cubic => Packing::Cubic,
    };
    let mut numbers = args.scales.clone();
    numbers.sort_unstable();
    numbers.dedup();
    let mut scene = Scene {
        generator: concat!(env!("CARGO_PKG_NAME"), " ", env!("CARGO_PKG_VERSION")).to_owned(),
        scheme: scheme.to_string(),
        seed: args.seed,
        packing: packing.to_string(),
        spheres_per_cube: args.spheres_per_cube.into(),
        scales: if numbers.is_empty() {
            vec![args.max_spheres]
        } else {
            numbers.clone()
        },
        ..Scene::default()
    };
    let mut fitter = CloudFit::default();
    let mut parts: Vec<Part> = Vec::new();
    for path in &args.clouds {
        let (points, mut info) = timed(&mut spent.read_s, || read(path, args, quiet))?;
        info.name = free_name(path, &scene.objects);
        let extent_m = info.extent_m.into();
        let default_m = build::default_contact_m(extent_m);
        let contact = args.contact_distance;
        let parameters = FitParameters {
            max_spheres: args.max_spheres as usize,
            contact_distance: contact.unwrap_or(ContactDistance::constant(if numbers.is_empty() {
                default_m
            } else {
                // what single precision still tells apart
                default_m * 1e-3
            })),
            cube_size_m: args
                .cube_size
                .map_or(build::default_cube_m(extent_m), |c| c.0),
            spheres_per_cube: args.spheres_per_cube.into(),
            packing,
            scheme,
            seed: args.seed,
        };
        scene.cube_size_m = parameters.cube_size_m;
        build::check(&points, parameters.contact_distance.floor_m)
            .map_err(|unfit| refused(path, &info, unfit))?;
        let mut guess_m = 0.05 * glam::DVec3::from(info.extent_m).length();
        for (scale, number) in scene.scales.iter().enumerate() {
            let fitted = timed(&mut spent.fit_s, || {
                if numbers.is_empty() {
                    fitter
                        .fit(&points, &parameters)
                        .map(|model| (model, parameters))
                } else {
                    scales::fit(&mut fitter, &points, &parameters, *number as usize, guess_m)
                }
            });
            let (fitted, used) = fitted.map_err(Failure::usage)?;
            // residuals fall about as the number of spheres grows
            let next = scene.scales.get(scale + 1).copied().unwrap_or(*number);
            guess_m = used.contact_distance.floor_m * f64::from(*number) / f64::from(next);
            let failed = |e| Failure::new(Kind::Failure, format_args!("{}: {e}", path.display()));
            let part = timed(&mut spent.map_s, || {
                build::part(&points, &fitted, &used, map)
            });
            let mut part = part.map_err(failed)?;
            let chamfer_m = timed(&mut spent.check_s, || build::chamfer_m(&points, &part));
            part.info.chamfer_m = chamfer_m.map_err(failed)?;
            part.info.object = scene.objects.len() as u32;
            part.info.scale = scale as u32;
            parts.push(part);
        }
        scene.objects.push(info);
    }
    parts.sort_by_key(|p| (p.info.scale, p.info.object));
    scene.parts = parts.iter().map(|p| p.info.clone()).collect();
    Ok((scene, parts))
}

/// A cloud in metres about its own origin, described, its unit told.
fn read(path: &Path, args: &ModelArgs, quiet: bool) -> Result<(LocalPoints, ObjectInfo), Failure> {
    let cloud = Cloud::read(path)?;
    let (format, stated) = (cloud.format, cloud.stated_unit);
    let unit = args.unit.or(stated).unwrap_or_default();
    let points = LocalPoints::new(&cloud.into_metres(unit))
        .map_err(|e| Failure::new(Kind::Input, format_args!("{}: {e}", path.display())))?;
    let mut info = build::describe(&points);
    info.source = path.display().to_string();
    info.unit = unit.to_string();
    if quiet {
        return Ok((points, info));
    }
    let from = match (args.unit, stated) {
        (Some(_), _) => "as given",
        (None, Some(_)) => "the file says so",
        (None, None) => "assumed; --unit gives another",
    };
    let [x, y, z] = info.extent_m;
    let mut text = format!(
        "{}: {format}, {} points, 1 unit = 1 {unit} ({from}), {x:.4} x {y:.4} x {z:.4} m",
        info.source, info.points
    );
    if info.rejected > 0 {
        let _ = write!(text, ", {} not finite and left out", info.rejected);
    }
    if let Some(repeated @ 1..) = info.duplicates {
        let _ = write!(text, ", {repeated} repeat another");
    }
    message::say(&text);
    let widest = x.max(y).max(z);
    if args.unit.is_none()
        && let Some(other) = unit.suspected(widest)
    {
        message::say(&format!(
            "{}: is {widest:.3} m wide: if its coordinates are in {other}, give --unit {other}",
            info.source
        ));
    }
    Ok((points, info))
}

/// The file's name without its ending, with a number where it is taken.
fn free_name(path: &Path, taken: &[ObjectInfo]) -> String {
    let stem = path.file_stem().unwrap_or(path.as_os_str());
    let stem = stem.to_string_lossy();
    let free = |name: &String| !taken.iter().any(|o| o.name == *name);
    let numbered = (2..).map(|n| format!("{stem}-{n}"));
    let mut names = std::iter::once(stem.to_string()).chain(numbered);
    names.find(free).unwrap_or_default()
}

fn refused(path: &Path, info: &ObjectInfo, unfit: Unfit) -> Failure {
    match unfit {
        Unfit::NoSurface { points } => CloudError::NoSurface {
            path: path.to_owned(),
            points: points + info.rejected as usize,
            usable: points,
        }
        .into(),
        Unfit::TooWide { .. } => {
            Failure::new(Kind::Input, format_args!("{}: {unfit}", path.display()))
        }
    }
}

fn map_choice(args: &ModelArgs) -> Result<MapChoice, Failure> {
    match (args.contact_map, args.map_resolution) {
        (CloudMapArg::Claims, None) => Ok(MapChoice::Claims(None)),
        (CloudMapArg::Claims, Some(MapResolution::Side(side))) => {
            Ok(MapChoice::Claims(Some(side.0)))
        }
        (CloudMapArg::Merged, None) => Ok(MapChoice::Merged(build::DEFAULT_ROWS)),
        (CloudMapArg::Merged, Some(MapResolution::Cells(cells))) => Ok(MapChoice::Merged(cells)),
        (CloudMapArg::Claims, Some(MapResolution::Cells(_))) => Err(Failure::usage(
            "--contact-map claims has cells of one length: give --map-resolution a length with its unit (0.5mm)",
        )),
        (CloudMapArg::Merged, Some(MapResolution::Side(_))) => Err(Failure::usage(
            "--contact-map merged has the same cells on every sphere: give --map-resolution their number over 180 degrees (1024)",
        )),
    }
}

/// One part, for people.
pub fn line(scene: &Scene, part: &Part) -> String {
    let info = &part.info;
    let object = &scene.objects[info.object as usize];
    let mut text = format!(
        "{}: {} points -> {} spheres at {}, {:.2} % explained, residual mean {:.4} p99 {:.4} mm, {} bytes ({:.1} % of 3 floats a point)",
        object.name,
        object.points,
        info.spheres,
        info.contact_distance,
        100.0 * info.explained,
        1e3 * info.residual.mean_m,
        1e3 * info.residual.p99_m,
        info.bytes,
        100.0 * info.bytes as f64 / object.raw_bytes.max(1) as f64,
    );
    let map = &info.map;
    let _ = write!(
        text,
        "; {} map of {}: {} cells, {} of {} points kept ({} share a cell)",
        map.kind,
        if map.kind == "merged" {
            format!("{} rows", map.resolution)
        } else {
            format!("{:.4} mm", 1e3 * map.resolution)
        },
        map.cells,
        map.kept(),
        map.points,
        map.shared,
    );
    if map.kind == "merged" {
        let _ = write!(text, ", {} collisions", map.collisions);
    }
    match info.chamfer_m {
        Some(chamfer_m) => {
            let _ = write!(text, ", Chamfer {:.4} mm", 1e3 * chamfer_m);
        }
        None => text.push_str(", Chamfer not measured"),
    }
    if scene.scales.len() > 1 {
        let _ = write!(text, "; scale {}", scene.scales[info.scale as usize]);
    }
    text
}

pub fn print_json(value: &impl Serialize) -> Result<(), Failure> {
    let mut text = serde_json::to_string(value).map_err(|e| Failure::new(Kind::Failure, e))?;
    text.push('\n');
    super::write_data(text.as_bytes())
}

fn peak_memory_mb() -> f64 {
    super::machine::peak_mb()
}
