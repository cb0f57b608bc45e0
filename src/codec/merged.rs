//! Payload of a model with the paper's merged contact map (`FORMAT.md`, chapter 3).

use super::polar::{PolarCodecError, Reader, put_varint};
use crate::contact_map::merged::LiteralMap;
use crate::contact_map::polar::PolarGrid;
use crate::fit::cloud::CloudModel;
use glam::DVec3;

/// First four bytes of the payload.
pub const MAGIC: [u8; 4] = *b"SMRG";
const VERSION: u8 = 1;
/// Bytes of one sphere.
const SPHERE_BYTES: usize = 16;
/// Most rows of the grid.
const MAX_ROWS: u32 = 1 << 15;

/// What the paper stores (3.2, 5): "sphere radii, centers, and a unified contact map".
#[derive(Clone, Debug, PartialEq)]
pub struct MergedModel {
    /// Zero of all coordinates in the source's, metres.
    pub origin: DVec3,
    /// Centre x, y, z (about the origin) and radius, metres.
    pub floats: Vec<[f32; 4]>,
    /// The grid all spheres share.
    pub grid: PolarGrid,
    /// Cell and sphere number, ascending by cell, each cell once.
    pub cells: Vec<(u32, u32)>,
}

impl MergedModel {
    /// A model's spheres and its merged map.
    #[must_use]
    pub fn new(model: &CloudModel, map: LiteralMap) -> Self {
        Self {
            origin: model.origin,
            floats: model.spheres.iter().map(|s| s.paper_floats()).collect(),
            grid: map.grid,
            cells: map.cells,
        }
    }

    /// Centre and radius of each sphere, metres about the origin.
    pub fn spheres(&self) -> impl Iterator<Item = (DVec3, f64)> + '_ {
        let exact = |[x, y, z, r]: [f32; 4]| {
            let center = DVec3::new(f64::from(x), f64::from(y), f64::from(z));
            (center, f64::from(r))
        };
        self.floats.iter().copied().map(exact)
    }

    /// The points by Eq. 1 (metres about the origin), one per cell, with their sphere's number.
    pub fn points(&self) -> impl Iterator<Item = (DVec3, u32)> + '_ {
        let spheres: Vec<_> = self.spheres().collect();
        self.cells.iter().filter_map(move |&(cell, s)| {
            let (center, radius) = *spheres.get(s as usize)?;
            Some((center + self.grid.middle(cell).point(radius), s))
        })
    }
}

/// Appends the payload of `model` to `bytes`.
///
/// # Errors
/// Numbers that are not finite, cells out of order, or a grid or sphere number out of range.
/// `bytes` is then as it was.
pub fn encode(model: &MergedModel, bytes: &mut Vec<u8>) -> Result<(), PolarCodecError> {
    let refuse = |why| Err(PolarCodecError::Map(why));
    if !model.origin.is_finite() || !model.floats.iter().all(usable) {
        return refuse("a sphere or the origin is not finite");
    }
    if !usable_grid(model.grid) {
        return refuse("the grid must have 1 to 32768 rows and twice as many columns");
    }
    let count = model.grid.rows * model.grid.columns;
    let spheres = model.floats.len();
    let inside = |c: &(u32, u32)| c.0 < count && (c.1 as usize) < spheres;
    if !model.cells.iter().all(inside) || !model.cells.windows(2).all(|w| w[0].0 < w[1].0) {
        return refuse("the cells must ascend, lie on the grid and name a sphere");
    }
    let start = bytes.len();
    bytes.extend_from_slice(&MAGIC);
    bytes.extend_from_slice(&[VERSION, 0]);
    for v in model.origin.to_array() {
        bytes.extend_from_slice(&v.to_le_bytes());
    }
    put_varint(bytes, model.grid.rows);
    put_varint(bytes, spheres as u32);
    for v in model.floats.iter().flatten() {
        bytes.extend_from_slice(&v.to_le_bytes());
    }
    put_varint(bytes, model.cells.len() as u32);
    let mut next = 0;
    for &(cell, sphere) in &model.cells {
        put_varint(bytes, cell - next);
        put_varint(bytes, sphere);
        next = cell + 1;
    }
    let check = crc32fast::hash(&bytes[start..]);
    bytes.extend_from_slice(&check.to_le_bytes());
    Ok(())
}

