//! The SAINT loss for other languages: a C ABI (feature `capi`, header `include/saint_live.h`).
//!
//! ```text
//! cargo rustc --release --lib --features capi --crate-type cdylib
//! ```
//! makes `target/release/libsaint_live.so`. `examples/torch_loss.py` calls it from PyTorch.
//!
//! Plain pointers and counts come in; every pointer is checked for null and every count for
//! overflow before memory is read. What cannot be checked is the caller's duty: a pointer that
//! is not null must point to as many values as the header says, aligned, and outputs must not
//! overlap inputs. Nothing is kept after a call and no memory changes hands; calls from several
//! threads are safe.
#![allow(
    unsafe_code,
    reason = "the only place where memory of another language is read and written"
)]

use crate::loss::{Ball, LossError, LossGradient, Owners, Penalty, SaintLoss};
use glam::DVec3;
use std::panic::catch_unwind;
use std::slice;

/// Version of this interface: it grows when a struct or a meaning changes.
pub const ABI_VERSION: u32 = 1;

/// Done.
pub const OK: i32 = 0;
/// A pointer is null where values are announced.
pub const NULL_POINTER: i32 = 1;
/// A count is larger than memory.
pub const TOO_MANY: i32 = 2;
/// A value is not finite, a radius or weight negative, the Huber distance not above 0.
pub const BAD_VALUE: i32 = 3;
/// A point names a sphere that is not there.
pub const BAD_OWNER: i32 = 4;
/// The penalty is none of the three.
pub const BAD_PENALTY: i32 = 5;
/// A fault of the library.
pub const FAULT: i32 = 6;

/// What goes in: `saint_live_loss_input` of the header.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct LossInput {
    /// x y z of each point, metres.
    pub points: *const f64,
    /// Number of points.
    pub point_count: usize,
    /// x y z and radius of each sphere, metres.
    pub spheres: *const f64,
    /// Number of spheres.
    pub sphere_count: usize,
    /// For each point its sphere, `UINT32_MAX` for none; null: the nearest.
    pub owners: *const u32,
    /// For each point its weight; null: 1 each.
    pub weights: *const f64,
    /// 0 absolute, 1 squared, 2 Huber.
    pub penalty: u32,
    /// Huber distance, metres; not looked at otherwise.
    pub huber_m: f64,
}

/// [`ABI_VERSION`].
// SAFETY: the name is this library's own and is defined once.
#[unsafe(no_mangle)]
pub extern "C" fn saint_live_abi_version() -> u32 {
    ABI_VERSION
}

/// The loss and its slopes: `saint_live_loss` of the header. Gradients that are null are not
/// written. On any result but 0 nothing is written.
///
/// # Safety
/// `input` points to a [`LossInput`] whose pointers are null or point to as many values as it
/// announces; `value`, `point_gradient` (3 per point) and `sphere_gradient` (4 per sphere) are
/// null or point to room for that many; outputs overlap nothing.
// SAFETY: the name is this library's own and is defined once.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn saint_live_loss(
    input: *const LossInput,
    value: *mut f64,
    point_gradient: *mut f64,
    sphere_gradient: *mut f64,
) -> i32 {
    let call = || {
        // SAFETY: null is refused by as_ref; else it points to a LossInput (contract above)
        let input = unsafe { input.as_ref() }.ok_or(NULL_POINTER)?;
        if value.is_null() {
            return Err(NULL_POINTER);
        }
        // SAFETY: announced counts are those of the arrays (contract above)
        let (loss, gradient) = unsafe { compute(input) }?;
        // SAFETY: not null, room for one value (contract above)
        unsafe { value.write(loss) };
        if !point_gradient.is_null() {
            // SAFETY: room for three values a point (contract above), of which there are some
            // or none; a count that overflows was refused by compute
            let out = unsafe { slice::from_raw_parts_mut(point_gradient, 3 * input.point_count) };
            for (to, g) in out.chunks_exact_mut(3).zip(&gradient.points) {
                to.copy_from_slice(&g.to_array());
            }
        }
        if !sphere_gradient.is_null() {
            // SAFETY: room for four values a sphere (contract above), count checked by compute
            let out = unsafe { slice::from_raw_parts_mut(sphere_gradient, 4 * input.sphere_count) };
            let slopes = gradient.centers.iter().zip(&gradient.radii);
            for (to, (c, r)) in out.chunks_exact_mut(4).zip(slopes) {
                to.copy_from_slice(&[c.x, c.y, c.z, *r]);
            }
        }
        Ok(())
    };
    // a panic must not cross into another language
    match catch_unwind(std::panic::AssertUnwindSafe(call)) {
        Ok(Ok(())) => OK,
        Ok(Err(code)) => code,
        Err(_) => FAULT,
    }
}

/// # Safety
/// Pointers that are not null point to as many values as announced.
unsafe fn compute(input: &LossInput) -> Result<(f64, LossGradient), i32> {
    // SAFETY: as announced (contract above)
    let (points, spheres, owners, weights) = unsafe {
        (
            array(input.points, input.point_count, 3)?,
            array(input.spheres, input.sphere_count, 4)?,
            optional(input.owners, input.point_count)?,
            optional(input.weights, input.point_count)?,
        )
    };
    let penalty = match input.penalty {
        0 => Penalty::Absolute,
        1 => Penalty::Squared,
        2 => Penalty::Huber(input.huber_m),
        _ => return Err(BAD_PENALTY),
    };
    let points: Vec<DVec3> = points.chunks_exact(3).map(DVec3::from_slice).collect();
    let spheres: Vec<Ball> = spheres
        .chunks_exact(4)
        .map(|s| Ball {
            center: DVec3::from_slice(s),
            radius: s[3],
        })
        .collect();
    let loss = SaintLoss {
        points: &points,
        spheres: &spheres,
        owners: owners.map_or(Owners::Nearest, Owners::Given),
        weights,
        penalty,
    };
    let mut gradient = LossGradient::default();
    match loss.gradient(&mut gradient) {
        Ok(value) => Ok((value, gradient)),
        Err(LossError::Owner { .. }) => Err(BAD_OWNER),
        Err(_) => Err(BAD_VALUE),
    }
}

