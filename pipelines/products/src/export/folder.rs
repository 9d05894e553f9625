//! A folder of tiles: earlier tiles of ours are replaced, and nothing else in the folder.
//!
//! New tiles are written beside the old ones first. While they are moved into place, `tileset.json` has no tile and
//! lists the names of our files: after an export that was killed viewers show nothing, and the next export replaces it.

use super::TILESET;
use heliosplat_exchange::tiles::GENERATOR;
use heliosplat_raster::temporary::TemporaryFolder;
use heliosplat_raster::write::remove;
use heliosplat_raster::{RasterError, bounded, write_atomically};
use serde_json::{Value, json};
use std::collections::BTreeSet;
use std::path::Path;

/// Key of a tileset that is being replaced: the names of its files.
const UNFINISHED: &str = "unfinished";

/// Runs `fill`, which writes `tileset.json` and its tiles into a temporary folder, and moves them into `folder` in
/// place of the earlier tiles; `folder` is created where it is absent.
///
/// # Errors
/// Errors of `fill`, and [`RasterError`] where the folder holds other files or cannot be written.
pub(super) fn replace<T, E: From<RasterError>>(
    folder: &Path,
    fill: impl FnOnce(&Path) -> Result<T, E>,
) -> Result<T, E> {
    let made = !folder.exists();
    let replaced = replace_in(folder, fill);
    if made && replaced.is_err() {
        // The folder is removed only if it is empty.
        let _ = std::fs::remove_dir(folder);
    }
    replaced
}

fn replace_in<T, E: From<RasterError>>(folder: &Path, fill: impl FnOnce(&Path) -> Result<T, E>) -> Result<T, E> {
    if folder.is_file() {
        return Err(occupied(folder, TILESET).into());
    }
    let new_home = TemporaryFolder::inside(folder)?;
    let old = ours(folder, new_home.path())?;
    let filled = fill(new_home.path())?;
    put(folder, &old, new_home.path())?;
    Ok(filled)
}

/// Moves the files in `from` into `folder`, whose earlier tiles have the names `old`.
fn put(folder: &Path, old: &BTreeSet<String>, from: &Path) -> Result<(), RasterError> {
    let failed = |error: std::io::Error| RasterError::from_io(folder, &error);
    let entries = std::fs::read_dir(from).map_err(failed)?;
    let names = entries.map(|entry| Ok(entry?.file_name().to_string_lossy().into_owned()));
    let new: BTreeSet<String> = names.collect::<std::io::Result<_>>().map_err(failed)?;
    let tiles = || new.iter().filter(|name| *name != TILESET);
    if let Some(name) = tiles().find(|name| !old.contains(*name) && folder.join(name).exists()) {
        return Err(occupied(folder, name));
    }
    let all: Vec<&String> = old.iter().chain(tiles()).collect();
    let between = json!({"asset": {"version": "1.1", "generator": GENERATOR}, UNFINISHED: all});
    write_atomically(&folder.join(TILESET), format!("{between:#}\n").as_bytes())?;
    for name in old.difference(&new) {
        remove(&folder.join(name))?;
    }
    for name in tiles().map(String::as_str).chain([TILESET]) {
        std::fs::rename(from.join(name), folder.join(name)).map_err(failed)?;
    }
    Ok(())
}

/// Names of the earlier tiles in a folder; none where it holds nothing but `new`.
fn ours(folder: &Path, new: &Path) -> Result<BTreeSet<String>, RasterError> {
    let entries = std::fs::read_dir(folder).map_err(|error| RasterError::from_io(folder, &error))?;
    let entries = entries.flatten();
    let mut others = entries.filter(|entry| Some(&*entry.file_name()) != new.file_name());
    let text = bounded::read_text(&folder.join(TILESET)).unwrap_or_default();
    let tileset: Value = serde_json::from_str(&text).unwrap_or_default();
    let generator = tileset["asset"]["generator"].as_str().unwrap_or_default();
    let is_ours = generator.split(' ').next() == GENERATOR.split(' ').next();
    match (is_ours, others.next()) {
        (true, _) => Ok(listed(&tileset)),
        (false, None) => Ok(BTreeSet::new()),
        (false, Some(_)) => Err(occupied(folder, TILESET)),
    }
}

