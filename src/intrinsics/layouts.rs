//! Where each known layout keeps its numbers.
//!
//! Keys are compared without case and punctuation, so `image_width`, `Image.Width` and
//! `imageWidth` are one key. A matrix tells its own storage order by where its zeros are
//! (Open3D: columns, everybody else: rows).

use super::Calibration;
use crate::frame::Intrinsics;
use serde_json::Value;

/// Keys that hold the camera one level down, the depth camera first.
const NESTED: &[&str] = &[
    "depth",
    "depthintrinsics",
    "depthintrinsic",
    "depthcamera",
    "depthcamerainfo",
    "intrinsics",
    "intrinsic",
    "depthtocolor",
    "camerainfo",
    "camera",
    "colorintrinsics",
    "color",
];
const MATRIX: &[&str] = &[
    "intrinsicmatrix",
    "cameramatrix",
    "intrinsics",
    "intrinsic",
    "cameraintrinsics",
    "k",
    "m1",
    "cameramatrix1",
];
const FX: &[&str] = &["fx", "focallengthx", "camerafx", "camera1fx", "focalx"];
const FY: &[&str] = &["fy", "focallengthy", "camerafy", "camera1fy", "focaly"];
const CX: &[&str] = &["cx", "ppx", "principalpointx", "cameracx", "camera1cx"];
const CY: &[&str] = &["cy", "ppy", "principalpointy", "cameracy", "camera1cy"];
const FOCAL_PAIR: &[&str] = &["focallength", "focal", "f"];
const CENTRE_PAIR: &[&str] = &["principalpoint", "pp", "c"];
const WIDTH: &[&str] = &["width", "imagewidth", "camerawidth", "w"];
const HEIGHT: &[&str] = &["height", "imageheight", "cameraheight", "h"];
const SIZE_PAIR: &[&str] = &["imagesize", "size", "resolution"];
const UNIT_M: &[&str] = &[
    "depthscalemperunit",
    "depthunitm",
    "depthunits",
    "depthunit",
];
/// Either metres per unit (RealSense) or units per metre (Open3D, ORB-SLAM): told by its size.
const UNIT_EITHER: &[&str] = &["depthscale", "depthmapfactor", "rgbddepthmapfactor"];
const DEPTH_MIN: &[&str] = &["depthminm", "depthmin"];
const DEPTH_MAX: &[&str] = &["depthmaxm", "depthmax"];
const FPS: &[&str] = &["fps", "camerafps", "framerate"];
const INVALID: &[&str] = &["invalidvalues", "invalid"];
const DISTORTION: &[&str] = &[
    "distortioncoefficients",
    "distcoeffs",
    "distortion",
    "coeffs",
    "d",
    "d1",
];
/// No sensor has more columns or rows.
const MAX_SIDE: f64 = 32768.0;
/// Levels searched for the camera object.
const MAX_NESTING: usize = 3;

/// Reads a calibration out of a JSON-like tree; the flag says that the lens is distorted.
pub(super) fn calibration(tree: &Value) -> Result<(Calibration, bool), String> {
    let mut path = Vec::new();
    let Some(intrinsics) = find(tree, &mut path) else {
        return Err("no fx, fy, cx, cy (or ppx, ppy) and no 3x3 camera matrix in it".to_owned());
    };
    // What is not beside the intrinsics may stand in one of the objects around them.
    let around = |keys: &[&str]| path.iter().rev().find_map(|object| number(object, keys));
    let positive = |keys: &[&str], what: &str| match around(keys) {
        Some(value) if !(value.is_finite() && value > 0.0) => {
            Err(format!("{what} is {value}, but it must be above 0"))
        }
        value => Ok(value),
    };
    let size = path
        .iter()
        .rev()
        .find_map(|object| size(object))
        .transpose()?;
    let depth_unit_m = match positive(UNIT_M, "the depth unit")? {
        Some(unit) => Some(unit),
        None => positive(UNIT_EITHER, "the depth scale")?
            .map(|scale| if scale >= 1.0 { 1.0 / scale } else { scale }),
    };
    let invalid = path
        .iter()
        .rev()
        .find_map(|object| lookup(object, INVALID))
        .filter(|value| value.is_array())
        .map(codes)
        .transpose()?;
    let distorted = path
        .iter()
        .rev()
        .find_map(|object| lookup(object, DISTORTION))
        .and_then(numbers)
        .is_some_and(|list| list.iter().any(|value| *value != 0.0));
    Ok((
        Calibration {
            intrinsics: intrinsics?,
            size,
            depth_unit_m,
            depth_min_m: around(DEPTH_MIN).filter(|value| value.is_finite() && *value >= 0.0),
            depth_max_m: positive(DEPTH_MAX, "the largest depth")?,
            invalid,
            fps: around(FPS).filter(|value| value.is_finite() && *value > 0.0),
        },
        distorted,
    ))
}

/// Checked intrinsics, pixels.
pub(super) fn pinhole(fx: f64, fy: f64, cx: f64, cy: f64) -> Result<Intrinsics, String> {
    let usable = [fx, fy, cx, cy].iter().all(|value| value.is_finite()) && fx > 0.0 && fy > 0.0;
    if !usable {
        return Err(format!(
            "fx {fx}, fy {fy}, cx {cx}, cy {cy}: focal lengths must be above 0 and all finite"
        ));
    }
    Ok(Intrinsics { fx, fy, cx, cy })
}

