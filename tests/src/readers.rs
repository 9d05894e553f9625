//! All readers of outside bytes, by name: the targets of fuzzing, and of the ordinary tests over a corpus.
//!
//! A reader may refuse any input. It must not panic, run long, or allocate more memory than its input justifies.

mod captures;
pub mod images;

use heliosplat::gaussians::{Table, core_groups};
use heliosplat::model::SceneModel;
use heliosplat::model::shadow_gs::{ShadowGs, ShadowGsOptions};
use heliosplat_batch::manifest::Manifest;
use heliosplat_objects::model::ObjectFile;
use heliosplat_objects::run::ObjectRun;
use heliosplat_objects::{camera_table, colmap, points, transforms};
use heliosplat_products::{model::ModelFile, ply};
use heliosplat_rpc::adjust::{Sighting, Track};
use heliosplat_rpc::read::{self, acquisition};
use heliosplat_rpc::{GeoPoint, ImagePoint, Rpc, write};
use heliosplat_satellite::config::SatelliteConfig;
use heliosplat_satellite::patch_ties::PatchTies;
use heliosplat_satellite::run_file::RunFile;
use heliosplat_scene as scene;
use std::collections::BTreeMap;

/// A reader of outside bytes, with inputs that it accepts.
#[derive(Clone, Copy)]
pub struct Reader {
    /// Name of the reader and of its fuzz target.
    pub name: &'static str,
    /// Reads bytes and drops the result; true if they were accepted.
    pub read: fn(&[u8]) -> bool,
    /// Returns sound inputs, from which damaged ones are made.
    pub corpus: fn() -> Vec<Vec<u8>>,
}

/// All readers.
pub const READERS: [Reader; 20] = [
    Reader {
        name: "camera_text",
        read: camera_text,
        corpus: camera_texts,
    },
    Reader {
        name: "acquisition_text",
        read: acquisition_text,
        corpus: acquisition_texts,
    },
    Reader {
        name: "metadata_items",
        read: metadata_items,
        corpus: item_lists,
    },
    Reader {
        name: "scene_toml",
        read: scene_toml,
        corpus: scenes,
    },
    Reader {
        name: "run_toml",
        read: run_toml,
        corpus: runs,
    },
    Reader {
        name: "settings",
        read: settings,
        corpus: setting_lists,
    },
    Reader {
        name: "model_ply",
        read: model_ply,
        corpus: plys,
    },
    Reader {
        name: "model_json",
        read: model_json,
        corpus: models,
    },
    Reader {
        name: "transforms_json",
        read: transforms_json,
        corpus: captures::transforms,
    },
    Reader {
        name: "colmap_model",
        read: colmap_model,
        corpus: captures::colmap,
    },
    Reader {
        name: "camera_table",
        read: camera_table,
        corpus: captures::tables,
    },
    Reader {
        name: "point_cloud",
        read: point_cloud,
        corpus: captures::clouds,
    },
    Reader {
        name: "object_json",
        read: object_json,
        corpus: captures::models,
    },
    Reader {
        name: "object_ply",
        read: object_ply,
        corpus: captures::plys,
    },
    Reader {
        name: "object_toml",
        read: object_toml,
        corpus: captures::runs,
    },
    Reader {
        name: "batch_toml",
        read: batch_toml,
        corpus: manifests,
    },
    Reader {
        name: "tile_list",
        read: tile_list,
        corpus: tile_lists,
    },
    Reader {
        name: "patch_ties",
        read: patch_ties,
        corpus: ties,
    },
    Reader {
        name: "raster_file",
        read: images::raster_file,
        corpus: images::raster_files,
    },
    Reader {
        name: "picture_file",
        read: images::picture_file,
        corpus: images::picture_files,
    },
];

fn text(bytes: &[u8]) -> String {
    // As the program reads: bytes that are no UTF-8 are replaced.
    String::from_utf8_lossy(bytes).into_owned()
}