/// Names of the plain files that a tileset lists.
fn listed(tileset: &Value) -> BTreeSet<String> {
    let mut names: Vec<&Value> = tileset[UNFINISHED].as_array().into_iter().flatten().collect();
    let mut tiles = vec![&tileset["root"]];
    while let Some(tile) = tiles.pop() {
        names.push(&tile["content"]["uri"]);
        tiles.extend(tile["children"].as_array().into_iter().flatten());
    }
    let plain = |name: &&str| name.ends_with(".glb") && !name.contains(['/', '\\', '\0']);
    let names = names.into_iter().filter_map(Value::as_str).filter(plain);
    names.map(str::to_owned).collect()
}

fn occupied(folder: &Path, name: &str) -> RasterError {
    RasterError::Occupied(folder.to_owned(), name.to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    fn names(folder: &Path) -> Vec<String> {
        let entries = fs::read_dir(folder).expect("a folder");
        let mut names: Vec<String> = entries
            .map(|entry| entry.expect("an entry").file_name().to_string_lossy().into_owned())
            .collect();
        names.sort();
        names
    }

    fn write(folder: &Path, names: &[&str], fail: bool) -> Result<(), RasterError> {
        replace(folder, |new| {
            let children: Vec<Value> = names.iter().map(|name| json!({"content": {"uri": name}})).collect();
            let tileset = json!({"asset": {"generator": GENERATOR}, "root": {"children": children}});
            fs::write(new.join(TILESET), tileset.to_string()).expect("written");
            for name in names {
                fs::write(new.join(name), "").expect("written");
            }
            match fail {
                true => Err(RasterError::DiskFull(new.to_owned())),
                false => Ok(()),
            }
        })
    }

    #[test]
    fn tiles_take_the_place_of_earlier_ones_and_of_nothing_else() {
        let home = tempfile::tempdir().expect("a temporary folder");
        let path = home.path().join("tiles");
        assert!(write(&path, &["a.glb"], true).is_err());
        assert!(names(home.path()).is_empty());
        write(&path, &["a.glb", "b.glb"], false).expect("new");
        fs::write(path.join("index.html"), "my viewer").expect("written");
        write(&path, &["b.glb", "c.glb"], false).expect("replaced");
        assert!(write(&path, &["d.glb"], true).is_err());
        let expected = ["b.glb", "c.glb", "index.html", TILESET];
        assert_eq!(names(&path), expected);
        // A file of the user's with the name of a new tile.
        fs::write(path.join("e.glb"), "mine").expect("written");
        assert!(write(&path, &["e.glb"], false).is_err_and(|error| error.is_input_fault()));
        assert_eq!(fs::read(path.join("e.glb")).expect("there"), b"mine");
        assert!(path.join("c.glb").is_file());
    }

    #[test]
    fn an_export_that_was_killed_is_replaced_and_a_folder_of_anybody_else_is_not() {
        let home = tempfile::tempdir().expect("a temporary folder");
        let tileset = home.path().join(TILESET);
        let killed = json!({"asset": {"generator": GENERATOR}, UNFINISHED: ["a.glb", "../x.glb", "notes.txt"]});
        fs::write(&tileset, killed.to_string()).expect("written");
        for name in ["a.glb", "notes.txt"] {
            fs::write(home.path().join(name), "").expect("written");
        }
        write(home.path(), &["b.glb"], false).expect("replaced");
        assert_eq!(names(home.path()), ["b.glb", "notes.txt", TILESET]);
        let foreign = json!({"asset": {"generator": "another program"}, "root": {"content": {"uri": "b.glb"}}});
        fs::write(&tileset, foreign.to_string()).expect("written");
        assert!(write(home.path(), &["c.glb"], false).is_err_and(|error| error.is_input_fault()));
        assert_eq!(names(home.path()), ["b.glb", "notes.txt", TILESET]);
    }
}
