//! Every layout gives the same camera; every kind of damage its own message.

use super::*;

const FX: f64 = 517.3;
const FY: f64 = 516.5;
const CX: f64 = 318.6;
const CY: f64 = 255.3;

fn read(text: &str) -> Calibration {
    let (calibration, _) = parse(text).unwrap_or_else(|what| panic!("{what}\n{text}"));
    calibration
}

fn assert_camera(calibration: &Calibration, size: Option<(u32, u32)>) {
    let expected = Intrinsics {
        fx: FX,
        fy: FY,
        cx: CX,
        cy: CY,
    };
    assert_eq!(calibration.intrinsics, expected);
    assert_eq!(calibration.size, size);
}

#[test]
fn our_camera_json() {
    let calibration = read(
        r#"{"width":640,"height":480,"fx":517.3,"fy":516.5,"cx":318.6,"cy":255.3,
            "depth_scale_m_per_unit":0.0002,"fps":30,"invalid_values":[65535,0,0],
            "depth_min_m":0.3,"depth_max_m":8}"#,
    );
    assert_camera(&calibration, Some((640, 480)));
    assert_eq!(calibration.depth_unit_m, Some(0.0002));
    assert_eq!(calibration.fps, Some(30.0));
    assert_eq!(calibration.invalid, Some(vec![0, 65535]));
    assert_eq!(calibration.depth_min_m, Some(0.3));
    assert_eq!(calibration.depth_max_m, Some(8.0));
}

#[test]
fn null_fields_are_absent() {
    let calibration = read(r#"{"fx":517.3,"fy":516.5,"cx":318.6,"cy":255.3,"fps":null}"#);
    assert_camera(&calibration, None);
    assert_eq!(calibration.fps, None);
}

#[test]
fn a_camera_of_ours_as_json() {
    let camera = crate::frame::Camera {
        width: 640,
        height: 480,
        intrinsics: Intrinsics {
            fx: FX,
            fy: FY,
            cx: CX,
            cy: CY,
        },
        depth_unit_m: 0.00025,
        invalid: vec![0, 2047],
        depth_min_m: 0.1,
        depth_max_m: 9.0,
        fps: Some(15.0),
        name: "a".to_owned(),
    };
    let calibration = read(&serde_json::to_string(&camera).unwrap());
    assert_camera(&calibration, Some((640, 480)));
    assert_eq!(calibration.depth_unit_m, Some(0.00025));
    assert_eq!(calibration.depth_min_m, Some(0.1));
    assert_eq!(calibration.invalid, Some(vec![0, 2047]));
}

#[test]
fn ros_camera_info() {
    let calibration = read(
        "image_width: 640\nimage_height: 480\ncamera_name: depth\ncamera_matrix:\n  rows: 3\n  \
         cols: 3\n  data: [517.3, 0., 318.6, 0., 516.5, 255.3, 0., 0., 1.]\n\
         distortion_model: plumb_bob\ndistortion_coefficients:\n  rows: 1\n  cols: 5\n  \
         data: [0, 0, 0, 0, 0]\nprojection_matrix:\n  rows: 3\n  cols: 4\n  \
         data: [517.3, 0, 318.6, 0, 0, 516.5, 255.3, 0, 0, 0, 1, 0]\n",
    );
    assert_camera(&calibration, Some((640, 480)));
}

#[test]
fn ros_message_dump() {
    let text = "header:\n  frame_id: optical\nheight: 480\nwidth: 640\nd:\n- 0.1\n- 0.0\nk:\n- 517.3\n\
                - 0.0\n- 318.6\n- 0.0\n- 516.5\n- 255.3\n- 0.0\n- 0.0\n- 1.0\n---\n";
    let (calibration, distorted) = parse(text).unwrap();
    assert_camera(&calibration, Some((640, 480)));
    assert!(distorted);
}

#[test]
fn opencv_file_storage_yaml() {
    let calibration = read(
        "%YAML:1.0\n---\nimage_width: 640\nimage_height: 480\n\
         camera_matrix: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n   \
         data: [ 5.1730000000000000e+02, 0., 3.186e+02, 0.,\n       516.5, 255.3, 0., 0., 1. ]\n\
         distortion_coefficients: !!opencv-matrix\n   rows: 5\n   cols: 1\n   dt: d\n   \
         data: [ 0., 0., 0., 0., 0. ]\n",
    );
    assert_camera(&calibration, Some((640, 480)));
}

#[test]
fn orb_slam_settings() {
    let calibration = read(
        "%YAML:1.0\n\n# Camera\nCamera.fx: 517.3\nCamera.fy: 516.5\nCamera.cx: 318.6\n\
         Camera.cy: 255.3\nCamera.width: 640\nCamera.height: 480\nCamera.fps: 30.0\n\
         DepthMapFactor: 5000.0\n",
    );
    assert_camera(&calibration, Some((640, 480)));
    assert_eq!(calibration.depth_unit_m, Some(1.0 / 5000.0));
    assert_eq!(calibration.fps, Some(30.0));
}

#[test]
fn open3d_columns() {
    let inner = r#"{"width":640,"height":480,
        "intrinsic_matrix":[517.3,0,0,0,516.5,0,318.6,255.3,1]}"#;
    assert_camera(&read(inner), Some((640, 480)));
    let trajectory = format!(r#"{{"class_name":"PinholeCameraParameters","intrinsic":{inner}}}"#);
    assert_camera(&read(&trajectory), Some((640, 480)));
    let recording = r#"{"depth_scale":1000.0,"fps":30.0,"height":480,"width":640,
        "intrinsic_matrix":[517.3,0,0,0,516.5,0,318.6,255.3,1]}"#;
    assert_eq!(read(recording).depth_unit_m, Some(0.001));
}

