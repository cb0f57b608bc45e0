//! What an experiment found: tables, one curve, sentences.

use serde::Serialize;
use serde::ser::{SerializeMap, Serializer};
use std::fmt;

/// One value of a table.
#[derive(Clone, Debug, PartialEq)]
pub enum Cell {
    /// A name.
    Text(String),
    /// A number without repetition.
    Number(f64),
    /// Mean and standard deviation over the seeds.
    Spread(f64, f64),
}

impl Cell {
    /// Mean and sample standard deviation (0 for one value); "–" for none.
    #[must_use]
    pub fn spread(values: &[f64]) -> Self {
        let n = values.len() as f64;
        if values.is_empty() {
            return Self::Text("–".to_owned());
        }
        let mean = values.iter().sum::<f64>() / n;
        let squares: f64 = values.iter().map(|v| (v - mean).powi(2)).sum();
        Self::Spread(mean, (squares / (n - 1.0).max(1.0)).sqrt())
    }

    /// A name.
    pub fn text(text: impl Into<String>) -> Self {
        Self::Text(text.into())
    }

    /// The number or mean; `None` for a name.
    #[must_use]
    pub fn value(&self) -> Option<f64> {
        match self {
            Self::Text(_) => None,
            Self::Number(v) | Self::Spread(v, _) => Some(*v),
        }
    }
}

impl From<usize> for Cell {
    fn from(v: usize) -> Self {
        Self::Number(v as f64)
    }
}

impl fmt::Display for Cell {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Text(text) => f.write_str(text),
            Self::Number(v) => f.write_str(&digits(*v)),
            Self::Spread(mean, deviation) if *deviation == 0.0 => f.write_str(&digits(*mean)),
            Self::Spread(mean, deviation) => {
                // the deviation to two digits, the mean to the same place
                let place = (1 - deviation.log10().floor() as i32).clamp(0, 6) as usize;
                let least = digits(*mean);
                let shown = least.split_once('.').map_or(0, |(_, d)| d.len());
                let place = place.min(shown.max(2));
                write!(f, "{mean:.place$} ±{deviation:.place$}")
            }
        }
    }
}

/// Four significant digits, whole numbers whole.
#[must_use]
pub fn digits(v: f64) -> String {
    if v == 0.0 || !v.is_finite() || v.fract() == 0.0 && v.abs() < 1e12 {
        return format!("{v}");
    }
    let place = 3 - v.abs().log10().floor() as i32;
    if (0..=9).contains(&place) {
        format!("{v:.*}", place as usize)
    } else {
        format!("{v:.3e}")
    }
}

impl Serialize for Cell {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::Text(text) => serializer.serialize_str(text),
            Self::Number(v) => serializer.serialize_f64(*v),
            Self::Spread(mean, deviation) => {
                let mut map = serializer.serialize_map(Some(2))?;
                map.serialize_entry("mean", mean)?;
                map.serialize_entry("deviation", deviation)?;
                map.end()
            }
        }
    }
}

/// A table; every row has a cell for every column.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Table {
    /// What it shows.
    pub title: String,
    /// Heads, with units.
    pub columns: Vec<&'static str>,
    /// The rows.
    pub rows: Vec<Vec<Cell>>,
}

impl Table {
    /// A table without rows.
    pub fn new(title: impl Into<String>, columns: &[&'static str]) -> Self {
        Self {
            title: title.into(),
            columns: columns.to_vec(),
            rows: Vec::new(),
        }
    }

    /// The number in `column` of the first row whose first cells read `names`.
    #[must_use]
    pub fn value(&self, names: &[&str], column: &str) -> Option<f64> {
        let place = self.columns.iter().position(|c| *c == column)?;
        let named = |row: &&Vec<Cell>| {
            let first = row.iter().zip(names);
            first
                .filter(|(cell, name)| cell.to_string() == **name)
                .count()
                == names.len()
        };
        self.rows.iter().find(named)?.get(place)?.value()
    }
}

/// One line of a curve.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Series {
    /// Its name.
    pub name: String,
    /// x, y.
    pub points: Vec<(f64, f64)>,
}

/// A picture of the result.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Curve {
    /// What it shows.
    pub title: String,
    /// Horizontal axis.
    pub x: String,
    /// Vertical axis.
    pub y: String,
    /// Logarithmic axes: horizontal, vertical.
    pub log: (bool, bool),
    /// The lines.
    pub series: Vec<Series>,
}

/// The result of one experiment.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Report {
    /// Its name.
    pub experiment: &'static str,
    /// What the paper says.
    pub claim: &'static str,
    /// How it was measured here.
    pub method: &'static str,
    /// The data: name, points, diagonal, parameters.
    pub data: Vec<String>,
    /// Repetitions.
    pub seeds: u64,
    /// The numbers.
    pub tables: Vec<Table>,
    /// What they say.
    pub findings: Vec<String>,
    /// The picture.
    pub curve: Curve,
}
