use super::*;
use crate::fit::cloud::{CloudSphere, FitParameters, Scheme};
use crate::fit::scheme::CloudFit;
use std::collections::BTreeMap;
use std::collections::BTreeSet;

/// Three overlapping balls and a plane, fitted.
fn fitted() -> (LocalPoints, CloudModel) {
    let golden = 2.399_963_229_728_653;
    let mut positions = Vec::new();
    for (center, radius) in [
        (DVec3::new(0.0, 0.0, 1.0), 0.2),
        (DVec3::new(0.25, 0.1, 1.1), 0.15),
        (DVec3::new(-0.4, 0.2, 1.5), 0.3),
    ] {
        positions.extend((0..1500).map(|i| {
            let z = 1.0 - 2.0 * (f64::from(i) + 0.5) / 1500.0;
            let (sin, cos) = (golden * f64::from(i)).sin_cos();
            let ring = (1.0 - z * z).sqrt();
            center + (radius + 0.001 * sin * cos) * DVec3::new(ring * cos, ring * sin, z)
        }));
    }
    positions.extend(
        (0..1600).map(|i| DVec3::new(f64::from(i % 40) * 0.03, f64::from(i / 40) * 0.03, 2.0)),
    );
    let points = LocalPoints::new(&positions).unwrap();
    let parameters = FitParameters {
        scheme: Scheme::Random,
        contact_distance: 0.003.into(),
        ..FitParameters::default()
    };
    let model = CloudFit::default().fit(&points, &parameters).unwrap();
    (points, model)
}

#[test]
fn every_point_is_rebuilt_within_half_a_cell_and_its_residual() {
    let (points, model) = fitted();
    for step_m in [0.002f32, 0.01, 0.05] {
        let (map, outside) = ClaimMap::new(&points, &model, step_m);
        assert_eq!(outside, 0);
        let rebuilt = map.rebuild();
        assert_eq!(rebuilt.len(), map.cells.len());
        let by_sphere: Vec<&[DVec3]> = (0..map.patches.len())
            .map(|s| &rebuilt[map.starts[s] as usize..map.starts[s + 1] as usize])
            .collect();
        for (i, s) in assigned(&points, &model) {
            let p = points.at(i).as_dvec3();
            let error = by_sphere[s as usize]
                .iter()
                .map(|q| q.distance(p))
                .fold(f64::MAX, f64::min);
            let residual = model.spheres[s as usize].distance(p);
            let bound = 0.5f64.sqrt() * f64::from(step_m) + residual + 1e-6;
            assert!(
                error <= bound,
                "step {step_m}: point {i} is {error} m off, at most {bound}"
            );
        }
    }
}

#[test]
fn no_claim_is_lost() {
    let (points, model) = fitted();
    let step_m = 0.01f32;
    let (map, _) = ClaimMap::new(&points, &model, step_m);
    let mut truth: BTreeMap<PatchCell, BTreeSet<u32>> = BTreeMap::new();
    for (i, s) in assigned(&points, &model) {
        let grid = map.patches[s as usize].grid(f64::from(step_m));
        truth
            .entry(grid.cell(points.at(i).as_dvec3()).unwrap())
            .or_default()
            .insert(s);
    }
    let flat: Vec<(PatchCell, u32)> = truth
        .iter()
        .flat_map(|(&c, set)| set.iter().map(move |&s| (c, s)))
        .collect();
    assert_eq!(map.merged(), flat);
    assert!(
        truth.values().any(|set| set.len() > 1),
        "no cell with two claims: nothing was tested"
    );
}

#[test]
fn literal_collisions_are_counted_as_a_brute_force_counts_them() {
    let (points, model) = fitted();
    for mr in [4, 45, 500] {
        let grid = PolarGrid::new(mr);
        let map = LiteralMap::new(&points, &model, grid);
        let mut holders: BTreeMap<u32, BTreeMap<u32, usize>> = BTreeMap::new();
        for (i, s) in assigned(&points, &model) {
            let center = model.spheres[s as usize].center_radius().0;
            let cell = grid.cell(Angles::of(points.at(i).as_dvec3() - center));
            *holders.entry(cell).or_default().entry(s).or_default() += 1;
        }
        let kept: Vec<(u32, u32)> = holders
            .iter()
            .map(|(&c, h)| (c, *h.keys().next().unwrap()))
            .collect();
        let lost_points: usize = holders.values().flat_map(|h| h.values().skip(1)).sum();
        let lost_contacts: usize = holders.values().map(|h| h.len() - 1).sum();
        assert_eq!(map.cells, kept, "mr {mr}");
        assert_eq!(
            (map.lost_points, map.lost_contacts),
            (lost_points, lost_contacts),
            "mr {mr}"
        );
        assert_eq!(map.rebuild(&model).len(), kept.len());
    }
    let coarse = LiteralMap::new(&points, &model, PolarGrid::new(4));
    assert!(
        coarse.lost_points > 0,
        "no collision at 4 rows: nothing was tested"
    );
}

#[test]
fn literal_points_lie_within_half_a_cell() {
    let sphere = CloudSphere::from_center_radius(DVec3::new(0.1, 0.0, 1.0), 0.5).unwrap();
    let positions: Vec<DVec3> = (0..200)
        .map(f64::from)
        .map(|t| {
            DVec3::new(0.1, 0.0, 1.0)
                + 0.5 * DVec3::new(t.sin(), t.cos(), (0.3 * t).sin()).normalize()
        })
        .collect();
    let points = LocalPoints::new(&positions).unwrap();
    let model = CloudModel {
        origin: points.origin,
        spheres: vec![sphere.translated(-points.origin)],
        assignment: vec![0; points.len()],
        explained: 1.0,
    };
    let map = LiteralMap::new(&points, &model, PolarGrid::new(180));
    assert_eq!((map.lost_points, map.points), (0, 200));
    let rebuilt = map.rebuild(&model);
    let bound = 0.5 * 0.5f64.sqrt() * std::f64::consts::PI / 180.0;
    for i in 0..points.len() {
        let error = rebuilt
            .iter()
            .map(|q| q.distance(points.at(i).as_dvec3()))
            .fold(f64::MAX, f64::min);
        assert!(error <= bound + 1e-6, "{error} m off, at most {bound}");
    }
}

#[test]
fn empty_models_give_empty_maps() {
    let points = LocalPoints::new(&[DVec3::ONE]).unwrap();
    let model = CloudModel {
        assignment: vec![UNASSIGNED],
        ..CloudModel::default()
    };
    let (map, outside) = ClaimMap::new(&points, &model, 0.01);
    assert_eq!(
        (map.cells.len(), map.starts.as_slice(), outside),
        (0, &[0u32][..], 0)
    );
    assert!(map.rebuild().is_empty() && map.merged().is_empty());
    assert!(
        LiteralMap::new(&points, &model, PolarGrid::new(90))
            .cells
            .is_empty()
    );
}
