use super::*;
use glam::DQuat;
use proptest::prelude::*;

fn vector(limit: f64) -> impl Strategy<Value = DVec3> {
    (-limit..limit, -limit..limit, -limit..limit).prop_map(|(x, y, z)| DVec3::new(x, y, z))
}

fn rotation() -> impl Strategy<Value = DQuat> {
    (vector(1.0), 0.0f64..6.0).prop_map(|(axis, angle)| {
        DQuat::from_axis_angle(axis.try_normalize().unwrap_or(DVec3::X), angle)
    })
}

fn place(name: &str) -> usize {
    COLUMNS.iter().position(|c| c.name == name).unwrap()
}

/// Points of a bumpy surface about (0, 0, 2), well apart from each other.
fn bumpy(side: usize) -> Vec<DVec3> {
    let mut state = 1u64;
    let mut noise = move || {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1);
        (state >> 40) as f64 / 2f64.powi(24) - 0.5
    };
    (0..side * side)
        .map(|i| {
            let x = (i % side) as f64 * 0.01 + 0.004 * noise();
            let y = (i / side) as f64 * 0.01 + 0.004 * noise();
            DVec3::new(x, y, 2.0 + 0.03 * (9.0 * x).sin() + 0.02 * (7.0 * y).cos())
        })
        .collect()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(16))]
    #[test]
    fn columns_behind_the_papers_do_not_turn(turn in rotation(), shift in vector(2.0), seen in any::<bool>()) {
        let points = bumpy(14);
        let moved: Vec<DVec3> = points.iter().map(|p| turn * *p + shift).collect();
        let ball = Ball { center: DVec3::new(0.1, 0.0, 1.0), radius: 1.0 };
        let moved_ball = Ball { center: turn * ball.center + shift, ..ball };
        let owners = vec![0; points.len()];
        let options = FeatureOptions { view: seen.then_some(DVec3::ZERO), ..FeatureOptions::default() };
        let moved_options = FeatureOptions { view: seen.then_some(shift), ..options };
        let a = Features::new(&points, &[ball], &owners, &options);
        let b = Features::new(&moved, &[moved_ball], &owners, &moved_options);
        for i in 0..points.len() {
            // without a camera a normal square to the way to the centroid has no side
            let edge = !seen && a.row(i)[place("centroid_cosine")].abs() < 1e-6;
            for (c, column) in COLUMNS.iter().enumerate().skip(PAPER_COLUMNS) {
                let (x, y) = (a.row(i)[c], b.row(i)[c]);
                prop_assert!(edge || (x - y).abs() <= 2e-5 * (1.0 + x.abs()), "{}: {x} {y}", column.name);
            }
        }
    }
}

#[test]
fn the_papers_columns_are_the_papers() {
    let ball = Ball {
        center: DVec3::new(1.0, 2.0, 3.0),
        radius: 5.0,
    };
    // a point on the sphere at phi = 90 degrees less atan(4/3), theta = 120 degrees
    let theta = 120f64.to_radians();
    let p = ball.center + DVec3::new(3.0 * theta.cos(), 3.0 * theta.sin(), 4.0);
    let options = FeatureOptions {
        origin: DVec3::new(1.0, 1.0, 1.0),
        ..FeatureOptions::default()
    };
    let features = Features::new(&[p], &[ball], &[0], &options);
    let truth = [0.0, 1.0, 2.0, 5.0, 3.0, theta];
    for (found, truth) in features.row(0).iter().zip(truth) {
        assert!((f64::from(*found) - truth).abs() < 1e-6, "{found} {truth}");
    }
    assert_eq!(
        features.row(0)[PAPER_COLUMNS..],
        [0.0; 9],
        "one point has no surface"
    );
    let none = Features::new(&[p], &[ball], &[UNASSIGNED], &options);
    assert_eq!(none.row(0)[..PAPER_COLUMNS], [0.0; 6]);
}

