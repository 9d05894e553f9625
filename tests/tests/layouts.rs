//! Layouts of scenes on disk: folders of Sat-NeRF and EOGS with images, cameras and truth apart, lists, `scene.toml`,
//! crops.

use heliosplat_raster::{ImageSpec, RasterFile, SampleType, write_geotiff};
use heliosplat_scene::{IngestOptions, RpcPreference, Scene, SceneError, Split, SunSource};
use heliosplat_tests::scenes::{SIZE_PX, View, write_altitudes, write_scene};
use std::fs;
use std::path::Path;
use tempfile::{TempDir, tempdir};

/// Easting and northing in UTM 37N of the middle of the views' ground, metres.
const SITE_M: [f64; 2] = [315451.0, 4161270.0];

fn open(path: &Path) -> Result<Scene, SceneError> {
    Scene::open(path, &IngestOptions::default())
}

fn names(scene: &Scene, split: Split) -> Vec<&str> {
    let of_split = scene.images.iter().filter(|image| image.split == split);
    of_split.map(|image| image.name.as_str()).collect()
}

/// `images/SITE/*.tif` without cameras, `rpcs/SITE/*.json` with them, `train.txt`, `test.txt` and
/// `truth/SITE/SITE_DSM.tif`.
fn eogs(home: &Path, site: &str) {
    let [images, cameras, truth] = ["images", "rpcs", "truth"].map(|name| home.join(name).join(site));
    parts(site, &images, &cameras, &truth);
}

/// As DFC2019 and Sat-NeRF are published: images and truth below `DFC2019`, two kinds of cameras below `root_dir`.
fn published(home: &Path, site: &str) {
    let [images, adjusted, raw] = [
        "DFC2019/Track3-RGB-crops",
        "root_dir/crops_rpcs_ba_v2",
        "root_dir/crops_rpcs_raw",
    ]
    .map(|name| home.join(name).join(site));
    parts(site, &images, &adjusted, &home.join("DFC2019/Track3-Truth"));
    fs::create_dir_all(&raw).expect("made");
    for entry in fs::read_dir(&adjusted).expect("cameras") {
        let path = entry.expect("a file").path();
        let text = fs::read_to_string(&path).expect("text");
        let mut lines = text.clone();
        if let Ok(mut json) = serde_json::from_str::<serde_json::Value>(&text) {
            let moved = json["rpc"]["col_offset"].as_f64().expect("an offset") + 3.0;
            json["rpc"]["col_offset"] = serde_json::json!(moved);
            lines = json.to_string();
        }
        fs::write(raw.join(path.file_name().expect("a name")), lines).expect("written");
    }
}

/// The parts of one site, each in a folder.
fn parts(site: &str, images: &Path, cameras: &Path, truth: &Path) {
    for folder in [images, cameras, truth] {
        fs::create_dir_all(folder).expect("made");
    }
    for number in 0..4 {
        let view = View {
            name: format!("{site}_{number:03}_RGB"),
            bands: 3,
            ..View::new(number)
        };
        let with_tag = view.write(images);
        fs::rename(
            with_tag.with_extension("json"),
            cameras.join(format!("{}.json", view.name)),
        )
        .expect("moved");
        // The image again, without its tag.
        let pixels = RasterFile::open(&with_tag)
            .expect("an image")
            .read_all()
            .expect("pixels");
        fs::remove_file(&with_tag).expect("removed");
        write_geotiff(&with_tag, &ImageSpec::plain(&pixels), SampleType::U16).expect("written");
    }
    let line = |number: usize| format!("{site}_{number:03}_RGB.json\n");
    fs::write(cameras.join("train.txt"), line(0) + &line(1) + &line(2)).expect("written");
    fs::write(cameras.join("test.txt"), line(3)).expect("written");
    let ground = heliosplat::Raster::filled(8, 8, 1, 700.0);
    write_altitudes(&truth.join(format!("{site}_DSM.tif")), &ground, SITE_M[0], SITE_M[1]);
}

