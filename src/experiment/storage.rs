//! Figures 8 to 10: bytes, beside those of general and point-cloud compression.
//!
//! Compressors that are not part of this crate come in as functions ([`Tools`]): the command
//! line runs the programs where they are installed.

use super::map_resolution::bend_planes;
use super::{Cell, Curve, Effort, ExperimentError, Report, Series, Subject, Table};
use crate::codec::polar;
use crate::contact_map::merged::{ClaimMap, LiteralMap};
use crate::contact_map::polar::PolarGrid;
use crate::fit::cloud::{CloudModel, FitParameters, Scheme, UNASSIGNED};
use crate::fit::contact_distance::ContactDistance;
use crate::fit::scheme::CloudFit;
use crate::partition::points::LocalPoints;
use crate::quality::cloud_error;
use flate2::Compression;
use flate2::write::GzEncoder;
use glam::DVec3;
use std::io::Write;

/// Chamfer distance aimed at, % of the diagonal, where none is asked for.
pub const CHAMFER_PERCENT: f64 = 0.1;
/// Halvings in the search for the contact distance.
const HALVINGS: usize = 7;
/// Quantisation bits tried for Draco.
const DRACO_BITS: std::ops::RangeInclusive<u32> = 6..=16;
/// In place of a number that was not measured.
const MISSING: &str = "not installed";

/// A general compressor: bytes in, size out; `None` where there is none.
pub type Squeeze<'a> = &'a dyn Fn(&[u8]) -> Option<usize>;
/// Draco: points (metres, about a local origin) and quantisation bits in, size and decoded points out.
pub type DracoRun<'a> = &'a dyn Fn(&[DVec3], u32) -> Option<(usize, Vec<DVec3>)>;

/// Compressors outside this crate.
#[derive(Clone, Copy)]
pub struct Tools<'a> {
    /// Zstandard at its best ordinary level (19).
    pub zstd: Squeeze<'a>,
    /// Draco, kd-tree, level 10.
    pub draco: DracoRun<'a>,
}

/// Rows of one subject: method, bytes of each seed, Chamfer (%), points kept (%).
struct Method {
    name: String,
    bytes: Vec<f64>,
    chamfer: Vec<f64>,
    kept: Vec<f64>,
}

/// Compares sizes at `chamfer_percent` of the diagonal.
///
/// # Errors
/// [`ExperimentError`].
pub fn run(
    subjects: &[Subject],
    effort: Effort,
    chamfer_percent: f64,
    tools: Tools<'_>,
) -> Result<Report, ExperimentError> {
    let mut table = Table::new(
        "bytes by method",
        &[
            "data",
            "method",
            "bytes",
            "bits per point",
            "of gzip raw",
            "Chamfer %",
            "points kept %",
        ],
    );
    let mut findings = Vec::new();
    let mut curve = Curve {
        title: "Size against gzip of the raw points".to_owned(),
        x: "data set".to_owned(),
        y: "bytes, gzip of raw = 1".to_owned(),
        log: (false, true),
        ..Curve::default()
    };
    for (place, subject) in subjects.iter().enumerate() {
        let methods = methods(subject, effort, chamfer_percent, tools)?;
        let mean = |m: &Method| m.bytes.iter().sum::<f64>() / m.bytes.len().max(1) as f64;
        let find = |name: &str| methods.iter().find(|m| m.name == name);
        let gzip = find("gzip of raw").map_or(1.0, mean);
        for method in &methods {
            let bytes = mean(method);
            let known = !method.bytes.is_empty();
            let number = |v: f64| {
                if known {
                    Cell::Number(v)
                } else {
                    Cell::text(MISSING)
                }
            };
            table.rows.push(vec![
                Cell::text(&*subject.name),
                Cell::text(&*method.name),
                if known {
                    Cell::spread(&method.bytes)
                } else {
                    Cell::text(MISSING)
                },
                number(8.0 * bytes / subject.points.len() as f64),
                number(bytes / gzip),
                Cell::spread(&method.chamfer),
                Cell::spread(&method.kept),
            ]);
            if known {
                let name = method.name.split(" (").next().unwrap_or_default();
                let point = (place as f64 + 1.0, bytes / gzip);
                match curve.series.iter_mut().find(|s| s.name == name) {
                    Some(series) => series.points.push(point),
                    None => curve.series.push(Series {
                        name: name.to_owned(),
                        points: vec![point],
                    }),
                }
            }
        }
        findings.push(verdict(subject, &methods, gzip));
    }
    Ok(Report {
        experiment: "storage",
        claim: "Fig. 8–10: storage is one third of what a standard compression obtains",
        method: "Raw: three 32-bit floats a point. SAINT: random scheme, contact distance chosen so that the points rebuilt have the Chamfer distance aimed at, metric contact map with cells of that contact distance, payload as FORMAT.md has it. Merged map of the paper: 16 bytes a sphere, 6 bytes a cell, mr such that a cell of the median sphere is as long. Rounded: coordinates rounded to that Chamfer distance, 16 or 32 bits each, then gzip. gzip level 9, zstd level 19, Draco kd-tree level 10, interpolated between the two numbers of bits around the distance",
        data: subjects.iter().map(Subject::describe).collect(),
        seeds: effort.seeds,
        tables: vec![table],
        findings,
        curve,
    })
}

