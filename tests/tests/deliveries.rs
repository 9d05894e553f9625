//! Images as vendors pack them: panchromatic and multispectral files of one acquisition, images cut into tiles, gains,
//! stretches to eight bits, and images of several resolutions.

use heliosplat::Raster;
use heliosplat_raster::write::copy_with_rpc;
use heliosplat_raster::{Crs, CrsTransform, GeoTransform, ImageSpec, RasterFile, SampleType, Window, write_geotiff};
use heliosplat_rpc::read::gdal_domain;
use heliosplat_rpc::{Rpc, write};
use heliosplat_scene::cameras::SceneCameras;
use heliosplat_scene::{Index, IngestOptions, RpcPreference, Scene, SceneError, ValueKind, Values};
use heliosplat_tests::program::{fault, heliosplat, json, tiny_scene};
use heliosplat_tests::scenes::{GSD_M, SIZE_PX, View};
use serde_json::Value;
use std::fs;
use std::path::{Path, PathBuf};
use tempfile::tempdir;

fn open(path: &Path) -> Result<Scene, SceneError> {
    Scene::open(path, &IngestOptions::default())
}

/// Panchromatic pixels along the side of a multispectral one.
const RATIO: usize = 4;

/// Writes four bands of a quarter of a view's resolution, whose pixels lie `moved_px` of them off.
fn write_multispectral(path: &Path, view: &View, moved_px: f64, date: &str) {
    let size = SIZE_PX / RATIO;
    let mut bands = Raster::filled(size, size, 4, 100.0);
    for (index, value) in bands.values.iter_mut().enumerate() {
        *value = 100.0 * (1 + index / (size * size)) as f32 + (index % size) as f32;
    }
    let (fine, ratio) = (view.rpc(), RATIO as f64);
    let rpc = Rpc {
        sample_offset: (fine.sample_offset + 0.5) / ratio - 0.5,
        line_offset: (fine.line_offset + 0.5) / ratio - 0.5,
        sample_scale: fine.sample_scale / ratio,
        line_scale: fine.line_scale / ratio,
        ..fine.clone()
    };
    let mut rpc = rpc;
    // Bent, not moved: a shift of both cameras is nobody's fault.
    rpc.sample_numerator[7] += moved_px / rpc.sample_scale;
    let rpc: Vec<(String, String)> = write::gdal_domain(&rpc).into_iter().collect();
    let spec = ImageSpec {
        rpc: &rpc,
        ..ImageSpec::plain(&bands)
    };
    write_geotiff(path, &spec, SampleType::U16).expect("written");
    let text = format!("{{\"img\": \"x.tif\", \"acquisition_date\": \"{date}\"}}");
    fs::write(path.with_extension("json"), text).expect("written");
}

/// Three views, a minute apart.
fn views() -> Vec<View> {
    let dates = ["20160423083400", "20160423083500", "20160423083600"];
    let view = |(number, date)| View {
        date: Some(date),
        ..View::new(number)
    };
    dates.into_iter().enumerate().map(view).collect()
}

#[test]
fn a_panchromatic_and_a_multispectral_file_are_one_image_by_their_names() {
    let home = tempdir().expect("a temporary folder");
    for view in views() {
        let pan = View {
            name: format!("{}-P1BS-01_P001", view.name),
            ..view.clone()
        };
        pan.write(home.path());
        let name = format!("{}-M1BS-01_P001.tif", view.name);
        write_multispectral(&home.path().join(name), &view, 0.0, "20160423083400");
    }
    let scene = open(home.path()).expect("a scene");
    assert_eq!(scene.images.len(), 3);
    let bands: Vec<&str> = scene.bands().iter().map(|band| band.name()).collect();
    assert_eq!(bands, ["red", "green", "blue", "near_infrared"]);
    for image in &scene.images {
        assert_eq!((image.pixels.width, image.pixels.height), (SIZE_PX, SIZE_PX));
        assert!(image.name.contains("P1BS") && (image.gsd_m - 0.5).abs() < 0.01);
        let [red, infrared] = [0, 3].map(|band| image.pixels.at(band, 30, 30));
        // Blue comes first in files of this vendor: 400 counts to 300, but for a gradient.
        assert!((1.3..1.34).contains(&(infrared / red)), "{}", infrared / red);
    }
    let told = scene.warnings.iter().filter(|line| line.contains("pansharpened"));
    assert_eq!(told.count(), 1, "{:?}", scene.warnings);
}

#[test]
fn files_of_one_second_are_one_image_whatever_their_names_and_folders() {
    let home = tempdir().expect("a temporary folder");
    for (number, view) in views().into_iter().enumerate() {
        let folders = ["first", "second"].map(|name| home.path().join(format!("{name}_{number}")));
        for folder in &folders {
            fs::create_dir_all(folder).expect("made");
        }
        let pan = view.write(&folders[0]);
        let json = format!(
            "{{\"img\": \"other.tif\", \"acquisition_date\": \"{}\"}}",
            view.date.expect("a date")
        );
        fs::write(pan.with_extension("json"), json).expect("written");
        write_multispectral(&folders[1].join("image.tif"), &view, 0.0, view.date.expect("a date"));
    }
    let scene = open(home.path()).expect("a scene");
    assert_eq!((scene.images.len(), scene.bands().len()), (3, 4));
}

#[test]
fn halves_whose_cameras_disagree_are_refused_with_a_number() {
    let home = tempdir().expect("a temporary folder");
    for view in views() {
        let pan = View {
            name: format!("{}_P", view.name),
            ..view.clone()
        };
        pan.write(home.path());
        let path = home.path().join(format!("{}_MS.tif", view.name));
        write_multispectral(&path, &view, 6.0, "20160423083400");
    }
    let error = open(home.path()).expect_err("cameras of other images").to_string();
    assert!(
        error.contains("view_0_P.tif") && error.contains("view_0_MS.tif") && error.contains("disagree by"),
        "{error}"
    );
}

/// Writes a view in four uneven tiles, whose names `name` makes of row and column, and whole into another folder; the
/// first tile has the camera of all, and the JSON is its.
fn cut(view: &View, home: &Path, whole: &Path, name: &dyn Fn(usize, usize) -> String) {
    view.write(whole);
    let path = view.write(home);
    let file = RasterFile::open(&path).expect("an image");
    let rpc: Vec<(String, String)> = file.domain("RPC").into_iter().collect();
    for (row, (row0, height)) in [(0, CUT_PX[1]), (CUT_PX[1], SIZE_PX - CUT_PX[1])]
        .into_iter()
        .enumerate()
    {
        for (col, (col0, width)) in [(0, CUT_PX[0]), (CUT_PX[0], SIZE_PX - CUT_PX[0])]
            .into_iter()
            .enumerate()
        {
            let window = Window {
                col0,
                row0,
                width,
                height,
            };
            let pixels = file.read(window, &[0]).expect("pixels");
            let spec = ImageSpec {
                rpc: if row + col == 0 { &rpc } else { &[] },
                ..ImageSpec::plain(&pixels)
            };
            let name = format!("{}.tif", name(row + 1, col + 1));
            write_geotiff(&home.join(name), &spec, SampleType::U16).expect("written");
        }
    }
    fs::remove_file(&path).expect("removed");
    let json = fs::read_to_string(path.with_extension("json")).expect("text");
    fs::remove_file(path.with_extension("json")).expect("removed");
    let tile = name(1, 1);
    let json = json.replace(&format!("{}.tif", view.name), &format!("{tile}.tif"));
    fs::write(home.join(format!("{tile}.json")), json).expect("written");
}