#[test]
fn an_eogs_scene_is_found_from_its_cameras_its_images_and_its_root() {
    let home = tempdir().expect("a temporary folder");
    eogs(home.path(), "JAX_068");
    for start in ["rpcs/JAX_068", "images/JAX_068", "."] {
        let scene = open(&home.path().join(start)).unwrap_or_else(|error| panic!("{start}: {error}"));
        assert_eq!(
            names(&scene, Split::Train),
            ["JAX_068_000_RGB", "JAX_068_001_RGB", "JAX_068_002_RGB"],
            "{start}"
        );
        assert_eq!(names(&scene, Split::Test), ["JAX_068_003_RGB"], "{start}");
        assert_eq!(scene.altitude_range_m, (690.0, 720.0), "{start}");
        assert!(
            scene.images.iter().all(|image| image.rpc_source.ends_with("_RGB.json")),
            "{start}"
        );
        let dsm = scene
            .truth
            .dsm
            .as_deref()
            .unwrap_or_else(|| panic!("{start}: no truth"));
        assert!(
            dsm.ends_with("truth/JAX_068/JAX_068_DSM.tif"),
            "{start}: {}",
            dsm.display()
        );
    }
}

#[test]
fn the_published_layout_is_found_from_either_cameras_the_images_and_the_top() {
    let home = tempdir().expect("a temporary folder");
    published(home.path(), "JAX_068");
    let column = |scene: &Scene| scene.images[0].rpc.sample_offset;
    let adjusted = open(&home.path().join("root_dir/crops_rpcs_ba_v2/JAX_068")).expect("bundle-adjusted cameras");
    assert!(
        adjusted
            .warnings
            .iter()
            .all(|line| !line.contains("cameras in several"))
    );
    for (start, moved_px) in [
        ("root_dir/crops_rpcs_ba_v2/JAX_068", 0.0),
        ("root_dir/crops_rpcs_raw/JAX_068", 3.0),
        ("DFC2019/Track3-RGB-crops/JAX_068", 0.0),
        ("root_dir", 0.0),
        (".", 0.0),
    ] {
        let scene = open(&home.path().join(start)).unwrap_or_else(|error| panic!("{start}: {error}"));
        assert_eq!(names(&scene, Split::Train).len(), 3, "{start}");
        assert_eq!(names(&scene, Split::Test), ["JAX_068_003_RGB"], "{start}");
        assert!((column(&scene) - column(&adjusted) - moved_px).abs() < 1e-9, "{start}");
        let dsm = scene.truth.dsm.unwrap_or_else(|| panic!("{start}: no truth"));
        assert!(dsm.ends_with("Track3-Truth/JAX_068_DSM.tif"), "{start}");
        let chosen = scene.warnings.iter().filter(|line| line.contains("bundle-adjusted"));
        let named = chosen.filter(|line| line.contains("crops_rpcs_raw")).count();
        assert_eq!(
            named,
            usize::from(!start.contains("rpcs")),
            "{start}: {:?}",
            scene.warnings
        );
    }
}

#[test]
fn a_top_of_several_areas_lists_one_folder_for_each() {
    let home = tempdir().expect("a temporary folder");
    published(home.path(), "JAX_004");
    published(home.path(), "JAX_068");
    let error = open(home.path()).expect_err("which one?").to_string();
    for area in ["crops_rpcs_ba_v2/JAX_004", "crops_rpcs_ba_v2/JAX_068"] {
        assert!(error.contains(area), "{error}");
    }
    assert!(!error.contains("crops_rpcs_raw"), "{error}");
    let scene = open(&home.path().join("root_dir/crops_rpcs_raw/JAX_004")).expect("one of them");
    assert!(scene.images.iter().all(|image| image.name.starts_with("JAX_004")));
    assert!(scene.truth.dsm.is_some_and(|dsm| dsm.ends_with("JAX_004_DSM.tif")));
}

