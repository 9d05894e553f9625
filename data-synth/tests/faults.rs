//! Faults of real images have their effect, change nothing else, and are in the manifest.

use heliosplat_synth::{BandSet, Cover, Fault, SatelliteRequest, Site, Summary, write_satellite};
use std::fs;
use std::path::Path;
use tempfile::TempDir;
use tiff::decoder::{Decoder, DecodingResult};
use tiff::tags::Tag;

/// GDAL's metadata items.
const ITEMS: Tag = Tag::Unknown(42_112);
const BANDS: usize = 3;

fn small(faults: &[Fault], cover: Option<Cover>) -> SatelliteRequest {
    SatelliteRequest {
        site: Site::Tiny,
        seed: 4,
        views: Some(4),
        dates: Some(2),
        gsd_m: Some(1.0),
        bands: BandSet::Rgb,
        noise: 0.0,
        faults: faults.iter().copied().collect(),
        cover,
        ..Default::default()
    }
}

/// A scene in a folder of its own.
struct Made {
    folder: TempDir,
    summary: Summary,
}

impl Made {
    fn new(request: &SatelliteRequest) -> Self {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let summary = write_satellite(request, folder.path(), &|_, _| {}).expect("a scene");
        Self { folder, summary }
    }

    fn path(&self, name: &str) -> std::path::PathBuf {
        self.folder.path().join(name)
    }

    fn bytes(&self, name: &str) -> Vec<u8> {
        fs::read(self.path(name)).expect("file")
    }

    fn raster(&self, name: &str) -> Vec<f64> {
        samples(&self.path(name))
    }

    /// All images, one after the other, bands interleaved.
    fn images(&self) -> Vec<Vec<f64>> {
        (self.summary.images.iter())
            .map(|image| self.raster(&format!("{}.tif", image.name)))
            .collect()
    }

    fn shadow(&self, index: usize) -> Vec<f64> {
        self.raster(&format!("truth/shadow_{}.tif", self.summary.images[index].name))
    }

    fn manifest(&self) -> String {
        String::from_utf8(self.bytes("truth/summary.json")).expect("UTF-8")
    }
}

fn samples(path: &Path) -> Vec<f64> {
    let mut decoder = Decoder::new(fs::File::open(path).expect("file")).expect("a TIFF");
    match decoder.read_image().expect("samples") {
        DecodingResult::U8(values) => values.into_iter().map(f64::from).collect(),
        DecodingResult::U16(values) => values.into_iter().map(f64::from).collect(),
        DecodingResult::F32(values) => values.into_iter().map(f64::from).collect(),
        _ => panic!("samples of an unknown kind"),
    }
}

fn band(image: &[f64], band: usize) -> impl Iterator<Item = f64> {
    image.iter().skip(band).step_by(BANDS).copied()
}

fn mean(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = values.fold((0.0, 0usize), |(sum, count), value| (sum + value, count + 1));
    sum / count.max(1) as f64
}

#[test]
fn gains_of_bands_multiply_the_counts_and_stand_in_the_manifest() {
    let (plain, faulty) = (
        Made::new(&small(&[], None)),
        Made::new(&small(&[Fault::BandGains], None)),
    );
    assert!(plain.summary.images.iter().all(|image| image.band_gains.is_empty()));
    for ((before, after), image) in plain.images().iter().zip(faulty.images()).zip(&faulty.summary.images) {
        assert_eq!(image.band_gains.len(), BANDS);
        for (index, (x, y)) in before.iter().zip(&after).enumerate() {
            let expected = image.band_gains[index % BANDS] * x;
            // Both are rounded.
            assert!(
                (y - expected.min(2047.0)).abs() < 1.6 || *x >= 2047.0,
                "{x} {y} {expected}"
            );
        }
    }
    for name in ["dsm", "classes", "albedo"] {
        let name = format!("truth/{name}.tif");
        assert!(plain.bytes(&name) == faulty.bytes(&name), "{name}");
    }
    assert!(!plain.manifest().contains("faults") && faulty.manifest().contains("band-gains"));
}

