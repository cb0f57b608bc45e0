use super::file::ModelFile;
use super::*;
use crate::fit::cloud::{FitParameters, Scheme};
use crate::fit::contact_distance::ContactDistance;
use crate::fit::scheme::CloudFit;
use crate::partition::points::LocalPoints;
use crate::quality::cloud_error;
use build::{MapChoice, Unfit};
use std::path::Path;

const UTM: DVec3 = DVec3::new(448_262.25, 5_411_932.5, 113.75);

/// Points of a sphere of 0.2 m about `center`, evenly spread.
fn ball(center: DVec3, n: usize) -> Vec<DVec3> {
    (0..n)
        .map(|i| {
            let z = 1.0 - (2.0 * i as f64 + 1.0) / n as f64;
            let (sin, cos) = (2.399_963 * i as f64).sin_cos();
            let ring = (1.0 - z * z).sqrt();
            center + 0.2 * DVec3::new(ring * cos, ring * sin, z)
        })
        .collect()
}

/// Three balls in a row.
fn balls(center: DVec3) -> Vec<DVec3> {
    (0..3)
        .flat_map(|i| ball(center + DVec3::X * f64::from(i), 1500))
        .collect()
}

fn parameters() -> FitParameters {
    FitParameters {
        scheme: Scheme::Random,
        contact_distance: ContactDistance::constant(0.002),
        ..FitParameters::default()
    }
}

fn part_of(positions: &[DVec3], choice: MapChoice) -> Part {
    let points = LocalPoints::new(positions).unwrap();
    let model = CloudFit::default().fit(&points, &parameters()).unwrap();
    build::part(&points, &model, &parameters(), choice).unwrap()
}

/// A scene of two objects at two scales.
fn scene() -> (Scene, Vec<Part>) {
    let mut scene = Scene {
        generator: "test".to_owned(),
        scales: vec![3, 9],
        ..Scene::default()
    };
    let mut parts = Vec::new();
    for (name, center) in [("near", DVec3::ZERO), ("far", UTM)] {
        let points = LocalPoints::new(&balls(center)).unwrap();
        scene.objects.push(ObjectInfo {
            name: name.to_owned(),
            ..build::describe(&points)
        });
        for scale in 0..2 {
            let model = CloudFit::default().fit(&points, &parameters()).unwrap();
            let mut part =
                build::part(&points, &model, &parameters(), MapChoice::Claims(None)).unwrap();
            part.info.object = scene.objects.len() as u32 - 1;
            part.info.scale = scale;
            parts.push(part);
        }
    }
    parts.sort_by_key(|p| (p.info.scale, p.info.object));
    scene.parts = parts.iter().map(|p| p.info.clone()).collect();
    (scene, parts)
}

#[test]
fn known_spheres_come_back_wherever_they_lie() {
    for center in [DVec3::ZERO, UTM] {
        let part = part_of(&balls(center), MapChoice::Claims(Some(0.001)));
        assert_eq!((part.info.spheres, part.info.explained), (3, 1.0));
        assert!(part.info.residual.max_m < 1e-5, "{:?}", part.info.residual);
        let geometry = Geometry::decode(&part.payload).unwrap();
        let mut found: Vec<f64> = geometry
            .spheres()
            .iter()
            .map(|&(c, r)| {
                assert!((r - 0.2).abs() < 1e-5, "radius {r}");
                (c + geometry.origin() - center).x
            })
            .collect();
        found.sort_by(f64::total_cmp);
        for (x, wanted) in found.iter().zip(0..) {
            assert!((x - f64::from(wanted)).abs() < 1e-5, "{found:?}");
        }
        // every point comes back within its cell
        let rebuilt: Vec<DVec3> = geometry
            .points()
            .iter()
            .map(|p| p.0 + geometry.origin())
            .collect();
        let error = cloud_error(&balls(center), &rebuilt);
        assert!(error.max_m < 0.00072, "{error:?}");
    }
}

#[test]
fn maps_count_what_they_keep() {
    let claims = part_of(&balls(DVec3::ZERO), MapChoice::Claims(Some(0.02)))
        .info
        .map;
    assert_eq!(
        (claims.points, claims.lost, claims.collisions),
        (4500, 0, 0)
    );
    assert_eq!(claims.cells + claims.shared, 4500);
    // three balls on one grid: at the paper's 64 rows they displace each other
    let part = part_of(&balls(DVec3::ZERO), MapChoice::Merged(64));
    let merged = part.info.map;
    assert!(merged.lost > 500 && merged.collisions > 500, "{merged:?}");
    assert_eq!(merged.cells + merged.shared + merged.lost, 4500);
    assert_eq!(merged.kept(), 4500 - merged.lost);
    let geometry = Geometry::decode(&part.payload).unwrap();
    assert!(matches!(geometry, Geometry::Merged(_)));
    assert_eq!(geometry.points().len() as u64, merged.cells);
    for (p, s) in geometry.points() {
        let (c, r) = geometry.spheres()[s as usize];
        assert!((p.distance(c) - r).abs() < 1e-6);
    }
}