/// Every column written out from its definition, with an exhaustive neighbour search.
#[test]
fn columns_agree_with_their_definition() {
    let points = bumpy(16);
    let view = DVec3::new(0.05, -0.1, 0.3);
    let options = FeatureOptions {
        neighbours: 12,
        view: Some(view),
        ..FeatureOptions::default()
    };
    let features = Features::new(&points, &[], &[], &options);
    let centroid = points.iter().sum::<DVec3>() / points.len() as f64;
    for (i, &p) in points.iter().enumerate() {
        let mut near = points.clone();
        near.sort_by(|a, b| a.distance(p).total_cmp(&b.distance(p)));
        near.truncate(12);
        let mut moments = PointMoments::default();
        near.iter().for_each(|q| moments.add(*q - p));
        let (c, r) = moments.fit().unwrap().sphere.center_radius();
        let center = c + p;
        let rms = |f: &dyn Fn(&DVec3) -> f64| {
            (near.iter().map(|q| f(q).powi(2)).sum::<f64>() / 12.0).sqrt()
        };
        let outward = (p - center).normalize();
        let side = if outward.dot(view - p) < 0.0 {
            -1.0
        } else {
            1.0
        };
        let n = side * outward;
        let k = if r >= 1e4 { 0.0 } else { side / r };
        let s = rms(&|q| q.distance(p));
        let truth = [
            k,
            k * s / (1.0 + k.abs() * s),
            rms(&|q| q.distance(center) - r),
            side * (p.distance(center) - r),
            s,
            n.dot((view - p).normalize()),
            p.distance(centroid),
            n.dot(p - centroid) / p.distance(centroid),
            n.dot(centroid - p),
        ];
        let row = features.row(i);
        for (column, truth) in COLUMNS[PAPER_COLUMNS..].iter().zip(truth) {
            let found = f64::from(row[place(column.name)]);
            let room = 1e-6 * (1.0 + truth.abs());
            assert!(
                (found - truth).abs() < room,
                "{} of {i}: {found} {truth}",
                column.name
            );
        }
        assert!((DVec3::from(features.normals[i].map(f64::from)) - n).length() < 1e-6);
    }
}

use crate::fit::point_moments::PointMoments;

#[test]
fn a_ball_and_a_bowl_have_opposite_curvature() {
    // a cap of radius 0.5 about its pole; seen from outside it bulges, from inside it is hollow
    let cap: Vec<DVec3> = (0..400)
        .map(|i| {
            let (x, y) = (
                f64::from(i % 20) * 0.01 - 0.1,
                f64::from(i / 20) * 0.01 - 0.1,
            );
            DVec3::new(x, y, (0.25 - x * x - y * y).sqrt())
        })
        .collect();
    for (z, sign) in [(2.0, 1.0), (0.0, -1.0)] {
        let options = FeatureOptions {
            view: Some(DVec3::Z * z),
            ..FeatureOptions::default()
        };
        let features = Features::new(&cap, &[], &[], &options);
        for i in 0..cap.len() {
            let row = features.row(i);
            let curvature = f64::from(row[place("curvature")]);
            assert!((curvature - sign * 2.0).abs() < 1e-4, "{curvature}");
            assert!(row[place("residual")] < 1e-6 && row[place("offset")].abs() < 1e-6);
        }
    }
}

#[test]
fn odd_clouds_give_finite_rows() {
    let line: Vec<DVec3> = (0..50).map(|i| DVec3::X * f64::from(i)).collect();
    let mut holes = bumpy(6);
    holes[3] = DVec3::NAN;
    let utm: Vec<DVec3> = bumpy(6)
        .iter()
        .map(|p| *p + DVec3::new(4.5e5, 5.4e6, 100.0))
        .collect();
    for points in [
        vec![],
        vec![DVec3::ONE],
        vec![DVec3::ONE; 300],
        line,
        holes.clone(),
        utm.clone(),
    ] {
        let features = Features::new(&points, &[], &[], &FeatureOptions::default());
        assert_eq!(features.values.len(), points.len() * COLUMNS.len());
        assert_eq!(features.normals.len(), points.len());
        assert!(features.values.iter().all(|v| v.is_finite()));
    }
    let features = Features::new(&holes, &[], &[], &FeatureOptions::default());
    assert_eq!(features.row(3), [0.0; COLUMNS.len()]);
    // a distant zero costs what the input's doubles lose there, no more
    let near = Features::new(&bumpy(6), &[], &[], &FeatureOptions::default());
    let far = Features::new(&utm, &[], &[], &FeatureOptions::default());
    for i in 0..utm.len() {
        let (a, b) = (near.row(i)[place("bend")], far.row(i)[place("bend")]);
        assert!((a - b).abs() < 1e-4, "{a} {b}");
    }
}
