//! The first corpus, from what lies in the repository: the golden payloads, frames of a bundled
//! recording (every eighth pixel) as images, recordings and polar maps, the files of other
//! programs, small clouds and camera files.

use super::fuzz::{CLOUDS, CONTAINERS, IMAGES};
use saint_live::capture::Next;
use saint_live::capture::containers::rvl;
use saint_live::capture::sequences::exr::encode_exr_depth;
use saint_live::capture::sequences::png::write_png_depth;
use saint_live::capture::sequences::{self, SequenceOptions};
use saint_live::codec::merged::{self, MergedModel};
use saint_live::codec::{CodecOptions, EncodedFrame, Encoder, polar};
use saint_live::contact_map::labels::SaintFrame;
use saint_live::contact_map::polar::PolarGrid;
use saint_live::contact_map::polar_frame::PolarMapper;
use saint_live::fit::contact_distance::ContactDistance;
use saint_live::fit::live::{FitOptions, Modeler};
use saint_live::frame::{Camera, ColorFrame, DepthFrame};
use saint_live::recording::raw::{RawWriter, image_message};
use saint_live::recording::{RecordingWriter, Target, WriterOptions};
use std::error::Error;
use std::fs;
use std::path::{Path, PathBuf};

/// `Ok`, or what went wrong.
pub type Outcome = Result<(), Box<dyn Error>>;

/// Every so many pixels, along both sides.
const STEP: usize = 8;

struct Corpus(PathBuf);

impl Corpus {
    fn put(&self, target: &str, name: &str, bytes: &[u8]) -> Outcome {
        let folder = self.0.join("corpus").join(target);
        fs::create_dir_all(&folder)?;
        Ok(fs::write(folder.join(name), bytes)?)
    }

    fn put_kind(&self, target: &str, name: &str, kind: usize, bytes: &[u8]) -> Outcome {
        self.put(target, name, &[&[kind as u8], bytes].concat())
    }
}

/// Writes `tests/fuzz/corpus/TARGET/NAME`.
pub fn write() -> Outcome {
    let root = &Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fuzz");
    let corpus = Corpus(root.to_owned());
    for entry in fs::read_dir(root.join("../golden"))? {
        let path = entry?.path();
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        let bytes = fs::read(&path)?;
        if name.ends_with(".bin") {
            corpus.put("sensor_payload", &name, &bytes)?;
            corpus.put("header", &name, bytes.get(4..104).unwrap_or(&bytes))?;
        }
    }
    for entry in fs::read_dir(root.join("../foreign"))? {
        let path = entry?.path();
        let ending = path.extension().unwrap_or_default().to_string_lossy();
        if let Some(kind) = CONTAINERS.iter().position(|known| *known == ending) {
            let name = path.file_name().unwrap_or_default().to_string_lossy();
            corpus.put_kind("container", &name, kind, &fs::read(&path)?)?;
        }
    }
    let (camera, frames) = bundled(&root.join("../../recordings/moving_object"))?;
    let folder = tempfile::tempdir()?;
    images(&corpus, &camera, &frames[0], folder.path())?;
    recordings(&corpus, &camera, &frames, folder.path())?;
    raw_capture(&corpus, &camera, &frames, folder.path())?;
    cloud_payloads(&corpus, &camera, &frames[0])?;
    cloud_files(&corpus)?;
    camera_files(&corpus, root)
}

/// The first frames of a recording, made smaller.
fn bundled(folder: &Path) -> Result<(Camera, Vec<DepthFrame>), Box<dyn Error>> {
    let mut source = sequences::open(folder, &SequenceOptions::default())?;
    let mut camera = source.camera().clone();
    let (width, mut frame) = (camera.width as usize, DepthFrame::default());
    camera.width /= STEP as u32;
    camera.height /= STEP as u32;
    let (lens, step) = (&mut camera.intrinsics, STEP as f64);
    for side in [&mut lens.fx, &mut lens.fy, &mut lens.cx, &mut lens.cy] {
        *side /= step;
    }
    let mut frames = Vec::new();
    while frames.len() < 6 && source.next(&mut frame)? == Next::Frame {
        let mut small = frame.clone();
        small.depth.clear();
        for y in 0..camera.height as usize {
            let row = &frame.depth[y * STEP * width..][..camera.width as usize * STEP];
            small.depth.extend(row.iter().step_by(STEP));
        }
        frames.push(small);
    }
    Ok((camera, frames))
}

