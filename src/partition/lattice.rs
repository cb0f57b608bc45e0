//! Cell centres on a lattice: hexagonal close packing, and cubic for comparison (paper 4.1).
//!
//! The densest packing of equal spheres (Kepler) is reached by the face-centred cubic lattice,
//! whose points are the integer triples with an even sum. Its nearest point to a position is
//! found by rounding (Conway & Sloane, *Sphere Packings, Lattices and Groups*, ch. 20): round
//! each coordinate; where the sum is odd, round the coordinate that was rounded farthest the
//! other way.
//!
//! Comparing packings. `spacing_m` is the distance between neighbouring centres. At *equal
//! spacing* FCC has √2 times the cells of cubic, so its residual is smaller for that reason
//! alone. At *equal cell count* ([`Lattice::with_cell_volume`]) the comparison is fair: the FCC
//! cell (a rhombic dodecahedron) is rounder than the cube of the same volume.

use glam::{DVec3, Vec3};
use std::fmt;
use std::str::FromStr;

/// Which lattice the cell centres form.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Packing {
    /// Face-centred cubic: hexagonal layers, the densest packing.
    #[default]
    Hexagonal,
    /// Simple cubic.
    Cubic,
}

impl fmt::Display for Packing {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Hexagonal => "hex",
            Self::Cubic => "cubic",
        })
    }
}

impl FromStr for Packing {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "hex" | "hexagonal" => Ok(Self::Hexagonal),
            "cubic" => Ok(Self::Cubic),
            _ => Err(format!("packing {text:?} is unknown; use hex or cubic")),
        }
    }
}

/// A lattice of cell centres about the local origin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lattice {
    /// Hexagonal or cubic.
    pub kind: Packing,
    /// Distance between neighbouring centres, metres.
    pub spacing_m: f64,
    /// Position of the lattice point (0, 0, 0), metres.
    pub offset: DVec3,
}

/// A cell's integer coordinates on its lattice.
pub type CellIndex = [i32; 3];

/// Largest cell coordinate: three of them pack into the 63 bits of a sort key.
const INDEX_LIMIT: f64 = ((1i64 << 20) - 2) as f64;

impl Lattice {
    /// A lattice with a centre at the local origin.
    #[must_use]
    pub fn new(kind: Packing, spacing_m: f64) -> Self {
        Self {
            kind,
            spacing_m,
            offset: DVec3::ZERO,
        }
    }

    /// A lattice whose cells have this volume (m³): the fair way to compare packings.
    #[must_use]
    pub fn with_cell_volume(kind: Packing, volume_m3: f64) -> Self {
        // one cell takes step³ (cubic, spacing = step) or 2·step³ (FCC, spacing = √2·step)
        let spacing_m = match kind {
            Packing::Cubic => volume_m3.cbrt(),
            Packing::Hexagonal => (volume_m3 / 2.0).cbrt() * std::f64::consts::SQRT_2,
        };
        Self::new(kind, spacing_m)
    }

    /// Volume of one cell, m³.
    #[must_use]
    pub fn cell_volume(&self) -> f64 {
        let step = self.step();
        match self.kind {
            Packing::Cubic => step.powi(3),
            Packing::Hexagonal => 2.0 * step.powi(3),
        }
    }

    /// Distance from a centre to its cell's farthest corner, metres.
    #[must_use]
    pub fn cell_radius(&self) -> f64 {
        match self.kind {
            Packing::Cubic => self.step() * 0.75f64.sqrt(),
            Packing::Hexagonal => self.step(),
        }
    }

    /// Metres per integer coordinate.
    fn step(&self) -> f64 {
        match self.kind {
            Packing::Cubic => self.spacing_m,
            Packing::Hexagonal => self.spacing_m / std::f64::consts::SQRT_2,
        }
    }

    /// Integer coordinates of the centre nearest to `p` (metres about the local origin). Always
    /// a lattice point; positions beyond ±2²⁰ cells are taken to the border.
    #[must_use]
    pub fn nearest(&self, p: Vec3) -> CellIndex {
        let q = ((p.as_dvec3() - self.offset) / self.step())
            .clamp(DVec3::splat(-INDEX_LIMIT), DVec3::splat(INDEX_LIMIT));
        let r = q.round();
        let mut index = [r.x as i32, r.y as i32, r.z as i32];
        if self.kind == Packing::Hexagonal && (index[0] + index[1] + index[2]) & 1 != 0 {
            let off = (q - r).to_array();
            let mut worst = 0;
            for axis in 1..3 {
                if off[axis].abs() > off[worst].abs() {
                    worst = axis;
                }
            }
            index[worst] += if off[worst] < 0.0 { -1 } else { 1 };
        }
        index
    }

