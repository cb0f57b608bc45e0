use super::*;
use crate::capture::synthetic::{NoiseModel, Scene, SyntheticOptions, SyntheticSource};
use crate::fit::cloud::Scheme;
use crate::fit::contact_distance::ContactDistance;
use crate::fit::live::{FitOptions, Modeler};
use crate::frame::Intrinsics;

fn source(scene: Scene, noise: NoiseModel, size: (u32, u32)) -> SyntheticSource {
    let options = SyntheticOptions {
        width: size.0,
        height: size.1,
        noise,
        ..SyntheticOptions::unpaced(scene)
    };
    SyntheticSource::open(options).unwrap()
}

fn shot(source: &mut SyntheticSource, index: u64) -> DepthFrame {
    let mut frame = DepthFrame::default();
    source.render(index, &mut frame.depth);
    frame
}

fn camera_of(source: &SyntheticSource) -> Camera {
    use crate::capture::FrameSource;
    source.camera().clone()
}

fn parameters(scheme: Scheme) -> FitParameters {
    FitParameters {
        scheme,
        ..FitParameters::default()
    }
}

fn fitted(camera: &Camera, frame: &DepthFrame, with: &FitParameters) -> (SaintFrame, FitReport) {
    let mut saint = SaintFrame::default();
    let mut fit = FrameFit::new(camera, with).unwrap();
    let report = fit.model(frame, &mut saint, &|| false).unwrap();
    (saint, report)
}

/// Every label against its meaning, in double precision.
fn check(camera: &Camera, frame: &DepthFrame, saint: &SaintFrame, contact: ContactDistance) {
    let (rays, validity) = (Rays::new(camera), Validity::new(camera));
    let labels = saint.labels(rays.width, rays.height);
    for (pixel, (&raw, &label)) in frame.depth.iter().zip(&labels).enumerate() {
        assert_eq!(label == INVALID, !validity.accepts(raw), "pixel {pixel}");
        if label >= NO_SPHERE {
            continue;
        }
        let sphere = saint.spheres[usize::from(label)].unwrap();
        let (x, y) = (pixel % rays.width, pixel / rays.width);
        let ray = rays.point(x, y, 1.0);
        let (a, l) = (f64::from(sphere.a), sphere.m.as_dvec3().dot(ray));
        let root = (l * l + 4.0 * a * ray.length_squared()).sqrt();
        let w = 0.5 * if sphere.far { l - root } else { l + root };
        let z = f64::from(raw) * camera.depth_unit_m;
        let error = (1.0 / w - z).abs() * ray.length();
        assert!(
            w > 0.0 && error <= contact.at(z) + 2e-5,
            "pixel {pixel} is {error} m off its sphere along its ray"
        );
    }
}

#[test]
fn known_spheres_come_back() {
    // a contact distance of one sigma of the noise would split the spheres: three sigma here
    let wide = ContactDistance {
        floor_m: 0.01,
        per_z2: 4.2e-3,
    };
    for (noise, contact, tolerance) in [
        (NoiseModel::Off, ContactDistance::constant(0.002), 0.02),
        (NoiseModel::Kinect, wide, 0.25),
    ] {
        let mut source = source(Scene::Spheres, noise, (160, 120));
        let (camera, frame) = (camera_of(&source), shot(&mut source, 0));
        let truth = source.truth(0);
        for scheme in [Scheme::Progressive, Scheme::Random] {
            let with = FitParameters {
                contact_distance: contact,
                ..parameters(scheme)
            };
            let (saint, report) = fitted(&camera, &frame, &with);
            check(&camera, &frame, &saint, contact);
            let covered = f64::from(report.explained_pixels) / f64::from(report.valid_pixels);
            // at a rim the ray runs along the surface, and its error is many times the distance
            assert!(covered > 0.93, "{noise:?} {scheme}: {covered} covered");
            let labels = saint.labels(camera.width as usize, camera.height as usize);
            let mut found = 0;
            for sphere in &truth.spheres {
                let mut pixels = vec![0u32; saint.spheres.len()];
                for (label, surface) in labels.iter().zip(&truth.surface) {
                    if *surface == sphere.surface && *label < NO_SPHERE {
                        pixels[usize::from(*label)] += 1;
                    }
                }
                let most = (0..pixels.len()).max_by_key(|&s| pixels[s]).unwrap();
                if pixels[most] < 200 {
                    continue;
                }
                found += 1;
                let (center, radius) = saint.spheres[most].unwrap().center_radius();
                let (off, wrong) = (
                    center.distance(sphere.center_m),
                    (radius - sphere.radius_m).abs(),
                );
                assert!(
                    off.max(wrong) < tolerance * sphere.radius_m,
                    "{noise:?} {scheme}: centre {off} m off, radius {wrong} m, of {} m",
                    sphere.radius_m
                );
            }
            assert!(found >= 3, "{noise:?} {scheme}: only {found} spheres seen");
        }
    }
}