fn verdict(subject: &Subject, methods: &[Method], gzip: f64) -> String {
    let bytes = |start: &str| {
        let found = methods.iter().find(|m| m.name.starts_with(start))?;
        let mean = found.bytes.iter().sum::<f64>() / found.bytes.len() as f64;
        mean.is_finite().then_some(mean)
    };
    let saint = bytes("gzip of SAINT").unwrap_or(f64::NAN);
    let ratio =
        |other: Option<f64>| other.map_or_else(|| "–".to_owned(), |o| format!("{:.2}", saint / o));
    format!(
        "{}: gzip of SAINT is {:.2} of gzip of raw: one third is {}. At equal error it is {} of gzipped rounded coordinates and {} of Draco.",
        subject.name,
        saint / gzip,
        if saint / gzip <= 1.0 / 3.0 {
            "reached"
        } else {
            "NOT reached"
        },
        ratio(bytes("gzip of rounded")),
        ratio(bytes("Draco")),
    )
}

fn methods(
    subject: &Subject,
    effort: Effort,
    chamfer_percent: f64,
    tools: Tools<'_>,
) -> Result<Vec<Method>, ExperimentError> {
    let points = subject.local()?;
    let local: Vec<DVec3> = (0..points.len()).map(|i| points.at(i).as_dvec3()).collect();
    let raw: Vec<u8> = local
        .iter()
        .flat_map(|p| p.as_vec3().to_array())
        .flat_map(f32::to_le_bytes)
        .collect();
    let all = |name: &str, bytes: Option<usize>, chamfer: f64| Method {
        name: name.to_owned(),
        bytes: bytes.iter().map(|b| *b as f64).collect(),
        chamfer: vec![chamfer],
        kept: vec![100.0],
    };
    let mut methods = vec![
        all("raw", Some(raw.len()), 0.0),
        all("gzip of raw", Some(gzip(&raw)), 0.0),
        all("zstd of raw", (tools.zstd)(&raw), 0.0),
    ];
    let aim_m = 0.01 * chamfer_percent * subject.diagonal_m();
    let (rounded, error) = rounded(&local, aim_m);
    let percent = |m: f64| 100.0 * m / subject.diagonal_m();
    methods.push(all("gzip of rounded", Some(gzip(&rounded)), percent(error)));
    methods.extend(saint(subject, &points, &local, effort, aim_m, tools)?);
    methods.push(match draco_at(&local, aim_m, tools.draco) {
        Some((bytes, bits)) => all(
            &format!("Draco (between qp {} and {bits})", bits - 1),
            Some(bytes),
            percent(aim_m),
        ),
        None => Method {
            name: "Draco".to_owned(),
            bytes: Vec::new(),
            chamfer: Vec::new(),
            kept: Vec::new(),
        },
    });
    Ok(methods)
}

/// Draco's bytes at a Chamfer distance of `aim_m`, and the fewest bits that reach it: its error
/// halves from one number of bits to the next, so the bytes between two are interpolated (in
/// the logarithm of the distance).
fn draco_at(local: &[DVec3], aim_m: f64, run: DracoRun<'_>) -> Option<(usize, u32)> {
    let mut before: Option<(f64, f64)> = None;
    for bits in DRACO_BITS {
        let (bytes, decoded) = run(local, bits)?;
        let now = (bytes as f64, cloud_error(local, &decoded).chamfer_m);
        if now.1 <= aim_m {
            let Some(coarser) = before else {
                return Some((bytes, bits));
            };
            let share = (coarser.1 / aim_m).ln() / (coarser.1 / now.1).ln();
            let between = coarser.0 + share * (now.0 - coarser.0);
            return Some((between.round() as usize, bits));
        }
        before = Some(now);
    }
    None
}

