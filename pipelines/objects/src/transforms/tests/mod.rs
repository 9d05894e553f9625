use super::*;
use serde_json::json;

const SIZE: [usize; 2] = [40, 30];

fn matrix_json() -> Value {
    json!([
        [0.0, -0.6, 0.8, 3.2],
        [1.0, 0.0, 0.0, 0.0],
        [0.0, 0.8, 0.6, 2.4],
        [0.0, 0.0, 0.0, 1.0]
    ])
}

/// The frames of a file with this content, next to an empty file `a.png` (this reader opens no images).
fn frames(value: &Value) -> Result<Vec<FrameSpec>, CaptureError> {
    let folder = tempfile::tempdir().expect("a temporary folder");
    std::fs::create_dir(folder.path().join("train")).expect("a folder");
    for name in ["a.png", "a_normal.png", "b.exr"] {
        std::fs::write(folder.path().join("train").join(name), "").expect("a file");
    }
    let path = folder.path().join("transforms_train.json");
    std::fs::write(&path, value.to_string()).expect("a file");
    read(&path).map(|listed| listed.frames)
}

fn only(value: Value) -> (Pinhole, Option<PointLight>, String) {
    let frames = frames(&value).expect("a sound file");
    assert_eq!(frames.len(), 1);
    let camera = frames[0].camera(SIZE).expect("a camera");
    (camera, frames[0].light, frames[0].name.clone())
}

#[test]
fn every_dialect_says_the_same_camera_and_light() {
    let angle = 2.0 * (20.0f64 / 50.0).atan();
    let m = matrix_json();
    let nerf = only(json!({"camera_angle_x": angle,
        "frames": [{"file_path": "./train/a", "rotation": 0.01, "transform_matrix": m}]}));
    assert!((nerf.0.focal_px[0] - 50.0).abs() < 1e-9 && nerf.0.principal_px == [19.5, 14.5]);
    assert_eq!((nerf.1, nerf.2.as_str()), (None, "train/a"));
    let same = |other: &Pinhole| {
        let apart = |a: [f64; 2], b: [f64; 2]| (a[0] - b[0]).abs().max((a[1] - b[1]).abs());
        assert!((other.eye - nerf.0.eye).length() < 1e-9 && (other.forward - nerf.0.forward).length() < 1e-9);
        assert!((other.right - nerf.0.right).length() < 1e-9 && (other.down - nerf.0.down).length() < 1e-9);
        assert!(apart(other.focal_px, nerf.0.focal_px) < 1e-9 && apart(other.principal_px, nerf.0.principal_px) < 1e-9);
    };
    let lit = |one: (Pinhole, Option<PointLight>, String), intensity: Option<[f64; 3]>| {
        same(&one.0);
        let position = DVec3::new(1.0, 2.0, 3.0);
        assert_eq!(
            (one.1, one.2.as_str()),
            (Some(PointLight { position, intensity }), "train/a")
        );
    };
    // NRHints and RNG: intrinsics of the file, extension apart, intensity.
    lit(
        only(
            json!({"camera_intrinsics": [20.0, 15.0, 50.0, 50.0], "frames": [{"file_path": "train/a",
            "file_ext": ".png", "transform_matrix": m, "pl_pos": [1, 2, 3], "pl_intensity": [4, 5, 6]}]}),
        ),
        Some([4.0, 5.0, 6.0]),
    );
    // GS³: intrinsics of the frame over those of the file, an absolute path of another machine, one intensity.
    lit(
        only(
            json!({"camera_angle_x": 0.1, "frames": [{"file_path": "train/a", "img_path": "/elsewhere/a.png",
            "camera_intrinsics": [20.0, 15.0, 50.0, 50.0], "transform_matrix": m,
            "pl_pos": [1, 2, 3], "pl_intensity": 7}]}),
        ),
        Some([7.0; 3]),
    );
    // GS³ after refinement: the pose in OpenCV's axes, the matrix out of date.
    let r = json!([[0.0, 0.6, -0.8], [1.0, 0.0, 0.0], [0.0, -0.8, -0.6]]);
    lit(
        only(
            json!({"frames": [{"file_path": "train/a.png", "camera_intrinsics": [20.0, 15.0, 50.0, 50.0],
            "R_opt": r, "T_opt": [0.0, 0.0, 4.0], "transform_matrix": [[9]], "pl_pos": [1, 2, 3]}]}),
        ),
        None,
    );
    // nerfstudio and OpenIllumination, declared at twice the size.
    lit(
        only(
            json!({"fl_x": 100.0, "fl_y": 100.0, "cx": 40.0, "cy": 30.0, "w": 80, "h": 60, "frames": [{
            "file_path": "train/a.png", "transform_matrix": m,
            "light": {"position": [1, 2, 3], "intensity": [1, 1, 1]}}]}),
        ),
        Some([1.0; 3]),
    );
}

