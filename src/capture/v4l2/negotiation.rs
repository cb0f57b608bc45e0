//! Which format, size and rate to ask a camera for, and whether it gave them. Pure.

use super::depth_format::DepthFormat;
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
    fn holds(&self, (width, height): (u32, u32)) -> bool {
        let fits = |v: u32, min: u32, max: u32, step: u32| {
            v >= min && v <= max && (v - min) % step.max(1) == 0
        };
        fits(width, self.min.0, self.max.0, self.step.0)
            && fits(height, self.min.1, self.max.1, self.step.1)
    }
}

/// What the user asked for; `None` leaves the choice to us.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Wish {
    /// Pixel format.
    pub format: Option<DepthFormat>,
    /// Width and height.
    pub size: Option<(u32, u32)>,
    /// Frames per second.
    pub fps: Option<u32>,
}

/// What to ask the driver for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Plan {
    /// Pixel format.
    pub format: DepthFormat,
    /// Pixels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Frames per second; `None` leaves it to the driver.
    pub fps: Option<f64>,
}

/// What the driver gave.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Granted {
    /// Pixel format.
    pub format: FourCc,
    /// Pixels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Bytes per row; 0 where the driver does not say.
    pub stride: u32,
    /// Frames per second, where the driver says.
    pub fps: Option<f64>,
}

/// Why camera and wish do not meet.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Mismatch {
    /// What was asked and what there is.
    pub what: String,
    /// What to do.
    pub remedy: String,
}

/// The size chosen when none is asked: the one of this many pixels, or the nearest.
const USUAL_PIXELS: u64 = 640 * 480;
/// The rate chosen when none is asked: the fastest up to this, frames/s.
const USUAL_FPS: f64 = 30.0;
/// 29.97 passes for 30.
const FPS_TOLERANCE: f64 = 0.02;

/// Chooses what to ask a node for.
///
/// # Errors
/// [`Mismatch`] names what was asked and lists what the node offers.
pub fn plan(wish: &Wish, offered: &[OfferedFormat]) -> Result<Plan, Mismatch> {
    let format = plan_format(wish, offered)?;
    let offer = offered
        .iter()
        .find(|o| o.pixel_format == format.fourcc())
        .ok_or_else(|| no_such_format(&format.fourcc(), offered))?;
    let (size, fps) = plan_size_and_rate(wish.size, wish.fps, offer)?;
    Ok(Plan {
        format,
        width: size.0,
        height: size.1,
        fps,
    })
}

/// Chooses the size and the rate to ask for, of one format.
///
/// # Errors
/// [`Mismatch`] names what was asked and lists what the format comes in.
pub fn plan_size_and_rate(
    size: Option<(u32, u32)>,
    fps: Option<u32>,
    offer: &OfferedFormat,
) -> Result<((u32, u32), Option<f64>), Mismatch> {
    let size = plan_size(size, offer)?;
    let listed = offer.sizes.iter().find(|s| (s.width, s.height) == size);
    let fps = plan_rate(fps, listed.map_or(&[], |s| &s.fps), size)?;
    Ok((size, fps))
}

fn plan_format(wish: &Wish, offered: &[OfferedFormat]) -> Result<DepthFormat, Mismatch> {
    if let Some(format) = wish.format {
        return Ok(format);
    }
    let has = |f: DepthFormat| offered.iter().any(|o| o.pixel_format == f.fourcc());
    if has(DepthFormat::Z16) {
        return Ok(DepthFormat::Z16);
    }
    match DepthFormat::ALL.into_iter().find(|f| has(*f)) {
        Some(grey) => Err(Mismatch {
            what: format!("no format named depth, but {}", list(offered)),
            remedy: format!(
                "if {} is depth on this camera, ask for it with --pixel-format {0}",
                grey.fourcc()
            ),
        }),
        None => Err(no_such_format(&DepthFormat::Z16.fourcc(), offered)),
    }
}

fn no_such_format(asked: &FourCc, offered: &[OfferedFormat]) -> Mismatch {
    Mismatch {
        what: format!("asked for {asked}, the camera offers {}", list(offered)),
        remedy: "choose one of them with --pixel-format, or another node \
                 (`saint-live devices` lists all)"
            .into(),
    }
}

