//! The live fit against scenes whose truth is known.

#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use saint_live::capture::FrameSource;
use saint_live::capture::synthetic::{
    NoiseModel, Scene, SceneTruth, SyntheticOptions, SyntheticSource,
};
use saint_live::codec::{CodecOptions, EncodedFrame, Encoder};
use saint_live::contact_map::labels::{INVALID, NO_SPHERE, SaintFrame};
use saint_live::deproject::{Rays, Validity};
use saint_live::fit::contact_distance::ContactDistance;
use saint_live::fit::live::{FitOptions, FitReport, Modeler};
use saint_live::frame::{Camera, DepthFrame};

/// Three standard deviations of Kinect noise, and its step, within the share of the contact
/// distance that surfaces are fitted to (0.7): what lies farther off is no noise.
const WIDE: ContactDistance = ContactDistance {
    floor_m: 0.0115,
    per_z2: 6.5e-3,
};

fn source(scene: Scene, noise: NoiseModel) -> SyntheticSource {
    let options = SyntheticOptions {
        width: 320,
        height: 240,
        noise,
        ..SyntheticOptions::unpaced(scene)
    };
    SyntheticSource::open(options).unwrap()
}

fn shot(source: &mut SyntheticSource, index: u64) -> DepthFrame {
    let mut frame = DepthFrame {
        sequence: index,
        ..DepthFrame::default()
    };
    source.render(index, &mut frame.depth);
    frame
}

fn options(contact_distance: ContactDistance) -> FitOptions {
    FitOptions {
        contact_distance,
        ..FitOptions::default()
    }
}

/// Errors along z against the truth, metres, RMS over the pixels a sphere explains that are not
/// at a depth edge (there the sensor shows another surface than the truth).
#[derive(Debug)]
struct Errors {
    modelled: f64,
    measured: f64,
    pixels: usize,
}

fn errors(camera: &Camera, frame: &DepthFrame, saint: &SaintFrame, truth: &SceneTruth) -> Errors {
    let (rays, validity) = (Rays::new(camera), Validity::new(camera));
    let (mut modelled, mut measured, mut pixels) = (0.0, 0.0, 0);
    for (pixel, label) in saint
        .labels(rays.width, rays.height)
        .into_iter()
        .enumerate()
    {
        let raw = frame.depth[pixel];
        assert_eq!(
            label == INVALID,
            !validity.accepts(raw),
            "pixel {pixel}: {raw}"
        );
        let (x, y) = (pixel % rays.width, pixel / rays.width);
        let inside = (2..rays.width - 2).contains(&x) && (2..rays.height - 2).contains(&y);
        let same = |q: usize| truth.surface[q] == truth.surface[pixel];
        let far = 2 * rays.width;
        if label >= NO_SPHERE
            || !inside
            || truth.surface[pixel] == 0
            || ![pixel - 2, pixel + 2, pixel - far, pixel + far]
                .into_iter()
                .all(same)
        {
            continue;
        }
        let (u, v) = (rays.u[x], rays.v[y]);
        let sphere = saint.spheres[usize::from(label)].unwrap();
        let z = 1.0 / f64::from(sphere.inverse_depth(u, v, u * u + v * v + 1.0));
        let raw = f64::from(frame.depth[pixel]) * camera.depth_unit_m;
        modelled += (z - truth.depth_m[pixel]).powi(2);
        measured += (raw - truth.depth_m[pixel]).powi(2);
        pixels += 1;
    }
    Errors {
        modelled: (modelled / pixels as f64).sqrt(),
        measured: (measured / pixels as f64).sqrt(),
        pixels,
    }
}

/// The sphere most pixels of a surface carry, and how many of how many do.
fn main_sphere(saint: &SaintFrame, truth: &SceneTruth, surface: u16) -> (usize, u32, u32) {
    let mut pixels = vec![0u32; saint.spheres.len()];
    for (label, &on) in saint.labels(320, 240).into_iter().zip(&truth.surface) {
        if on == surface && label < NO_SPHERE {
            pixels[usize::from(label)] += 1;
        }
    }
    let most = (0..pixels.len()).max_by_key(|&s| pixels[s]).unwrap_or(0);
    (
        most,
        pixels.get(most).copied().unwrap_or(0),
        pixels.iter().sum(),
    )
}