/// A text file of 4 numbers (fx fy cx cy) or 9 (a 3×3 matrix); `None` if it is something else.
pub(super) fn bare_matrix(text: &str) -> Option<Result<Intrinsics, String>> {
    let list = text
        .split(|c: char| c.is_whitespace() || c == ',')
        .filter(|part| !part.is_empty())
        .map(|part| part.parse::<f64>().ok())
        .collect::<Option<Vec<_>>>()?;
    Some(match list[..] {
        [fx, fy, cx, cy] => pinhole(fx, fy, cx, cy),
        _ => matrix(&list)
            .unwrap_or_else(|| Err(format!("4 or 9 numbers expected, got {}", list.len()))),
    })
}

/// Finds the camera in `tree` or in an object inside it; `path` gets the objects from the
/// outside in.
fn find<'t>(tree: &'t Value, path: &mut Vec<&'t Value>) -> Option<Result<Intrinsics, String>> {
    path.push(tree);
    if let Some(found) = direct(tree) {
        return Some(found);
    }
    if path.len() < MAX_NESTING {
        for key in NESTED {
            let inner = lookup(tree, &[*key]).filter(|inner| inner.is_object());
            if let Some(found) = inner.and_then(|inner| find(inner, path)) {
                return Some(found);
            }
        }
    }
    path.pop();
    None
}

fn direct(object: &Value) -> Option<Result<Intrinsics, String>> {
    let pair = |keys: &[&str]| match numbers(lookup(object, keys)?)?[..] {
        [x, y] => Some((x, y)),
        _ => None,
    };
    let focal = number(object, FX)
        .zip(number(object, FY))
        .or_else(|| pair(FOCAL_PAIR));
    let centre = number(object, CX)
        .zip(number(object, CY))
        .or_else(|| pair(CENTRE_PAIR));
    if let Some(((fx, fy), (cx, cy))) = focal.zip(centre) {
        return Some(pinhole(fx, fy, cx, cy));
    }
    MATRIX
        .iter()
        .filter_map(|key| numbers(lookup(object, &[*key])?))
        .find_map(|list| matrix(&list))
}

/// Intrinsics of a 3×3 matrix (or the left 3×3 of a 3×4) in rows or columns.
fn matrix(m: &[f64]) -> Option<Result<Intrinsics, String>> {
    if m.len() != 9 {
        return None;
    }
    let by_columns = m[2] == 0.0 && m[5] == 0.0 && (m[6] != 0.0 || m[7] != 0.0);
    let (cx, cy) = if by_columns {
        (m[6], m[7])
    } else {
        (m[2], m[5])
    };
    if m[8] != 1.0 {
        return Some(Err(format!(
            "the last element of the camera matrix is {}, but it must be 1",
            m[8]
        )));
    }
    Some(pinhole(m[0], m[4], cx, cy))
}

fn size(object: &Value) -> Option<Result<(u32, u32), String>> {
    let (width, height) = match (number(object, WIDTH), number(object, HEIGHT)) {
        (Some(width), Some(height)) => (width, height),
        _ => match numbers(lookup(object, SIZE_PAIR)?)?[..] {
            [width, height] => (width, height),
            _ => return None,
        },
    };
    let whole = |side: f64| side.fract() == 0.0 && (1.0..=MAX_SIDE).contains(&side);
    Some(if whole(width) && whole(height) {
        Ok((width as u32, height as u32))
    } else {
        Err(format!(
            "the image size is {width}x{height}, but sides are whole numbers from 1 to {MAX_SIDE}"
        ))
    })
}

fn codes(list: &Value) -> Result<Vec<u16>, String> {
    let fail = || format!("invalid_values {list}: whole numbers from 0 to 65535 expected");
    let mut codes = numbers(list)
        .ok_or_else(fail)?
        .into_iter()
        .map(|code| {
            let fits = code.fract() == 0.0 && (0.0..=65535.0).contains(&code);
            fits.then_some(code as u16).ok_or_else(fail)
        })
        .collect::<Result<Vec<_>, _>>()?;
    codes.sort_unstable();
    codes.dedup();
    Ok(codes)
}

/// The value of the first of `keys` the object has; the keys are already plain.
fn lookup<'t>(object: &'t Value, keys: &[&str]) -> Option<&'t Value> {
    let object = object.as_object()?;
    keys.iter().find_map(|key| {
        object
            .iter()
            .find(|(name, value)| is_key(name, key) && !value.is_null())
            .map(|(_, value)| value)
    })
}

/// `name` without case and punctuation is `plain`.
fn is_key(name: &str, plain: &str) -> bool {
    name.chars()
        .filter(char::is_ascii_alphanumeric)
        .map(|c| c.to_ascii_lowercase())
        .eq(plain.chars())
}

fn number(object: &Value, keys: &[&str]) -> Option<f64> {
    scalar(lookup(object, keys)?)
}

/// A number, or text that reads as one (some tools quote all values).
fn scalar(value: &Value) -> Option<f64> {
    match value {
        Value::Number(number) => number.as_f64(),
        Value::String(text) => text.trim().parse().ok(),
        _ => None,
    }
}

/// A flat list of numbers out of `[…]`, `[[…], …]` or `{data: […]}`.
fn numbers(value: &Value) -> Option<Vec<f64>> {
    match value {
        Value::Array(items) => {
            let mut list = Vec::with_capacity(items.len());
            for item in items {
                match item {
                    Value::Array(row) => {
                        for cell in row {
                            list.push(scalar(cell)?);
                        }
                    }
                    other => list.push(scalar(other)?),
                }
            }
            Some(list)
        }
        Value::Object(_) => numbers(lookup(value, &["data"])?),
        _ => None,
    }
}
