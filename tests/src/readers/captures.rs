//! Sound files of captures of objects and of their models.

use glam::DVec3;
use heliosplat::gaussians::{Table, core_groups};
use heliosplat::model::SceneModel;
use heliosplat::model::olat::{Olat, OlatOptions};
use heliosplat::model::radiance::RadianceOptions;
use heliosplat::model::reflective::{Reflective, ReflectiveOptions};
use heliosplat_exchange::splat_ply;
use heliosplat_objects::config::ObjectConfigs;
use heliosplat_objects::frame_spec::PointLight;
use heliosplat_objects::model::{Kind, ObjectFile, ObjectImage, SCHEMA};
use heliosplat_objects::pinhole::Pinhole;
use heliosplat_objects::pixels::Encoding;
use heliosplat_objects::run::ObjectRun;
use heliosplat_objects::views::Preparation;
use heliosplat_scene::Split;
use std::path::Path;
use std::sync::OnceLock;

/// A folder with the images named in [`transforms`]; their contents are not read.
pub(super) fn folder() -> &'static Path {
    static FOLDER: OnceLock<tempfile::TempDir> = OnceLock::new();
    let folder = FOLDER.get_or_init(|| {
        let folder = tempfile::tempdir().expect("a temporary folder");
        for n in 0..3 {
            std::fs::write(folder.path().join(format!("r_{n}.png")), b"").expect("written");
        }
        folder
    });
    folder.path()
}

/// One `transforms.json` for each dialect: a field of view, focal lengths, lamps by name and in lists, a refined pose.
pub(super) fn transforms() -> Vec<Vec<u8>> {
    let pose = "[[0.8, 0.3, -0.5, -2.0], [-0.6, 0.4, -0.7, -2.8], [0.0, 0.9, 0.5, 2.0], [0.0, 0.0, 0.0, 1.0]]";
    [
        format!(r#"{{"camera_angle_x": 0.69, "frames": [{{"file_path": "./r_0", "rotation": 0.01, "transform_matrix": {pose}}}]}}"#),
        format!(
            r#"{{"fl_x": 80.5, "fl_y": 80.1, "cx": 32.0, "cy": 24.0, "w": 64, "h": 48, "frames": [
            {{"file_path": "r_0.png", "transform_matrix": {pose}, "pl_pos": [1.0, 2.0, 3.0], "pl_intensity": [5.0, 5.0, 5.0]}},
            {{"file_path": "r_1.png", "transform_matrix": {pose}, "light": {{"position": [0.0, 2.0, 3.0], "intensity": 2.0}}}}]}}"#
        ),
        format!(
            r#"{{"camera_angle_x": 0.5, "frames": [{{"file_paths": ["r_0", "r_1", "r_2"], "transform_matrix": {pose},
            "light_positions": [[1, 2, 3], [1, 2, 4], [1, 2, 5]], "light_intensities": [1, 2, [3, 3, 3]]}}]}}"#
        ),
        r#"{"camera_intrinsics": [32.0, 24.0, 80.5, 80.1], "frames": [{"file_path": "r_2", "file_ext": ".png",
            "R_opt": [[1, 0, 0], [0, -1, 0], [0, 0, -1]], "T_opt": [0.1, 0.2, 4.0]}]}"#
            .to_owned(),
    ]
    .map(String::into_bytes)
    .to_vec()
}

/// Cameras, images and points of a COLMAP model, as text and binary.
pub(super) fn colmap() -> Vec<Vec<u8>> {
    let numbers = |values: &[f64]| values.iter().flat_map(|value| value.to_le_bytes()).collect::<Vec<u8>>();
    let one = 1u64.to_le_bytes().to_vec();
    let cameras = [
        one.clone(),
        vec![1, 0, 0, 0, 1, 0, 0, 0],
        64u64.to_le_bytes().to_vec(),
        48u64.to_le_bytes().to_vec(),
        numbers(&[80.5, 80.1, 32.0, 24.0]),
    ];
    let images = [
        one.clone(),
        vec![1, 0, 0, 0],
        numbers(&[0.5, 0.5, -0.5, 0.5, 0.1, 0.2, 4.0]),
        vec![1, 0, 0, 0],
        b"r_0.png\0".to_vec(),
        2u64.to_le_bytes().to_vec(),
        vec![0; 48],
    ];
    let points = [
        one.clone(),
        one.clone(),
        numbers(&[0.1, 0.2, 0.3]),
        vec![9, 8, 7],
        numbers(&[0.5]),
        one,
        vec![0; 8],
    ];
    [
        b"# cameras\n1 PINHOLE 64 48 80.5 80.1 32 24\n2 SIMPLE_PINHOLE 64 48 80.5 32 24\n".to_vec(),
        b"# images\n1 0.5 0.5 -0.5 0.5 0.1 0.2 4 1 r_0.png\n\n2 1 0 0 0 0 0 4 1 r_1.png\n1.5 2.5 -1\n".to_vec(),
        b"# points\n1 0.1 0.2 0.3 9 8 7 0.5 1 2 3 4\n".to_vec(),
        cameras.concat(),
        images.concat(),
        points.concat(),
    ]
    .to_vec()
}