#[test]
fn haze_brightens_shadows_most_in_blue_lowers_contrast_and_differs_from_date_to_date() {
    let (clear, hazy) = (Made::new(&small(&[], None)), Made::new(&small(&[Fault::Haze], None)));
    let (before, after) = (clear.images(), hazy.images());
    for (index, image) in hazy.summary.images.iter().enumerate() {
        let shadow = hazy.shadow(index);
        assert_eq!(shadow, clear.shadow(index), "where the sun reaches is as it was");
        let in_shade = |image: &[f64], which: usize| {
            mean(
                band(image, which)
                    .zip(&shadow)
                    .filter(|(_, s)| **s == 1.0)
                    .map(|(v, _)| v),
            )
        };
        let in_sun = |image: &[f64], which: usize| {
            mean(
                band(image, which)
                    .zip(&shadow)
                    .filter(|(_, s)| **s == 0.0)
                    .map(|(v, _)| v),
            )
        };
        let haze = image.haze.expect("haze");
        assert!((0.05..0.6).contains(&haze.depth));
        for which in 0..3 {
            let contrast = |image: &[f64]| in_sun(image, which) / in_shade(image, which);
            assert!(contrast(&after[index]) < contrast(&before[index]));
        }
        let gain = |which: usize| in_shade(&after[index], which) / in_shade(&before[index], which);
        let rise = |which: usize| in_shade(&after[index], which) - in_shade(&before[index], which);
        assert!(
            rise(2) > rise(0) && rise(0) > rise(3),
            "{} {} {}",
            rise(2),
            rise(0),
            rise(3)
        );
        assert!(gain(0) > 1.0);
    }
    let of_date = |date: usize| hazy.summary.images.iter().find(|image| image.date == date);
    assert_ne!(
        of_date(0).and_then(|image| image.haze),
        of_date(1).and_then(|image| image.haze)
    );
}

#[test]
fn light_between_surfaces_changes_shadows_more_than_sunlit_ground_and_no_truth() {
    let (plain, faulty) = (
        Made::new(&small(&[], None)),
        Made::new(&small(&[Fault::Interreflection], None)),
    );
    let change = |lit: f64| {
        let images = plain.images().into_iter().zip(faulty.images()).enumerate();
        mean(images.flat_map(|(index, (before, after))| {
            let shadow = plain.shadow(index);
            let pairs: Vec<f64> = (band(&before, 0).zip(band(&after, 0)).zip(shadow))
                .filter(|(_, shadow)| *shadow == 1.0 - lit)
                .map(|((x, y), _)| ((y - x) / x).abs())
                .collect();
            pairs
        }))
    };
    let (in_shade, in_sun) = (change(0.0), change(1.0));
    assert!(in_shade > 1.5 * in_sun && in_shade > 0.01, "{in_shade} {in_sun}");
    for name in ["dsm", "classes", "albedo"] {
        let name = format!("truth/{name}.tif");
        assert!(plain.bytes(&name) == faulty.bytes(&name), "{name}");
    }
}

#[test]
fn glossy_surfaces_have_a_mask_and_leave_heights_and_classes_as_they_are() {
    let request = |faults: &[Fault]| SatelliteRequest {
        site: Site::Block,
        views: Some(1),
        gsd_m: Some(2.0),
        ..small(faults, None)
    };
    let (plain, glossy) = (Made::new(&request(&[])), Made::new(&request(&[Fault::Glossy])));
    assert_eq!(plain.summary.glossy_share, 0.0);
    assert!(!plain.path("truth/glossy.tif").exists());
    let mask = glossy.raster("truth/glossy.tif");
    let share = mean(mask.iter().copied());
    assert!((share - glossy.summary.glossy_share).abs() < 1e-12);
    assert!((0.005..0.3).contains(&share), "{share}");
    for name in ["dsm", "classes"] {
        let name = format!("truth/{name}.tif");
        assert!(plain.bytes(&name) == glossy.bytes(&name), "{name}");
    }
    let classes = glossy.raster("truth/classes.tif");
    let only_roofs = mask
        .iter()
        .zip(&classes)
        .all(|(&glossy, &class)| glossy == 0.0 || class == 6.0);
    assert!(only_roofs, "no cars in the truth, and water has its own mirror");
    let (before, after) = (plain.images().concat(), glossy.images().concat());
    let moved = mean((before.iter().zip(&after)).map(|(x, y)| f64::from((x - y).abs() > 20.0)));
    assert!((0.002..0.3).contains(&moved), "{moved}");
}

#[test]
fn large_clouds_hide_a_third_of_a_quarter_of_the_images_to_train_with_unless_a_number_is_given() {
    let cloudy = |clouds: usize| -> Vec<f64> {
        let request = SatelliteRequest {
            clouds,
            ..small(&[Fault::LargeClouds], None)
        };
        let images = Made::new(&request).summary.images;
        (images.iter().map(|image| image.cloud_share))
            .filter(|&share| share > 0.0)
            .collect()
    };
    for (clouds, expected) in [(0, 1), (2, 2)] {
        let shares = cloudy(clouds);
        assert_eq!(shares.len(), expected);
        assert!(shares.iter().all(|share| (0.25..0.45).contains(share)), "{shares:?}");
    }
}

