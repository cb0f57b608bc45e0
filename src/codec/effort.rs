//! Effort: how long the encoder looks for fewer bits.
//!
//! Live, bits are few and have one context each, and one guess of what spheres and boundaries cost
//! serves all frames. Mixing three contexts, with a bit for each pixel that may miss its sphere, saves
//! 2 to 4 % at the default bound, 4 to 7 % without loss. For an archive each frame is encoded with
//! several guesses, too, and the one is kept that costs least, bits and errors together.

/// How long the encoder looks for fewer bits.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Effort {
    /// Once through each frame, coded for speed in writing and reading.
    #[default]
    Live,
    /// Once through each frame, with mixed contexts.
    Usual,
    /// Each frame in several ways: some six times the time.
    Max,
}

/// What the encoder takes spheres and boundaries to cost, and how finely it states spheres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Thrift {
    /// One more sphere in a block, its boundary included, in 1/16 bit.
    pub entry: u32,
    /// Stating a sphere, in 1/16 bit: shared by its blocks.
    pub sphere: u32,
    /// Share of the contact distance that one quantisation step takes.
    pub step: f64,
}

/// The guess for all frames. Steps of half that size or twice that size change the bits at equal
/// Chamfer distance by less than 3 %.
pub(super) const USUAL: Thrift = Thrift {
    entry: 20 * 16,
    sphere: 28 * 16,
    step: 0.12,
};

/// What [`Effort::Max`] tries.
pub(super) const TRIALS: [Thrift; 6] = [
    USUAL,
    Thrift {
        entry: 34 * 16,
        ..USUAL
    },
    Thrift {
        sphere: 80 * 16,
        ..USUAL
    },
    Thrift { step: 0.2, ..USUAL },
    Thrift {
        entry: 34 * 16,
        sphere: 80 * 16,
        step: 0.2,
    },
    Thrift {
        entry: 50 * 16,
        sphere: 160 * 16,
        step: 0.3,
    },
];
