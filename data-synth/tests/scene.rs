//! Properties of a whole scene: the same bytes for the same request, consistent files, hidden truth, and refusals in
//! one line.

use heliosplat_rpc::{GeoPoint, ImagePoint};
use heliosplat_synth::{BandSet, SatelliteRequest, Site, Summary, SynthError, write_satellite};
use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use tiff::decoder::{Decoder, DecodingResult};
use tiff::tags::Tag;

fn small() -> SatelliteRequest {
    SatelliteRequest {
        site: Site::Tiny,
        seed: 4,
        views: Some(3),
        dates: Some(2),
        gsd_m: Some(1.0),
        ..Default::default()
    }
}

fn make(request: &SatelliteRequest, out: &Path) -> Summary {
    write_satellite(request, out, &|_, _| {}).expect("a scene")
}

fn bytes_of(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut files = BTreeMap::new();
    for entry in fs::read_dir(folder).expect("folder") {
        let path = entry.expect("entry").path();
        let name = path.file_name().expect("name").to_string_lossy().into_owned();
        if path.is_dir() {
            files.extend(
                bytes_of(&path)
                    .into_iter()
                    .map(|(inner, bytes)| (format!("{name}/{inner}"), bytes)),
            );
        } else {
            files.insert(name, fs::read(&path).expect("file"));
        }
    }
    files
}

fn open(path: &Path) -> Decoder<fs::File> {
    Decoder::new(fs::File::open(path).expect("file")).expect("a TIFF")
}

#[test]
fn the_same_request_gives_the_same_bytes_for_any_number_of_threads() {
    let with_threads = |threads: usize| {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .expect("threads");
        pool.install(|| make(&small(), folder.path()));
        bytes_of(folder.path())
    };
    let (one, three) = (with_threads(1), with_threads(3));
    assert!(one.len() == 3 * 3 + 8, "{:?}", one.keys());
    assert_eq!(one.keys().collect::<Vec<_>>(), three.keys().collect::<Vec<_>>());
    for (name, bytes) in &one {
        assert!(*bytes == three[name], "{name} differs between 1 and 3 threads");
    }
}

#[test]
fn houses_that_change_do_so_in_truth_on_a_day_that_two_images_lie_on_either_side_of() {
    let request = SatelliteRequest {
        views: Some(4),
        change: 1.0,
        ..small()
    };
    let folder = tempfile::tempdir().expect("folder");
    let refused = write_satellite(
        &SatelliteRequest {
            dates: Some(1),
            ..request.clone()
        },
        folder.path(),
        &|_, _| {},
    );
    assert!(
        matches!(refused, Err(SynthError::BadRequest(_))),
        "one date has no before"
    );
    let folder = tempfile::tempdir().expect("folder");
    let summary = make(
        &SatelliteRequest {
            views: Some(6),
            ..request
        },
        folder.path(),
    );
    let floats = |name: &str| match open(&folder.path().join("truth").join(name)).read_image() {
        Ok(DecodingResult::F32(values)) => values.into_iter().map(f64::from).collect::<Vec<_>>(),
        Ok(DecodingResult::F64(values)) => values,
        _ => panic!("{name} holds floats"),
    };
    let (before, after, change) = (floats("dsm_before.tif"), floats("dsm.tif"), floats("change.tif"));
    let cells = before.len();
    assert_eq!(change.len(), 2 * cells);
    let time = summary
        .images
        .iter()
        .find(|image| image.date == 1)
        .map(|image| image.time);
    let day = time.map(|time| time.strftime("%Y%m%d").to_string().parse::<f64>().expect("a number"));
    let mut changed = 0;
    for cell in 0..cells {
        let [difference_m, changed_at] = [change[2 * cell], change[2 * cell + 1]];
        assert!((after[cell] - before[cell] - difference_m).abs() < 1e-3);
        assert!(
            changed_at == 0.0 || Some(changed_at) == day,
            "{changed_at} is the day of the second date"
        );
        if difference_m.abs() > 2.0 {
            assert!(changed_at > 0.0, "what changes has a day");
            changed += 1;
        }
    }
    assert!(changed > 30, "{changed} cells of a square metre");
}

