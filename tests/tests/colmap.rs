//! Cameras in other formats than `transforms.json`: a capture converted to COLMAP or a table is the same capture.

use heliosplat_objects::Capture;
use heliosplat_objects::capture::{Frame, IMAGE_BYTES};
use heliosplat_tests::program::{fault, heliosplat, json};
use std::fmt::Write;
use std::path::Path;
use tempfile::{TempDir, tempdir};

/// A small capture of an object, all of whose images are in one list.
fn capture() -> TempDir {
    let folder = tempdir().expect("a temporary folder");
    let out = folder.path().display().to_string();
    let arguments = [
        "synth", "object", "--out", &out, "--views", "9", "--size", "48", "--paths", "4", "--seed", "2",
    ];
    heliosplat(&arguments).assert().success();
    let at = |name: &str| folder.path().join(name);
    std::fs::rename(at("transforms_train.json"), at("transforms.json")).expect("a list");
    std::fs::remove_file(at("transforms_test.json")).expect("a list");
    folder
}

/// A folder whose `images/` are those of `capture`.
fn with_images(capture: &Path) -> TempDir {
    let folder = tempdir().expect("a temporary folder");
    std::fs::create_dir_all(folder.path().join("images/train")).expect("a folder");
    for file in std::fs::read_dir(capture.join("train")).expect("images") {
        let path = file.expect("a file").path();
        let name = path.file_name().expect("a name");
        std::fs::copy(&path, folder.path().join("images/train").join(name)).expect("copied");
    }
    folder
}

/// Rotation from world to camera as a quaternion with the scalar first, and the translation, in OpenCV's axes.
fn pose(frame: &Frame) -> ([f64; 4], [f64; 3]) {
    let camera = &frame.camera;
    let world_from_camera = glam::DMat3::from_cols(camera.right, camera.down, camera.forward);
    let rotation = world_from_camera.transpose();
    let q = glam::DQuat::from_mat3(&rotation);
    ([q.w, q.x, q.y, q.z], (-(rotation * camera.eye)).into())
}

/// Points on the object, as COLMAP finds them: the corners and the middle of a cube.
fn points() -> Vec<([f64; 3], [u8; 3])> {
    let cell = |n: usize, k: usize| 0.1 * ((n / 5usize.pow(k as u32)) % 5) as f64 - 0.2;
    (0..125)
        .map(|n| ([0, 1, 2].map(|k| cell(n, k)), [n as u8, 2, 3]))
        .collect()
}

fn write_text(folder: &Path, capture: &Capture) {
    let sparse = folder.join("sparse/0");
    std::fs::create_dir_all(&sparse).expect("a folder");
    let (mut cameras, mut images) = ("# cameras\n".to_owned(), "# images\n".to_owned());
    for (n, frame) in capture.frames.iter().enumerate() {
        let camera = &frame.camera;
        let ([fx, fy], [cx, cy]) = (camera.focal_px, camera.principal_px.map(|c| c + 0.5));
        let [width, height] = camera.size_px;
        let _ = match n {
            0 => writeln!(cameras, "0 SIMPLE_PINHOLE {width} {height} {fx} {cx} {cy}"),
            _ => writeln!(cameras, "{n} PINHOLE {width} {height} {fx} {fy} {cx} {cy}"),
        };
        let ([w, x, y, z], [t1, t2, t3]) = pose(frame);
        // The list of observations may be empty.
        let observations = if n % 2 == 0 { "" } else { "1.5 2.5 -1 3.0 4.0 7" };
        let name = &frame.name;
        let _ = writeln!(
            images,
            "{n} {w} {x} {y} {z} {t1} {t2} {t3} {n} {name}.png\n{observations}"
        );
    }
    std::fs::write(sparse.join("cameras.txt"), cameras).expect("written");
    std::fs::write(sparse.join("images.txt"), images).expect("written");
}

