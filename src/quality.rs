//! How far rebuilt geometry is from the original.
//!
//! Clouds: nearest-neighbour distances both ways ([`cloud_error`]). Depth frames that kept their
//! pixel grid: distance along the ray, pixel by pixel ([`depth_error`]), which also sees what a
//! nearest neighbour forgives. Percentiles interpolate linearly between ranks, as NumPy does.

use crate::frame::Camera;
use glam::DVec3;
use rayon::prelude::*;
use rstar::RTree;

/// Nearest-neighbour errors between two clouds, metres. All are infinite where one cloud is
/// empty and the other is not, and 0 where both are.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CloudError {
    /// Symmetric Chamfer distance: the mean of the two mean nearest-neighbour distances.
    pub chamfer_m: f64,
    /// D1: the larger of the two RMS nearest-neighbour distances.
    pub d1_m: f64,
    /// The larger of the two 99th percentiles.
    pub p99_m: f64,
    /// The larger of the two maxima (Hausdorff distance).
    pub max_m: f64,
    /// Mean distance from the original's points to the rebuilt cloud: what went missing.
    pub original_to_rebuilt_m: f64,
    /// Mean distance from the rebuilt points to the original: what was invented.
    pub rebuilt_to_original_m: f64,
}

/// Along-ray errors of a depth frame, metres, over the pixels valid on both sides; 0 where
/// there is none.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct DepthError {
    /// Pixels valid in the original.
    pub valid: usize,
    /// Pixels valid in the original and not in the rebuilt frame.
    pub lost: usize,
    /// Pixels valid in the rebuilt frame and not in the original.
    pub invented: usize,
    /// Mean error.
    pub mean_m: f64,
    /// 99th percentile.
    pub p99_m: f64,
    /// Largest error.
    pub max_m: f64,
}

/// Frames that cannot be compared.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "the original has {original} pixels, the rebuilt frame {rebuilt} and the camera {camera}; they must be the same"
)]
pub struct SizeMismatch {
    /// Pixels of the original.
    pub original: usize,
    /// Pixels of the rebuilt frame.
    pub rebuilt: usize,
    /// Pixels of the camera.
    pub camera: usize,
}

/// Compares two clouds (metres, same frame). Non-finite positions are left out. O(n log n).
#[must_use]
pub fn cloud_error(original: &[DVec3], rebuilt: &[DVec3]) -> CloudError {
    let (forth, back) = (tree(original), tree(rebuilt));
    match (forth.size(), back.size()) {
        (0, 0) => return CloudError::default(),
        (0, _) | (_, 0) => {
            let never = f64::INFINITY;
            return CloudError {
                chamfer_m: never,
                d1_m: never,
                p99_m: never,
                max_m: never,
                original_to_rebuilt_m: never,
                rebuilt_to_original_m: never,
            };
        }
        _ => {}
    }
    let (missing, invented) = (
        Distances::new(nearest(original, &back)),
        Distances::new(nearest(rebuilt, &forth)),
    );
    CloudError {
        chamfer_m: 0.5 * (missing.mean + invented.mean),
        d1_m: missing.rms.max(invented.rms),
        p99_m: missing.p99.max(invented.p99),
        max_m: missing.max.max(invented.max),
        original_to_rebuilt_m: missing.mean,
        rebuilt_to_original_m: invented.mean,
    }
}

