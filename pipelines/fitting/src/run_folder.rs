//! The folder of a run: its inputs with hashes, its metrics, and one way for every training to begin in it, to be resumed, and
//! to finish.

use crate::budget::Budget;
use crate::checkpoint::{self, CheckpointError, CheckpointWriter, LoadedCheckpoint};
use crate::request::TrainRequest;
use crate::training::Ending;
use heliosplat::Raster;
use heliosplat_raster::write::write_atomically;
use heliosplat_raster::{RasterError, bounded};
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::Value;
use sha2::{Digest, Sha256};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// Why a run cannot be read or written.
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    /// There is no such run.
    #[error("{0}: not a finished run (it has no model.json); train one with `heliosplat train SCENE --out {0}`")]
    NotARun(PathBuf),
    /// A file of the run that is not what it should be.
    #[error("{path}: {reason}; train the run again")]
    Damaged {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        reason: String,
    },
    /// A file that cannot be read.
    #[error("{path}: {reason}")]
    Io {
        /// The file.
        path: PathBuf,
        /// What the operating system says.
        reason: std::io::Error,
    },
    /// A file that cannot be written.
    #[error(transparent)]
    Write(#[from] RasterError),
    /// A checkpoint.
    #[error(transparent)]
    Checkpoint(#[from] CheckpointError),
    /// A folder that cannot be made.
    #[error("{}: the folder cannot be made ({reason}); choose another --out", path.display())]
    Folder {
        /// The folder.
        path: PathBuf,
        /// What the operating system says.
        reason: std::io::Error,
    },
}

impl RunError {
    /// Whether what the user gave is at fault, rather than the machine.
    pub fn is_input_fault(&self) -> bool {
        match self {
            Self::NotARun(_) | Self::Damaged { .. } => true,
            Self::Write(error) => error.is_input_fault(),
            Self::Checkpoint(error) => error.is_input_fault(),
            Self::Io { .. } | Self::Folder { .. } => false,
        }
    }
}

/// One input of a run.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct Input {
    /// The file.
    pub path: PathBuf,
    /// Its SHA-256, hexadecimal; of a file on a virtual file system, that of the pixels that were read.
    pub sha256: String,
}

/// The text of a file of a run.
///
/// # Errors
/// [`RunError::Io`].
pub fn read(path: &Path) -> Result<String, RunError> {
    bounded::read_text(path).map_err(|reason| RunError::Io {
        path: path.to_owned(),
        reason,
    })
}

/// SHA-256 of a file, hexadecimal.
///
/// # Errors
/// When the file cannot be read.
pub fn hash(path: &Path) -> Result<String, RunError> {
    let io = |reason| RunError::Io {
        path: path.to_owned(),
        reason,
    };
    let mut file = std::fs::File::open(path).map_err(io)?;
    let mut hasher = Sha256::new();
    std::io::copy(&mut file, &mut hasher).map_err(io)?;
    Ok(hex::encode(hasher.finalize()))
}

/// SHA-256 of the values of a raster, hexadecimal.
pub fn hash_of_pixels(raster: &Raster) -> String {
    let mut hasher = Sha256::new();
    for value in &raster.values {
        hasher.update(value.to_le_bytes());
    }
    hex::encode(hasher.finalize())
}

/// Writes `metrics.json`.
///
/// # Errors
/// When it cannot be written.
pub fn save_metrics(folder: &Path, metrics: &serde_json::Value) -> Result<(), RunError> {
    let text = format!("{metrics:#}\n");
    Ok(write_atomically(&folder.join("metrics.json"), text.as_bytes())?)
}

/// Memory that this process holds now, bytes; zero where the system does not tell.
pub fn resident_bytes() -> u64 {
    status_bytes("VmRSS:")
}

/// The most memory this process has used, bytes; zero where the system does not tell.
pub fn peak_rss_bytes() -> u64 {
    status_bytes("VmHWM:")
}

/// One size of `/proc/self/status`, bytes. The kernel says them in KiB there, whatever the size of its pages.
fn status_bytes(field: &str) -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let kib = status
        .lines()
        .find_map(|line| line.strip_prefix(field))
        .and_then(|rest| rest.split_whitespace().next()?.parse::<u64>().ok());
    kib.unwrap_or(0) * 1024
}

/// Makes a folder and those above it.
///
/// # Errors
/// [`RunError::Folder`].
pub fn create_folder(path: &Path) -> Result<(), RunError> {
    std::fs::create_dir_all(path).map_err(|reason| RunError::Folder {
        path: path.to_owned(),
        reason,
    })
}