#[test]
fn fewer_spheres_take_a_larger_distance() {
    let points = LocalPoints::new(&balls(DVec3::ZERO)).unwrap();
    let mut fitter = CloudFit::default();
    let mut search = |spheres, floor_m| {
        let floor = FitParameters {
            contact_distance: ContactDistance::constant(floor_m),
            ..parameters()
        };
        let (model, used) = scales::fit(&mut fitter, &points, &floor, spheres, 0.05).unwrap();
        assert!(model.spheres.len() <= spheres);
        assert!(model.explained >= 0.999, "{spheres}: {}", model.explained);
        used.contact_distance.floor_m
    };
    let (one, three) = (search(1, 1e-5), search(3, 1e-4));
    assert!(one > 0.05, "{one}");
    // three spheres are the truth: the floor holds
    assert_eq!(three, 1e-4);
}

#[test]
fn files_round_trip_and_are_selected_from() {
    let (scene, parts) = scene();
    let bytes = file::encode(&scene, &parts, "x").unwrap();
    assert_eq!(bytes, file::encode(&scene, &parts, "x").unwrap());
    let read = ModelFile::parse(&bytes, Path::new("x.mcap")).unwrap();
    assert_eq!(
        (&read.scene, &read.parts, &read.damage),
        (&scene, &parts, &None)
    );
    let names = |scale, object| {
        let chosen = read.select(scale, object).unwrap();
        let name = |p: &&Part| (p.info.scale, p.info.object);
        chosen.iter().map(name).collect::<Vec<_>>()
    };
    assert_eq!(names(None, None), [(1, 0), (1, 1)]);
    assert_eq!(names(Some(3), None), [(0, 0), (0, 1)]);
    assert_eq!(names(Some(9), Some("far")), [(1, 1)]);
    let told = read.select(Some(5), None).unwrap_err().to_string();
    assert!(told.contains("scale 5") && told.contains("3, 9"), "{told}");
    let told = read.select(None, Some("sun")).unwrap_err().to_string();
    assert!(told.contains("near, far"), "{told}");
}

#[test]
fn a_cut_file_gives_its_coarse_scale() {
    let (scene, parts) = scene();
    let bytes = file::encode(&scene, &parts, "x").unwrap();
    let mut most = 0;
    for length in (0..bytes.len()).step_by(97) {
        if let Ok(read) = ModelFile::parse(&bytes[..length], Path::new("x")) {
            assert!(read.parts.len() >= most, "more bytes, fewer parts");
            assert_eq!(read.parts, parts[..read.parts.len()]);
            // what is cut behind the last part may be told, a part that is missing is
            assert!(read.damage.is_some() || read.parts.len() == parts.len());
            most = read.parts.len();
        }
    }
    assert_eq!(most, parts.len());
}

#[test]
fn a_record_beyond_its_chunk_is_told() {
    let (scene, parts) = scene();
    let bytes = file::encode(&scene, &parts, "x").unwrap();
    let record = |at: usize| {
        let length = u64::from_le_bytes(*bytes[at + 1..].first_chunk().unwrap());
        (bytes[at], at + 9, at + 9 + length as usize)
    };
    let mut at = mcap::MAGIC.len();
    let mut chunks = Vec::new();
    while at < bytes.len() - mcap::MAGIC.len() {
        let (opcode, body, end) = record(at);
        if opcode == mcap::records::op::CHUNK {
            chunks.push(body + 40);
        }
        at = end;
    }
    // of each chunk, the length of its first record
    for &first in &chunks {
        for more in [1, 200, 5000] {
            let mut hit = bytes.clone();
            let (_, body, end) = record(first);
            hit[first + 1..body].copy_from_slice(&((end - body + more) as u64).to_le_bytes());
            if let Ok(read) = ModelFile::parse(&hit, Path::new("x")) {
                assert!(read.parts.len() < parts.len());
                let damage = read.damage.unwrap();
                assert!(damage.contains("do not end with it"), "{damage}");
            }
        }
    }
    assert!(chunks.len() > 1);
}