/// Reads a payload. Safe on any bytes: allocates no more than a small multiple of their length.
///
/// # Errors
/// Any bytes that [`encode`] would not have written.
pub fn decode(bytes: &[u8]) -> Result<MergedModel, PolarCodecError> {
    let mut reader = Reader::checked(bytes, MAGIC, VERSION)?;
    let origin = reader.origin()?;
    let rows = reader.varint("number of rows")?;
    if rows == 0 || rows > MAX_ROWS {
        return Err(reader.value("number of rows"));
    }
    let grid = PolarGrid::new(rows);
    let count = reader.varint("number of spheres")? as usize;
    if count > reader.left() / SPHERE_BYTES {
        return Err(reader.count("spheres", count));
    }
    let mut floats = Vec::with_capacity(count);
    for _ in 0..count {
        let mut sphere = [0f32; 4];
        for v in &mut sphere {
            *v = f32::from_le_bytes(reader.array("sphere")?);
        }
        if !usable(&sphere) {
            return Err(reader.value("sphere"));
        }
        floats.push(sphere);
    }
    let claims = reader.varint("number of cells")? as usize;
    if claims > reader.left() / 2 {
        return Err(reader.count("cells", claims));
    }
    let mut cells = Vec::with_capacity(claims);
    let mut next = 0u64;
    for _ in 0..claims {
        let cell = next + u64::from(reader.varint("cell")?);
        let sphere = reader.varint("sphere of a cell")?;
        if cell >= u64::from(grid.rows * grid.columns) || sphere as usize >= count {
            return Err(reader.value("cell"));
        }
        cells.push((cell as u32, sphere));
        next = cell + 1;
    }
    reader.end()?;
    Ok(MergedModel {
        origin,
        floats,
        grid,
        cells,
    })
}

fn usable(sphere: &[f32; 4]) -> bool {
    sphere.iter().all(|v| v.is_finite()) && sphere[3] > 0.0
}

fn usable_grid(grid: PolarGrid) -> bool {
    (1..=MAX_ROWS).contains(&grid.rows) && grid.columns == 2 * grid.rows
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn model() -> impl Strategy<Value = MergedModel> {
        let sphere = [-9f32..9.0, -9f32..9.0, -9f32..9.0, 0.01f32..1e4];
        let spheres = proptest::collection::vec(sphere, 1..6);
        (
            spheres,
            1u32..300,
            proptest::collection::btree_map(0u32..180_000, 0u32..6, 0..60),
        )
            .prop_map(|(floats, rows, cells)| {
                let grid = PolarGrid::new(rows);
                let (count, spheres) = (grid.rows * grid.columns, floats.len() as u32);
                let cells = cells.into_iter().filter(|c| c.0 < count);
                MergedModel {
                    origin: DVec3::new(448_262.0, -5.0, 0.25),
                    floats,
                    grid,
                    cells: cells.map(|(c, s)| (c, s % spheres)).collect(),
                }
            })
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]
        #[test]
        fn round_trip_and_every_cut_fails(model in model(), at in any::<prop::sample::Index>(), bit in 0u8..8) {
            let mut bytes = Vec::new();
            encode(&model, &mut bytes).unwrap();
            prop_assert_eq!(&decode(&bytes).unwrap(), &model);
            for length in 0..bytes.len() {
                prop_assert!(decode(&bytes[..length]).is_err());
            }
            let at = at.index(bytes.len());
            bytes[at] ^= 1 << bit;
            prop_assert!(decode(&bytes).is_err());
        }

        #[test]
        fn any_bytes_behind_a_right_check_are_safe(body in proptest::collection::vec(any::<u8>(), 0..200)) {
            let mut bytes = [MAGIC.as_slice(), &[VERSION, 0], &[0; 24], &body].concat();
            let check = crc32fast::hash(&bytes);
            bytes.extend_from_slice(&check.to_le_bytes());
            if let Ok(model) = decode(&bytes) {
                prop_assert!(model.points().count() == model.cells.len());
                let mut again = Vec::new();
                encode(&model, &mut again).unwrap();
                prop_assert_eq!(again, bytes);
            }
        }
    }
}
