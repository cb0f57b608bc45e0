//! Scales: for each number of spheres the contact distance that goes with it.
//!
//! Paper 4.1: "For each set number of spheres, if the *contact distance* is varied, we achieve
//! multi-scale representation". Given the number, the distance is searched: the smallest at which
//! so many spheres still explain all but 0.1 % of the points.

use super::build::printed_distance;
use crate::fit::cloud::{CloudModel, FitParameters, UNEXPLAINED_SHARE};
use crate::fit::contact_distance::ContactDistance;
use crate::fit::scheme::{CloudFit, ParameterError};
use crate::partition::points::LocalPoints;

/// Distances that differ by less than this factor are the same.
const CLOSE: f64 = 1.04;
/// Fits per scale, at most.
const TRIES: usize = 14;

/// Digits of a distance that is tried: what is printed is what was used.
const DIGITS: usize = 3;

/// A model and the parameters it was made with.
pub type Scaled = (CloudModel, FitParameters);

/// Fits at most `spheres` spheres with the smallest constant contact distance, no smaller than
/// that of `parameters`, that explains 99.9 % of the points. `guess_m` is where the search
/// begins, metres; twice or half costs one fit more. Where no distance tried does it, the model
/// that explains most. Deterministic.
///
/// # Errors
/// Parameters out of range.
pub fn fit(
    fitter: &mut CloudFit,
    points: &LocalPoints,
    parameters: &FitParameters,
    spheres: usize,
    guess_m: f64,
) -> Result<Scaled, ParameterError> {
    let floor_m = parameters.contact_distance.floor_m;
    let mut attempt = |contact_m: f64| {
        // a few more than asked for: the last ones make early ones superfluous
        let tried = FitParameters {
            contact_distance: ContactDistance::constant(contact_m),
            max_spheres: spheres + spheres / 8 + 2,
            ..*parameters
        };
        let model = fitter.fit(points, &tried)?;
        let few = model.spheres.len() <= spheres;
        let kept = FitParameters {
            max_spheres: spheres,
            ..tried
        };
        Ok((
            few && model.explained >= 1.0 - UNEXPLAINED_SHARE,
            (model, kept),
        ))
    };
    let (mut too_small, mut enough): (Option<f64>, Option<(f64, Scaled)>) = (None, None);
    let mut contact_m = printed_distance(guess_m, DIGITS).max(floor_m);
    for _ in 0..TRIES {
        let (reached, scaled) = attempt(contact_m)?;
        if reached {
            enough = Some((contact_m, scaled));
        } else {
            too_small = Some(contact_m);
        }
        contact_m = match (&enough, too_small) {
            (Some((at, _)), _) if *at <= floor_m => break,
            (Some((at, _)), Some(below)) if *at < below * CLOSE => break,
            (Some((at, _)), Some(below)) => (at * below).sqrt(),
            (Some((at, _)), None) => (0.5 * at).max(floor_m),
            (None, _) => 2.0 * contact_m,
        };
        contact_m = printed_distance(contact_m, DIGITS).max(floor_m);
    }
    if let Some((_, scaled)) = enough {
        return Ok(scaled);
    }
    // no surface of so few spheres: what the last distance gives, cut to the number
    let last = FitParameters {
        contact_distance: ContactDistance::constant(contact_m),
        max_spheres: spheres,
        ..*parameters
    };
    Ok((fitter.fit(points, &last)?, last))
}
