//! What kind of depth camera is imitated, and the numbers of its noise.
//!
//! | | `kinect` | `stereo` | `tof` |
//! |---|---|---|---|
//! | imitates | Kinect v1, structured light | RealSense D435 | Azure Kinect, phase ToF |
//! | noise law | σ(1/z) = 1.15e-3 /m + steps: σ(z) ≈ 1.4e-3 z² | σ(1/z) = 2.4e-3 /m: σ(z) ≈ 2.4e-3 z² | σ(z) = 1 mm + 0.3e-3 z² |
//! | steps | 1/8 px of fB = 43.5 px·m: 2.9 mm at 1 m | 1/32 px of fB = 21.3 px·m: 1.5 mm at 1 m | none but the unit |
//! | correlated over | 5 px | 9 px | 3 px |
//! | speckle holes | 0.6 % | 2.5 % | 0.5 % |
//! | occlusion shadow | 75 mm baseline | 50 mm baseline, and a blind left border | none |
//! | at depth edges | ragged, some lost | ragged, some lost | flying pixels |
//! | range | 0.4–8 m | 0.2–10 m | 0.25–5.5 m |
//!
//! Sources. Kinect: Khoshelham and Oude Elberink, "Accuracy and resolution of Kinect depth data",
//! Sensors 2012 (σ = 1.425e-3 z², disparity step m/fb = 2.85e-3 /m); Nguyen, Izadi and Lovell,
//! "Modeling Kinect sensor noise", 3DIMPVT 2012 (0.8 px lateral noise at edges, no depth at
//! grazing angles). Stereo: depth error z²/(fB) times the sub-pixel error of 0.04–0.08 px, as in
//! Intel's tuning guide for the D400 series. ToF: Tölgyessy et al., "Evaluation of the Azure
//! Kinect", Sensors 2021 (1–3 mm up to 3.5 m, flying pixels at edges). Correlation lengths, the
//! share of noise that stays from frame to frame and the flicker of holes were set by comparison
//! with frames of real Kinect, D435 and D455 cameras.

/// The camera imitated.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum NoiseModel {
    /// Exact depth, rounded to the unit.
    Off,
    /// Structured light: Kinect v1.
    #[default]
    Kinect,
    /// Active stereo: RealSense D435.
    Stereo,
    /// Time of flight: Azure Kinect.
    Tof,
}

impl NoiseModel {
    /// All models by name.
    pub const ALL: [(Self, &'static str); 4] = [
        (Self::Off, "off"),
        (Self::Kinect, "kinect"),
        (Self::Stereo, "stereo"),
        (Self::Tof, "tof"),
    ];

    /// The model of that name.
    #[must_use]
    pub fn named(name: &str) -> Option<Self> {
        let found = Self::ALL.iter().find(|entry| entry.1 == name);
        found.map(|entry| entry.0)
    }

    /// Its numbers.
    #[must_use]
    pub fn sensor(self) -> Sensor {
        match self {
            Self::Off => IDEAL,
            Self::Kinect => Sensor {
                sigma_inverse_m: 1.15e-3,
                step_inverse_m: 1.0 / (8.0 * 43.5),
                window_px: 5,
                hole_level: 2.5,
                baseline_m: 0.075,
                range_m: (0.4, 8.0),
                ..IDEAL
            },
            Self::Stereo => Sensor {
                sigma_inverse_m: 2.4e-3,
                step_inverse_m: 1.0 / (32.0 * 21.3),
                window_px: 9,
                hole_level: 1.96,
                blind_border: true,
                baseline_m: 0.05,
                focal_per_width: 0.6,
                range_m: (0.2, 10.0),
                ..IDEAL
            },
            Self::Tof => Sensor {
                sigma_floor_m: 1.0e-3,
                sigma_growth_per_m: 0.3e-3,
                window_px: 3,
                hole_level: 2.6,
                focal_per_width: 0.79,
                range_m: (0.25, 5.5),
                flying_pixels: true,
                ..IDEAL
            },
        }
    }
}

/// A sensor without faults; the others are told by where they differ.
const IDEAL: Sensor = Sensor {
    sigma_inverse_m: 0.0,
    step_inverse_m: 0.0,
    sigma_floor_m: 0.0,
    sigma_growth_per_m: 0.0,
    window_px: 1,
    hole_level: f32::INFINITY,
    blind_border: false,
    baseline_m: 0.0,
    focal_per_width: 0.9,
    range_m: (0.0, f64::INFINITY),
    flying_pixels: false,
};

/// The numbers of a noise model.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sensor {
    /// Standard deviation of inverse depth before it is stepped, 1/m.
    pub sigma_inverse_m: f64,
    /// Step of inverse depth (one sub-pixel step of disparity), 1/m; 0 = none.
    pub step_inverse_m: f64,
    /// Standard deviation of depth at zero range, metres.
    pub sigma_floor_m: f64,
    /// Growth of that standard deviation with z², 1/m.
    pub sigma_growth_per_m: f64,
    /// Side of the square over which noise is correlated, pixels.
    pub window_px: usize,
    /// A pixel is lost where the hole field is above this many standard deviations.
    pub hole_level: f32,
    /// True where the second camera's image ends like the first one's, so that the left border
    /// has nothing to match.
    pub blind_border: bool,
    /// Distance of the second camera or the projector, metres; 0 = none, no shadow.
    pub baseline_m: f64,
    /// Focal length over image width.
    pub focal_per_width: f64,
    /// Least and greatest depth measured, metres.
    pub range_m: (f64, f64),
    /// True where an edge gives depths between its two sides.
    pub flying_pixels: bool,
}

impl Sensor {
    /// Standard deviation of the depth of a flat, frontal surface at `z_m` metres, metres: noise,
    /// disparity steps (a step s is a uniform error of s/√12) and rounding to `unit_m` together.
    #[must_use]
    pub fn sigma_m(&self, z_m: f64, unit_m: f64) -> f64 {
        let inverse = self
            .sigma_inverse_m
            .hypot(self.step_inverse_m / 12.0_f64.sqrt());
        let depth = self.sigma_floor_m + self.sigma_growth_per_m * z_m * z_m;
        (inverse * z_m * z_m)
            .hypot(depth)
            .hypot(unit_m / 12.0_f64.sqrt())
    }
}
