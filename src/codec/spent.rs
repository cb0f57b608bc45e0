//! Where the bits of payloads go.

use serde::{Deserialize, Serialize};
use std::ops::AddAssign;

/// What one frame cost.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
pub struct EncodeReport {
    /// Measured pixels.
    pub valid_pixels: u32,
    /// Those that smoothing the mask took away; all others come back.
    pub lost_pixels: u32,
    /// Pixels that smoothing the mask added.
    pub invented_pixels: u32,
    /// Pixels that touch their sphere after quantisation.
    pub touching_pixels: u32,
    /// Spheres in the frame.
    pub spheres: u32,
    /// Spheres taken from the frame before to the bit.
    pub kept_spheres: u32,
    /// Bytes of header and checksum, and of each section.
    pub header_bytes: u32,
    /// Bytes of the section of blocks: the contact map in the coarse.
    pub block_bytes: u32,
    /// Bytes of the sphere section.
    pub sphere_bytes: u32,
    /// Bytes of the section of pixels: mask and contact map in the fine.
    pub pixel_bytes: u32,
    /// Bytes of the residual section.
    pub residual_bytes: u32,
    /// Bits of the section of blocks that say where anything was measured.
    pub fill_bits: u32,
    /// Bits of the section of pixels that do.
    pub mask_bits: u32,
}

impl EncodeReport {
    /// The payload's bits by what they say.
    #[must_use]
    pub fn spent(&self) -> Spent {
        let bits = |bytes: u32| 8 * u64::from(bytes);
        let (fills, mask) = (u64::from(self.fill_bits), u64::from(self.mask_bits));
        Spent {
            mask: fills + mask,
            palettes: bits(self.block_bytes) - fills,
            spheres: bits(self.sphere_bytes),
            labels: bits(self.pixel_bytes) - mask,
            residual: bits(self.residual_bytes),
            header: bits(self.header_bytes),
        }
    }
}

/// Bits of sensor payloads by what they say. The parts add up to the payloads; where a section holds
/// two of them, the limit between them is known to half a bit.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Spent {
    /// Which pixels hold a measurement: of blocks, of quads, of pixels.
    pub mask: u64,
    /// Which spheres a block touches.
    pub palettes: u64,
    /// The spheres.
    pub spheres: u64,
    /// Which sphere of its block a pixel touches.
    pub labels: u64,
    /// What spheres do not give back.
    pub residual: u64,
    /// Header and checksum.
    pub header: u64,
}

impl Spent {
    /// All of them.
    #[must_use]
    pub fn total(&self) -> u64 {
        self.parts().iter().map(|part| part.1).sum()
    }

    /// Each part with its name, in the order of the fields.
    #[must_use]
    pub fn parts(&self) -> [(&'static str, u64); 6] {
        [
            ("mask", self.mask),
            ("palettes", self.palettes),
            ("spheres", self.spheres),
            ("labels", self.labels),
            ("residual", self.residual),
            ("header", self.header),
        ]
    }
}

impl AddAssign for Spent {
    fn add_assign(&mut self, other: Self) {
        self.mask += other.mask;
        self.palettes += other.palettes;
        self.spheres += other.spheres;
        self.labels += other.labels;
        self.residual += other.residual;
        self.header += other.header;
    }
}

/// `mask 23 %, palettes 21 %, …`, or `nothing`.
impl std::fmt::Display for Spent {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let total = self.total();
        if total == 0 {
            return f.write_str("nothing");
        }
        for (n, (name, bits)) in self.parts().into_iter().enumerate() {
            let comma = if n == 0 { "" } else { ", " };
            let share = 100.0 * bits as f64 / total as f64;
            write!(f, "{comma}{name} {share:.0} %")?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_are_added_and_shown() {
        let mut spent = Spent::default();
        assert_eq!(spent.to_string(), "nothing");
        let one = Spent {
            mask: 1,
            palettes: 2,
            spheres: 3,
            labels: 4,
            residual: 5,
            header: 5,
        };
        spent += one;
        spent += one;
        assert_eq!(spent.total(), 40);
        let shown =
            "mask 5 %, palettes 10 %, spheres 15 %, labels 20 %, residual 25 %, header 25 %";
        assert_eq!(spent.to_string(), shown);
    }
}