/// Columns and rows of the first tile.
const CUT_PX: [usize; 2] = [24, 40];

/// The scene in tiles is the scene of whole images.
fn assert_alike(tiled: &Path, whole: &Path) {
    let (tiled, whole) = (open(tiled).expect("a scene"), open(whole).expect("a scene"));
    assert_eq!(tiled.images.len(), 3);
    for (tiled, whole) in tiled.images.iter().zip(&whole.images) {
        assert_eq!(tiled.pixels, whole.pixels);
        assert_eq!(tiled.rpc, whole.rpc);
    }
}

#[test]
fn tiles_of_an_image_are_read_as_one() {
    let home = tempdir().expect("a temporary folder");
    let whole = tempdir().expect("a temporary folder");
    for view in views() {
        let name = |row: usize, col: usize| format!("{}_R{row}C{col}", view.name);
        cut(&view, home.path(), whole.path(), &name);
    }
    assert_alike(home.path(), whole.path());
    fs::remove_file(home.path().join("view_1_R2C1.tif")).expect("removed");
    let error = open(home.path()).expect_err("a tile is gone").to_string();
    assert!(error.contains("R2C1") && error.contains("view_1"), "{error}");
}

/// The DIMAP of a product in four tiles.
fn dimap(file: &dyn Fn(usize, usize) -> String) -> String {
    let mut files = String::new();
    for (row, col) in [(1, 1), (1, 2), (2, 1), (2, 2)] {
        let href = file(row, col);
        files +=
            &format!("<Data_File tile_R=\"{row}\" tile_C=\"{col}\"><DATA_FILE_PATH href=\"{href}.tif\"/></Data_File>");
    }
    let [columns, rows] = CUT_PX;
    format!(
        "<?xml version=\"1.0\" encoding=\"UTF-8\"?><Dimap_Document><Raster_Data><Data_Access><DATA_FILE_TILES>true</DATA_FILE_TILES>\
         <Data_Files>{files}</Data_Files></Data_Access><Raster_Dimensions><NROWS>{SIZE_PX}</NROWS><NCOLS>{SIZE_PX}</NCOLS><Tile_Set>\
         <NTILES>4</NTILES><Regular_Tiling><NTILES_SIZE nrows=\"{rows}\" ncols=\"{columns}\"/><OVERLAP_ROW>0</OVERLAP_ROW>\
         <OVERLAP_COL>0</OVERLAP_COL></Regular_Tiling></Tile_Set></Raster_Dimensions></Raster_Data></Dimap_Document>"
    )
}

#[test]
fn tiles_that_a_dimap_lists_are_one_image_whatever_their_names() {
    let home = tempdir().expect("a temporary folder");
    let whole = tempdir().expect("a temporary folder");
    for view in views() {
        let corner = |row: usize, col: usize| {
            let corner = [["a_upper_left", "b_upper_right"], ["c_lower_left", "d_lower_right"]][row - 1][col - 1];
            format!("{}_{corner}", view.name)
        };
        cut(&view, home.path(), whole.path(), &corner);
        let name = format!("DIM_PRODUCT_{}.XML", view.name);
        fs::write(home.path().join(name), dimap(&corner)).expect("written");
    }
    assert_alike(home.path(), whole.path());
    fs::remove_file(home.path().join("view_1_c_lower_left.tif")).expect("removed");
    let error = open(home.path()).expect_err("a tile is gone").to_string();
    for word in ["view_1_c_lower_left.tif", "DIM_PRODUCT_view_1.XML", "copy it"] {
        assert!(error.contains(word), "{word} in {error}");
    }
}

/// The IMD of a view, with near infrared of twice the gain of red.
fn imd() -> String {
    let band = |name: &str, factor: f64| {
        format!(
            "BEGIN_GROUP = BAND_{name}\n\tabsCalFactor = {factor:e};\n\teffectiveBandwidth = 1.0e-01;\nEND_GROUP = BAND_{name}\n"
        )
    };
    let bands = [("B", 0.01), ("G", 0.01), ("R", 0.01), ("N", 0.02)].map(|(name, factor)| band(name, factor));
    format!(
        "bandId = \"BGRN\";\nradiometricLevel = \"Corrected\";\nradiometricEnhancement = \"Off\";\n{}BEGIN_GROUP = IMAGE_1\n\tsatId = \
         \"WV03\";\nEND_GROUP = IMAGE_1\nEND;\n",
        bands.concat()
    )
}

#[test]
fn indices_are_of_reflectance_where_all_images_have_gains() {
    let home = tempdir().expect("a temporary folder");
    for view in views() {
        let path = View { bands: 4, ..view }.write(home.path());
        fs::write(path.with_extension("IMD"), imd()).expect("written");
    }
    let scene = open(home.path()).expect("a scene");
    let first = &scene.images[0];
    assert_eq!(first.values.kind, ValueKind::Reflectance);
    assert_eq!(first.values.source.as_deref(), Some("view_0.IMD"));
    let counts = Values::default().ndvi(&first.bands).expect("both bands");
    let value = |band: usize| first.pixels.at(band, 30, 30);
    let reflectance = first.ndvi().expect("both bands");
    // All bands have equal counts: near infrared reflects more than twice what red does, for there is less of it in
    // sunlight.
    assert_eq!(counts.of(value), 0.0);
    assert!((0.4..0.6).contains(&reflectance.of(value)), "{}", reflectance.of(value));

    fs::remove_file(home.path().join("view_2.IMD")).expect("removed");
    let scene = open(home.path()).expect("a scene");
    let told = scene.warnings.iter().find(|line| line.contains("has no gains"));
    assert!(
        told.is_some_and(|line| line.contains("view_2.tif")),
        "{:?}",
        scene.warnings
    );
    assert_eq!(scene.images[0].ndvi(), Some(counts));
    assert_eq!(scene.images[2].values, Values::default());
}

/// Rewrites the image of a view in eight bits, its counts stretched and clipped.
fn stretch(path: &Path, gain: f32) {
    let file = RasterFile::open(path).expect("an image");
    let mut raster = file.read_all().expect("pixels");
    let rpc: Vec<(String, String)> = file.domain("RPC").into_iter().collect();
    let names: Vec<String> = file.bands.iter().map(|band| band.description.clone()).collect();
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    raster
        .values
        .iter_mut()
        .for_each(|value| *value = (*value * gain).round().clamp(0.0, 255.0));
    let spec = ImageSpec {
        rpc: &rpc,
        band_descriptions: &names,
        ..ImageSpec::plain(&raster)
    };
    write_geotiff(path, &spec, SampleType::U8).expect("written");
}

