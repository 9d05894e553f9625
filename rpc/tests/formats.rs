//! Real files of the supported formats, against golden values of the same products.

mod common;

use common::{golden, golden_camera, read_text, shared};
use heliosplat_rpc::read::{Acquisition, ReadError, acquisition};
use heliosplat_rpc::{GeoPoint, ImagePoint, Rpc, read, sun_position};
use std::path::Path;

/// Every number of two cameras is the same, errors apart (golden files have none).
fn assert_same(name: &str, found: &Rpc, expected: &Rpc) {
    let found = Rpc {
        error_bias_m: None,
        error_random_m: None,
        ..found.clone()
    };
    assert_eq!(&found, expected, "{name}");
}

fn camera(folder: &Path, name: &str) -> Rpc {
    let rpc = read::rpc_from_text(name, &read_text(&folder.join(name))).unwrap_or_else(|e| panic!("{name}: {e}"));
    // Every text is read as a valid camera: its own centre goes to the ground and back.
    let centre = ImagePoint::new(rpc.sample_offset, rpc.line_offset);
    let ground = rpc
        .localise(centre, rpc.height_offset_m)
        .unwrap_or_else(|e| panic!("{name}: {e}"));
    assert!(common::distance_px(rpc.project(ground), centre) < 1e-8, "{name}");
    rpc
}

#[test]
fn real_files_are_the_cameras_of_the_golden_values() {
    let Some(shared) = shared() else { return };
    for (file, name) in [
        ("rpcm/rpc_IKONOS.txt", "ikonos_rpcm"),
        ("rpcm/rpc_PLANET_L1A.txt", "planet_l1a"),
        ("rpcm/rpc_PLANET_L1B.txt", "planet_l1b"),
        (
            "rpcm/20191015_073816_ssc1d3_0011_basic_l1a_panchromatic_dn_RPC.TXT",
            "skysat_ssc1d3",
        ),
        ("rpcm/rpc_PLEIADES.xml", "phr1a_uruguay_rpcm"),
        ("rpcm/rpc_SPOT6.xml", "spot6_haiti"),
        ("rpcm/rpc_WV2.xml", "wv2_rpcm"),
        ("rpcm/rpc_WV3.xml", "wv3_rpcm"),
        ("rpcm/JAX_068_001_RGB.json", "jax068_satnerf"),
        ("gdal/md_dg.RPB", "wv3_gdal_rome"),
        ("gdal/md_dg_2.XML", "wv3_gdal_rome"),
        ("gdal/md_ge_rgb_0010000_rpc.txt", "ikonos_paris_gdal"),
        ("gdal/md_kompsat.rpc", "kompsat2"),
        ("gdal/md_ov_rpc.txt", "orbview3"),
        ("gdal/alos/RPC-md_alos.txt", "alos_avnir2"),
    ] {
        assert_same(
            file,
            &camera(&shared.join("data/formats"), file),
            &golden_camera(&golden(&shared, name)),
        );
    }
}

#[test]
fn cameras_of_one_site_are_those_of_the_golden_values() {
    let Some(shared) = shared() else { return };
    let all = common::read_json(&shared.join("data/cameras/mvs3dm_worldview3_40.json"));
    for (image, name) in [
        ("0025_WV03_15SEP01135603-P1BS-500497284040_01_P001.png", "mvs3dm_0025"),
        ("0016_WV03_15MAY05140810-P1BS-500497282090_01_P001.png", "mvs3dm_0016"),
    ] {
        let rpc = read::satnerf_json(&all[image].to_string()).expect("the camera reads");
        assert_same(image, &rpc, &golden_camera(&golden(&shared, name)));
    }
}

#[test]
fn files_without_a_camera_are_clear_errors() {
    let Some(shared) = shared() else { return };
    for (file, words) in [
        ("rpcm/rpc_unsupported.xml", "<VRTDataset>"),
        ("gdal/md_dg.IMD", "no camera recognised"),
        ("gdal/md_ge_metadata.txt", "no camera recognised"),
        ("gdal/md_kompsat.txt", "no camera recognised"),
        ("gdal/alos/summary.txt", "no camera recognised"),
        ("gdal/spot/METADATA.DIM", "Global_RFM"),
        ("gdal/dimap2/bundle/DIM_foo.XML", "Global_RFM"),
        // Placeholders in place of numbers.
        ("gdal/dimap2/bundle/RPC_foo.XML", "LAT_OFF is \"LAT_OFF\""),
        (
            "gdal/dimap2/primary_rpc_center_h/RPC_PNEO3_STD_x_1_1_F_1.XML",
            "LAT_OFF is \"LAT_OFF\"",
        ),
    ] {
        let error = read::rpc_from_text(file, &read_text(&shared.join("data/formats").join(file))).expect_err(file);
        assert!(error.to_string().contains(words), "{file}: {error}");
        if words.contains("recognised") {
            assert!(
                matches!(&error, ReadError::Unrecognised { file: named, .. } if named == file),
                "{error:?}"
            );
        }
    }
}