#[test]
fn suns_of_no_image_add_truth_and_change_nothing_else() {
    let (a, b) = (
        tempfile::tempdir().expect("folder"),
        tempfile::tempdir().expect("folder"),
    );
    make(&small(), a.path());
    let relight = SatelliteRequest { relight: 3, ..small() };
    let summary = make(&relight, b.path());
    let (without, with) = (bytes_of(a.path()), bytes_of(b.path()));
    for (name, bytes) in &without {
        assert!(
            name == "truth/summary.json" || *bytes == with[name],
            "{name} has changed"
        );
    }
    assert_eq!(with.len(), without.len() + 3 * 2 + 2);
    let list: Vec<serde_json::Value> = serde_json::from_slice(&with["truth/relit.json"]).expect("a list");
    let mut seen: Vec<(f64, f64, f64)> = (list.iter().enumerate())
        .map(|(number, sun)| {
            let Ok(DecodingResult::U16(counts)) =
                open(&b.path().join(format!("truth/relit_{number}.tif"))).read_image()
            else {
                panic!("counts of 16 bits");
            };
            let mask = open(&b.path().join(format!("truth/relit_{number}_shadow.tif"))).read_image();
            let Ok(DecodingResult::U8(mask)) = mask else {
                panic!("a mask of 8 bits");
            };
            // The decoder gives colours only; near infrared is a fourth sample.
            let cells = summary.grid.size.pow(2);
            assert_eq!((counts.len(), mask.len()), (3 * cells, cells));
            let mean = counts.iter().map(|&count| f64::from(count)).sum::<f64>() / counts.len() as f64;
            let dark = mask.iter().map(|&shadow| f64::from(shadow)).sum::<f64>() / mask.len() as f64;
            (sun["sun_elevation_deg"].as_f64().expect("an angle"), mean, dark)
        })
        .collect();
    seen.sort_by(|x, y| x.0.total_cmp(&y.0));
    assert_eq!(seen.iter().map(|sun| sun.0).collect::<Vec<_>>(), [10.0, 40.0, 70.0]);
    assert!(
        seen[0].1 < 0.7 * seen[1].1 && seen[1].1 < seen[2].1,
        "brighter with the sun's height: {seen:?}"
    );
    assert!(
        seen[0].2 > seen[1].2 && seen[1].2 > seen[2].2,
        "and less in shadow: {seen:?}"
    );
    let Ok(DecodingResult::F32(hours)) = open(&b.path().join("truth/sun_hours.tif")).read_image() else {
        panic!("hours as floats");
    };
    assert!(hours.iter().all(|hours| (0.0..=12.4).contains(hours)) && hours.iter().any(|hours| *hours > 6.0));
}

#[test]
fn another_seed_gives_another_scene() {
    let (a, b) = (
        tempfile::tempdir().expect("folder"),
        tempfile::tempdir().expect("folder"),
    );
    let first = make(
        &SatelliteRequest {
            views: Some(1),
            ..small()
        },
        a.path(),
    );
    let second = make(
        &SatelliteRequest {
            views: Some(1),
            seed: 5,
            ..small()
        },
        b.path(),
    );
    assert_ne!(first.origin, second.origin);
    let dsm = |folder: &Path| fs::read(folder.join("truth/dsm.tif")).expect("file");
    assert!(dsm(a.path()) != dsm(b.path()));
}

#[test]
fn the_tag_and_the_json_of_an_image_hold_the_same_camera_and_it_covers_the_site_at_all_altitudes() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let summary = make(&small(), folder.path());
    let [low_m, high_m] = summary.altitude_range_m;
    for image in &summary.images {
        let path = folder.path().join(format!("{}.tif", image.name));
        let tag = open(&path).get_tag_f64_vec(Tag::Unknown(50_844)).expect("RPC tag");
        let json = fs::read_to_string(path.with_extension("json")).expect("file");
        let rpc = heliosplat_rpc::read::satnerf_json(&json).expect("camera");
        assert_eq!(tag, heliosplat_rpc::write::geotiff_tag(&rpc));
        let grid = summary.grid;
        let far = grid.size as f64 * grid.cell_m;
        for (east, north) in [(0.0, 0.0), (far, 0.0), (0.0, -far), (far, -far)] {
            for height_m in [low_m, high_m] {
                let [lon_deg, lat_deg] = grid.zone.unproject(grid.west_m + east, grid.north_m + north);
                let ImagePoint { col, row } = rpc.project(GeoPoint::new(lon_deg, lat_deg, height_m));
                let inside =
                    (0.0..image.size_px[0] as f64).contains(&col) && (0.0..image.size_px[1] as f64).contains(&row);
                assert!(inside, "{}: ({col}, {row}) of {:?}", image.name, image.size_px);
            }
        }
        assert!(image.rpc_rms_px < 0.03 && image.rpc_rms_px > 1e-4);
    }
}