fn write_binary(folder: &Path, capture: &Capture) {
    let sparse = folder.join("sparse");
    std::fs::create_dir_all(&sparse).expect("a folder");
    let count = (capture.frames.len() as u64).to_le_bytes();
    let (mut cameras, mut images) = (count.to_vec(), count.to_vec());
    // In another order than that of the names.
    for (n, frame) in capture.frames.iter().enumerate().rev() {
        let camera = &frame.camera;
        cameras.extend((n as u32).to_le_bytes());
        cameras.extend(1u32.to_le_bytes());
        camera
            .size_px
            .iter()
            .for_each(|&n| cameras.extend((n as u64).to_le_bytes()));
        let principal = camera.principal_px.map(|c| c + 0.5);
        let numbers = camera.focal_px.into_iter().chain(principal);
        numbers.for_each(|value| cameras.extend(value.to_le_bytes()));
        let (q, t) = pose(frame);
        images.extend((n as u32).to_le_bytes());
        q.into_iter()
            .chain(t)
            .for_each(|value| images.extend(value.to_le_bytes()));
        images.extend((n as u32).to_le_bytes());
        images.extend(format!("{}.png\0", frame.name).bytes());
        images.extend(1u64.to_le_bytes());
        images.extend([0; 24]);
    }
    std::fs::write(sparse.join("cameras.bin"), cameras).expect("written");
    std::fs::write(sparse.join("images.bin"), images).expect("written");
}

fn write_table(folder: &Path, capture: &Capture) {
    let mut text = "name,fx,fy,cx,cy,width,height,r11,r12,r13,r21,r22,r23,r31,r32,r33,t1,t2,t3\n".to_owned();
    for frame in &capture.frames {
        let camera = &frame.camera;
        let ([fx, fy], [cx, cy]) = (camera.focal_px, camera.principal_px.map(|c| c + 0.5));
        let [width, height] = camera.size_px;
        let rows = [camera.right, camera.down, camera.forward];
        let translation = rows.map(|row| -row.dot(camera.eye));
        let numbers: Vec<String> = rows
            .iter()
            .flat_map(|row| row.to_array())
            .chain(translation)
            .map(|value| value.to_string())
            .collect();
        let name = &frame.name;
        let _ = writeln!(
            text,
            "{name}.png,{fx},{fy},{cx},{cy},{width},{height},{}",
            numbers.join(",")
        );
    }
    std::fs::write(folder.join("cameras.csv"), text).expect("written");
}

fn open(folder: &Path) -> Capture {
    Capture::open(folder, IMAGE_BYTES).expect("a sound capture")
}

fn trained(capture: &Path) -> Vec<u8> {
    let home = tempdir().expect("a temporary folder");
    let (capture, run) = (capture.display().to_string(), home.path().join("run"));
    let out = run.display().to_string();
    let arguments = [
        "train",
        &capture,
        "--out",
        &out,
        "--preset",
        "fast",
        "--set",
        "train.iterations=40",
        "--set",
        "start.gaussians=500",
    ];
    json(&arguments);
    std::fs::read(run.join("model.ply")).expect("a model")
}

#[test]
fn a_capture_has_the_same_cameras_in_every_format() {
    let source = capture();
    let expected = open(source.path());
    let [text, binary, table] = [write_text, write_binary, write_table].map(|write| {
        let folder = with_images(source.path());
        write(folder.path(), &expected);
        folder
    });
    for folder in [&text, &binary, &table] {
        let found = open(folder.path());
        assert_eq!((found.frames.len(), &found.warnings), (9, &Vec::new()));
        for (a, b) in found.frames.iter().zip(&expected.frames) {
            assert_eq!(
                (&a.name, a.split, a.camera.size_px),
                (&b.name, b.split, b.camera.size_px)
            );
            assert_eq!(a.picture, b.picture);
            let axes = |frame: &Frame| {
                [
                    frame.camera.eye,
                    frame.camera.right,
                    frame.camera.down,
                    frame.camera.forward,
                ]
            };
            for (a, b) in axes(a).into_iter().zip(axes(b)) {
                assert!((a - b).length() < 1e-6, "{a} {b}");
            }
            for k in 0..2 {
                assert!((a.camera.focal_px[k] - b.camera.focal_px[k]).abs() < 1e-6);
                assert!((a.camera.principal_px[k] - b.camera.principal_px[k]).abs() < 1e-6);
            }
        }
    }
    assert!(trained(text.path()) == trained(binary.path()), "the same training");
}

