//! Custom EXR attributes of our depth images: camera and time travel inside the file.
//!
//! | name | EXR type | meaning |
//! |---|---|---|
//! | `fx` `fy` `cx` `cy` | double | pinhole intrinsics, pixels; centre of the top-left pixel is (0, 0) |
//! | `depthUnit` | double | metres per depth integer: Z is a whole multiple of it |
//! | `depthMin` `depthMax` | double | range of depths that are measurements, metres |
//! | `fps` | double | nominal frame rate |
//! | `invalidCodes` | string | depth integers that mean "no measurement", separated by spaces |
//! | `frameNumber` | string | the source's frame number, decimal |
//! | `deviceTimeNs` `wallTimeNs` | string | [`FrameTime`], decimal int64: EXR has no such type |
//! | `cameraName` | string | what the source calls itself, UTF-8 |
//!
//! Reading also takes float and int for a double, and text that reads as a number: all of them
//! are what other tools make of such an attribute.

use crate::frame::{Camera, FrameTime, Intrinsics};
use exr::meta::attribute::{AttributeValue, Text};
use exr::meta::header::{Header, LayerAttributes};

/// What the attributes of one file say; nothing is required.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ExrAttributes {
    /// Pinhole intrinsics, pixels, at the size of the image.
    pub intrinsics: Option<Intrinsics>,
    /// Metres per depth integer.
    pub depth_unit_m: Option<f64>,
    /// Nearest depth that is a measurement, metres.
    pub depth_min_m: Option<f64>,
    /// Farthest depth that is a measurement, metres.
    pub depth_max_m: Option<f64>,
    /// Nominal frame rate, frames per second.
    pub fps: Option<f64>,
    /// Depth integers that mean "no measurement".
    pub invalid: Option<Vec<u16>>,
    /// The source's frame number.
    pub sequence: Option<u64>,
    /// Device clock, ns.
    pub device_ns: Option<i64>,
    /// Wall clock, ns.
    pub wall_ns: Option<i64>,
    /// What the source calls itself.
    pub name: Option<String>,
}

impl ExrAttributes {
    /// Everything a frame of `camera` carries.
    #[must_use]
    pub fn of_frame(camera: &Camera, sequence: u64, time: FrameTime) -> Self {
        Self {
            intrinsics: Some(camera.intrinsics),
            depth_unit_m: Some(camera.depth_unit_m),
            depth_min_m: Some(camera.depth_min_m),
            depth_max_m: Some(camera.depth_max_m),
            fps: camera.fps,
            invalid: Some(camera.invalid.clone()),
            sequence: Some(sequence),
            device_ns: Some(time.device_ns),
            wall_ns: Some(time.wall_ns),
            name: Some(camera.name.clone()),
        }
    }

    /// The time, where the file has one.
    #[must_use]
    pub fn time(&self) -> Option<FrameTime> {
        self.device_ns.map(|device_ns| FrameTime {
            device_ns,
            wall_ns: self.wall_ns.unwrap_or(0),
        })
    }

    /// Reads the attributes of a file's part. Values that make no sense (a focal length of 0) are
    /// absent, like attributes that are not there.
    #[must_use]
    pub fn read(header: &Header) -> Self {
        let find = |name: &str| {
            let layer = header.own_attributes.other.iter();
            let image = header.shared_attributes.other.iter();
            layer
                .chain(image)
                .find(|(key, _)| key.bytes() == name.as_bytes())
                .map(|(_, value)| value)
        };
        let number = |name: &str| {
            find(name)
                .and_then(number)
                .filter(|value| value.is_finite())
        };
        let positive = |name: &str| number(name).filter(|value| *value > 0.0);
        let intrinsics = || {
            Some(Intrinsics {
                fx: positive("fx")?,
                fy: positive("fy")?,
                cx: number("cx")?,
                cy: number("cy")?,
            })
        };
        let string = |name: &str| find(name).and_then(text);
        Self {
            intrinsics: intrinsics(),
            depth_unit_m: positive("depthUnit"),
            depth_min_m: number("depthMin").filter(|value| *value >= 0.0),
            depth_max_m: positive("depthMax"),
            fps: positive("fps"),
            invalid: string("invalidCodes").and_then(|list| {
                list.split_whitespace()
                    .map(|code| code.parse().ok())
                    .collect()
            }),
            sequence: string("frameNumber").and_then(|text| text.trim().parse().ok()),
            device_ns: string("deviceTimeNs").and_then(|text| text.trim().parse().ok()),
            wall_ns: string("wallTimeNs").and_then(|text| text.trim().parse().ok()),
            name: string("cameraName"),
        }
    }