#[test]
fn the_json_has_what_satnerf_readers_look_for_and_bounds_that_do_not_give_the_truth_away() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let summary = make(&small(), folder.path());
    let [low_m, high_m] = summary.altitude_range_m;
    for image in &summary.images {
        let text = fs::read_to_string(folder.path().join(format!("{}.json", image.name))).expect("file");
        let json: serde_json::Value = serde_json::from_str(&text).expect("JSON");
        assert_eq!(json["img"], format!("{}.tif", image.name));
        assert_eq!(
            (json["width"].as_u64(), json["height"].as_u64()),
            (Some(image.size_px[0] as u64), Some(image.size_px[1] as u64))
        );
        assert_eq!(json["sun_elevation"], format!("{:+.1}", image.sun_elevation_deg));
        assert_eq!(json["acquisition_date"].as_str().map(str::len), Some(14));
        assert_eq!(json["geojson"]["coordinates"][0].as_array().map(Vec::len), Some(5));
        assert!(json["min_alt"].as_f64().is_some_and(|bound| bound <= low_m - 10.0));
        assert!(json["max_alt"].as_f64().is_some_and(|bound| bound >= high_m + 10.0));
    }
}

#[test]
fn images_are_split_between_train_and_test() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let request = SatelliteRequest {
        views: Some(5),
        gsd_m: Some(2.0),
        ..small()
    };
    let summary = make(&request, folder.path());
    let lines = |name: &str| -> Vec<String> {
        fs::read_to_string(folder.path().join(name))
            .expect("file")
            .lines()
            .map(str::to_string)
            .collect()
    };
    let (train, test) = (lines("train.txt"), lines("test.txt"));
    assert_eq!((train.len(), test.len()), (4, 1));
    for name in train.iter().chain(&test) {
        assert!(folder.path().join(name).exists(), "{name}");
    }
    assert_eq!(summary.images.iter().filter(|image| image.held_out).count(), 1);
}

#[test]
fn every_kind_of_image_has_its_bands_and_depth() {
    for (bands, bits, samples) in [(BandSet::Pan, 16, 1), (BandSet::Rgb, 8, 3), (BandSet::RgbNir, 16, 4)] {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let request = SatelliteRequest {
            bands,
            bits,
            views: Some(1),
            size_px: Some(40),
            ..small()
        };
        let summary = make(&request, folder.path());
        let path = folder.path().join(format!("{}.tif", summary.images[0].name));
        let mut decoder = open(&path);
        assert_eq!(decoder.dimensions().expect("size"), (40, 40));
        assert_eq!(decoder.get_tag_u32(Tag::SamplesPerPixel).expect("tag"), samples);
        match decoder.read_image().expect("samples") {
            DecodingResult::U8(values) => {
                assert_eq!(bits, 8);
                assert!(values.iter().max() > Some(&150) && values.iter().min() < Some(&100));
            }
            DecodingResult::U16(values) => {
                assert_eq!(bits, 16);
                assert!(values.iter().all(|value| (1..=2047).contains(value)));
            }
            _ => panic!("neither 8 nor 16 bits"),
        }
    }
}

#[test]
fn progress_reaches_its_total_and_never_goes_back() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let seen = std::cell::RefCell::new(Vec::new());
    write_satellite(&small(), folder.path(), &|done, total| {
        seen.borrow_mut().push((done, total))
    })
    .expect("a scene");
    let seen = seen.into_inner();
    assert!(
        seen.windows(2)
            .all(|pair| pair[0].0 < pair[1].0 && pair[0].1 == pair[1].1)
    );
    assert_eq!(seen.last().map(|(done, total)| done == total), Some(true));
}