#[test]
fn a_plane_is_one_sphere_and_smoother_than_its_measurement() {
    for noise in [NoiseModel::Off, NoiseModel::Kinect] {
        let mut source = source(Scene::Plane, noise);
        let (camera, frame) = (source.camera().clone(), shot(&mut source, 0));
        let truth = source.truth(0);
        let mut saint = SaintFrame::default();
        let report = Modeler::new(&camera, &options(WIDE)).model(&frame, &mut saint, &|| false);
        let covered = f64::from(report.explained_pixels) / f64::from(report.valid_pixels);
        assert!(covered >= 0.99, "{noise:?}: {covered} covered, {report:?}");
        let (most, own, all) = main_sphere(&saint, &truth, 1);
        assert!(
            own * 10 > all * 9,
            "{noise:?}: {own} of {all} pixels share a sphere"
        );
        let (_, radius) = saint.spheres[most].unwrap().center_radius();
        assert!(radius > 30.0, "{noise:?}: a plane of radius {radius} m");
        let e = errors(&camera, &frame, &saint, &truth);
        assert!(
            e.pixels > 50_000 && e.modelled < 0.5 * e.measured.max(0.0005),
            "{noise:?}: {e:?}"
        );
    }
}

#[test]
fn spheres_of_known_size_are_found() {
    for (noise, contact, tolerance) in [
        (NoiseModel::Off, ContactDistance::constant(0.005), 0.03),
        (NoiseModel::Kinect, WIDE, 0.2),
    ] {
        let mut source = source(Scene::Spheres, noise);
        let (camera, frame) = (source.camera().clone(), shot(&mut source, 0));
        let truth = source.truth(0);
        let mut saint = SaintFrame::default();
        let report = Modeler::new(&camera, &options(contact)).model(&frame, &mut saint, &|| false);
        let covered = f64::from(report.explained_pixels) / f64::from(report.valid_pixels);
        assert!(covered >= 0.97, "{noise:?}: {covered} covered, {report:?}");
        let mut found = 0;
        for sphere in &truth.spheres {
            let (most, own, all) = main_sphere(&saint, &truth, sphere.surface);
            if all < 1000 {
                continue;
            }
            found += 1;
            let (center, radius) = saint.spheres[most].unwrap().center_radius();
            let wrong = center
                .distance(sphere.center_m)
                .max((radius - sphere.radius_m).abs());
            assert!(
                wrong < tolerance * sphere.radius_m,
                "{noise:?}: sphere of {} m is {wrong} m off, on {own} of {all} pixels",
                sphere.radius_m
            );
        }
        assert!(found >= 3, "{noise:?}: only {found} spheres seen");
        let e = errors(&camera, &frame, &saint, &truth);
        assert!(e.modelled < e.measured, "{noise:?}: {e:?}");
    }
}

#[test]
fn a_room_is_covered_and_smoother_than_its_measurement() {
    for noise in [NoiseModel::Off, NoiseModel::Kinect] {
        let mut source = source(Scene::Room, noise);
        let (camera, frame) = (source.camera().clone(), shot(&mut source, 0));
        let truth = source.truth(0);
        let mut saint = SaintFrame::default();
        let report = Modeler::new(&camera, &options(WIDE)).model(&frame, &mut saint, &|| false);
        let covered = f64::from(report.explained_pixels) / f64::from(report.valid_pixels);
        assert!(covered >= 0.99, "{noise:?}: {covered} covered, {report:?}");
        let e = errors(&camera, &frame, &saint, &truth);
        if noise != NoiseModel::Off {
            assert!(e.modelled < e.measured, "{noise:?}: {e:?}");
        }
    }
}

/// Reports and errors over frames 1 to 8, warm or cold.
fn run(scene: Scene, warm_start: bool) -> (Vec<FitReport>, f64) {
    let mut source = source(scene, NoiseModel::Kinect);
    let camera = source.camera().clone();
    let fit = FitOptions {
        warm_start,
        ..options(WIDE)
    };
    let mut modeler = Modeler::new(&camera, &fit);
    let mut saint = SaintFrame::default();
    let (mut reports, mut square, mut pixels) = (Vec::new(), 0.0, 0);
    for index in 0..9 {
        let frame = shot(&mut source, index);
        let report = modeler.model(&frame, &mut saint, &|| false);
        if index > 0 {
            let e = errors(&camera, &frame, &saint, &source.truth(index));
            square += e.modelled * e.modelled * e.pixels as f64;
            pixels += e.pixels;
            reports.push(report);
        }
    }
    (reports, (square / pixels as f64).sqrt())
}

