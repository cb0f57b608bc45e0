//! Our stream beside other depth codecs: the same frames, one process, one thread.
//!
//! `cargo bench --bench peers [-- FOLDER ...]`; without folders the bundled recordings.
//!
//! What the camera calls invalid is set to 0 first, so that all code the same measurements. A
//! frame goes through every codec before the next one does, so that a busy machine disturbs all
//! alike; the whole is done [`PASSES`] times and the fastest time of each frame counts. Ratios are
//! taken frame by frame: median, and 10th and 90th percentile in brackets. The first frame, which
//! only warms up, is left out. Every frame that comes back is compared with what went in.

#![allow(clippy::print_stdout, reason = "the table is what the bench is for")]

mod lossless;
mod ours;

use lossless::Peer;
use ours::Ours;
use saint_live::capture::Next;
use saint_live::capture::sequences::{self, SequenceOptions};
use saint_live::deproject::{Rays, Validity};
use saint_live::frame::{Camera, DepthFrame};
use std::error::Error;
use std::hint::black_box;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Times the whole is repeated.
const PASSES: usize = 3;
/// Most frames of an input.
const FRAMES: usize = 40;
/// Our rows: name, cold, lossless. The first two are what the others are compared with.
const OURS: [(&str, bool, bool); 4] = [
    ("live, lossless", false, true),
    ("live, default tolerance (lossy)", false, false),
    ("cold, lossless", true, true),
    ("cold, default tolerance (lossy)", true, false),
];

/// One codec on one frame.
#[derive(Clone, Copy, Debug)]
struct Sample {
    encode_ms: f64,
    decode_ms: f64,
    bytes: usize,
}

impl Sample {
    /// The faster of two runs on the same frame.
    fn fastest(self, other: Self) -> Self {
        Self {
            encode_ms: self.encode_ms.min(other.encode_ms),
            decode_ms: self.decode_ms.min(other.decode_ms),
            bytes: self.bytes,
        }
    }
}

fn main() -> Result<(), Box<dyn Error>> {
    rayon::ThreadPoolBuilder::new()
        .num_threads(1)
        .use_current_thread()
        .build_global()?;
    // cargo itself passes --bench
    let mut folders: Vec<PathBuf> = std::env::args_os()
        .skip(1)
        .filter(|a| !a.as_encoded_bytes().starts_with(b"--"))
        .map(PathBuf::from)
        .collect();
    if folders.is_empty() {
        let bundled = Path::new(env!("CARGO_MANIFEST_DIR")).join("recordings");
        folders = ["static_room", "moving_camera", "moving_object"]
            .map(|n| bundled.join(n))
            .to_vec();
    }
    for folder in &folders {
        compare(folder)?;
    }
    Ok(())
}

/// The frames of a folder, what is invalid set to 0.
fn load(folder: &Path) -> Result<(Camera, Vec<DepthFrame>), Box<dyn Error>> {
    let mut source = sequences::open(folder, &SequenceOptions::default())?;
    let camera = source.camera().clone();
    let validity = Validity::new(&camera);
    let mut frames = Vec::new();
    while frames.len() < FRAMES {
        let mut frame = DepthFrame::default();
        match source.next(&mut frame)? {
            Next::Frame => {}
            Next::Waiting(_) => continue,
            Next::End => break,
        }
        for raw in &mut frame.depth {
            *raw *= u16::from(validity.accepts(*raw));
        }
        frames.push(frame);
    }
    if frames.len() < 2 {
        return Err(format!("{}: two frames at least are needed", folder.display()).into());
    }
    Ok((camera, frames))
}

