//! Frames at the edges of what the payload can say.

#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

mod frames;

use frames::{camera, options};
use glam::Vec3;
use saint_live::codec::{Decoder, EncodedFrame, Encoder};
use saint_live::contact_map::labels::{Contacts, SaintFrame};
use saint_live::fit::contact_distance::ContactDistance;
use saint_live::fit::motion::Motion;
use saint_live::fit::sphere::Sphere;
use saint_live::frame::{DepthFrame, FrameTime};

/// The plane z = `1/w`.
fn wall(w: f32) -> Option<Sphere> {
    Some(Sphere {
        a: 0.0,
        m: Vec3::new(0.0, 0.0, w),
        far: false,
    })
}

/// A section that ends in thousands of sure bits is mostly zeros past its end.
#[test]
fn a_large_image_without_a_hole_decodes() {
    let camera = camera(2048, 2048);
    let with = options(ContactDistance::default(), false, 2);
    let mut encoder = Encoder::new(&camera, with).unwrap();
    let mut decoder = Decoder::new();
    let mut encoded = EncodedFrame::default();
    let saint = SaintFrame {
        spheres: vec![wall(0.5)],
        contacts: Contacts::Labels(vec![0; camera.pixels()]),
        motion: Motion::default(),
    };
    for sequence in 0..2 {
        let frame = DepthFrame {
            sequence,
            time: FrameTime::default(),
            depth: vec![2000; camera.pixels()],
        };
        encoder.encode(&frame, &saint, false, &mut encoded).unwrap();
        let decoded = decoder.decode(&encoded.payload).unwrap();
        assert!(decoded.depth_m.iter().all(|d| (d - 2.0).abs() < 1e-3));
    }
}

/// A motion that takes a sphere through the camera leaves its number in use for both sides.
#[test]
fn a_sphere_lost_to_the_motion_is_stated_again() {
    let camera = camera(64, 8);
    let with = options(ContactDistance::default(), false, 30);
    let mut encoder = Encoder::new(&camera, with).unwrap();
    let mut decoder = Decoder::new();
    let mut encoded = EncodedFrame::default();
    // the middle sphere, at 1 m, ends at z = 0
    let shots = [
        ([1.0f32, 1.0, 0.5], Motion::default(), [1000u16, 1000, 2000]),
        (
            [0.25, 0.125, 1.0],
            Motion {
                turn: [0; 3],
                shift: [0, 0, -16384],
            },
            [4000, 8000, 1000],
        ),
    ];
    for (sequence, (walls, motion, depths)) in (0u64..).zip(shots) {
        // in the second frame the first two spheres change places with the last
        let order: [usize; 8] = if sequence == 0 {
            [0, 1, 2, 2, 2, 2, 2, 2]
        } else {
            [2, 2, 2, 2, 2, 2, 1, 0]
        };
        let label = |i: usize| order[i % 64 / 8];
        let saint = SaintFrame {
            spheres: walls.map(wall).to_vec(),
            contacts: Contacts::Labels((0..64 * 8).map(|i| label(i) as u16).collect()),
            motion,
        };
        let frame = DepthFrame {
            sequence,
            time: FrameTime::default(),
            depth: (0..64 * 8).map(|i| depths[label(i)]).collect(),
        };
        encoder.encode(&frame, &saint, false, &mut encoded).unwrap();
        let decoded = decoder.decode(&encoded.payload).unwrap();
        for (i, (&raw, &back)) in frame.depth.iter().zip(&decoded.depth_m).enumerate() {
            let error = f64::from(back) - f64::from(raw) * 1e-3;
            assert!(
                error.abs() < 0.01,
                "frame {sequence} pixel {i}: {raw} mm, {back} m"
            );
        }
    }
}