#[test]
fn eight_bits_clipped_at_their_limits_are_for_display_and_make_no_index() {
    let stretched = |gain: f32| {
        let home = tempdir().expect("a temporary folder");
        for view in views() {
            stretch(&View { bands: 4, ..view }.write(home.path()), gain);
        }
        open(home.path()).expect("a scene")
    };
    let display = stretched(0.5);
    assert_eq!(
        display.images[0].values,
        Values {
            kind: ValueKind::Display,
            ..Values::default()
        }
    );
    assert_eq!(display.images[0].ndvi(), None);
    let told = display
        .warnings
        .iter()
        .filter(|line| line.contains("stretched for display"));
    assert_eq!(told.count(), 1, "{:?}", display.warnings);
    // Eight bits alone are no reason.
    let linear = stretched(0.25);
    assert_eq!(linear.images[0].values, Values::default());
    assert!(linear.images[0].ndvi().is_some());
}

/// Averages two by two pixels of an image into one, with its camera; a JSON beside it keeps what else it says.
fn halve(path: &Path) {
    let file = RasterFile::open(path).expect("an image");
    let raster = file.read_all().expect("pixels").downscaled(2);
    let rpc = gdal_domain(&file.domain("RPC")).expect("a camera");
    let halved = |offset: f64| (offset + 0.5) / 2.0 - 0.5;
    let rpc = Rpc {
        sample_offset: halved(rpc.sample_offset),
        line_offset: halved(rpc.line_offset),
        sample_scale: rpc.sample_scale / 2.0,
        line_scale: rpc.line_scale / 2.0,
        ..rpc
    };
    let items: Vec<(String, String)> = write::gdal_domain(&rpc).into_iter().collect();
    let names: Vec<String> = file.bands.iter().map(|band| band.description.clone()).collect();
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    let spec = ImageSpec {
        rpc: &items,
        band_descriptions: &names,
        ..ImageSpec::plain(&raster)
    };
    write_geotiff(path, &spec, SampleType::U16).expect("written");
    let json = path.with_extension("json");
    let mut said: Value = serde_json::from_slice(&fs::read(&json).expect("text")).expect("JSON");
    said["rpc"] = write::satnerf_json_rpc(&rpc);
    said["width"] = raster.width.into();
    said["height"] = raster.height.into();
    fs::write(&json, said.to_string()).expect("written");
}

/// Largest ratio of the error of the swept surface with every second image twice as coarse to the error with all images
/// fine (docs/lab/deliveries.md).
const MIXED_TIMES: f64 = 1.5;

#[test]
fn images_of_two_resolutions_make_a_surface_in_cells_of_the_finer() {
    let home = tempdir().expect("a temporary folder");
    let scene = home.path().join("scene");
    let word = scene.display().to_string();
    json(&["synth", "satellite", "--site", "tiny", "--seed", "1", "--out", &word]);
    let dsm = home.path().join("dsm.tif").display().to_string();
    let truth = scene.join("truth").join("dsm.tif").display().to_string();
    let error_m = || {
        json(&["dsm", &word, "--from", "sweep", "--out", &dsm]);
        let errors = json(&["evaluate", "--dsm", &dsm, "--truth", &truth]);
        assert_eq!(
            errors,
            json(&["evaluate", &dsm, "--truth", &truth]),
            "a DSM is told from a run"
        );
        errors["dsm"]["mae_m"].as_f64().expect("a number")
    };
    let gsd_m = |scene: &Value| scene["gsd_m"].as_f64().expect("a number");
    let (fine, fine_m) = (json(&["inspect", &word]), error_m());
    let images = fine["images"].as_array().expect("images").iter();
    let paths = images.map(|image| PathBuf::from(image["path"].as_str().expect("a path")));
    paths.skip(1).step_by(2).for_each(|path| halve(&path));
    let (mixed, mixed_m) = (json(&["inspect", &word]), error_m());
    let of_image = |image: usize| gsd_m(&mixed["images"][image]);
    assert!(
        (of_image(1) / of_image(0) - 2.0).abs() < 0.2,
        "{} {}",
        of_image(0),
        of_image(1)
    );
    assert!(
        (gsd_m(&mixed) - gsd_m(&fine)).abs() < 0.05,
        "{} {}",
        gsd_m(&mixed),
        gsd_m(&fine)
    );
    assert!(mixed_m < MIXED_TIMES * fine_m, "{mixed_m} m for {fine_m} m");
}

#[test]
fn copies_of_one_image_are_refused_and_one_among_others_is_named() {
    let home = tempdir().expect("a temporary folder");
    let folder = home.path().join("scene");
    fs::create_dir(&folder).expect("made");
    let [first, copy] = ["first", "copy"].map(|name| View {
        name: name.into(),
        ..View::new(0)
    });
    for view in [&first, &copy] {
        view.write(&folder);
    }
    let out = home.path().join("dsm.tif");
    let arguments = [folder.as_path(), Path::new("--out"), out.as_path()].map(|path| path.display().to_string());
    let arguments: Vec<&str> = ["dsm", "--from", "sweep"]
        .into_iter()
        .chain(arguments.iter().map(String::as_str))
        .collect();
    let said = fault(&arguments, 2);
    assert!(
        said.contains("no parallax") && said.contains("copy.tif") && said.contains("first.tif"),
        "{said}"
    );
    assert!(!out.exists());
    View::new(1).write(&folder);
    let scene = open(&folder).expect("a scene");
    let told = scene
        .warnings
        .iter()
        .filter(|line| line.contains("have the same camera"));
    assert_eq!(told.count(), 1, "{:?}", scene.warnings);
    let bases: Vec<f64> = scene.pairs().iter().map(|pair| pair.base_to_height).collect();
    assert!(
        bases[0] < 1e-6 && bases[1..].iter().all(|base| (base - 0.206).abs() < 0.01),
        "{bases:?}"
    );
}

