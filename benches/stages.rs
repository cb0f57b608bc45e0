//! Time of each stage on the VGA frames of `recordings/static_room`, one thread.
//!
//! `cargo bench --bench stages [-- FILTER]`. Throughput is in pixels of the image. The recording is
//! played forth and back, so that the stages that look at the frame before see steady motion.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "a bench fails by panicking"
)]

use divan::Bencher;
use divan::counter::ItemsCount;
use glam::DVec3;
use saint_live::capture::Next;
use saint_live::capture::sequences::{self, SequenceOptions};
use saint_live::codec::{CodecOptions, Decoder, EncodedFrame, Encoder, Tolerance, polar};
use saint_live::contact_map::labels::SaintFrame;
use saint_live::contact_map::polar_frame::{PolarMapper, default_step_m};
use saint_live::deproject::{Rays, Validity};
use saint_live::export::{ExportFrame, ply};
use saint_live::fit::live::{FitOptions, Modeler};
use saint_live::frame::{Camera, DepthFrame};
use std::hint::black_box;
use std::path::Path;

fn main() {
    rayon::ThreadPoolBuilder::new()
        .num_threads(1)
        .use_current_thread()
        .build_global()
        .unwrap();
    divan::main();
}

/// Camera, frames and the state of a running stream.
struct Stream {
    camera: Camera,
    frames: Vec<DepthFrame>,
    count: u64,
    modeler: Modeler,
    encoder: Encoder,
}

impl Stream {
    /// A stream past its first frames. Only its first frame is a key frame.
    fn new() -> Self {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("recordings/static_room");
        let mut source = sequences::open(&folder, &SequenceOptions::default()).unwrap();
        let camera = source.camera().clone();
        let mut frames = vec![DepthFrame::default()];
        while source.next(frames.last_mut().unwrap()).unwrap() == Next::Frame {
            frames.push(DepthFrame::default());
        }
        frames.pop();
        let fit = FitOptions::default();
        let codec = CodecOptions::fitted(fit.contact_distance, u32::MAX);
        Self {
            modeler: Modeler::new(&camera, &fit),
            encoder: Encoder::new(&camera, codec).unwrap(),
            camera,
            frames,
            count: 0,
        }
    }

    fn pixels(&self) -> ItemsCount {
        ItemsCount::new(self.camera.pixels())
    }

    /// The next frame, forth and back.
    fn frame(&mut self) -> DepthFrame {
        let (len, n) = (self.frames.len(), self.count as usize);
        let at = n % (2 * len);
        let mut frame = self.frames[if at < len { at } else { 2 * len - 1 - at }].clone();
        frame.sequence = self.count;
        self.count += 1;
        frame
    }

    fn modelled(&mut self) -> (DepthFrame, SaintFrame) {
        let (frame, mut saint) = (self.frame(), SaintFrame::default());
        self.modeler.model(&frame, &mut saint, &|| false);
        (frame, saint)
    }

    fn encoded(&mut self) -> EncodedFrame {
        let (frame, saint) = self.modelled();
        let mut encoded = EncodedFrame::default();
        self.encoder
            .encode(&frame, &saint, false, &mut encoded)
            .unwrap();
        encoded
    }
}

/// Frames before the clock runs.
const WARM_UP: usize = 10;

#[divan::bench(sample_size = 1)]
fn clean_and_deproject(bencher: Bencher<'_, '_>) {
    let mut stream = Stream::new();
    let (rays, validity) = (Rays::new(&stream.camera), Validity::new(&stream.camera));
    let (mut plane, mut points) = (Vec::new(), Vec::<DVec3>::new());
    bencher
        .counter(stream.pixels())
        .with_inputs(|| stream.frame())
        .bench_local_refs(|frame| {
            validity.clean(&rays, frame, &mut plane);
            points.clear();
            for (y, row) in plane.chunks_exact(rays.stride()).enumerate() {
                for (x, &raw) in row.iter().enumerate().filter(|(_, raw)| **raw != 0) {
                    let z = f64::from(raw) * f64::from(rays.unit);
                    points.push(rays.point(x, y, z));
                }
            }
            black_box(points.len())
        });
}