#[test]
fn stretched_images_have_eight_bits_both_ends_clipped_and_say_nothing_of_their_scale() {
    let (plain, display) = (Made::new(&small(&[], None)), Made::new(&small(&[Fault::Stretch], None)));
    for (index, (linear, shown)) in plain.images().iter().zip(display.images()).enumerate() {
        let image = &display.summary.images[index];
        let stretch = image.stretch.as_ref().expect("a stretch");
        for (x, y) in linear.iter().zip(&shown).skip(1).step_by(BANDS) {
            let share = ((x - stretch.low[1]) / (stretch.high[1] - stretch.low[1])).clamp(0.0, 1.0);
            let expected = (255.0 * share.powf(1.0 / stretch.gamma)).max(1.0);
            assert!((y - expected).abs() <= 0.5, "{x} {y} {expected}");
        }
        let at = |value: f64| shown.iter().filter(|&&count| count == value).count() as f64 / shown.len() as f64;
        assert!(at(255.0) > 0.004 && at(1.0) > 0.004);
        let path = display.path(&format!("{}.tif", image.name));
        let mut decoder = Decoder::new(fs::File::open(path).expect("file")).expect("a TIFF");
        let items = decoder.get_tag_ascii_string(ITEMS).expect("items");
        assert!(
            items.contains("ACQUISITIONDATETIME") && !items.contains("RADIOMETRY"),
            "{items}"
        );
    }
    let gammas: Vec<f64> = (display.summary.images.iter().flat_map(|image| &image.stretch))
        .map(|stretch| stretch.gamma)
        .collect();
    assert!(gammas.windows(2).all(|pair| pair[0] != pair[1]), "each image its own");
}

#[test]
fn half_of_the_area_is_a_level_sea_and_the_land_alone_is_the_same_land() {
    let (sea, land) = (
        Made::new(&small(&[], Some(Cover::Sea))),
        Made::new(&small(&[], Some(Cover::Nodata))),
    );
    let (heights, classes) = (sea.raster("truth/dsm.tif"), sea.raster("truth/classes.tif"));
    let cover = sea.raster("truth/cover.tif");
    assert!((0.45..0.60).contains(&sea.summary.cover_share));
    let levels: Vec<f64> = (heights.iter().zip(&cover))
        .filter(|(_, cover)| **cover == 1.0)
        .map(|(height, _)| *height)
        .collect();
    assert!(
        levels.iter().all(|level| (level - levels[0]).abs() < 0.01),
        "one altitude"
    );
    assert!(
        heights.iter().all(|height| *height > levels[0] - 0.01),
        "nothing lies lower"
    );
    assert!((classes.iter().zip(&cover)).all(|(&class, &cover)| cover == 0.0 || class == 9.0));
    let bare = sea.raster("truth/dsm_uncovered.tif");
    let land_cells = bare.iter().filter(|&&height| height != -9999.0).count() as f64 / bare.len() as f64;
    assert!((0.25..0.5).contains(&land_cells), "{land_cells}");
    for ((bare, height), cover) in bare.iter().zip(&heights).zip(&cover) {
        assert!(*bare == -9999.0 || (bare == height && *cover == 0.0));
    }
    for name in ["dsm", "dsm_uncovered", "classes", "albedo", "cover"] {
        let name = format!("truth/{name}.tif");
        assert!(sea.bytes(&name) == land.bytes(&name), "{name}");
    }
    for (with, without) in sea.images().iter().zip(land.images()) {
        let pixels = with.chunks(BANDS).zip(without.chunks(BANDS));
        let missing = pixels
            .clone()
            .filter(|(_, pixel)| pixel.iter().all(|&count| count == 0.0));
        let share = missing.count() as f64 / (with.len() / BANDS) as f64;
        assert!((0.35..0.65).contains(&share), "{share}");
        assert!(
            pixels
                .clone()
                .all(|(a, b)| b.iter().all(|&count| count == 0.0) || a == b)
        );
    }
}

#[test]
fn half_of_the_area_is_snow_that_is_bright_even_and_clipped_and_changes_no_height() {
    let (bare, snow) = (Made::new(&small(&[], None)), Made::new(&small(&[], Some(Cover::Snow))));
    for name in ["dsm", "classes"] {
        let name = format!("truth/{name}.tif");
        assert!(bare.bytes(&name) == snow.bytes(&name), "{name}");
    }
    let (cover, classes) = (snow.raster("truth/cover.tif"), snow.raster("truth/classes.tif"));
    let albedo = snow.raster("truth/albedo.tif");
    let roads: Vec<f64> = (band(&albedo, 0).zip(&cover).zip(&classes))
        .filter(|((_, cover), class)| **cover == 1.0 && **class == 11.0)
        .map(|((albedo, _), _)| albedo)
        .collect();
    let level = mean(roads.iter().copied());
    let spread = mean(roads.iter().map(|albedo| (albedo - level).powi(2))).sqrt();
    assert!(level > 0.8 && spread < 0.12, "{level} {spread}");
    for (before, after) in bare.images().iter().zip(snow.images()) {
        let clipped = |image: &[f64]| mean(band(image, 0).map(|count| f64::from(count >= 2047.0)));
        assert!(
            clipped(&after) > clipped(before) + 0.1,
            "{} {}",
            clipped(&after),
            clipped(before)
        );
    }
}