#[test]
fn an_orbview_pvl_is_the_camera_of_its_text_file() {
    let Some(shared) = shared() else { return };
    let folder = shared.join("data/formats/gdal");
    let (pvl, txt) = (camera(&folder, "md_ov.pvl"), camera(&folder, "md_ov_rpc.txt"));
    let ground = txt
        .localise(ImagePoint::new(3_000.0, 9_000.0), 150.0)
        .expect("localises");
    assert!(common::distance_px(pvl.project(ground), txt.project(ground)) < 0.01);
}

fn acquired(shared: &Path, file: &str) -> Acquisition {
    let text = read_text(&shared.join("data").join(file));
    acquisition::from_text(file, &text).unwrap_or_else(|| panic!("{file}: nothing found"))
}

fn time(text: &str) -> Option<jiff::Timestamp> {
    Some(text.parse().expect("RFC 3339"))
}

#[test]
fn acquisitions_of_real_files_are_read() {
    let Some(shared) = shared() else { return };
    for (file, utc, azimuth_deg, elevation_deg) in [
        ("formats/gdal/md_dg.IMD", "2010-04-01T12:00:00Z", None, None),
        ("formats/gdal/md_dg_2.XML", "2011-05-01T13:00:00Z", None, None),
        ("formats/gdal/md_ov.pvl", "2013-07-01T15:00:00Z", None, None),
        ("formats/gdal/md_ge_metadata.txt", "2012-06-01T14:00:00Z", None, None),
        ("formats/gdal/md_kompsat.txt", "2007-05-01T07:00:00Z", None, None),
        (
            "formats/gdal/spot/METADATA.DIM",
            "2001-03-01T00:00:00Z",
            Some(144.903_762_82),
            Some(54.877_838_135),
        ),
        (
            "formats/gdal/dimap2/bundle/DIM_foo.XML",
            "2016-06-17T12:34:56Z",
            None,
            None,
        ),
        (
            "formats/gdal/dimap2/single_component/DIM_foo.XML",
            "2022-05-19T05:55:43.122330Z",
            None,
            None,
        ),
        (
            "formats/rpcm/rpc_WV2.xml",
            "2015-09-30T10:56:56.973685Z",
            Some(162.1),
            Some(40.3),
        ),
        (
            "formats/rpcm/rpc_WV3.xml",
            "2012-02-12T05:33:43.088646Z",
            Some(153.0),
            Some(45.4),
        ),
        (
            "formats/rpcm/JAX_068_001_RGB.json",
            "2014-10-05T16:01:38Z",
            Some(150.3),
            Some(50.8),
        ),
        (
            "kahramanmaras/kahramanmaras_04.json",
            "2023-04-15T08:34:39.9Z",
            Some(151.244),
            Some(59.242),
        ),
    ] {
        let found = acquired(&shared, file);
        assert_eq!(found.time, time(utc), "{file}");
        assert_eq!(
            (found.sun_azimuth_deg, found.sun_elevation_deg),
            (azimuth_deg, elevation_deg),
            "{file}"
        );
    }
    let neo = acquired(&shared, "formats/gdal/dimap2/vhr2020_ms_fs/MS-FS/DIM_MS-FS.XML");
    assert_eq!(
        neo.sun_azimuth_deg,
        Some(165.762_381_243_442_86),
        "the centre of nine places"
    );
    assert!(neo.time > time("2017-04-12T11:06:01Z") && neo.time < time("2017-04-12T11:06:03Z"));
}

#[test]
fn stated_suns_agree_with_computed_ones_to_the_vendors_error() {
    let Some(shared) = shared() else { return };
    let mut largest_deg = 0.0_f64;
    let mut compared = 0;
    for folder in ["kahramanmaras", "giza", "ventoux"] {
        for entry in std::fs::read_dir(shared.join("data").join(folder)).expect("folder") {
            let path = entry.expect("entry").path();
            if path.extension().is_none_or(|e| e != "json") {
                continue;
            }
            let text = read_text(&path);
            let found = acquisition::satnerf_json(&text);
            let rpc = read::satnerf_json(&text).expect("the camera reads");
            let at = GeoPoint::new(rpc.longitude_offset_deg, rpc.latitude_offset_deg, 0.0);
            let apart_deg = found.sun_disagreement_deg(at).expect("both are there");
            // These angles are computed ones of the crop, the camera's centre is up to 10 km away.
            assert!(apart_deg < 0.15, "{}: {apart_deg}", path.display());
            assert_eq!(found.sun_at(at), found.time.map(|time| sun_position(time, at)));
            compared += 1;
        }
    }
    let cameras = common::read_json(&shared.join("data/cameras/mvs3dm_worldview3_40.json"));
    for (name, value) in cameras.as_object().expect("object") {
        let found = acquisition::satnerf_json(&value.to_string());
        let at = GeoPoint::new(-58.5757, -34.4466, 20.0);
        let apart_deg = found
            .sun_disagreement_deg(at)
            .unwrap_or_else(|| panic!("{name}: {found:?}"));
        assert!(apart_deg < 0.5, "{name}: {apart_deg}");
        largest_deg = largest_deg.max(apart_deg);
        compared += 1;
    }
    assert_eq!(compared, 48);
    println!("largest disagreement of 40 vendor suns: {largest_deg:.3} degree");
}