fn compare(folder: &Path) -> Result<(), Box<dyn Error>> {
    let (camera, frames) = load(folder)?;
    let rays = Rays::new(&camera);
    let names: Vec<_> = OURS
        .iter()
        .map(|o| o.0)
        .chain(Peer::ALL.map(Peer::name))
        .collect();
    let mut rows: Vec<Vec<Sample>> = vec![Vec::new(); names.len()];
    let mut errors = Vec::new();
    for pass in 0..PASSES {
        let mut ours = Vec::new();
        for (_, cold, lossless) in OURS {
            ours.push(Ours::new(&camera, cold, lossless)?);
        }
        for (n, frame) in frames.iter().enumerate() {
            let mut samples = Vec::new();
            for ours in &mut ours {
                samples.push(ours.run(frame)?);
            }
            for peer in Peer::ALL {
                samples.push(run(peer, &rays, &frame.depth)?);
            }
            if n == 0 {
                continue;
            }
            for (row, sample) in rows.iter_mut().zip(samples) {
                match row.get_mut(n - 1) {
                    Some(best) if pass > 0 => *best = best.fastest(sample),
                    _ => row.push(sample),
                }
            }
        }
        errors = ours.iter().map(|o| o.errors).collect();
    }
    let points: Vec<_> = frames[1..]
        .iter()
        .map(|f| f.depth.iter().filter(|raw| **raw != 0).count())
        .collect();
    let total = points.iter().sum::<usize>().max(1) as f64;
    println!(
        "\n{} ({}x{}), {} frames, {:.0} measurements a frame, one thread",
        folder.display(),
        camera.width,
        camera.height,
        frames.len() - 1,
        total / points.len() as f64
    );
    println!(
        "{:<32} {:>9} {:>9} {:>12}   error mm, mean / max",
        "", "encode ms", "decode ms", "bits/valid px"
    );
    for (k, (name, row)) in names.iter().zip(&rows).enumerate() {
        let bytes: usize = row.iter().map(|s| s.bytes).sum();
        let told = match errors.get(k) {
            Some(e) if !OURS[k].2 => {
                format!("{:.2} / {:.1}", e.mean_m() * 1e3, e.max_m * 1e3)
            }
            _ => "0".to_owned(),
        };
        println!(
            "{name:<32} {:>9.2} {:>9.2} {:>12.3}   {told}",
            spread(row.iter().map(|s| s.encode_ms)).1,
            spread(row.iter().map(|s| s.decode_ms)).1,
            bytes as f64 * 8.0 / total
        );
    }
    for reference in 0..2 {
        println!("ratio to {}", names[reference]);
        println!(
            "{:<32} {:>22} {:>22} {:>22}",
            "", "size", "encode", "decode"
        );
        for (name, row) in names
            .iter()
            .zip(&rows)
            .filter(|(n, _)| **n != names[reference])
        {
            let pairs = || row.iter().zip(&rows[reference]);
            println!(
                "{name:<32} {:>22} {:>22} {:>22}",
                ratio(pairs().map(|(a, b)| a.bytes as f64 / b.bytes as f64)),
                ratio(pairs().map(|(a, b)| a.encode_ms / b.encode_ms)),
                ratio(pairs().map(|(a, b)| a.decode_ms / b.decode_ms)),
            );
        }
    }
    Ok(())
}

/// One peer on one frame.
fn run(peer: Peer, rays: &Rays, depth: &[u16]) -> Result<Sample, Box<dyn Error>> {
    let mut bytes = Vec::new();
    let start = Instant::now();
    peer.encode(rays, depth, &mut bytes)?;
    let encode = start.elapsed();
    let start = Instant::now();
    let decoded = black_box(peer.decode(rays, &bytes)?);
    let decode = start.elapsed();
    if !decoded.equals(rays, depth) {
        return Err(format!("{}: not lossless", peer.name()).into());
    }
    Ok(Sample {
        encode_ms: encode.as_secs_f64() * 1e3,
        decode_ms: decode.as_secs_f64() * 1e3,
        bytes: bytes.len(),
    })
}

/// 10th percentile, median and 90th percentile (nearest rank).
fn spread(values: impl Iterator<Item = f64>) -> (f64, f64, f64) {
    let mut values: Vec<_> = values.collect();
    values.sort_by(f64::total_cmp);
    let at = |q: f64| {
        let rank = (q * values.len().saturating_sub(1) as f64).round() as usize;
        values.get(rank).copied().unwrap_or(f64::NAN)
    };
    (at(0.1), at(0.5), at(0.9))
}

fn ratio(values: impl Iterator<Item = f64>) -> String {
    let (low, middle, high) = spread(values);
    format!("{middle:.2} [{low:.2} {high:.2}]")
}