fn plan_size(wish: Option<(u32, u32)>, offer: &OfferedFormat) -> Result<(u32, u32), Mismatch> {
    if let Some(asked) = wish {
        let listed = offer.sizes.iter().any(|s| (s.width, s.height) == asked);
        let unlisted = offer.sizes.is_empty() && offer.size_range.is_none();
        if listed || unlisted || offer.size_range.is_some_and(|r| r.holds(asked)) {
            return Ok(asked);
        }
        return Err(Mismatch {
            what: format!(
                "asked for {}x{}, {} comes in {}",
                asked.0,
                asked.1,
                offer.pixel_format,
                SizeList(offer)
            ),
            remedy: "choose one of them with --size".into(),
        });
    }
    let usual_distance =
        |s: &&FrameSize| (u64::from(s.width) * u64::from(s.height)).abs_diff(USUAL_PIXELS);
    if let Some(size) = offer.sizes.iter().min_by_key(usual_distance) {
        return Ok((size.width, size.height));
    }
    Ok(match offer.size_range {
        Some(range) if range.holds((640, 480)) => (640, 480),
        Some(range) => range.max,
        None => (640, 480),
    })
}

fn plan_rate(wish: Option<u32>, rates: &[f64], size: (u32, u32)) -> Result<Option<f64>, Mismatch> {
    let Some(asked) = wish else {
        let usual = rates.iter().copied().filter(|r| *r <= USUAL_FPS + 0.5);
        let fastest = usual.fold(None, |best: Option<f64>, r| {
            Some(best.map_or(r, |b| b.max(r)))
        });
        return Ok(fastest.or_else(|| rates.iter().copied().reduce(f64::min)));
    };
    let asked = f64::from(asked);
    if rates.is_empty() {
        return Ok(Some(asked));
    }
    let (low, high) = rates.iter().fold((f64::MAX, 0.0f64), |(low, high), r| {
        (low.min(*r), high.max(*r))
    });
    match rates.iter().copied().find(|r| same_rate(*r, asked)) {
        Some(rate) => Ok(Some(rate)),
        None => Err(Mismatch {
            what: format!(
                "asked for {asked} frames/s, at {}x{} the camera gives {}",
                size.0,
                size.1,
                RateList(rates)
            ),
            remedy: format!("choose one of them with --fps ({low:.3} to {high:.3})"),
        }),
    }
}

fn same_rate(a: f64, b: f64) -> bool {
    (a - b).abs() <= FPS_TOLERANCE * b
}

/// Compares what the driver gave with what was asked: drivers substitute without an error.
///
/// Returns the bytes per row to read by.
///
/// # Errors
/// [`Mismatch`] names both.
pub fn check_granted(plan: &Plan, wish: &Wish, granted: &Granted) -> Result<u32, Mismatch> {
    let asked = format!("{} {}x{}", plan.format.fourcc(), plan.width, plan.height);
    let got = format!("{} {}x{}", granted.format, granted.width, granted.height);
    if asked != got {
        return Err(Mismatch {
            what: format!("asked for {asked}, the driver gave {got}"),
            remedy: "choose a format and size that `saint-live devices` lists".into(),
        });
    }
    if let (Some(asked), Some(got)) = (wish.fps, granted.fps)
        && !same_rate(got, f64::from(asked))
    {
        return Err(Mismatch {
            what: format!("asked for {asked} frames/s, the driver gave {got:.3}"),
            remedy: "choose a rate that `saint-live devices` lists, with --fps".into(),
        });
    }
    let row = u32::try_from(plan.format.row_bytes(plan.width as usize)).unwrap_or(u32::MAX);
    match granted.stride {
        0 => Ok(row),
        stride if stride >= row => Ok(stride),
        stride => Err(Mismatch {
            what: format!("a row of {asked} takes {row} bytes, the driver says {stride}"),
            remedy: "choose another size with --size; this one is broken in the driver".into(),
        }),
    }
}

fn list(offered: &[OfferedFormat]) -> String {
    if offered.is_empty() {
        return "no format at all".into();
    }
    let names: Vec<String> = offered.iter().map(|o| o.pixel_format.to_string()).collect();
    names.join(", ")
}

struct SizeList<'a>(&'a OfferedFormat);

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

struct RateList<'a>(&'a [f64]);

impl fmt::Display for RateList<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (i, rate) in self.0.iter().enumerate() {
            let comma = if i == 0 { "" } else { ", " };
            write!(f, "{comma}{}", (rate * 1000.0).round() / 1000.0)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn size(width: u32, height: u32, fps: &[f64]) -> FrameSize {
        FrameSize {
            width,
            height,
            fps: fps.to_vec(),
        }
    }

    fn offer(code: &[u8; 4], sizes: Vec<FrameSize>) -> OfferedFormat {
        OfferedFormat {
            pixel_format: FourCc(*code),
            description: String::new(),
            sizes,
            size_range: None,
        }
    }

    fn depth_camera() -> Vec<OfferedFormat> {
        let rates = [90.0, 30.0, 15.0];
        vec![
            offer(b"YUYV", vec![size(640, 480, &rates)]),
            offer(
                b"Z16 ",
                vec![
                    size(1280, 720, &rates),
                    size(640, 480, &rates),
                    size(320, 240, &[60.0]),
                ],
            ),
        ]
    }

