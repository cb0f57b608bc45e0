//! The statistics of noise, holes and edges.

use super::*;

/// Standard deviation of measured minus true depth on a frontal wall at `z` metres.
fn measured_sigma(noise: NoiseModel, z: f64) -> (f64, f64) {
    let (width, height, unit_m) = (200, 150, 0.001);
    let sensor = noise.sensor();
    let coding = noise::Coding {
        unit_m,
        hole: 0,
        focal_px: 200.0,
    };
    let mut model = noise::Noise::new(sensor, coding, width);
    // a range of depths within one disparity step, so that the step's error is uniform
    let spread = 2.0 * sensor.step_inverse_m;
    let pixels = width * height;
    let view = render::View {
        inverse_depth: (0..pixels)
            .map(|i| 1.0 / z + spread * (i / width) as f64 / height as f64)
            .collect(),
        surface: vec![1; pixels],
    };
    let mut out = vec![0; pixels];
    let (mut sum, mut squares, mut count) = (0.0, 0.0, 0.0);
    for frame in 0..4 {
        let white = field::White {
            lasting: 1000 + frame,
            fleeting: 77_777 * frame,
            shift: (0, 0),
        };
        model.apply(&view, &[0.0, 0.0], white, &mut out);
        for (&code, &w) in out.iter().zip(&view.inverse_depth) {
            if code > 0 {
                let error = f64::from(code) * unit_m - 1.0 / w;
                sum += error;
                squares += error * error;
                count += 1.0;
            }
        }
    }
    assert!(
        count > 0.9 * 4.0 * pixels as f64,
        "{noise:?} at {z}: {count}"
    );
    let mean: f64 = sum / count;
    ((squares / count - mean * mean).sqrt(), mean)
}

#[test]
fn noise_follows_the_law_of_its_sensor() {
    for noise in [NoiseModel::Kinect, NoiseModel::Stereo, NoiseModel::Tof] {
        for z in [0.7, 1.5, 3.0, 5.0] {
            let expected = noise.sensor().sigma_m(z, 0.001);
            let (sigma, mean) = measured_sigma(noise, z);
            assert!(
                (sigma / expected - 1.0).abs() < 0.1,
                "{noise:?} at {z} m: sigma {sigma}, law {expected}"
            );
            assert!(
                mean.abs() < 0.15 * expected,
                "{noise:?} at {z} m: mean {mean}"
            );
        }
    }
    // triangulation: four times the noise at twice the depth
    let ratio =
        measured_sigma(NoiseModel::Kinect, 4.0).0 / measured_sigma(NoiseModel::Kinect, 2.0).0;
    assert!((ratio - 4.0).abs() < 0.4, "ratio {ratio}");
}

#[test]
fn holes_are_as_frequent_and_as_restless_as_in_real_frames() {
    for noise in [NoiseModel::Kinect, NoiseModel::Stereo, NoiseModel::Tof] {
        let mut source = open(SyntheticOptions {
            noise,
            width: 320,
            height: 240,
            ..small(Scene::Room)
        });
        let (mut one, mut two) = (Vec::new(), Vec::new());
        source.render(0, &mut one);
        source.render(1, &mut two);
        let holes = share(one.iter().map(|&code| code == 0));
        assert!((0.01..0.2).contains(&holes), "{noise:?}: holes {holes}");
        let flicker = share(one.iter().zip(&two).map(|(&a, &b)| (a == 0) != (b == 0)));
        assert!(
            (0.002..0.06).contains(&flicker),
            "{noise:?}: flicker {flicker}"
        );
        let moved = share(one.iter().zip(&two).map(|(&a, &b)| a != b));
        assert!(moved > 0.2, "{noise:?}: {moved}");
    }
}

#[test]
fn the_second_camera_casts_a_shadow_on_the_left_only() {
    // a near square before a wall: columns 60..100 of a row of 160
    let width = 160;
    let wall = |x: usize| if (60..100).contains(&x) { 1.0 } else { 0.25 };
    let view = render::View {
        inverse_depth: (0..width * 20).map(|i| wall(i % width)).collect(),
        surface: vec![1; width * 20],
    };
    let coding = noise::Coding {
        unit_m: 0.001,
        hole: 0,
        focal_px: 200.0,
    };
    let mut model = noise::Noise::new(NoiseModel::Kinect.sensor(), coding, width);
    let mut out = vec![0; width * 20];
    let white = field::White {
        lasting: 5,
        fleeting: 6,
        shift: (0, 0),
    };
    model.apply(&view, &[0.0; 2], white, &mut out);
    // 0.075 m × 200 px × (1 − 1/4) /m = 11 px of shadow
    let lost = |columns: std::ops::Range<usize>| {
        share(
            (0..20)
                .flat_map(|y| columns.clone().map(move |x| (x, y)))
                .map(|(x, y)| out[y * width + x] == 0),
        )
    };
    assert!(lost(50..58) > 0.99, "{}", lost(50..58));
    assert!(lost(30..47) < 0.1, "{}", lost(30..47));
    assert!(lost(103..130) < 0.1, "{}", lost(103..130));
}

#[test]
fn time_of_flight_has_pixels_between_the_two_sides_of_an_edge() {
    let mut counts = Vec::new();
    for noise in [NoiseModel::Tof, NoiseModel::Kinect] {
        let mut source = open(SyntheticOptions {
            noise,
            width: 320,
            height: 240,
            ..small(Scene::Juggle)
        });
        let mut depth = Vec::new();
        source.render(5, &mut depth);
        let truth = source.truth(5);
        let flying = depth
            .iter()
            .zip(&truth.depth_m)
            .enumerate()
            .filter(|(i, (code, z))| {
                let z_measured = f64::from(**code) * 0.001;
                let neighbours = [i.saturating_sub(1), (i + 1).min(depth.len() - 1)];
                let off = |truth: f64| (z_measured - truth).abs() > 0.05;
                **code > 0 && off(**z) && neighbours.iter().all(|&j| off(truth.depth_m[j]))
            });
        counts.push(flying.count());
    }
    assert!(counts[0] > 100 && counts[0] > 3 * counts[1], "{counts:?}");
}

#[test]
fn measured_depths_are_in_the_range_the_camera_states() {
    for (noise, _) in NoiseModel::ALL {
        let mut source = open(SyntheticOptions {
            noise,
            ..small(Scene::Juggle)
        });
        let mut depth = Vec::new();
        source.render(3, &mut depth);
        let camera = source.camera();
        for &code in depth.iter().filter(|&&code| code > 0) {
            let z = f64::from(code) * camera.depth_unit_m;
            assert!(z >= camera.depth_min_m - 1e-3 && z <= camera.depth_max_m + 1e-3);
        }
    }
}
