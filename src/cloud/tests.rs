use super::*;
use proptest::prelude::*;

fn positions() -> Vec<DVec3> {
    vec![
        DVec3::new(448_262.125, 5_411_932.5, -3.25),
        DVec3::new(1.0, -2.5, 1e-3),
        DVec3::new(0.0, 7.0, 1024.0),
    ]
}

/// The positions as a file of each kind; `binary` is the kind's own form.
fn ply(form: &str, real: &str) -> Vec<u8> {
    // an element before the vertices, and properties around the coordinates
    let mut bytes = format!(
        "ply\nformat {form} 1.0\ncomment unit mm\nelement camera 1\nproperty list uchar int view\n\
         element vertex 3\nproperty uchar red\nproperty {real} x\nproperty {real} y\n\
         property {real} z\nproperty short n\nelement face 1\n\
         property list uchar int vertex_indices\nend_header\n"
    )
    .into_bytes();
    let big = form.contains("big");
    let put = |bytes: &mut Vec<u8>, value: f64| match (real, big) {
        ("double", true) => bytes.extend(value.to_be_bytes()),
        ("double", false) => bytes.extend(value.to_le_bytes()),
        (_, true) => bytes.extend((value as f32).to_be_bytes()),
        (_, false) => bytes.extend((value as f32).to_le_bytes()),
    };
    if form == "ascii" {
        bytes.extend(b"2 5 6\n");
        for p in positions() {
            bytes.extend(format!("9 {} {} {} -1\n", p.x, p.y, p.z).bytes());
        }
        bytes.extend(b"3 0 1 2\n");
        return bytes;
    }
    bytes.push(2);
    bytes.extend([0; 8]);
    for p in positions() {
        bytes.push(9);
        for v in p.to_array() {
            put(&mut bytes, v);
        }
        bytes.extend([0, 0]);
    }
    bytes.push(3);
    bytes.extend([0; 12]);
    bytes
}

fn pcd(form: &str) -> Vec<u8> {
    use pcd_rs::{DataKind, ValueKind, WriterInit};
    let kind = match form {
        "ascii" => DataKind::Ascii,
        "binary" => DataKind::Binary,
        _ => DataKind::BinaryCompressed,
    };
    let mut bytes = Vec::new();
    let mut writer = WriterInit {
        width: 3,
        height: 1,
        viewpoint: pcd_rs::ViewPoint::default(),
        data_kind: kind,
        schema: Some(pcd_rs::Schema::from_iter([
            ("rgb", ValueKind::U32, 1),
            ("x", ValueKind::F64, 1),
            ("normal", ValueKind::F32, 3),
            ("y", ValueKind::F64, 1),
            ("z", ValueKind::F64, 1),
        ])),
        version: None,
    }
    .build_from_writer::<pcd_rs::DynRecord, _>(io::Cursor::new(&mut bytes))
    .unwrap();
    for p in positions() {
        writer
            .push(&pcd_rs::DynRecord(vec![
                pcd_rs::Field::U32(vec![7]),
                pcd_rs::Field::F64(vec![p.x]),
                pcd_rs::Field::F32(vec![0.0, 0.5, 1.0]),
                pcd_rs::Field::F64(vec![p.y]),
                pcd_rs::Field::F64(vec![p.z]),
            ]))
            .unwrap();
    }
    writer.finish().unwrap();
    bytes
}

fn npy(descr: &str, fortran: bool, shape: &str, values: &[f64]) -> Vec<u8> {
    let order = if fortran { "True" } else { "False" };
    let header = format!("{{'descr': '{descr}', 'fortran_order': {order}, 'shape': {shape}, }}\n");
    let mut bytes = [npy::MAGIC, &[1, 0]].concat();
    bytes.extend((header.len() as u16).to_le_bytes());
    bytes.extend(header.bytes());
    for &v in values {
        match descr {
            "<f8" => bytes.extend(v.to_le_bytes()),
            ">f8" => bytes.extend(v.to_be_bytes()),
            "<f4" => bytes.extend((v as f32).to_le_bytes()),
            other => panic!("{other}"),
        }
    }
    bytes
}

