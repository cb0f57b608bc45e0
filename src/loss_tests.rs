use super::*;
use proptest::prelude::*;

fn vector(limit: f64) -> impl Strategy<Value = DVec3> {
    (-limit..limit, -limit..limit, -limit..limit).prop_map(|(x, y, z)| DVec3::new(x, y, z))
}

fn ball() -> impl Strategy<Value = Ball> {
    (vector(1.0), 0.05f64..2.0).prop_map(|(center, radius)| Ball { center, radius })
}

/// A whole problem: points, spheres, owners (one too many: none), weights.
type Problem = (Vec<DVec3>, Vec<Ball>, Vec<u32>, Vec<f64>);

fn problem() -> impl Strategy<Value = Problem> {
    (
        proptest::collection::vec(ball(), 1..5),
        proptest::collection::vec((vector(2.0), 0u32..100, 0f64..3.0), 1..12),
    )
        .prop_map(|(spheres, points)| {
            let owner = |o: u32| match o as usize % (spheres.len() + 1) {
                k if k == spheres.len() => UNASSIGNED,
                k => k as u32,
            };
            (
                points.iter().map(|p| p.0).collect(),
                spheres.clone(),
                points.iter().map(|p| owner(p.1)).collect(),
                points.iter().map(|p| p.2).collect(),
            )
        })
}

/// The definition, written out.
fn slow(loss: &SaintLoss<'_>) -> f64 {
    let (mut cost, mut total) = (0.0, 0.0);
    for (i, p) in loss.points.iter().enumerate() {
        let distance = |b: &Ball| {
            let d = *p - b.center;
            (d.x * d.x + d.y * d.y + d.z * d.z).sqrt() - b.radius
        };
        let s = match loss.owners {
            Owners::Given(owners) if owners[i] == UNASSIGNED => continue,
            Owners::Given(owners) => distance(&loss.spheres[owners[i] as usize]),
            Owners::Nearest => loss
                .spheres
                .iter()
                .map(distance)
                .min_by(|a, b| a.abs().total_cmp(&b.abs()))
                .unwrap(),
        };
        let rho = match loss.penalty {
            Penalty::Absolute => s.abs(),
            Penalty::Squared => s * s,
            Penalty::Huber(d) if s.abs() <= d => s * s / 2.0,
            Penalty::Huber(d) => d * s.abs() - d * d / 2.0,
        };
        let w = loss.weights.map_or(1.0, |w| w[i]);
        cost += w * rho;
        total += w;
    }
    if total > 0.0 { cost / total } else { 0.0 }
}

/// Smallest distance from a place where the loss has no slope: s = 0, a sphere's centre, the
/// border between two owners.
fn smoothness(loss: &SaintLoss<'_>) -> f64 {
    let mut least = f64::MAX;
    for (i, p) in loss.points.iter().enumerate() {
        let mut off: Vec<f64> = Vec::new();
        for (k, b) in loss.spheres.iter().enumerate() {
            let distance = p.distance(b.center);
            match loss.owners {
                Owners::Given(owners) if owners[i] != k as u32 => {}
                _ => {
                    least = least.min(distance).min((distance - b.radius).abs());
                    off.push((distance - b.radius).abs());
                }
            }
        }
        off.sort_by(f64::total_cmp);
        if let [a, b, ..] = off[..] {
            least = least.min(b - a);
        }
    }
    least
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn value_and_slopes_agree_with_the_definition(
        (points, spheres, owners, weights) in problem(),
        given in any::<bool>(), weighted in any::<bool>(), kind in 0usize..3,
    ) {
        let here = SaintLoss {
            points: &points,
            spheres: &spheres,
            owners: if given { Owners::Given(&owners) } else { Owners::Nearest },
            weights: weighted.then_some(&weights[..]),
            penalty: [Penalty::Absolute, Penalty::Squared, Penalty::Huber(0.3)][kind],
        };
        let mut gradient = LossGradient::default();
        let value = here.gradient(&mut gradient).unwrap();
        prop_assert!((value - slow(&here)).abs() < 1e-12);
        prop_assert_eq!(value, here.value().unwrap());

        // moving or turning all of it together changes nothing
        let push = gradient.points.iter().sum::<DVec3>() + gradient.centers.iter().sum::<DVec3>();
        prop_assert!(push.length() < 1e-12, "{push}");
        let turn = points.iter().zip(&gradient.points).map(|(p, g)| p.cross(*g)).sum::<DVec3>()
            + spheres.iter().zip(&gradient.centers).map(|(b, g)| b.center.cross(*g)).sum::<DVec3>();
        prop_assert!(turn.length() < 1e-11, "{turn}");

        // central differences of the definition, where it has a slope
        let h = 1e-6;
        prop_assume!(smoothness(&here) > 10.0 * h);
        let slope = |plus: f64, minus: f64| (plus - minus) / (2.0 * h);
        let close = |found: f64, truth: f64| (found - truth).abs() < 1e-7;
        for axis in 0..3 {
            for i in 0..points.len() {
                let at = |step: f64| {
                    let mut moved = points.clone();
                    moved[i][axis] += step;
                    slow(&SaintLoss { points: &moved, ..here })
                };
                prop_assert!(close(gradient.points[i][axis], slope(at(h), at(-h))));
            }
            for k in 0..spheres.len() {
                let at = |step: f64| {
                    let mut moved = spheres.clone();
                    moved[k].center[axis] += step;
                    slow(&SaintLoss { spheres: &moved, ..here })
                };
                prop_assert!(close(gradient.centers[k][axis], slope(at(h), at(-h))));
            }
        }
        for k in 0..spheres.len() {
            let at = |step: f64| {
                let mut moved = spheres.clone();
                moved[k].radius += step;
                slow(&SaintLoss { spheres: &moved, ..here })
            };
            prop_assert!(close(gradient.radii[k], slope(at(h), at(-h))));
        }
    }
}

