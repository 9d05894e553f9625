//! Hostile inputs: each gets one line with the fault, exit code 2, in seconds and in little memory. Nothing outside of
//! `--out` is written, and no network address is contacted.

use gdal::raster::{Buffer, RasterCreationOptions};
use gdal::{Dataset, DatasetOptions, DriverManager, GdalOpenFlags, Metadata};
use heliosplat_raster::{ImageSpec, SampleType, write_geotiff};
use heliosplat_tests::measured::{self, Measured};
use heliosplat_tests::program::{binary, json};
use heliosplat_tests::scenes::{View, parallel_camera, write_scene};
use serde_json::{Value, json};
use std::ffi::OsString;
use std::io::Write;
use std::net::TcpListener;
use std::os::unix::ffi::OsStringExt;
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;
use tempfile::tempdir;

/// The most memory that a refusal may take.
const PEAK_MAX: u64 = 500 << 20;
/// The most time, on a machine that is busy with other things.
const LONGEST: Duration = Duration::from_secs(30);

/// A hostile input: its name, the function that makes it in an empty folder and returns the arguments, and the text of
/// the refusal.
struct Case(&'static str, fn(&Path) -> Vec<OsString>, &'static str);

const CASES: [Case; 38] = [
    Case(
        "a manifest that leads to another file",
        manifest_traversal,
        "not an image",
    ),
    Case("a manifest that names a remote file", manifest_remote, "download"),
    Case("a manifest that is nested deep", manifest_deep, "scene.toml"),
    Case("a manifest that never ends", manifest_endless, "device"),
    Case("a manifest that is a pipe", manifest_pipe, "pipe"),
    Case("a manifest that is a folder", manifest_folder, "folder"),
    Case("a manifest of a gigabyte", manifest_long, "bytes"),
    Case("a manifest that is no text", manifest_binary, "UTF-8"),
    Case("a virtual raster", virtual_raster, "virtual raster"),
    Case("a link to itself as an image", link_loop, "no such file"),
    Case("folders that lead in a circle", folder_loop, "no images found"),
    Case("a folder as an image", folder_image, "not an image"),
    Case("a pipe as an image", pipe_image, "not an image"),
    Case(
        "an image of a trillion pixels",
        tiff_of_a_trillion,
        "claims 1000000 x 1000000",
    ),
    Case("a trillion pixels in a scene", tiff_in_a_scene, "view_2.tif"),
    Case(
        "an image of more pixels than its bytes hold",
        tiff_of_more,
        "claims 30000 x 30000",
    ),
    Case(
        "an image of one strip that its bytes do not hold",
        tiff_of_one_strip,
        "in one block",
    ),
    Case("an image of complex numbers", tiff_complex, "complex numbers"),
    Case("a raw image that is cut off", raw_cut_off, "claims 4096 bytes"),
    Case(
        "an Erdas image that leads to another folder",
        hfa_leads_away,
        "in another folder",
    ),
    Case("a system that is an address", crs_address, "no EPSG:N"),
    Case("a system that is a file", crs_file, "no EPSG:N"),
    Case("an XML bomb for a camera", xml_bomb, "view_1"),
    Case("a camera of no numbers", rpc_nan, "view_1"),
    Case("a camera of huge numbers", rpc_huge, "view_1"),
    Case("metadata of a gigabyte", metadata_long, "more than"),
    Case("a name that is not UTF-8", name_not_utf8, "not UTF-8"),
    Case(
        "a capture that names /etc/passwd",
        capture_absolute,
        "points out of the folder",
    ),
    Case("a capture that climbs out", capture_climbs, "points out of the folder"),
    Case("a capture nested deep", capture_deep, "not JSON"),
    Case("a PNG that claims a gigabyte", png_claims, "claims 16384 x 16384"),
    Case("a PNG that unpacks to a thousandfold", png_bomb, "claims 14000 x 14000"),
    Case("an EXR that claims a gigabyte", exr_claims, "view.exr"),
    Case(
        "a model of a trillion Gaussians",
        ply_of_a_trillion,
        "claims 1000000000000 Gaussians",
    ),
    Case("a model of impossible counts", model_counts, "model.json"),
    Case("a model of negative sizes", model_negative, "model.json"),
    Case(
        "a model whose image climbs out",
        model_climbs,
        "not one a file can have",
    ),
    Case("a model that is a pipe", model_pipe, "not a finished run"),
];

fn inspect(scene: &Path) -> Vec<OsString> {
    vec!["inspect".into(), scene.into()]
}

/// Two valid views; the second may be spoilt.
fn two_views(home: &Path) {
    write_scene(home, &[View::new(0), View::new(1)]);
}