#[test]
fn realsense_spellings() {
    for text in [
        r#"{"fx":517.3,"fy":516.5,"ppx":318.6,"ppy":255.3,"width":640,"height":480,
            "model":"distortion.brown_conrady","coeffs":[0,0,0,0,0]}"#,
        r#"{"Width":"640","Height":"480","PPX":"318.6","PPY":"255.3","Fx":"517.3","Fy":"516.5"}"#,
        r#"{"color":{"fx":1,"fy":1,"ppx":1,"ppy":1},"depth":{"intrinsics":{"fx":517.3,"fy":516.5,
            "ppx":318.6,"ppy":255.3,"width":640,"height":480}},"depth_scale":0.001}"#,
        r#"{"depth_intrinsics":{"focal_length":[517.3,516.5],"principal_point":[318.6,255.3],
            "resolution":[640,480]}}"#,
    ] {
        assert_camera(&read(text), Some((640, 480)));
    }
    let scaled = read(
        r#"{"intrinsics":{"fx":517.3,"fy":516.5,"ppx":318.6,"ppy":255.3},"depth_scale":0.001}"#,
    );
    assert_eq!(scaled.depth_unit_m, Some(0.001));
}

#[test]
fn bare_numbers() {
    assert_camera(&read("517.3 516.5 318.6 255.3\n"), None);
    assert_camera(&read("517.3 0 318.6\n0 516.5 255.3\n0 0 1\n"), None);
    assert_camera(
        &Calibration::parse_flag("517.3, 516.5,318.6,255.3").unwrap(),
        None,
    );
}

