//! The peers: general and depth codecs, each frame by itself, all without loss.

use flate2::{read::GzDecoder, write::GzEncoder};
use image::codecs::png::{CompressionType, FilterType, PngDecoder, PngEncoder};
use image::{ExtendedColorType, ImageDecoder, ImageEncoder};
use saint_live::capture::containers::rvl;
use saint_live::deproject::Rays;
use std::error::Error;
use std::io::{Cursor, Read, Write};

/// A codec beside ours.
#[derive(Clone, Copy, Debug)]
pub enum Peer {
    /// 16-bit PNG, rows filtered by the rows above, fast deflate: how this program writes PNG.
    Png,
    /// Zstandard, level 3, of the depth integers.
    Zstd,
    /// gzip, level 6, of the points as three floats each: the baseline of the 3DSAINT paper.
    GzipPoints,
    /// RVL (Wilson 2017).
    Rvl,
}

impl Peer {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::Png, Self::Zstd, Self::GzipPoints, Self::Rvl];

    /// As the table names it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Png => "PNG",
            Self::Zstd => "zstd -3, u16",
            Self::GzipPoints => "gzip, float xyz",
            Self::Rvl => "RVL",
        }
    }

    /// Replaces `bytes` by the frame.
    pub fn encode(
        self,
        rays: &Rays,
        depth: &[u16],
        bytes: &mut Vec<u8>,
    ) -> Result<(), Box<dyn Error>> {
        bytes.clear();
        match self {
            Self::Png => {
                let raw = integers(depth);
                PngEncoder::new_with_quality(bytes, CompressionType::Fast, FilterType::Up)
                    .write_image(
                        &raw,
                        rays.width as u32,
                        rays.height as u32,
                        ExtendedColorType::L16,
                    )?;
            }
            Self::Zstd => *bytes = zstd::bulk::compress(&integers(depth), 3)?,
            Self::GzipPoints => {
                let mut coder = GzEncoder::new(bytes, flate2::Compression::new(6));
                coder.write_all(&points(rays, depth))?;
                coder.finish()?;
            }
            Self::Rvl => {
                bytes.clear();
                rvl::encode(depth, bytes);
            }
        }
        Ok(())
    }

    /// What comes back.
    pub fn decode(self, rays: &Rays, bytes: &[u8]) -> Result<Decoded, Box<dyn Error>> {
        let pixels = rays.width * rays.height;
        Ok(match self {
            Self::Png => {
                let mut raw = vec![0; 2 * pixels];
                PngDecoder::new(Cursor::new(bytes))?.read_image(&mut raw)?;
                Decoded::Integers(from_bytes(&raw))
            }
            Self::Zstd => {
                Decoded::Integers(from_bytes(&zstd::bulk::decompress(bytes, 2 * pixels)?))
            }
            Self::GzipPoints => {
                let mut raw = Vec::with_capacity(12 * pixels);
                GzDecoder::new(bytes).read_to_end(&mut raw)?;
                Decoded::Points(raw)
            }
            Self::Rvl => {
                let mut depth = Vec::with_capacity(pixels);
                rvl::decode(bytes, pixels, &mut depth)?;
                Decoded::Integers(depth)
            }
        })
    }
}

/// What a peer gives back.
pub enum Decoded {
    /// Depth integers.
    Integers(Vec<u16>),
    /// Points, three little-endian floats each.
    Points(Vec<u8>),
}

impl Decoded {
    /// True where it is the frame that went in.
    pub fn equals(&self, rays: &Rays, depth: &[u16]) -> bool {
        match self {
            Self::Integers(back) => back == depth,
            Self::Points(back) => *back == points(rays, depth),
        }
    }
}

fn integers(depth: &[u16]) -> Vec<u8> {
    depth.iter().flat_map(|raw| raw.to_ne_bytes()).collect()
}

fn from_bytes(raw: &[u8]) -> Vec<u16> {
    let (pairs, _) = raw.as_chunks::<2>();
    pairs.iter().map(|pair| u16::from_ne_bytes(*pair)).collect()
}

fn points(rays: &Rays, depth: &[u16]) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(12 * depth.len());
    for (row, v) in depth.chunks_exact(rays.width).zip(&rays.v) {
        for (raw, u) in row.iter().zip(&rays.u).filter(|(raw, _)| **raw != 0) {
            let z = f32::from(*raw) * rays.unit;
            for value in [u * z, v * z, z] {
                bytes.extend_from_slice(&value.to_le_bytes());
            }
        }
    }
    bytes
}