#[test]
fn lists_of_lights_are_an_image_each() {
    let value = json!({"camera_angle_x": 0.7, "frames": [{"transform_matrix": matrix_json(), "width": 40, "height": 30,
        "file_paths": ["train/a", "train/b"], "light_positions": [[1, 2, 3], [4, 5, 6]],
        "light_intensities": [2, [1, 2, 3]]}]});
    let frames = frames(&value).expect("a sound file");
    assert_eq!(frames.len(), 2);
    assert_eq!(frames[1].light.expect("a light").position, DVec3::new(4.0, 5.0, 6.0));
    assert_eq!(frames[1].light.expect("a light").intensity, Some([1.0, 2.0, 3.0]));
    assert!(frames[1].path.ends_with("train/b.exr"));
    assert_eq!(frames[0].pose, frames[1].pose);
}

#[test]
fn nothing_is_carried_over_from_the_frame_before() {
    let m = matrix_json();
    let value = json!({"camera_angle_x": 0.7, "frames": [
        {"file_path": "train/a", "transform_matrix": m, "camera_intrinsics": [1, 2, 30, 30], "pl_pos": [1, 2, 3]},
        {"file_path": "train/b", "transform_matrix": m, "pl_pos": null}]});
    let frames = frames(&value).expect("a sound file");
    let camera = frames[1].camera(SIZE).expect("a camera");
    assert!(camera.principal_px == [19.5, 14.5] && (camera.focal_px[0] - 20.0 / 0.35f64.tan()).abs() < 1e-9);
    assert!(frames[0].light.is_some() && frames[1].light.is_none());
}

#[test]
fn frames_that_are_wrong_are_named_with_what_is_wrong() {
    let good = json!({"file_path": "train/a", "transform_matrix": matrix_json()});
    let with = |key: &str, value: Value| {
        let mut frame = good.clone();
        frame[key] = value;
        json!({"camera_angle_x": 0.7, "frames": [good.clone(), frame]})
    };
    for (value, fault) in [
        (with("file_path", json!("../../etc/passwd")), "points out of the folder"),
        (with("file_path", json!("/etc/passwd")), "points out of the folder"),
        (with("file_path", json!("train/c")), "no image train/c"),
        (with("file_path", json!(7)), "no `file_path`"),
        (
            with("transform_matrix", json!([[0, 0, 0, 0], [0, 0, 0, 0], [0, 0, 0, 0]])),
            "spans no space",
        ),
        (with("transform_matrix", json!([[1, 0, 0, null]])), "fewer than 3 rows"),
        (with("camera_intrinsics", json!([1, 2, 0, 1])), "of no camera"),
        (with("camera_angle_x", json!(4.0)), "field of view"),
        (with("pl_pos", json!([1, 2])), "3 finite numbers"),
        (with("pl_pos", json!({"x": 1})), "3 finite numbers"),
        (with("w", json!("wide")), "not a number"),
    ] {
        let error = frames(&value).expect_err(fault).to_string();
        assert!(error.contains("transforms_train.json: frame 1: "), "{error}");
        assert!(error.contains(fault) && error.contains("correct or remove"), "{error}");
    }
    let error = frames(&json!({"frames": []})).expect_err("nothing").to_string();
    assert!(error.contains("no image"), "{error}");
    let error = frames(&json!([1])).expect_err("a list").to_string();
    assert!(error.contains("not a JSON object"), "{error}");
}

#[test]
fn numbers_that_are_none_are_no_json() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("transforms.json");
    for text in ["{\"frames\": [NaN]}", "{\"frames\": [1e999]}", "{\"frames\": ["] {
        std::fs::write(&path, text).expect("a file");
        let error = read(&path).expect_err("no JSON").to_string();
        assert!(error.contains("transforms.json: it is not JSON"), "{error}");
    }
}

#[test]
fn an_image_of_another_shape_than_declared_is_refused() {
    let value = json!({"fl_x": 100.0, "w": 80, "h": 80, "frames": [{"file_path": "train/a", "transform_matrix": matrix_json()}]});
    let error = frames(&value).expect("a sound file")[0]
        .camera(SIZE)
        .expect_err("another shape");
    assert!(error.0.contains("40 x 30"), "{error:?}");
}

#[test]
fn listed_images_are_left_out() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    for name in ["a.png", "b.png", "exclude_list.txt"] {
        std::fs::write(folder.path().join(name), "a.png\n").expect("a file");
    }
    let m = matrix_json();
    let value = json!({"camera_angle_x": 0.7, "frames": [{"file_path": "a", "transform_matrix": m},
        {"file_path": "b", "transform_matrix": m}]});
    let path = folder.path().join("transforms.json");
    std::fs::write(&path, value.to_string()).expect("a file");
    let names: Vec<String> = read(&path)
        .expect("a sound file")
        .frames
        .into_iter()
        .map(|f| f.name)
        .collect();
    assert_eq!(names, ["b"]);
}
