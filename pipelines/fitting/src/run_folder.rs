//! The folder of a run: its inputs with hashes, its metrics, and the start, resumption and end of every training in it.

use crate::budget::Budget;
use crate::checkpoint::{self, CheckpointError, CheckpointWriter, LoadedCheckpoint};
use crate::lock::Lock;
use crate::request::{Earlier, TrainRequest};
use crate::training::Ending;
use heliosplat::timeline;
use heliosplat_raster::write::{remove, write_atomically};
use heliosplat_raster::{RasterError, bounded, sha256};
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::Value;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// File of the Gaussians of a run.
const GAUSSIANS: &str = "model.ply";
/// File of shared parameters, frame and cameras. A folder with this file is a run.
pub const MODEL: &str = "model.json";
/// File that describes the training: model, inputs and settings.
pub const RUN: &str = "run.toml";
/// File of metrics. A run with this file is finished.
const METRICS: &str = "metrics.json";
/// Files of a run besides its model, its rasters and `run.toml`; a run need not have all of them.
const FILES: [&str; 9] = [
    METRICS,
    "calibration.svg",
    "change.png",
    "dsm.png",
    "error.png",
    "error.tif",
    "report.html",
    "start.png",
    "sun.html",
];
/// Rasters of a run, `NAME.tif` with the style `NAME.qml`; a run need not have all of them.
const RASTERS: [&str; 15] = [
    "change",
    "change_confidence",
    "change_date",
    "dsm",
    "dsm_before",
    "dsm_before_coverage",
    "dsm_before_stddev",
    "dsm_before_views",
    "dsm_coverage",
    "dsm_stddev",
    "dsm_views",
    "start",
    "start_coverage",
    "start_stddev",
    "start_views",
];
/// Folders of a run's pictures.
const PICTURES: [&str; 2] = ["relit", "views"];

/// Reason why a run cannot be read or written.
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    /// The folder holds no finished run.
    #[error(
        "{0}: not a finished run (it has no model.json); `heliosplat train SCENE --out RUN` makes one, `heliosplat dsm SCENE --from sweep` needs none"
    )]
    NotARun(PathBuf),
    /// An invalid file of the run. Fields: the file, the fault.
    #[error("{0}: {1}; train the run again")]
    Damaged(PathBuf, String),
    /// A file that cannot be read. Fields: the file, error of the operating system.
    #[error("{0}: {1}")]
    Io(PathBuf, std::io::Error),
    /// A file that cannot be written.
    #[error(transparent)]
    Write(#[from] RasterError),
    /// A checkpoint cannot be used or written.
    #[error(transparent)]
    Checkpoint(#[from] CheckpointError),
    /// A folder that holds a finished run.
    #[error("{}: holds a finished run; give --overwrite to replace it, or another --out", .0.display())]
    Exists(PathBuf),
    /// A folder in which another process trains.
    #[error("{}: another training writes into this folder; wait for it, or give another --out", .0.display())]
    Busy(PathBuf),
    /// A folder that cannot be made. Fields: the folder, error of the operating system.
    #[error("{}: the folder cannot be made ({}); choose another --out", .0.display(), .1)]
    Folder(PathBuf, std::io::Error),
}

impl RunError {
    /// True if the user's input is at fault, rather than the machine.
    pub fn is_input_fault(&self) -> bool {
        match self {
            Self::NotARun(_) | Self::Damaged(..) | Self::Exists(_) | Self::Busy(_) => true,
            Self::Write(error) => error.is_input_fault(),
            Self::Checkpoint(error) => error.is_input_fault(),
            Self::Io(..) | Self::Folder(..) => false,
        }
    }
}

/// An input file of a run with its hash.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct Input {
    /// Path of the file.
    pub path: PathBuf,
    /// SHA-256 of the file, hexadecimal. For a file on a virtual file system it is that of the pixels that were read.
    pub sha256: String,
}

/// Reads the text of a file of a run.
///
/// # Errors
/// [`RunError::Io`] when the file cannot be read; [`RunError::Damaged`] when it is not UTF-8, too large, or no regular
/// file.
pub fn read(path: &Path) -> Result<String, RunError> {
    bounded::read_text(path).map_err(|reason| unreadable(path, reason))
}

