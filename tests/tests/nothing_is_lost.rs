//! Existing files in folders: inputs are never replaced, results of two commands never mixed, and failed writes are
//! reported.

use heliosplat_tests::program::{binary, fault, heliosplat, json, tiny_scene};
use std::collections::BTreeMap;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::LazyLock;
use tempfile::{TempDir, tempdir};

/// A scene with truth, and a run of one step on it.
static HOME: LazyLock<TempDir> = LazyLock::new(|| {
    let home = tempdir().expect("a temporary folder");
    tiny_scene(&home.path().join("S"));
    json(&training(home.path(), "R", &[]));
    home
});

fn training(home: &Path, run: &str, more: &[&str]) -> Vec<String> {
    let words = "train S --preset preview --set train.iterations=1 --out";
    let words = words.split(' ').chain([run]).chain(more.iter().copied());
    words.map(|word| in_folder(home, word)).collect()
}

/// `S` and `R` and paths below them, as a path.
fn in_folder(home: &Path, word: &str) -> String {
    match word.split('/').next() {
        Some("S" | "R" | "out") => home.join(word).display().to_string(),
        _ => word.to_owned(),
    }
}

/// A copy of the scene and the run, as if the run had been trained on the copy.
fn copy() -> TempDir {
    let copy = tempdir().expect("a temporary folder");
    let done = Command::new("cp")
        .arg("-r")
        .args(["S", "R"].map(|name| HOME.path().join(name)))
        .arg(copy.path())
        .status();
    assert!(done.is_ok_and(|status| status.success()));
    let [from, to] = [HOME.path(), copy.path()].map(|path| path.display().to_string());
    for name in ["R/run.toml", "R/cut.json"] {
        let path = copy.path().join(name);
        let text = std::fs::read_to_string(&path).expect("readable");
        std::fs::write(&path, text.replace(&from, &to)).expect("written");
    }
    copy
}

/// All files below a folder with their bytes.
fn files(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let (mut found, mut open) = (BTreeMap::new(), vec![folder.to_owned()]);
    while let Some(folder) = open.pop() {
        for entry in std::fs::read_dir(&folder).expect("listable").flatten() {
            match entry.path() {
                path if path.is_dir() => open.push(path),
                path => drop(found.insert(path.clone(), std::fs::read(&path).expect("readable"))),
            }
        }
    }
    found
}

/// Any image of the scene, below its folder.
fn image(home: &Path) -> String {
    let image = files(&home.join("S")).into_keys().find(|path| {
        path.extension().is_some_and(|extension| extension == "tif") && !path.display().to_string().contains("truth")
    });
    let image = image.expect("an image");
    image.strip_prefix(home).expect("below").display().to_string()
}

#[test]
fn no_output_takes_the_place_of_an_input() {
    let home = copy();
    let image = image(home.path());
    let folder = Path::new(&image).parent().expect("a folder").display().to_string();
    std::os::unix::fs::symlink(home.path().join("R/model.ply"), home.path().join("R/link.ply")).expect("linked");
    let before = files(home.path());
    for line in [
        format!("adjust S --images --out {folder}"),
        format!("adjust S --out {folder}"),
        format!("train S --preset preview --out {folder}"),
        format!("dsm S --from sweep --out {image}"),
        format!("dsm R --out {image}"),
        format!("render R --split all --out {folder}"),
        format!("relight R --sun 250,35 --out {image}"),
        format!("products R --out {folder}"),
        "render R --split all --out R".into(),
        "products R --out R".into(),
        "export R --ply R/model.ply".into(),
        "export R --ply R/link.ply".into(),
        "export R --tiles R".into(),
        "dsm R --out R/model.json".into(),
        "view R --out R/model.json".into(),
        format!("view --dsm {image} --albedo {image} --out {image}"),
    ] {
        let words: Vec<String> = line.split(' ').map(|word| in_folder(home.path(), word)).collect();
        fault(&words, 2);
        assert!(files(home.path()) == before, "{line}");
    }
}

#[test]
fn nothing_of_a_run_that_is_replaced_is_taken_for_the_new_one() {
    let home = copy();
    let run = home.path().join("R");
    for name in ["error.tif", "error.png", "calibration.svg"] {
        assert!(run.join(name).is_file(), "a run with truth has {name}");
    }
    std::fs::write(run.join("views/old.png"), "an image of the scene before").expect("written");
    std::fs::write(run.join("change.tif"), "of the scene before").expect("written");
    let truth = home.path().join("S/truth");
    std::fs::remove_dir_all(truth).expect("the truth of the scene");
    fault(&training(home.path(), "R", &[]), 2);
    assert!(run.join("error.tif").is_file(), "refused before anything is touched");
    json(&training(home.path(), "R", &["--overwrite"]));
    for name in [
        "error.tif",
        "error.png",
        "calibration.svg",
        "change.tif",
        "views/old.png",
        ".lock",
    ] {
        assert!(!run.join(name).exists(), "{name}");
    }
    let page = |name: &str| std::fs::read_to_string(run.join(name)).expect("a page");
    assert!(!page("report.html").contains("Height errors"));
    assert!(!page("sun.html").contains("Height errors against truth"));
}

