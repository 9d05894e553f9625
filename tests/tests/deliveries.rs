//! Images as vendors pack them: panchromatic and multispectral files of one acquisition, and images cut into tiles.

use heliosplat::Raster;
use heliosplat_raster::{ImageSpec, RasterFile, Sample, Window, write_geotiff};
use heliosplat_rpc::{Rpc, write};
use heliosplat_scene::{IngestOptions, Scene, SceneError};
use heliosplat_tests::scenes::{SIZE_PX, View};
use std::fs;
use std::path::Path;
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

#[test]
fn tiles_of_an_image_are_read_as_one() {
    let home = tempdir().expect("a temporary folder");
    let whole = tempdir().expect("a temporary folder");
    for view in views() {
        view.write(whole.path());
        let path = view.write(home.path());
        let file = RasterFile::open(&path).expect("an image");
        let rpc: Vec<(String, String)> = file.domain("RPC").into_iter().collect();
        // Cut unevenly.
        for (row, (row0, height)) in [(0, 40), (40, SIZE_PX - 40)].into_iter().enumerate() {
            for (col, (col0, width)) in [(0, 24), (24, SIZE_PX - 24)].into_iter().enumerate() {
                let window = Window {
                    col0,
                    row0,
                    width,
                    height,
                };
                let pixels = file.read(window, &[0]).expect("pixels");
                let spec = ImageSpec {
                    // The camera of the product stands in its first tile.
                    rpc: if row + col == 0 { &rpc } else { &[] },
                    ..ImageSpec::plain(&pixels)
                };
                let name = format!("{}_R{}C{}.tif", view.name, row + 1, col + 1);
                write_geotiff(&home.path().join(name), &spec, Sample::U16).expect("written");
            }
        }
        fs::remove_file(&path).expect("removed");
        let json = fs::read_to_string(path.with_extension("json")).expect("text");
        fs::remove_file(path.with_extension("json")).expect("removed");
        let tile = format!("{}_R1C1", view.name);
        let json = json.replace(&format!("{}.tif", view.name), &format!("{tile}.tif"));
        fs::write(home.path().join(format!("{tile}.json")), json).expect("written");
    }
    let (tiled, whole) = (
        open(home.path()).expect("a scene"),
        open(whole.path()).expect("a scene"),
    );
    assert_eq!(tiled.images.len(), 3);
    for (tiled, whole) in tiled.images.iter().zip(&whole.images) {
        assert_eq!(tiled.pixels, whole.pixels);
        assert_eq!(tiled.rpc, whole.rpc);
    }
    fs::remove_file(home.path().join("view_1_R2C1.tif")).expect("removed");
    let error = open(home.path()).expect_err("a tile is gone").to_string();
    assert!(error.contains("R2C1") && error.contains("view_1"), "{error}");
}