#[test]
fn damaged_files_are_told() {
    let (scene, parts) = scene();
    let bytes = file::encode(&scene, &parts, "x").unwrap();
    let mut state = 7u64;
    for _ in 0..300 {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1);
        let mut hit = bytes.clone();
        let at = (state >> 33) as usize % hit.len();
        hit[at] ^= 1 << (state >> 30 & 7);
        // the whole scene, or a part that is not what was written is noticed
        if let Ok(read) = ModelFile::parse(&hit, Path::new("x")) {
            for (found, wanted) in read.parts.iter().zip(&parts) {
                let same = found.payload == wanted.payload;
                assert!(same || read.decode(found).is_err(), "byte {at}");
            }
        }
    }
}

#[test]
fn exports_keep_places_far_from_zero() {
    let (scene, parts) = scene();
    let read = ModelFile::parse(&file::encode(&scene, &parts, "x").unwrap(), Path::new("x"));
    let read = read.unwrap();
    let chosen = read.select(None, None).unwrap();
    let decoded: Vec<_> = chosen.iter().map(|p| read.decode(p).unwrap()).collect();
    let placed: Vec<_> = (0u32..).zip(&decoded).collect();
    let wanted: Vec<DVec3> = [balls(DVec3::ZERO), balls(UTM)].concat();
    use crate::cloud::{Cloud, CloudFormat};
    for (bytes, format) in [
        (export::ply_points(&placed), CloudFormat::Ply),
        (export::pcd_points(&placed).unwrap(), CloudFormat::Pcd),
    ] {
        let cloud = Cloud::parse(&bytes, format).unwrap();
        let error = cloud_error(&wanted, &cloud.positions);
        assert!(error.max_m < 0.00075, "{format}: {error:?}");
    }
    let spheres = Cloud::parse(&export::ply_spheres(&placed), CloudFormat::Ply).unwrap();
    assert_eq!(spheres.positions.len(), 6);
    assert!(spheres.positions.iter().any(|c| c.distance(UTM) < 1e-5));
}

#[test]
fn objects_without_a_surface_are_refused() {
    let check = |positions: &[DVec3], contact_m| {
        build::check(&LocalPoints::new(positions).unwrap(), contact_m)
    };
    let line: Vec<_> = (0..50).map(|i| DVec3::X * f64::from(i)).collect();
    for odd in [&[], &line[..1], &line, &vec![DVec3::ONE; 40][..]] {
        let told = check(odd, 0.01).unwrap_err();
        assert_eq!(told, Unfit::NoSurface { points: odd.len() });
    }
    let flat: Vec<_> = (0..64)
        .map(|i| DVec3::new(f64::from(i % 8), f64::from(i / 8), 0.0))
        .collect();
    assert_eq!(check(&flat, 0.01), Ok(()));
    let wide: Vec<_> = flat.iter().map(|p| *p * 1e6).collect();
    assert!(matches!(check(&wide, 0.001), Err(Unfit::TooWide { .. })));
    assert_eq!(check(&wide, 100.0), Ok(()));
}

#[test]
fn chamfer_compares_what_was_given_with_what_comes_back() {
    let given = LocalPoints::new(&ball(UTM, 3000)).unwrap();
    let part = part_of(&ball(UTM, 3000), MapChoice::Claims(Some(0.001)));
    let rebuilt: Vec<DVec3> = {
        let geometry = Geometry::decode(&part.payload).unwrap();
        let points = geometry.points().into_iter();
        points.map(|(p, _)| p + geometry.origin()).collect()
    };
    let truth_m = cloud_error(&ball(UTM, 3000), &rebuilt).chamfer_m;
    let chamfer_m = build::chamfer_m(&given, &part).unwrap().unwrap();
    assert!((chamfer_m - truth_m).abs() < 1e-7, "{chamfer_m} {truth_m}");
    // about another origin
    let moved = LocalPoints::new(&ball(UTM + DVec3::X * 100.0, 3000)).unwrap();
    let far_m = build::chamfer_m(&moved, &part).unwrap().unwrap();
    assert!((far_m - 100.0).abs() < 0.4, "{far_m}");
    let mut broken = part;
    broken.payload.truncate(5);
    assert!(build::chamfer_m(&given, &broken).is_err());
}

#[test]
fn distances_are_what_their_text_says() {
    for length_m in [0.0069, 0.000_685, 1.234e-5, 12.3456, 4.2e-9] {
        let distance = ContactDistance::constant(build::printed_distance(length_m, 3));
        let text = distance.to_string();
        assert!(text.ends_with("mm") && text.len() < 16, "{text}");
        assert_eq!(text.parse(), Ok(distance), "{text}");
        assert!((distance.floor_m / length_m - 1.0).abs() < 0.005, "{text}");
    }
}
