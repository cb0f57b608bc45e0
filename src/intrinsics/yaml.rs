//! Calibration YAML as the tree JSON gives, so that one reader serves both.
//!
//! Events are pulled, not recursed into: nesting is bounded here and aliases are refused, so no
//! file can exhaust stack or memory.

use saphyr_parser::{Event, Parser, ScalarStyle};
use serde_json::{Map, Value};

/// Deeper nesting than any calibration layout has.
const MAX_DEPTH: usize = 16;

/// A collection that is still open.
enum Open {
    Sequence(Vec<Value>),
    /// The entries so far, and the key that waits for its value.
    Mapping(Map<String, Value>, Option<String>),
}

/// Parses the first document of `text`. Plain scalars that read as numbers become numbers.
///
/// OpenCV writes `%YAML:1.0`, which is not YAML: directive lines are left out.
pub(super) fn parse(text: &str) -> Result<Value, String> {
    let body: String = text
        .lines()
        .skip_while(|line| line.starts_with('%') || line.trim().is_empty())
        .flat_map(|line| [line, "\n"])
        .collect();
    let mut open: Vec<Open> = Vec::new();
    for event in Parser::new_from_str(&body) {
        let (event, _) = event.map_err(|error| format!("not valid YAML ({error})"))?;
        let value = match event {
            Event::SequenceStart(..) => {
                push(&mut open, Open::Sequence(Vec::new()))?;
                continue;
            }
            Event::MappingStart(..) => {
                push(&mut open, Open::Mapping(Map::new(), None))?;
                continue;
            }
            Event::Scalar(text, style, ..) => scalar(&text, style),
            Event::SequenceEnd | Event::MappingEnd => match open.pop() {
                Some(Open::Sequence(items)) => Value::Array(items),
                Some(Open::Mapping(entries, _)) => Value::Object(entries),
                None => return Err("not valid YAML (unbalanced)".to_owned()),
            },
            Event::Alias(_) => return Err("YAML aliases are not supported".to_owned()),
            _ => continue,
        };
        match open.last_mut() {
            None => return Ok(value),
            Some(Open::Sequence(items)) => items.push(value),
            Some(Open::Mapping(entries, key)) => match key.take() {
                Some(key) => {
                    entries.insert(key, value);
                }
                None => *key = Some(key_text(&value)),
            },
        }
    }
    Err("the YAML holds no value".to_owned())
}

fn push(open: &mut Vec<Open>, collection: Open) -> Result<(), String> {
    if open.len() == MAX_DEPTH {
        return Err(format!("YAML nested deeper than {MAX_DEPTH} levels"));
    }
    open.push(collection);
    Ok(())
}

fn scalar(text: &str, style: ScalarStyle) -> Value {
    let number = (style == ScalarStyle::Plain)
        .then(|| text.parse::<f64>().ok())
        .flatten()
        .and_then(serde_json::Number::from_f64);
    number.map_or_else(|| Value::String(text.to_owned()), Value::Number)
}

fn key_text(value: &Value) -> String {
    match value {
        Value::String(text) => text.clone(),
        other => other.to_string(),
    }
}
