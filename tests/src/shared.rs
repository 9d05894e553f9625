//! Real images and golden values that are not part of the repository.

use std::path::{Path, PathBuf};

/// A file or folder of the shared material: in `$HELIOSPLAT_SHARED` or in `shared` next to the workspace. Returns
/// `None` with a message where it is missing; with `HELIOSPLAT_REQUIRE_SHARED=1` that is a failure.
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
