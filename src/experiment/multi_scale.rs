//! Figures 5 and 7: models of 5 to 250 spheres.

use super::{Cell, Curve, Effort, ExperimentError, Report, Series, Subject, Table};
use crate::codec::polar;
use crate::contact_map::merged::ClaimMap;
use crate::fit::cloud::{CloudModel, FitParameters, Scheme, UNEXPLAINED_SHARE};
use crate::fit::contact_distance::ContactDistance;
use crate::fit::scheme::CloudFit;
use crate::partition::points::LocalPoints;
use crate::quality::cloud_error;

/// The paper's numbers of spheres.
pub const SCALES: [usize; 7] = [5, 10, 20, 50, 100, 200, 250];
/// Most points on which the contact distance of a scale is looked for. Spheres fit a thin sample
/// better than the cloud it is of.
const PROBE_POINTS: usize = 20_000;
/// Halvings of the search, from a factor of 20 000: to 2 %.
const HALVINGS: usize = 9;

/// What one model of one scale gives.
struct Scale {
    explained: f64,
    chamfer: f64,
    spheres: f64,
    contact: f64,
    bytes: f64,
}

/// Fits every subject at every scale, twice: with the subject's own contact distance (figure 5),
/// and with the smallest contact distance at which that many spheres touch 99.9 % of the points
/// (figure 7: "contact distance is different for each of the configurations").
///
/// # Errors
/// [`ExperimentError`].
pub fn run(subjects: &[Subject], effort: Effort) -> Result<Report, ExperimentError> {
    let columns = [
        "data",
        "spheres",
        "contact %",
        "explained %",
        "Chamfer %",
        "payload bytes",
    ];
    let mut fixed = Table::new(
        "one contact distance, more and more spheres (Fig. 5)",
        &columns,
    );
    let mut free = Table::new(
        "smallest contact distance at which the spheres touch 99.9 % (Fig. 7)",
        &columns,
    );
    let mut curve = Curve {
        title: "Error against number of spheres".to_owned(),
        x: "spheres".to_owned(),
        y: "Chamfer, % of diagonal".to_owned(),
        log: (true, true),
        ..Curve::default()
    };
    let mut falls = Vec::new();
    for subject in subjects {
        let points = subject.local()?;
        let mut series = Series {
            name: subject.name.clone(),
            points: Vec::new(),
        };
        for scale in SCALES {
            let (mut given, mut found) = (Vec::new(), Vec::new());
            for seed in 0..effort.seeds {
                given.push(model(subject, &points, subject.contact, scale, seed)?);
                let contact = finest(subject, scale, seed)?;
                found.push(model(subject, &points, contact, scale, seed)?);
            }
            fixed.rows.push(row(subject, scale, &given));
            free.rows.push(row(subject, scale, &found));
            let mean = found.iter().map(|s| s.chamfer).sum::<f64>() / found.len() as f64;
            series.points.push((scale as f64, mean));
        }
        if let (Some(first), Some(last)) = (series.points.first(), series.points.last()) {
            falls.push((first.1 / last.1).ln());
        }
        curve.series.push(series);
    }
    let mean_fall = (falls.iter().sum::<f64>() / falls.len().max(1) as f64).exp();
    Ok(Report {
        experiment: "multi-scale",
        claim: "Fig. 5, 7: finer details are achieved as the number of spheres increases",
        method: "Random scheme; Chamfer distance of the points rebuilt from a metric contact map (cells of half the contact distance) to the original, in % of the bounding box's diagonal; payload as FORMAT.md has it",
        data: subjects.iter().map(Subject::describe).collect(),
        seeds: effort.seeds,
        tables: vec![fixed, free],
        findings: vec![format!(
            "From 5 to 250 spheres the Chamfer distance falls {mean_fall:.1} times (geometric mean over data, contact distance as small as 99.9 % allow)."
        )],
        curve,
    })
}

fn row(subject: &Subject, scale: usize, scales: &[Scale]) -> Vec<Cell> {
    let spread = |f: fn(&Scale) -> f64| Cell::spread(&scales.iter().map(f).collect::<Vec<_>>());
    let used = spread(|s| s.spheres);
    let spheres = match used.value() {
        Some(v) if v == scale as f64 => Cell::from(scale),
        _ => Cell::text(format!("{scale} (used {used})")),
    };
    vec![
        Cell::text(&*subject.name),
        spheres,
        spread(|s| s.contact),
        spread(|s| s.explained),
        spread(|s| s.chamfer),
        spread(|s| s.bytes),
    ]
}

fn model(
    subject: &Subject,
    points: &LocalPoints,
    contact: ContactDistance,
    scale: usize,
    seed: u64,
) -> Result<Scale, ExperimentError> {
    let model = fit(points, contact, scale, seed)?;
    let diagonal = subject.diagonal_m();
    let (map, _) = ClaimMap::new(points, &model, (0.5 * contact.floor_m) as f32);
    let mut payload = Vec::new();
    polar::encode(&map, &mut payload).map_err(|e| ExperimentError::Data(e.to_string()))?;
    let rebuilt: Vec<_> = map.rebuild().iter().map(|p| *p + map.origin).collect();
    Ok(Scale {
        explained: 100.0 * model.explained,
        chamfer: 100.0 * cloud_error(&subject.points, &rebuilt).chamfer_m / diagonal,
        spheres: model.spheres.len() as f64,
        contact: 100.0 * contact.floor_m / diagonal,
        bytes: payload.len() as f64,
    })
}

fn fit(
    points: &LocalPoints,
    contact: ContactDistance,
    scale: usize,
    seed: u64,
) -> Result<CloudModel, ExperimentError> {
    let parameters = FitParameters {
        max_spheres: scale,
        contact_distance: contact,
        scheme: Scheme::Random,
        seed,
        ..FitParameters::default()
    };
    Ok(CloudFit::default().fit(points, &parameters)?)
}

/// The smallest constant contact distance, to about 2 %, at which `scale` spheres touch enough
/// of a sample of the points.
fn finest(subject: &Subject, scale: usize, seed: u64) -> Result<ContactDistance, ExperimentError> {
    let stride = subject.points.len().div_ceil(PROBE_POINTS).max(1);
    let sample: Vec<_> = subject.points.iter().copied().step_by(stride).collect();
    let points = LocalPoints::new(&sample)?;
    let (mut low, mut high) = (1e-5 * subject.diagonal_m(), 0.2 * subject.diagonal_m());
    for _ in 0..HALVINGS {
        let middle = (low * high).sqrt();
        let found = fit(&points, ContactDistance::constant(middle), scale, seed)?;
        if found.explained >= 1.0 - UNEXPLAINED_SHARE {
            high = middle;
        } else {
            low = middle;
        }
    }
    Ok(ContactDistance::constant(high))
}
