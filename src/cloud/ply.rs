//! PLY: the header by the `ply-rs-bw` crate, the vertices straight from the bytes (the crate keeps
//! each point as a map of named properties).

use super::LengthUnit;
use super::number::{Layout, Number};
use super::text;
use glam::DVec3;
use ply_rs_bw::parser::{Parser, Reader};
use ply_rs_bw::ply::{DefaultElement, ElementDef, Encoding, PropertyType, ScalarType};

/// Reads the vertices. `unit` becomes what a comment `unit NAME` says.
pub fn read(bytes: &[u8], unit: &mut Option<LengthUnit>) -> Result<Vec<DVec3>, String> {
    let mut reader = Reader::new(bytes);
    let header = Parser::<DefaultElement>::new()
        .read_header(&mut reader)
        .map_err(|e| e.to_string())?;
    let mut rest: &[u8] = reader.into_inner();
    *unit = header.comments.iter().find_map(|comment| {
        let mut words = comment.split_whitespace();
        let says = words.next()?.trim_end_matches(':');
        says.eq_ignore_ascii_case("unit")
            .then(|| words.next()?.parse().ok())
            .flatten()
    });
    let big_endian = header.encoding == Encoding::BinaryBigEndian;
    let ascii = header.encoding == Encoding::Ascii;
    for (name, element) in &header.elements {
        if name != "vertex" {
            rest = if ascii {
                text::after_lines(rest, element.count)
            } else {
                after(rest, element, big_endian)
            }
            .ok_or_else(|| ends_in(name))?;
            continue;
        }
        if ascii {
            return read_ascii(rest, element);
        }
        return match layout(element, big_endian) {
            Ok(layout) => layout.read(rest, element.count as u64),
            Err(what) => Err(what),
        };
    }
    Err("it has no element `vertex`".to_owned())
}

fn ends_in(element: &str) -> String {
    format!("it ends within its element `{element}`")
}

/// Places of x, y and z among an element's properties.
fn axes(element: &ElementDef) -> Result<[usize; 3], String> {
    let place = |axis: &str| {
        let found = element.properties.iter().position(|(name, _)| name == axis);
        found.ok_or_else(|| format!("its vertices have no property `{axis}`"))
    };
    Ok([place("x")?, place("y")?, place("z")?])
}

fn layout(element: &ElementDef, big_endian: bool) -> Result<Layout, String> {
    let places = axes(element)?;
    let mut found = [(Number::F32, 0); 3];
    let mut record = 0usize;
    for (i, (name, property)) in element.properties.iter().enumerate() {
        let PropertyType::Scalar(scalar) = &property.data_type else {
            return Err(format!(
                "its vertices have the list `{name}`, so that they differ in size; write it without"
            ));
        };
        let number = number(scalar);
        for (axis, &place) in found.iter_mut().zip(&places) {
            if place == i {
                *axis = (number, record);
            }
        }
        record += number.size();
    }
    Ok(Layout {
        record,
        axes: found,
        big_endian,
    })
}

fn number(scalar: &ScalarType) -> Number {
    match scalar {
        ScalarType::Char => Number::I8,
        ScalarType::UChar => Number::U8,
        ScalarType::Short => Number::I16,
        ScalarType::UShort => Number::U16,
        ScalarType::Int => Number::I32,
        ScalarType::UInt => Number::U32,
        ScalarType::Float => Number::F32,
        ScalarType::Double => Number::F64,
    }
}

/// The bytes behind an element; `None` where it is not whole.
fn after<'a>(mut rest: &'a [u8], element: &ElementDef, big_endian: bool) -> Option<&'a [u8]> {
    if element.properties.is_empty() {
        return Some(rest);
    }
    for _ in 0..element.count {
        for (_, property) in &element.properties {
            let bytes = match &property.data_type {
                PropertyType::Scalar(scalar) => number(scalar).size(),
                PropertyType::List(length, entry) => {
                    let length = number(length);
                    let entries = length.value(rest, big_endian)?;
                    rest = &rest[length.size()..];
                    // a negative length is none
                    (entries as usize).checked_mul(number(entry).size())?
                }
            };
            rest = rest.get(bytes..)?;
        }
    }
    Some(rest)
}

fn read_ascii(rest: &[u8], element: &ElementDef) -> Result<Vec<DVec3>, String> {
    let places = axes(element)?;
    // a list before an axis would move it from line to line
    let last = places.iter().copied().max().unwrap_or(0);
    let mut before = element.properties.iter().take(last + 1);
    if before.any(|(_, p)| matches!(p.data_type, PropertyType::List(..))) {
        return Err("a list stands before x, y or z; write it without".to_owned());
    }
    text::columns(rest, places, element.count as u64)
}