/// Two valid views, and a third that has a camera in a JSON but no image.
fn missing_image(home: &Path) -> PathBuf {
    write_scene(home, &[View::new(0), View::new(1), View::new(2)]);
    let path = home.join("view_2.tif");
    std::fs::remove_file(&path).expect("removed");
    path
}

/// Two valid views; the second has no camera yet.
fn missing_camera(home: &Path) {
    let bare = View {
        has_rpc: false,
        ..View::new(1)
    };
    write_scene(home, &[View::new(0), bare]);
}

fn manifest(home: &Path, images: &str) -> Vec<OsString> {
    two_views(home);
    let text = format!("[[images]]\npath = \"view_0.tif\"\n[[images]]\npath = \"{images}\"\n");
    std::fs::write(home.join("scene.toml"), text).expect("written");
    inspect(home)
}

fn manifest_traversal(home: &Path) -> Vec<OsString> {
    manifest(home, "../../../../../../../../../../etc/passwd")
}

fn manifest_remote(home: &Path) -> Vec<OsString> {
    manifest(home, "/vsicurl/http://127.0.0.1:9/a.tif")
}

fn manifest_deep(home: &Path) -> Vec<OsString> {
    two_views(home);
    std::fs::write(home.join("scene.toml"), format!("a = {}", "[".repeat(1_000_000))).expect("written");
    inspect(home)
}

fn manifest_endless(home: &Path) -> Vec<OsString> {
    symlink("/dev/zero", home.join("scene.toml")).expect("linked");
    inspect(&home.join("scene.toml"))
}

fn pipe(path: &Path) {
    let made = Command::new("mkfifo").arg(path).status().expect("mkfifo runs");
    assert!(made.success());
}

fn manifest_pipe(home: &Path) -> Vec<OsString> {
    pipe(&home.join("scene.toml"));
    inspect(&home.join("scene.toml"))
}

fn manifest_folder(home: &Path) -> Vec<OsString> {
    two_views(home);
    std::fs::create_dir(home.join("city.toml")).expect("made");
    [
        "batch".into(),
        home.join("city.toml").into(),
        "--out".into(),
        home.join("out").into(),
    ]
    .into()
}

fn long_file(path: &Path) {
    let file = std::fs::File::create(path).expect("created");
    file.set_len(1 << 30).expect("a sparse file");
}

fn manifest_long(home: &Path) -> Vec<OsString> {
    long_file(&home.join("scene.toml"));
    inspect(home)
}

fn manifest_binary(home: &Path) -> Vec<OsString> {
    std::fs::write(home.join("scene.toml"), b"[[images]]\npath = \"\xff\xfe\"\n").expect("written");
    inspect(home)
}

fn virtual_raster(home: &Path) -> Vec<OsString> {
    std::fs::write(home.join("a.vrt"), virtual_text("/etc/passwd")).expect("written");
    manifest(home, "a.vrt")
}

fn virtual_text(source: &str) -> String {
    format!(
        "<VRTDataset rasterXSize=\"64\" rasterYSize=\"64\"><VRTRasterBand dataType=\"UInt16\" band=\"1\"><SimpleSource>\
         <SourceFilename relativeToVRT=\"0\">{source}</SourceFilename><SourceBand>1</SourceBand></SimpleSource></VRTRasterBand></VRTDataset>"
    )
}

fn link_loop(home: &Path) -> Vec<OsString> {
    symlink(home.join("b.tif"), home.join("a.tif")).expect("linked");
    symlink(home.join("a.tif"), home.join("b.tif")).expect("linked");
    manifest(home, "a.tif")
}

fn folder_loop(home: &Path) -> Vec<OsString> {
    let scene = home.join("scene");
    std::fs::create_dir(&scene).expect("made");
    for name in ["images", "a", "RGB"] {
        symlink(&scene, scene.join(name)).expect("linked");
    }
    inspect(&scene)
}

fn folder_image(home: &Path) -> Vec<OsString> {
    std::fs::create_dir(home.join("folder.tif")).expect("made");
    manifest(home, "folder.tif")
}

fn pipe_image(home: &Path) -> Vec<OsString> {
    pipe(&home.join("pipe.tif"));
    manifest(home, "pipe.tif")
}

/// A TIFF of eight bytes of pixels: its side, rows of each strip, and its sample format (bits, compression, format).
fn tiff(path: &Path, side: u32, rows: u32, [bits, compression, format]: [u32; 3]) {
    let entry = |tag: u16, kind: u16, value: u32| {
        let mut bytes = [tag.to_le_bytes(), kind.to_le_bytes()].concat();
        bytes.extend_from_slice(&1u32.to_le_bytes());
        bytes.extend_from_slice(&value.to_le_bytes());
        bytes
    };
    // Width, height, bits, compression, grey, where the strip is, one band, rows of a strip, length of the strip,
    // format of samples.
    let entries = [
        entry(256, 4, side),
        entry(257, 4, side),
        entry(258, 3, bits),
        entry(259, 3, compression),
        entry(262, 3, 1),
        entry(273, 4, 8),
        entry(277, 3, 1),
        entry(278, 4, rows),
        entry(279, 4, 8),
        entry(339, 3, format),
    ];
    let mut bytes = b"II*\0\x10\0\0\0\x78\x9c\x03\0\0\0\0\x01".to_vec();
    bytes.extend_from_slice(&(entries.len() as u16).to_le_bytes());
    bytes.extend(entries.concat());
    bytes.extend_from_slice(&[0; 4]);
    std::fs::write(path, bytes).expect("written");
}

