//! Whether the driver gave what was asked. Pure.

use super::fourcc::FourCc;
use super::negotiation::{Mismatch, Plan, Wish, same_rate};

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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::capture::v4l2::depth_format::DepthFormat;

    fn vga() -> Plan {
        Plan {
            format: DepthFormat::Z16,
            width: 640,
            height: 480,
            fps: Some(30.0),
        }
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
    fn a_substituted_format_size_or_rate_is_an_error_with_both() {
        let wish = Wish {
            fps: Some(30),
            ..Wish::default()
        };
        let plan = vga();
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
        let plan = vga();
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
}
