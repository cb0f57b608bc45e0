//! What to imitate: `synthetic:SCENE[,key=value,...]` as typed options.

use super::scene::Scene;
use super::sensor::NoiseModel;
use super::surface::Pose;
use crate::capture::CaptureError;
use glam::{DQuat, DVec3};
use std::fmt::Display;
use std::str::FromStr;

/// Largest image, pixels: 16 megapixels.
const MAX_PIXELS: u64 = 1 << 24;
/// Largest memory for frames rendered ahead, bytes.
const MAX_PRERENDER_BYTES: u64 = 1 << 30;

/// How the synthetic sensor behaves.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SyntheticOptions {
    /// What it looks at.
    pub scene: Scene,
    /// Image width, pixels.
    pub width: u32,
    /// Image height, pixels.
    pub height: u32,
    /// Nominal frame rate, frames per second; motion follows it.
    pub fps: f64,
    /// Everything random follows from it.
    pub seed: u64,
    /// The camera imitated.
    pub noise: NoiseModel,
    /// Frames before the stream ends; endless when `None`.
    pub frames: Option<u64>,
    /// Metres per depth integer.
    pub unit_m: f64,
    /// Frames come this many times as fast as `fps` says (overload).
    pub speed: f64,
    /// Another view every so many frames; 0 = never.
    pub cut: u64,
    /// Every second run of so many frames is pure noise; 0 = never.
    pub burst: u64,
    /// Silent for a second after every so many frames; 0 = never.
    pub stall: u64,
    /// The camera is unplugged for a second after every so many frames; 0 = never.
    pub unplug: u64,
    /// Every so many frames one is lost by the sensor; 0 = none.
    pub gap: u64,
    /// Every so many frames one arrives damaged and is skipped; 0 = none.
    pub damage: u64,
    /// Where the camera stands in the scene, metres (the usual place is the origin).
    pub at: [f64; 3],
    /// How far it is turned to the right and up, degrees.
    pub turn: [f64; 2],
    /// Frames rendered when the source is opened and then repeated for ever; 0 = render as they
    /// come. For sizes and rates this machine cannot render in time.
    pub prerender: u32,
    /// True: a camera that does not wait. False: frames as fast as they are asked for.
    pub paced: bool,
}

/// What goes wrong with a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Fault {
    Lost,
    Damaged,
}

/// Keys of the text form, with what they take.
const KEYS: [(&str, &str); 20] = [
    ("width", "pixels"),
    ("height", "pixels"),
    ("size", "WIDTHxHEIGHT"),
    ("fps", "frames per second"),
    ("seed", "number"),
    ("noise", "off|kinect|stereo|tof"),
    ("frames", "frames before the end"),
    ("unit", "metres per integer"),
    ("speed", "times the nominal rate"),
    ("cut", "frames per view"),
    ("burst", "frames per burst"),
    ("stall", "frames between stalls"),
    ("unplug", "frames between unplugs"),
    ("gap", "frames to a lost one"),
    ("damage", "frames to a damaged one"),
    ("at", "X/Y/Z metres"),
    ("yaw", "degrees to the right"),
    ("pitch", "degrees up"),
    ("prerender", "frames"),
    ("paced", "true|false"),
];

impl SyntheticOptions {
    /// VGA at 30 frames per second, Kinect noise, paced.
    #[must_use]
    pub fn new(scene: Scene) -> Self {
        Self {
            scene,
            width: 640,
            height: 480,
            fps: 30.0,
            seed: 1,
            noise: match scene {
                Scene::Checkerboard => NoiseModel::Off,
                _ => NoiseModel::Kinect,
            },
            frames: None,
            unit_m: 0.001,
            speed: 1.0,
            cut: if scene == Scene::Cut { 30 } else { 0 },
            burst: if scene == Scene::Noise { 15 } else { 0 },
            stall: if scene == Scene::Stall { 60 } else { 0 },
            unplug: 0,
            gap: 0,
            damage: 0,
            at: [0.0; 3],
            turn: [0.0; 2],
            prerender: 0,
            paced: true,
        }
    }

    /// The same, unpaced: for tests, benches and generation.
    #[must_use]
    pub fn unpaced(scene: Scene) -> Self {
        Self {
            paced: false,
            ..Self::new(scene)
        }
    }

