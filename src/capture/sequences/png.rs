//! Depth images as 16-bit grey PNG: the sensor's integers, unchanged.

use super::{input, pixel_count};
use crate::capture::CaptureError;
use image::codecs::png::{CompressionType, FilterType, PngDecoder, PngEncoder};
use image::{ColorType, ExtendedColorType, ImageDecoder, ImageEncoder};
use std::fs::File;
use std::io::{BufRead, BufReader, Seek};
use std::path::Path;

const REPLACE: &str = "give undamaged 16-bit PNG images of depth, not pictures of it";

/// Reads one image into `depth` (row-major); gives width and height, pixels. `bytes` is scratch,
/// used again by the next call.
///
/// # Errors
/// [`CaptureError::Input`] names the file: missing, damaged, cut, 8-bit, colour.
pub fn read_png_depth(
    path: &Path,
    bytes: &mut Vec<u8>,
    depth: &mut Vec<u16>,
) -> Result<(u32, u32), CaptureError> {
    let file =
        File::open(path).map_err(|error| input(path, error.to_string(), "check the path"))?;
    decode_png_depth(BufReader::new(file), bytes, depth).map_err(|what| input(path, what, REPLACE))
}

/// The same for an image that lies anywhere; says what is wrong with it.
pub(in crate::capture) fn decode_png_depth(
    from: impl BufRead + Seek,
    bytes: &mut Vec<u8>,
    depth: &mut Vec<u16>,
) -> Result<(u32, u32), String> {
    let damaged = |error: image::ImageError| error.to_string();
    let decoder = PngDecoder::new(from).map_err(damaged)?;
    let (width, height) = decoder.dimensions();
    let pixels = pixel_count(u64::from(width), u64::from(height))?;
    if decoder.color_type() != ColorType::L16 {
        return Err(match decoder.color_type() {
            ColorType::L8 => "an 8-bit image, but depth has 16 bits".to_owned(),
            other => format!("a {other:?} image, but depth is 16-bit grey"),
        });
    }
    bytes.resize(pixels * 2, 0);
    decoder.read_image(bytes).map_err(damaged)?;
    depth.clear();
    let (pairs, _) = bytes.as_chunks::<2>();
    depth.extend(pairs.iter().map(|pair| u16::from_ne_bytes(*pair)));
    Ok((width, height))
}

/// Writes depth integers (row-major, `width * height` of them). An existing file is replaced.
///
/// # Errors
/// [`CaptureError::Usage`] when the size does not match, [`CaptureError::Input`] when the file
/// cannot be written.
pub fn write_png_depth(
    path: &Path,
    width: u32,
    height: u32,
    depth: &[u16],
) -> Result<(), CaptureError> {
    if depth.len() as u64 != u64::from(width) * u64::from(height) || depth.is_empty() {
        let (path, pixels) = (path.display(), depth.len());
        return Err(CaptureError::Usage(format!(
            "{path}: a frame of {pixels} pixels for an image of {width}x{height}"
        )));
    }
    let failed = |what: String| input(path, what, "check the folder and the space left");
    let mut file = Vec::new();
    encode_png_depth(width, height, depth, &mut file).map_err(failed)?;
    std::fs::write(path, file).map_err(|error| failed(error.to_string()))
}

/// Appends the image file's bytes to `file`.
///
/// # Errors
/// What the encoder says, such as a size that is not that of `depth`.
pub fn encode_png_depth(
    width: u32,
    height: u32,
    depth: &[u16],
    file: &mut Vec<u8>,
) -> Result<(), String> {
    let pixels = u64::from(width) * u64::from(height);
    if depth.len() as u64 != pixels {
        let given = depth.len();
        return Err(format!("{given} pixels for an image of {width}x{height}"));
    }
    let bytes: Vec<u8> = depth.iter().flat_map(|raw| raw.to_ne_bytes()).collect();
    // Depth rows look like the rows above: the Up filter alone is as small as trying all.
    PngEncoder::new_with_quality(file, CompressionType::Fast, FilterType::Up)
        .write_image(&bytes, width, height, ExtendedColorType::L16)
        .map_err(|error| error.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_codes_survive() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.png");
        let depth: Vec<u16> = (0..=u16::MAX).collect();
        write_png_depth(&path, 256, 256, &depth).unwrap();
        let (mut bytes, mut back) = (Vec::new(), vec![1]);
        assert_eq!(
            read_png_depth(&path, &mut bytes, &mut back).unwrap(),
            (256, 256)
        );
        assert_eq!(back, depth);
        assert!(write_png_depth(&path, 255, 256, &depth).is_err());
    }
}