/// `count` records of `width` values; null is allowed for none.
///
/// # Safety
/// `start` is null or points to `count * width` values that nobody writes to for as long.
unsafe fn array<'a, T>(start: *const T, count: usize, width: usize) -> Result<&'a [T], i32> {
    let length = count
        .checked_mul(width)
        .filter(|n| *n <= isize::MAX as usize / size_of::<T>())
        .ok_or(TOO_MANY)?;
    match (length, start.is_null()) {
        (0, _) => Ok(&[]),
        (_, true) => Err(NULL_POINTER),
        // SAFETY: not null, of that length (contract above), within isize
        (_, false) => Ok(unsafe { slice::from_raw_parts(start, length) }),
    }
}

/// As [`array`], null meaning that there is none.
///
/// # Safety
/// As [`array`].
unsafe fn optional<'a, T>(start: *const T, count: usize) -> Result<Option<&'a [T]>, i32> {
    if start.is_null() {
        return Ok(None);
    }
    // SAFETY: the same contract
    unsafe { array(start, count, 1) }.map(Some)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::ptr::{null, null_mut};

    fn input(points: &[f64], spheres: &[f64]) -> LossInput {
        LossInput {
            points: points.as_ptr(),
            point_count: points.len() / 3,
            spheres: spheres.as_ptr(),
            sphere_count: spheres.len() / 4,
            owners: null(),
            weights: null(),
            penalty: 1,
            huber_m: 0.0,
        }
    }

    fn call(input: &LossInput) -> (i32, f64, [f64; 6], [f64; 4]) {
        let (mut value, mut points, mut spheres) = (-1.0, [-1.0; 6], [-1.0; 4]);
        // SAFETY: two points and one sphere at most, the outputs have that room
        let code = unsafe {
            saint_live_loss(input, &mut value, points.as_mut_ptr(), spheres.as_mut_ptr())
        };
        (code, value, points, spheres)
    }

    #[test]
    fn the_door_gives_what_the_library_gives() {
        let (points, spheres) = ([2.0, 0.0, 0.0, 0.0, 0.5, 0.0], [0.0, 0.0, 0.0, 1.0]);
        let (code, value, p, s) = call(&input(&points, &spheres));
        // distances 1 and -0.5: mean of squares, slopes 2 s u / 2
        assert_eq!((code, value), (OK, 0.625));
        assert_eq!(p, [1.0, 0.0, 0.0, 0.0, -0.5, 0.0]);
        assert_eq!(s, [-1.0, 0.5, 0.0, -0.5]);
        let mut alone = 0.0;
        // SAFETY: null gradients are not written
        let code = unsafe {
            saint_live_loss(
                &input(&points, &spheres),
                &mut alone,
                null_mut(),
                null_mut(),
            )
        };
        assert_eq!((code, alone), (OK, value));
    }

    #[test]
    fn bad_calls_write_nothing() {
        let (points, spheres) = ([2.0, 0.0, 0.0, 0.0, 0.5, 0.0], [0.0, 0.0, 0.0, 1.0]);
        let good = input(&points, &spheres);
        let owners = [0u32, 1];
        for (bad, code) in [
            (
                LossInput {
                    points: null(),
                    ..good
                },
                NULL_POINTER,
            ),
            (
                LossInput {
                    spheres: null(),
                    ..good
                },
                NULL_POINTER,
            ),
            (
                LossInput {
                    point_count: usize::MAX,
                    ..good
                },
                TOO_MANY,
            ),
            (
                LossInput {
                    sphere_count: usize::MAX / 32,
                    ..good
                },
                TOO_MANY,
            ),
            (LossInput { penalty: 3, ..good }, BAD_PENALTY),
            (LossInput { penalty: 2, ..good }, BAD_VALUE),
            (
                LossInput {
                    owners: owners.as_ptr(),
                    ..good
                },
                BAD_OWNER,
            ),
        ] {
            assert_eq!(call(&bad), (code, -1.0, [-1.0; 6], [-1.0; 4]));
        }
        let none = LossInput {
            points: null(),
            point_count: 0,
            ..good
        };
        assert_eq!(call(&none).0, OK);
        // SAFETY: null is what is tested
        let code = unsafe { saint_live_loss(null(), null_mut(), null_mut(), null_mut()) };
        assert_eq!(code, NULL_POINTER);
    }

    #[test]
    fn the_header_says_the_same() {
        let header = include_str!("../include/saint_live.h");
        let defines = [
            ("SAINT_LIVE_ABI_VERSION", ABI_VERSION as i32),
            ("SAINT_LIVE_OK", OK),
            ("SAINT_LIVE_NULL_POINTER", NULL_POINTER),
            ("SAINT_LIVE_TOO_MANY", TOO_MANY),
            ("SAINT_LIVE_BAD_VALUE", BAD_VALUE),
            ("SAINT_LIVE_BAD_OWNER", BAD_OWNER),
            ("SAINT_LIVE_BAD_PENALTY", BAD_PENALTY),
            ("SAINT_LIVE_FAULT", FAULT),
        ];
        for (name, value) in defines {
            let line = header
                .lines()
                .find_map(|l| l.strip_prefix(&format!("#define {name} ")));
            let said = line.and_then(|l| l.split_whitespace().next()?.parse().ok());
            assert_eq!(said, Some(value), "{name}");
        }
    }
}