/// Reads and parses a file of the run in `folder`; a fault that `parse` states is that of a damaged file.
///
/// # Errors
/// [`RunError::NotARun`] when the file is absent, and those of [`read`].
pub fn parsed<T>(folder: &Path, name: &str, parse: impl FnOnce(&str) -> Result<T, String>) -> Result<T, RunError> {
    let path = folder.join(name);
    if !path.is_file() {
        return Err(RunError::NotARun(folder.to_owned()));
    }
    parse(&read(&path)?).map_err(|reason| RunError::Damaged(path, reason))
}

fn unreadable(path: &Path, reason: std::io::Error) -> RunError {
    let path = path.to_owned();
    match reason.kind() {
        ErrorKind::InvalidData => RunError::Damaged(path, reason.to_string()),
        _ => RunError::Io(path, reason),
    }
}

/// Reads the path and the bytes of the `model.ply` of a run. `stated` is the SHA-256 in `model.json`; models of
/// earlier versions state none.
///
/// # Errors
/// [`RunError::Io`] when the file cannot be read; [`RunError::Damaged`] when it is too large, no regular file, or has
/// another SHA-256.
pub fn read_gaussians(folder: &Path, stated: Option<&str>) -> Result<(PathBuf, Vec<u8>), RunError> {
    let path = folder.join(GAUSSIANS);
    let bytes = bounded::read_bytes(&path, bounded::MODEL_MAX).map_err(|reason| unreadable(&path, reason))?;
    if stated.is_some_and(|sum| sum != sha256::of_bytes(&bytes)) {
        let reason = format!("its SHA-256 is not the one in {MODEL}: it is damaged, or of another run");
        return Err(RunError::Damaged(path, reason));
    }
    Ok((path, bytes))
}

/// Writes a model into `folder`, which must exist: `model.ply`, the `texts` of a run by their names, and last
/// `model.json`, which makes the folder a run. Without texts only the model of the run is replaced. `describe` makes
/// the text of `model.json` from the SHA-256 of `model.ply`. The folder holds no run until `model.json` is written.
///
/// # Errors
/// When a file cannot be removed or written.
pub fn save_model(
    folder: &Path,
    gaussians: &[u8],
    texts: &[(&str, &str)],
    describe: impl FnOnce(String) -> serde_json::Result<String>,
) -> Result<(), RunError> {
    let path = folder.join(MODEL);
    let text = describe(sha256::of_bytes(gaussians));
    let text = text.map_err(|error| RunError::Damaged(path.clone(), error.to_string()))?;
    if !texts.is_empty() {
        remove_earlier(folder)?;
    }
    remove(&path)?;
    // The large file first: where it finds no room, nothing is written.
    write_atomically(&folder.join(GAUSSIANS), gaussians)?;
    for (name, text) in texts {
        write_atomically(&folder.join(name), text.as_bytes())?;
    }
    Ok(write_atomically(&path, text.as_bytes())?)
}

/// Removes all files of an earlier run but its model: they do not describe the new run, which may not write all of
/// them.
fn remove_earlier(folder: &Path) -> Result<(), RunError> {
    for name in FILES {
        remove(&folder.join(name))?;
    }
    for name in RASTERS {
        remove(&folder.join(name).with_extension("tif"))?;
        remove(&folder.join(name).with_extension("qml"))?;
    }
    for name in PICTURES {
        let pictures = folder.join(name);
        for picture in std::fs::read_dir(&pictures).into_iter().flatten().flatten() {
            if picture.path().extension().is_some_and(|extension| extension == "png") {
                remove(&picture.path())?;
            }
        }
        // The folder stays where the user keeps other files in it.
        let _ = std::fs::remove_dir(&pictures);
    }
    Ok(())
}

/// SHA-256 of a file, hexadecimal.
///
/// # Errors
/// When the file cannot be read.
pub fn hash(path: &Path) -> Result<String, RunError> {
    sha256::of_file(path).map_err(|reason| RunError::Io(path.to_owned(), reason))
}

/// Writes `metrics.json` into the folder of a run.
///
/// # Errors
/// When the file cannot be written.
pub fn save_metrics(folder: &Path, metrics: &serde_json::Value) -> Result<(), RunError> {
    let text = format!("{metrics:#}\n");
    Ok(write_atomically(&folder.join(METRICS), text.as_bytes())?)
}

/// Current memory of this process, bytes; zero where the system does not report it.
pub fn resident_bytes() -> u64 {
    status_bytes("VmRSS:")
}

/// Peak memory of this process, bytes; zero where the system does not report it.
pub fn peak_rss_bytes() -> u64 {
    status_bytes("VmHWM:")
}

