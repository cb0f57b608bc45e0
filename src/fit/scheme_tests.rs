use super::*;
use crate::fit::cloud::UNASSIGNED;
use crate::fit::contact_distance::ContactDistance;
use glam::DVec3;

/// A ball of 0.3 m on a floor before a wall, with a few millimetres of even noise.
fn room(n: usize) -> Vec<DVec3> {
    let mut state = 5u64;
    let mut unit = move || {
        state = state
            .wrapping_mul(6364136223846793005)
            .wrapping_add(1442695040888963407);
        (state >> 11) as f64 / (1u64 << 53) as f64
    };
    (0..n)
        .map(|i| {
            let (s, t, noise) = (
                2.0 * unit() - 1.0,
                2.0 * unit() - 1.0,
                0.004 * unit() - 0.002,
            );
            match i % 3 {
                0 => DVec3::new(s, 0.5 + noise, 2.0 + t),
                1 => DVec3::new(s, 0.5 * t, 3.0 + noise),
                _ => {
                    let (sin, cos) = (std::f64::consts::PI * s).sin_cos();
                    let ring = (1.0 - t * t).sqrt();
                    DVec3::new(0.0, 0.2, 2.0)
                        + (0.3 + noise) * DVec3::new(ring * cos, t, ring * sin)
                }
            }
        })
        .collect()
}

fn parameters(scheme: Scheme) -> FitParameters {
    FitParameters {
        scheme,
        contact_distance: ContactDistance::constant(0.005),
        ..FitParameters::default()
    }
}

fn fit(positions: &[DVec3], parameters: &FitParameters) -> (LocalPoints, CloudModel) {
    let points = LocalPoints::new(positions).unwrap();
    let model = CloudFit::default().fit(&points, parameters).unwrap();
    (points, model)
}

/// 99.9 % explained by few spheres.
fn assert_explained(model: &CloudModel, most: usize, what: &str) {
    let (explained, spheres) = (model.explained, model.spheres.len());
    assert!(explained >= 0.999, "{what}: {explained} explained");
    assert!(spheres <= most, "{what}: {spheres} spheres, not {most}");
}

const BOTH: [Scheme; 2] = [Scheme::Progressive, Scheme::Random];

#[test]
fn three_surfaces_are_explained_by_few_spheres_within_contact_distance() {
    for (scheme, most) in [(Scheme::Progressive, 12), (Scheme::Random, 6)] {
        let parameters = parameters(scheme);
        let (points, model) = fit(&room(12_000), &parameters);
        assert_explained(&model, most, &scheme.to_string());
        for (i, &s) in model
            .assignment
            .iter()
            .enumerate()
            .filter(|a| *a.1 != UNASSIGNED)
        {
            let off = model.spheres[s as usize].distance(points.at(i).as_dvec3());
            assert!(
                off <= 0.005 + 1e-6,
                "{scheme}: point {i} is {off} m off its sphere"
            );
        }
        let ball = DVec3::new(0.0, 0.2, 2.0) - points.origin;
        let found = model.spheres.iter().any(|s| {
            let (center, radius) = s.center_radius();
            center.distance(ball) < 0.003 && (radius - 0.3).abs() < 0.003
        });
        assert!(found, "{scheme}: the ball is not among the spheres");
    }
}

#[test]
fn one_thread_and_many_give_the_same_model() {
    let positions = room(9000);
    for scheme in BOTH {
        let parameters = parameters(scheme);
        let run = |threads| {
            let pool = rayon::ThreadPoolBuilder::new()
                .num_threads(threads)
                .build()
                .unwrap();
            pool.install(|| fit(&positions, &parameters).1)
        };
        assert_eq!(run(1), run(4), "{scheme}");
    }
}

#[test]
fn reused_buffers_change_nothing() {
    let (small, large) = (room(500), room(6000));
    for scheme in BOTH {
        let parameters = parameters(scheme);
        let mut reused = CloudFit::default();
        for positions in [&large, &small, &large] {
            let points = LocalPoints::new(positions).unwrap();
            let model = reused.fit(&points, &parameters).unwrap();
            assert_eq!(model, fit(positions, &parameters).1, "{scheme}");
        }
    }
}

#[test]
fn a_distant_zero_changes_the_model_by_rounding_only() {
    let utm = DVec3::new(448_262.0, 5_411_932.0, 113.0);
    let positions = room(6000);
    let moved: Vec<DVec3> = positions.iter().map(|p| *p + utm).collect();
    for scheme in BOTH {
        let (_, near) = fit(&positions, &parameters(scheme));
        let (_, far) = fit(&moved, &parameters(scheme));
        assert!(far.explained >= 0.999, "{scheme}: {}", far.explained);
        let difference = near.spheres.len().abs_diff(far.spheres.len());
        assert!(
            difference <= 3,
            "{scheme}: {} and {}",
            near.spheres.len(),
            far.spheres.len()
        );
    }
}