const UNIT: Ball = Ball {
    center: DVec3::ZERO,
    radius: 1.0,
};

#[test]
fn points_on_their_spheres_cost_nothing() {
    let points = [DVec3::X, -DVec3::Y, DVec3::ONE.normalize()];
    for penalty in [Penalty::Absolute, Penalty::Squared, Penalty::Huber(0.1)] {
        let loss = SaintLoss {
            points: &points,
            spheres: &[UNIT],
            penalty,
            ..SaintLoss::default()
        };
        let mut gradient = LossGradient::default();
        assert!(loss.gradient(&mut gradient).unwrap() < 1e-15);
        let slope = gradient.points[0].length();
        assert_eq!(slope, 0.0, "{penalty:?}");
    }
}

#[test]
fn a_plane_of_huge_radius_keeps_its_digits() {
    let radius = 1e4;
    let spheres = [Ball {
        center: DVec3::Z * (radius + 2.0),
        radius,
    }];
    let points = [DVec3::Z * 1.999];
    let loss = SaintLoss {
        points: &points,
        spheres: &spheres,
        ..SaintLoss::default()
    };
    assert!((loss.value().unwrap() - 0.001).abs() < 1e-11);
}

#[test]
fn the_centre_of_a_sphere_pulls_nowhere() {
    let loss = SaintLoss {
        points: &[DVec3::ZERO],
        spheres: &[UNIT],
        ..SaintLoss::default()
    };
    let mut gradient = LossGradient::default();
    assert_eq!(loss.gradient(&mut gradient), Ok(1.0));
    assert_eq!(gradient.points, [DVec3::ZERO]);
    assert_eq!(gradient.radii, [1.0]);
}

#[test]
fn nothing_costs_nothing() {
    let mut gradient = LossGradient {
        points: vec![DVec3::ONE; 7],
        ..LossGradient::default()
    };
    let none = SaintLoss::default();
    assert_eq!(none.gradient(&mut gradient), Ok(0.0));
    assert_eq!(gradient, LossGradient::default());
    let without_spheres = SaintLoss {
        points: &[DVec3::ONE],
        ..SaintLoss::default()
    };
    assert_eq!(without_spheres.gradient(&mut gradient), Ok(0.0));
    let weightless = SaintLoss {
        spheres: &[UNIT],
        weights: Some(&[0.0]),
        ..without_spheres
    };
    assert_eq!(weightless.gradient(&mut gradient), Ok(0.0));
    assert_eq!(gradient.points, [DVec3::ZERO]);
}

#[test]
fn bad_input_is_refused() {
    let points = [DVec3::ONE, DVec3::X];
    let good = SaintLoss {
        points: &points,
        spheres: &[UNIT],
        ..SaintLoss::default()
    };
    let nan = [DVec3::ONE, DVec3::NAN];
    let negative = [Ball {
        radius: -1.0,
        ..UNIT
    }];
    for (loss, word) in [
        (
            SaintLoss {
                points: &nan,
                ..good
            },
            "point 1",
        ),
        (
            SaintLoss {
                spheres: &negative,
                ..good
            },
            "sphere 0",
        ),
        (
            SaintLoss {
                weights: Some(&[1.0]),
                ..good
            },
            "1 weights",
        ),
        (
            SaintLoss {
                weights: Some(&[1.0, -1.0]),
                ..good
            },
            "weight 1",
        ),
        (
            SaintLoss {
                owners: Owners::Given(&[0]),
                ..good
            },
            "1 owners",
        ),
        (
            SaintLoss {
                owners: Owners::Given(&[0, 1]),
                ..good
            },
            "names sphere 1",
        ),
        (
            SaintLoss {
                penalty: Penalty::Huber(0.0),
                ..good
            },
            "Huber",
        ),
    ] {
        let text = loss.value().unwrap_err().to_string();
        assert!(text.contains(word), "{text}");
    }
}