#[test]
fn truth_of_another_area_is_not_taken() {
    let home = tempdir().expect("a temporary folder");
    published(home.path(), "JAX_068");
    let truth = home.path().join("DFC2019/Track3-Truth");
    fs::rename(truth.join("JAX_068_DSM.tif"), truth.join("JAX_004_DSM.tif")).expect("renamed");
    let cameras = home.path().join("root_dir/crops_rpcs_ba_v2/JAX_068");
    assert!(open(&cameras).expect("a scene").truth.dsm.is_none());
    // The right name on the wrong ground, placed by its text: 2 km east.
    let ground = heliosplat::Raster::filled(8, 8, 1, 700.0);
    let dsm = truth.join("JAX_068_DSM.tif");
    write_geotiff(&dsm, &ImageSpec::plain(&ground), SampleType::F32).expect("written");
    let origin = open(&cameras).expect("a scene").origin();
    let utm = heliosplat_raster::Crs::utm(origin).expect("a zone");
    let (east, north) = heliosplat_raster::CrsTransform::from_lon_lat(&utm)
        .and_then(|way| way.apply(origin.lon_deg, origin.lat_deg))
        .expect("in the zone");
    for (moved_m, taken) in [(0.0, true), (2000.0, false)] {
        let text = format!("{}\n{}\n8\n0.5\n", east + moved_m, north);
        fs::write(dsm.with_extension("txt"), text).expect("written");
        let scene = open(&cameras).expect("a scene");
        assert_eq!(scene.truth.dsm.is_some(), taken, "{:?}", scene.warnings);
        assert_eq!(scene.warnings.iter().any(|line| line.contains("other ground")), !taken);
    }
}

#[test]
fn crops_and_whole_images_of_one_name_are_told_apart_by_their_size() {
    let home = tempdir().expect("a temporary folder");
    published(home.path(), "JAX_068");
    let whole = home.path().join("DFC2019/Track3-RGB-1");
    fs::create_dir_all(&whole).expect("made");
    let large = heliosplat::Raster::filled(2 * SIZE_PX, 2 * SIZE_PX, 3, 9.0);
    for number in 0..4 {
        let cameras = home.path().join("root_dir/crops_rpcs_ba_v2/JAX_068");
        let camera = cameras.join(format!("JAX_068_{number:03}_RGB.json"));
        let text = fs::read_to_string(&camera).expect("text");
        let mut json: serde_json::Value = serde_json::from_str(&text).expect("JSON");
        for side in ["width", "height"] {
            json[side] = serde_json::json!(SIZE_PX);
        }
        fs::write(&camera, json.to_string()).expect("written");
        let path = whole.join(format!("JAX_068_{number:03}_RGB.tif"));
        write_geotiff(&path, &ImageSpec::plain(&large), SampleType::U16).expect("written");
    }
    let scene = open(&home.path().join("root_dir/crops_rpcs_ba_v2/JAX_068")).expect("a scene");
    assert!(scene.images.iter().all(|image| image.pixels.width == SIZE_PX));
}

#[test]
fn a_root_of_several_scenes_names_them() {
    let home = tempdir().expect("a temporary folder");
    eogs(home.path(), "JAX_068");
    eogs(home.path(), "JAX_214");
    let error = open(home.path()).expect_err("which one?").to_string();
    assert!(
        error.contains("several scenes") && error.contains("JAX_068") && error.contains("JAX_214"),
        "{error}"
    );
    let scene = open(&home.path().join("rpcs/JAX_214")).expect("one of them");
    assert_eq!(scene.images.len(), 4);
    assert!(scene.truth.dsm.is_some_and(|dsm| dsm.ends_with("JAX_214_DSM.tif")));
}