#[test]
fn every_damage_has_its_message() {
    for (text, says) in [
        ("", "empty"),
        ("{\"fx\":", "not valid JSON"),
        ("a: [1, 2", "not valid YAML"),
        ("{\"fx\":1,\"fy\":1}", "no fx, fy, cx, cy"),
        ("just words", "no fx, fy, cx, cy"),
        ("1 2 3", "4 or 9 numbers"),
        ("{\"fx\":-5,\"fy\":5,\"cx\":1,\"cy\":1}", "above 0"),
        ("{\"k\":[5,0,1,0,5,1,0,0,7]}", "must be 1"),
        (
            "{\"fx\":5,\"fy\":5,\"cx\":1,\"cy\":1,\"width\":0,\"height\":4}",
            "image size is 0x4",
        ),
        (
            "{\"fx\":5,\"fy\":5,\"cx\":1,\"cy\":1,\"depth_unit_m\":0}",
            "depth unit is 0",
        ),
        (
            "{\"fx\":5,\"fy\":5,\"cx\":1,\"cy\":1,\"invalid_values\":[70000]}",
            "70000",
        ),
        ("a: &x 1\nb: *x\n", "aliases"),
    ] {
        let what = parse(text).expect_err(text);
        assert!(what.contains(says), "{text:?} said {what:?}, not {says:?}");
    }
    let deep = format!("a: {}1{}", "[".repeat(200), "]".repeat(200));
    assert!(parse(&deep).unwrap_err().contains("deeper"));
    let dashes = format!("a:\n  {}1\n", "- ".repeat(100_000));
    assert!(parse(&dashes).unwrap_err().contains("deeper"));
}

#[test]
fn flag_errors_name_the_text_and_the_remedy() {
    for (text, says) in [
        ("1,2,3", "got 3"),
        ("1,x,3,4", "\"x\" is not a number"),
        ("nan,1,1,1", "finite"),
        ("/nowhere/camera.json", "/nowhere/camera.json"),
    ] {
        let message = Calibration::parse_flag(text).unwrap_err().to_string();
        assert!(message.contains(says), "{message}");
    }
    let message = Calibration::parse_flag("1,2,3").unwrap_err().to_string();
    assert!(message.contains("--intrinsics"), "{message}");
}

#[test]
fn a_file_is_read_and_a_huge_or_binary_one_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("camera,1.json");
    std::fs::write(&path, "517.3 516.5 318.6 255.3").unwrap();
    assert_camera(
        &Calibration::parse_flag(path.to_str().unwrap()).unwrap(),
        None,
    );
    std::fs::write(&path, [0xff, 0xfe, 0x00]).unwrap();
    assert!(
        Calibration::read(&path)
            .unwrap_err()
            .to_string()
            .contains("not a text")
    );
    let file = std::fs::File::create(&path).unwrap();
    file.set_len(MAX_FILE_BYTES + 1).unwrap();
    assert!(
        Calibration::read(&path)
            .unwrap_err()
            .to_string()
            .contains("at most")
    );
    assert!(matches!(
        Calibration::read(folder.path()),
        Err(IntrinsicsError::Io { .. })
    ));
}

#[test]
fn rescales_the_same_aspect_and_refuses_another() {
    let calibration = read(r#"{"width":640,"height":480,"fx":500,"fy":500,"cx":319.5,"cy":239.5}"#);
    assert_eq!(
        calibration.for_size(640, 480).unwrap(),
        calibration.intrinsics
    );
    let half = calibration.for_size(320, 240).unwrap();
    let expected = Intrinsics {
        fx: 250.0,
        fy: 250.0,
        cx: 159.5,
        cy: 119.5,
    };
    assert_eq!(half, expected);
    let message = calibration.for_size(640, 360).unwrap_err().to_string();
    assert!(
        message.contains("640x480") && message.contains("640x360"),
        "{message}"
    );
    // 848x480 is not exactly 16:9, yet it is a mode of 16:9 sensors.
    let wide = Calibration {
        size: Some((1280, 720)),
        ..calibration.clone()
    };
    assert!(wide.for_size(848, 480).is_ok());
    let any = Calibration {
        size: None,
        ..calibration
    };
    assert_eq!(any.for_size(7, 5).unwrap(), any.intrinsics);
}

proptest::proptest! {
    #![proptest_config(proptest::prelude::ProptestConfig::with_cases(128))]

    #[test]
    fn no_text_panics(text in "[\\[\\]{}:,\"\\-&*!%#a-dfkxy0-9. \n]{0,80}") {
        let _ = parse(&text);
    }
}
