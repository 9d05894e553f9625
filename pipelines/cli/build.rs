//! Sets `HELIOSPLAT_SOURCE` in release builds of a checkout to the last commit that changed the program, with `+` after
//! uncommitted changes. Other builds are identified only by their hash (`pipelines/fitting/src/program.rs`).

use std::path::Path;
use std::process::Command;

/// Sources of the program, relative to the root of the checkout.
const SOURCES: [&str; 7] = [
    "Cargo.lock",
    "Cargo.toml",
    "bin",
    "data-synth",
    "pipelines",
    "rpc",
    "src",
];

fn main() {
    println!("cargo:rerun-if-changed=build.rs");
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let is_release = std::env::var_os("PROFILE").is_some_and(|profile| profile == "release");
    if !is_release || !SOURCES.iter().all(|source| root.join(source).exists()) {
        return;
    }
    let git = |words: &[&str], paths: &[&str]| {
        let output = Command::new("git")
            .args(words)
            .args(paths)
            .current_dir(&root)
            .output()
            .ok()?;
        let text = String::from_utf8(output.stdout).ok()?;
        output.status.success().then(|| text.trim().to_owned())
    };
    let Some(commit) = git(&["log", "-1", "--format=%h", "--"], &SOURCES).filter(|commit| !commit.is_empty()) else {
        return;
    };
    let changed = git(&["status", "--porcelain", "--"], &SOURCES).is_none_or(|files| !files.is_empty());
    println!(
        "cargo:rustc-env=HELIOSPLAT_SOURCE={commit}{}",
        if changed { "+" } else { "" }
    );
    for source in SOURCES {
        println!("cargo:rerun-if-changed={}", root.join(source).display());
    }
    if let Some(log) = git(&["rev-parse", "--git-path", "logs/HEAD"], &[]) {
        println!("cargo:rerun-if-changed={}", root.join(log).display());
    }
}
