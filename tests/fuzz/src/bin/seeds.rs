//! Writes the corpus: the golden payloads, small recordings and clouds, images of other programs.

use saint_live::capture::CaptureError;
use saint_live::capture::containers::rvl;
use saint_live::capture::sequences::exr::encode_exr_depth;
use saint_live::capture::sequences::png::write_png_depth;
use saint_live::capture::synthetic::{Scene, SyntheticOptions, generate};
use saint_live::codec::merged::{self, MergedModel};
use saint_live::codec::{CodecOptions, EncodedFrame, Encoder, polar};
use saint_live::contact_map::labels::SaintFrame;
use saint_live::contact_map::merged::{ClaimMap, Patch, PatchCell};
use saint_live::contact_map::polar::PolarGrid;
use saint_live::fit::contact_distance::ContactDistance;
use saint_live::fit::live::{FitOptions, Modeler};
use saint_live::recording::{RecordingWriter, Target, WriterOptions};
use saint_live_fuzz::ENDINGS;
use std::error::Error;
use std::fs;
use std::path::{Path, PathBuf};

type Outcome = Result<(), Box<dyn Error>>;

struct Corpus(PathBuf);

impl Corpus {
    fn put(&self, target: &str, name: &str, bytes: &[u8]) -> Outcome {
        let folder = self.0.join("corpus").join(target);
        fs::create_dir_all(&folder)?;
        Ok(fs::write(folder.join(name), bytes)?)
    }

    fn put_kind(&self, target: &str, name: &str, kind: u8, bytes: &[u8]) -> Outcome {
        self.put(target, name, &[&[kind], bytes].concat())
    }
}

fn main() -> Outcome {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let corpus = Corpus(root.to_owned());
    for entry in fs::read_dir(root.join("../golden"))? {
        let path = entry?.path();
        if path.extension().is_some_and(|ending| ending == "bin") {
            let name = path.file_stem().unwrap_or_default().to_string_lossy();
            corpus.put("sensor", &name, &fs::read(&path)?)?;
        }
    }
    for entry in fs::read_dir(root.join("../foreign"))? {
        let path = entry?.path();
        let ending = path.extension().unwrap_or_default().to_string_lossy();
        let kind = ENDINGS.iter().position(|known| *known == ending);
        if let Some(kind) = kind {
            let name = path.file_name().unwrap_or_default().to_string_lossy();
            corpus.put_kind("sequence", &name, kind as u8, &fs::read(&path)?)?;
        }
    }
    cloud_payloads(&corpus)?;
    cloud_files(&corpus)?;
    frames(&corpus)
}

fn cloud_payloads(corpus: &Corpus) -> Outcome {
    let patch = |i: u8| Patch {
        anchor: [f32::from(i), 0.5, -2.0].into(),
        normal: [0.6, 0.0, 0.8].into(),
        curvature: f32::from(i) * 0.25 - 0.25,
    };
    let cell = |(row, column)| PatchCell { row, column };
    let cells = [
        (-3, 5),
        (-3, 6),
        (0, -400),
        (70_000, 0),
        (1, 1),
        (0, 0),
        (0, 7),
    ];
    let map = ClaimMap {
        origin: [448_262.0, 5_411_932.0, -113.0].into(),
        step_m: 0.002,
        patches: (0..3).map(patch).collect(),
        starts: vec![0, 4, 5, 7],
        cells: cells.map(cell).to_vec(),
    };
    let mut bytes = Vec::new();
    polar::encode(&map, &mut bytes)?;
    corpus.put("cloud_payload", "polar", &bytes)?;
    let model = MergedModel {
        origin: [1.0, 2.0, 3.0].into(),
        floats: vec![[0.0, 1.0, 2.0, 3.0], [-1.0, 0.5, 9.0, 0.25]],
        grid: PolarGrid::new(200),
        cells: vec![(0, 0), (1, 1), (7000, 0), (79_999, 1)],
    };
    bytes.clear();
    merged::encode(&model, &mut bytes)?;
    corpus.put("cloud_payload", "merged", &bytes)
}