/// Compares two depth images of `camera`: row-major planar depth in metres, invalid where not
/// finite or not above 0. The error of a pixel is its depth error times the length of its ray.
///
/// # Errors
/// Images of another size than the camera's.
pub fn depth_error(
    camera: &Camera,
    original_m: &[f32],
    rebuilt_m: &[f32],
) -> Result<DepthError, SizeMismatch> {
    let pixels = camera.pixels();
    if original_m.len() != pixels || rebuilt_m.len() != pixels {
        return Err(SizeMismatch {
            original: original_m.len(),
            rebuilt: rebuilt_m.len(),
            camera: pixels,
        });
    }
    let lens = &camera.intrinsics;
    let width = camera.width as usize;
    let mut error = DepthError::default();
    let mut off = Vec::new();
    for (i, (&z, &w)) in original_m.iter().zip(rebuilt_m).enumerate() {
        let valid = |depth: f32| depth.is_finite() && depth > 0.0;
        error.valid += usize::from(valid(z));
        match (valid(z), valid(w)) {
            (true, true) => {
                let u = ((i % width) as f64 - lens.cx) / lens.fx;
                let v = ((i / width) as f64 - lens.cy) / lens.fy;
                let ray = (u * u + v * v + 1.0).sqrt();
                off.push((f64::from(w) - f64::from(z)).abs() * ray);
            }
            (true, false) => error.lost += 1,
            (false, true) => error.invented += 1,
            (false, false) => {}
        }
    }
    if !off.is_empty() {
        let distances = Distances::new(off);
        error.mean_m = distances.mean;
        error.p99_m = distances.p99;
        error.max_m = distances.max;
    }
    Ok(error)
}

fn tree(points: &[DVec3]) -> RTree<[f64; 3]> {
    let finite = points.iter().filter(|p| p.is_finite());
    RTree::bulk_load(finite.map(DVec3::to_array).collect())
}

/// Distance of every finite point to its nearest neighbour in the tree.
fn nearest(points: &[DVec3], tree: &RTree<[f64; 3]>) -> Vec<f64> {
    let finite = points.par_iter().filter(|p| p.is_finite());
    let distance = |p: &DVec3| {
        let found = tree.nearest_neighbor(p.to_array());
        found.map_or(f64::INFINITY, |&q| p.distance(DVec3::from_array(q)))
    };
    finite.map(distance).collect()
}

/// Summary of at least one distance.
struct Distances {
    mean: f64,
    rms: f64,
    p99: f64,
    max: f64,
}

impl Distances {
    fn new(mut values: Vec<f64>) -> Self {
        // sorted first: the sums do not depend on the order the threads finished in
        values.par_sort_unstable_by(f64::total_cmp);
        let n = values.len().max(1) as f64;
        Self {
            mean: values.iter().sum::<f64>() / n,
            rms: (values.iter().map(|v| v * v).sum::<f64>() / n).sqrt(),
            p99: percentile(&values, 0.99),
            max: values.last().copied().unwrap_or(0.0),
        }
    }
}