#[test]
fn live_covers_a_room_no_worse_than_random() {
    let mut source = source(Scene::Room, NoiseModel::Kinect, (320, 240));
    let (camera, frame) = (camera_of(&source), shot(&mut source, 0));
    let (saint, random) = fitted(&camera, &frame, &parameters(Scheme::Random));
    check(&camera, &frame, &saint, ContactDistance::default());
    let mut modeler = Modeler::new(&camera, &FitOptions::default());
    let live = modeler.model(&frame, &mut SaintFrame::default(), &|| false);
    assert_eq!(live.valid_pixels, random.valid_pixels);
    // the live fit works on blocks of 8x8 pixels, and small images are poor in blocks
    assert!(
        f64::from(live.explained_pixels) >= 0.98 * f64::from(random.explained_pixels),
        "live {live:?}, random {random:?}"
    );
}

#[test]
fn a_hollow_is_seen_at_its_far_side() {
    let camera = Camera {
        width: 64,
        height: 48,
        intrinsics: Intrinsics {
            fx: 60.0,
            fy: 60.0,
            cx: 31.5,
            cy: 23.5,
        },
        depth_unit_m: 0.0005,
        invalid: vec![0],
        depth_min_m: 0.0,
        depth_max_m: 10.0,
        fps: None,
        name: String::new(),
    };
    let rays = Rays::new(&camera);
    let hollow = Sphere {
        far: true,
        ..Sphere::from_center_radius(DVec3::new(0.0, 0.1, 2.0), 0.6).unwrap()
    };
    let mut frame = DepthFrame::default();
    for y in 0..48 {
        for x in 0..64 {
            let (u, v) = (rays.u[x], rays.v[y]);
            let z = 1.0 / hollow.inverse_depth(u, v, u * u + v * v + 1.0);
            frame.depth.push(if z.is_finite() {
                (z / 0.0005).round() as u16
            } else {
                0
            });
        }
    }
    for scheme in [Scheme::Progressive, Scheme::Random] {
        let with = FitParameters {
            contact_distance: ContactDistance::constant(0.002),
            ..parameters(scheme)
        };
        let (saint, report) = fitted(&camera, &frame, &with);
        assert!(
            report.explained_pixels as f64 > 0.9 * f64::from(report.valid_pixels),
            "{scheme}: {report:?}"
        );
        check(&camera, &frame, &saint, with.contact_distance);
        let label = saint.contacts.label(64, 32, 24);
        let sphere = saint.spheres[usize::from(label)].unwrap();
        let (center, radius) = sphere.center_radius();
        assert!(sphere.far, "{scheme}");
        assert!(
            center.distance(DVec3::new(0.0, 0.1, 2.0)) < 0.02 && (radius - 0.6).abs() < 0.02,
            "{scheme}: {center} {radius}"
        );
    }
}

#[test]
fn numbers_stay_with_their_surfaces() {
    let mut source = source(Scene::Room, NoiseModel::Off, (80, 60));
    let (camera, frame) = (camera_of(&source), shot(&mut source, 0));
    let mut fit = FrameFit::new(&camera, &parameters(Scheme::Progressive)).unwrap();
    let (mut first, mut second) = (SaintFrame::default(), SaintFrame::default());
    fit.model(&frame, &mut first, &|| false).unwrap();
    fit.model(&frame, &mut second, &|| false).unwrap();
    assert_eq!(
        (&first.contacts, &first.spheres),
        (&second.contacts, &second.spheres)
    );
    // numbers swapped by hand: the fit names its spheres as the frame before does
    let mut numbers = Numbers {
        before: vec![7, 7, 7, 0, 0, 0, 3],
        ..Numbers::default()
    };
    let sphere = |radius| Sphere::from_center_radius(DVec3::Z * 2.0, radius).unwrap();
    let spheres = [sphere(0.1), sphere(0.2), sphere(0.3), sphere(0.4)];
    let mut labels = [0, 0, 1, 1, 1, 3, INVALID];
    let mut slots = Vec::new();
    numbers.settle(&spheres, &mut labels, &mut slots);
    assert_eq!(labels, [7, 7, 0, 0, 0, 1, INVALID]);
    assert_eq!(
        (slots.len(), slots[7], slots[0]),
        (8, Some(spheres[0]), Some(spheres[1]))
    );
    assert_eq!(
        (slots[1], slots.iter().flatten().count()),
        (Some(spheres[3]), 3)
    );
}

#[test]
fn no_time_and_no_measurement_give_frames_without_spheres() {
    let mut source = source(Scene::Room, NoiseModel::Off, (80, 60));
    let (camera, mut frame) = (camera_of(&source), shot(&mut source, 0));
    let mut fit = FrameFit::new(&camera, &parameters(Scheme::Random)).unwrap();
    let mut saint = SaintFrame::default();
    let report = fit.model(&frame, &mut saint, &|| true).unwrap();
    assert!(report.degraded && report.explained_pixels == 0 && report.valid_pixels > 0);
    assert!(saint.labels(80, 60).iter().all(|l| *l >= NO_SPHERE));
    frame.depth.fill(0);
    let report = fit.model(&frame, &mut saint, &|| false).unwrap();
    assert_eq!((report.valid_pixels, report.spheres), (0, 0));
    assert!(saint.labels(80, 60).iter().all(|l| *l == INVALID));
    assert!(saint.spheres.is_empty());
}