#[test]
fn equal_pixels_under_unlike_cameras_are_named() {
    let home = tempdir().expect("a temporary folder");
    let views = views();
    views.iter().for_each(|view| drop(view.write(home.path())));
    let named = || {
        let scene = open(home.path()).expect("a scene");
        let told = scene
            .findings
            .into_iter()
            .filter(|finding| finding.code == "same-pixels");
        told.map(|finding| finding.images).collect::<Vec<_>>()
    };
    assert!(named().is_empty());
    let [image, target] = ["view_1.tif", "view_2.tif"].map(|name| home.path().join(name));
    let camera: Vec<(String, String)> = write::gdal_domain(&views[2].rpc()).into_iter().collect();
    copy_with_rpc(&image, &target, &camera).expect("written");
    assert_eq!(named(), [["view_1", "view_2"]]);
    // Stretched, and a third of it lost.
    let file = RasterFile::open(&image).and_then(|file| file.read_all());
    let mut pixels = file.expect("pixels");
    let third = pixels.plane_len() / 3;
    for (index, value) in pixels.values.iter_mut().enumerate() {
        *value = if index < third {
            (index * 7919 % 997) as f32
        } else {
            (0.6 * *value + 40.0).round()
        };
    }
    let spec = ImageSpec {
        rpc: &camera,
        ..ImageSpec::plain(&pixels)
    };
    write_geotiff(&target, &spec, SampleType::U16).expect("written");
    assert_eq!(named(), [["view_1", "view_2"]]);
    // A third of the rows missing.
    for (index, value) in pixels.values.iter_mut().enumerate() {
        let row = index / pixels.width;
        *value = if row.is_multiple_of(3) { f32::NAN } else { *value };
    }
    let spec = ImageSpec {
        rpc: &camera,
        ..ImageSpec::plain(&pixels)
    };
    write_geotiff(&target, &spec, SampleType::F32).expect("written");
    assert_eq!(named(), [["view_1", "view_2"]]);
}

#[test]
fn an_image_of_which_much_is_clipped_is_named() {
    let home = tempdir().expect("a temporary folder");
    let views = views();
    views.iter().for_each(|view| drop(view.write(home.path())));
    let path = home.path().join("view_1.tif");
    let file = RasterFile::open(&path).and_then(|file| file.read_all());
    let mut pixels = file.expect("pixels");
    pixels.values.iter_mut().for_each(|value| *value = value.min(500.0));
    let camera: Vec<(String, String)> = write::gdal_domain(&views[1].rpc()).into_iter().collect();
    let spec = ImageSpec {
        rpc: &camera,
        ..ImageSpec::plain(&pixels)
    };
    write_geotiff(&path, &spec, SampleType::U16).expect("written");
    let findings = open(home.path()).expect("a scene").findings;
    let clipped: Vec<_> = findings.iter().filter(|finding| finding.code == "clipped").collect();
    assert_eq!(clipped.len(), 1, "{findings:?}");
    assert_eq!(clipped[0].images, ["view_1"]);
}

/// Finding codes and full output of `inspect` for a scene.
fn inspected(folder: &Path, more: &[&str]) -> (Vec<String>, Value) {
    let word = folder.display().to_string();
    let arguments: Vec<&str> = ["inspect", &word].into_iter().chain(more.iter().copied()).collect();
    let seen = json(&arguments);
    let findings = seen["findings"].as_array().expect("findings").iter();
    let codes = findings.map(|finding| finding["code"].as_str().expect("a code").to_owned());
    (codes.collect(), seen)
}

/// Three views with their cameras in the tag and their times in a JSON without a camera.
fn tagged(folder: &Path) -> Vec<View> {
    let views = views();
    for view in &views {
        let path = view.write(folder);
        let date = view.date.expect("a date");
        fs::remove_file(path.with_extension("json")).expect("removed");
        fs::write(
            folder.join(format!("{}_metadata.txt", view.name)),
            format!("Acquisition Date/Time: {date}\n"),
        )
        .expect("written");
    }
    views
}

/// Rewrites the image of a view with another tag, or with none, and where it lies on the map.
fn retag(path: &Path, rpc: Option<&Rpc>, georeference: Option<(&GeoTransform, &Crs)>, metadata: &[(String, String)]) {
    let raster = RasterFile::open(path).and_then(|file| file.read_all()).expect("pixels");
    let rpc: Vec<(String, String)> = rpc.map(write::gdal_domain).unwrap_or_default().into_iter().collect();
    let spec = ImageSpec {
        rpc: &rpc,
        georeference,
        metadata,
        ..ImageSpec::plain(&raster)
    };
    write_geotiff(path, &spec, SampleType::U16).expect("written");
}

/// A camera as an RPB of this specification.
fn rpb(rpc: &Rpc, specification: &str) -> String {
    let list = |values: &[f64; 20]| {
        let values: Vec<String> = values.iter().map(|value| format!("{value:.15E}")).collect();
        format!("(\n{})", values.join(",\n"))
    };
    let mut text = format!("satId = \"WV02\";\nSpecId = \"{specification}\";\nBEGIN_GROUP = IMAGE\n");
    for (name, value) in [
        ("lineOffset", rpc.line_offset),
        ("sampOffset", rpc.sample_offset),
        ("latOffset", rpc.latitude_offset_deg),
        ("longOffset", rpc.longitude_offset_deg),
        ("heightOffset", rpc.height_offset_m),
        ("lineScale", rpc.line_scale),
        ("sampScale", rpc.sample_scale),
        ("latScale", rpc.latitude_scale_deg),
        ("longScale", rpc.longitude_scale_deg),
        ("heightScale", rpc.height_scale_m),
    ] {
        text += &format!("\t{name} = {value:?};\n");
    }
    for (name, values) in [
        ("lineNumCoef", &rpc.line_numerator),
        ("lineDenCoef", &rpc.line_denominator),
        ("sampNumCoef", &rpc.sample_numerator),
        ("sampDenCoef", &rpc.sample_denominator),
    ] {
        text += &format!("\t{name} = {};\n", list(values));
    }
    text + "END_GROUP = IMAGE\nEND;\n"
}

/// The map frame of a view whose pixels lie `moved_px` east of where its camera says.
fn frame(view: &View, moved_px: f64) -> (GeoTransform, Crs) {
    let crs = Crs::from_epsg(32637).expect("UTM 37N");
    let rpc = view.rpc();
    let to_map = CrsTransform::from_lon_lat(&crs).expect("known");
    let (east, north) = to_map
        .apply(rpc.longitude_offset_deg, rpc.latitude_offset_deg)
        .expect("inside");
    let half_m = SIZE_PX as f64 / 2.0 * GSD_M;
    (
        GeoTransform::north_up(east - half_m + moved_px * GSD_M, north + half_m, GSD_M),
        crs,
    )
}