/// One size of `/proc/self/status`, bytes. The kernel reports KiB there, whatever the size of its pages.
fn status_bytes(field: &str) -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let rest = status.lines().find_map(|line| line.strip_prefix(field));
    let kib = rest.and_then(|rest| rest.split_whitespace().next()?.parse::<u64>().ok());
    kib.unwrap_or(0) * 1024
}

/// Makes a folder and those above it.
///
/// # Errors
/// [`RunError::Folder`] when a folder cannot be made.
pub fn create_folder(path: &Path) -> Result<(), RunError> {
    std::fs::create_dir_all(path).map_err(|reason| RunError::Folder(path.to_owned(), reason))
}

/// A folder in which a training begins or continues; `P` is the result of a pipeline's preprocessing.
pub struct RunFolder<'a, P> {
    /// Start of the training, pauses not counted.
    pub begun: Instant,
    /// Time budget of the training, if the user set one.
    pub budget: Option<Budget>,
    /// Writer of the training's checkpoints.
    pub checkpoints: CheckpointWriter<'a, P>,
    /// Checkpoint to continue from, if there is one.
    pub checkpoint: Option<LoadedCheckpoint<P>>,
    /// Data for the end of the training.
    pub closing: Closing<'a>,
}

/// Data that a folder needs at the end of its training.
#[derive(Debug)]
pub struct Closing<'a> {
    out: &'a Path,
    identity: &'a str,
    new: bool,
    lock: Lock,
}

/// State of a folder at the request of a training.
pub enum FolderState<'a, P> {
    /// The folder holds this very training, finished, with these metrics.
    Finished(Value),
    /// The training can begin, or continue from a checkpoint.
    Ready(Box<RunFolder<'a, P>>),
}

impl<'a, P: Clone + Serialize + DeserializeOwned + 'static> FolderState<'a, P> {
    /// Locks the folder of a run and reads its state. The folder is made where it is absent, so that one that cannot be
    /// written fails before the training. `identity` states the training line by line: equal lines mean the same one.
    /// `steps_after` is the cost of the work after training, in training steps.
    ///
    /// # Errors
    /// When another process trains there, the folder holds a training that `earlier` keeps, the checkpoint is damaged
    /// or of another training, or the folder cannot be made.
    pub fn look(request: &'a TrainRequest, identity: &'a str, steps_after: f64) -> Result<Self, RunError> {
        let (out, earlier) = (request.out.as_path(), request.earlier);
        let new = !out.exists();
        create_folder(out)?;
        let lock = Lock::take(out)?.ok_or_else(|| RunError::Busy(out.to_owned()))?;
        if matches!(earlier, Earlier::Resume | Earlier::Update) {
            let metrics = metrics_of(out).filter(|metrics| metrics["training"] == checkpoint::digest(identity));
            if let Some(metrics) = metrics {
                checkpoint::remove(out);
                return Ok(Self::Finished(metrics));
            }
        }
        if earlier == Earlier::Overwrite {
            checkpoint::remove(out);
        }
        let checkpoint: Option<LoadedCheckpoint<P>> = checkpoint::read(out, identity)?;
        match &checkpoint {
            Some(checkpoint) => tracing::info!("{}: continues at step {}", out.display(), checkpoint.trainer.steps()),
            None if matches!(earlier, Earlier::Keep | Earlier::Resume) => must_be_free(out)?,
            None => {}
        }
        heliosplat_session::log::keep_in(out);
        // A training that was interrupted began earlier by the time that it had taken.
        let before = checkpoint.as_ref().map_or(0.0, |checkpoint| checkpoint.log.elapsed_s);
        let before = Duration::try_from_secs_f64(before).unwrap_or_default();
        let begun = request.begun.checked_sub(before).unwrap_or(request.begun);
        let closing = Closing {
            out,
            identity,
            new,
            lock,
        };
        Ok(Self::Ready(Box::new(RunFolder {
            begun,
            budget: (request.time_budget).map(|limit| Budget::new(begun, limit, steps_after)),
            checkpoints: CheckpointWriter::new(out, identity, request.checkpoint_every, begun),
            checkpoint,
            closing,
        })))
    }
}

