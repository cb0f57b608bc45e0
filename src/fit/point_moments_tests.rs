use super::*;
use proptest::prelude::*;

/// A small generator with a fixed seed: uniform in 0..1 and normal deviates.
struct Draw(u64);

impl Draw {
    fn uniform(&mut self) -> f64 {
        self.0 = self
            .0
            .wrapping_mul(6364136223846793005)
            .wrapping_add(1442695040888963407);
        let x = (self.0 ^ (self.0 >> 33)).wrapping_mul(0xff51afd7ed558ccd);
        ((x ^ (x >> 33)) >> 11) as f64 / (1u64 << 53) as f64
    }
    fn normal(&mut self) -> f64 {
        (0..12).map(|_| self.uniform()).sum::<f64>() - 6.0
    }
}

fn moments(points: &[DVec3]) -> PointMoments {
    let mut m = PointMoments::default();
    points.iter().for_each(|&p| m.add(p));
    m
}

/// A 10 cm patch of a sphere of radius `radius` (infinite: a plane) facing a random way.
fn patch(radius: f64, noise_m: f64, n: usize, draw: &mut Draw) -> (Vec<DVec3>, Vec<DVec3>) {
    let axis = DVec3::new(draw.normal(), draw.normal(), draw.normal()).normalize();
    let (u, v) = axis.any_orthonormal_pair();
    let at = DVec3::new(0.3, -0.2, 1.0);
    let mut seen = Vec::new();
    let mut truth = Vec::new();
    while seen.len() < n {
        let (s, t) = (0.1 * draw.uniform() - 0.05, 0.1 * draw.uniform() - 0.05);
        let rho2 = s * s + t * t;
        if rho2 > 0.9 * radius * radius {
            continue;
        }
        let sag = rho2 / (radius + (radius * radius - rho2).sqrt());
        let sag = if radius.is_finite() { sag } else { 0.0 };
        let p = at + u * s + v * t - axis * sag;
        let center = at - axis * radius;
        let outward = if radius.is_finite() {
            (p - center).normalize()
        } else {
            axis
        };
        truth.push(p);
        seen.push(p + outward * noise_m * draw.normal());
    }
    (seen, truth)
}

/// Geometric least squares by Gauss-Newton with damping on (κ, n, d), the slow obvious oracle.
fn geometric(points: &[DVec3], start: CloudSphere) -> CloudSphere {
    let mean = points.iter().sum::<DVec3>() / points.len() as f64;
    let cost = |s: &CloudSphere| {
        points
            .iter()
            .map(|&p| s.signed_distance(p - mean).powi(2))
            .sum::<f64>()
    };
    let mut best = start.translated(-mean);
    let mut lambda = 1e-3;
    for _ in 0..60 {
        let parameters = [
            best.curvature,
            best.normal.x,
            best.normal.y,
            best.normal.z,
            best.offset,
        ];
        let with = |k: usize, step: f64| {
            let mut v = parameters;
            v[k] += step;
            CloudSphere::normalised(v[0], DVec3::new(v[1], v[2], v[3]), v[4]).unwrap()
        };
        let steps = [1e-4, 1e-6, 1e-6, 1e-6, 1e-7];
        let (mut jtj, mut jtr) = ([[0.0; 5]; 5], [0.0; 5]);
        let plus: Vec<_> = (0..5).map(|k| with(k, steps[k])).collect();
        for &p in points {
            let r = best.signed_distance(p - mean);
            let j: Vec<f64> = (0..5)
                .map(|k| (plus[k].signed_distance(p - mean) - r) / steps[k])
                .collect();
            for a in 0..5 {
                jtr[a] += j[a] * r;
                for b in 0..5 {
                    jtj[a][b] += j[a] * j[b];
                }
            }
        }
        for (k, row) in jtj.iter_mut().enumerate() {
            row[k] *= 1.0 + lambda;
            row[k] += 1e-12;
        }
        let delta = solve(jtj, jtr);
        let mut v = parameters;
        for k in 0..5 {
            v[k] -= delta[k];
        }
        match CloudSphere::normalised(v[0], DVec3::new(v[1], v[2], v[3]), v[4]) {
            Some(next) if cost(&next) < cost(&best) => {
                best = next;
                lambda *= 0.3;
            }
            _ => lambda *= 10.0,
        }
    }
    best.translated(mean)
}

/// Gaussian elimination with pivoting.
fn solve(mut a: [[f64; 5]; 5], mut b: [f64; 5]) -> [f64; 5] {
    for k in 0..5 {
        let pivot = (k..5)
            .max_by(|&i, &j| a[i][k].abs().total_cmp(&a[j][k].abs()))
            .unwrap();
        a.swap(k, pivot);
        b.swap(k, pivot);
        for i in k + 1..5 {
            let f = a[i][k] / a[k][k];
            let pivot_row = a[k];
            for (v, p) in a[i].iter_mut().zip(pivot_row) {
                *v -= f * p;
            }
            b[i] -= f * b[k];
        }
    }
    let mut x = [0.0; 5];
    for k in (0..5).rev() {
        x[k] = (b[k] - (k + 1..5).map(|j| a[k][j] * x[j]).sum::<f64>()) / a[k][k];
    }
    x
}

