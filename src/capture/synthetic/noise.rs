//! From exact depth to what a sensor would give.
//!
//! In the order of the physics: depth noise (correlated, in inverse depth for triangulating
//! sensors), disparity steps, ragged edges or flying pixels, the shadow the second camera cannot
//! see, surfaces too slanted to match, speckle holes; then rounding to the unit and the range.
//! The numbers and their sources are in [`super::sensor`]. One frame is a pure function of the
//! view, the keys and the parameters.

use super::field::{Kind, White, Window};
use super::random::scatter;
use super::render::View;
use super::sensor::Sensor;
use multiversion::multiversion;

/// Side of the window of the hole field, pixels: the size of a speckle.
const HOLE_SIDE: usize = 7;
/// Slope (tangent of the tilt) from which a surface starts to be lost: about 72°.
const SLANT: f32 = 3.0;
/// How fast it is lost beyond, standard deviations per unit of slope: half at 80°, all at 84°.
const SLANT_LOSS: f32 = 1.0;
/// Slope that is a jump between two surfaces and not a surface.
const JUMP: f32 = 20.0;
/// Lateral noise at a jump, pixels (Nguyen et al. 2012).
const LATERAL_PX: f32 = 0.8;
/// Pixels at a jump are lost where the depth noise is above this: a third of them.
const JUMP_LEVEL: f32 = 0.43;
/// Score of what the second camera does not see.
const HIDDEN: f32 = 1e6;

/// What a pixel must know to become an integer.
#[derive(Clone, Copy, Debug)]
pub(super) struct Coding {
    /// Metres per integer.
    pub unit_m: f64,
    /// The integer of a lost pixel.
    pub hole: u16,
    /// Focal length, pixels.
    pub focal_px: f64,
}

/// Turns views into frames of one sensor; owns the scratch, allocates nothing per frame.
#[derive(Debug)]
pub(super) struct Noise {
    sensor: Sensor,
    coding: Coding,
    width: usize,
    depth_window: Window,
    hole_window: Window,
    depth_white: Vec<i32>,
    hole_white: Vec<i32>,
    rows: Rows,
    /// Inverse depth of three rows, one pixel of border on either side.
    lines: [Vec<f32>; 3],
}

/// One row on its way through the sensor.
#[derive(Debug)]
struct Rows {
    depth: Vec<f32>,
    hole: Vec<f32>,
    slope: Vec<f32>,
    /// What counts against the pixel, in standard deviations: lost above [`Law::hole_level`].
    score: Vec<f32>,
    /// 0, or [`HIDDEN`].
    shadow: Vec<f32>,
}

/// The sensor's numbers in the precision of the row kernel.
#[derive(Clone, Copy, Debug)]
struct Law {
    sigma_inverse: f32,
    step: f32,
    sigma_floor: f32,
    sigma_growth: f32,
    half_focal: f32,
    near: f32,
    far: f32,
    per_unit: f32,
    hole_level: f32,
    hole: u16,
}

impl Law {
    fn of(sensor: &Sensor, coding: &Coding) -> Self {
        Self {
            sigma_inverse: sensor.sigma_inverse_m as f32,
            step: sensor.step_inverse_m as f32,
            sigma_floor: sensor.sigma_floor_m as f32,
            sigma_growth: sensor.sigma_growth_per_m as f32,
            half_focal: 0.5 * coding.focal_px as f32,
            near: sensor.range_m.0 as f32,
            // 65535 marks a hole for many readers: never a depth
            far: sensor.range_m.1.min(65534.0 * coding.unit_m) as f32,
            per_unit: (1.0 / coding.unit_m) as f32,
            hole_level: sensor.hole_level,
            hole: coding.hole,
        }
    }