#[track_caller]
fn assert_reads(bytes: &[u8], format: CloudFormat, exact: bool) {
    let cloud = Cloud::parse(bytes, format).unwrap();
    assert_eq!(cloud.positions.len(), 3);
    for (read, wanted) in cloud.positions.iter().zip(positions()) {
        let rounded = wanted.as_vec3().as_dvec3();
        assert_eq!(*read, if exact { wanted } else { rounded });
    }
}

#[test]
fn all_forms_of_ply_hold_the_same_points() {
    for form in ["ascii", "binary_little_endian", "binary_big_endian"] {
        assert_reads(&ply(form, "double"), CloudFormat::Ply, true);
        assert_reads(&ply(form, "float"), CloudFormat::Ply, form == "ascii");
        let read = Cloud::parse(&ply(form, "double"), CloudFormat::Ply).unwrap();
        assert_eq!(read.stated_unit, Some(LengthUnit::Millimetre));
        let metres = read.into_metres(LengthUnit::Millimetre);
        assert_eq!(metres[1], DVec3::new(1.0, -2.5, 1e-3) * 1e-3);
    }
}

#[test]
fn all_forms_of_pcd_hold_the_same_points() {
    for form in ["ascii", "binary", "compressed"] {
        assert_reads(&pcd(form), CloudFormat::Pcd, true);
    }
}

#[test]
fn text_and_objects_hold_the_same_points() {
    let mut xyz = String::from("# made by hand\n3\nX Y Z intensity\n\n");
    let mut csv = String::from("x,y,z\n");
    let mut obj = String::from("o thing\r\n");
    for p in positions() {
        xyz.push_str(&format!("{} {}\t{} 0.5\n", p.x, p.y, p.z));
        csv.push_str(&format!("{}, {};{}\n", p.x, p.y, p.z));
        obj.push_str(&format!("v {} {} {}\r\nvn 0 0 1\r\n", p.x, p.y, p.z));
    }
    obj.push_str("f 1 2 3\r\n");
    assert_reads(xyz.as_bytes(), CloudFormat::Xyz, true);
    assert_reads(csv.as_bytes(), CloudFormat::Xyz, true);
    assert_reads(obj.as_bytes(), CloudFormat::Obj, true);
}

#[test]
fn arrays_hold_the_same_points() {
    let rows: Vec<f64> = positions().iter().flat_map(|p| p.to_array()).collect();
    let with_more: Vec<f64> = positions()
        .iter()
        .flat_map(|p| [p.x, p.y, p.z, 9.0])
        .collect();
    let columns: Vec<f64> = (0..3)
        .flat_map(|axis| positions().into_iter().map(move |p| p.to_array()[axis]))
        .collect();
    assert_reads(&npy("<f8", false, "(3, 3)", &rows), CloudFormat::Npy, true);
    assert_reads(&npy(">f8", false, "(3, 3)", &rows), CloudFormat::Npy, true);
    assert_reads(&npy("<f4", false, "(3, 3)", &rows), CloudFormat::Npy, false);
    assert_reads(
        &npy("<f8", false, "(1, 3, 4)", &with_more),
        CloudFormat::Npy,
        true,
    );
    assert_reads(
        &npy("<f8", true, "(3, 3)", &columns),
        CloudFormat::Npy,
        true,
    );
}