fn rms(sphere: &CloudSphere, points: &[DVec3]) -> f64 {
    (points
        .iter()
        .map(|&p| sphere.distance(p).powi(2))
        .sum::<f64>()
        / points.len() as f64)
        .sqrt()
}

#[test]
fn as_good_as_the_geometric_fit_on_noisy_patches() {
    let mut draw = Draw(7);
    for radius in [0.05, 0.1, 0.3, 1.0, 10.0, 1000.0, f64::INFINITY] {
        let (mut ours, mut oracle) = (0.0, 0.0);
        for _ in 0..10 {
            let (seen, truth) = patch(radius, 0.003, 300, &mut draw);
            let fit = moments(&seen).fit().unwrap();
            ours += rms(&fit.sphere, &truth).powi(2);
            oracle += rms(&geometric(&seen, fit.sphere), &truth).powi(2);
            assert!(
                (fit.rms_m - rms(&fit.sphere, &seen)).abs() < 0.05 * fit.rms_m,
                "R {radius}"
            );
        }
        let (ours, oracle) = ((ours / 10.0).sqrt(), (oracle / 10.0).sqrt());
        assert!(
            ours < 1.25 * oracle + 2e-5,
            "R {radius}: RMS {ours:.6} m, geometric {oracle:.6} m"
        );
        assert!(ours < 0.0008, "R {radius}: RMS {ours:.6} m from the truth");
    }
}

#[test]
fn exact_on_exact_points() {
    let mut draw = Draw(3);
    for radius in [0.05, 0.5, 5.0, 1000.0] {
        let (_, truth) = patch(radius, 0.0, 50, &mut draw);
        let fit = moments(&truth).fit().unwrap();
        assert!(
            rms(&fit.sphere, &truth) < 1e-7,
            "R {radius}: {}",
            rms(&fit.sphere, &truth)
        );
    }
    // a closed sphere has no normal and no plane
    let center = DVec3::new(0.2, 0.1, -0.4);
    let ball: Vec<DVec3> = (0..200)
        .map(|_| center + 0.3 * DVec3::new(draw.normal(), draw.normal(), draw.normal()).normalize())
        .collect();
    let (c, r) = moments(&ball).fit().unwrap().sphere.center_radius();
    assert!((c - center).length() < 1e-9 && (r - 0.3).abs() < 1e-9);
}

#[test]
fn flat_patches_stay_flat() {
    let mut draw = Draw(11);
    let flat = (0..200)
        .filter(|_| {
            let (seen, _) = patch(f64::INFINITY, 0.003, 200, &mut draw);
            moments(&seen).fit().unwrap().sphere.curvature == 0.0
        })
        .count();
    assert!(flat >= 180, "{flat} of 200 flat patches were called flat");
}

#[test]
fn what_spans_no_surface_gives_none() {
    let at = |x: f64, y: f64| DVec3::new(1.0 + x, 2.0 + y, 3.0 + 2.0 * x);
    for n in 0..=4 {
        let few: Vec<DVec3> = (0..n).map(|i| at(f64::from(i), f64::from(i * i))).collect();
        assert!(moments(&few).fit().is_none(), "{n} points");
    }
    let line: Vec<DVec3> = (0..50).map(|i| at(f64::from(i) * 0.01, 0.0)).collect();
    assert!(moments(&line).fit().is_none());
    assert!(moments(&[at(0.3, 0.4); 50]).fit().is_none());
    let sheet: Vec<DVec3> = (0..50)
        .map(|i| at(f64::from(i % 7) * 0.01, f64::from(i / 7) * 0.01))
        .collect();
    let fit = moments(&sheet).fit().unwrap();
    assert_eq!(fit.sphere.curvature, 0.0);
    assert!(rms(&fit.sphere, &sheet) < 1e-8);
    // points on one circle lie on many spheres: the plane is the simplest
    let ring: Vec<DVec3> = (0..50)
        .map(f64::from)
        .map(|t| at(0.1 * t.cos(), 0.1 * t.sin()))
        .collect();
    assert!(rms(&moments(&ring).fit().unwrap().sphere, &ring) < 1e-7);
    let mut poisoned = moments(&sheet);
    poisoned.add(DVec3::NAN);
    assert!(poisoned.fit().is_none());
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]
    #[test]
    fn shift_and_merge_equal_a_direct_sum(
        points in proptest::collection::vec((-1f64..1.0, -1f64..1.0, -1f64..1.0), 2..40),
        (tx, ty, tz) in (-2f64..2.0, -2f64..2.0, -2f64..2.0), cut in 0usize..40,
    ) {
        let points: Vec<DVec3> = points.into_iter().map(|(x, y, z)| DVec3::new(x, y, z)).collect();
        let t = DVec3::new(tx, ty, tz);
        let cut = cut.min(points.len());
        let mut joined = moments(&points[..cut]);
        joined.merge(&moments(&points[cut..]));
        let shifted = joined.shifted(t);
        let direct = moments(&points.iter().map(|&p| p - t).collect::<Vec<_>>());
        let near = |a: DVec3, b: DVec3| (a - b).length() < 1e-10 * (1.0 + b.length());
        prop_assert!(near(shifted.first, direct.first) && near(shifted.square, direct.square));
        prop_assert!(near(shifted.cross, direct.cross) && near(shifted.third, direct.third));
        prop_assert!((shifted.fourth - direct.fourth).abs() < 1e-10 * (1.0 + direct.fourth));
    }
}
