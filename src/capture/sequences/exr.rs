//! Depth images as OpenEXR: one float channel `Z`, planar metres.
//!
//! Sensor integers survive exactly: Z is `raw · unit` rounded to f32, which is off by at most
//! 65535·2⁻²⁴ = 0.004 units, and the attribute `depthUnit` says what to divide by. Metres are
//! what other tools read; whole numbers of units would be smaller on disk and useless to them.
//! Compression is ZIP over 16 lines: lossless.

use super::exr_attributes::{ExrAttributes, sort_header};
use super::{checked_pixels, input};
use crate::capture::CaptureError;
use crate::frame::{Camera, DepthFrame, FrameTime};
use exr::block::reader::ChunksReader;
use exr::meta::attribute::SampleType;
use exr::meta::header::Header;
use exr::prelude::{
    AnyChannel, AnyChannels, Blocks, Compression, Encoding, FlatSamples, Image, Layer,
    LayerAttributes, LineOrder, WritableImage, f16,
};
use std::fs::File;
use std::io::{BufReader, Cursor};
use std::path::Path;

/// The depth channel's name.
const DEPTH_CHANNEL: &str = "Z";
const REPLACE: &str = "the file is damaged or not an EXR image: replace it";

/// One decoded depth channel; its buffer is used again by the next [`read_exr_depth`].
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ExrImage {
    /// Image width, pixels.
    pub width: u32,
    /// Image height, pixels.
    pub height: u32,
    /// The channel's values, row-major, `width * height` of them, as stored (metres when planar).
    pub values: Vec<f32>,
    /// The file stores half floats: 11 significant bits, steps of 2 mm from 2 m on.
    pub half: bool,
    /// Camera and time.
    pub attributes: ExrAttributes,
}

/// Which channel of a file is the depth.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ExrChannel<'a> {
    /// Full name of the channel; without one: `Z`, then `….Z`, then `depth`, then the only one.
    pub name: Option<&'a str>,
    /// Name of the part, or of the layer before the channel's last dot.
    pub layer: Option<&'a str>,
}

/// Reads one depth channel, whatever the file's compression, tiling and data window.
///
/// # Errors
/// [`CaptureError::Input`] names the file: missing, damaged, cut, too large, no such channel.
pub fn read_exr_depth(
    path: &Path,
    channel: ExrChannel<'_>,
    image: &mut ExrImage,
) -> Result<(), CaptureError> {
    let file =
        File::open(path).map_err(|error| input(path, error.to_string(), "check the path"))?;
    let damaged = |error: exr::error::Error| input(path, message(&error), REPLACE);
    let reader = exr::block::read(BufReader::new(file), false).map_err(damaged)?;
    let (part, index) = select(path, reader.headers(), channel)?;
    let header = &reader.headers()[part];
    let (width, height) = (header.layer_size.0, header.layer_size.1);
    let pixels = checked_pixels(path, width as u64, height as u64)?;
    let half = match header.channels.list[index].sample_type {
        SampleType::F16 => true,
        SampleType::F32 => false,
        SampleType::U32 => {
            let what = format!(
                "channel {} holds integers",
                header.channels.list[index].name
            );
            return Err(input(path, what, "write the depth as floats, in metres"));
        }
    };
    image.attributes = ExrAttributes::read(header);
    image.width = width as u32;
    image.height = height as u32;
    image.half = half;
    // Zeros, not old pixels, where a damaged file tells one block twice.
    image.values.clear();
    image.values.resize(pixels, 0.0);

    let channels = header.channels.clone();
    let mut filled = 0usize;
    let mut halves = vec![f16::ZERO; if half { width } else { 0 }];
    reader
        .filter_chunks(false, |_, tile, block| {
            block.layer == part && tile.level_index.0 == 0 && tile.level_index.1 == 0
        })
        .and_then(|chunks| {
            chunks.decompress_sequential(false, |_, block| {
                for line in block.lines(&channels) {
                    let (at, count) = (line.location.position, line.location.sample_count);
                    if line.location.channel != index {
                        continue;
                    }
                    let start = at.1 * width + at.0;
                    let row = image
                        .values
                        .get_mut(start..start + count)
                        .filter(|_| at.0 + count <= width)
                        .ok_or(exr::error::Error::Invalid("line outside the image".into()))?;
                    if half {
                        line.read_samples_into_slice(&mut halves[..count])?;
                        for (value, half) in row.iter_mut().zip(&halves) {
                            *value = half.to_f32();
                        }
                    } else {
                        line.read_samples_into_slice(row)?;
                    }
                    filled += count;
                }
                Ok(())
            })
        })
        .map_err(damaged)?;
    if filled != pixels {
        let what = format!("{filled} of {pixels} pixels are there");
        return Err(input(path, what, REPLACE));
    }
    Ok(())
}

/// Writes sensor integers so that reading gives exactly the same integers.
///
/// Codes the camera lists as invalid are written like depths; readers know them by the attribute
/// `invalidCodes`. An existing file is replaced: ask before.
///
/// # Errors
/// [`CaptureError::Usage`] when the frame is not of the camera's size, [`CaptureError::Input`]
/// when the file cannot be written.
pub fn write_exr_depth(
    path: &Path,
    camera: &Camera,
    frame: &DepthFrame,
) -> Result<(), CaptureError> {
    check_size(camera, frame.depth.len()).map_err(|what| wrong_size(path, &what))?;
    let file = encode_exr_depth(camera, frame).map_err(|what| unwritable(path, what))?;
    std::fs::write(path, file).map_err(|error| unwritable(path, error.to_string()))
}