impl Closing<'_> {
    /// Result of a training that succeeded. The folder of one that failed is removed, if it was made for it and is still
    /// empty.
    ///
    /// # Errors
    /// The error of the training.
    pub fn after<T, E>(self, trained: Result<T, E>) -> Result<(Self, T), E> {
        match trained {
            Ok(trained) => Ok((self, trained)),
            Err(error) => {
                self.discard();
                Err(error)
            }
        }
    }

    fn discard(self) {
        if self.new {
            drop(self.lock);
            let _ = std::fs::remove_file(self.out.join(heliosplat_session::log::FILE));
            // The call removes only an empty folder; a folder that stays is no further fault.
            let _ = std::fs::remove_dir(self.out);
        }
    }

    /// Adds the timeline of the process to `metrics`, writes them as `metrics.json`, which makes the run finished, and
    /// removes its checkpoint. The folder stays locked while the returned lock is held.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn finish(self, metrics: &mut Value, ending: &Ending) -> Result<Lock, RunError> {
        metrics["timeline"] = serde_json::to_value(timeline::take()).unwrap_or_default();
        if *ending == Ending::Done {
            metrics["training"] = checkpoint::digest(self.identity).into();
        }
        save_metrics(self.out, metrics)?;
        checkpoint::remove(self.out);
        Ok(self.lock)
    }
}

/// Refuses a folder that holds a finished run.
///
/// # Errors
/// [`RunError::Exists`] when the folder has a `model.json`.
pub fn must_be_free(out: &Path) -> Result<(), RunError> {
    match out.join(MODEL).exists() {
        true => Err(RunError::Exists(out.to_owned())),
        false => Ok(()),
    }
}

fn metrics_of(run: &Path) -> Option<Value> {
    serde_json::from_str(&bounded::read_text(&run.join(METRICS)).ok()?).ok()
}

/// Reads the inputs listed in the `run.toml` of a run of any pipeline.
///
/// # Errors
/// When the file is missing or damaged.
pub fn inputs(run: &Path) -> Result<Vec<Input>, RunError> {
    #[derive(serde::Deserialize)]
    struct Inputs {
        inputs: Vec<Input>,
    }
    let path = run.join(RUN);
    let parsed = toml::from_str::<Inputs>(&read(&path)?).map(|run| run.inputs);
    parsed.map_err(|error| RunError::Damaged(path, error.message().to_owned()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_model_that_cannot_be_replaced_is_no_run_any_more_and_nothing_of_the_run_before_stays() {
        let home = tempfile::tempdir().expect("a temporary folder");
        let path = |name: &str| home.path().join(name);
        std::fs::create_dir_all(path("views")).expect("made");
        for name in [
            "views/a.png",
            "views/notes.txt",
            "error.tif",
            "report.html",
            "metrics.json",
            "model.json",
            "mine.txt",
        ] {
            std::fs::write(path(name), "earlier").expect("written");
        }
        // A folder cannot be replaced by a file.
        std::fs::create_dir(path("model.ply")).expect("made");
        let save = || save_model(home.path(), b"gaussians", &[(RUN, "run")], Ok);
        assert!(save().is_err());
        assert!(!path(MODEL).exists(), "what is not whole is no run");
        std::fs::remove_dir(path("model.ply")).expect("removed");
        save().expect("written");
        let mut left: Vec<_> = std::fs::read_dir(home.path())
            .expect("a folder")
            .map(|entry| entry.expect("an entry").file_name().into_string().expect("a name"))
            .collect();
        left.sort();
        assert_eq!(left, ["mine.txt", "model.json", "model.ply", "run.toml", "views"]);
        assert!(path("views/notes.txt").is_file() && !path("views/a.png").exists());
        let sum = std::fs::read_to_string(path(MODEL)).expect("there");
        assert!(read_gaussians(home.path(), Some(&sum)).is_ok());
        std::fs::write(path("model.ply"), b"gaussianr").expect("written");
        let damaged = read_gaussians(home.path(), Some(&sum)).expect_err("another sum");
        assert!(damaged.is_input_fault() && damaged.to_string().contains("SHA-256"));
        std::fs::write(path(MODEL), [0xff, 0xfe]).expect("written");
        assert!(read(&path(MODEL)).is_err_and(|error| error.is_input_fault()));
    }

    #[test]
    #[cfg(target_os = "linux")]
    fn the_most_memory_used_is_no_less_than_what_was_held_before() {
        let before = resident_bytes();
        drop(std::hint::black_box(vec![1u8; 64 << 20]));
        let most = peak_rss_bytes();
        assert!(before > 0 && most >= before + (32 << 20), "{before} {most}");
    }
}