#[test]
fn a_warm_start_is_as_good_and_does_less() {
    for (scene, work) in [(Scene::Room, 0.35), (Scene::Walk, 0.6)] {
        let ((cold, cold_error), (warm, warm_error)) = (run(scene, false), run(scene, true));
        let sum = |reports: &[FitReport], of: fn(&FitReport) -> u32| -> f64 {
            reports.iter().map(|r| f64::from(of(r))).sum()
        };
        assert!(
            warm_error <= 1.1 * cold_error,
            "{scene:?}: warm {warm_error} m, cold {cold_error} m"
        );
        let explained = |r: &[FitReport]| sum(r, |r| r.explained_pixels);
        assert!(
            explained(&warm) >= 0.995 * explained(&cold),
            "{scene:?}: warm explains {}, cold {}",
            explained(&warm),
            explained(&cold)
        );
        let fitted = |r: &[FitReport]| sum(r, |r| r.cold_pixels);
        assert!(
            fitted(&warm) < work * fitted(&cold),
            "{scene:?}: warm fits {} pixels anew, cold {}",
            fitted(&warm),
            fitted(&cold)
        );
        let new = |r: &[FitReport]| sum(r, |r| r.new);
        assert!(
            new(&warm) < work * new(&cold),
            "{scene:?}: warm makes {} spheres, cold {}",
            new(&warm),
            new(&cold)
        );
    }
}

#[test]
fn one_thread_and_two_give_the_same_frames_and_bytes() {
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        pool.install(|| {
            let mut source = source(Scene::Walk, NoiseModel::Kinect);
            let camera = source.camera().clone();
            let mut modeler = Modeler::new(&camera, &FitOptions::default());
            let with = CodecOptions::fitted(ContactDistance::default(), 30);
            let mut encoder = Encoder::new(&camera, with).unwrap();
            let (mut saint, mut encoded) = (SaintFrame::default(), EncodedFrame::default());
            (0..4)
                .map(|index| {
                    let frame = shot(&mut source, index);
                    let report = modeler.model(&frame, &mut saint, &|| false);
                    encoder.encode(&frame, &saint, false, &mut encoded).unwrap();
                    let payload = encoded.payload.clone();
                    (
                        report,
                        saint.contacts.clone(),
                        saint.spheres.clone(),
                        payload,
                    )
                })
                .collect::<Vec<_>>()
        })
    };
    let (one, two) = (run(1), run(2));
    for (index, (one, two)) in one.iter().zip(&two).enumerate() {
        assert!(one == two, "frame {index} differs");
    }
}

#[test]
fn hard_pictures_are_survived() {
    for (width, height) in [(1, 1), (17, 9), (33, 1), (8, 8)] {
        let camera = Camera {
            width,
            height,
            ..source(Scene::Room, NoiseModel::Off).camera().clone()
        };
        let camera = Camera {
            depth_max_m: 70.0,
            ..camera
        };
        let pixels = camera.pixels();
        let mut modeler = Modeler::new(&camera, &FitOptions::default());
        let mut saint = SaintFrame::default();
        let frames: [Vec<u16>; 5] = [
            vec![0; pixels],
            vec![65535; pixels],
            (0..pixels).map(|i| 1000 * (1 + i as u16 % 2)).collect(),
            (0..pixels)
                .map(|i| 1500 * u16::from(i == pixels / 2))
                .collect(),
            (0..pixels)
                .map(|i| (i as u16).wrapping_mul(40_503))
                .collect(),
        ];
        for depth in frames {
            let valid = depth.iter().filter(|d| **d != 0).count();
            let frame = DepthFrame {
                depth,
                ..DepthFrame::default()
            };
            let report = modeler.model(&frame, &mut saint, &|| false);
            assert_eq!(report.valid_pixels as usize, valid, "{width}x{height}");
            let labels = saint.labels(width as usize, height as usize);
            let named = labels.iter().filter(|l| **l < NO_SPHERE);
            assert_eq!(report.explained_pixels as usize, named.clone().count());
            assert!(
                named
                    .clone()
                    .all(|l| saint.spheres[usize::from(*l)].is_some())
            );
        }
    }
}