    /// Reads `SCENE[,key=value,...]`, with or without `synthetic:` before it. No scene at all
    /// means `juggle`.
    ///
    /// # Errors
    /// [`CaptureError::Usage`] naming what is unknown or out of range, and what exists.
    pub fn parse(text: &str) -> Result<Self, CaptureError> {
        let text = text.strip_prefix("synthetic:").unwrap_or(text);
        let mut parts = text.split(',');
        let name = match parts.next().unwrap_or_default() {
            "" | "synthetic" => Scene::Juggle.name(),
            name => name,
        };
        let scene = Scene::named(name).ok_or_else(|| unknown_scene(name))?;
        let mut options = Self::new(scene);
        for part in parts {
            let (key, value) = part.split_once('=').ok_or_else(|| {
                CaptureError::Usage(format!("`{part}` is not key=value; {}", known_keys()))
            })?;
            options.set(key, value)?;
        }
        options.validated()
    }

    /// Where the camera stands: its frame to the scene's.
    #[must_use]
    pub fn placement(&self) -> Pose {
        let [yaw, pitch] = self.turn.map(f64::to_radians);
        Pose {
            rotation: DQuat::from_rotation_y(yaw) * DQuat::from_rotation_x(pitch),
            position: DVec3::from_array(self.at),
        }
    }

    /// What becomes of a frame before anybody can read it.
    pub(super) fn fault(&self, index: u64) -> Option<Fault> {
        let is_due = |every: u64| every > 0 && (index + 1).is_multiple_of(every);
        if is_due(self.gap) {
            Some(Fault::Lost)
        } else {
            is_due(self.damage).then_some(Fault::Damaged)
        }
    }

    fn set(&mut self, key: &str, value: &str) -> Result<(), CaptureError> {
        match key {
            "width" => self.width = number(key, value)?,
            "height" => self.height = number(key, value)?,
            "size" => {
                let (width, height) = value.split_once('x').ok_or_else(|| {
                    CaptureError::Usage(format!("size is WIDTHxHEIGHT, not `{value}`"))
                })?;
                self.width = number(key, width)?;
                self.height = number(key, height)?;
            }
            "fps" => self.fps = number(key, value)?,
            "seed" => self.seed = number(key, value)?,
            "noise" => {
                self.noise = NoiseModel::named(value).ok_or_else(|| {
                    let known = NoiseModel::ALL.map(|entry| entry.1).join(", ");
                    CaptureError::Usage(format!("no noise model `{value}`; there are {known}"))
                })?;
            }
            "frames" => self.frames = Some(number(key, value)?),
            "unit" => self.unit_m = number(key, value)?,
            "speed" => self.speed = number(key, value)?,
            "cut" => self.cut = number(key, value)?,
            "burst" => self.burst = number(key, value)?,
            "stall" => self.stall = number(key, value)?,
            "unplug" => self.unplug = number(key, value)?,
            "gap" => self.gap = number(key, value)?,
            "damage" => self.damage = number(key, value)?,
            "at" => {
                let place: Vec<f64> = value
                    .split('/')
                    .map(|part| number(key, part))
                    .collect::<Result<_, _>>()?;
                self.at = place.try_into().map_err(|_| {
                    CaptureError::Usage(format!("at is X/Y/Z in metres, not `{value}`"))
                })?;
            }
            "yaw" => self.turn[0] = number(key, value)?,
            "pitch" => self.turn[1] = number(key, value)?,
            "prerender" => self.prerender = number(key, value)?,
            "paced" => self.paced = number(key, value)?,
            _ => {
                return Err(CaptureError::Usage(format!(
                    "the synthetic sensor has no `{key}`; {}",
                    known_keys()
                )));
            }
        }
        Ok(())
    }

