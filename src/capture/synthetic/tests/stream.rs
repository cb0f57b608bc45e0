//! Frames as a stream: determinism, pacing, gaps, odd scenes.

use super::*;
use glam::DVec3;

#[test]
fn a_frame_depends_on_its_number_and_seed_alone() {
    for scene in [Scene::Walk, Scene::Juggle, Scene::Noise, Scene::Cut] {
        let options = SyntheticOptions {
            cut: if scene == Scene::Cut { 3 } else { 0 },
            burst: if scene == Scene::Noise { 2 } else { 0 },
            noise: NoiseModel::Stereo,
            ..small(scene)
        };
        let mut running = open(options);
        let mut frame = DepthFrame::default();
        let mut frames = Vec::new();
        while frames.len() < 9 {
            assert_eq!(running.next(&mut frame).expect("frame"), Next::Frame);
            assert_eq!(frame.sequence, frames.len() as u64);
            frames.push(frame.depth.clone());
        }
        for index in [8, 0, 5] {
            let mut fresh = Vec::new();
            open(options).render(index, &mut fresh);
            assert!(fresh == frames[index as usize], "{scene:?} frame {index}");
        }
        let mut other = Vec::new();
        open(SyntheticOptions { seed: 2, ..options }).render(5, &mut other);
        assert!(other != frames[5], "{scene:?}: the seed does nothing");
    }
}

#[test]
fn cuts_and_bursts_come_when_asked_for() {
    let mut source = open(SyntheticOptions {
        cut: 4,
        ..small(Scene::Cut)
    });
    let poses: Vec<Pose> = (0..8).map(|index| source.truth(index).pose).collect();
    assert!(poses[0] == poses[3] && poses[3] != poses[4] && poses[4] == poses[7]);
    let mut source = open(SyntheticOptions {
        burst: 2,
        ..small(Scene::Noise)
    });
    let far = |index, source: &mut SyntheticSource| {
        let mut depth = Vec::new();
        source.render(index, &mut depth);
        share(depth.iter().map(|&code| code > 10_000))
    };
    for (index, burst) in [(0, false), (1, false), (2, true), (3, true), (4, false)] {
        assert_eq!(far(index, &mut source) > 0.5, burst, "frame {index}");
    }
}

#[test]
fn odd_scenes_are_what_their_names_say() {
    let mut depth = Vec::new();
    open(small(Scene::Empty)).render(0, &mut depth);
    assert!(depth.len() == 160 * 120 && depth.iter().all(|&code| code == 0));
    open(small(Scene::Checkerboard)).render(0, &mut depth);
    assert_eq!(&depth[..3], &[1000, 2000, 1000]);
    assert_eq!(&depth[160..163], &[2000, 1000, 2000]);
    let mut source = open(small(Scene::Codes65535));
    source.render(0, &mut depth);
    assert_eq!(source.camera().invalid, [0, 65535]);
    assert!(depth.contains(&65535) && !depth.contains(&0));
}

#[test]
fn any_image_size_renders() {
    for (width, height) in [(1, 1), (1, 9), (9, 1), (3, 2), (17, 5)] {
        for (noise, _) in NoiseModel::ALL {
            let mut source = open(SyntheticOptions {
                width,
                height,
                noise,
                ..small(Scene::Walk)
            });
            let mut depth = Vec::new();
            source.render(7, &mut depth);
            assert_eq!(depth.len(), (width * height) as usize);
        }
    }
}

#[test]
fn a_late_reader_of_a_paced_sensor_sees_gaps_and_counts_them() {
    let mut source = open(SyntheticOptions {
        width: 32,
        height: 24,
        fps: 500.0,
        paced: true,
        ..small(Scene::Juggle)
    });
    assert!(source.is_live());
    let (mut frame, mut seen) = (DepthFrame::default(), Vec::new());
    let mut times = Vec::new();
    // the sensor does not end: however long the reader is held up, frames come after the gap
    while seen.len() < 20 {
        match source.next(&mut frame).expect("frame") {
            Next::Frame => {
                seen.push(frame.sequence);
                times.push(frame.time.device_ns);
            }
            Next::Waiting(_) => continue,
            Next::End => panic!("it has no end"),
        }
        let mut again = Vec::new();
        open(*source.options()).render(frame.sequence, &mut again);
        assert_eq!(frame.depth, again, "frame {}", frame.sequence);
        if seen.len() == 3 {
            // at least twenty frames pass; the driver holds six
            std::thread::sleep(Duration::from_millis(40));
        }
    }
    assert!(seen.is_sorted_by(|a, b| a < b), "{seen:?}");
    assert!(times.is_sorted_by(|a, b| a < b));
    let last = seen.last().expect("frames");
    let lost = last + 1 - seen.len() as u64;
    assert!(lost >= 10, "lost {lost}");
    assert_eq!(source.losses().sensor_gap, lost);
}

