//! What the command line says of itself to shells and to `man`.

use heliosplat_tests::program::{heliosplat, json};
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
    assert_eq!(completed("heliosplat tra"), "train tradeoff");
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