    /// The options, if all numbers are in range.
    ///
    /// # Errors
    /// [`CaptureError::Usage`] naming the number and its range.
    pub fn validated(self) -> Result<Self, CaptureError> {
        let pixels = u64::from(self.width) * u64::from(self.height);
        if pixels == 0 || pixels > MAX_PIXELS || self.width > 16384 || self.height > 16384 {
            return Err(CaptureError::Usage(format!(
                "size {}x{} is out of range: 1x1 to {MAX_PIXELS} pixels, sides up to 16384",
                self.width, self.height
            )));
        }
        in_range("fps", self.fps, 0.01, 10_000.0)?;
        in_range("unit", self.unit_m, 1e-6, 0.1)?;
        in_range("speed", self.speed, 0.01, 100.0)?;
        for value in self.at {
            in_range("at", value, -100.0, 100.0)?;
        }
        in_range("yaw", self.turn[0], -360.0, 360.0)?;
        in_range("pitch", self.turn[1], -90.0, 90.0)?;
        let ahead = u64::from(self.prerender) * pixels * 2;
        if ahead > MAX_PRERENDER_BYTES {
            return Err(CaptureError::Usage(format!(
                "prerender={} needs {ahead} bytes, at most {MAX_PRERENDER_BYTES}; ask for fewer",
                self.prerender
            )));
        }
        Ok(self)
    }
}

fn in_range(key: &str, value: f64, least: f64, most: f64) -> Result<(), CaptureError> {
    if (least..=most).contains(&value) {
        return Ok(());
    }
    Err(CaptureError::Usage(format!(
        "{key}={value} is out of range: {least} to {most}"
    )))
}

fn number<T: FromStr<Err: Display>>(key: &str, value: &str) -> Result<T, CaptureError> {
    value
        .parse()
        .map_err(|error: T::Err| CaptureError::Usage(format!("{key}={value}: {error}")))
}

fn unknown_scene(name: &str) -> CaptureError {
    let mut text = format!("no scene `{name}`; there are");
    for (_, name, about) in Scene::ALL {
        text.push_str(&format!("\n  {name:<13}{about}"));
    }
    CaptureError::Usage(text)
}

fn known_keys() -> String {
    let keys = KEYS.map(|(key, takes)| format!("{key}={takes}"));
    format!("keys are {}", keys.join(", "))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_text_form_sets_every_option() {
        let parsed = SyntheticOptions::parse(
            "synthetic:walk,width=848,height=480,fps=90,seed=7,noise=stereo,frames=100,unit=0.0001,\
         speed=2,cut=9,burst=8,stall=7,unplug=40,gap=11,damage=13,at=1.5/0/-2,yaw=-30,pitch=5,prerender=6,paced=false",
        );
        let expected = SyntheticOptions {
            scene: Scene::Walk,
            width: 848,
            height: 480,
            fps: 90.0,
            seed: 7,
            noise: NoiseModel::Stereo,
            frames: Some(100),
            unit_m: 0.0001,
            speed: 2.0,
            cut: 9,
            burst: 8,
            stall: 7,
            unplug: 40,
            gap: 11,
            damage: 13,
            at: [1.5, 0.0, -2.0],
            turn: [-30.0, 5.0],
            prerender: 6,
            paced: false,
        };
        assert_eq!(parsed.expect("parsed"), expected);
        for (scene, name, _) in Scene::ALL {
            let parsed = SyntheticOptions::parse(name).expect("a scene");
            assert_eq!((parsed.scene, scene.name()), (scene, name));
        }
        let default = SyntheticOptions::parse("synthetic:").expect("default");
        assert_eq!(default.scene, Scene::Juggle);
    }

    #[test]
    fn wrong_text_is_named_with_what_exists() {
        for (text, says) in [
            ("hall", "checkerboard"),
            ("room,colour=1", "keys are width=pixels"),
            ("room,noise=lidar", "kinect, stereo, tof"),
            ("room,width", "not key=value"),
            ("room,width=-3", "width=-3"),
            ("room,width=0", "0x480"),
            ("room,width=100000", "out of range"),
            ("room,size=3", "WIDTHxHEIGHT"),
            ("room,fps=nan", "fps=NaN is out of range"),
            ("room,unit=0", "unit=0 is out of range"),
            ("room,speed=1e9", "out of range"),
            ("room,prerender=4000000", "bytes"),
            ("room,at=1/2", "X/Y/Z"),
            ("room,at=1/2/nan", "at=NaN is out of range"),
            ("room,pitch=91", "-90 to 90"),
        ] {
            match SyntheticOptions::parse(text) {
                Err(CaptureError::Usage(message)) => {
                    assert!(message.contains(says), "{text}: {message}");
                }
                other => panic!("{text}: {other:?}"),
            }
        }
    }
}