/// Reads cameras: RPB, `_RPC.TXT`, DIMAP, Maxar XML, JSON, `.geom` and fixed width, first by content, then by each
/// reader.
pub fn camera_text(bytes: &[u8]) -> bool {
    let text = text(bytes);
    let found = read::rpc_from_text("a file", &text);
    if let Ok(rpc) = &found {
        // A camera read from damaged text is still safe to use.
        let _ = rpc.localise(ImagePoint { col: 10.0, row: 10.0 }, 0.0);
    }
    for reader in [
        read::rpb,
        read::rpc_txt,
        read::dimap,
        read::maxar_xml,
        read::satnerf_json,
        read::ossim_geom,
        read::fixed_width,
    ] {
        let _ = reader(&text);
    }
    let _ = scene::image_described(&text);
    found.is_ok()
}

/// Reads acquisitions: IMD, DIMAP, Maxar XML, Sat-NeRF JSON, STAC and metadata texts.
pub fn acquisition_text(bytes: &[u8]) -> bool {
    let text = text(bytes);
    let _ = (acquisition::stac(&text), acquisition::satnerf_json(&text));
    acquisition::from_text("a file", &text).is_some()
}

/// Reads items of GDAL's metadata domains, one `name=value` a line, as a camera and as an acquisition.
pub fn metadata_items(bytes: &[u8]) -> bool {
    let text = text(bytes);
    let pairs = text.lines().filter_map(|line| line.split_once('='));
    let items: BTreeMap<String, String> = pairs.map(|(k, v)| (k.to_owned(), v.to_owned())).collect();
    let _ = acquisition::gdal_domain(&items);
    let numbers: Vec<f64> = items.values().filter_map(|value| value.parse().ok()).collect();
    let _ = read::geotiff_tag(&numbers);
    read::gdal_domain(&items).is_ok()
}

/// Reads a `scene.toml`.
pub fn scene_toml(bytes: &[u8]) -> bool {
    scene::images_listed(&text(bytes)).is_ok()
}

/// Reads the `run.toml` of a satellite run.
pub fn run_toml(bytes: &[u8]) -> bool {
    RunFile::parse(&text(bytes)).is_ok()
}

/// Reads `--set` pairs, one `key=value` a line.
pub fn settings(bytes: &[u8]) -> bool {
    let text = text(bytes);
    let pairs = text.lines().take(16).filter_map(|line| line.split_once('='));
    let set: Vec<(String, String)> = pairs.map(|(k, v)| (k.trim().to_owned(), v.trim().to_owned())).collect();
    SatelliteConfig::resolve(heliosplat_fitting::settings::Preset::Fast, &set, 1).is_ok()
}

/// Reads the `model.ply` of a satellite model of four bands.
pub fn model_ply(bytes: &[u8]) -> bool {
    ply::decode(bytes, &model()).is_ok()
}

/// Reads the `model.json` of a satellite model, and makes the model from its options.
pub fn model_json(bytes: &[u8]) -> bool {
    match ModelFile::parse(&text(bytes)) {
        Ok(file) => {
            let model = ShadowGs::new(file.options);
            model.initial_globals(1.0).groups.len() == file.globals.groups.len()
        }
        Err(_) => false,
    }
}

/// Reads the `transforms.json` of a capture in a folder with `r_0.png` to `r_2.png`, and makes its cameras.
pub fn transforms_json(bytes: &[u8]) -> bool {
    match transforms::parse(&captures::folder().join("transforms.json"), bytes) {
        Ok(listed) => {
            for frame in &listed.frames {
                let _ = frame
                    .camera([64, 48])
                    .map(|camera| camera.projective(glam::DVec3::ZERO));
            }
            true
        }
        Err(_) => false,
    }
}

/// Reads a part of a COLMAP model, text or binary: its cameras, images or points.
pub fn colmap_model(bytes: &[u8]) -> bool {
    let text = std::str::from_utf8(bytes).unwrap_or_default();
    let binary = [
        colmap::cameras_binary(bytes).is_ok(),
        colmap::images_binary(bytes).is_ok(),
        colmap::points_binary(bytes).is_ok(),
    ];
    let text = [
        colmap::cameras_text(text).is_ok(),
        colmap::images_text(text).is_ok(),
        colmap::points_text(text).is_ok(),
    ];
    binary.into_iter().chain(text).any(|read| read)
}

/// Reads a `cameras.csv` in a folder with `r_0.png` to `r_2.png`.
pub fn camera_table(bytes: &[u8]) -> bool {
    camera_table::parse(captures::folder(), &String::from_utf8_lossy(bytes)).is_ok()
}