#[test]
fn announced_points_that_are_not_there_are_told() {
    for bytes in [
        ply("binary_little_endian", "float"),
        ply("ascii", "float"),
        pcd("binary"),
        pcd("compressed"),
        npy("<f8", false, "(3, 3)", &[0.0; 9]),
    ] {
        let format = CloudFormat::of(Path::new("x"), &bytes).unwrap_or(CloudFormat::Pcd);
        // the face element of the PLY is not needed
        let cut = bytes.len() - 40;
        let told = Cloud::parse(&bytes[..cut], format).unwrap_err();
        assert!(!told.is_empty());
    }
    // counts far beyond the file: refused before memory is taken
    let far = "ply\nformat binary_little_endian 1.0\nelement vertex 99999999999\n\
               property double x\nproperty double y\nproperty double z\nend_header\n";
    assert!(
        Cloud::parse(far.as_bytes(), CloudFormat::Ply)
            .unwrap_err()
            .contains("99999999999")
    );
    let far = npy("<f8", false, "(99999999999, 99999999999, 3)", &[]);
    assert!(Cloud::parse(&far, CloudFormat::Npy).is_err());
    let far = npy("<f8", true, "(9999999999999, 3)", &[]);
    assert!(Cloud::parse(&far, CloudFormat::Npy).is_err());
}

#[test]
fn lines_without_numbers_are_told_by_their_number() {
    let told = |text: &str, format| Cloud::parse(text.as_bytes(), format).unwrap_err();
    assert!(told("1 2 3\n4 5\n", CloudFormat::Xyz).contains("line 2"));
    assert!(told("v 1 2 3\nv 1 two 3\n", CloudFormat::Obj).contains("line 2"));
    assert!(told("a\nb\nc\n", CloudFormat::Xyz).contains("line 3"));
    let none = Cloud::parse(b"\n# nothing\n", CloudFormat::Xyz).unwrap();
    assert!(none.positions.is_empty());
}

#[test]
fn kinds_are_known_by_bytes_first() {
    let of = |name: &str, bytes: &[u8]| CloudFormat::of(Path::new(name), bytes);
    assert_eq!(of("a.xyz", b"ply\nformat"), Some(CloudFormat::Ply));
    assert_eq!(of("a.OBJ", b"v 1 2 3"), Some(CloudFormat::Obj));
    assert_eq!(of("a.pcd", b"VERSION .7\n"), Some(CloudFormat::Pcd));
    assert_eq!(of("a.las", b"LASF"), None);
}

const FORMATS: [CloudFormat; 5] = [
    CloudFormat::Ply,
    CloudFormat::Pcd,
    CloudFormat::Obj,
    CloudFormat::Xyz,
    CloudFormat::Npy,
];

proptest! {
    #![proptest_config(ProptestConfig::with_cases(96))]
    #[test]
    fn any_bytes_are_safe(bytes in proptest::collection::vec(any::<u8>(), 0..300), kind in 0usize..5) {
        let _ = Cloud::parse(&bytes, FORMATS[kind]);
    }

    #[test]
    fn damaged_files_are_safe(
        kind in 0usize..9,
        hits in proptest::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6),
        end in any::<prop::sample::Index>(),
        cut in any::<bool>(),
    ) {
        let (mut bytes, format) = match kind {
            0 => (ply("ascii", "double"), CloudFormat::Ply),
            1 => (ply("binary_little_endian", "float"), CloudFormat::Ply),
            2 => (ply("binary_big_endian", "double"), CloudFormat::Ply),
            3 => (pcd("ascii"), CloudFormat::Pcd),
            4 => (pcd("binary"), CloudFormat::Pcd),
            5 | 6 => (pcd("compressed"), CloudFormat::Pcd),
            7 => (npy("<f8", false, "(3, 3)", &[1.0; 9]), CloudFormat::Npy),
            _ => (npy("<f8", true, "(3, 3)", &[1.0; 9]), CloudFormat::Npy),
        };
        for (at, value) in hits {
            let at = at.index(bytes.len());
            bytes[at] = value;
        }
        if cut {
            bytes.truncate(end.index(bytes.len()));
        }
        // no more points than bytes could hold
        if let Ok(cloud) = Cloud::parse(&bytes, format) {
            prop_assert!(cloud.positions.len() <= bytes.len());
        }
    }
}