    fn granted(plan: &Plan) -> Granted {
        Granted {
            format: plan.format.fourcc(),
            width: plan.width,
            height: plan.height,
            stride: plan.width * 2,
            fps: plan.fps,
        }
    }

    #[test]
    fn without_a_wish_depth_near_vga_at_30_is_chosen() {
        let plan = plan(&Wish::default(), &depth_camera()).unwrap();
        let want = Plan {
            format: DepthFormat::Z16,
            width: 640,
            height: 480,
            fps: Some(30.0),
        };
        assert_eq!(plan, want);
        assert_eq!(
            check_granted(&plan, &Wish::default(), &granted(&plan)),
            Ok(1280)
        );
    }

    #[test]
    fn a_size_with_fast_rates_only_takes_the_slowest() {
        let wish = Wish {
            size: Some((320, 240)),
            ..Wish::default()
        };
        assert_eq!(plan(&wish, &depth_camera()).unwrap().fps, Some(60.0));
    }

    #[test]
    fn what_is_not_offered_is_named_beside_what_is() {
        let ask = |format, size, fps| {
            plan(&Wish { format, size, fps }, &depth_camera())
                .unwrap_err()
                .what
        };
        assert_eq!(
            ask(Some(DepthFormat::Y12), None, None),
            "asked for Y12, the camera offers YUYV, Z16"
        );
        assert_eq!(
            ask(None, Some((800, 600)), None),
            "asked for 800x600, Z16 comes in 1280x720, 640x480, 320x240"
        );
        assert_eq!(
            ask(None, None, Some(25)),
            "asked for 25 frames/s, at 640x480 the camera gives 90, 30, 15"
        );
    }

    #[test]
    fn grey_is_not_taken_for_depth_unasked() {
        let grey = [offer(b"Y16 ", vec![size(640, 480, &[])])];
        let error = plan(&Wish::default(), &grey).unwrap_err();
        assert!(error.remedy.contains("--pixel-format Y16"), "{error:?}");
        let wish = Wish {
            format: Some(DepthFormat::Y16),
            ..Wish::default()
        };
        let plan = plan(&wish, &grey).unwrap();
        assert_eq!((plan.format, plan.fps), (DepthFormat::Y16, None));
    }

    #[test]
    fn a_substituted_format_size_or_rate_is_an_error_with_both() {
        let wish = Wish {
            fps: Some(30),
            ..Wish::default()
        };
        let plan = plan(&wish, &depth_camera()).unwrap();
        let mut got = granted(&plan);
        got.format = FourCc(*b"YUYV");
        let what = check_granted(&plan, &wish, &got).unwrap_err().what;
        assert_eq!(what, "asked for Z16 640x480, the driver gave YUYV 640x480");
        let mut got = granted(&plan);
        got.width = 848;
        assert!(
            check_granted(&plan, &wish, &got)
                .unwrap_err()
                .what
                .contains("848x480")
        );
        let mut got = granted(&plan);
        got.fps = Some(15.0);
        assert!(
            check_granted(&plan, &wish, &got)
                .unwrap_err()
                .what
                .contains("15.000")
        );
        assert!(
            check_granted(&plan, &Wish::default(), &got).is_ok(),
            "no rate was asked"
        );
        got.fps = Some(29.97);
        assert!(check_granted(&plan, &wish, &got).is_ok(), "29.97 is 30");
    }

    #[test]
    fn the_stride_is_the_drivers_unless_it_cannot_be() {
        let plan = plan(&Wish::default(), &depth_camera()).unwrap();
        let with = |stride| {
            let got = Granted {
                stride,
                ..granted(&plan)
            };
            check_granted(&plan, &Wish::default(), &got)
        };
        assert_eq!(with(0), Ok(1280));
        assert_eq!(with(1344), Ok(1344));
        assert!(with(1279).unwrap_err().what.contains("1279"));
    }

    #[test]
    fn a_range_of_sizes_is_checked_by_its_steps() {
        let mut ranged = offer(b"Z16 ", vec![]);
        ranged.size_range = Some(SizeRange {
            min: (32, 32),
            max: (512, 512),
            step: (16, 2),
        });
        let offered = [ranged];
        let ask = |size| {
            plan(
                &Wish {
                    size,
                    ..Wish::default()
                },
                &offered,
            )
        };
        assert_eq!(ask(Some((48, 34))).unwrap().width, 48);
        assert!(
            ask(Some((40, 34)))
                .unwrap_err()
                .what
                .contains("steps of 16x2")
        );
        assert!(ask(Some((528, 34))).is_err());
        let usual = ask(None).unwrap();
        assert_eq!(
            (usual.width, usual.height),
            (512, 512),
            "640x480 is out of range"
        );
    }
}