#[test]
fn training_starts_from_the_points_where_images_have_no_coverage() {
    let source = capture();
    let expected = open(source.path());
    let folder = with_images(source.path());
    write_text(folder.path(), &expected);
    for file in std::fs::read_dir(folder.path().join("images/train")).expect("images") {
        let path = file.expect("a file").path();
        let image = image::open(&path).expect("an image");
        image.to_rgb8().save(&path).expect("written");
    }
    let mut text = String::new();
    let mut cloud = "ply\nformat ascii 1.0\nelement vertex 125\nproperty float x\nproperty float y\n\
                     property float z\nproperty uint8 red\nproperty uint8 green\nproperty uint8 blue\nend_header\n"
        .to_owned();
    let mut bytes = (points().len() as u64).to_le_bytes().to_vec();
    for (n, ([x, y, z], [r, g, b])) in points().into_iter().enumerate() {
        let _ = writeln!(text, "{n} {x} {y} {z} {r} {g} {b} 0.5 1 2 3 4");
        let _ = writeln!(cloud, "{x} {y} {z} {r} {g} {b}");
        bytes.extend((n as u64).to_le_bytes());
        [x, y, z].iter().for_each(|value| bytes.extend(value.to_le_bytes()));
        bytes.extend([r, g, b]);
        bytes.extend(0.5f64.to_le_bytes());
        bytes.extend(1u64.to_le_bytes());
        bytes.extend([0; 8]);
    }
    let sparse = folder.path().join("sparse/0");
    std::fs::write(sparse.join("points3D.txt"), text).expect("written");
    let from_text = open(folder.path()).points;
    assert_eq!(from_text.len(), 125);
    let of_text = trained(folder.path());
    std::fs::write(sparse.join("points3D.bin"), bytes).expect("written");
    assert_eq!(open(folder.path()).points, from_text);
    assert!(trained(folder.path()) == of_text, "the same training");
    std::fs::write(sparse.join("points3D.bin"), [1, 0, 0, 0, 0, 0, 0, 0]).expect("written");
    let error = fault(&["inspect".as_ref(), folder.path().as_os_str()], 2);
    assert!(
        error.contains("points3D.bin") && error.contains("ends early"),
        "{error}"
    );

    // The same points in the PLY file of nerfstudio.
    let studio = tempdir().expect("a temporary folder");
    std::fs::rename(folder.path().join("images/train"), studio.path().join("train")).expect("moved");
    std::fs::write(studio.path().join("sparse_pc.ply"), cloud).expect("written");
    let list = std::fs::read_to_string(source.path().join("transforms.json")).expect("a list");
    let mut list: serde_json::Value = serde_json::from_str(&list).expect("JSON");
    list["ply_file_path"] = "sparse_pc.ply".into();
    list["applied_transform"] = serde_json::json!([[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0]]);
    list["camera_model"] = "OPENCV".into();
    for key in ["k1", "k2", "p1", "p2"] {
        list[key] = serde_json::json!(0.0);
    }
    let file = studio.path().join("transforms.json");
    std::fs::write(&file, list.to_string()).expect("written");
    let of_cloud = open(studio.path()).points;
    for (a, b) in of_cloud.iter().zip(&from_text) {
        assert!((a.position - b.position).length() < 1e-6 && a.colour == b.colour);
    }
    assert_eq!(of_cloud.len(), 125);
    for (key, value) in [
        ("k1", serde_json::json!(0.1)),
        ("camera_model", "OPENCV_FISHEYE".into()),
    ] {
        list[key] = value;
        std::fs::write(&file, list.to_string()).expect("written");
        let error = fault(&["inspect".as_ref(), studio.path().as_os_str()], 2);
        assert!(error.contains("image_undistorter"), "{error}");
    }
}

#[test]
fn models_of_lenses_with_distortion_are_refused_with_a_remedy() {
    let source = capture();
    let expected = open(source.path());
    let folder = with_images(source.path());
    write_text(folder.path(), &expected);
    let path = folder.path().join("sparse/0/cameras.txt");
    let inspected = |text: &str| {
        std::fs::write(&path, text).expect("written");
        fault(&["inspect".as_ref(), folder.path().as_os_str()], 2)
    };
    let error = inspected("0 SIMPLE_RADIAL 48 48 60 24 24 0.01\n");
    assert!(
        error.contains("SIMPLE_RADIAL") && error.contains("image_undistorter"),
        "{error}"
    );
    let error = inspected("0 PINHOLE 48 48 60 60 24\n");
    assert!(error.contains("3 parameters"), "{error}");
    let error = inspected("7 PINHOLE 48 48 60 60 24 24\n");
    assert!(error.contains("which is not there"), "{error}");
}
