//! Images as vendors pack them: panchromatic and multispectral files of one acquisition, images cut into tiles, gains, stretches to eight
//! bits, and images of several resolutions.

use heliosplat::Raster;
use heliosplat_raster::{ImageSpec, RasterFile, Sample, Window, write_geotiff};
use heliosplat_rpc::read::gdal_domain;
use heliosplat_rpc::{Rpc, write};
use heliosplat_scene::{IngestOptions, Scene, SceneError, ValueKind, Values};
use heliosplat_tests::program::{fault, json};
use heliosplat_tests::scenes::{SIZE_PX, View};
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
    write_geotiff(path, &spec, Sample::U16).expect("written");
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

/// Writes a view in four uneven tiles, whose names `name` makes of row and column, and whole into another folder; the first tile has the
/// camera of all, and the JSON is its.
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
            write_geotiff(&home.join(name), &spec, Sample::U16).expect("written");
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
    // All bands have equal counts: near infrared reflects more than twice what red does, for there is less of it in sunlight.
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
    write_geotiff(path, &spec, Sample::U8).expect("written");
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
    write_geotiff(path, &spec, Sample::U16).expect("written");
    let json = path.with_extension("json");
    let mut said: Value = serde_json::from_slice(&fs::read(&json).expect("text")).expect("JSON");
    said["rpc"] = write::satnerf_json_rpc(&rpc);
    said["width"] = raster.width.into();
    said["height"] = raster.height.into();
    fs::write(&json, said.to_string()).expect("written");
}

/// How many times the error of the surface swept from fine images alone that of a scene may be of which half of the images are twice as
/// coarse (docs/lab/deliveries.md).
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