    /// The integer for depth `z`, the hole's where it is out of range or not a number.
    #[inline(always)]
    fn code(self, z: f32, lost: bool) -> u16 {
        let seen = !lost & (z >= self.near) & (z <= self.far);
        // after adding 2²³ the low bits of a float are its integer: unlike `as`, this vectorises
        let code = ((z * self.per_unit + 0.5).floor() + 8_388_608.0).to_bits() as u16;
        if seen & (code > 0) { code } else { self.hole }
    }

    /// Depth measured where the true inverse depth is `w`, with unit normal noise `n`.
    #[inline(always)]
    fn measure(self, w: f32, n: f32) -> f32 {
        let mut measured = w + self.sigma_inverse * n;
        if self.step > 0.0 {
            measured = (measured / self.step + 0.5).floor() * self.step;
        }
        let z = 1.0 / measured;
        z + (self.sigma_floor + self.sigma_growth * z * z) * n
    }
}

impl Noise {
    pub fn new(sensor: Sensor, coding: Coding, width: usize) -> Self {
        let depth_window = Window::new(Kind::Depth, sensor.window_px, width);
        let hole_window = Window::new(Kind::Hole, HOLE_SIDE, width);
        let padded = depth_window.padded().max(hole_window.padded());
        Self {
            sensor,
            coding,
            width,
            depth_window,
            hole_window,
            depth_white: vec![0; padded],
            hole_white: vec![0; padded],
            rows: Rows {
                depth: vec![0.0; width],
                hole: vec![0.0; width],
                slope: vec![0.0; width],
                score: vec![0.0; width],
                shadow: vec![0.0; width],
            },
            lines: std::array::from_fn(|_| vec![0.0; width + 2]),
        }
    }

    /// Fills `out` (as long as the view) with what the sensor gives. `dropout[id]` is that of
    /// surface `id`, entry 0 unused.
    pub fn apply(&mut self, view: &View, dropout: &[f32], white: White, out: &mut [u16]) {
        assert_eq!(view.inverse_depth.len(), out.len());
        let height = out.len() / self.width;
        self.depth_window.restart();
        self.hole_window.restart();
        for y in 1..HOLE_SIDE {
            self.push_white(white, -(y as i32));
        }
        let (law, width) = (Law::of(&self.sensor, &self.coding), self.width);
        load_line(&mut self.lines[0], &view.inverse_depth[..width]);
        load_line(&mut self.lines[1], &view.inverse_depth[..width]);
        for y in 0..height {
            let below = (y + 1).min(height - 1) * width;
            load_line(
                &mut self.lines[2],
                &view.inverse_depth[below..below + width],
            );
            self.push_white(white, y as i32);
            self.depth_window.normal(&mut self.rows.depth);
            self.hole_window.normal(&mut self.rows.hole);
            self.cast_shadow();
            let span = y * width..(y + 1) * width;
            let [above, here, below] = &self.lines;
            let out = &mut out[span.clone()];
            measure_row(law, [above, here, below], &mut self.rows, out);
            self.mend_row(law, &view.surface[span], dropout, out);
            self.lines.rotate_left(1);
        }
    }

    fn push_white(&mut self, white: White, y: i32) {
        white.row(y, &mut self.depth_white, &mut self.hole_white);
        self.depth_window.push(&self.depth_white);
        self.hole_window.push(&self.hole_white);
    }

    /// Marks what the second camera (to the right) or the projector does not see: a point is
    /// hidden when something to its right falls on the same place, or left of it, over there.
    fn cast_shadow(&mut self) {
        let shift = (self.sensor.baseline_m * self.coding.focal_px) as f32;
        if shift == 0.0 {
            return;
        }
        let line = &self.lines[1][1..=self.width];
        let mut least = f32::INFINITY;
        let border = if self.sensor.blind_border {
            0.0
        } else {
            f32::NEG_INFINITY
        };
        for x in (0..self.width).rev() {
            let place = x as f32 - shift * line[x];
            // half a pixel for the slant of ordinary surfaces
            let hidden = place > least + 0.5 || place < border;
            self.rows.shadow[x] = if hidden { HIDDEN } else { 0.0 };
            least = least.min(place);
        }
    }