#[test]
fn products_that_are_not_whole_have_no_item() {
    let home = copy();
    let run = in_folder(home.path(), "R");
    let products = home.path().join("R/products");
    json(&["products", &run]);
    let item = products.join("item.json");
    assert!(item.is_file());
    // A folder in its place, that no file can replace, stops the second set half-way.
    std::fs::remove_file(products.join("points.laz")).expect("removed");
    std::fs::create_dir(products.join("points.laz")).expect("made");
    fault(&["products", &run, "--sun", "100,50"], 1);
    assert!(!item.exists());
}

#[test]
fn a_damaged_model_is_refused_in_one_line() {
    let home = copy();
    let out = in_folder(home.path(), "out/x.tif");
    let run = in_folder(home.path(), "R");
    let [ply, json] = ["R/model.ply", "R/model.json"].map(|name| home.path().join(name));
    let whole = std::fs::read(&ply).expect("readable");
    let mut damaged = whole.clone();
    let middle = damaged.len() / 2;
    damaged[middle] ^= 64;
    std::fs::write(&ply, &damaged).expect("written");
    let line = fault(&["dsm", &run, "--out", &out], 2);
    assert!(line.contains("model.ply") && line.contains("SHA-256"), "{line}");
    std::fs::write(&ply, &whole).expect("written");
    std::fs::write(&json, [b'{', 0xff, b'}']).expect("written");
    let line = fault(&["dsm", &run, "--out", &out], 2);
    assert!(line.contains("model.json") && line.contains("UTF-8"), "{line}");
}

#[test]
fn an_extension_without_a_format_and_a_sun_beyond_the_zenith_are_refused() {
    let run = in_folder(HOME.path(), "R");
    for line in [
        "dsm R --out out/x.jpg",
        "relight R --sun 250,35 --out out/x",
        "relight R --sun 250,35 --out out/x.webp",
        "view R --out out/x.pdf",
        "evaluate R --error-map out/x.tif",
        "relight R --sun 250,95 --out out/x.tif",
        "relight R --sun 1e9,40 --out out/x.tif",
        "products R --sun 250,95 --out out",
        "export R --sun 250,180 --ply out/x.ply",
    ] {
        let words: Vec<String> = line.split(' ').map(|word| in_folder(HOME.path(), word)).collect();
        heliosplat(&words).assert().code(2);
    }
    let manifest = tempdir().expect("a temporary folder");
    let image = HOME.path().join(image(HOME.path())).display().to_string();
    let text = format!("[[images]]\npath = \"{image}\"\nsun_azimuth_deg = 10\nsun_elevation_deg = 95\n");
    std::fs::write(manifest.path().join("scene.toml"), text).expect("written");
    let line = fault(&["inspect".into(), manifest.path().display().to_string()], 2);
    assert!(line.contains("scene.toml") && line.contains("95"), "{line}");
    assert!(Path::new(&run).is_dir() && !HOME.path().join("out").exists());
}

#[test]
fn a_result_that_cannot_be_written_to_stdout_is_exit_code_1() {
    let Ok(full) = std::fs::OpenOptions::new().write(true).open("/dev/full") else {
        return;
    };
    for line in [
        "sun --time 2016-04-23T08:34:00Z --at 37.58,36.91",
        "--version",
        "completions bash",
    ] {
        let stdout = full.try_clone().expect("a second handle");
        let output = Command::new(binary()).args(line.split(' ')).stdout(stdout).output();
        let output = output.expect("starts");
        assert_eq!(output.status.code(), Some(1), "{line}");
    }
}

#[test]
fn the_first_ctrl_c_ends_what_has_nothing_to_save() {
    let home = tempdir().expect("a temporary folder");
    let line = "dsm S --from sweep --threads 1 --out";
    let words = line.split(' ').map(|word| in_folder(HOME.path(), word));
    let out = home.path().join("x.tif");
    let mut child = Command::new(binary())
        .args(words)
        .arg(&out)
        .env("HELIOSPLAT_PROGRESS", "lines")
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .expect("starts");
    let said = BufReader::new(child.stderr.take().expect("piped"));
    // The sweep has begun.
    let begun = said
        .lines()
        .map_while(Result::ok)
        .find(|line| line.starts_with("progress "));
    assert!(begun.is_some());
    let sent = Command::new("kill").args(["-INT", &child.id().to_string()]).status();
    assert!(sent.is_ok_and(|status| status.success()));
    assert_eq!(child.wait().expect("ends").code(), Some(130));
    assert!(!out.exists());
}