#[test]
fn images_on_a_map_are_refused_where_their_rpc_is_that_of_the_raw_image() {
    let home = tempdir().expect("a temporary folder");
    let word = home.path().display().to_string();
    let views = tagged(home.path());
    let path = |view: &View| home.path().join(format!("{}.tif", view.name));
    let map = |moved_px: f64| {
        for view in &views {
            let (transform, crs) = frame(view, moved_px);
            retag(&path(view), Some(&view.rpc()), Some((&transform, &crs)), &[]);
        }
    };
    // Of a map that turns by a degree against the north, the corners of 64 pixels are a pixel off.
    map(0.0);
    let (codes, _) = inspected(home.path(), &[]);
    assert_eq!(codes, [""; 0]);
    map(20.0);
    let out = home.path().join("out").display().to_string();
    let dsm = format!("{out}.tif");
    for arguments in [
        vec!["inspect", &word],
        vec!["dsm", &word, "--from", "sweep", "--out", &dsm],
        vec!["adjust", &word, "--out", &out],
        vec!["train", &word, "--out", &out],
    ] {
        let said = fault(&arguments, 2);
        for words in ["view_", "map-projected", "and 2 more images", "give the original image"] {
            assert!(said.contains(words), "{words} in {said}");
        }
    }
    // Frames of NITF headers are fitted to the corners of raw images: turned against the map, and far off.
    for view in &views {
        let (north_up, crs) = frame(view, 20.0);
        let mut six = north_up.to_gdal();
        (six[2], six[4]) = (0.01 * GSD_M, 0.01 * GSD_M);
        let turned = GeoTransform::from_gdal(six);
        retag(&path(view), Some(&view.rpc()), Some((&turned, &crs)), &[]);
    }
    let (codes, _) = inspected(home.path(), &[]);
    assert_eq!(codes, [""; 0]);
    let (transform, crs) = frame(&views[0], 0.0);
    retag(&path(&views[0]), None, Some((&transform, &crs)), &[]);
    let said = fault(&["inspect", &word], 2);
    assert!(
        said.contains("view_0.tif") && said.contains("map-projected") && !said.contains("beside"),
        "{said}"
    );
}

#[test]
fn the_tag_of_a_crop_counts_before_the_file_of_the_whole_image_and_a_choice_before_both() {
    let home = tempdir().expect("a temporary folder");
    let views = tagged(home.path());
    let camera = |view: &View, moved: [f64; 2]| Rpc {
        sample_offset: view.rpc().sample_offset + moved[0],
        line_offset: view.rpc().line_offset + moved[1],
        ..view.rpc()
    };
    for view in &views {
        let text = rpb(&camera(view, [20.0, 25.0]), "RPC00B");
        fs::write(home.path().join(format!("{}.RPB", view.name)), text).expect("written");
    }
    let source = |seen: &Value| seen["images"][0]["rpc_source"].as_str().expect("a source").to_owned();
    let (codes, seen) = inspected(home.path(), &[]);
    assert_eq!(
        (codes, source(&seen)),
        (vec!["two-cameras".to_owned()], "image".to_owned())
    );
    let finding = &seen["findings"][0];
    assert_eq!(finding["images"].as_array().map(Vec::len), Some(3), "{finding}");
    let apart_px = finding["value"].as_f64().expect("pixels");
    assert!((apart_px - 32.016).abs() < 0.01, "{apart_px}");
    let (_, chosen) = inspected(home.path(), &["--rpc", "sidecar"]);
    assert_eq!(source(&chosen), "view_0.RPB");
    // A crop never begins left of or above the whole image.
    fs::write(
        home.path().join("view_0.RPB"),
        rpb(&camera(&views[0], [5.0, -4.0]), "RPC00B"),
    )
    .expect("written");
    let (_, seen) = inspected(home.path(), &[]);
    assert_eq!(source(&seen), "view_0.RPB");
    // An adjusted text is moved by parts of a pixel: it counts before the raw tag.
    for view in &views {
        fs::remove_file(home.path().join(format!("{}.RPB", view.name))).expect("removed");
    }
    let text = write::rpc_txt(&camera(&views[0], [5.3, 4.1]));
    fs::write(home.path().join("view_0_RPC.TXT"), text).expect("written");
    let (codes, seen) = inspected(home.path(), &[]);
    assert_eq!(
        (codes, source(&seen)),
        (vec!["two-cameras".to_owned()], "view_0_RPC.TXT".to_owned())
    );
    let apart_px = seen["findings"][0]["value"].as_f64().expect("pixels");
    assert!((apart_px - 6.70).abs() < 0.01, "{apart_px}");
    let (_, chosen) = inspected(home.path(), &["--rpc", "tag"]);
    assert_eq!(source(&chosen), "image");
}

#[test]
fn cameras_of_other_ground_are_refused() {
    let home = tempdir().expect("a temporary folder");
    let views = tagged(home.path());
    let elsewhere = Rpc {
        longitude_offset_deg: -47.0,
        latitude_offset_deg: -22.9,
        ..views[1].rpc()
    };
    fs::write(home.path().join("view_1_RPC.TXT"), write::rpc_txt(&elsewhere)).expect("written");
    let word = home.path().display().to_string();
    let said = fault(&["inspect", &word], 2);
    assert!(
        said.contains("view_1.tif") && said.contains("see other ground") && said.contains("view_1_RPC.TXT"),
        "{said}"
    );
    let (codes, _) = inspected(home.path(), &["--rpc", "tag"]);
    assert_eq!(codes, ["two-cameras"]);
}

#[test]
fn images_of_two_places_are_refused_unless_an_area_chooses_one() {
    let home = tempdir().expect("a temporary folder");
    let views = tagged(home.path());
    for view in &views[..2] {
        let own = view.rpc();
        let moved = Rpc {
            longitude_offset_deg: own.longitude_offset_deg + 0.5,
            ..own
        };
        let there = home.path().join(format!("there_{}.tif", view.name));
        fs::copy(home.path().join(format!("{}.tif", view.name)), &there).expect("copied");
        retag(&there, Some(&moved), None, &[]);
    }
    let word = home.path().display().to_string();
    for line in ["inspect", "dsm --from sweep --out x.tif"] {
        let words: Vec<&str> = line.split(' ').chain([word.as_str()]).collect();
        let said = fault(&words, 2);
        assert!(said.contains("another place") && said.contains("44 km"), "{said}");
    }
    let (lon, lat) = (views[0].rpc().longitude_offset_deg, views[0].rpc().latitude_offset_deg);
    let area = [lon - 0.0002, lat - 0.0002, lon + 0.0002, lat + 0.0002].map(|value| value.to_string());
    let (_, seen) = inspected(home.path(), &["--area", &area.join(",")]);
    assert_eq!(seen["images"].as_array().map(Vec::len), Some(3), "{seen}");
}