/// A `cameras.csv`.
pub(super) fn tables() -> Vec<Vec<u8>> {
    let header = "name,fx,fy,cx,cy,width,height,r11,r12,r13,r21,r22,r23,r31,r32,r33,t1,t2,t3";
    vec![
        format!("{header}\nr_0.png,80.5,80.1,32,24,64,48,1,0,0,0,1,0,0,0,1,0.1,0.2,4\nr_1,80,80,32,24,64,48,0,-1,0,1,0,0,0,0,1,0,0,4\n")
            .into_bytes(),
    ]
}

/// Point clouds in PLY, as text and binary.
pub(super) fn clouds() -> Vec<Vec<u8>> {
    let header = |format: &str, kind: &str| {
        let axes = ["x", "y", "z"].map(|axis| format!("property {kind} {axis}\n")).concat();
        let colours = ["red", "green", "blue"]
            .map(|colour| format!("property uchar {colour}\n"))
            .concat();
        format!("ply\nformat {format} 1.0\nelement vertex 1\n{axes}{colours}end_header\n").into_bytes()
    };
    let mut text = header("ascii", "float");
    text.extend(b"0.1 0.2 0.3 9 8 7\n");
    let mut binary = header("binary_little_endian", "double");
    [0.1f64, 0.2, 0.3]
        .iter()
        .for_each(|value| binary.extend(value.to_le_bytes()));
    binary.extend([9, 8, 7]);
    vec![text, binary]
}

/// A small model of one light at a time with all of its parts.
pub(super) fn olat() -> Olat {
    Olat::new(OlatOptions {
        scattering: true,
        refined: true,
        width: 2,
        hidden: 1,
        ..OlatOptions::default()
    })
}

/// A `model.json` for every kind of model.
pub(super) fn models() -> Vec<Vec<u8>> {
    let (olat, options) = (
        olat(),
        ReflectiveOptions {
            width: 2,
            hidden: 1,
            ..ReflectiveOptions::default()
        },
    );
    let reflective = Reflective::new(options);
    let kinds = [
        (Kind::Radiance(RadianceOptions::default()), Table::zeros(Vec::new(), 1)),
        (Kind::Olat(olat.options.clone()), olat.initial_globals()),
        (
            Kind::Reflective(reflective.options.clone()),
            reflective.initial_globals(1),
        ),
    ];
    let image = ObjectImage {
        name: "train/r_0".into(),
        split: Split::Train,
        camera: Pinhole {
            eye: DVec3::new(0.0, -4.0, 0.0),
            right: DVec3::X,
            down: -DVec3::Z,
            forward: DVec3::Y,
            focal_px: [80.0; 2],
            principal_px: [31.5, 23.5],
            size_px: [64, 48],
        },
        light: Some(PointLight {
            position: DVec3::new(1.0, 2.0, 3.0),
            intensity: Some([2.0; 3]),
        }),
    };
    let file = |(kind, globals): (Kind, Table)| ObjectFile {
        schema: SCHEMA,
        gaussians_sha256: None,
        kind,
        globals,
        centre: DVec3::ZERO,
        half_size: 1.5,
        pixel_size: 0.05,
        encoding: Encoding::Linear,
        preparation: Preparation {
            background: [0.0; 3],
            coverage: true,
            linear: false,
            unit_light: Some([2.0; 3]),
        },
        projection: heliosplat::splat::ProjectionOptions::default(),
        images: vec![image.clone()],
    };
    kinds
        .into_iter()
        .map(|kind| serde_json::to_vec(&file(kind)).unwrap_or_default())
        .collect()
}

/// Two files `model.ply`, with five Gaussians and with none.
pub(super) fn plys() -> Vec<Vec<u8>> {
    let mut groups = core_groups();
    groups.extend(olat().feature_groups());
    let mut table = Table::zeros(groups, 5);
    for group in &mut table.groups {
        for (i, v) in group.values.iter_mut().enumerate() {
            *v = (i as f32 * 0.61).cos();
        }
    }
    vec![
        splat_ply::encode(&table, &[]),
        splat_ply::encode(&table.gather(&[]), &[]),
    ]
}

/// One `run.toml`.
pub(super) fn runs() -> Vec<Vec<u8>> {
    let run = ObjectRun {
        version: "0.1.0".into(),
        build: "0123456789abcdef".into(),
        preset: "fast".into(),
        seed: 1,
        capture: "capture".into(),
        inputs: Vec::new(),
        config: ObjectConfigs::resolve(heliosplat_fitting::settings::Preset::Fast, &[], 1)
            .map(|configs| configs.constant)
            .unwrap_or_default(),
        plan: None,
    };
    vec![toml::to_string_pretty(&run).unwrap_or_default().into_bytes()]
}