/// Bytes, deflated.
const DEFLATED_BYTES: [u32; 3] = [8, 8, 1];

fn tiff_of_a_trillion(home: &Path) -> Vec<OsString> {
    surface_of(home, 1_000_000, 1, DEFLATED_BYTES)
}

fn tiff_of_more(home: &Path) -> Vec<OsString> {
    surface_of(home, 30_000, 1, DEFLATED_BYTES)
}

fn tiff_of_one_strip(home: &Path) -> Vec<OsString> {
    // Sixteen bits, LZW: GDAL reads such a strip whole.
    tiff(&missing_image(home), 30_000, 30_000, [16, 5, 1]);
    inspect(home)
}

fn tiff_complex(home: &Path) -> Vec<OsString> {
    surface_of(home, 1, 1, [32, 1, 5])
}

/// A malformed surface model, measured against itself.
fn surface_of(home: &Path, side: u32, rows: u32, samples: [u32; 3]) -> Vec<OsString> {
    tiff(&home.join("dsm.tif"), side, rows, samples);
    std::fs::write(home.join("dsm.tfw"), "0.5\n0\n0\n-0.5\n312000\n4160000\n").expect("written");
    measure(&home.join("dsm.tif"))
}

/// Measures a surface model against itself.
fn measure(path: &Path) -> Vec<OsString> {
    [
        "evaluate".into(),
        "--dsm".into(),
        path.into(),
        "--truth".into(),
        path.into(),
    ]
    .into()
}

/// An image of 64 by 64 bytes in a format that GDAL writes.
fn written_by(driver: &str, path: &Path, options: &[&str]) {
    let driver = DriverManager::get_driver_by_name(driver).expect("a format of GDAL");
    let options = RasterCreationOptions::from_iter(options.iter().copied());
    let dataset = driver.create_with_band_type_with_options::<u8, _>(path, 64, 64, 1, &options);
    let values = Buffer::new((64, 64), vec![7u8; 64 * 64]);
    let dataset = dataset.expect("created");
    let mut band = dataset.rasterband(1).expect("a band");
    band.write((0, 0), (64, 64), &mut { values }).expect("pixels");
}

fn raw_cut_off(home: &Path) -> Vec<OsString> {
    let path = home.join("dsm.img");
    written_by("ENVI", &path, &[]);
    let file = std::fs::File::options().write(true).open(&path).expect("an image");
    file.set_len(64 * 64 * 6 / 10).expect("shorter");
    measure(&path)
}

fn hfa_leads_away(home: &Path) -> Vec<OsString> {
    let path = home.join("pixels.img");
    written_by("HFA", &path, &["USE_SPILL=YES"]);
    let mut bytes = std::fs::read(&path).expect("readable");
    let at = bytes
        .windows(10)
        .position(|name| name == b"pixels.ige")
        .expect("the name of its pixels");
    bytes[at..at + 10].copy_from_slice(b"../els.ige");
    std::fs::write(&path, bytes).expect("written");
    measure(&path)
}

fn crs_address(home: &Path) -> Vec<OsString> {
    in_system(home, "http://127.0.0.1:9/a.wkt")
}

fn crs_file(home: &Path) -> Vec<OsString> {
    std::fs::write(home.join("a.prj"), "EPSG:32637").expect("written");
    in_system(home, &home.join("a.prj").to_string_lossy())
}

fn in_system(home: &Path, system: &str) -> Vec<OsString> {
    two_views(home);
    let mut arguments: Vec<OsString> = ["dsm".into(), home.into(), "--out".into(), home.join("dsm.tif").into()].into();
    arguments.extend(["--from", "sweep", "--crs", system].map(OsString::from));
    arguments
}

fn tiff_in_a_scene(home: &Path) -> Vec<OsString> {
    tiff(&missing_image(home), 1_000_000, 1, DEFLATED_BYTES);
    inspect(home)
}

