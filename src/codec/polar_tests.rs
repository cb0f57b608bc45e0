use super::*;
use crate::contact_map::polar::PatchCell;
use glam::Vec3;
use proptest::prelude::*;

fn patch(i: u32) -> Patch {
    Patch {
        anchor: Vec3::new(i as f32, 0.5, -2.0),
        normal: Vec3::new(0.6, 0.0, 0.8),
        curvature: i as f32 * 0.25 - 1.0,
    }
}

fn map(claims: &[Vec<(i32, i32)>]) -> ClaimMap {
    let mut map = ClaimMap {
        origin: DVec3::new(448_262.0, 5_411_932.0, -113.0),
        step_m: 0.002,
        patches: (0..claims.len() as u32).map(patch).collect(),
        starts: vec![0],
        cells: Vec::new(),
    };
    for own in claims {
        let mut own: Vec<PatchCell> = own
            .iter()
            .map(|&(row, column)| PatchCell { row, column })
            .collect();
        own.sort();
        own.dedup();
        map.cells.extend(own);
        map.starts.push(map.cells.len() as u32);
    }
    map
}

fn sample() -> ClaimMap {
    map(&[
        vec![(-3, 5), (-3, 6), (-3, 9), (0, -400), (70_000, 0)],
        vec![],
        vec![
            (-MAX_STEPS, -MAX_STEPS),
            (-MAX_STEPS, MAX_STEPS),
            (MAX_STEPS, -MAX_STEPS),
            (MAX_STEPS, MAX_STEPS),
        ],
        vec![(0, 0)],
    ])
}

fn bytes(map: &ClaimMap) -> Vec<u8> {
    let mut bytes = Vec::new();
    encode(map, &mut bytes).unwrap();
    bytes
}

/// The same bytes with a check that matches: what a hostile writer would send.
fn resealed(bytes: &[u8]) -> Vec<u8> {
    let body = &bytes[..bytes.len().saturating_sub(CHECK_BYTES)];
    [body, &crc32fast::hash(body).to_le_bytes()].concat()
}

#[test]
fn round_trips() {
    for map in [sample(), map(&[])] {
        assert_eq!(decode(&bytes(&map)).unwrap(), map);
    }
}

#[test]
fn another_version_is_refused_by_its_number() {
    let mut old = bytes(&sample());
    old[4] = 1;
    let error = decode(&resealed(&old)).unwrap_err();
    let (version, flags, known) = (1, 0, 2);
    let expected = PolarCodecError::Unsupported {
        version,
        flags,
        known,
    };
    assert_eq!(error, expected);
    assert!(error.to_string().contains("make the file anew"), "{error}");
    old[4] = 3;
    let error = decode(&resealed(&old)).unwrap_err();
    assert!(error.to_string().contains("newer program"), "{error}");
}

#[test]
fn every_prefix_and_every_extra_byte_fails() {
    let whole = bytes(&sample());
    for length in 0..whole.len() {
        assert!(
            decode(&whole[..length]).is_err(),
            "prefix of {length} bytes was read"
        );
        // the coder knows an end by its checksum only: another map, or an error
        if let Ok(map) = decode(&resealed(&whole[..length])) {
            assert_ne!(map, sample(), "resealed prefix of {length} bytes");
        }
    }
    assert!(decode(&[&whole[..], &[0]].concat()).is_err());
    let mut extra = whole.clone();
    let end = whole.len() - CHECK_BYTES;
    extra.splice(end..end, [1; 16]);
    assert!(decode(&resealed(&extra)).is_err());
    extra.truncate(end);
    extra.extend([0; 16]);
    extra.extend([1; 4]);
    extra.extend([0; 4]);
    let extra = decode(&resealed(&extra)).unwrap_err();
    assert!(matches!(extra, PolarCodecError::Extra { .. }), "{extra}");
}

#[test]
fn every_flipped_bit_fails_and_resealed_never_panics() {
    let whole = bytes(&sample());
    for at in 0..whole.len() {
        for bit in 0..8 {
            let mut damaged = whole.clone();
            damaged[at] ^= 1 << bit;
            assert!(decode(&damaged).is_err(), "bit {bit} of byte {at}");
            if let Ok(map) = decode(&resealed(&damaged)) {
                // what is read is well formed: it can be written
                assert_eq!(decode(&bytes(&map)).unwrap(), map, "bit {bit} of byte {at}");
            }
        }
    }
}