#[test]
fn files_beside_images_are_read_by_our_own_readers() {
    let home = tempdir().expect("a temporary folder");
    let views = tagged(home.path());
    for view in &views {
        retag(&home.path().join(format!("{}.tif", view.name)), None, None, &[]);
    }
    let file = |number: usize, end: &str| home.path().join(format!("{}{end}", views[number].name));
    let order = [0, 1, 2, 3, 4, 5, 6, 10, 7, 8, 9, 11, 14, 17, 12, 15, 18, 13, 16, 19];
    let in_a = |of_b: [f64; 20]| order.map(|place| of_b[place]);
    // With a term that has another place in RPC00A.
    let mut curved = views[0].rpc();
    curved.line_numerator[7] = 0.01;
    let of_a = Rpc {
        line_numerator: in_a(curved.line_numerator),
        ..curved.clone()
    };
    fs::write(file(0, ".RPB"), rpb(&of_a, "RPC00A")).expect("written");
    let utf16: Vec<u8> = std::iter::once(0xfeff)
        .chain(write::rpc_txt(&views[1].rpc()).encode_utf16())
        .flat_map(u16::to_le_bytes)
        .collect();
    fs::write(file(1, "_RPC.TXT"), utf16).expect("written");
    fs::write(file(2, ".RPB"), rpb(&views[2].rpc(), "RPC00B").replace('.', ",")).expect("written");
    let scene = open(home.path()).expect("a scene");
    for (image, rpc) in scene.images.iter().zip([curved, views[1].rpc(), views[2].rpc()]) {
        assert!((image.rpc.line_offset - rpc.line_offset).abs() < 1e-6, "{}", image.name);
        assert_eq!(image.rpc.line_numerator, rpc.line_numerator, "{}", image.name);
    }
    // A camera file that lacks something is named, not its absence.
    let whole = write::rpc_txt(&views[1].rpc());
    let lacking: String = whole
        .split_inclusive('\n')
        .filter(|line| !line.starts_with("HEIGHT"))
        .collect();
    fs::write(file(1, "_RPC.TXT"), lacking).expect("written");
    let said = fault(&["inspect", &home.path().display().to_string()], 2);
    assert!(
        said.contains("view_1_RPC.TXT") && said.contains("HEIGHT_OFF is missing"),
        "{said}"
    );
}

#[test]
fn the_date_that_gdal_writes_into_every_nitf_is_no_time_and_no_sun_is_needed_for_a_sweep() {
    let home = tempdir().expect("a temporary folder");
    let views = tagged(home.path());
    for view in &views {
        fs::remove_file(home.path().join(format!("{}_metadata.txt", view.name))).expect("removed");
    }
    let dated = |of: &dyn Fn(usize) -> &'static str| {
        for (number, view) in views.iter().enumerate() {
            let items = [("NITF_IDATIM".to_owned(), of(number).to_owned())];
            retag(
                &home.path().join(format!("{}.tif", view.name)),
                Some(&view.rpc()),
                None,
                &items,
            );
        }
        let (codes, seen) = inspected(home.path(), &[]);
        let images = seen["images"].as_array().expect("images").clone();
        let times: Vec<Option<String>> = images
            .iter()
            .map(|image| image["time"].as_str().map(str::to_owned))
            .collect();
        (codes, times)
    };
    assert_eq!(dated(&|_| "20021216151629"), (vec![], vec![None, None, None]));
    // Images that look from different places are not of one second.
    assert_eq!(dated(&|_| "20160423083400"), (vec![], vec![None, None, None]));
    let passes = ["20160423083400", "20160501083500", "20160601083600"];
    let (codes, times) = dated(&|number| passes[number]);
    assert!(codes.is_empty() && times.iter().all(Option::is_some), "{times:?}");
    let nights = ["20160423203400", "20160501203500", "20160601203600"];
    let (codes, _) = dated(&|number| nights[number]);
    assert_eq!(codes, ["sun-below-horizon"]);
}

/// The same parallel camera with other scales: those of the ground `ground` times, those of the image `image` times as
/// large.
fn rescaled(rpc: &Rpc, ground: f64, image: f64) -> Rpc {
    let numerator = |values: &[f64; 20]| {
        std::array::from_fn(|term| values[term] / image * if (1..4).contains(&term) { ground } else { 1.0 })
    };
    Rpc {
        latitude_scale_deg: rpc.latitude_scale_deg * ground,
        longitude_scale_deg: rpc.longitude_scale_deg * ground,
        height_scale_m: rpc.height_scale_m * ground,
        line_scale: rpc.line_scale * image,
        sample_scale: rpc.sample_scale * image,
        line_numerator: numerator(&rpc.line_numerator),
        sample_numerator: numerator(&rpc.sample_numerator),
        ..rpc.clone()
    }
}

#[test]
fn equivalent_cameras_of_odd_scales_make_the_same_surface() {
    let home = tempdir().expect("a temporary folder");
    let views = tagged(home.path());
    let (word, out) = (home.path().display().to_string(), home.path().join("out"));
    fs::create_dir(&out).expect("made");
    let surface = |name: &str| {
        let path = out.join(name);
        let dsm = path.display().to_string();
        json(&["dsm", &word, "--from", "sweep", "--altitude", "690,720", "--out", &dsm]);
        let file = RasterFile::open(&path).expect("a surface");
        let raster = file.read_all().expect("values");
        raster.plane(0).to_vec()
    };
    let plain = surface("plain.tif");
    for (ground, image) in [(0.05, 1.0), (1.0, 1e5), (1e5, 1.0), (20.0, 0.05), (1e-3, 1e-3)] {
        for view in &views {
            let path = home.path().join(format!("{}.tif", view.name));
            retag(&path, Some(&rescaled(&view.rpc(), ground, image)), None, &[]);
        }
        let (codes, _) = inspected(home.path(), &["--altitude", "690,720"]);
        assert!(codes.is_empty(), "{codes:?}");
        let odd = surface("odd.tif");
        assert_eq!(odd.len(), plain.len(), "{ground} {image}");
        let apart = plain
            .iter()
            .zip(&odd)
            .filter(|(a, b)| a.is_nan() != b.is_nan() || (*a - *b).abs() > 1e-3);
        assert_eq!(apart.count(), 0, "{ground} {image}");
    }
}

#[test]
fn an_image_that_was_halved_without_its_rpc_is_named() {
    let home = tempdir().expect("a temporary folder");
    let views = tagged(home.path());
    let path = home.path().join("view_1.tif");
    let raster = RasterFile::open(&path)
        .and_then(|file| file.read_all())
        .expect("pixels");
    let rpc: Vec<(String, String)> = write::gdal_domain(&views[1].rpc()).into_iter().collect();
    let halved = raster.downscaled(2);
    let spec = ImageSpec {
        rpc: &rpc,
        ..ImageSpec::plain(&halved)
    };
    write_geotiff(&path, &spec, SampleType::U16).expect("written");
    let (codes, seen) = inspected(home.path(), &[]);
    assert_eq!(codes, ["rpc-of-another-size", "camera-contradicts-others"]);
    let finding = &seen["findings"][0];
    assert_eq!(finding["images"], serde_json::json!(["view_1"]));
    assert!(
        finding["message"]
            .as_str()
            .is_some_and(|line| line.contains("32 x 32 pixels") && line.contains("64 x 64"))
    );
}