fn xml_bomb(home: &Path) -> Vec<OsString> {
    missing_camera(home);
    let mut text = "<!DOCTYPE l [<!ENTITY a0 \"aaaaaaaaaa\">".to_owned();
    for level in 1..30 {
        let inside = format!("&a{};", level - 1).repeat(10);
        text += &format!("<!ENTITY a{level} \"{inside}\">");
    }
    text += "]><isd><RPB>&a29;</RPB></isd>";
    std::fs::write(home.join("view_1.xml"), &text).expect("written");
    std::fs::write(home.join("RPC_view_1.XML"), &text).expect("written");
    inspect(home)
}

/// The camera of the second view as a `_RPC.TXT` whose numbers are all `with`.
fn rpc_of(home: &Path, with: &str) -> Vec<OsString> {
    missing_camera(home);
    let mut text = String::new();
    for name in ["LINE", "SAMP", "LAT", "LONG", "HEIGHT"] {
        text += &format!("{name}_OFF: {with}\n{name}_SCALE: {with}\n");
    }
    for name in ["LINE_NUM", "LINE_DEN", "SAMP_NUM", "SAMP_DEN"] {
        for number in 1..=20 {
            text += &format!("{name}_COEFF_{number}: {with}\n");
        }
    }
    std::fs::write(home.join("view_1_RPC.TXT"), text).expect("written");
    inspect(home)
}

fn rpc_nan(home: &Path) -> Vec<OsString> {
    rpc_of(home, "nan")
}

fn rpc_huge(home: &Path) -> Vec<OsString> {
    rpc_of(home, "1e300")
}

fn metadata_long(home: &Path) -> Vec<OsString> {
    missing_camera(home);
    long_file(&home.join("view_1.RPB"));
    inspect(home)
}

fn name_not_utf8(home: &Path) -> Vec<OsString> {
    two_views(home);
    let name = OsString::from_vec(b"view_\xff.tif".to_vec());
    std::fs::write(home.join(name), b"no image").expect("written");
    inspect(home)
}

fn capture(home: &Path, file_path: &str) -> Vec<OsString> {
    let frame =
        json!({"file_path": file_path, "transform_matrix": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 4], [0, 0, 0, 1]]});
    let text = json!({"camera_angle_x": 0.7, "frames": [frame, frame]}).to_string();
    std::fs::write(home.join("transforms_train.json"), text).expect("written");
    inspect(home)
}

fn capture_absolute(home: &Path) -> Vec<OsString> {
    capture(home, "/etc/passwd")
}

fn capture_climbs(home: &Path) -> Vec<OsString> {
    capture(home, "../../../../etc/passwd")
}

fn capture_deep(home: &Path) -> Vec<OsString> {
    std::fs::write(home.join("transforms_train.json"), "[".repeat(5_000_000)).expect("written");
    inspect(home)
}

/// Training reads pixels, which inspecting does not.
fn train_capture(home: &Path, file_path: &str) -> Vec<OsString> {
    capture(home, file_path);
    vec!["train".into(), home.into(), "--out".into(), home.join("run").into()]
}

fn png_claims(home: &Path) -> Vec<OsString> {
    let mut bytes = b"\x89PNG\r\n\x1a\n".to_vec();
    let mut header = b"IHDR".to_vec();
    header.extend_from_slice(&16_384u32.to_be_bytes());
    header.extend_from_slice(&16_384u32.to_be_bytes());
    header.extend_from_slice(&[8, 6, 0, 0, 0]);
    bytes.extend_from_slice(&13u32.to_be_bytes());
    bytes.extend_from_slice(&header);
    bytes.extend_from_slice(&crc(&header).to_be_bytes());
    bytes.extend_from_slice(&100u32.to_be_bytes());
    bytes.extend_from_slice(b"IDAT\x78\x9c");
    std::fs::write(home.join("view.png"), bytes).expect("written");
    train_capture(home, "view.png")
}

/// The checksum of PNG's chunks (ISO 15948, annex D).
fn crc(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(!0u32, |crc, &byte| {
        (0..8).fold(crc ^ u32::from(byte), |c, _| {
            if c & 1 == 1 { c >> 1 ^ 0xedb8_8320 } else { c >> 1 }
        })
    })
}

fn png_bomb(home: &Path) -> Vec<OsString> {
    let picture = image::GrayImage::new(14_000, 14_000);
    picture.save(home.join("view.png")).expect("written");
    train_capture(home, "view.png")
}

fn exr_claims(home: &Path) -> Vec<OsString> {
    let path = home.join("view.exr");
    image::Rgb32FImage::new(4, 4).save(&path).expect("written");
    let mut bytes = std::fs::read(&path).expect("readable");
    for name in [&b"dataWindow\0box2i\0"[..], b"displayWindow\0box2i\0"] {
        let at = bytes.windows(name.len()).position(|w| w == name).expect("a window");
        // Behind the name and the length of the value: left, top, right, bottom.
        let right = at + name.len() + 4 + 8;
        bytes[right..right + 4].copy_from_slice(&16_000i32.to_le_bytes());
        bytes[right + 4..right + 8].copy_from_slice(&16_000i32.to_le_bytes());
    }
    std::fs::write(&path, bytes).expect("written");
    train_capture(home, "view.exr")
}