#[test]
fn counts_are_checked_before_memory_is_taken() {
    // spheres, claims
    for (place, spheres) in [(2, u32::MAX as usize), (1, 0)] {
        let mut many = bytes(&map(&[]));
        let at = many.len() - CHECK_BYTES - place;
        many.splice(at..=at, [0xff, 0xff, 0xff, 0xff, 0x0f]);
        let error = decode(&resealed(&many)).unwrap_err();
        let left = 0;
        let expected = PolarCodecError::Count {
            what: "spheres and claims",
            count: u32::MAX as usize,
            left,
        };
        assert_eq!(error, expected, "{spheres}");
    }
}

/// A whole square of cells costs next to nothing, and is filled up to what a byte may hold.
#[test]
fn a_full_square_is_padded() {
    let cells = (0..200).flat_map(|r| (0..200).map(move |c| (r, c)));
    let square = map(&[cells.collect()]);
    let bytes = bytes(&square);
    assert!(bytes.len() >= 40_001 / MOST_IN_A_BYTE);
    assert!(
        bytes.len() < 40_001 / MOST_IN_A_BYTE + 60,
        "{}",
        bytes.len()
    );
    assert_eq!(decode(&bytes).unwrap(), square);
}

/// A lattice that lies at a slant, as the pixels of a camera do.
#[test]
fn a_lattice_costs_less_than_its_density() {
    let lattice = (0..300).flat_map(|v| {
        (0..300).map(move |u| {
            let (u, v) = (f64::from(u), f64::from(v));
            let (row, column) = (1.31 * v + 0.21 * u, 1.45 * u - 0.17 * v);
            (row.round() as i32, column.round() as i32)
        })
    });
    let map = map(&[lattice.collect()]);
    let bits = 8.0 * bytes(&map).len() as f64 / map.cells.len() as f64;
    // half of the cells are claimed, which is two bits a claim if nothing else is known
    assert!(bits < 1.3, "{bits} bits a claim");
    assert_eq!(decode(&bytes(&map)).unwrap(), map);
}

#[test]
fn maps_that_break_their_rules_are_not_written() {
    let spoil: [fn(&mut ClaimMap); 8] = [
        |m| m.step_m = 0.0,
        |m| m.origin.x = f64::NAN,
        |m| m.starts[1] = 99,
        |m| m.starts.truncate(2),
        |m| m.cells.swap(0, 1),
        |m| m.cells[4].row = MAX_STEPS + 1,
        |m| m.patches[0].normal = Vec3::ZERO,
        |m| m.patches[1].curvature = f32::INFINITY,
    ];
    for (n, spoil) in spoil.into_iter().enumerate() {
        let mut map = sample();
        spoil(&mut map);
        let mut bytes = vec![7];
        assert!(encode(&map, &mut bytes).is_err(), "case {n}");
        assert_eq!(bytes, [7], "case {n}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]
    #[test]
    fn any_map_round_trips(
        claims in proptest::collection::vec(
            proptest::collection::vec((-300i32..300, -9i32..9), 0..60), 0..8),
    ) {
        let map = map(&claims);
        prop_assert_eq!(decode(&bytes(&map)).unwrap(), map);
    }

    #[test]
    fn any_bytes_are_survived(body in proptest::collection::vec(any::<u8>(), 0..200)) {
        let header = &bytes(&map(&[]))[..34];
        let _ = decode(&body);
        let _ = decode(&resealed(&[header, &[5, 200, 1], &body].concat()));
    }

    #[test]
    fn any_floats_come_back_to_the_bit(floats in proptest::collection::vec(any::<[u32; 7]>(), 1..20)) {
        use super::super::range_coder::{Decoder, Encoder};
        let patches: Vec<Patch> = floats.iter().map(|bits| {
            let f = bits.map(f32::from_bits);
            Patch {
                anchor: Vec3::new(f[0], f[1], f[2]),
                normal: Vec3::new(f[3], f[4], f[5]),
                curvature: f[6],
            }
        }).collect();
        let mut bytes = Vec::new();
        let (mut coder, mut models) = (Encoder::new(&mut bytes), Models::default());
        for patch in &patches {
            polar_claims::code_patch(&mut coder, &mut models, true, Some(patch));
        }
        coder.finish();
        let (mut coder, mut models) = (Decoder::new(&bytes), Models::default());
        for bits in floats {
            let read = polar_claims::code_patch(&mut coder, &mut models, true, None);
            prop_assert_eq!(super::floats(&read).map(f32::to_bits), bits);
        }
        prop_assert!(!coder.overran());
    }
}
