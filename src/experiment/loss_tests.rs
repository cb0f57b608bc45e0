use super::*;

/// Pixels whose depth is exactly their plane's guess, on spheres that say the same.
fn set(seed: u64) -> Set {
    let mut chance = Chance::new(seed);
    let mut set = Set::default();
    for i in 0..400 {
        let z = 1.0 + chance.unit();
        let mut guess = || z + 0.05 * chance.normal();
        let (base, mut guesses) = (guess(), [0.0; GUESSES]);
        guesses.iter_mut().for_each(|g| *g = guess());
        guesses[GUESSES - 1] = z;
        let ray = DVec3::new(chance.unit() - 0.5, chance.unit() - 0.5, 1.0);
        // a sphere of 1 m about the foot of each pixel, seen straight on
        set.spheres.push(Ball {
            center: ray * z + ray.normalize(),
            radius: 1.0,
        });
        set.pixels.push(Pixel {
            ray,
            base,
            guesses,
            measured: z,
            truth: None,
            // every fourth pixel is on no sphere
            owner: if i % 4 == 0 { UNASSIGNED } else { i },
        });
    }
    set
}

/// The goal itself, written out.
fn goal_value(set: &Set, weights: &[f64; WEIGHTS], goal: Goal) -> f64 {
    let off = |p: &Pixel| (p.predict(weights) - p.measured).abs();
    let all = set.pixels.iter().map(off).sum::<f64>() / set.pixels.len() as f64;
    let covered: Vec<&Pixel> = set
        .pixels
        .iter()
        .filter(|p| p.owner != UNASSIGNED)
        .collect();
    let n = covered.len() as f64;
    let mask = covered.iter().map(|p| off(p)).sum::<f64>() / n;
    let distance = |p: &&Pixel| {
        let ball = set.spheres[p.owner as usize];
        ((p.ray * p.predict(weights)).distance(ball.center) - ball.radius).abs()
    };
    let saint = covered.iter().map(distance).sum::<f64>() / n;
    match goal {
        Goal::L1 => all,
        Goal::L1AndSaint => all + saint,
        Goal::L1AndMask => all + mask,
        Goal::Saint => saint,
        Goal::Mask => mask,
    }
}

#[test]
fn slopes_are_those_of_each_goal() {
    let set = set(1);
    let weights = [0.1, -0.2, 0.05, 0.15, -0.1, 0.3, 0.01];
    let mut gradient = LossGradient::default();
    for (goal, name) in GOALS {
        let found = slopes(&set.pixels, &set.spheres, &weights, goal, &mut gradient);
        for k in 0..WEIGHTS {
            let at = |step: f64| {
                let mut moved = weights;
                moved[k] += step;
                goal_value(&set, &moved, goal)
            };
            let truth = (at(1e-7) - at(-1e-7)) / 2e-7;
            assert!(
                (found[k] - truth).abs() < 1e-5,
                "{name}, weight {k}: {} {truth}",
                found[k]
            );
        }
    }
}

#[test]
fn the_right_guess_is_found_with_every_goal() {
    let (train, test) = (set(1), set(2));
    for (goal, name) in GOALS {
        let scores = descend(&train, &test, goal, 3);
        let (first, last) = (scores[0].1.rmse, scores[scores.len() - 1].1.rmse);
        assert!(last < 0.2 * first, "{name}: {first} to {last}");
    }
}

#[test]
fn a_plane_is_continued_in_inverse_depth() {
    // 1/z = 0.5 + 0.02 x - 0.03 y about the pixel
    let at = |x: f64, y: f64| (x, y, 1.0 / (0.5 + 0.02 * x - 0.03 * y));
    let near: Vec<_> = [
        (-0.5, -1.0),
        (0.5, -1.0),
        (-0.5, 0.3),
        (1.5, 0.3),
        (0.5, 1.0),
    ]
    .map(|(x, y)| at(x, y))
    .to_vec();
    let z = plane_at_zero(&near).unwrap();
    assert!((z - 2.0).abs() < 1e-12, "{z}");
    assert!(plane_at_zero(&near[..3]).is_none());
}