/// A run of one step.
fn run(home: &Path) -> PathBuf {
    let (scene, run) = (home.join("scene"), home.join("run"));
    std::fs::create_dir(&scene).expect("made");
    write_scene(&scene, &[View::new(0), View::new(1), View::new(2)]);
    let mut arguments: Vec<OsString> = ["train".into(), scene.into(), "--out".into(), run.clone().into()].into();
    let set = [
        "--preset",
        "fast",
        "--altitude",
        "690,710",
        "--set",
        "train.iterations=1",
    ];
    arguments.extend(set.map(OsString::from));
    json(&arguments);
    run
}

fn render(home: &Path, run: &Path) -> Vec<OsString> {
    let out = home.join("out").join("inner");
    [
        "render".into(),
        run.into(),
        "--out".into(),
        out.into(),
        "--split".into(),
        "all".into(),
    ]
    .into()
}

fn ply_of_a_trillion(home: &Path) -> Vec<OsString> {
    let run = run(home);
    let path = run.join("model.ply");
    let bytes = std::fs::read(&path).expect("readable");
    let start = String::from_utf8_lossy(&bytes[..200]).into_owned();
    let line = start
        .lines()
        .find(|line| line.starts_with("element vertex"))
        .expect("a count")
        .to_owned();
    let at = start.find(&line).expect("a count");
    let damaged = [&bytes[..at], b"element vertex 1000000000000", &bytes[at + line.len()..]].concat();
    std::fs::write(&path, damaged).expect("written");
    // Its sum would refuse it before it is decoded.
    change_model(&run, |model| model["gaussians_sha256"] = Value::Null);
    render(home, &run)
}

fn change_model(run: &Path, change: fn(&mut Value)) {
    let path = run.join("model.json");
    let mut model: Value = serde_json::from_slice(&std::fs::read(&path).expect("readable")).expect("JSON");
    change(&mut model);
    std::fs::write(&path, model.to_string()).expect("written");
}

/// A run whose `model.json` was changed.
fn changed_model(home: &Path, change: fn(&mut Value)) -> Vec<OsString> {
    let run = run(home);
    change_model(&run, change);
    render(home, &run)
}

fn model_counts(home: &Path) -> Vec<OsString> {
    changed_model(home, |model| model["options"]["images"] = json!(1_000_000_000_000u64))
}

fn model_negative(home: &Path) -> Vec<OsString> {
    changed_model(home, |model| model["images"][0]["crop"]["width"] = json!(-5))
}

fn model_climbs(home: &Path) -> Vec<OsString> {
    changed_model(home, |model| model["images"][0]["name"] = json!("../../escaped"))
}

fn model_pipe(home: &Path) -> Vec<OsString> {
    let run = home.join("run");
    std::fs::create_dir(&run).expect("made");
    pipe(&run.join("model.json"));
    render(home, &run)
}