    /// Adds the attributes to those of a layer that is about to be written.
    pub(super) fn write(&self, layer: &mut LayerAttributes) {
        let k = self.intrinsics;
        let numbers = [
            ("fx", k.map(|k| k.fx)),
            ("fy", k.map(|k| k.fy)),
            ("cx", k.map(|k| k.cx)),
            ("cy", k.map(|k| k.cy)),
            ("depthUnit", self.depth_unit_m),
            ("depthMin", self.depth_min_m),
            ("depthMax", self.depth_max_m),
            ("fps", self.fps),
        ];
        let codes = |codes: &Vec<u16>| {
            let words: Vec<String> = codes.iter().map(u16::to_string).collect();
            words.join(" ")
        };
        let texts = [
            ("invalidCodes", self.invalid.as_ref().map(codes)),
            ("frameNumber", self.sequence.map(|n| n.to_string())),
            ("deviceTimeNs", self.device_ns.map(|ns| ns.to_string())),
            ("wallTimeNs", self.wall_ns.map(|ns| ns.to_string())),
            ("cameraName", self.name.clone()),
        ];
        let numbers = numbers
            .into_iter()
            .filter_map(|(name, value)| Some((name, AttributeValue::F64(value?))));
        let texts = texts.into_iter().filter_map(|(name, value)| {
            let text = Text::from_slice_unchecked(value?.as_bytes());
            Some((name, AttributeValue::Text(text)))
        });
        for (name, value) in numbers.chain(texts) {
            let name = Text::from_slice_unchecked(name.as_bytes());
            layer.other.insert(name, value);
        }
    }
}

fn number(value: &AttributeValue) -> Option<f64> {
    match value {
        AttributeValue::F64(value) => Some(*value),
        // The shortest decimal of a float is what its writer meant: 0.001, not 0.00100000005.
        AttributeValue::F32(value) => value.to_string().parse().ok(),
        AttributeValue::I32(value) => Some(f64::from(*value)),
        AttributeValue::Rational((over, under)) => Some(f64::from(*over) / f64::from(*under)),
        AttributeValue::Text(_) => text(value)?.trim().parse().ok(),
        _ => None,
    }
}

fn text(value: &AttributeValue) -> Option<String> {
    match value {
        AttributeValue::Text(text) => Some(String::from_utf8_lossy(text.bytes()).into_owned()),
        AttributeValue::I32(value) => Some(value.to_string()),
        _ => None,
    }
}

/// Puts the attributes of a written single-part file into the order of their names.
///
/// The crate writes them in the order of a randomly seeded hash map; sorted, one frame always
/// gives the same bytes. The header keeps its length, so chunk offsets stay true.
pub(super) fn sort_header(file: &mut [u8]) {
    const START: usize = 8;
    let mut records: Vec<&[u8]> = Vec::new();
    let mut rest = file.get(START..).unwrap_or_default();
    loop {
        if rest.first() == Some(&0) {
            break;
        }
        let Some(length) = record_length(rest).filter(|length| *length <= rest.len()) else {
            return;
        };
        let (record, after) = rest.split_at(length);
        records.push(record);
        rest = after;
    }
    records.sort_unstable();
    let sorted = records.concat();
    file[START..START + sorted.len()].copy_from_slice(&sorted);
}

/// Bytes of the attribute at the start of `rest`: name, 0, type, 0, size (i32 LE), value.
fn record_length(rest: &[u8]) -> Option<usize> {
    let name = rest.iter().position(|byte| *byte == 0)? + 1;
    let kind = rest[name..].iter().position(|byte| *byte == 0)? + 1;
    let size = rest.get(name + kind..name + kind + 4)?;
    let size = u32::from_le_bytes(size.try_into().ok()?) as usize;
    (name + kind + 4).checked_add(size)
}
