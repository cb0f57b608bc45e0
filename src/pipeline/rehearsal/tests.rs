//! Rehearsed and not: the same bytes; and made-up frames that are worth a rehearsal.

use super::*;
use crate::capture::FrameSource;
use crate::capture::synthetic::{Scene, SyntheticOptions, SyntheticSource};
use crate::codec::{CodecOptions, EncodedFrame, Encoder};
use crate::contact_map::labels::SaintFrame;
use crate::fit::contact_distance::ContactDistance;
use crate::fit::live::{FitOptions, Modeler};
use crate::frame::Intrinsics;
use crate::pipeline::budget::Budget;
use crate::pipeline::clock::fake::FakeClock;
use crate::pipeline::{Options, Pace, Priority};
use std::sync::atomic::AtomicBool;

fn options() -> Options {
    Options {
        threads: 1,
        stage_threads: 1,
        priority: Priority::Usual,
        pace: Pace::Live,
        budget: Budget::UNLIMITED,
        frames: None,
        duration: None,
    }
}

/// Payloads of a few frames of a scene that moves, some of them coded plainly.
fn payloads(
    source: &mut SyntheticSource,
    model: &mut Modeler,
    encode: &mut Encoder,
) -> Vec<Vec<u8>> {
    let (mut frame, mut saint) = (DepthFrame::default(), SaintFrame::default());
    let mut encoded = EncodedFrame::default();
    (0..6)
        .map(|n| {
            source.render(n, &mut frame.depth);
            frame.sequence = n;
            let mut report = Model::model(model, &frame, &mut saint, &|| false).unwrap();
            report.hurried = n == 3;
            Encode::encode(encode, &frame, &saint, &report, &mut encoded).unwrap();
            encoded.payload.clone()
        })
        .collect()
}

#[test]
fn a_rehearsed_stream_is_the_same_to_the_byte() {
    let fit = FitOptions::default();
    let usual = CodecOptions::fitted(fit.contact_distance, 4);
    let (mut lossless, mut smooth, mut tight) = (usual, usual, usual);
    lossless.tolerance.lossless = true;
    smooth.smooth_mask = true;
    tight.tolerance.contact = ContactDistance::constant(0.002);
    for (name, codec) in [
        ("usual", usual),
        ("lossless", lossless),
        ("smooth", smooth),
        ("tight", tight),
    ] {
        let scene = SyntheticOptions {
            width: 160,
            height: 120,
            ..SyntheticOptions::unpaced(Scene::Juggle)
        };
        let mut source = SyntheticSource::open(scene).unwrap();
        let camera = source.camera().clone();
        let stages = || {
            let encoder = Encoder::new(&camera, codec).unwrap();
            (Modeler::new(&camera, &fit), encoder)
        };
        let (mut model, mut encode) = stages();
        let without = payloads(&mut source, &mut model, &mut encode);

        let (mut model, mut encode) = stages();
        let rehearsal = Rehearsal::of(&camera, &mut model, &mut encode, None).unwrap();
        let (clock, stop) = (FakeClock::default(), AtomicBool::new(false));
        let shared = Shared::new(&clock, &stop, &options(), None);
        let mut packet = Packet::default();
        rehearsal.alone(&mut model, &mut encode, &mut packet, &shared);
        assert_eq!(packet.act, Some(Act::Plain), "all acts were played");
        assert!(packet.encoded.payload.len() > 1000, "and coded");
        assert!(shared.take_failure().is_none());
        let with = payloads(&mut source, &mut model, &mut encode);
        for (n, (a, b)) in without.iter().zip(&with).enumerate() {
            assert!(a == b, "{name}: frame {n} differs after a rehearsal");
        }
        // what is compared depends on the frames before: without starting over it does differ
        let again = payloads(&mut source, &mut model, &mut encode);
        assert!(again != without, "{name}: nothing is remembered");
    }
}

fn camera(width: u32, height: u32) -> Camera {
    Camera {
        width,
        height,
        intrinsics: Intrinsics {
            fx: f64::from(width),
            fy: f64::from(width),
            cx: f64::from(width) / 2.0,
            cy: f64::from(height) / 2.0,
        },
        depth_unit_m: 0.001,
        invalid: vec![0],
        depth_min_m: 0.2,
        depth_max_m: 8.0,
        fps: Some(30.0),
        name: "made up".into(),
    }
}

#[test]
fn made_up_frames_are_work_for_every_stage() {
    let camera = camera(320, 240);
    let mut frame = DepthFrame::default();
    scene(&camera, 0, &mut frame);
    let measured = frame.depth.iter().filter(|&&raw| raw != 0).count();
    assert!(measured * 10 > camera.pixels() * 9, "{measured} measured");
    assert!(measured < camera.pixels(), "no holes");
    let mut model = Modeler::new(&camera, &FitOptions::default());
    let mut saint = SaintFrame::default();
    let report = model.model(&frame, &mut saint, &|| false);
    assert!(report.spheres >= 20, "{report:?}");
    assert!(report.explained_pixels < report.valid_pixels, "{report:?}");
    assert!(
        report.explained_pixels * 10 > report.valid_pixels * 9,
        "{report:?}"
    );
    let first = frame.depth.clone();
    scene(&camera, 1, &mut frame);
    assert!(frame.depth != first, "nothing moves");
}

#[test]
fn any_camera_can_be_rehearsed() {
    for (width, height) in [(1, 1), (1, 9), (9, 1), (17, 5)] {
        for (unit, min, max) in [
            (0.001, 0.0, 65.0),
            (1e-4, 0.0, 6.5),
            (0.25, 3.0, 3.1),
            (0.001, 100.0, 200.0),
            (1e-9, 0.0, 1e-6),
        ] {
            let camera = Camera {
                depth_unit_m: unit,
                depth_min_m: min,
                depth_max_m: max,
                invalid: vec![0, 700, 65535],
                ..camera(width, height)
            };
            let mut frame = DepthFrame::default();
            scene(&camera, 2, &mut frame);
            assert_eq!(frame.depth.len(), camera.pixels());
            let validity = Validity::new(&camera);
            let ok = |&raw: &u16| raw == 0 || validity.accepts(raw);
            assert!(frame.depth.iter().all(ok), "{camera:?}");
        }
    }
}
