//! Running the program `heliosplat` from tests.

use assert_cmd::Command;
use std::path::{Path, PathBuf};
use std::sync::LazyLock;

/// The program, built once per test process, because cargo does not build binaries of other packages for a test.
/// `HELIOSPLAT_BIN` names another one. It is built together with an example, so that cargo selects the features that
/// dependencies have in tests; else it would compile the whole workspace a second time.
static BINARY: LazyLock<PathBuf> = LazyLock::new(|| match std::env::var_os("HELIOSPLAT_BIN") {
    Some(path) => path.into(),
    None => {
        let built = build(&["--bin", "heliosplat", "--example", "project_points"]);
        let program = built
            .into_iter()
            .find(|path| path.file_stem().is_some_and(|stem| stem == "heliosplat"));
        program.expect("cargo names the program")
    }
});

/// The programs in the folder `examples`, built as the binary is: `cargo test --test examples` alone would not build
/// them.
static EXAMPLES: LazyLock<Vec<PathBuf>> = LazyLock::new(|| build(&["--examples"]));

/// Builds at least one program of the workspace and returns the paths. The packages are those of the tests, so that
/// nothing is compiled twice.
fn build(which: &[&str]) -> Vec<PathBuf> {
    let workspace = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let cargo = std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
    let output = std::process::Command::new(cargo)
        .current_dir(workspace)
        .args([
            "build",
            "--profile",
            "test",
            "--workspace",
            "--exclude",
            "heliosplat-python",
        ])
        .args(which)
        .args(cfg!(feature = "gpu").then_some("--features=gpu"))
        .args(["--message-format", "json-render-diagnostics"])
        .output()
        .expect("cargo runs");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let messages = String::from_utf8_lossy(&output.stdout).into_owned();
    let executables: Vec<PathBuf> = messages
        .lines()
        .filter_map(|line| serde_json::from_str::<serde_json::Value>(line).ok())
        .filter_map(|message| message["executable"].as_str().map(PathBuf::from))
        .collect();
    assert!(!executables.is_empty(), "cargo names what it built");
    executables
}

/// Command of a program of the folder `examples` with its arguments.
pub fn example<S: AsRef<std::ffi::OsStr>>(name: &str, arguments: &[S]) -> Command {
    let found = EXAMPLES
        .iter()
        .find(|path| path.file_stem().is_some_and(|stem| stem == name));
    let mut command = Command::new(found.expect("an example of this name"));
    command.args(arguments);
    command
}

/// Path of the program `heliosplat`.
pub fn binary() -> &'static Path {
    &BINARY
}

/// Command of the program `heliosplat` with its arguments, without the variables for logs and SIMD.
pub fn heliosplat<S: AsRef<std::ffi::OsStr>>(arguments: &[S]) -> Command {
    let mut command = Command::new(binary());
    command
        .args(arguments)
        // Without it the library of software Vulkan writes an error of its own.
        .env("XDG_RUNTIME_DIR", std::env::temp_dir())
        .env_remove("HELIOSPLAT_LOG")
        .env_remove("HELIOSPLAT_SIMD");
    command
}

/// Runs the program with `--json` and parses the one object that it prints; panics when it fails.
pub fn json<S: AsRef<std::ffi::OsStr>>(arguments: &[S]) -> serde_json::Value {
    let output = heliosplat(arguments).arg("--json").assert().success();
    serde_json::from_slice(&output.get_output().stdout).expect("one JSON object on stdout")
}

/// Synthesises a scene of the tiny site with four views in `folder`.
pub fn tiny_scene(folder: &Path) {
    let out = folder.display().to_string();
    let words = "synth satellite --site tiny --seed 5 --views 4 --out";
    json(&words.split(' ').chain([out.as_str()]).collect::<Vec<_>>());
}

/// Runs the program and returns its one line of error; panics when it does not fail with `exit_code`.
pub fn fault<S: AsRef<std::ffi::OsStr>>(arguments: &[S], exit_code: i32) -> String {
    let assert = heliosplat(arguments).assert().code(exit_code);
    let output = assert.get_output();
    assert!(output.stdout.is_empty(), "nothing on stdout");
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    let errors: Vec<&str> = text.lines().filter(|line| line.starts_with("error: ")).collect();
    assert_eq!(errors.len(), 1, "one line of error in:\n{text}");
    assert!(!text.contains("panicked"), "{text}");
    errors[0].to_owned()
}