    /// Position of a centre, metres about the local origin.
    #[must_use]
    pub fn center(&self, index: CellIndex) -> DVec3 {
        DVec3::new(
            f64::from(index[0]),
            f64::from(index[1]),
            f64::from(index[2]),
        ) * self.step()
            + self.offset
    }
}

/// A cell's sort key: order is by z, then y, then x.
pub(crate) fn cell_key(index: CellIndex) -> u64 {
    let biased = |v: i32| (i64::from(v) + (1 << 20)) as u64 & ((1 << 21) - 1);
    biased(index[2]) << 42 | biased(index[1]) << 21 | biased(index[0])
}

/// The inverse of [`cell_key`].
pub(crate) fn key_cell(key: u64) -> CellIndex {
    let unbiased = |v: u64| ((v & ((1 << 21) - 1)) as i64 - (1 << 20)) as i32;
    [unbiased(key), unbiased(key >> 21), unbiased(key >> 42)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Every lattice point within two steps, by exhaustion.
    fn nearest_distance(lattice: &Lattice, p: DVec3) -> f64 {
        let base = ((p - lattice.offset) / lattice.step()).floor();
        let mut best = f64::MAX;
        for x in -2..=3 {
            for y in -2..=3 {
                for z in -2..=3 {
                    let index = [base.x as i32 + x, base.y as i32 + y, base.z as i32 + z];
                    let even = (index[0] + index[1] + index[2]) % 2 == 0;
                    if lattice.kind == Packing::Cubic || even {
                        best = best.min(lattice.center(index).distance(p));
                    }
                }
            }
        }
        best
    }

    proptest! {
        #[test]
        fn nearest_is_nearest(
            x in -9f32..9.0, y in -9f32..9.0, z in -9f32..9.0,
            spacing_m in 0.05f64..3.0, offset in 0f64..1.0, cubic in any::<bool>(),
        ) {
            let kind = if cubic { Packing::Cubic } else { Packing::Hexagonal };
            let mut lattice = Lattice::new(kind, spacing_m);
            lattice.offset = DVec3::new(offset, -0.3 * offset, 0.7 * offset);
            let p = Vec3::new(x, y, z);
            let index = lattice.nearest(p);
            if !cubic {
                prop_assert_eq!((index[0] + index[1] + index[2]).rem_euclid(2), 0);
            }
            let found = lattice.center(index).distance(p.as_dvec3());
            let best = nearest_distance(&lattice, p.as_dvec3());
            prop_assert!(found <= best + 1e-9, "{found} but {best} is possible");
            prop_assert!(found <= lattice.cell_radius() + 1e-9);
        }

        #[test]
        fn keys_round_trip(x in -(1i32 << 20)..1 << 20, y in -(1i32 << 20)..1 << 20, z in -(1i32 << 20)..1 << 20) {
            prop_assert_eq!(key_cell(cell_key([x, y, z])), [x, y, z]);
        }
    }

    #[test]
    fn spacing_and_volume_agree() {
        for kind in [Packing::Cubic, Packing::Hexagonal] {
            let lattice = Lattice::with_cell_volume(kind, 0.027);
            assert!((lattice.cell_volume() - 0.027).abs() < 1e-12);
            // nearest neighbour of the centre (0,0,0)
            let neighbour = match kind {
                Packing::Cubic => [1, 0, 0],
                Packing::Hexagonal => [1, 1, 0],
            };
            assert!((lattice.center(neighbour).length() - lattice.spacing_m).abs() < 1e-12);
        }
    }

    #[test]
    fn far_positions_stay_on_the_lattice() {
        let lattice = Lattice::new(Packing::Hexagonal, 1e-6);
        let index = lattice.nearest(Vec3::new(1e9, -1e9, 0.3));
        assert_eq!(key_cell(cell_key(index)), index);
        assert_eq!((index[0] + index[1] + index[2]).rem_euclid(2), 0);
    }
}