#[test]
fn a_camera_whose_image_is_missing_names_both() {
    let home = tempdir().expect("a temporary folder");
    eogs(home.path(), "JAX_068");
    fs::remove_file(home.path().join("images/JAX_068/JAX_068_001_RGB.tif")).expect("removed");
    let error = open(&home.path().join("rpcs/JAX_068"))
        .expect_err("an image is gone")
        .to_string();
    assert!(
        error.contains("JAX_068_001_RGB.tif") && error.contains("JAX_068_001_RGB.json"),
        "{error}"
    );
}

fn three_views() -> (TempDir, Vec<View>) {
    let folder = tempdir().expect("a temporary folder");
    let views: Vec<View> = (0..3).map(View::new).collect();
    write_scene(folder.path(), &views);
    (folder, views)
}

#[test]
fn truth_in_the_same_folder_is_no_image() {
    let (folder, _) = three_views();
    let ground = heliosplat::Raster::filled(8, 8, 1, 700.0);
    write_altitudes(&folder.path().join("site_DSM.tif"), &ground, SITE_M[0], SITE_M[1]);
    let scene = open(folder.path()).expect("a scene");
    assert_eq!(scene.images.len(), 3);
    assert!(scene.truth.dsm.is_some());
}

#[test]
fn a_scene_toml_says_what_the_files_do_not() {
    let (folder, _) = three_views();
    for number in 0..3 {
        fs::remove_file(folder.path().join(format!("view_{number}.json"))).expect("removed");
    }
    let manifest = "altitude_range_m = [650, 750]\nbands = [\"near_infrared\"]\n\
        [[images]]\npath = \"view_0.tif\"\ntime = \"2016-04-23T08:34:00Z\"\n\
        [[images]]\npath = \"view_1.tif\"\nsun_azimuth_deg = 150\nsun_elevation_deg = 60\n\
        [[images]]\npath = \"view_2.tif\"\ntime = \"2016-04-23T08:34:00Z\"\nsplit = \"test\"\n";
    let path = folder.path().join("scene.toml");
    fs::write(&path, manifest).expect("written");
    let scene = open(&path).expect("a scene");
    assert_eq!(scene.altitude_range_m, (650.0, 750.0));
    assert_eq!(names(&scene, Split::Test), ["view_2"]);
    assert_eq!(scene.images[0].sun.source, SunSource::Time);
    let stated = scene.images[1].sun;
    assert_eq!(stated.source, SunSource::Metadata);
    assert!((stated.angles_deg().expect("a sun")[1] - 60.0).abs() < 1e-9);
    assert_eq!(scene.bands()[0].name(), "near_infrared");
}

#[test]
fn the_frame_is_centred_and_the_views_cover_it() {
    let (folder, _) = three_views();
    let scene = open(folder.path()).expect("a scene");
    let origin = scene.origin();
    assert!((origin.height_m - 705.0).abs() < 1e-9);
    assert!(
        (origin.lon_deg - 36.91).abs() < 2e-5 && (origin.lat_deg - 37.58).abs() < 2e-5,
        "{origin:?}"
    );
    assert_eq!(scene.views_covering(0.0, 0.0, 0.0), 3);
    assert_eq!(scene.views_covering(100.0, 0.0, 0.0), 0);
    assert!(scene.area.east_m - scene.area.west_m > 25.0 && scene.area.east_m - scene.area.west_m < 34.0);
    // Most pixels lie between 0 and 1, and the brightest near 1.
    let brightest = scene.images[0].pixels.values.iter().copied().fold(0.0, f32::max);
    assert!((0.9..1.1).contains(&brightest), "{brightest}");
}

