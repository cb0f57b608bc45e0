//! What a node offers: formats, sizes, rates.

use super::fourcc::FourCc;
use serde::Serialize;
use std::fmt;

/// A pixel format a node offers.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct OfferedFormat {
    /// Its code.
    pub pixel_format: FourCc,
    /// The driver's words for it.
    pub description: String,
    /// Sizes, where the driver lists them one by one.
    pub sizes: Vec<FrameSize>,
    /// The range of sizes, where the driver gives a range.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub size_range: Option<SizeRange>,
}

/// One image size and its frame rates.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct FrameSize {
    /// Pixels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Frame rates, frames/s; empty where the driver does not list them.
    pub fps: Vec<f64>,
}

/// Sizes in steps: `(width, height)` each.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct SizeRange {
    /// The smallest.
    pub min: (u32, u32),
    /// The largest.
    pub max: (u32, u32),
    /// From one to the next, at least 1.
    pub step: (u32, u32),
}

impl SizeRange {
    /// True when the range has this size.
    #[must_use]
    pub fn holds(&self, (width, height): (u32, u32)) -> bool {
        let fits = |v: u32, min: u32, max: u32, step: u32| {
            v >= min && v <= max && (v - min).is_multiple_of(step.max(1))
        };
        fits(width, self.min.0, self.max.0, self.step.0)
            && fits(height, self.min.1, self.max.1, self.step.1)
    }
}

/// A format's sizes as a sentence has them.
pub(super) struct SizeList<'a>(pub &'a OfferedFormat);

impl fmt::Display for SizeList<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (i, size) in self.0.sizes.iter().enumerate() {
            let comma = if i == 0 { "" } else { ", " };
            write!(f, "{comma}{}x{}", size.width, size.height)?;
        }
        if let Some(SizeRange { min, max, step }) = self.0.size_range {
            write!(f, "{}x{} to {}x{}", min.0, min.1, max.0, max.1)?;
            write!(f, " in steps of {}x{}", step.0, step.1)?;
        }
        Ok(())
    }
}

/// Rates as a sentence has them.
pub(super) struct RateList<'a>(pub &'a [f64]);

impl fmt::Display for RateList<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (i, rate) in self.0.iter().enumerate() {
            let comma = if i == 0 { "" } else { ", " };
            write!(f, "{comma}{}", (rate * 1000.0).round() / 1000.0)?;
        }
        Ok(())
    }
}
