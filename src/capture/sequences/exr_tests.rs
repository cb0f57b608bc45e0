//! Round trips through EXR and damaged EXR files.

use super::*;
use crate::frame::Intrinsics;

fn camera(width: u32, height: u32, unit: f64) -> Camera {
    Camera {
        width,
        height,
        intrinsics: Intrinsics {
            fx: 517.3,
            fy: 516.5,
            cx: 318.6,
            cy: 255.3,
        },
        depth_unit_m: unit,
        invalid: vec![0, 65535],
        depth_min_m: 0.1,
        depth_max_m: 7.5,
        fps: Some(29.97),
        name: "Tiefe ⊕ 1".to_owned(),
    }
}

fn frame(depth: Vec<u16>) -> DepthFrame {
    let time = FrameTime {
        device_ns: 9_007_199_254_740_993,
        wall_ns: -5,
    };
    DepthFrame {
        sequence: 17,
        time,
        depth,
    }
}

#[test]
fn all_codes_come_back_exactly() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.exr");
    let codes: Vec<u16> = (0..=u16::MAX).collect();
    for unit in [0.001, 0.0002, 0.00025, 0.0001] {
        let camera = camera(256, 256, unit);
        let frame = frame(codes.clone());
        write_exr_depth(&path, &camera, &frame).unwrap();
        let options = super::super::SequenceOptions::default();
        let mut source = super::super::open(&path, &options).unwrap();
        assert_eq!(source.camera(), &camera);
        let mut back = DepthFrame::default();
        source.next(&mut back).unwrap();
        assert!(back.depth == codes, "unit {unit}");
        assert_eq!(back.time, frame.time);
        let mut image = ExrImage::default();
        read_exr_depth(&path, ExrChannel::default(), &mut image).unwrap();
        assert_eq!(image.attributes.sequence, Some(17));
        assert!((f64::from(image.values[40_000]) - 40_000.0 * unit).abs() < 2e-6);
    }
}

#[test]
fn the_same_frame_gives_the_same_bytes() {
    let folder = tempfile::tempdir().unwrap();
    let written: Vec<Vec<u8>> = (0..8)
        .map(|n| {
            let path = folder.path().join(format!("{n}.exr"));
            write_exr_depth(
                &path,
                &camera(4, 2, 0.001),
                &frame(vec![1, 2, 3, 4, 5, 6, 7, 8]),
            )
            .unwrap();
            std::fs::read(path).unwrap()
        })
        .collect();
    assert!(written.windows(2).all(|pair| pair[0] == pair[1]));
}

#[test]
fn metres_are_kept_as_they_are() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.exr");
    let depth = [0.0, 1.234_567_8, 65.0, 1e-7];
    write_exr_metres(&path, &camera(2, 2, 0.001), 3, FrameTime::default(), &depth).unwrap();
    let mut image = ExrImage::default();
    read_exr_depth(&path, ExrChannel::default(), &mut image).unwrap();
    assert_eq!(image.values, depth);
    assert_eq!(image.attributes.depth_unit_m, None);
    assert!(image.attributes.intrinsics.is_some());
    let error = write_exr_metres(
        &path,
        &camera(2, 2, 0.001),
        3,
        FrameTime::default(),
        &depth[1..],
    );
    assert!(matches!(error, Err(CaptureError::Usage(_))));
}

/// A file with these channels, 3x2 pixels, sample = channel position + pixel.
fn file_of(path: &Path, channels: &[(&str, bool)], encoding: Encoding, layer: &str) {
    let channels = channels.iter().enumerate().map(|(at, (name, half))| {
        let values = (0..6u8).map(|pixel| f32::from(pixel) + at as f32 * 10.0);
        let samples = if *half {
            FlatSamples::F16(values.map(f16::from_f32).collect())
        } else {
            FlatSamples::F32(values.collect())
        };
        AnyChannel::new(*name, samples)
    });
    let attributes = LayerAttributes::named(layer).with_position(exr::math::Vec2(-3, 5));
    let list = AnyChannels::sort(channels.collect());
    let layer = Layer::new((3, 2), attributes, encoding, list);
    Image::from_layer(layer)
        .write()
        .non_parallel()
        .to_file(path)
        .unwrap();
}

#[test]
fn channels_are_found_by_name_and_layer() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.exr");
    let read = |name, layer| {
        let mut image = ExrImage::default();
        read_exr_depth(&path, ExrChannel { name, layer }, &mut image)
            .map(|()| (image.values[0], image.half))
            .map_err(|error| error.to_string())
    };
    let tiles = Encoding {
        compression: Compression::RLE,
        blocks: Blocks::Tiles(exr::math::Vec2(2, 1)),
        line_order: LineOrder::Unspecified,
    };
    for encoding in [Encoding::UNCOMPRESSED, Encoding::SMALL_LOSSLESS, tiles] {
        file_of(
            &path,
            &[("R", true), ("G", true), ("Z", false)],
            encoding,
            "view",
        );
        assert_eq!(read(None, None), Ok((20.0, false)));
        assert_eq!(read(Some("G"), None), Ok((10.0, true)));
        assert_eq!(read(None, Some("view")), Ok((20.0, false)));
        let error = read(Some("Y"), None).unwrap_err();
        assert!(error.contains("no channel Y among: G, R, Z"), "{error}");
        let error = read(None, Some("other")).unwrap_err();
        assert!(error.contains("in layer other"), "{error}");
    }
    file_of(
        &path,
        &[("a.R", false), ("a.Depth.Z", false)],
        Encoding::UNCOMPRESSED,
        "x",
    );
    assert_eq!(read(None, None), Ok((10.0, false)));
    assert_eq!(read(None, Some("a")), Ok((10.0, false)));
    file_of(&path, &[("Y", true)], Encoding::UNCOMPRESSED, "x");
    assert_eq!(read(None, None), Ok((0.0, true)));
    file_of(
        &path,
        &[("R", false), ("G", false)],
        Encoding::UNCOMPRESSED,
        "x",
    );
    assert!(read(None, None).unwrap_err().contains("--exr-channel"));
}

#[test]
fn every_cut_is_an_error_and_no_mutation_panics() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.exr");
    let depth = (0..40 * 35).map(|n: u32| (n * 37 % 5000) as u16).collect();
    write_exr_depth(&path, &camera(40, 35, 0.001), &frame(depth)).unwrap();
    let whole = std::fs::read(&path).unwrap();
    let mut image = ExrImage::default();
    for length in (0..whole.len()).step_by(13) {
        std::fs::write(&path, &whole[..length]).unwrap();
        let error = read_exr_depth(&path, ExrChannel::default(), &mut image).unwrap_err();
        assert!(error.to_string().contains("a.exr"), "{error}");
    }
    for at in 0..whole.len().min(1200) {
        let mut damaged = whole.clone();
        damaged[at] ^= [0x01, 0x80, 0xff][at % 3];
        std::fs::write(&path, &damaged).unwrap();
        if read_exr_depth(&path, ExrChannel::default(), &mut image).is_ok() {
            let pixels = image.width as usize * image.height as usize;
            assert_eq!(image.values.len(), pixels);
        }
    }
}