#[test]
fn a_stalled_sensor_says_so_and_goes_on() {
    let mut source = open(SyntheticOptions {
        width: 8,
        height: 6,
        fps: 1000.0,
        stall: 3,
        frames: Some(4),
        paced: true,
        ..small(Scene::Stall)
    });
    let (mut frame, mut said, mut last) = (DepthFrame::default(), 0, 0);
    loop {
        match source.next(&mut frame).expect("frame") {
            Next::Frame => last = frame.sequence,
            Next::Waiting(why) => said += u32::from(why.is_some_and(|w| w.contains("stalled"))),
            Next::End => break,
        }
    }
    assert_eq!(last, 3);
    assert!(said >= 1, "silent for a second without a word");
}

#[test]
fn rendering_ahead_repeats_the_first_frames() {
    let options = SyntheticOptions {
        prerender: 3,
        ..small(Scene::Juggle)
    };
    let (mut source, mut plain) = (open(options), open(small(Scene::Juggle)));
    for index in 0..7 {
        let (mut a, mut b) = (Vec::new(), Vec::new());
        source.render(index, &mut a);
        plain.render(index % 3, &mut b);
        assert!(a == b, "frame {index}");
        assert_eq!(source.truth(index), plain.truth(index % 3));
    }
}

#[test]
fn generation_hands_over_every_frame_once() {
    let mut sequences = Vec::new();
    let options = SyntheticOptions {
        paced: true,
        ..small(Scene::Walk)
    };
    let written = generate::<CaptureError>(options, 5, &mut |camera, frame| {
        assert_eq!(camera.pixels(), frame.depth.len());
        sequences.push((frame.sequence, frame.time.device_ns));
        Ok(())
    });
    assert_eq!(written.expect("written"), 5);
    assert_eq!(sequences[3], (3, 100_000_000));
    let stopped = generate(options, 5, &mut |_, _| {
        Err(CaptureError::Usage("full".into()))
    });
    assert!(stopped.is_err());
}

#[test]
fn frames_are_the_same_bytes_on_every_machine() {
    // recordings/ can be made again: change these numbers only together with them
    let mut sums = Vec::new();
    for (noise, _) in NoiseModel::ALL {
        let mut source = open(SyntheticOptions {
            noise,
            ..small(Scene::Juggle)
        });
        let mut depth = Vec::new();
        source.render(5, &mut depth);
        let bytes: Vec<u8> = depth.iter().flat_map(|code| code.to_le_bytes()).collect();
        sums.push(crc32fast::hash(&bytes));
    }
    assert_eq!(
        sums,
        [1_725_859_665, 3_783_252_144, 574_147_385, 3_549_264_067]
    );
}

/// Numbers of the frames that come, and what is counted at the end.
fn drain(options: SyntheticOptions) -> (Vec<u64>, SourceLosses) {
    let mut source = open(options);
    let mut frame = DepthFrame::default();
    let mut numbers = Vec::new();
    loop {
        match source.next(&mut frame).expect("a frame or none") {
            Next::Frame => numbers.push(frame.sequence),
            Next::Waiting(_) => {}
            Next::End => return (numbers, source.losses()),
        }
    }
}

#[test]
fn faults_come_when_asked_for_and_are_counted() {
    let options = SyntheticOptions {
        gap: 10,
        damage: 7,
        frames: Some(75),
        ..small(Scene::Empty)
    };
    // lost: 9, 19, ... 69; damaged: 6, 13, ... but 69, which is lost already
    let (numbers, losses) = drain(options);
    let want = |n: &u64| !(n + 1).is_multiple_of(10) && !(n + 1).is_multiple_of(7);
    assert_eq!(numbers, (0..75).filter(want).collect::<Vec<_>>());
    assert_eq!((losses.sensor_gap, losses.damaged, losses.stall), (7, 9, 0));

    // a camera that does not wait: what a late reader misses is a gap, too
    let paced = SyntheticOptions {
        paced: true,
        speed: 30.0,
        ..options
    };
    let (numbers, losses) = drain(paced);
    assert!(numbers.iter().all(want), "{numbers:?}");
    let counted = numbers.len() as u64 + losses.sensor_gap + losses.damaged;
    let last = numbers.last().copied().expect("frames");
    assert!((last + 1..=75).contains(&counted), "{counted} after {last}");
}

#[test]
fn a_camera_stands_where_it_is_put() {
    let placed = SyntheticOptions {
        at: [1.5, -0.25, -2.0],
        turn: [90.0, 0.0],
        ..small(Scene::Room)
    };
    let pose = open(placed).truth(0).pose;
    let ahead = pose.to_world(DVec3::Z);
    // it looks to the right now
    assert!(
        (ahead - DVec3::new(2.5, -0.25, -2.0)).length() < 1e-12,
        "{ahead}"
    );
    let up = SyntheticOptions {
        turn: [0.0, 90.0],
        ..small(Scene::Room)
    };
    let ahead = up.placement().to_world(DVec3::Z);
    assert!(
        (ahead + DVec3::Y).length() < 1e-12,
        "y points down: {ahead}"
    );
}