fn images(corpus: &Corpus, camera: &Camera, frame: &DepthFrame, folder: &Path) -> Outcome {
    let (width, height) = (camera.width, camera.height);
    let kind = |ending| IMAGES.iter().position(|known| *known == ending);
    let exr = encode_exr_depth(camera, frame)?;
    corpus.put_kind("image", "a.exr", kind("exr").unwrap_or(0), &exr)?;
    let png = folder.join("a.png");
    write_png_depth(&png, width, height, &frame.depth)?;
    corpus.put_kind("image", "a.png", kind("png").unwrap_or(0), &fs::read(&png)?)?;
    let mut bytes = Vec::new();
    rvl::encode(&frame.depth[..1000], &mut bytes);
    let kind = CONTAINERS.iter().position(|known| *known == "rvl");
    corpus.put_kind("container", "a.rvl", kind.unwrap_or(0), &bytes)
}

fn color(depth: &DepthFrame) -> ColorFrame {
    ColorFrame {
        sequence: depth.sequence,
        time: depth.time,
        format: "jpeg".into(),
        data: vec![7; 50],
    }
}

fn target(path: &Path) -> Target {
    Target::File {
        path: path.to_owned(),
        overwrite: true,
    }
}

fn recordings(corpus: &Corpus, camera: &Camera, frames: &[DepthFrame], folder: &Path) -> Outcome {
    let path = folder.join("a.mcap");
    let mut modeler = Modeler::new(camera, &FitOptions::default());
    let with = CodecOptions::fitted(ContactDistance::default(), 3);
    let mut encoder = Encoder::new(camera, with)?;
    let mut writer = RecordingWriter::create(target(&path), camera, &WriterOptions::default())?;
    let (mut saint, mut encoded) = (SaintFrame::default(), EncodedFrame::default());
    let mut chain = Vec::new();
    for frame in frames {
        modeler.model(frame, &mut saint, &|| false);
        encoder.encode(frame, &saint, false, &mut encoded)?;
        writer.color(&color(frame))?;
        writer.frame(&encoded)?;
        chain.extend((encoded.payload.len() as u32).to_le_bytes());
        chain.extend(&encoded.payload);
    }
    writer.statistics(&serde_json::json!({"fps": 30}), frames[0].time)?;
    writer.finish()?;
    corpus.put("sensor_payload", "recording", &chain)?;
    let bytes = fs::read(&path)?;
    corpus.put("recording", "whole", &bytes)?;
    corpus.put("recording", "cut", &bytes[..bytes.len() * 2 / 3])
}

fn raw_capture(corpus: &Corpus, camera: &Camera, frames: &[DepthFrame], folder: &Path) -> Outcome {
    let path = folder.join("raw.mcap");
    let mut writer = RawWriter::create(target(&path), camera, &WriterOptions::default())?;
    let mut image = Vec::new();
    for frame in &frames[..2] {
        image_message(camera, &frame.depth, &mut image);
        writer.frame(frame.sequence, frame.time, &image)?;
        writer.color(&color(frame))?;
    }
    writer.finish()?;
    let bytes = fs::read(&path)?;
    corpus.put("raw_capture", "whole", &bytes)?;
    corpus.put("raw_capture", "cut", &bytes[..bytes.len() * 2 / 3])
}

fn cloud_payloads(corpus: &Corpus, camera: &Camera, frame: &DepthFrame) -> Outcome {
    let mut saint = SaintFrame::default();
    Modeler::new(camera, &FitOptions::default()).model(frame, &mut saint, &|| false);
    for step_mm in [10, 100] {
        let mut mapper = PolarMapper::new(camera, step_mm as f32 * 1e-3);
        let (map, _) = mapper.map(frame, &saint)?;
        let mut bytes = Vec::new();
        polar::encode(&map, &mut bytes)?;
        corpus.put("cloud_payload", &format!("polar{step_mm}"), &bytes)?;
    }
    let model = MergedModel {
        origin: [1.0, 2.0, 3.0].into(),
        floats: vec![[0.0, 1.0, 2.0, 3.0], [-1.0, 0.5, 9.0, 0.25]],
        grid: PolarGrid::new(200),
        cells: vec![(0, 0), (1, 1), (7000, 0), (79_999, 1)],
    };
    let mut bytes = Vec::new();
    merged::encode(&model, &mut bytes)?;
    corpus.put("cloud_payload", "merged", &bytes)
}