#[test]
fn own_outputs_among_the_images_are_neither_truth_nor_images() {
    let home = tempdir().expect("a temporary folder");
    let views = tagged(home.path());
    let raster = Raster::filled(SIZE_PX, SIZE_PX, 1, 700.0);
    let (transform, crs) = frame(&views[0], 0.0);
    let write = |name: &str, software: Option<&str>| {
        let items: Vec<_> = software
            .map(|name| ("SOFTWARE".to_owned(), name.to_owned()))
            .into_iter()
            .collect();
        let spec = ImageSpec {
            georeference: Some((&transform, &crs)),
            metadata: &items,
            ..ImageSpec::plain(&raster)
        };
        write_geotiff(&home.path().join(name), &spec, SampleType::F32).expect("written");
    };
    for name in ["dsm.tif", "surface.tif"] {
        write(name, Some("heliosplat 0.1.0"));
    }
    let (_, seen) = inspected(home.path(), &[]);
    assert_eq!(seen["images"].as_array().map(Vec::len), Some(3));
    assert_eq!(seen["truth"]["dsm"], Value::Null);
    let told = seen["warnings"].as_array().expect("warnings").iter();
    let told = told.filter(|line| line.as_str().is_some_and(|line| line.contains("written by heliosplat")));
    assert_eq!(told.count(), 2, "{}", seen["warnings"]);
    fs::remove_file(home.path().join("surface.tif")).expect("removed");
    write("dsm.tif", None);
    let (_, seen) = inspected(home.path(), &[]);
    assert!(
        seen["truth"]["dsm"]
            .as_str()
            .is_some_and(|path| path.ends_with("dsm.tif"))
    );
}

#[test]
fn a_run_inside_of_a_delivery_is_no_scene() {
    let home = tempdir().expect("a temporary folder");
    // Without JSONs, whose folders are scenes of their own.
    let bare: Vec<View> = views().into_iter().map(|view| View { date: None, ..view }).collect();
    for view in &bare {
        let folder = home.path().join(&view.name);
        fs::create_dir(&folder).expect("made");
        view.write(&folder);
    }
    let run = home.path().join("run");
    fs::create_dir(&run).expect("made");
    fs::write(run.join("run.toml"), "").expect("written");
    for view in &bare {
        view.write(&run);
    }
    assert_eq!(open(home.path()).expect("a scene").images.len(), 3);
}

#[test]
fn masks_of_planet_are_masks_of_their_images() {
    let home = tempdir().expect("a temporary folder");
    // Neither clear nor snow; snow.
    let is_unusable = |col: usize, row: usize| row < SIZE_PX / 2 && col < SIZE_PX / 2;
    let is_snow = |col: usize, row: usize| row < SIZE_PX / 2 && col >= SIZE_PX / 2;
    for view in views() {
        let image = View {
            name: format!("{}_basic_panchromatic_dn", view.name),
            ..view.clone()
        };
        image.write(home.path());
        let mut mask = Raster::filled(SIZE_PX, SIZE_PX, 8, 1.0);
        for (index, (col, row)) in (0..SIZE_PX * SIZE_PX).map(|index| (index, (index % SIZE_PX, index / SIZE_PX))) {
            mask.plane_mut(0)[index] = if is_unusable(col, row) || is_snow(col, row) {
                0.0
            } else {
                1.0
            };
            mask.plane_mut(1)[index] = if is_snow(col, row) { 1.0 } else { 0.0 };
        }
        let path = home.path().join(format!("{}_basic_panchromatic_udm2.tif", view.name));
        write_geotiff(&path, &ImageSpec::plain(&mask), SampleType::U8).expect("written");
    }
    let index = Index::open(home.path(), RpcPreference::Json).expect("a delivery");
    assert_eq!(index.images.len(), 3);
    for (image, view) in index.images.iter().zip(views()) {
        let mask = image.usable_mask.as_ref().expect("a mask");
        assert!(
            mask.ends_with(format!("{}_basic_panchromatic_udm2.tif", view.name)),
            "{mask:?}"
        );
        assert!(index.files.contains(mask));
    }
    // Averaged down for tie points, a pixel is missing that any unusable one is part of.
    let cameras = SceneCameras::new(&index, &IngestOptions::default()).expect("cameras");
    let whole = Window {
        col0: 0,
        row0: 0,
        width: SIZE_PX,
        height: SIZE_PX,
    };
    let reduced = cameras.read_reduced(0, whole, 3).expect("pixels");
    for (col, row) in (0..reduced.height).flat_map(|row| (0..reduced.width).map(move |col| (col, row))) {
        let missing = reduced.at(0, col, row).is_nan();
        assert_eq!(missing, is_unusable(3 * col, 3 * row), "{col} {row}");
    }
    let scene = open(home.path()).expect("a scene");
    for image in &scene.images {
        let window = image.window;
        for (col, row) in (0..window.height).flat_map(|row| (0..window.width).map(move |col| (col, row))) {
            let missing = image.pixels.at(0, col, row).is_nan();
            assert_eq!(
                missing,
                is_unusable(col + window.col0, row + window.row0),
                "{col} {row}"
            );
        }
    }
    assert!(
        scene.warnings.iter().any(|warning| warning.contains("unusable")),
        "{:?}",
        scene.warnings
    );
}

/// Writes bands of a view, each with one value, as a file of its own.
fn write_bands(path: &Path, view: &View, values: &[f32]) {
    let mut raster = Raster::filled(SIZE_PX, SIZE_PX, values.len(), 0.0);
    for (band, value) in values.iter().enumerate() {
        raster.plane_mut(band).fill(*value);
    }
    // Two values, so that the scale of values is that of all bands.
    raster.values[0] = 700.0;
    let rpc: Vec<(String, String)> = write::gdal_domain(&view.rpc()).into_iter().collect();
    let spec = ImageSpec {
        rpc: &rpc,
        ..ImageSpec::plain(&raster)
    };
    write_geotiff(path, &spec, SampleType::U16).expect("written");
}

#[test]
fn files_of_the_bands_of_one_acquisition_are_one_image() {
    type Files = [(&'static str, &'static [f32])];
    let of_neo: &Files = &[
        ("RGB_R1C1", &[300.0, 200.0, 100.0]),
        ("NED_R1C1", &[400.0, 500.0, 600.0]),
    ];
    let of_geoeye: &Files = &[
        ("blu_0000000", &[100.0]),
        ("grn_0000000", &[200.0]),
        ("nir_0000000", &[400.0]),
        ("red_0000000", &[300.0]),
    ];
    for (files, nested) in [(of_neo, false), (of_neo, true), (of_geoeye, false)] {
        let home = tempdir().expect("a temporary folder");
        for view in views() {
            let folder = if nested {
                home.path().join(&view.name)
            } else {
                home.path().to_owned()
            };
            fs::create_dir_all(&folder).expect("made");
            for (end, values) in files {
                write_bands(&folder.join(format!("IMG_{}_{end}.tif", view.name)), &view, values);
            }
        }
        let scene = open(home.path()).expect("a scene");
        assert_eq!(scene.images.len(), 3);
        let bands: Vec<&str> = scene.bands().iter().map(|band| band.name()).collect();
        assert_eq!(bands, ["red", "green", "blue", "near_infrared"]);
        for image in &scene.images {
            let value = |band: usize| image.pixels.at(band, 30, 30);
            for (band, times) in [3.0, 2.0, 1.0, 4.0].into_iter().enumerate() {
                assert!((value(band) / value(2) - times).abs() < 1e-3, "{band}");
            }
        }
        let told = scene
            .warnings
            .iter()
            .filter(|line| line.contains("of the same acquisition"));
        assert_eq!(told.count(), 1, "{:?}", scene.warnings);
    }
}