    /// Treats the few pixels apart that are at a jump or on a surface that is hard to see.
    fn mend_row(&self, law: Law, surface: &[u16], dropout: &[f32], out: &mut [u16]) {
        let rows = &self.rows;
        let line = &self.lines[1];
        let width = out.len();
        for (x, (out, &id)) in out.iter_mut().zip(surface).enumerate() {
            let (n, h) = (rows.depth[x], rows.hole[x]);
            if rows.slope[x] < JUMP {
                let dropout = dropout.get(usize::from(id)).copied().unwrap_or(0.0);
                if dropout > 0.0 && rows.score[x] > law.hole_level - dropout {
                    *out = law.hole;
                }
                continue;
            }
            let lost = n > JUMP_LEVEL || rows.shadow[x] > 0.0;
            let z = if self.sensor.flying_pixels {
                let share = (0.5 + 0.5 * h).clamp(0.0, 1.0);
                let depth = |w: f32| if w > 0.0 { 1.0 / w } else { 0.0 };
                let (left, right) = (depth(line[x]), depth(line[x + 2]));
                left + share * (right - left)
            } else {
                let moved = (LATERAL_PX * h).round() as i64 + x as i64;
                let moved = moved.clamp(0, width as i64 - 1) as usize;
                law.measure(line[moved + 1], n)
            };
            *out = law.code(z, lost);
        }
    }

    /// Fills `out` with exact depth: rounded to the unit, nothing lost.
    pub fn exact(&self, view: &View, out: &mut [u16]) {
        let (unit, hole) = (self.coding.unit_m, self.coding.hole);
        for (out, &w) in out.iter_mut().zip(&view.inverse_depth) {
            let code = 1.0 / (w * unit);
            // beyond the last code, or nothing there
            *out = if (0.5..65534.5).contains(&code) {
                (code + 0.5) as u16
            } else {
                hole
            };
        }
    }
}

/// A frame without any picture: every integer as likely as any other.
pub(super) fn pure_noise(key: u32, out: &mut [u16]) {
    for (x, out) in (0_u32..).zip(out) {
        *out = (scatter(key.wrapping_add(x)) >> 16) as u16;
    }
}

/// Copies a row, repeating its first and last value as a border.
fn load_line(line: &mut [f32], row: &[f64]) {
    let width = row.len();
    for (line, &w) in line[1..=width].iter_mut().zip(row) {
        *line = w as f32;
    }
    line[0] = line[1];
    line[width + 1] = line[width];
}

/// Noise, steps, losses and code of one row, jumps left aside. `lines` are the rows above, here
/// and below with a border of one; the slope is the tangent of the surface's tilt against the ray
/// (near the image centre). Where nothing is (inverse depth 0) noise alone stays out of range.
#[multiversion(targets("x86_64+avx2"))]
fn measure_row(law: Law, lines: [&[f32]; 3], rows: &mut Rows, out: &mut [u16]) {
    let width = out.len();
    let [above, here, below] = lines.map(|line| &line[..width + 2]);
    let (depth, hole, shadow) = (
        &rows.depth[..width],
        &rows.hole[..width],
        &rows.shadow[..width],
    );
    let (slope, score) = (&mut rows.slope[..width], &mut rows.score[..width]);
    for x in 0..width {
        let w = here[x + 1];
        let dx = (here[x + 2] - here[x]).abs();
        let dy = (below[x + 1] - above[x + 1]).abs();
        let tilt = law.half_focal * (dx + dy) / w.max(1e-6);
        let against = hole[x] + shadow[x] + SLANT_LOSS * (tilt - SLANT).max(0.0);
        slope[x] = tilt;
        score[x] = against;
        out[x] = law.code(law.measure(w, depth[x]), against > law.hole_level);
    }
}
