//! The sensor against its own truth, and the truth against an obvious oracle.

mod geometry;
mod sensing;
mod stream;

use super::*;

pub(super) fn small(scene: Scene) -> SyntheticOptions {
    SyntheticOptions {
        width: 160,
        height: 120,
        ..SyntheticOptions::unpaced(scene)
    }
}

pub(super) fn open(options: SyntheticOptions) -> SyntheticSource {
    SyntheticSource::open(options).expect("valid options")
}

pub(super) fn share(flags: impl Iterator<Item = bool>) -> f64 {
    let (mut yes, mut all) = (0.0, 0.0);
    for flag in flags {
        yes += f64::from(u8::from(flag));
        all += 1.0;
    }
    yes / all
}