/// Reads a point cloud in PLY.
pub fn point_cloud(bytes: &[u8]) -> bool {
    points::read_ply(bytes).is_ok()
}

/// Reads the `model.json` of an object, and makes the model from its options.
pub fn object_json(bytes: &[u8]) -> bool {
    let file = std::str::from_utf8(bytes)
        .ok()
        .and_then(|text| ObjectFile::parse(text).ok());
    file.is_some_and(|file| file.kind.model().feature_groups().len() > 1)
}

/// Reads the `model.ply` of an object in a model of one light at a time.
pub fn object_ply(bytes: &[u8]) -> bool {
    heliosplat_exchange::splat_ply::decode(bytes, captures::olat().feature_groups()).is_ok()
}

/// Reads the `run.toml` of an object.
pub fn object_toml(bytes: &[u8]) -> bool {
    ObjectRun::parse(&text(bytes)).is_ok()
}

/// Reads the manifest of a batch.
pub fn batch_toml(bytes: &[u8]) -> bool {
    Manifest::parse(&text(bytes)).is_ok()
}

/// Reads the ties of a batch's unit.
pub fn patch_ties(bytes: &[u8]) -> bool {
    PatchTies::from_bytes(bytes).is_some()
}

fn ties() -> Vec<Vec<u8>> {
    let sighting = |image| Sighting {
        image,
        at: ImagePoint::new(120.25, 3000.5),
        weight: 0.5,
    };
    let track = Track {
        near: GeoPoint::new(36.9, 37.5, 700.0),
        sightings: vec![sighting(0), sighting(300)],
    };
    let ties = PatchTies(vec![vec![track.clone(), track], Vec::new()]);
    vec![ties.to_bytes().expect("written")]
}

/// Reads Maxar's `.TIL`, and the files that a DIMAP lists.
pub fn tile_list(bytes: &[u8]) -> bool {
    let text = text(bytes);
    let listed = read::data_files(&text).is_some();
    listed || !scene::places_in_til(&text).is_empty()
}

fn tile_lists() -> Vec<Vec<u8>> {
    let til = "numTiles = 2;\nBEGIN_GROUP = TILE_1\n\tfilename = \"A_R1C1.TIF\";\n\tULColOffset = 0;\n\tULRowOffset = 0;\n\
               END_GROUP = TILE_1\nBEGIN_GROUP = TILE_2\n\tfilename = \"A_R1C2.TIF\";\n\tULColOffset = 16384;\n\tULRowOffset = 7;\n\
               END_GROUP = TILE_2\nEND;\n";
    let file = |col: u32| {
        format!("<Data_File tile_R=\"1\" tile_C=\"{col}\"><DATA_FILE_PATH href=\"A_R1C{col}.TIF\"/></Data_File>")
    };
    let dimap = format!(
        "<Dimap_Document><Raster_Data><Data_Access><Data_Files>{}{}</Data_Files></Data_Access></Raster_Data></Dimap_Document>",
        file(1),
        file(2)
    );
    vec![til.as_bytes().to_vec(), dimap.into_bytes()]
}

fn manifests() -> Vec<Vec<u8>> {
    let text = "[[images]]\nname = \"all\"\nscene = \"images\"\n\n[[areas]]\nname = \"a\"\nbounds = [36.9, 37.5, 37.0, 37.6]\n\
                crs = \"EPSG:4326\"\naltitude_m = [640.0, 780.0]\n\n[[presets]]\nname = \"quick\"\npreset = \"fast\"\nseed = 2\n\
                set = { \"train.iterations\" = 100 }\n\n[tiles]\nmemory = \"4GiB\"\n";
    vec![text.as_bytes().to_vec()]
}

fn model() -> ShadowGs {
    ShadowGs::new(ShadowGsOptions {
        bands: 4,
        images: 2,
        ..ShadowGsOptions::default()
    })
}

fn camera() -> Rpc {
    crate::scenes::View::new(1).rpc()
}

