//! Small frames that are hard on a fit and a codec, and the checks both must pass.

#![allow(dead_code, reason = "each test uses a part of it")]

use saint_live::codec::{CodecOptions, DecodedFrame, Tolerance};
use saint_live::deproject::{Rays, Validity};
use saint_live::fit::contact_distance::ContactDistance;
use saint_live::frame::{Camera, DepthFrame, FrameTime, Intrinsics};

/// A camera of this size with a lens to match, millimetres, 0 and 7777 invalid.
pub fn camera(width: u32, height: u32) -> Camera {
    let (w, h) = (f64::from(width), f64::from(height));
    Camera {
        width,
        height,
        intrinsics: Intrinsics {
            fx: 0.85 * w.max(h),
            fy: 0.86 * w.max(h),
            cx: 0.5 * w - 0.3,
            cy: 0.5 * h - 0.7,
        },
        depth_unit_m: 0.001,
        invalid: vec![0, 7777],
        depth_min_m: 0.0,
        depth_max_m: 66.0,
        fps: Some(30.0),
        name: "test".to_owned(),
    }
}

/// Numbers that look random and are the same each time (splitmix64).
pub struct Chance(pub u64);

impl Chance {
    pub fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ z >> 30).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ z >> 27).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ z >> 31
    }

    pub fn below(&mut self, n: u64) -> u64 {
        self.next() % n
    }
}

/// What a frame shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Picture {
    Invalid,
    OnePixel,
    Checkerboard,
    Largest,
    Smallest,
    Noise,
    NoisySlope,
    BallsAndHoles,
}

pub const PICTURES: [Picture; 8] = [
    Picture::Invalid,
    Picture::OnePixel,
    Picture::Checkerboard,
    Picture::Largest,
    Picture::Smallest,
    Picture::Noise,
    Picture::NoisySlope,
    Picture::BallsAndHoles,
];

/// Frame `number` of a picture; frames differ by their noise and a slow motion.
pub fn draw(camera: &Camera, picture: Picture, number: u64, seed: u64) -> DepthFrame {
    let mut chance = Chance(seed ^ number << 32);
    let (w, h) = (u64::from(camera.width), u64::from(camera.height));
    let mut depth = Vec::new();
    for i in 0..w * h {
        let (x, y) = (i % w, i / w);
        depth.push(match picture {
            Picture::Invalid => [0, 7777][chance.below(2) as usize],
            Picture::OnePixel => 1234 * u16::from(i == (w * h / 2 + number) % (w * h)),
            Picture::Checkerboard => 1000 + 1000 * ((x + y + number) % 2) as u16,
            Picture::Largest => 65535,
            Picture::Smallest => 1,
            Picture::Noise => chance.next() as u16,
            Picture::NoisySlope => {
                let noise = chance.below(9);
                (900 + 3 * x + 5 * y + noise + number) as u16
            }
            Picture::BallsAndHoles => {
                let (dx, dy) = (x as f64 - 0.4 * w as f64, y as f64 - 0.5 * h as f64);
                let left = 0.1 * (w * w) as f64 - dx * dx - dy * dy;
                let noise = chance.below(5);
                match chance.below(20) {
                    0 => 0,
                    1 => 60_000 + noise as u16,
                    _ if left > 0.0 => (1500.0 - 4.0 * left.sqrt()) as u16 + noise as u16,
                    _ => (2000 + x + number) as u16 + noise as u16,
                }
            }
        });
    }
    DepthFrame {
        sequence: 10 + 2 * number,
        time: FrameTime {
            device_ns: number as i64 * 33_333_333,
            wall_ns: -5,
        },
        depth,
    }
}

pub fn options(contact: ContactDistance, lossless: bool, keyframe_every: u32) -> CodecOptions {
    CodecOptions {
        keyframe_every,
        tolerance: Tolerance { contact, lossless },
        contact,
        smooth_mask: false,
        effort: saint_live::codec::Effort::Live,
    }
}

/// Mask kept exactly, every measurement within its bound along its ray, or exactly where lossless.
#[track_caller]
pub fn check(
    what: &str,
    camera: &Camera,
    frame: &DepthFrame,
    decoded: &DecodedFrame,
    with: &Tolerance,
) {
    let (rays, validity) = (Rays::new(camera), Validity::new(camera));
    assert_eq!(decoded.sequence, frame.sequence, "{what}");
    assert_eq!(decoded.time, frame.time, "{what}");
    assert_eq!(decoded.depth_m.len(), frame.depth.len(), "{what}");
    for (pixel, (&raw, &back)) in frame.depth.iter().zip(&decoded.depth_m).enumerate() {
        let (x, y) = (pixel % rays.width, pixel / rays.width);
        assert_eq!(
            back > 0.0 && back.is_finite(),
            validity.accepts(raw),
            "{what}: mask at ({x}, {y}): {raw} came back as {back} m"
        );
        if back == 0.0 {
            continue;
        }
        let z = f64::from(raw) * camera.depth_unit_m;
        if with.lossless {
            assert_eq!(back, z as f32, "{what}: ({x}, {y})");
            continue;
        }
        let error = (z - f64::from(back)).abs() * rays.point(x, y, 1.0).length();
        let bound = with.contact.at(z);
        // single precision of the depth itself
        assert!(
            error <= bound + 1e-6 * z.max(1.0),
            "{what}: ({x}, {y}) is {error} m off, at most {bound}; {z} m came back as {back}"
        );
    }
}
