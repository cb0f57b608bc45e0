//! One colour per sphere, the same in every frame and every run (the paper's Fig. 7).
//!
//! The hue of sphere `i` is `i` golden angles round the colour circle: no two numbers share a
//! hue (before it is rounded to bytes), and neighbours in number (often neighbours in the scene) are far apart. Saturation and
//! brightness go through three steps, so that hues that come close differ there.

/// Red, green, blue.
pub type Rgb = [u8; 3];

/// Colour of a measured pixel without a sphere.
pub const NO_SPHERE_COLOR: Rgb = [128, 128, 128];
/// The golden angle as a fraction of the circle, times 2³²: (3 − √5)/2.
const GOLDEN: u32 = 1_640_531_527;

/// The colour of a sphere, or of a pixel without one.
#[must_use]
pub fn of_sphere(sphere: Option<u16>) -> Rgb {
    let Some(number) = sphere else {
        return NO_SPHERE_COLOR;
    };
    // wrapping multiplication is the turn's fraction, exactly
    let turn = u32::from(number).wrapping_mul(GOLDEN);
    let hue = f64::from(turn) / f64::from(u32::MAX) * 6.0;
    let (saturation, value) = [(0.85, 0.95), (0.60, 1.0), (0.90, 0.75)][usize::from(number % 3)];
    // Smith 1978: a hexcone's sector from its distance to the channel's own hue
    let channel = |offset: f64| {
        let k = (offset + hue) % 6.0;
        value - value * saturation * k.min(4.0 - k).clamp(0.0, 1.0)
    };
    [5.0, 3.0, 1.0].map(|offset| (channel(offset) * 255.0).round() as u8)
}

/// Nearest and farthest depth of the shading, metres: fixed, so that a film does not flicker.
const SHADE_NEAR_M: f32 = 0.3;
const SHADE_FAR_M: f32 = 10.0;
/// Brightness that is left at the far end.
const SHADE_LEFT: f32 = 0.35;

/// The colour darkened with depth (metres), in equal steps per doubling of the distance.
#[must_use]
pub fn shaded(color: Rgb, depth_m: f32) -> Rgb {
    let far = (depth_m / SHADE_NEAR_M).ln() / (SHADE_FAR_M / SHADE_NEAR_M).ln();
    let light = 1.0 - (1.0 - SHADE_LEFT) * far.clamp(0.0, 1.0);
    color.map(|c| (f32::from(c) * light).round() as u8)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    #[test]
    fn colours_stay_what_they_are() {
        // golden values: files and films of different versions must look alike
        let colors = [0, 1, 2, 3, 1499].map(|n| of_sphere(Some(n)));
        let expected = [
            [242, 36, 36],
            [102, 255, 147],
            [120, 19, 191],
            [242, 217, 36],
            [19, 122, 191],
        ];
        assert_eq!(colors, expected);
        assert_eq!(of_sphere(None), NO_SPHERE_COLOR);
    }

    #[test]
    fn spheres_are_told_apart() {
        let colors: BTreeSet<_> = (0..1500).map(|n| of_sphere(Some(n))).collect();
        assert!(
            colors.len() > 1200,
            "{} colours for 1500 spheres",
            colors.len()
        );
        for n in 0..1000u16 {
            let (a, b) = (of_sphere(Some(n)), of_sphere(Some(n + 1)));
            let apart: u32 = (0..3).map(|c| u32::from(a[c].abs_diff(b[c]))).sum();
            assert!(apart > 100, "{n} and {}: {a:?} {b:?}", n + 1);
        }
    }

    #[test]
    fn shade_falls_with_depth_and_keeps_some_light() {
        let mut last = 256;
        for depth in [0.1f32, 0.3, 0.6, 1.2, 2.4, 4.8, 9.6, 100.0] {
            let light = i32::from(shaded([255; 3], depth)[0]);
            assert!(
                light <= last && light >= 89,
                "{light} at {depth} m after {last}"
            );
            last = light;
        }
    }
}
