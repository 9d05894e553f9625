//! Which build of the program runs: part of the identity of runs, checkpoints and units of a batch.

use heliosplat::train::STATE_VERSION;
use sha2::{Digest, Sha256};
use std::fs::File;
use std::path::Path;
use std::sync::LazyLock;

/// Digits of a build's name.
const DIGITS: usize = 16;

/// First digits of the SHA-256 of the running executable, hexadecimal; computed once. `unknown` where the executable cannot be read.
pub fn build() -> &'static str {
    static BUILD: LazyLock<String> = LazyLock::new(|| {
        let sum = executable().and_then(|mut file| {
            let mut hasher = Sha256::new();
            std::io::copy(&mut file, &mut hasher)?;
            Ok(hex::encode(hasher.finalize()))
        });
        sum.map_or_else(|_| "unknown".to_owned(), |sum| sum.chars().take(DIGITS).collect())
    });
    &BUILD
}

/// The executable; on Linux the one that runs, also after another took its place on the disk.
fn executable() -> std::io::Result<File> {
    File::open(Path::new("/proc/self/exe")).or_else(|_| File::open(std::env::current_exe()?))
}

/// The first line of every identity: version, build, and the format of a training's state.
pub fn identity_of_program() -> String {
    let version = env!("CARGO_PKG_VERSION");
    format!("heliosplat {version}, build {}, state {STATE_VERSION}\n", build())
}
