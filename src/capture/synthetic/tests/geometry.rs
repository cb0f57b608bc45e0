//! Exact depth against walking along the ray.

use super::*;
use crate::frame::Intrinsics;
use glam::{DQuat, DVec3};

fn ray(k: &Intrinsics, x: usize, y: usize) -> DVec3 {
    DVec3::new((x as f64 - k.cx) / k.fx, (y as f64 - k.cy) / k.fy, 1.0)
}

/// Signed distance-like function: negative inside a solid, changes sign across a surface.
fn inside(shape: &Shape, p: DVec3) -> f64 {
    match *shape {
        Shape::Plane { normal, offset } => normal.dot(p) - offset,
        Shape::Sphere { center, radius } => (p - center).length() - radius,
        Shape::Box {
            center,
            half,
            rotation,
        } => ((rotation.inverse() * (p - center)).abs() - half).max_element(),
        Shape::Cylinder {
            center,
            axis,
            radius,
            half_length,
        } => {
            let along = (p - center).dot(axis);
            let across = (p - center - axis * along).length();
            (across - radius).max(along.abs() - half_length)
        }
    }
}

/// Nearest depth by walking along the ray and halving the step where the sign changes.
fn oracle(surfaces: &[Surface], pose: &Pose, ray: DVec3) -> Option<f64> {
    let mut nearest: Option<f64> = None;
    for surface in surfaces {
        let at = |z: f64| inside(&surface.shape, pose.to_world(ray * z));
        let (mut z, step) = (0.01, 0.004);
        let start = at(z);
        while z < 8.0 {
            if at(z + step) * start < 0.0 {
                let (mut low, mut high) = (z, z + step);
                for _ in 0..60 {
                    let middle = 0.5 * (low + high);
                    if at(middle) * start < 0.0 {
                        high = middle;
                    } else {
                        low = middle;
                    }
                }
                nearest = Some(nearest.map_or(high, |n: f64| n.min(high)));
                break;
            }
            z += step;
        }
    }
    nearest
}

#[test]
fn rendered_depth_is_what_marching_along_the_ray_finds() {
    for scene in [Scene::Juggle, Scene::Walk, Scene::Spheres, Scene::Plane] {
        let mut source = open(SyntheticOptions {
            width: 48,
            height: 36,
            ..small(scene)
        });
        let k = source.camera().intrinsics;
        let mut grazed = 0;
        for index in [0, 47] {
            let truth = source.truth(index);
            for pixel in (0..48 * 36).step_by(5) {
                let found = oracle(
                    &truth.surfaces,
                    &truth.pose,
                    ray(&k, pixel % 48, pixel / 48),
                );
                let (found, drawn) = (found.unwrap_or(0.0), truth.depth_m[pixel]);
                // walking steps over a solid it only grazes
                if drawn > 0.0 && (found == 0.0 || found > drawn + 1e-3) {
                    let p = truth.pose.to_world(ray(&k, pixel % 48, pixel / 48) * drawn);
                    let hit = truth.surfaces[usize::from(truth.surface[pixel]) - 1];
                    assert!(inside(&hit.shape, p).abs() < 1e-9, "pixel {pixel}");
                    grazed += 1;
                    continue;
                }
                assert!(
                    (drawn - found).abs() < 1e-9,
                    "{scene:?} frame {index} pixel {pixel}: drawn {drawn}, found {found}"
                );
            }
        }
        assert!(grazed <= 3, "{scene:?}: {grazed} pixels differ");
    }
}

#[test]
fn a_cylinder_shows_its_cap_from_above_and_its_side_from_the_front() {
    let shape = Shape::Cylinder {
        center: DVec3::new(0.0, 0.0, 2.0),
        axis: DVec3::Y,
        radius: 0.5,
        half_length: 0.75,
    };
    let surfaces = [Surface {
        shape,
        dropout: 0.0,
        moves: false,
    }];
    let k = Intrinsics {
        fx: 40.0,
        fy: 40.0,
        cx: 19.5,
        cy: 19.5,
    };
    let mut renderer = render::Renderer::new(40, 40, k);
    let mut view = render::View::default();
    let above = Pose {
        // looks straight down on the cap, 1 m away
        rotation: DQuat::from_rotation_x(-std::f64::consts::FRAC_PI_2),
        position: DVec3::new(0.1, -1.75, 2.0),
    };
    for (pose, seen) in [(Pose::default(), 1.5), (above, 1.0)] {
        renderer.draw(&surfaces, &pose, None, &mut view);
        let mut hits = 0;
        for pixel in 0..1600 {
            let drawn = view.inverse_depth[pixel];
            let found = oracle(&surfaces, &pose, ray(&k, pixel % 40, pixel / 40));
            assert!(drawn > 0.0 || found.is_none(), "pixel {pixel} not drawn");
            if drawn > 0.0 {
                hits += 1;
                let p = pose.to_world(ray(&k, pixel % 40, pixel / 40) / drawn);
                assert!(inside(&surfaces[0].shape, p).abs() < 1e-9, "pixel {pixel}");
                // walking steps over the rim
                assert!(
                    found.is_none_or(|z| z > 1.0 / drawn - 1e-9),
                    "pixel {pixel}"
                );
            }
        }
        assert!(hits > 100, "{hits}");
        let middle = 1.0 / view.inverse_depth[19 * 40 + 19];
        assert!((middle - seen).abs() < 1e-3, "{middle}");
    }
}

#[test]
fn true_spheres_lie_on_the_exact_depth() {
    for scene in [Scene::Spheres, Scene::Juggle, Scene::Walk] {
        let mut source = open(small(scene));
        let k = source.camera().intrinsics;
        let truth = source.truth(20);
        let mut on_spheres = 0;
        for sphere in &truth.spheres {
            for pixel in 0..truth.depth_m.len() {
                if truth.surface[pixel] == sphere.surface {
                    let p = ray(&k, pixel % 160, pixel / 160) * truth.depth_m[pixel];
                    let off = (p - sphere.center_m).length() - sphere.radius_m;
                    assert!(
                        off.abs() < 1e-9,
                        "{scene:?} sphere {}: {off}",
                        sphere.surface
                    );
                    on_spheres += 1;
                }
            }
        }
        assert!(on_spheres > 500, "{scene:?}: {on_spheres}");
    }
}

#[test]
fn without_noise_every_code_is_the_rounded_truth() {
    for unit_m in [0.001, 0.0001] {
        let mut source = open(SyntheticOptions {
            noise: NoiseModel::Off,
            unit_m,
            ..small(Scene::Walk)
        });
        let mut depth = Vec::new();
        source.render(33, &mut depth);
        let truth = source.truth(33);
        for (&code, &z) in depth.iter().zip(&truth.depth_m) {
            assert!((f64::from(code) * unit_m - z).abs() <= 0.5 * unit_m + 1e-12);
        }
    }
}
