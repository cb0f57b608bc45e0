//! Pixels out of image messages: plain rows, and the two forms of `compressedDepth`.

use super::super::rvl;
use super::super::{DepthImage, Stored};
use super::messages::{CompressedImage, Image};
use crate::capture::sequences::pixel_count;
use crate::capture::sequences::png::decode_png_depth;
use std::io::Cursor;

/// Bytes of `compressedDepth` before the data: a format and the two parameters of its inverse depth.
const DEPTH_HEADER: usize = 12;

/// What the integers or floats of a depth image are; `None` for every other encoding.
pub(super) fn stored(encoding: &str) -> Option<Stored> {
    match encoding {
        "16UC1" | "mono16" | "Z16" => Some(Stored::Integers),
        "32FC1" => Some(Stored::Metres),
        _ => None,
    }
}

/// The encoding before compression: `16UC1; compressedDepth png` was 16UC1.
pub(super) fn compressed_stored(format: &str) -> Option<Stored> {
    let (encoding, how) = format.split_once(';')?;
    let lossless = how.contains("compressedDepth") || how.contains("png");
    stored(encoding.trim()).filter(|_| lossless)
}

/// Copies the rows of an image; says what is wrong with it.
pub(super) fn decode(message: &Image<'_>, out: &mut DepthImage) -> Result<(), String> {
    let (width, height) = (message.width, message.height);
    pixel_count(u64::from(width), u64::from(height))?;
    let kind = stored(message.encoding)
        .ok_or_else(|| format!("the encoding is now {}", message.encoding))?;
    let sample = match kind {
        Stored::Integers => 2,
        Stored::Metres => 4,
    };
    let (row, step) = (width as usize * sample, message.step as usize);
    let needed = step.saturating_mul(height as usize - 1).saturating_add(row);
    if step < row || message.data.len() < needed {
        return Err(format!(
            "{} bytes in rows of {step} are no {width}x{height} image of {sample} bytes a pixel",
            message.data.len()
        ));
    }
    (out.width, out.height, out.stored) = (width, height, kind);
    let rows = message.data.chunks(step).take(height as usize);
    let rows = rows.map(|bytes| &bytes[..row]);
    match kind {
        Stored::Integers => {
            let integer = if message.big_endian {
                u16::from_be_bytes
            } else {
                u16::from_le_bytes
            };
            out.integers.clear();
            for row in rows {
                out.integers
                    .extend(row.as_chunks::<2>().0.iter().map(|bytes| integer(*bytes)));
            }
        }
        Stored::Metres => {
            let float = if message.big_endian {
                f32::from_be_bytes
            } else {
                f32::from_le_bytes
            };
            out.metres.clear();
            for row in rows {
                out.metres
                    .extend(row.as_chunks::<4>().0.iter().map(|bytes| float(*bytes)));
            }
        }
    }
    Ok(())
}

/// Decompresses an image; `scratch` is used again by the next call.
///
/// `compressedDepth` codes 32FC1 as integers q of inverse depth, z = a / (q − b), 0 where nothing
/// was measured; a and b stand before the data.
pub(super) fn decode_compressed(
    message: &CompressedImage<'_>,
    scratch: &mut Vec<u8>,
    out: &mut DepthImage,
) -> Result<(), String> {
    let kind = compressed_stored(message.format)
        .ok_or_else(|| format!("the format is now \"{}\"", message.format))?;
    let cut = || format!("its {} bytes end too early", message.data.len());
    let mut data = message.data;
    let mut inverse = [0.0f32; 2];
    if message.format.contains("compressedDepth") {
        let (header, rest) = data.split_at_checked(DEPTH_HEADER).ok_or_else(cut)?;
        for (value, bytes) in inverse.iter_mut().zip(header[4..].as_chunks::<4>().0) {
            *value = f32::from_le_bytes(*bytes);
        }
        data = rest;
    }
    if message.format.contains("rvl") {
        let mut side = || {
            let (bytes, rest) = data.split_first_chunk::<4>()?;
            data = rest;
            Some(u32::from_le_bytes(*bytes))
        };
        let (width, height) = side().zip(side()).ok_or_else(cut)?;
        let pixels = pixel_count(u64::from(width), u64::from(height))?;
        rvl::decode(data, pixels, &mut out.integers).map_err(|error| error.to_string())?;
        (out.width, out.height) = (width, height);
    } else {
        let size = decode_png_depth(Cursor::new(data), scratch, &mut out.integers)?;
        (out.width, out.height) = size;
    }
    out.stored = kind;
    if kind == Stored::Metres {
        let [a, b] = inverse;
        out.metres.clear();
        out.metres.extend(out.integers.iter().map(|&q| match q {
            0 => 0.0,
            q => a / (f32::from(q) - b),
        }));
    }
    Ok(())
}
