//! A picture of a frame: each pixel in its sphere's colour, darker with depth, black where
//! nothing was measured.

use super::{ExportFrame, color, is_measured, sphere_of};
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder};

/// A small RGB picture.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Picture {
    /// Width, pixels.
    pub width: u32,
    /// Height, pixels.
    pub height: u32,
    /// Row-major, three bytes (red, green, blue) per pixel.
    pub rgb: Vec<u8>,
}

/// Draws the frame at `width`×`height` into `picture`, whose buffer is used again. Each pixel of
/// the picture is the frame's pixel at its middle. For a preview in a terminal, where a cell is
/// twice as high as wide and a half block shows two pixels, take one pixel per column and two per
/// row.
///
/// A frame whose lengths do not fit its camera ([`ExportFrame::check`]) gives black.
pub fn draw(frame: &ExportFrame<'_>, (width, height): (u32, u32), picture: &mut Picture) {
    picture.width = width;
    picture.height = height;
    picture.rgb.clear();
    picture.rgb.resize(width as usize * height as usize * 3, 0);
    if frame.check().is_err() || picture.rgb.is_empty() {
        return;
    }
    let middle = |at: u32, of: u32, full: u32| {
        ((2 * u64::from(at) + 1) * u64::from(full) / (2 * u64::from(of))) as usize
    };
    let across: Vec<_> = (0..width)
        .map(|u| middle(u, width, frame.camera.width))
        .collect();
    let rows = picture.rgb.chunks_exact_mut(width as usize * 3);
    for (v, row) in (0..height).zip(rows) {
        let start = middle(v, height, frame.camera.height) * frame.camera.width as usize;
        for (pixel, u) in row.chunks_exact_mut(3).zip(&across) {
            let z = frame.depth_m[start + u];
            if is_measured(z) {
                let plain = color::of_sphere(sphere_of(frame.labels[start + u]));
                pixel.copy_from_slice(&color::shaded(plain, z));
            }
        }
    }
}

/// Replaces `file` by the frame's picture at its own size, as PNG.
///
/// # Errors
/// What the encoder says.
pub fn picture(frame: &ExportFrame<'_>, file: &mut Vec<u8>) -> Result<(), String> {
    let mut picture = Picture::default();
    draw(
        frame,
        (frame.camera.width, frame.camera.height),
        &mut picture,
    );
    file.clear();
    PngEncoder::new_with_quality(file, CompressionType::Fast, FilterType::Sub)
        .write_image(
            &picture.rgb,
            picture.width,
            picture.height,
            ExtendedColorType::Rgb8,
        )
        .map_err(|e| e.to_string())
}