#[cfg(unix)]
#[test]
fn a_name_that_is_not_utf8_is_said() {
    use std::os::unix::ffi::OsStrExt;
    let home = tempdir().expect("a temporary folder");
    for view in views() {
        view.write(home.path());
    }
    let latin1 = std::ffi::OsStr::from_bytes(b"for\xeat.tif");
    fs::rename(home.path().join("view_1.tif"), home.path().join(latin1)).expect("renamed");
    let said = fault(&["inspect", &home.path().display().to_string()], 2);
    assert!(
        said.contains("for") && said.contains("not UTF-8") && said.contains("rename"),
        "{said}"
    );
}

#[test]
fn an_image_that_fits_no_other_is_named_and_not_called_cloudy() {
    let home = tempdir().expect("a temporary folder");
    let scene = home.path().join("scene");
    tiny_scene(&scene);
    let word = scene.display().to_string();
    let seen = json(&["inspect", &word]);
    let image = &seen["images"][1];
    let path = PathBuf::from(image["path"].as_str().expect("a path"));
    let file = RasterFile::open(&path).expect("an image");
    let raster = file.read_all().expect("pixels").downscaled(2);
    let rpc: Vec<(String, String)> = file.domain("RPC").into_iter().collect();
    let bands: Vec<&str> = file.bands.iter().map(|band| band.description.as_str()).collect();
    let spec = ImageSpec {
        rpc: &rpc,
        band_descriptions: &bands,
        ..ImageSpec::plain(&raster)
    };
    write_geotiff(&path, &spec, SampleType::U16).expect("written");
    let name = image["name"].as_str().expect("a name");
    let out = home.path().join("dsm.tif").display().to_string();
    let output = heliosplat(&["dsm", &word, "--from", "sweep", "--out", &out])
        .assert()
        .success();
    let said = String::from_utf8_lossy(&output.get_output().stderr).into_owned();
    let told: Vec<&str> = said
        .lines()
        .filter(|line| line.contains("its camera contradicts the others"))
        .collect();
    assert!(
        told.len() == 1 && told[0].contains(name) && told[0].contains("left out"),
        "{said}"
    );
    assert!(!said.contains(&format!("{name}: clouds over")), "{said}");
    let (codes, seen) = inspected(&scene, &[]);
    let finding = seen["findings"].as_array().expect("findings").iter();
    let mut finding = finding.filter(|finding| finding["code"] == "camera-contradicts-others");
    assert_eq!(
        finding.next().map(|finding| &finding["images"]),
        Some(&serde_json::json!([name])),
        "{codes:?}"
    );
    assert!(finding.next().is_none());
}

/// The image is one of those of `synth satellite --site block --seed 5 --views 4` that are trained on.
#[test]
fn a_mirrored_camera_is_left_out_of_tiles_and_batches_too() {
    let home = tempdir().expect("a temporary folder");
    let scene = home.path().join("scene");
    let word = scene.display().to_string();
    let words = "synth satellite --site block --seed 5 --views 4 --out";
    json(&words.split(' ').chain([word.as_str()]).collect::<Vec<_>>());
    let path = scene.join("block_005_02.json");
    let mut said: Value = serde_json::from_slice(&fs::read(&path).expect("text")).expect("JSON");
    let last = said["width"].as_f64().expect("a width") - 1.0;
    let offset = said["rpc"]["col_offset"].as_f64().expect("an offset");
    said["rpc"]["col_offset"] = (last - offset).into();
    for coefficient in said["rpc"]["col_num"].as_array_mut().expect("coefficients") {
        *coefficient = (-coefficient.as_f64().expect("a number")).into();
    }
    fs::write(&path, said.to_string()).expect("written");
    let out = home.path().join("dsm.tif").display().to_string();
    let output = heliosplat(&["dsm", &word, "--from", "sweep", "--memory", "300MB", "--out", &out])
        .assert()
        .success();
    let said = String::from_utf8_lossy(&output.get_output().stderr).into_owned();
    let left_out = said.lines().filter(|line| line.contains("is left out"));
    let named: Vec<&str> = left_out.filter(|line| line.contains("block_005_02")).collect();
    assert!(named.len() == 1 && said.contains(" tiles ("), "{said}");
    let manifest = home.path().join("batch.toml");
    let text = "[tiles]\nside_m = 80.0\n[[images]]\nname = \"a\"\nscene = \"scene\"\n[[presets]]\nname = \"sweep\"\n";
    fs::write(&manifest, text).expect("written");
    let out = home.path().join("out").display().to_string();
    let done = json(&["batch", &manifest.display().to_string(), "--out", &out]);
    assert!(done["failed"] == 0 && done["done"].as_u64() >= Some(4), "{done}");
    let units = done["units"].as_array().expect("units");
    let adjusted = units.iter().find(|unit| unit["kind"] == "adjust").expect("cameras");
    assert_eq!(adjusted["metrics"]["left_out"], serde_json::json!(["block_005_02"]));
}

/// Four like views: ties are found between swapped cameras too, and only their residual shows the contradiction.
#[test]
fn swapped_cameras_of_like_views_are_warned_of_by_the_residual_of_their_ties() {
    let home = tempdir().expect("a temporary folder");
    let scene = home.path().join("scene");
    let word = scene.display().to_string();
    let words = "synth satellite --site tiny --seed 5 --views 4 --out";
    json(&words.split(' ').chain([word.as_str()]).collect::<Vec<_>>());
    let out = home.path().join("dsm.tif").display().to_string();
    let is_warned = || {
        let arguments = ["dsm", &word, "--from", "sweep", "--rpc", "json", "--out", &out];
        let output = heliosplat(&arguments).assert().success();
        String::from_utf8_lossy(&output.get_output().stderr).contains("check that each image has its own camera")
    };
    assert!(!is_warned());
    let [first, second] = ["00", "03"].map(|number| scene.join(format!("tiny_005_{number}.json")));
    let read = |path: &Path| -> Value { serde_json::from_slice(&fs::read(path).expect("text")).expect("JSON") };
    let [mut a, mut b] = [read(&first), read(&second)];
    std::mem::swap(&mut a["rpc"], &mut b["rpc"]);
    fs::write(&first, a.to_string()).expect("written");
    fs::write(&second, b.to_string()).expect("written");
    assert!(is_warned());
}

#[test]
fn a_database_of_proj_that_is_not_there_is_said_by_inspect() {
    let home = tempdir().expect("a temporary folder");
    tagged(home.path());
    let elsewhere = home.path().join("elsewhere");
    let output = heliosplat(&["inspect".as_ref(), home.path().as_os_str()])
        .env("PROJ_LIB", &elsewhere)
        .env("PROJ_DATA", &elsewhere)
        .assert()
        .code(2);
    let said = String::from_utf8_lossy(&output.get_output().stderr).into_owned();
    assert!(said.contains("unset PROJ_LIB and PROJ_DATA"), "{said}");
}
