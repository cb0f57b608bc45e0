use super::*;
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
fn golden_bytes_of_version_one() {
    let mut one = map(&[vec![(-1, 2), (-1, 3), (1, -1)]]);
    one.origin = DVec3::ZERO;
    one.step_m = 1.0;
    let found = bytes(&one);
    let mut golden = b"SPOL\x01\x00".to_vec();
    golden.extend([0; 24]);
    golden.extend([0, 0, 0x80, 0x3f, 1]);
    for v in [0f32, 0.5, -2.0, 0.6, 0.0, 0.8, -1.0] {
        golden.extend(v.to_le_bytes());
    }
    // three claims; row −1 = zigzag 1; column 2 = zigzag 4; next column; two rows up; 2 to −1
    golden.extend([3, 3, 4, 0, 3, 5]);
    golden.extend(crc32fast::hash(&golden).to_le_bytes());
    assert_eq!(found, golden);
}

#[test]
fn every_prefix_and_every_extra_byte_fails() {
    let whole = bytes(&sample());
    for length in 0..whole.len() {
        assert!(
            decode(&whole[..length]).is_err(),
            "prefix of {length} bytes was read"
        );
        assert!(
            decode(&resealed(&whole[..length])).is_err(),
            "resealed prefix of {length} bytes was read"
        );
    }
    assert!(decode(&[&whole[..], &[0]].concat()).is_err());
    let mut extra = whole.clone();
    extra.insert(whole.len() - CHECK_BYTES, 0);
    assert!(matches!(
        decode(&resealed(&extra)),
        Err(PolarCodecError::Extra { extra: 1 })
    ));
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
                // what is read is well formed: it can be written, and is the same bytes again
                assert_eq!(bytes(&map), resealed(&damaged), "bit {bit} of byte {at}");
            }
        }
    }
}

#[test]
fn counts_are_checked_before_memory_is_taken() {
    let mut many = bytes(&map(&[]));
    let at = many.len() - CHECK_BYTES - 1;
    many.splice(at..=at, [0xff, 0xff, 0xff, 0xff, 0x0f]);
    let error = decode(&resealed(&many)).unwrap_err();
    assert_eq!(
        error,
        PolarCodecError::Count {
            what: "spheres",
            count: u32::MAX as usize,
            left: 0
        }
    );
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
        let _ = decode(&resealed(&[header, &body].concat()));
    }
}