/// The bytes of the file that [`write_exr_depth`] writes.
///
/// # Errors
/// The frame is not of the camera's size, or what the encoder says.
pub fn encode_exr_depth(camera: &Camera, frame: &DepthFrame) -> Result<Vec<u8>, String> {
    let unit = camera.depth_unit_m;
    let values = frame
        .depth
        .iter()
        .map(|&raw| (f64::from(raw) * unit) as f32);
    let attributes = ExrAttributes::of_frame(camera, frame.sequence, frame.time);
    encode(camera, values.collect(), &attributes)
}

/// Writes planar depth in metres (0: no measurement), such as a decoded frame.
///
/// It is not made of whole units, so the file names no `depthUnit` and no invalid codes.
///
/// # Errors
/// As [`write_exr_depth`].
pub fn write_exr_metres(
    path: &Path,
    camera: &Camera,
    sequence: u64,
    time: FrameTime,
    depth_m: &[f32],
) -> Result<(), CaptureError> {
    let attributes = ExrAttributes {
        depth_unit_m: None,
        invalid: None,
        ..ExrAttributes::of_frame(camera, sequence, time)
    };
    check_size(camera, depth_m.len()).map_err(|what| wrong_size(path, &what))?;
    let file = encode(camera, depth_m.to_vec(), &attributes);
    let file = file.map_err(|what| unwritable(path, what))?;
    std::fs::write(path, file).map_err(|error| unwritable(path, error.to_string()))
}

fn check_size(camera: &Camera, pixels: usize) -> Result<(), String> {
    if pixels == camera.pixels() && pixels > 0 {
        return Ok(());
    }
    let (width, height) = (camera.width, camera.height);
    Err(format!(
        "a frame of {pixels} pixels for a camera of {width}x{height}"
    ))
}

fn wrong_size(path: &Path, what: &str) -> CaptureError {
    CaptureError::Usage(format!("{}: {what}", path.display()))
}

fn unwritable(path: &Path, what: String) -> CaptureError {
    input(path, what, "check the folder and the space left")
}

fn encode(
    camera: &Camera,
    values: Vec<f32>,
    attributes: &ExrAttributes,
) -> Result<Vec<u8>, String> {
    check_size(camera, values.len())?;
    let mut layer_attributes = LayerAttributes::default();
    attributes.write(&mut layer_attributes);
    let encoding = Encoding {
        compression: Compression::ZIP16,
        blocks: Blocks::ScanLines,
        line_order: LineOrder::Increasing,
    };
    let channel = AnyChannel::new(DEPTH_CHANNEL, FlatSamples::F32(values));
    let layer = Layer::new(
        (camera.width as usize, camera.height as usize),
        layer_attributes,
        encoding,
        AnyChannels::sort(std::iter::once(channel).collect()),
    );
    let mut file = Vec::new();
    Image::from_layer(layer)
        .write()
        .non_parallel()
        .to_buffered(Cursor::new(&mut file))
        .map_err(|error| message(&error))?;
    sort_header(&mut file);
    Ok(file)
}

/// Part and channel that hold the depth.
fn select(
    path: &Path,
    headers: &[Header],
    wanted: ExrChannel<'_>,
) -> Result<(usize, usize), CaptureError> {
    let mut names = Vec::new();
    let mut found = Vec::new();
    for (part, header) in headers.iter().enumerate() {
        let part_name = header.own_attributes.layer_name.as_ref();
        for (index, channel) in header.channels.list.iter().enumerate() {
            let name = String::from_utf8_lossy(channel.name.bytes()).into_owned();
            let in_layer = wanted.layer.is_none_or(|layer| {
                part_name.is_some_and(|part_name| part_name.eq(layer))
                    || name
                        .strip_prefix(layer)
                        .is_some_and(|rest| rest.starts_with('.'))
            });
            if in_layer {
                found.push((part, index, names.len()));
            }
            names.push(name);
        }
    }
    let last = |name: &str| {
        name.rsplit('.')
            .next()
            .unwrap_or_default()
            .to_ascii_lowercase()
    };
    let pick = |test: &dyn Fn(&str) -> bool| found.iter().find(|(.., at)| test(&names[*at]));
    let picked = match wanted.name {
        Some(wanted) => pick(&|name| name == wanted),
        None => pick(&|name| name == DEPTH_CHANNEL)
            .or_else(|| pick(&|name| last(name) == "z"))
            .or_else(|| pick(&|name| last(name) == "depth"))
            .or_else(|| found.first().filter(|_| found.len() == 1)),
    };
    let Some((part, index, _)) = picked.copied() else {
        let asked = wanted.name.unwrap_or(DEPTH_CHANNEL);
        let layer = wanted.layer.map(|layer| format!(" in layer {layer}"));
        return Err(input(
            path,
            format!(
                "no channel {asked}{} among: {}",
                layer.unwrap_or_default(),
                names.join(", ")
            ),
            "name the depth channel with --exr-channel",
        ));
    };
    let header = &headers[part];
    let sampled = header
        .channels
        .list
        .iter()
        .any(|channel| channel.sampling.area() != 1);
    if header.deep || sampled {
        let what = if header.deep {
            "a deep image"
        } else {
            "subsampled channels"
        };
        return Err(input(
            path,
            what,
            "write a flat image with full-size channels",
        ));
    }
    Ok((part, index))
}

/// The crate's message without its variant names.
fn message(error: &exr::error::Error) -> String {
    use exr::error::Error;
    match error {
        Error::Aborted => "aborted".to_owned(),
        Error::NotSupported(what) => format!("not supported: {what}"),
        Error::Invalid(what) => format!("invalid: {what}"),
        Error::Io(error) if error.kind() == std::io::ErrorKind::UnexpectedEof => {
            "the file ends too early".to_owned()
        }
        Error::Io(error) => error.to_string(),
    }
}

#[cfg(test)]
#[path = "exr_tests.rs"]
mod tests;