#[divan::bench(sample_size = 1)]
fn model_warm(bencher: Bencher<'_, '_>) {
    model(bencher, false);
}

#[divan::bench(sample_size = 1)]
fn model_cold(bencher: Bencher<'_, '_>) {
    model(bencher, true);
}

fn model(bencher: Bencher<'_, '_>, cold: bool) {
    let mut stream = Stream::new();
    let mut modeler = Modeler::new(&stream.camera, &FitOptions::default());
    let mut saint = SaintFrame::default();
    for _ in 0..WARM_UP {
        modeler.model(&stream.frame(), &mut saint, &|| false);
    }
    bencher
        .counter(stream.pixels())
        .with_inputs(|| stream.frame())
        .bench_local_refs(|frame| {
            if cold {
                modeler.reset();
            }
            modeler.model(frame, &mut saint, &|| false)
        });
}

#[divan::bench(sample_size = 1)]
fn encode_p_frame(bencher: Bencher<'_, '_>) {
    encode(bencher, false);
}

#[divan::bench(sample_size = 1)]
fn encode_key_frame(bencher: Bencher<'_, '_>) {
    encode(bencher, true);
}

fn encode(bencher: Bencher<'_, '_>, key: bool) {
    let mut stream = Stream::new();
    let tolerance = Tolerance {
        contact: FitOptions::default().contact_distance,
        lossless: false,
    };
    let options = CodecOptions {
        keyframe_every: if key { 1 } else { u32::MAX },
        contact: tolerance.contact,
        smooth_mask: false,
        effort: saint_live::codec::Effort::Live,
        tolerance,
    };
    let mut encoder = Encoder::new(&stream.camera, options).unwrap();
    let mut encoded = EncodedFrame::default();
    for _ in 0..WARM_UP {
        let (frame, saint) = stream.modelled();
        encoder.encode(&frame, &saint, false, &mut encoded).unwrap();
    }
    bencher
        .counter(stream.pixels())
        .with_inputs(|| stream.modelled())
        .bench_local_refs(|(frame, saint)| {
            encoder.encode(frame, saint, false, &mut encoded).unwrap()
        });
}

#[divan::bench(sample_size = 1)]
fn decode(bencher: Bencher<'_, '_>) {
    let mut stream = Stream::new();
    let mut decoder = Decoder::new();
    for _ in 0..WARM_UP {
        decoder.decode(&stream.encoded().payload).unwrap();
    }
    bencher
        .counter(stream.pixels())
        .with_inputs(|| stream.encoded())
        .bench_local_refs(|encoded| decoder.decode(&encoded.payload).unwrap().sequence);
}

#[divan::bench(sample_size = 1)]
fn polar_map(bencher: Bencher<'_, '_>) {
    let mut stream = Stream::new();
    let step_m = default_step_m(&FitOptions::default().contact_distance) as f32;
    let mut mapper = PolarMapper::new(&stream.camera, step_m);
    let mut bytes = Vec::new();
    bencher
        .counter(stream.pixels())
        .with_inputs(|| stream.modelled())
        .bench_local_refs(|(frame, saint)| {
            bytes.clear();
            let (map, lost) = mapper.map(frame, saint).unwrap();
            polar::encode(&map, &mut bytes).unwrap();
            lost
        });
}

#[divan::bench(sample_size = 1)]
fn export_ply(bencher: Bencher<'_, '_>) {
    let mut stream = Stream::new();
    let camera = stream.camera.clone();
    let mut decoder = Decoder::new();
    let mut file = Vec::new();
    bencher
        .counter(stream.pixels())
        .with_inputs(|| {
            let encoded = stream.encoded();
            decoder.decode(&encoded.payload).unwrap().clone()
        })
        .bench_local_refs(|decoded| {
            let frame = ExportFrame {
                camera: &camera,
                sequence: decoded.sequence,
                time: decoded.time,
                depth_m: &decoded.depth_m,
                labels: &decoded.labels,
                spheres: &decoded.spheres,
            };
            ply::points(&frame, &mut file);
        });
}
