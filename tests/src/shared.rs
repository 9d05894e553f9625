//! Real images and golden values that are not part of the repository.

use std::path::{Path, PathBuf};

/// Path of a file or folder of the shared material, in `$HELIOSPLAT_SHARED` or in `shared` next to the workspace. Where
/// it is missing, the function prints a message and returns `None`; with `HELIOSPLAT_REQUIRE_SHARED=1` it panics.
pub fn shared(relative: &str) -> Option<PathBuf> {
    let root = match std::env::var_os("HELIOSPLAT_SHARED") {
        Some(root) => PathBuf::from(root),
        None => Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared"),
    };
    let path = root.join(relative);
    if path.exists() {
        return Some(path);
    }
    let required = std::env::var("HELIOSPLAT_REQUIRE_SHARED").is_ok_and(|value| value == "1");
    assert!(!required, "{} is required and not there", path.display());
    println!("skipped: no shared data");
    None
}