/// Writes view 1 as a crop: its camera is that of a larger image, whose origin is only in the geotransform.
fn write_crop(folder: &Path, view: &View, origin: [f64; 2]) {
    let path = view.write(folder);
    let pixels = RasterFile::open(&path).expect("an image").read_all().expect("pixels");
    let mut full = view.rpc().cropped(-origin[0], -origin[1]);
    // The same camera, made for an image forty times as wide: only heights keep their scale.
    full.sample_scale *= 40.0;
    full.line_scale *= 40.0;
    full.latitude_scale_deg *= 40.0;
    full.longitude_scale_deg *= 40.0;
    full.sample_numerator[3] /= 40.0;
    full.line_numerator[3] /= 40.0;
    let rpc: Vec<(String, String)> = heliosplat_rpc::write::gdal_domain(&full).into_iter().collect();
    let spec = ImageSpec {
        rpc: &rpc,
        ..ImageSpec::plain(&pixels)
    };
    write_geotiff(&path, &spec, SampleType::U16).expect("written");
    let metadata = path.with_extension("json");
    fs::write(
        metadata,
        "{\"img\": \"view_1.tif\", \"acquisition_date\": \"20160423083400\"}",
    )
    .expect("written");
    // A world file is the only way to a geotransform without a coordinate system that GDAL keeps apart from the image.
    let centre = origin.map(|value| value + 0.5);
    let world = format!("1\n0\n0\n1\n{}\n{}\n", centre[0], centre[1]);
    fs::write(path.with_extension("tfw"), world).expect("written");
}

#[test]
fn a_crop_whose_origin_is_only_in_the_geotransform_gets_its_own_camera() {
    let (folder, views) = three_views();
    write_crop(folder.path(), &views[1], [700.0, 300.5]);
    let scene = open(folder.path()).expect("a scene");
    let image = scene
        .images
        .iter()
        .find(|image| image.name == "view_1")
        .expect("view 1");
    let want = views[1].rpc();
    assert!(
        (image.rpc.sample_offset - want.sample_offset).abs() < 1e-6,
        "{}",
        image.rpc.sample_offset
    );
    assert!(
        (image.rpc.line_offset - want.line_offset).abs() < 1e-6,
        "{}",
        image.rpc.line_offset
    );
    assert_eq!(scene.views_covering(0.0, 0.0, 0.0), 3);
    assert!(
        scene
            .warnings
            .iter()
            .any(|line| line.contains("view_1.tif") && line.contains("crop origin"))
    );
}

#[test]
fn two_cameras_that_differ_are_a_warning_and_the_option_chooses() {
    let (folder, views) = three_views();
    let path = folder.path().join("view_1.json");
    let mut metadata: serde_json::Value = serde_json::from_slice(&fs::read(&path).expect("readable")).expect("JSON");
    let moved = views[1].rpc().sample_offset + 2.0;
    metadata["rpc"]["col_offset"] = serde_json::json!(moved);
    fs::write(&path, metadata.to_string()).expect("written");
    for (preference, want) in [(RpcPreference::Json, moved), (RpcPreference::Image, moved - 2.0)] {
        let options = IngestOptions {
            rpc: preference,
            ..IngestOptions::default()
        };
        let scene = Scene::open(folder.path(), &options).expect("a scene");
        let image = scene
            .images
            .iter()
            .find(|image| image.name == "view_1")
            .expect("view 1");
        assert!((image.rpc.sample_offset - want).abs() < 1e-9);
        assert!(
            scene.warnings.iter().any(|line| line.contains("differ by 2.0 px")),
            "{:?}",
            scene.warnings
        );
    }
}

#[test]
fn a_time_that_contradicts_the_stated_sun_is_a_warning_and_the_time_counts() {
    let folder = tempdir().expect("a temporary folder");
    let contradictory = View {
        sun_deg: Some([100.0, 30.0]),
        ..View::new(1)
    };
    write_scene(folder.path(), &[View::new(0), contradictory]);
    let scene = open(folder.path()).expect("a scene");
    let image = &scene.images[1];
    assert_eq!(image.sun.source, SunSource::Time);
    assert!((image.sun.angles_deg().expect("a sun")[1] - 62.1).abs() < 0.1);
    assert!(
        scene
            .warnings
            .iter()
            .any(|line| line.contains("view_1.tif") && line.contains("degrees off"))
    );
}

