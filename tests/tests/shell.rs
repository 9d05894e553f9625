//! Descriptions of the command line for shells and for `man`.

use heliosplat_tests::program::{heliosplat, json};
use heliosplat_tests::scenes::{View, write_scene};
use std::path::Path;
use tempfile::tempdir;

/// The verbs, as `--help` lists them.
fn verbs() -> Vec<String> {
    let output = heliosplat(&["--help"]).assert().success();
    let help = String::from_utf8_lossy(&output.get_output().stdout).into_owned();
    let list = help.split("Commands:\n").nth(1).expect("a list of verbs");
    let first_word = |line: &str| line.split_whitespace().next().map(str::to_owned);
    let verbs: Vec<_> = list
        .lines()
        .map_while(first_word)
        .filter(|verb| verb != "help")
        .collect();
    assert!(verbs.len() > 15 && verbs.contains(&"train".to_owned()), "{verbs:?}");
    verbs
}

#[test]
fn bash_accepts_its_completions_and_completes_an_option_and_its_values() {
    let output = heliosplat(&["completions", "bash"]).assert().success();
    let folder = tempdir().expect("a folder");
    let script = folder.path().join("heliosplat.bash");
    std::fs::write(&script, &output.get_output().stdout).expect("written");
    assert_cmd::Command::new("bash")
        .arg("-n")
        .arg(&script)
        .assert()
        .success();

    let completed = |words: &str| {
        let count = words.split(' ').count();
        let ask = format!(
            "source '{}'; COMP_WORDS=({words}); COMP_CWORD={}; _heliosplat heliosplat \"${{COMP_WORDS[-1]}}\" \
             \"${{COMP_WORDS[-2]}}\"; echo \"${{COMPREPLY[*]}}\"",
            script.display(),
            count - 1
        );
        let output = assert_cmd::Command::new("bash").arg("-c").arg(ask).assert().success();
        String::from_utf8_lossy(&output.get_output().stdout).trim().to_owned()
    };
    assert_eq!(completed("heliosplat tra"), "train");
    assert_eq!(completed("heliosplat train --pres"), "--preset");
    assert_eq!(completed("heliosplat train --preset b"), "balanced best");
}

#[test]
fn completions_of_every_shell_name_every_verb() {
    for shell in ["bash", "zsh", "fish"] {
        let output = heliosplat(&["completions", shell]).assert().success();
        let script = String::from_utf8_lossy(&output.get_output().stdout).into_owned();
        for verb in verbs() {
            assert!(script.contains(&verb), "{shell} does not know {verb}");
        }
    }
    heliosplat(&["completions", "cmd.exe"]).assert().code(2);
}

#[test]
fn every_verb_has_a_manual_page_with_its_options_and_its_example() {
    let folder = tempdir().expect("a folder");
    let out = folder.path().join("new/man1");
    let pages = json(&["man", "--out", &out.display().to_string()])["pages"].clone();
    let read = |name: &str| {
        let path = Path::new(&out).join(name);
        std::fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
    };
    // A hyphen is `\-` in roff, so that it can be copied as one.
    let train = read("heliosplat-train.1").replace("\\-", "-");
    for word in ["--preset", "--time-budget", "balanced", "Examples: heliosplat train"] {
        assert!(train.contains(word), "{word} is not in\n{train}");
    }
    // Verbs of verbs have pages of their own.
    for name in verbs()
        .iter()
        .map(String::as_str)
        .chain(["rpc-project", "rpc-localise"])
    {
        assert!(read(&format!("heliosplat-{name}.1")).contains("Example"), "{name}");
    }
    // What is hidden from --help is hidden here.
    assert!(!read("heliosplat-batch.1").contains("attended"));
    assert!(pages.as_array().expect("a list").len() > verbs().len());
    assert!(
        !read("heliosplat.1").contains("GDAL "),
        "versions of this machine's libraries"
    );
}

/// Two images of level ground, 700 m above the ellipsoid, in a folder.
fn pair() -> (tempfile::TempDir, Vec<String>) {
    let home = tempdir().expect("a folder");
    write_scene(home.path(), &[View::new(0), View::new(1), View::new(2)]);
    let images = (0..3).map(|number| home.path().join(format!("view_{number}.tif")).display().to_string());
    let images = images.collect();
    (home, images)
}