#[test]
fn hostile_inputs_are_refused_in_one_line_in_seconds_and_in_little_memory() {
    assert!(binary().is_file());
    let mut wrong = Vec::new();
    for Case(name, make, said) in CASES {
        let home = tempdir().expect("a temporary folder");
        let arguments = make(home.path());
        let Measured {
            code,
            stderr,
            peak_bytes,
            took,
            ..
        } = measured::run(&arguments, LONGEST);
        println!(
            "{name}: {} MiB, {} ms: {}",
            peak_bytes >> 20,
            took.as_millis(),
            stderr.trim_end()
        );
        let errors: Vec<&str> = stderr.lines().filter(|line| line.starts_with("error: ")).collect();
        let line = errors.first().copied().unwrap_or_default();
        let refused = code == Some(2) && errors.len() == 1 && !stderr.contains("panicked");
        if !(refused && line.contains(said) && line.len() < 2000 && peak_bytes < PEAK_MAX && took < LONGEST) {
            wrong.push(format!(
                "{name}: {code:?}, {} MiB, {took:?}: {stderr}",
                peak_bytes >> 20
            ));
        }
        let escaped = ["escaped.tif", "out/escaped.tif", "run/escaped.png"].map(|path| home.path().join(path));
        assert!(escaped.iter().all(|path| !path.exists()), "{name}: written outside");
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

/// Three images large enough to be averaged, without stated altitudes.
fn averaged_views(home: &Path) {
    const SIDE: usize = 400;
    let mut raster = heliosplat::Raster::filled(SIDE, SIDE, 1, 0.0);
    for (index, value) in raster.values.iter_mut().enumerate() {
        *value = 200.0 + (index.wrapping_mul(2_654_435_761) >> 7 & 0xff) as f32;
    }
    for (number, tilt) in [[0.0, 0.0], [0.2, 0.05], [-0.1, 0.15]].into_iter().enumerate() {
        let camera = parallel_camera(SIDE, 0.5, [36.91, 37.58], tilt);
        let rpc: Vec<(String, String)> = heliosplat_rpc::write::gdal_domain(&camera).into_iter().collect();
        let spec = ImageSpec {
            rpc: &rpc,
            ..ImageSpec::plain(&raster)
        };
        write_geotiff(&home.join(format!("view_{number}.tif")), &spec, SampleType::U16).expect("written");
    }
}

/// Gives an image an item of the domain in which GDAL looks for overviews.
fn name_overviews(image: &Path, source: &str) {
    let options = DatasetOptions {
        open_flags: GdalOpenFlags::GDAL_OF_UPDATE | GdalOpenFlags::GDAL_OF_RASTER,
        ..DatasetOptions::default()
    };
    let mut dataset = Dataset::open_ex(image, options).expect("an image");
    dataset
        .set_metadata_item("OVERVIEW_FILE", source, "OVERVIEWS")
        .expect("an item");
    dataset.close().expect("written");
}

/// Names of overviews that a file may have, for a server that listens at `address`.
fn foreign_overviews(address: &str, cache: &Path) -> Vec<String> {
    let (host, port) = address.split_once(':').expect("a port");
    let http = format!("http://{address}/a.tif");
    let cache = cache.display();
    vec![
        "MEM:::DATAPOINTER=4096,PIXELS=200,LINES=200,BANDS=1,DATATYPE=Byte".to_owned(),
        http.clone(),
        format!("{http}?DODS"),
        format!("/vsicurl/{http}"),
        format!("/vsicurl_streaming/{http}"),
        "/vsis3/bucket/a.tif".to_owned(),
        format!("WMTS:{http}"),
        format!("WMS:{http}"),
        format!("STACIT:\"{http}\""),
        format!("ZARR:\"/vsicurl/{http}\""),
        format!("PG:host={host} port={port} dbname=a user=a"),
        format!(
            "<GDAL_WMS><Service name=\"TMS\"><ServerUrl>http://{address}/${{z}}/${{x}}/${{y}}.png</ServerUrl></Service><DataWindow>\
             <UpperLeftX>0</UpperLeftX><UpperLeftY>0</UpperLeftY><LowerRightX>200</LowerRightX><LowerRightY>-200</LowerRightY>\
             <SizeX>200</SizeX><SizeY>200</SizeY><TileLevel>0</TileLevel></DataWindow><Projection>EPSG:3857</Projection>\
             <BlockSizeX>256</BlockSizeX><BlockSizeY>256</BlockSizeY><BandsCount>1</BandsCount>\
             <Cache><Path>{cache}</Path><Extension>.php</Extension></Cache></GDAL_WMS>"
        ),
        virtual_text(&format!("/vsicurl_streaming/{http}")),
    ]
}

/// Images of more than 320 pixels a side are averaged where no altitude is given, and GDAL would look for overviews.
#[test]
fn overviews_that_a_file_names_are_never_opened() {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a free port");
    listener.set_nonblocking(true).expect("asked, not waited for");
    let address = listener.local_addr().expect("bound").to_string();
    let home = tempdir().expect("a temporary folder");
    let (scene, cache) = (home.path().join("scene"), home.path().join("cache"));
    std::fs::create_dir(&scene).expect("made");
    averaged_views(&scene);
    let escaped = |text: &str| text.replace('&', "&amp;").replace('<', "&lt;").replace('"', "&quot;");
    let inspected = |source: &str, place: &str| {
        let seen = measured::run(&inspect(&scene), LONGEST);
        assert!(
            matches!(seen.code, Some(0 | 2)),
            "{source} in {place}: {:?} {}",
            seen.code,
            seen.stderr
        );
        let called = listener.accept().map(|(_, from)| from);
        assert!(called.is_err(), "{source} in {place}: called from {called:?}");
        assert!(!cache.exists(), "{source} in {place}: written outside");
    };
    for source in foreign_overviews(&address, &cache) {
        name_overviews(&scene.join("view_0.tif"), &source);
        let sidecar = format!(
            "<PAMDataset><Metadata domain=\"OVERVIEWS\"><MDI key=\"OVERVIEW_FILE\">{}</MDI></Metadata></PAMDataset>",
            escaped(&source)
        );
        std::fs::write(scene.join("view_1.tif.aux.xml"), sidecar).expect("written");
        let stands_in_a_virtual_raster = virtual_text(&escaped(&source));
        for end in ["ovr", "msk"] {
            std::fs::write(scene.join(format!("view_2.tif.{end}")), &stands_in_a_virtual_raster).expect("written");
        }
        inspected(&source, "a tag, a sidecar and a virtual raster");
    }
}

/// A kind of file that never ends, and how it is made.
type Kind = (&'static str, fn(&Path));

/// GDAL opens the sidecars of an image by itself: it waits for pipes, and reads texts whole.
#[test]
fn files_beside_an_image_that_never_end_are_refused_in_seconds_and_in_little_memory() {
    let kinds: [Kind; 3] = [
        ("pipe", pipe),
        ("device", |path| symlink("/dev/zero", path).expect("linked")),
        ("sparse", |path| {
            let file = std::fs::File::create(path).expect("created");
            file.set_len(4 << 30).expect("a sparse file");
        }),
    ];
    for name in [
        "view_0.tif.aux.xml",
        "view_0.aux",
        "view_1.IMD",
        "view_1.RPB",
        "view_0_RPC.TXT",
        "view_1.xml",
        "view_0.tfw",
        "view_0.tab",
        "view_0_metadata.txt",
        "METADATA.DIM",
        "view_0.tif.msk",
        "view_0.tif.ovr",
    ] {
        for (kind, make) in kinds {
            let home = tempdir().expect("a temporary folder");
            two_views(home.path());
            make(&home.path().join(name));
            let seen = measured::run(&inspect(home.path()), LONGEST);
            let refused = seen.code == Some(2) && seen.stderr.contains(name);
            let harmless = kind == "sparse" && seen.code == Some(0);
            assert!(refused || harmless, "{kind} {name}: {:?} {}", seen.code, seen.stderr);
            let mib = seen.peak_bytes >> 20;
            assert!(
                seen.peak_bytes < PEAK_MAX && seen.took < LONGEST,
                "{kind} {name}: {mib} MiB, {:?}",
                seen.took
            );
        }
    }
}

/// A log that cannot be written is no reason to stop.
#[test]
fn a_training_whose_log_cannot_be_written_ends_well() {
    let home = tempdir().expect("a temporary folder");
    two_views(home.path());
    let run = home.path().join("run");
    let full = std::fs::File::options()
        .write(true)
        .open("/dev/full")
        .expect("a device");
    let (closed, open) = std::io::pipe().expect("a pipe");
    drop(closed);
    for stderr in [std::process::Stdio::from(full), open.into()] {
        let status = Command::new(binary())
            .arg("train")
            .arg(home.path())
            .arg("--out")
            .arg(&run)
            .args([
                "--preset",
                "preview",
                "--altitude",
                "690,710",
                "--set",
                "train.iterations=1",
            ])
            .stdout(std::process::Stdio::null())
            .stderr(stderr)
            .status()
            .expect("the program runs");
        assert_eq!(status.code(), Some(0));
        assert!(run.join("model.json").is_file());
        std::fs::remove_dir_all(&run).expect("removed");
    }
}

/// Numbers that mean nothing, or more than any machine has.
#[test]
fn numbers_without_sense_are_refused_in_one_line() {
    let home = tempdir().expect("a temporary folder");
    two_views(home.path());
    let scene = home.path().display();
    let out = home.path().join("out");
    let out = out.display();
    let train = format!("train {scene} --out {out} --preset preview --altitude 690,710");
    for (words, said) in [
        (format!("inspect {scene} --threads 1000000"), "--threads"),
        (format!("{train} --set start.cell_gsd=1e-9"), "start.cell_gsd"),
        (format!("{train} --set start.cell_gsd=1e-3"), "start.cell_gsd"),
        (format!("{train} --set start.cell_gsd=1e4"), "start.cell_gsd"),
        (format!("{train} --set start.cell_gsd=1e300"), "start.cell_gsd"),
        (
            format!("dsm {scene} --from sweep --altitude 690,710 --out {out}.tif --gsd 1e-9"),
            "too large",
        ),
        (format!("relight {scene} --out {out}.tif --sun=250,95"), "--sun"),
        (format!("products {scene} --out {out} --sun=1e9,40"), "--sun"),
        (format!("export {scene} --ply {out}.ply --sun=250,91"), "--sun"),
        (
            format!("synth satellite --out {out} --views 1000000000000"),
            "views; ask for",
        ),
        (
            format!("synth satellite --out {out} --size 1000000000000"),
            "px; ask for",
        ),
    ] {
        let arguments: Vec<&str> = words.split(' ').collect();
        let seen = measured::run(&arguments, LONGEST);
        assert_eq!(seen.code, Some(2), "{words}: {}", seen.stderr);
        let line = seen
            .stderr
            .lines()
            .find(|line| line.starts_with("error: "))
            .unwrap_or_default();
        assert!(line.contains(said), "{words}: {}", seen.stderr);
        assert!(
            seen.peak_bytes < PEAK_MAX && !seen.stderr.contains("panicked"),
            "{words}"
        );
    }
}

/// A failed write loses the result, and the exit code reports it.
#[test]
fn a_result_that_cannot_be_written_to_stdout_is_a_failure() {
    let full = std::fs::File::options()
        .write(true)
        .open("/dev/full")
        .expect("a device");
    let words = ["sun", "--time", "2016-04-23T08:34:00Z", "--at", "37.58,36.91"];
    let status = Command::new(binary())
        .args(words)
        .stdout(full)
        .status()
        .expect("the program runs");
    assert_eq!(status.code(), Some(1));
}

/// A line of standard input has an end.
#[test]
fn a_line_without_an_end_is_refused_in_little_memory() {
    let home = tempdir().expect("a temporary folder");
    two_views(home.path());
    let zeros = std::fs::File::open("/dev/zero").expect("a device");
    let image = home.path().join("view_0.tif");
    let output = Command::new(binary())
        .args(["rpc", "project"])
        .arg(image)
        .stdin(zeros)
        .output()
        .expect("the program runs");
    assert_eq!(output.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&output.stderr).contains("stdin line 1"));
}

/// A training without a map would fail when it is over.
#[test]
fn a_missing_database_of_coordinate_systems_is_found_before_training() {
    let home = tempdir().expect("a temporary folder");
    two_views(home.path());
    let run = home.path().join("run");
    let mut command = Command::new(binary());
    command
        .arg("train")
        .arg(home.path())
        .arg("--out")
        .arg(&run)
        .env("PROJ_LIB", home.path());
    let output = command
        .args(["--preset", "preview", "--altitude", "690,710"])
        .output()
        .expect("the program runs");
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(
        stderr.contains("PROJ's database") && stderr.contains("PROJ_LIB"),
        "{stderr}"
    );
    assert!(!run.exists(), "no run is begun");
}

/// Terminals obey control characters; an error names files as they can be shown.
#[test]
fn control_characters_of_names_do_not_reach_the_terminal() {
    let home = tempdir().expect("a temporary folder");
    two_views(home.path());
    std::fs::write(home.path().join("a\x1b]0;owned\x07.tif"), "no image").expect("written");
    let seen = measured::run(&inspect(home.path()), LONGEST);
    assert_eq!(seen.code, Some(2), "{}", seen.stderr);
    assert!(seen.stderr.contains("owned"), "{}", seen.stderr);
    for text in [&seen.stderr, &seen.stdout] {
        assert!(!text.contains(['\x1b', '\x07']), "{text:?}");
    }
}

/// Every way that was thought of to make GDAL call an address.
#[test]
fn no_address_is_called_that_a_file_names() {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a free port");
    listener.set_nonblocking(true).expect("asked, not waited for");
    let address = format!("http://{}/a.tif", listener.local_addr().expect("bound"));
    let home = tempdir().expect("a temporary folder");
    two_views(home.path());
    let remote = format!("/vsicurl/{address}");
    // A sidecar may name any file for the overviews and masks of an image.
    let sidecar = format!(
        "<PAMDataset><Metadata domain=\"OVERVIEWS\"><MDI key=\"OVERVIEW_FILE\">{remote}</MDI></Metadata></PAMDataset>"
    );
    std::fs::write(home.path().join("view_0.tif.aux.xml"), sidecar).expect("written");
    std::fs::write(home.path().join("view_1.tif.ovr"), virtual_text(&remote)).expect("written");
    let mask = home.path().join("view_1.tif.msk");
    std::fs::write(&mask, virtual_text(&remote)).expect("written");
    let seen = measured::run(&inspect(home.path()), LONGEST);
    assert_eq!(seen.code, Some(2), "{}", seen.stderr);
    assert!(seen.stderr.contains("view_1.tif.msk"), "{}", seen.stderr);
    std::fs::remove_file(&mask).expect("removed");
    let seen = measured::run(&inspect(home.path()), LONGEST);
    assert_eq!(seen.code, Some(0), "{}", seen.stderr);
    for (name, text) in [
        ("a.tif", virtual_text(&remote)),
        (
            "a.tif",
            format!("<GDAL_WMS><Service name=\"TMS\"><ServerUrl>{address}</ServerUrl></Service></GDAL_WMS>"),
        ),
        ("a.tif", remote.clone()),
    ] {
        let mut file = std::fs::File::create(home.path().join(name)).expect("created");
        file.write_all(text.as_bytes()).expect("written");
        let seen = measured::run(&inspect(home.path()), LONGEST);
        assert_eq!(seen.code, Some(2), "{}", seen.stderr);
    }
    assert_eq!(measured::run(&["inspect".to_owned(), address], LONGEST).code, Some(2));
    let called = listener.accept().map(|(_, from)| from);
    assert!(called.is_err(), "called from {called:?}");
}