/// SAINT in our map and in the paper's, plain, gzipped and by zstd.
fn saint(
    subject: &Subject,
    points: &LocalPoints,
    local: &[DVec3],
    effort: Effort,
    aim_m: f64,
    tools: Tools<'_>,
) -> Result<Vec<Method>, ExperimentError> {
    let names = [
        "SAINT",
        "gzip of SAINT",
        "zstd of SAINT",
        "merged map of the paper",
        "gzip of merged map",
    ];
    let mut methods: Vec<Method> = names
        .iter()
        .map(|name| Method {
            name: (*name).to_owned(),
            bytes: Vec::new(),
            chamfer: Vec::new(),
            kept: Vec::new(),
        })
        .collect();
    let percent = |m: f64| 100.0 * m / subject.diagonal_m();
    let n = points.len() as f64;
    for seed in 0..effort.seeds {
        let (model, map, chamfer) = at_chamfer(points, local, aim_m, seed)?;
        let mut payload = Vec::new();
        polar::encode(&map, &mut payload).map_err(|e| ExperimentError::Data(e.to_string()))?;
        let sizes = [
            Some(payload.len()),
            Some(gzip(&payload)),
            (tools.zstd)(&payload),
        ];
        for (method, size) in methods.iter_mut().zip(sizes) {
            if let Some(size) = size {
                method.bytes.push(size as f64);
                method.chamfer.push(percent(chamfer));
                method.kept.push(100.0 * map.cells.len() as f64 / n);
            }
        }
        let mut model = model;
        bend_planes(points, &mut model, f64::from(map.step_m));
        let grid = grid_of_step(&model, f64::from(map.step_m));
        let literal = LiteralMap::new(points, &model, grid);
        let bytes = literal_bytes(&model, &literal);
        let error = cloud_error(local, &literal.rebuild(&model)).chamfer_m;
        for (method, size) in methods[3..].iter_mut().zip([bytes.len(), gzip(&bytes)]) {
            method.bytes.push(size as f64);
            method.chamfer.push(percent(error));
            method.kept.push(100.0 * literal.cells.len() as f64 / n);
        }
    }
    Ok(methods)
}

/// The model whose map with cells of the contact distance has the Chamfer distance aimed at, as
/// nearly as a search by halving finds it from below.
fn at_chamfer(
    points: &LocalPoints,
    local: &[DVec3],
    aim_m: f64,
    seed: u64,
) -> Result<(CloudModel, ClaimMap, f64), ExperimentError> {
    let at = |contact_m: f64| -> Result<_, ExperimentError> {
        let parameters = FitParameters {
            contact_distance: ContactDistance::constant(contact_m),
            scheme: Scheme::Random,
            seed,
            ..FitParameters::default()
        };
        let model = CloudFit::default().fit(points, &parameters)?;
        let (map, _) = ClaimMap::new(points, &model, contact_m as f32);
        let chamfer = cloud_error(local, &map.rebuild()).chamfer_m;
        Ok((model, map, chamfer))
    };
    let (mut low, mut high) = (0.25 * aim_m, 8.0 * aim_m);
    let mut best = at(low)?;
    for _ in 0..HALVINGS {
        let middle = (low * high).sqrt();
        let found = at(middle)?;
        if found.2 <= 1.01 * aim_m {
            low = middle;
            best = found;
        } else {
            high = middle;
        }
    }
    Ok(best)
}

/// The paper's grid whose cells are about `step_m` long on the sphere that the median point has.
fn grid_of_step(model: &CloudModel, step_m: f64) -> PolarGrid {
    let mut radii: Vec<f64> = model
        .assignment
        .iter()
        .filter(|s| **s != UNASSIGNED)
        .map(|s| model.spheres[*s as usize].center_radius().1)
        .collect();
    radii.sort_by(f64::total_cmp);
    let radius = radii.get(radii.len() / 2).copied().unwrap_or(1.0);
    PolarGrid::new((std::f64::consts::PI * radius / step_m).min(65536.0) as u32)
}

/// The paper's form: four floats a sphere; row, column and sphere number of each cell in use.
fn literal_bytes(model: &CloudModel, map: &LiteralMap) -> Vec<u8> {
    let spheres = model.spheres.iter().flat_map(|s| s.paper_floats());
    let mut bytes: Vec<u8> = spheres.flat_map(f32::to_le_bytes).collect();
    for (cell, sphere) in &map.cells {
        let (row, column) = (cell / map.grid.columns, cell % map.grid.columns);
        for v in [row, column, *sphere] {
            bytes.extend_from_slice(&(v as u16).to_le_bytes());
        }
    }
    bytes
}

/// Coordinates rounded so coarsely that their mean error is `aim_m`, and that error.
fn rounded(local: &[DVec3], aim_m: f64) -> (Vec<u8>, f64) {
    // mean distance of a point of a cube from its middle: 0.480296 sides
    let step = aim_m / 0.480_296;
    let low = local.iter().fold(DVec3::MAX, |a, b| a.min(*b));
    let cells: Vec<DVec3> = local.iter().map(|p| ((*p - low) / step).round()).collect();
    let largest = cells.iter().fold(0.0, |a: f64, c| a.max(c.max_element()));
    let bytes = cells.iter().flat_map(|c| c.to_array()).flat_map(|v| {
        let bytes = (v as u32).to_le_bytes();
        let width = if largest < 65536.0 { 2 } else { 4 };
        bytes.into_iter().take(width)
    });
    let back: Vec<DVec3> = cells.iter().map(|c| low + *c * step).collect();
    (bytes.collect(), cloud_error(local, &back).chamfer_m)
}

fn gzip(bytes: &[u8]) -> usize {
    let mut encoder = GzEncoder::new(Vec::new(), Compression::best());
    // writing to memory does not fail
    match encoder.write_all(bytes).and_then(|()| encoder.finish()) {
        Ok(packed) => packed.len(),
        Err(_) => bytes.len(),
    }
}