fn polynomials(rpc: &Rpc) -> [(&'static str, [f64; 20]); 4] {
    [
        ("lineNumCoef", rpc.line_numerator),
        ("lineDenCoef", rpc.line_denominator),
        ("sampNumCoef", rpc.sample_numerator),
        ("sampDenCoef", rpc.sample_denominator),
    ]
}

const SCALARS: [&str; 10] = [
    "lineOffset",
    "sampOffset",
    "latOffset",
    "longOffset",
    "heightOffset",
    "lineScale",
    "sampScale",
    "latScale",
    "longScale",
    "heightScale",
];

fn camera_texts() -> Vec<Vec<u8>> {
    let rpc = camera();
    let scalars = &write::geotiff_tag(&rpc)[2..12];
    let list = |values: &[f64], between: &str| {
        values
            .iter()
            .map(|v| format!("{v:e}"))
            .collect::<Vec<_>>()
            .join(between)
    };
    let mut rpb = String::from("satId = \"WV03\";\nSpecId = \"RPC00B\";\nBEGIN_GROUP = IMAGE\n");
    let mut maxar = String::from("<isd><RPB><SPECID>RPC00B</SPECID><IMAGE>");
    for (name, value) in SCALARS.iter().zip(scalars) {
        rpb += &format!("\t{name} = {value:e};\n");
        let tag = name.to_ascii_uppercase();
        maxar += &format!("<{tag}>{value:e}</{tag}>");
    }
    for (name, values) in polynomials(&rpc) {
        rpb += &format!("\t{name} = (\n{});\n", list(&values, ",\n"));
        let tag = name.to_ascii_uppercase();
        maxar += &format!("<{tag}List><{tag}>{}</{tag}></{tag}List>", list(&values, " "));
    }
    rpb += "END_GROUP = IMAGE\nEND;\n";
    maxar += "</IMAGE></RPB></isd>";
    let names = ["LINE_NUM", "LINE_DEN", "SAMP_NUM", "SAMP_DEN"];
    let coefficients: String = polynomials(&rpc)
        .iter()
        .zip(names)
        .flat_map(|((_, values), name)| {
            (0..20).map(move |i| format!("<{name}_COEFF_{0}>{1:e}</{name}_COEFF_{0}>", i + 1, values[i]))
        })
        .collect();
    let keys = [
        "LINE_OFF",
        "SAMP_OFF",
        "LAT_OFF",
        "LONG_OFF",
        "HEIGHT_OFF",
        "LINE_SCALE",
        "SAMP_SCALE",
        "LAT_SCALE",
        "LONG_SCALE",
        "HEIGHT_SCALE",
    ];
    let validity: String = keys
        .iter()
        .zip(scalars)
        .map(|(key, value)| format!("<{key}>{value:e}</{key}>"))
        .collect();
    let dimap = format!(
        "<?xml version=\"1.0\"?><Dimap_Document><Metadata_Identification><METADATA_PROFILE>PHR_SENSOR</METADATA_PROFILE>\
         </Metadata_Identification><Rational_Function_Model><Global_RFM><Inverse_Model>{coefficients}</Inverse_Model>\
         <RFM_Validity>{validity}</RFM_Validity></Global_RFM></Rational_Function_Model></Dimap_Document>"
    );
    let json =
        serde_json::json!({"img": "a.tif", "rpc": write::satnerf_json_rpc(&rpc), "min_alt": 1, "max_alt": "20.5"});
    [rpb, write::rpc_txt(&rpc), dimap, maxar, json.to_string()]
        .map(String::into_bytes)
        .to_vec()
}

fn acquisition_texts() -> Vec<Vec<u8>> {
    [
        "BEGIN_GROUP = IMAGE_1\n\tfirstLineTime = 2015-09-30T10:56:56.973685Z;\n\tmeanSunAz = 162.1;\n\tmeanSunEl = 40.3;\nEND;\n",
        "<isd><IMD><IMAGE><FIRSTLINETIME>2015-09-30T10:56:56Z</FIRSTLINETIME><MEANSUNAZ>1.6e+02</MEANSUNAZ><MEANSUNEL>4e1</MEANSUNEL></IMAGE></IMD></isd>",
        "<Dimap_Document><Located_Geometric_Values><LOCATION_TYPE>Center</LOCATION_TYPE><TIME>2015-09-30T10:56:56Z</TIME>\
         <SUN_AZIMUTH unit=\"deg\">162</SUN_AZIMUTH><SUN_ELEVATION>40</SUN_ELEVATION></Located_Geometric_Values></Dimap_Document>",
        r#"{"type": "Feature", "properties": {"datetime": "2015-09-30T10:56:56Z", "view:sun_azimuth": 162.1, "view:sun_elevation": 40.3}}"#,
        r#"{"acquisition_date": "20150930105656", "sun_azimuth": "162.1", "sun_elevation": "+40.3"}"#,
        "Acquisition Date/Time: 2015-09-30 10:56 GMT\nSun Angle Azimuth: 162.1 degrees\nSun Angle Elevation: 40.3 degrees\n",
    ]
    .map(|text| text.as_bytes().to_vec())
    .to_vec()
}

fn item_lists() -> Vec<Vec<u8>> {
    let mut items = write::gdal_domain(&camera());
    items.insert("NITF_IDATIM".into(), "20150901135603".into());
    items.insert("NITF_USE00A_SUN_EL".into(), "+39.0".into());
    let lines: String = items.iter().map(|(key, value)| format!("{key}={value}\n")).collect();
    vec![lines.into_bytes()]
}

fn scenes() -> Vec<Vec<u8>> {
    let text = "altitude_range_m = [640, 780]\nbands = [\"red\", \"green\"]\ncounts = \"linear\"\n\n[[images]]\npath = \"a.tif\"\n\
                split = \"train\"\ntime = \"2016-04-23T08:34:00Z\"\n\n[[images]]\npath = \"b.tif\"\nsun_azimuth_deg = 150.0\n\
                sun_elevation_deg = 40\n\n[truth]\ndsm = \"lidar.tif\"\nshadows = { a = \"s.tif\" }\n";
    vec![text.as_bytes().to_vec()]
}

fn runs() -> Vec<Vec<u8>> {
    let run = RunFile {
        area: None,
        version: "0.1.0".into(),
        build: "0123456789abcdef".into(),
        preset: "fast".into(),
        seed: 1,
        scene: "scene".into(),
        altitude_range_m: Some((640.0, 780.0)),
        altitude_from_ties_m: Some((640.0, 780.0)),
        plan: Vec::new(),
        inputs: Vec::new(),
        config: SatelliteConfig::resolve(heliosplat_fitting::settings::Preset::Fast, &[], 1).unwrap_or_default(),
    };
    vec![toml::to_string_pretty(&run).unwrap_or_default().into_bytes()]
}

fn setting_lists() -> Vec<Vec<u8>> {
    let text = "train.iterations=200\ntrain.position_rate_gsd=0.002\ncameras.align=off\nmodel.image_colour=true\ntrain.density.cap=1000\n";
    vec![text.as_bytes().to_vec()]
}

fn plys() -> Vec<Vec<u8>> {
    let model = model();
    let mut groups = core_groups();
    groups.extend(model.feature_groups());
    let mut table = Table::zeros(groups, 7);
    for group in &mut table.groups {
        for (i, v) in group.values.iter_mut().enumerate() {
            *v = (i as f32 * 0.37).sin();
        }
    }
    vec![ply::encode(&table, 4), ply::encode(&table.gather(&[]), 4)]
}

fn models() -> Vec<Vec<u8>> {
    let model = model();
    let bands = ["red", "green", "blue", "near_infrared"];
    let image = serde_json::json!({
        "name": "view_0", "split": "train", "appearance": 0, "same_day": null,
        "map": {"u": [2.0, 0.0, 0.1, 31.5], "v": [0.0, -2.0, 0.0, 31.5], "w": [0.0, 0.0, 1e-6]},
        "crop": {"col0": 0, "row0": 0, "width": 64, "height": 64}, "shift_px": [0.0, 0.25],
        "sun": {"azimuth_rad": 2.5, "elevation_rad": 0.8},
    });
    let file = serde_json::json!({
        "schema": 1, "model": "shadow_gs", "options": model.options, "globals": model.initial_globals(0.3),
        "origin": {"lon_deg": 36.9, "lat_deg": 37.6, "height_m": 700.0}, "altitude_range_m": [690.0, 720.0],
        "area": {"west_m": -16.0, "south_m": -16.0, "east_m": 16.0, "north_m": 16.0}, "gsd_m": 0.5, "counts_per_unit": 1000.0,
        "projection": heliosplat::splat::ProjectionOptions::default(),
        "bands": bands, "images": [image],
    });
    vec![file.to_string().into_bytes()]
}
