//! Build of the running program: part of the identity of runs, checkpoints and units of a batch.

use crate::request::TrainRequest;
use heliosplat::train::STATE_VERSION;
use heliosplat_raster::sha256;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

/// Digits of a build's name.
const DIGITS: usize = 16;

static BUILD: OnceLock<String> = OnceLock::new();

/// First digits of the SHA-256 of the running executable, hexadecimal; computed once. `unknown` where the executable
/// cannot be read.
pub fn build() -> &'static str {
    BUILD.get_or_init(|| {
        let sum = sha256::of_file(&executable());
        sum.map_or_else(|_| "unknown".to_owned(), |sum| sum.chars().take(DIGITS).collect())
    })
}

/// Sets the build to the one that another process computed for the same executable. This avoids hashing the executable,
/// which has more bytes than most units of a batch read.
pub fn recall_build(build: String) {
    BUILD.get_or_init(|| build);
}

/// Path of the executable. On Linux it leads to the running program even after its file was replaced.
pub fn executable() -> PathBuf {
    let running = Path::new("/proc/self/exe");
    match running.exists() {
        true => running.to_owned(),
        false => std::env::current_exe().unwrap_or_default(),
    }
}

/// The first line of every identity: version, build, and the format of a training's state.
pub fn identity_of_program() -> String {
    let version = env!("CARGO_PKG_VERSION");
    format!("heliosplat {version}, build {}, state {STATE_VERSION}\n", build())
}

/// The first lines of the identity of a training: the program, the limits of the request, and the settings, which are
/// `config` in TOML.
pub fn identity_of_training(request: &TrainRequest, seed: u64, config: &str) -> String {
    let (program, limit, memory) = (identity_of_program(), request.time_budget, request.memory);
    let device = request.device.name();
    format!("{program}--device {device}\n--time-budget {limit:?}\n--memory {memory:?}\nseed = {seed}\n{config}\n")
}