/// Which training is to begin.
#[derive(Debug, Clone, Copy)]
pub struct RunRequest<'a> {
    /// What was asked for.
    pub request: &'a TrainRequest,
    /// All that decides the training, line by line: two of the same lines are the same training.
    pub identity: &'a str,
    /// What follows training, in steps of it.
    pub steps_after: f64,
}

/// A folder in which a training begins or goes on; `P` is what a pipeline computes once before training starts.
pub struct RunFolder<'a, P> {
    /// When the training began, pauses not counted.
    pub begun: Instant,
    /// The time left to it.
    pub budget: Option<Budget>,
    /// Writes its checkpoints.
    pub checkpoints: CheckpointWriter<'a, P>,
    /// Where it goes on from.
    pub checkpoint: Option<LoadedCheckpoint<P>>,
    /// What is known when it ends.
    pub closing: Closing<'a>,
}

/// What a folder needs to know when its training ends.
#[derive(Debug, Clone, Copy)]
pub struct Closing<'a> {
    out: &'a Path,
    identity: &'a str,
    new: bool,
}

/// What stands in a folder when a training is asked for.
pub enum Opened<'a, P> {
    /// This very training, finished: its metrics.
    Finished(Value),
    /// Nothing, or a checkpoint.
    Open(Box<RunFolder<'a, P>>),
}

impl<'a, P: Clone + Serialize + DeserializeOwned + 'static> Opened<'a, P> {
    /// Looks into the folder of a run, and makes it where it is absent: better to hear now than after the training that nothing can
    /// be written there.
    ///
    /// # Errors
    /// When the checkpoint is damaged or of another training, or the folder cannot be made.
    pub fn look(asked: RunRequest<'a>) -> Result<Self, RunError> {
        let RunRequest {
            request,
            identity,
            steps_after,
        } = asked;
        let out = request.out.as_path();
        if request.resume {
            let metrics = metrics_of(out).filter(|metrics| metrics["training"] == checkpoint::digest(identity));
            if let Some(metrics) = metrics {
                checkpoint::remove(out);
                return Ok(Self::Finished(metrics));
            }
        }
        let checkpoint: Option<LoadedCheckpoint<P>> = match request.resume {
            true => checkpoint::read(out, identity)?,
            false => None,
        };
        // A training that was interrupted began earlier by the time that it had taken.
        let before = checkpoint.as_ref().map_or(0.0, |checkpoint| checkpoint.log.elapsed_s);
        let before = Duration::try_from_secs_f64(before).unwrap_or_default();
        let begun = request.begun.checked_sub(before).unwrap_or(request.begun);
        let new = !out.exists();
        create_folder(out)?;
        Ok(Self::Open(Box::new(RunFolder {
            begun,
            budget: request.time_budget.map(|limit| Budget::new(begun, limit, steps_after)),
            checkpoints: CheckpointWriter::new(out, identity, request.checkpoint_every, begun),
            checkpoint,
            closing: Closing { out, identity, new },
        })))
    }
}

impl Closing<'_> {
    /// Removes the folder of a training that came to nothing, if it was made for it and is empty still.
    pub fn discard(&self) {
        if self.new {
            // Only removes it while it is empty; that it stays is no further fault.
            let _ = std::fs::remove_dir(self.out);
        }
    }

    /// Writes `metrics.json`, which makes the run finished, and removes its checkpoint.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn finish(&self, metrics: &mut Value, ending: &Ending) -> Result<(), RunError> {
        if *ending == Ending::Done {
            metrics["training"] = checkpoint::digest(self.identity).into();
        }
        save_metrics(self.out, metrics)?;
        checkpoint::remove(self.out);
        Ok(())
    }
}

fn metrics_of(run: &Path) -> Option<Value> {
    serde_json::from_str(&bounded::read_text(&run.join("metrics.json")).ok()?).ok()
}

/// The inputs that the `run.toml` of a run names, whatever its pipeline.
///
/// # Errors
/// When it is missing or damaged.
pub fn inputs(run: &Path) -> Result<Vec<Input>, RunError> {
    #[derive(serde::Deserialize)]
    struct Inputs {
        inputs: Vec<Input>,
    }
    let path = run.join("run.toml");
    let parsed = toml::from_str::<Inputs>(&read(&path)?);
    parsed.map(|run| run.inputs).map_err(|error| RunError::Damaged {
        path,
        reason: error.message().to_owned(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    #[cfg(target_os = "linux")]
    fn the_most_memory_used_is_no_less_than_what_was_held_before() {
        let before = resident_bytes();
        drop(std::hint::black_box(vec![1u8; 64 << 20]));
        let most = peak_rss_bytes();
        assert!(before > 0 && most >= before + (32 << 20), "{before} {most}");
    }
}
