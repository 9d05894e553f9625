//! Inputs that somebody made to do harm: each gets one line that says what is wrong with it, exit code 2, in seconds and in little
//! memory. Nothing outside of `--out` is written, and no address is called.

use heliosplat_tests::measured::{self, Measured};
use heliosplat_tests::program::{binary, json};
use heliosplat_tests::scenes::{View, write_scene};
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

/// A hostile input: its name, how it is made in an empty folder (which gives the arguments), and what the refusal says.
struct Case(&'static str, fn(&Path) -> Vec<OsString>, &'static str);

const CASES: [Case; 32] = [
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
    Case("an XML bomb for a camera", xml_bomb, "view_1"),
    Case("a camera of no numbers", rpc_nan, "view_1"),
    Case("a camera of huge numbers", rpc_huge, "view_1"),
    Case("metadata of a gigabyte", metadata_long, "more than"),
    Case("a name that is not UTF-8", name_not_utf8, "not an image"),
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

/// Two sound views, of which the second may be spoilt.
fn two_views(home: &Path) {
    write_scene(home, &[View::new(0), View::new(1)]);
}

/// Two sound views, and a third that has a camera in a JSON beside it and still needs its image.
fn missing_image(home: &Path) -> PathBuf {
    write_scene(home, &[View::new(0), View::new(1), View::new(2)]);
    let path = home.join("view_2.tif");
    std::fs::remove_file(&path).expect("removed");
    path
}

/// Two sound views, of which the second has no camera yet.
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
    std::fs::create_dir(home.join("points.toml")).expect("made");
    let mut arguments: Vec<OsString> = ["tradeoff".into(), home.into(), "--out".into(), home.join("out").into()].into();
    arguments.extend(["--points".into(), home.join("points.toml").into()]);
    arguments
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

/// A TIFF of one strip that claims to be larger than it is.
fn tiff(path: &Path, side: u32) {
    let entry = |tag: u16, kind: u16, value: u32| {
        let mut bytes = [tag.to_le_bytes(), kind.to_le_bytes()].concat();
        bytes.extend_from_slice(&1u32.to_le_bytes());
        bytes.extend_from_slice(&value.to_le_bytes());
        bytes
    };
    // Width, height, bits, deflate, grey, where the strip is, one band, rows per strip, length of the strip.
    let entries = [
        entry(256, 4, side),
        entry(257, 4, side),
        entry(258, 3, 8),
        entry(259, 3, 8),
        entry(262, 3, 1),
        entry(273, 4, 8),
        entry(277, 3, 1),
        entry(278, 4, 1),
        entry(279, 4, 8),
    ];
    let mut bytes = b"II*\0\x10\0\0\0\x78\x9c\x03\0\0\0\0\x01".to_vec();
    bytes.extend_from_slice(&(entries.len() as u16).to_le_bytes());
    bytes.extend(entries.concat());
    bytes.extend_from_slice(&[0; 4]);
    std::fs::write(path, bytes).expect("written");
}

fn tiff_of_a_trillion(home: &Path) -> Vec<OsString> {
    surface_of(home, 1_000_000)
}

fn tiff_of_more(home: &Path) -> Vec<OsString> {
    surface_of(home, 30_000)
}

/// A surface model that claims to be larger than it is, measured against itself.
fn surface_of(home: &Path, side: u32) -> Vec<OsString> {
    let path = home.join("dsm.tif");
    tiff(&path, side);
    std::fs::write(home.join("dsm.tfw"), "0.5\n0\n0\n-0.5\n312000\n4160000\n").expect("written");
    [
        "evaluate".into(),
        "--dsm".into(),
        path.clone().into(),
        "--truth".into(),
        path.into(),
    ]
    .into()
}

fn tiff_in_a_scene(home: &Path) -> Vec<OsString> {
    tiff(&missing_image(home), 1_000_000);
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

/// Every way that was thought of to make GDAL call an address.
#[test]
fn no_address_is_called_that_a_file_names() {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a free port");
    listener.set_nonblocking(true).expect("asked, not waited for");
    let address = format!("http://{}/a.tif", listener.local_addr().expect("bound"));
    let home = tempdir().expect("a temporary folder");
    two_views(home.path());
    let remote = format!("/vsicurl/{address}");
    // Overviews and masks beside an image may stand in any file that its sidecar names.
    let sidecar = format!(
        "<PAMDataset><Metadata domain=\"OVERVIEWS\"><MDI key=\"OVERVIEW_FILE\">{remote}</MDI></Metadata></PAMDataset>"
    );
    std::fs::write(home.path().join("view_0.tif.aux.xml"), sidecar).expect("written");
    std::fs::write(home.path().join("view_1.tif.ovr"), virtual_text(&remote)).expect("written");
    std::fs::write(home.path().join("view_1.tif.msk"), virtual_text(&remote)).expect("written");
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
