//! Folders that are there whole or not at all.

use crate::RasterError;
use crate::streamed::temporary_folder_beside;
use std::path::Path;

/// Lets `fill` write into a temporary folder beside `path`, which takes its place when all is written. What stood there before goes, if it is
/// empty or has a file called `mark`; any other folder is left alone.
///
/// # Errors
/// Those of `fill`, and [`RasterError`] where there is a folder of something else, or the folder cannot be made.
pub fn write_folder<T, E: From<RasterError>>(
    path: &Path,
    mark: &str,
    fill: impl FnOnce(&Path) -> Result<T, E>,
) -> Result<T, E> {
    let failed = |error: std::io::Error| E::from(RasterError::from_io(path, &error));
    if !may_be_replaced(path, mark).map_err(failed)? {
        return Err(RasterError::Occupied {
            path: path.to_owned(),
            mark: mark.to_owned(),
        }
        .into());
    }
    let home = temporary_folder_beside(path)?;
    let (new, old) = (home.path().join("new"), home.path().join("old"));
    std::fs::create_dir(&new).map_err(failed)?;
    let filled = fill(&new)?;
    if path.exists() {
        std::fs::rename(path, &old).map_err(failed)?;
    }
    if let Err(error) = std::fs::rename(&new, path) {
        // The old one goes back; if that fails too, the first failure is the one to tell.
        let _ = std::fs::rename(&old, path);
        return Err(failed(error));
    }
    Ok(filled)
}

fn may_be_replaced(path: &Path, mark: &str) -> std::io::Result<bool> {
    match std::fs::read_dir(path) {
        Ok(mut entries) => Ok(entries.next().is_none() || path.join(mark).is_file()),
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(true),
        Err(error) if error.kind() == std::io::ErrorKind::NotADirectory => Ok(false),
        Err(error) => Err(error),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    fn names(folder: &Path) -> Vec<String> {
        let entries = fs::read_dir(folder).expect("a folder");
        let name =
            |entry: std::io::Result<fs::DirEntry>| entry.expect("an entry").file_name().into_string().expect("a name");
        let mut names: Vec<String> = entries.map(name).collect();
        names.sort();
        names
    }

    #[test]
    fn a_folder_is_replaced_whole_and_nothing_is_left_of_one_that_failed() {
        let home = tempfile::tempdir().expect("a temporary folder");
        let path = home.path().join("tiles");
        let write = |name: &'static str, fail: bool| {
            write_folder(&path, "mark", |folder| {
                fs::write(folder.join("mark"), "").expect("written");
                fs::write(folder.join(name), "").expect("written");
                match fail {
                    true => Err(RasterError::DiskFull(folder.to_owned())),
                    false => Ok(()),
                }
            })
        };
        assert!(write("a", true).is_err());
        assert!(names(home.path()).is_empty());
        write("a", false).expect("new");
        write("b", false).expect("replaced");
        assert!(write("c", true).is_err());
        assert_eq!(
            (names(&path), names(home.path())),
            (vec!["b".into(), "mark".into()], vec!["tiles".to_owned()])
        );
    }

    #[test]
    fn what_a_killed_process_was_writing_is_removed_and_nothing_else() {
        let home = tempfile::tempdir().expect("a temporary folder");
        let staged = temporary_folder_beside(&home.path().join("tiles"))
            .expect("made")
            .keep();
        fs::create_dir(staged.join("new")).expect("made");
        fs::write(staged.join("new").join("tile.glb"), "").expect("written");
        fs::write(home.path().join(".heliosplat-file"), "").expect("written");
        fs::write(home.path().join("dsm.tif"), "").expect("written");
        crate::write::remove_leftovers(home.path());
        assert_eq!(names(home.path()), ["dsm.tif"]);
    }

    #[test]
    fn a_folder_of_something_else_is_left_alone() {
        let home = tempfile::tempdir().expect("a temporary folder");
        fs::write(home.path().join("mine"), "").expect("written");
        let refused = write_folder::<_, RasterError>(home.path(), "mark", |_| Ok(()));
        assert!(refused.is_err_and(|error| error.is_input_fault()));
        assert_eq!(names(home.path()), ["mine"]);
    }
}