fn cloud_files(corpus: &Corpus) -> Outcome {
    let put = |name: &str, bytes: &[u8]| {
        let ending = name.rsplit('.').next();
        let kind = CLOUDS.iter().position(|known| Some(known.0) == ending);
        corpus.put_kind("cloud_file", name, kind.unwrap_or(0), bytes)
    };
    let ply = "ply\nformat ascii 1.0\ncomment unit m\nelement vertex 2\nproperty float x\nproperty \
               double y\nproperty float z\nproperty uchar red\nelement face 1\nproperty list uchar \
               int vertex_indices\nend_header\n0 1 2 3\n4 5 6.5 7\n2 0 1\n";
    put("ascii.ply", ply.as_bytes())?;
    for order in ["little", "big"] {
        let header = format!(
            "ply\nformat binary_{order}_endian 1.0\nelement vertex 2\nproperty float x\nproperty \
             float y\nproperty float z\nend_header\n"
        );
        let bytes = [header.as_bytes(), &[0x3F; 24]].concat();
        put(&format!("{order}.ply"), &bytes)?;
    }
    for data in ["ascii", "binary", "binary_compressed"] {
        let header = format!(
            "# .PCD v0.7\nVERSION 0.7\nFIELDS x y z rgb\nSIZE 4 4 4 4\nTYPE F F F U\nCOUNT 1 1 1 1\n\
             WIDTH 2\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS 2\nDATA {data}\n"
        );
        let body = match data {
            "ascii" => b"0 1 2 3\n4 5 6 7\n".to_vec(),
            "binary" => vec![0x3F; 32],
            // LZF: 33 bytes, a literal run of 32
            _ => [&[33, 0, 0, 0, 32, 0, 0, 0, 31][..], &[0x3F; 32]].concat(),
        };
        let bytes = [header.as_bytes(), &body].concat();
        put(&format!("{data}.pcd"), &bytes)?;
    }
    let obj = "o thing\nv 1 2 3\nv 4.5 5e-1 -6 1.0\nvn 0 0 1\nf 1 2 2\n";
    put("a.obj", obj.as_bytes())?;
    put("a.xyz", b"# x y z\n1 2 3\n4,5,6\n7;8;9 255\n")?;
    let header = "{'descr': '<f4', 'fortran_order': False, 'shape': (2, 3), }";
    let header = format!("{header:<117}\n");
    let bytes = [b"\x93NUMPY\x01\x00\x76\x00", header.as_bytes(), &[0x3F; 24]].concat();
    put("a.npy", &bytes)
}

fn camera_files(corpus: &Corpus, root: &Path) -> Outcome {
    let put = |name: &str, text: &str| corpus.put("camera_file", name, text.as_bytes());
    let rig = fs::read_to_string(root.join("../../recordings/two_views.toml"))?;
    put("rig", &rig)?;
    put(
        "color",
        "width = 640\nheight = 480\nintrinsics = [525.0, 525.0, 319.5, 239.5]\n\
         matrix = [[1, 0, 0, 0.1], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]\n",
    )?;
    put("four", "525.0,525.0,319.5,239.5")?;
    put("matrix", "525 0 319.5\n0 525 239.5\n0 0 1\n")?;
    put(
        "json",
        "{\"width\": 640, \"height\": 480, \"fx\": 5e2, \"fy\": 500, \"cx\": 320, \"cy\": 240, \
         \"depth_scale_m_per_unit\": 0.001, \"invalid_values\": [0, 65535], \"fps\": 30.0, \
         \"depth_min_m\": 0.2, \"depth_max_m\": 8, \"intrinsic_matrix\": [5, 0, 0, 0, 5, 0, 3, 2, 1]}",
    )?;
    put(
        "yaml",
        "%YAML:1.0\nCamera.fx: 517.3\nCamera.fy: 516.5\nCamera.cx: 318.6\nCamera.cy: 255.3\n\
         Camera.k1: 0.26\nCamera.width: 640\nCamera.height: 480\nDepthMapFactor: 5000.0\n",
    )?;
    put(
        "opencv",
        "%YAML:1.0\n---\nimage_width: 640\ncamera_matrix: !!opencv-matrix\n   rows: 3\n   cols: 3\n   \
         dt: d\n   data: [ 525., 0., 319.5, 0., 525., 239.5, 0., 0., 1. ]\n",
    )?;
    put(
        "synthetic",
        "walk,size=40x30,paced=false,frames=12,seed=3,at=1.3/-0.2/0.6",
    )
}