fn cloud_files(corpus: &Corpus) -> Outcome {
    let ply = "ply\nformat ascii 1.0\ncomment unit m\nelement vertex 2\nproperty float x\nproperty \
               double y\nproperty float z\nproperty uchar red\nelement face 1\nproperty list uchar \
               int vertex_indices\nend_header\n0 1 2 3\n4 5 6.5 7\n2 0 1\n";
    corpus.put_kind("cloud_file", "ascii.ply", 0, ply.as_bytes())?;
    for (name, order) in [("little", "little"), ("big", "big")] {
        let header = format!(
            "ply\nformat binary_{order}_endian 1.0\nelement vertex 2\nproperty float x\nproperty \
             float y\nproperty float z\nend_header\n"
        );
        let bytes = [header.as_bytes(), &[0x3F; 24]].concat();
        corpus.put_kind("cloud_file", &format!("{name}.ply"), 0, &bytes)?;
    }
    for data in ["ascii", "binary", "binary_compressed"] {
        let header = format!(
            "# .PCD v0.7\nVERSION 0.7\nFIELDS x y z rgb\nSIZE 4 4 4 4\nTYPE F F F U\nCOUNT 1 1 1 1\n\
             WIDTH 2\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS 2\nDATA {data}\n"
        );
        let body = match data {
            "ascii" => b"0 1 2 3\n4 5 6 7\n".to_vec(),
            "binary" => vec![0x3F; 32],
            // LZF: 37 bytes, a literal run of 32
            _ => [&[33, 0, 0, 0, 32, 0, 0, 0, 31][..], &[0x3F; 32]].concat(),
        };
        let bytes = [header.as_bytes(), &body].concat();
        corpus.put_kind("cloud_file", &format!("{data}.pcd"), 1, &bytes)?;
    }
    let obj = "o thing\nv 1 2 3\nv 4.5 5e-1 -6 1.0\nvn 0 0 1\nf 1 2 2\n";
    corpus.put_kind("cloud_file", "a.obj", 2, obj.as_bytes())?;
    corpus.put_kind(
        "cloud_file",
        "a.xyz",
        3,
        b"# x y z\n1 2 3\n4,5,6\n7;8;9 255\n",
    )?;
    let header = "{'descr': '<f4', 'fortran_order': False, 'shape': (2, 3), }";
    let header = format!("{header:<117}\n");
    let bytes = [b"\x93NUMPY\x01\x00\x76\x00", header.as_bytes(), &[0x3F; 24]].concat();
    corpus.put_kind("cloud_file", "a.npy", 4, &bytes)
}

/// A recording, an EXR and a PNG file of the synthetic sensor.
fn frames(corpus: &Corpus) -> Outcome {
    let options = SyntheticOptions {
        width: 40,
        height: 30,
        ..SyntheticOptions::unpaced(Scene::Walk)
    };
    let mut shots = Vec::new();
    generate(options, 4, &mut |camera, frame| {
        shots.push((camera.clone(), frame.clone()));
        Ok::<(), CaptureError>(())
    })?;
    let (camera, first) = &shots[0];
    let exr = encode_exr_depth(camera, first)?;
    corpus.put_kind("sequence", "a.exr", 0, &exr)?;
    let mut bytes = Vec::new();
    rvl::encode(&first.depth[..1000], &mut bytes);
    corpus.put_kind("sequence", "a.rvl", 6, &bytes)?;
    let folder = tempfile::tempdir()?;
    let png = folder.path().join("a.png");
    write_png_depth(&png, 40, 30, &first.depth)?;
    corpus.put_kind("sequence", "a.png", 1, &fs::read(&png)?)?;

    let mcap = folder.path().join("a.mcap");
    let to = Target::File {
        path: mcap.clone(),
        overwrite: false,
    };
    let mut modeler = Modeler::new(camera, &FitOptions::default());
    let with = CodecOptions::fitted(ContactDistance::default(), 3);
    let mut encoder = Encoder::new(camera, with)?;
    let mut writer = RecordingWriter::create(to, camera, &WriterOptions::default())?;
    let (mut saint, mut encoded) = (SaintFrame::default(), EncodedFrame::default());
    for (_, frame) in &shots {
        modeler.model(frame, &mut saint, &|| false);
        encoder.encode(frame, &saint, false, &mut encoded)?;
        writer.frame(&encoded)?;
    }
    writer.finish()?;
    let bytes = fs::read(&mcap)?;
    corpus.put("recording", "whole", &bytes)?;
    corpus.put("recording", "cut", &bytes[..bytes.len() * 2 / 3])
}