#[test]
fn cameras_of_a_neighbouring_folder_are_not_taken() {
    let home = tempdir().expect("a temporary folder");
    let [own, other, bare] = ["site", "site_adjusted", "bare"].map(|name| home.path().join(name));
    for folder in [&own, &other, &bare] {
        fs::create_dir(folder).expect("made");
        write_scene(folder, &[0, 1].map(View::new));
    }
    for number in 0..2 {
        fs::remove_file(own.join(format!("view_{number}.json"))).expect("removed");
        fs::remove_file(other.join(format!("view_{number}.tif"))).expect("removed");
        // JSON files of images of another format, in a folder of a published name.
        let json = bare.join(format!("view_{number}.json"));
        fs::remove_file(bare.join(format!("view_{number}.tif"))).expect("removed");
        let text = fs::read_to_string(&json).expect("a JSON").replace(".tif", ".jp2");
        fs::write(json, text).expect("written");
    }
    let before = open(&own).expect("a scene");
    assert!(before.images.iter().all(|image| !image.rpc_source.ends_with(".json")));
    fs::rename(&bare, home.path().join("rpcs")).expect("renamed");
    let scene = open(&own).expect("a scene");
    assert!(scene.images.iter().all(|image| !image.rpc_source.ends_with(".json")));
    assert_eq!(scene.warnings, before.warnings);
}

#[test]
fn a_scene_beside_that_has_images_of_the_same_names_lends_nothing() {
    let home = tempdir().expect("a temporary folder");
    let [whole, bare] = ["whole", "bare"].map(|name| home.path().join(name));
    for folder in [&whole, &bare] {
        fs::create_dir(folder).expect("made");
        write_scene(folder, &[0, 1, 2].map(View::new));
    }
    fs::write(whole.join("test.txt"), "view_2.tif\n").expect("written");
    for number in 0..3 {
        fs::remove_file(bare.join(format!("view_{number}.json"))).expect("removed");
    }
    assert_eq!(open(&whole).expect("a scene").altitude_range_m, (690.0, 720.0));
    let scene = open(&bare).expect("a scene");
    assert_eq!(scene.altitude_range_m, (600.0, 800.0), "all that its own cameras allow");
    assert_eq!(names(&scene, Split::Test), [""; 0]);
    assert!(scene.images.iter().all(|image| !image.rpc_source.ends_with(".json")));
}

#[test]
fn without_any_altitude_the_cameras_range_is_searched_with_a_warning() {
    let (folder, _) = three_views();
    for number in 0..3 {
        let path = folder.path().join(format!("view_{number}.json"));
        fs::write(
            path,
            format!("{{\"img\": \"view_{number}.tif\", \"acquisition_date\": \"20160423083400\"}}"),
        )
        .expect("written");
    }
    let scene = open(folder.path()).expect("a scene");
    assert_eq!(scene.altitude_range_m, (600.0, 800.0));
    assert!(
        scene.warnings.iter().any(|line| line.contains("--altitude")),
        "{:?}",
        scene.warnings
    );
}

#[test]
fn nodata_is_missing_and_does_not_count_as_seen() {
    let (folder, _) = three_views();
    let path = folder.path().join("view_1.tif");
    let file = RasterFile::open(&path).expect("an image");
    let mut pixels = file.read_all().expect("pixels");
    let rpc: Vec<(String, String)> = file.domain("RPC").into_iter().collect();
    // The northern half is missing.
    pixels.values[..SIZE_PX * SIZE_PX / 2].fill(f32::NAN);
    let spec = ImageSpec {
        rpc: &rpc,
        ..ImageSpec::plain(&pixels)
    };
    write_geotiff(&path, &spec, SampleType::F32).expect("written");
    let scene = open(folder.path()).expect("a scene");
    assert_eq!(scene.views_covering(0.0, 8.0, 0.0), 2);
    assert_eq!(scene.views_covering(0.0, -8.0, 0.0), 3);
}
