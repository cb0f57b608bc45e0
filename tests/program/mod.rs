//! The program as a test runs it, and the files it reads and writes as others read them.

#![allow(dead_code, reason = "each test binary uses a part of it")]

use assert_cmd::Command;
use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::process::Output;

/// Runs the program; on a wrong exit code everything it said is printed.
#[track_caller]
pub fn run<I, S>(arguments: I, code: i32) -> (String, String)
where
    I: IntoIterator<Item = S>,
    S: AsRef<OsStr>,
{
    let output = run_bytes(arguments, code);
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    (text(&output.stdout), text(&output.stderr))
}

/// As [`run`], with the bytes of standard output.
#[track_caller]
pub fn run_bytes<I, S>(arguments: I, code: i32) -> Output
where
    I: IntoIterator<Item = S>,
    S: AsRef<OsStr>,
{
    let mut command = Command::cargo_bin("saint-live").unwrap();
    let output = command.args(arguments).output().unwrap();
    assert_eq!(
        output.status.code(),
        Some(code),
        "\ncommand: {command:?}\nstatus: {}\nstdout: {}\nstderr: {}\n",
        output.status,
        String::from_utf8_lossy(&output.stdout),
        String::from_utf8_lossy(&output.stderr),
    );
    output
}

/// One JSON value.
#[track_caller]
pub fn json(text: &str) -> serde_json::Value {
    serde_json::from_str(text).unwrap_or_else(|error| panic!("{error}: {text}"))
}

/// `info FILE --json`.
#[track_caller]
pub fn info(recording: &Path) -> serde_json::Value {
    json(&run(["info", text(recording), "--json"], 0).0)
}

/// A path of a test is UTF-8.
pub fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// A folder of this repository.
pub fn repository(folder: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(folder)
}

/// The files of a folder that end so, in the order of their names.
pub fn files(folder: &Path, extension: &str) -> Vec<PathBuf> {
    let mut files: Vec<_> = std::fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.extension().is_some_and(|end| end == extension))
        .collect();
    files.sort();
    files
}

/// A depth image as numbers, row-major.
pub struct Plane {
    pub width: usize,
    pub values: Vec<f32>,
}

/// Channel `Z` of an EXR file, read by the `exr` crate alone.
#[track_caller]
pub fn read_exr(path: &Path) -> Plane {
    let image = exr::prelude::read_first_flat_layer_from_file(path).unwrap();
    let layer = image.layer_data;
    let channel = layer
        .channel_data
        .list
        .iter()
        .find(|c| c.name.eq("Z"))
        .unwrap();
    Plane {
        width: layer.size.0,
        values: channel.sample_data.values_as_f32().collect(),
    }
}

/// Writes channel `Z` of an EXR file without any attribute of ours.
pub fn write_exr(path: &Path, width: usize, values: &[f32]) {
    use exr::prelude::*;
    let channel = AnyChannel::new("Z", FlatSamples::F32(values.to_vec()));
    let layer = Layer::new(
        (width, values.len() / width),
        LayerAttributes::default(),
        Encoding::FAST_LOSSLESS,
        AnyChannels::sort(smallvec_of(channel)),
    );
    Image::from_layer(layer).write().to_file(path).unwrap();
}

fn smallvec_of<T>(
    one: exr::prelude::AnyChannel<T>,
) -> exr::prelude::SmallVec<[exr::prelude::AnyChannel<T>; 4]> {
    let mut list = exr::prelude::SmallVec::new();
    list.push(one);
    list
}

/// Integers of a 16-bit PNG, read by the `image` crate alone.
#[track_caller]
pub fn read_png16(path: &Path) -> Vec<u16> {
    image::open(path).unwrap().into_luma16().into_raw()
}