#[test]
fn a_pointing_bias_moves_the_camera_and_nothing_else() {
    let (a, b) = (
        tempfile::tempdir().expect("folder"),
        tempfile::tempdir().expect("folder"),
    );
    let plain = make(&small(), a.path());
    let biased = make(
        &SatelliteRequest {
            pointing_bias_px: 2.5,
            ..small()
        },
        b.path(),
    );
    let mut square = 0.0;
    for (before, after) in plain.images.iter().zip(&biased.images) {
        let tag = |folder: &Path, name: &str| {
            open(&folder.join(format!("{name}.tif")))
                .get_tag_f64_vec(Tag::Unknown(50_844))
                .expect("tag")
        };
        let (from, to) = (tag(a.path(), &before.name), tag(b.path(), &after.name));
        for (index, (x, y)) in from.iter().zip(&to).enumerate() {
            // 2 and 3 are the offsets of line and sample.
            assert!(x == y || index == 2 || index == 3, "value {index}");
        }
        square += (to[2] - from[2]).powi(2) + (to[3] - from[3]).powi(2);
        let mask =
            |folder: &Path| fs::read(folder.join(format!("truth/shadow_{}.tif", before.name))).map(|bytes| bytes.len());
        assert_eq!(mask(a.path()).ok(), mask(b.path()).ok());
    }
    assert!(((square / 3.0).sqrt() - 2.5).abs() < 1e-9);
    let dsm = |folder: &Path| fs::read(folder.join("truth/dsm.tif")).expect("file");
    assert!(dsm(a.path()) == dsm(b.path()));
}

#[test]
fn clouds_change_the_images_they_are_in_and_no_other_file_of_the_scene() {
    let (a, b) = (
        tempfile::tempdir().expect("folder"),
        tempfile::tempdir().expect("folder"),
    );
    let clear = make(&small(), a.path());
    let cloudy = make(&SatelliteRequest { clouds: 2, ..small() }, b.path());
    assert!(clear.images.iter().all(|image| image.cloud_share == 0.0));
    let hidden: Vec<_> = (cloudy.images.iter())
        .filter(|image| image.cloud_share > 0.0)
        .map(|image| &image.name)
        .collect();
    assert_eq!(hidden.len(), 2);
    for image in &cloudy.images {
        assert!(image.cloud_share < 0.3, "{}", image.cloud_share);
    }
    let (before, after) = (bytes_of(a.path()), bytes_of(b.path()));
    for (name, bytes) in &after {
        let belongs = |image: &&String| name.contains(image.as_str());
        let same = before.get(name) == Some(bytes);
        match hidden.iter().find(|image| belongs(image)) {
            Some(image) if name == &format!("{image}.tif") => assert!(!same, "{name}"),
            Some(_) if name.starts_with("truth/cloud_") => assert!(!before.contains_key(name), "{name}"),
            // Their shadow may lie outside.
            Some(image) if name == &format!("truth/shadow_{image}.tif") => {}
            None if name == "truth/summary.json" => assert!(!same),
            _ => assert!(same, "{name}"),
        }
    }
    assert_eq!(after.len(), before.len() + hidden.len());
    let manifest = String::from_utf8_lossy(&before["truth/summary.json"]);
    assert!(!manifest.contains("cloud"), "as it was before there were clouds");
}

#[test]
fn requests_that_cannot_be_met_are_refused_before_anything_is_written() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let out = folder.path().join("scene");
    for request in [
        SatelliteRequest {
            views: Some(0),
            ..small()
        },
        SatelliteRequest {
            dates: Some(0),
            ..small()
        },
        SatelliteRequest { bits: 12, ..small() },
        SatelliteRequest {
            relight: 101,
            ..small()
        },
        SatelliteRequest {
            gsd_m: Some(f64::NAN),
            ..small()
        },
        SatelliteRequest {
            size_px: Some(3),
            ..small()
        },
        SatelliteRequest {
            pointing_bias_px: -1.0,
            ..small()
        },
        SatelliteRequest {
            noise: f64::INFINITY,
            ..small()
        },
        SatelliteRequest { clouds: 4, ..small() },
    ] {
        let error = write_satellite(&request, &out, &|_, _| {}).expect_err("refused");
        assert!(matches!(error, SynthError::BadRequest(_)), "{error}");
        assert!(!out.exists());
    }
}

#[test]
fn a_folder_that_cannot_be_written_is_named() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let taken = folder.path().join("taken");
    fs::write(&taken, "a file").expect("file");
    let error = write_satellite(&small(), &taken, &|_, _| {}).expect_err("refused");
    assert!(error.to_string().contains("taken"), "{error}");
}