/// The value below which `share` (0 to 1) of the ascending values lie, linear between ranks; 0
/// for no values.
#[must_use]
pub fn percentile(ascending: &[f64], share: f64) -> f64 {
    let Some(last) = ascending.len().checked_sub(1) else {
        return 0.0;
    };
    let rank = share.clamp(0.0, 1.0) * last as f64;
    let below = (rank as usize).min(last);
    let above = (below + 1).min(last);
    let part = rank - below as f64;
    ascending[below] + (ascending[above] - ascending[below]) * part
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::Intrinsics;
    use proptest::prelude::*;

    fn brute(a: &[DVec3], b: &[DVec3]) -> (f64, f64, f64, f64) {
        let one_way = |a: &[DVec3], b: &[DVec3]| {
            let mut d: Vec<f64> = a
                .iter()
                .map(|p| b.iter().map(|q| p.distance(*q)).fold(f64::MAX, f64::min))
                .collect();
            d.sort_by(f64::total_cmp);
            let n = d.len() as f64;
            let mean = d.iter().sum::<f64>() / n;
            let rms = (d.iter().map(|v| v * v).sum::<f64>() / n).sqrt();
            (mean, rms, percentile(&d, 0.99), d[d.len() - 1])
        };
        let (x, y) = (one_way(a, b), one_way(b, a));
        (0.5 * (x.0 + y.0), x.1.max(y.1), x.2.max(y.2), x.3.max(y.3))
    }

    fn cloud(size: std::ops::Range<usize>) -> impl Strategy<Value = Vec<DVec3>> {
        // a coarse grid, so that equal points and equal coordinates are common, as in depth data
        let axis = || (-8i32..8).prop_map(|v| f64::from(v) * 0.125);
        let point = (axis(), axis(), axis()).prop_map(|(x, y, z)| DVec3::new(x, y, z));
        proptest::collection::vec(point, size)
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]
        #[test]
        fn agrees_with_brute_force(a in cloud(1..120), b in cloud(1..120)) {
            let e = cloud_error(&a, &b);
            let (chamfer, d1, p99, max) = brute(&a, &b);
            for (found, truth) in [(e.chamfer_m, chamfer), (e.d1_m, d1), (e.p99_m, p99), (e.max_m, max)] {
                prop_assert!((found - truth).abs() < 1e-12, "{found} {truth}");
            }
        }
    }

    #[test]
    fn a_grid_moved_by_a_millimetre_is_a_millimetre_off() {
        let grid: Vec<DVec3> = (0..1000)
            .map(|i| {
                DVec3::new(
                    f64::from(i % 10),
                    f64::from(i / 10 % 10),
                    f64::from(i / 100),
                ) * 0.05
            })
            .collect();
        let moved: Vec<DVec3> = grid.iter().map(|p| *p + DVec3::X * 0.001).collect();
        let e = cloud_error(&grid, &moved);
        for v in [e.chamfer_m, e.d1_m, e.p99_m, e.max_m] {
            assert!((v - 0.001).abs() < 1e-12, "{e:?}");
        }
    }

    #[test]
    fn the_two_directions_tell_missing_from_invented() {
        let line: Vec<DVec3> = (0..100).map(|i| DVec3::X * f64::from(i)).collect();
        let e = cloud_error(&line, &line[..50]);
        assert_eq!(e.rebuilt_to_original_m, 0.0);
        assert!(e.original_to_rebuilt_m > 10.0);
    }

    #[test]
    fn empty_clouds() {
        let one = [DVec3::ONE];
        assert_eq!(cloud_error(&[], &[]), CloudError::default());
        assert_eq!(cloud_error(&one, &[DVec3::NAN]).chamfer_m, f64::INFINITY);
        assert_eq!(cloud_error(&[], &one).max_m, f64::INFINITY);
    }

    #[test]
    fn percentiles_interpolate() {
        // numpy.percentile([1, 2, 3, 4], 99) = 3.97
        assert!((percentile(&[1.0, 2.0, 3.0, 4.0], 0.99) - 3.97).abs() < 1e-12);
        assert_eq!(percentile(&[5.0], 0.99), 5.0);
        assert_eq!(percentile(&[], 0.99), 0.0);
    }

    #[test]
    fn depth_errors_are_along_the_ray_and_pixels_are_counted() {
        let camera = Camera {
            width: 3,
            height: 2,
            intrinsics: Intrinsics {
                fx: 1.0,
                fy: 1.0,
                cx: 0.0,
                cy: 0.0,
            },
            depth_unit_m: 0.001,
            invalid: vec![0],
            depth_min_m: 0.0,
            depth_max_m: 65.0,
            fps: None,
            name: String::new(),
        };
        let original = [1.0, 2.0, 0.0, f32::NAN, 4.0, 5.0];
        let rebuilt = [1.0, 2.5, 0.0, 3.0, 3.5, 0.0];
        let e = depth_error(&camera, &original, &rebuilt).unwrap();
        assert_eq!((e.valid, e.lost, e.invented), (4, 1, 1));
        // rays (1,0,1) and (1,1,1), each half a metre of depth off
        let off = [0.0, 0.5 * 2f64.sqrt(), 0.5 * 3f64.sqrt()];
        assert!((e.mean_m - off.iter().sum::<f64>() / 3.0).abs() < 1e-12);
        assert!((e.max_m - off[2]).abs() < 1e-12);
        assert!((e.p99_m - (off[1] + (off[2] - off[1]) * 0.98)).abs() < 1e-12);
        assert!(depth_error(&camera, &original[..5], &rebuilt).is_err());
        assert_eq!(
            depth_error(&camera, &[0.0; 6], &[0.0; 6]).unwrap(),
            DepthError::default()
        );
    }
}
