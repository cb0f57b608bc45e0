//! Colour images as a camera sends them: cut to their bytes, or packed as PNG. Pure.

use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder};

/// The JPEG image at the start of `bytes`, without what follows it in the driver's buffer.
///
/// `None` when it does not start or end as one: a damaged frame. The scan walks the segments, so
/// the end of an older, longer image further on is not taken for this one's.
#[must_use]
pub fn jpeg_image(bytes: &[u8]) -> Option<&[u8]> {
    const START: u8 = 0xd8;
    const END: u8 = 0xd9;
    const SCAN: u8 = 0xda;
    if bytes.get(..2)? != [0xff, START] {
        return None;
    }
    let mut at = 2;
    loop {
        if *bytes.get(at)? != 0xff {
            return None;
        }
        let marker = *bytes.get(at + 1)?;
        match marker {
            END => return bytes.get(..at + 2),
            // A fill byte before the marker.
            0xff => at += 1,
            // Markers without a segment.
            0x01 | 0xd0..=0xd7 => at += 2,
            _ => {
                let length = u16::from_be_bytes([*bytes.get(at + 2)?, *bytes.get(at + 3)?]);
                if length < 2 {
                    return None;
                }
                at += 2 + usize::from(length);
                if marker == SCAN {
                    at += scan_length(bytes.get(at..)?)?;
                }
            }
        }
    }
}

/// Bytes of entropy-coded data up to the next marker that ends it.
fn scan_length(data: &[u8]) -> Option<usize> {
    data.windows(2)
        // 0xff00 is a data byte, 0xffd0..7 restart the coder.
        .position(|pair| pair[0] == 0xff && !matches!(pair[1], 0x00 | 0xd0..=0xd7 | 0xff))
}

/// Packs a YUYV image (two pixels in four bytes, BT.601 video range) as PNG.
///
/// `None` when there are fewer bytes than pixels need, the width is odd, or the image is empty.
#[must_use]
pub fn png_of_yuyv(bytes: &[u8], width: u32, height: u32) -> Option<Vec<u8>> {
    let pixels = usize::try_from(width)
        .ok()?
        .checked_mul(usize::try_from(height).ok()?)?;
    let bytes = bytes.get(..pixels.checked_mul(2)?)?;
    if pixels == 0 || width % 2 != 0 {
        return None;
    }
    let mut rgb = Vec::with_capacity(pixels * 3);
    for pair in bytes.chunks_exact(4) {
        rgb.extend(rgb_of_yuv(pair[0], pair[1], pair[3]));
        rgb.extend(rgb_of_yuv(pair[2], pair[1], pair[3]));
    }
    let mut png = Vec::new();
    PngEncoder::new_with_quality(&mut png, CompressionType::Fast, FilterType::Sub)
        .write_image(&rgb, width, height, ExtendedColorType::Rgb8)
        .ok()?;
    Some(png)
}

/// BT.601, video range, in 1/256 with rounding.
fn rgb_of_yuv(y: u8, u: u8, v: u8) -> [u8; 3] {
    let (y, u, v) = (
        298 * (i32::from(y) - 16),
        i32::from(u) - 128,
        i32::from(v) - 128,
    );
    let channel = |sum: i32| ((sum + 128) >> 8).clamp(0, 255) as u8;
    [
        channel(y + 409 * v),
        channel(y - 100 * u - 208 * v),
        channel(y + 516 * u),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A minimal image: two segments, a scan with a stuffed byte and a restart, an end.
    fn jpeg() -> Vec<u8> {
        let mut image = vec![0xff, 0xd8];
        image.extend([0xff, 0xe0, 0, 4, 0xff, 0xd9]); // the end marker inside a segment
        image.extend([0xff, 0xff, 0xdb, 0, 3, 9]); // a fill byte
        image.extend([
            0xff, 0xda, 0, 3, 1, 0x12, 0xff, 0x00, 0x34, 0xff, 0xd3, 0x56,
        ]);
        image.extend([0xff, 0xd9]);
        image
    }

    #[test]
    fn an_image_is_cut_at_its_own_end() {
        let image = jpeg();
        assert_eq!(jpeg_image(&image), Some(&image[..]));
        let mut buffer = image.clone();
        buffer.extend([0, 1, 2, 0xff, 0xd9, 0xff]);
        assert_eq!(
            jpeg_image(&buffer),
            Some(&image[..]),
            "an older image's end is beyond"
        );
    }

    #[test]
    fn every_cut_of_an_image_is_damaged() {
        let image = jpeg();
        for end in 0..image.len() {
            assert_eq!(jpeg_image(&image[..end]), None, "{end}");
        }
        for at in [0, 1, 2] {
            let mut other = image.clone();
            other[at] ^= 0x11;
            assert_eq!(jpeg_image(&other), None, "{at}");
        }
        assert_eq!(
            jpeg_image(&[0xff, 0xd8, 0xff, 0xe0, 0, 1, 0xff, 0xd9]),
            None
        );
    }

    #[test]
    fn yuyv_becomes_the_textbook_colours() {
        // y, u, v of BT.601 video range and their RGB.
        for (y, u, v, want) in [
            (16, 128, 128, [0, 0, 0]),
            (235, 128, 128, [255, 255, 255]),
            (81, 90, 240, [255, 0, 0]),
            (145, 54, 34, [0, 255, 0]),
            (41, 240, 110, [0, 0, 255]),
        ] {
            let got = rgb_of_yuv(y, u, v);
            for (a, b) in got.iter().zip(want) {
                assert!(
                    i32::from(*a).abs_diff(b) <= 2,
                    "{got:?} instead of {want:?}"
                );
            }
        }
    }

    #[test]
    fn a_png_holds_both_pixels_of_a_pair() {
        let png = png_of_yuyv(&[16, 128, 235, 128, 235, 128, 16, 128], 2, 2).unwrap();
        let image = image::load_from_memory(&png).unwrap().into_rgb8();
        assert_eq!(image.dimensions(), (2, 2));
        assert_eq!(image.as_raw()[..6], [0, 0, 0, 255, 255, 255]);
        assert_eq!(image.as_raw()[6..], [255, 255, 255, 0, 0, 0]);
    }

    #[test]
    fn a_short_odd_or_empty_image_is_refused() {
        assert_eq!(png_of_yuyv(&[0; 7], 2, 2), None);
        assert_eq!(png_of_yuyv(&[0; 12], 3, 2), None);
        assert_eq!(png_of_yuyv(&[], 0, 2), None);
        assert_eq!(png_of_yuyv(&[0; 8], u32::MAX, u32::MAX), None);
    }
}