#[test]
fn image_files_are_a_scene_and_their_surface_may_be_above_a_geoid() {
    let (home, images) = pair();
    let out = home.path().join("out");
    let words = |verb: &str, out: &[&str]| -> Vec<String> {
        let all = std::iter::once(verb).chain(images.iter().map(String::as_str));
        all.chain(out.iter().copied()).map(str::to_owned).collect()
    };
    let seen = json(&words("inspect", &[]));
    assert_eq!(seen["images"].as_array().expect("images").len(), 3);
    let [ellipsoid, geoid] = ["a.tif", "b.tif"].map(|name| out.join(name).display().to_string());
    let altitude = ["--altitude", "690,710"];
    let level = json(&words("dsm", &[&["--out", &ellipsoid][..], &altitude].concat()));
    assert_eq!(level["surface"]["above"], "WGS84 ellipsoid");
    assert!(
        level["surface"]["crs"].as_str().is_some_and(|crs| crs == "EPSG:32637"),
        "{level}"
    );
    let page = std::fs::read_to_string(out.join("a.html")).expect("a page beside the surface");
    assert_eq!(level["page"], out.join("a.html").display().to_string());
    for part in [
        "EPSG:32637",
        "above WGS84 ellipsoid",
        "Number of images that see the ground",
    ] {
        assert!(page.contains(part), "{part}");
    }
    assert!(page.matches("src=\"data:image/jpeg;base64,").count() == 3 && !page.contains("http"));
    let height = |said: &serde_json::Value| said["surface"]["heights_m"][0].as_f64().expect("a height");
    assert!((height(&level) - 700.0).abs() < 10.0, "{level}");
    if heliosplat_raster::geoid::Undulation::new(heliosplat_raster::Geoid::Egm96).is_ok() {
        let above = json(&words(
            "dsm",
            &[&["--out", &geoid, "--geoid", "egm96"][..], &altitude].concat(),
        ));
        assert_eq!(above["surface"]["above"], "EGM96");
        assert!(height(&level) - height(&above) > 10.0, "{above}");
    }
    let run = home.path().join("run");
    let run = run.display().to_string();
    let few = ["--preset", "preview", "--set", "train.iterations=2"];
    json(&words("train", &[&["--out", &run][..], &altitude, &few].concat()));
    // The run knows its images, wherever the command was given.
    json(&["evaluate", run.as_str()]);
    let log = std::fs::read_to_string(Path::new(&run).join("log.txt")).expect("a log");
    assert!(
        log.lines()
            .next()
            .is_some_and(|line| line.starts_with("20") && line.contains('Z')),
        "{log}"
    );
    let output = heliosplat(&words("inspect", &[home.path().to_str().expect("a path")]))
        .assert()
        .code(2);
    let said = String::from_utf8_lossy(&output.get_output().stderr).into_owned();
    assert!(said.contains("a folder among several images"), "{said}");
}

#[test]
fn a_training_ends_with_its_surface_and_the_next_command() {
    let (home, images) = pair();
    let run = home.path().join("run").display().to_string();
    let [a, b, c] = [0, 1, 2].map(|number: usize| images[number].as_str());
    let line = ["train", a, b, c, "--out", run.as_str(), "--altitude", "690,710"];
    let few = ["--preset", "preview", "--set", "train.iterations=2"];
    let output = heliosplat(&[&line[..], &few, &["--quiet"]].concat()).assert().success();
    let text = String::from_utf8_lossy(&output.get_output().stdout).into_owned();
    for said in [
        "run/dsm.tif",
        "EPSG:32637",
        "% of the ground known",
        "above the WGS84 ellipsoid",
        "report.html",
        "heliosplat products",
    ] {
        assert!(text.contains(said), "{said}: {text}");
    }
    assert!(!text.contains("Gaussians") && !text.contains("PSNR"), "{text}");
    let log = String::from_utf8_lossy(&output.get_output().stderr).into_owned();
    assert!(!log.contains("INFO"), "{log}");
}

#[test]
fn faults_of_arguments_are_json_too() {
    let output = heliosplat(&["sun", "--json", "--time", "bad", "--place", "1,2"])
        .assert()
        .code(2);
    let said: serde_json::Value = serde_json::from_slice(&output.get_output().stdout).expect("JSON");
    assert_eq!(said["exit_code"], 2);
    assert!(
        said["error"].as_str().is_some_and(|error| error.contains("bad")),
        "{said}"
    );
    let help = heliosplat(&["--help", "--json"]).assert().success();
    assert!(String::from_utf8_lossy(&help.get_output().stdout).contains("Commands:"));
}
