use super::*;
use crate::frame::Intrinsics;
use glam::DVec3;

fn read(text: &str) -> Result<Rig, RigError> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("rig.toml");
    fs::write(&path, text).unwrap();
    fs::write(
        folder.path().join("color.toml"),
        "width = 640\nheight = 480\nintrinsics = [600.0, 600.0, 320.0, 240.0]\n",
    )
    .unwrap();
    Rig::read(&path)
}

#[test]
fn a_rig_says_who_the_cameras_are_and_where_they_stand() {
    let rig = read(
        r#"
        [[camera]]
        name = "left"
        device = "synthetic:room"
        translation = [1.0, 2.0, 3.0]
        intrinsics = "600,600,320,240"
        [[camera]]
        name = "right"
        device = "/dev/video4"
        matrix = [[0, 0, 1, 1.5], [0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 0, 1]]
        intrinsics = "right.yaml"
        depth_unit_mm = 0.1
        size = [848, 480]
        color_device = "6"
        color_camera = "color.toml"
        "#,
    )
    .unwrap();
    let [left, right] = rig.cameras.as_slice() else {
        panic!("two cameras: {rig:?}");
    };
    let at = |camera: &RigCamera| camera.pose.unwrap().to_common(DVec3::Z);
    assert_eq!(at(left), DVec3::new(1.0, 2.0, 4.0));
    assert_eq!(at(right), DVec3::new(2.5, 0.0, 0.0));
    assert_eq!(left.intrinsics.as_deref(), Some("600,600,320,240"));
    assert!(right.intrinsics.as_ref().unwrap().ends_with("/right.yaml"));
    assert!((right.depth_unit_m.unwrap() - 1e-4).abs() < 1e-15);
    assert_eq!(right.size, Some((848, 480)));
    assert_eq!(right.color_camera.unwrap().pose, Pose::default());
}

#[test]
fn what_is_wrong_in_a_rig_is_named() {
    let camera = |more: &str| format!("[[camera]]\nname = \"a\"\ndevice = \"0\"\n{more}\n");
    for (text, says) in [
        (String::new(), "missing field `camera`"),
        ("camera = []".into(), "no camera"),
        (camera("poes = 1"), "unknown field `poes`"),
        (camera("translation = [1, 2]"), "line 4"),
        (
            camera("rotation = [1, 1, 0, 0]"),
            "camera `a`: the quaternion",
        ),
        (
            camera("translation = [0, 0, 0]\nmatrix = [[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]"),
            "one of the two",
        ),
        (camera("depth_unit_mm = -1"), "depth_unit_mm is -1"),
        (camera("color_camera = \"none.toml\""), "none.toml"),
        (camera("") + &camera(""), "two cameras are called `a`"),
        (
            "[[camera]]\nname = \"a/b\"\ndevice = \"0\"".into(),
            "no camera name",
        ),
    ] {
        let error = read(&text).unwrap_err().to_string();
        assert!(error.contains(says), "{text}: {error}");
    }
    let missing = Rig::read(Path::new("/nonexistent/rig.toml")).unwrap_err();
    assert!(matches!(missing, RigError::Unreadable { .. }));
}

#[test]
fn devices_become_cameras_with_numbers() {
    let devices: Vec<String> = (0..20).map(|n| n.to_string()).collect();
    let rig = Rig::of_devices(&devices[..2]).unwrap();
    assert_eq!(rig.cameras[1].name, "cam1");
    assert_eq!(rig.cameras[1].device, "1");
    assert!(
        Rig::of_devices(&devices)
            .unwrap_err()
            .contains("at most 16")
    );
}

#[test]
fn a_point_falls_on_its_colour_pixel() {
    let camera = ColorCamera {
        width: 640,
        height: 480,
        intrinsics: Intrinsics {
            fx: 600.0,
            fy: 600.0,
            cx: 320.0,
            cy: 240.0,
        },
        // 10 cm to the right of the depth camera
        pose: Pose::from_quaternion([0.1, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]).unwrap(),
    };
    let pixel = |x, y, z| camera.pixel_of(DVec3::new(x, y, z), (640, 480));
    assert_eq!(pixel(0.1, 0.0, 2.0), Some((320, 240, 2.0)));
    assert_eq!(pixel(0.0, 0.0, 2.0), Some((290, 240, 2.0)));
    assert_eq!(pixel(0.1, 0.1, 1.0), Some((320, 300, 1.0)));
    assert_eq!(pixel(0.1, 0.0, -2.0), None, "behind");
    assert_eq!(pixel(2.0, 0.0, 2.0), None, "outside");
    // at half the size
    let half = camera.pixel_of(DVec3::new(0.0, 0.0, 2.0), (320, 240));
    assert_eq!(half, Some((145, 120, 2.0)));
}
