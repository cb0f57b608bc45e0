//! The curve of an experiment as an SVG picture.

use crate::cli::failure::{Failure, Kind};
use plotters::prelude::*;
use saint_live::experiment::Curve;
use saint_live::experiment::report::digits;
use std::ops::Range;
use std::path::Path;

const SIZE: (u32, u32) = (1000, 640);
/// Colours that stay apart for most eyes (after Okabe & Ito, 2008), then again.
const COLOURS: [RGBColor; 8] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(230, 159, 0),
    RGBColor(86, 180, 233),
    RGBColor(90, 90, 90),
    RGBColor(150, 60, 30),
];

/// Whether the file may be written, before minutes are spent on measuring.
pub fn check(path: &Path, overwrite: bool) -> Result<(), Failure> {
    if !path
        .extension()
        .is_some_and(|e| e.eq_ignore_ascii_case("svg"))
    {
        return Err(Failure::usage(format_args!(
            "{} does not end in .svg; the curve is written as SVG",
            path.display()
        )));
    }
    if path.exists() && !overwrite {
        return Err(Failure::usage(format_args!(
            "{} exists already; give another name or --overwrite",
            path.display()
        )));
    }
    Ok(())
}

/// Writes the picture.
pub fn write(path: &Path, curve: &Curve) -> Result<(), Failure> {
    let mut svg = String::new();
    draw(&mut svg, curve)
        .map_err(|e| Failure::new(Kind::Failure, format_args!("cannot draw the curve: {e}")))?;
    std::fs::write(path, svg).map_err(|e| {
        Failure::new(
            Kind::Output,
            format_args!("cannot write {}: {e}", path.display()),
        )
    })
}

fn draw(svg: &mut String, curve: &Curve) -> Result<(), Box<dyn std::error::Error>> {
    let on = |v: f64, log: bool| if log { v.log10() } else { v };
    let off = |v: f64, log: bool| digits(if log { 10f64.powf(v) } else { v });
    let series: Vec<(&str, Vec<(f64, f64)>)> = curve
        .series
        .iter()
        .map(|s| {
            let placed = s
                .points
                .iter()
                .map(|(x, y)| (on(*x, curve.log.0), on(*y, curve.log.1)));
            let drawn = placed.filter(|(x, y)| x.is_finite() && y.is_finite());
            (s.name.as_str(), drawn.collect())
        })
        .collect();
    let all = || series.iter().flat_map(|s| &s.1);
    let (xs, ys) = (range(all().map(|p| p.0)), range(all().map(|p| p.1)));
    let area = SVGBackend::with_string(svg, SIZE).into_drawing_area();
    area.fill(&WHITE)?;
    let mut chart = ChartBuilder::on(&area)
        .caption(&curve.title, ("sans-serif", 22))
        .margin(12)
        .x_label_area_size(48)
        .y_label_area_size(84)
        .build_cartesian_2d(xs, ys)?;
    chart
        .configure_mesh()
        .x_desc(&curve.x)
        .y_desc(&curve.y)
        .x_label_formatter(&|v| off(*v, curve.log.0))
        .y_label_formatter(&|v| off(*v, curve.log.1))
        .light_line_style(WHITE)
        .draw()?;
    for (k, (name, points)) in series.iter().enumerate() {
        let colour = COLOURS[k % COLOURS.len()];
        let line = LineSeries::new(points.iter().copied(), colour.stroke_width(2)).point_size(3);
        chart.draw_series(line)?.label(*name).legend(move |(x, y)| {
            PathElement::new(vec![(x, y), (x + 18, y)], colour.stroke_width(2))
        });
    }
    chart
        .configure_series_labels()
        .background_style(WHITE.mix(0.85))
        .border_style(BLACK.mix(0.3))
        .position(SeriesLabelPosition::UpperRight)
        .draw()?;
    area.present()?;
    Ok(())
}

/// From the least to the largest with a margin; 0 to 1 for nothing.
fn range(values: impl Iterator<Item = f64>) -> Range<f64> {
    let (low, high) = values.fold((f64::MAX, f64::MIN), |(a, b), v| (a.min(v), b.max(v)));
    if low > high {
        return 0.0..1.0;
    }
    let margin = (0.06 * (high - low)).max(1e-6 * (1.0 + high.abs()));
    low - margin..high + margin
}