#[test]
fn odd_clouds_give_defined_models() {
    let line: Vec<DVec3> = (0..100).map(|i| DVec3::X * f64::from(i) * 0.01).collect();
    let plane: Vec<DVec3> = (0..400)
        .map(|i| DVec3::new(f64::from(i % 20) * 0.05, f64::from(i / 20) * 0.05, 1.0))
        .collect();
    for scheme in BOTH {
        let parameters = parameters(scheme);
        let (_, nothing) = fit(&[], &parameters);
        assert_eq!((nothing.spheres.len(), nothing.explained), (0, 1.0));
        for odd in [&line[..1], &line[..4], &vec![DVec3::ONE; 300], &line] {
            let (points, model) = fit(odd, &parameters);
            assert_eq!(model.assignment.len(), points.len());
            for (i, &s) in model
                .assignment
                .iter()
                .enumerate()
                .filter(|a| *a.1 != UNASSIGNED)
            {
                let off = model.spheres[s as usize].distance(points.at(i).as_dvec3());
                assert!(off <= 0.005 + 1e-6, "{scheme}: {off}");
            }
        }
        let (_, flat) = fit(&plane, &parameters);
        assert_eq!((flat.spheres.len(), flat.explained), (1, 1.0), "{scheme}");
        assert!(flat.spheres[0].center_radius().1 > 50.0, "{scheme}");
    }
}

#[test]
fn max_spheres_is_kept_and_more_spheres_explain_more() {
    let positions = room(6000);
    for scheme in BOTH {
        let explained = [1, 2, 40].map(|max_spheres| {
            let (_, model) = fit(
                &positions,
                &FitParameters {
                    max_spheres,
                    ..parameters(scheme)
                },
            );
            assert!(model.spheres.len() <= max_spheres);
            model.explained
        });
        assert!(
            explained[0] < explained[1] && explained[1] < explained[2],
            "{scheme}: {explained:?}"
        );
    }
}

#[test]
fn contact_distance_follows_depth() {
    // the same noise of 8 mm at 1 m and at 4 m: only the far plane is one surface
    let at = |z: f64| {
        (0..900).map(move |i| {
            let noise = 0.016 * f64::from(i * 7919 % 97) / 96.0 - 0.008;
            DVec3::new(
                f64::from(i % 30) * 0.03,
                f64::from(i / 30) * 0.03,
                z + noise,
            )
        })
    };
    let contact_distance: ContactDistance = "2mm+1e-3z2".parse().unwrap();
    for scheme in BOTH {
        let parameters = FitParameters {
            contact_distance,
            max_spheres: 1,
            ..parameters(scheme)
        };
        let near: Vec<DVec3> = at(1.0).collect();
        let far: Vec<DVec3> = at(4.0).collect();
        let (near, far) = (fit(&near, &parameters).1, fit(&far, &parameters).1);
        assert!(far.explained > 0.99, "{scheme}: {}", far.explained);
        assert!(near.explained < 0.6, "{scheme}: {}", near.explained);
    }
}

#[test]
fn parameters_out_of_range_are_refused() {
    let good = parameters(Scheme::Random);
    for bad in [
        FitParameters {
            cube_size_m: 0.0,
            ..good
        },
        FitParameters {
            cube_size_m: f64::NAN,
            ..good
        },
        FitParameters {
            max_spheres: 0,
            ..good
        },
        FitParameters {
            spheres_per_cube: 0,
            ..good
        },
        FitParameters {
            contact_distance: ContactDistance::constant(f64::NAN),
            ..good
        },
    ] {
        assert!(
            CloudFit::default()
                .fit(&LocalPoints::default(), &bad)
                .is_err(),
            "{bad:?}"
        );
    }
}

/// A shared cloud as metres; `None`, said aloud, where the shared data is not there.
#[allow(clippy::print_stderr, reason = "a test that skips says so")]
fn shared_cloud(name: &str, unit_m: f64) -> Option<LocalPoints> {
    let root = std::env::var("SAINT_SHARED")
        .unwrap_or_else(|_| concat!(env!("CARGO_MANIFEST_DIR"), "/../shared").to_owned());
    let path = std::path::Path::new(&root).join("data/clouds").join(name);
    let Ok(bytes) = std::fs::read(&path) else {
        eprintln!("skipped: {} is not there", path.display());
        return None;
    };
    let end = b"end_header\n";
    let start = bytes.windows(end.len()).position(|w| w == end).unwrap() + end.len();
    let number = |b: &[u8]| f64::from(f32::from_le_bytes(b.try_into().unwrap())) * unit_m;
    let positions: Vec<DVec3> = bytes[start..]
        .chunks_exact(12)
        .map(|p| DVec3::new(number(&p[..4]), number(&p[4..8]), number(&p[8..])))
        .collect();
    Some(LocalPoints::new(&positions).unwrap())
}

#[test]
fn scanned_objects_need_few_spheres_at_one_millimetre() {
    for (name, unit_m, most) in [
        ("kits_case00000.ply", 0.001, 32),
        ("stanford_bunny.ply", 1.0, 60),
        ("libigl_face.ply", 0.01, 73),
    ] {
        let Some(points) = shared_cloud(name, unit_m) else {
            return;
        };
        let parameters = FitParameters {
            contact_distance: 0.001.into(),
            ..parameters(Scheme::Random)
        };
        let model = CloudFit::default().fit(&points, &parameters).unwrap();
        assert_explained(&model, most, name);
    }
}
