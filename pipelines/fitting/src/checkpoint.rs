//! The state of a training in its run's folder, from which the same training continues: `checkpoint/training.bin`.
//!
//! The file has a line with the name of the format, the contents, and their SHA-256. It is written to a temporary name
//! and renamed, so that a complete file always exists. A checkpoint of another build, configuration or other inputs is
//! refused.

use crate::curve::CurvePoint;
use heliosplat::train::{StateError, TrainError, Trainer, TrainerState};
use heliosplat_raster::write::write_atomically_with;
use heliosplat_raster::{RasterError, bounded, sha256};
use serde::Serialize;
use serde::de::DeserializeOwned;
use sha2::{Digest, Sha256};
use std::borrow::Cow;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// First bytes of a checkpoint; the number is that of this layout.
const MAGIC: &[u8] = b"heliosplat checkpoint 3\n";
/// Bytes of the check sum at the end.
const SUM: usize = 32;
/// Bytes that a checkpoint has at most: parameters, two moments of each, and the best parameters.
const LARGEST: u64 = 4 * bounded::MODEL_MAX;
/// A checkpoint is written no more often than this many times the time that the last one took.
const SPARING: u32 = 20;
/// Name of the folder in a run, and of the file in it.
const PLACE: [&str; 2] = ["checkpoint", "training.bin"];

/// Reason why a checkpoint cannot be used or written.
#[derive(Debug, thiserror::Error)]
pub enum CheckpointError {
    /// The file is no checkpoint, or is damaged. Fields: the file, the fault.
    #[error("{}: {}; give --overwrite to begin anew", .0.display(), .1)]
    Damaged(PathBuf, String),
    /// The checkpoint is of another training. Fields: the file, first line in which the identities differ, in words.
    #[error("{}: it is of another training ({}); give the same settings, or --overwrite to begin anew", .0.display(), .1)]
    Other(PathBuf, String),
    /// The checkpoint cannot be written.
    #[error(transparent)]
    Write(#[from] RasterError),
    /// The device of the training does not give its state back.
    #[error(transparent)]
    Fetch(#[from] TrainError),
}

impl CheckpointError {
    /// True if the user's input is at fault, rather than the machine.
    pub fn is_input_fault(&self) -> bool {
        !matches!(self, Self::Write(_) | Self::Fetch(_))
    }
}

/// The progress of a training so far, kept in its checkpoint.
#[derive(Debug, Clone, Default, serde::Serialize, serde::Deserialize)]
pub struct TrainingLog {
    /// Points of the curve so far.
    pub curve: Vec<CurvePoint>,
    /// Smoothed mean absolute difference to the images; `None` before the first step.
    pub smoothed: Option<f64>,
    /// Seconds since the run began, pauses not counted.
    pub elapsed_s: f64,
}

#[derive(serde::Serialize, serde::Deserialize)]
struct Contents<'a, P: Clone> {
    identity: Cow<'a, str>,
    preprocessed: Option<Cow<'a, P>>,
    log: Cow<'a, TrainingLog>,
    trainer: TrainerState<'a>,
}

/// The checkpoint of an interrupted training; `P` is the result of a pipeline's preprocessing.
pub struct LoadedCheckpoint<P> {
    /// Results of preprocessing, which need not be computed again.
    pub preprocessed: Option<P>,
    /// The progress so far.
    pub log: TrainingLog,
    /// The trainer's state.
    pub trainer: TrainerState<'static>,
}

/// Path of the checkpoint in the folder of a run.
pub fn path_in(run: &Path) -> PathBuf {
    run.join(PLACE[0]).join(PLACE[1])
}

/// Removes the checkpoint of a run, if there is one.
pub fn remove(run: &Path) {
    // Remaining files are harmless: any other training refuses them, and the same one continues from them.
    let _ = std::fs::remove_file(path_in(run));
    let _ = std::fs::remove_dir(run.join(PLACE[0]));
}

/// Short name of an identity: its SHA-256, hexadecimal.
pub fn digest(identity: &str) -> String {
    sha256::of_bytes(identity.as_bytes())
}

/// Reads the checkpoint of a run; `None` where there is none. `identity` describes the training that may continue from
/// it, line by line.
///
/// # Errors
/// [`CheckpointError`] when the checkpoint is damaged, or of another training.
pub fn read<P: Clone + DeserializeOwned + 'static>(
    run: &Path,
    identity: &str,
) -> Result<Option<LoadedCheckpoint<P>>, CheckpointError> {
    let path = path_in(run);
    let bytes = match bounded::read_bytes(&path, LARGEST) {
        Ok(bytes) => bytes,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(None),
        Err(error) => return Err(CheckpointError::Damaged(path, error.to_string())),
    };
    decode(&bytes, identity, &path).map(Some)
}

// The identity first: the rest may have another layout in another version.
fn decode<P: Clone + DeserializeOwned + 'static>(
    bytes: &[u8],
    identity: &str,
    path: &Path,
) -> Result<LoadedCheckpoint<P>, CheckpointError> {
    let damaged = |reason: &str| CheckpointError::Damaged(path.to_owned(), reason.to_owned());
    let undecoded = |error: postcard::Error| damaged(&error.to_string());
    let rest = bytes.strip_prefix(MAGIC);
    let rest = rest.ok_or_else(|| damaged("it is no checkpoint of this version of the program"))?;
    let parts = rest.split_last_chunk::<SUM>();
    let (contents, sum) = parts.ok_or_else(|| damaged("it is truncated"))?;
    if Sha256::digest(contents)[..] != sum[..] {
        return Err(damaged("its check sum is wrong: it is truncated or damaged"));
    }
    let (before, _) = postcard::take_from_bytes::<Cow<str>>(contents).map_err(undecoded)?;
    if let Some(difference) = difference(&before, identity) {
        return Err(CheckpointError::Other(path.to_owned(), difference));
    }
    let contents: Contents<'static, P> = owned(contents).map_err(undecoded)?;
    Ok(LoadedCheckpoint {
        preprocessed: contents.preprocessed.map(Cow::into_owned),
        log: contents.log.into_owned(),
        trainer: contents.trainer,
    })
}

fn owned<P: Clone + DeserializeOwned + 'static>(contents: &[u8]) -> postcard::Result<Contents<'static, P>> {
    serde::Deserialize::deserialize(&mut postcard::Deserializer::from_bytes(contents))
}

/// The first line in which two identities differ, in words.
fn difference(then: &str, now: &str) -> Option<String> {
    if then == now {
        return None;
    }
    let mut pairs = then.lines().zip(now.lines());
    let different = pairs.find(|(a, b)| a != b);
    let (then, now) = different.unwrap_or(("less or more of it", "as it is now"));
    let short = |text: &str| text.chars().take(120).collect::<String>();
    Some(format!("then: {}, now: {}", short(then), short(now)))
}

/// Writes the checkpoints of a training.
pub struct CheckpointWriter<'a, P> {
    run: &'a Path,
    identity: &'a str,
    every: Duration,
    begun: Instant,
    last: Instant,
    took: Duration,
    /// Results of preprocessing, which every checkpoint contains.
    pub preprocessed: Option<P>,
    /// The progress so far.
    pub log: TrainingLog,
}

impl<'a, P: Clone + Serialize> CheckpointWriter<'a, P> {
    /// Writer of checkpoints into the folder `run`, one for each interval `every`, of the training that `identity`
    /// describes. `begun` is the start of the run, pauses not counted.
    pub fn new(run: &'a Path, identity: &'a str, every: Duration, begun: Instant) -> Self {
        Self {
            run,
            identity,
            every,
            begun,
            last: Instant::now(),
            took: Duration::ZERO,
            preprocessed: None,
            log: TrainingLog::default(),
        }
    }

    /// Error of a checkpoint whose state does not fit the trainer although its identity fits.
    pub fn does_not_fit(&self, error: &StateError) -> CheckpointError {
        CheckpointError::Damaged(path_in(self.run), error.to_string())
    }

    /// Writes a checkpoint if one is due. A failure is logged, and the training continues.
    pub fn step_done(&mut self, trainer: &mut Trainer) {
        if self.last.elapsed() < self.every.max(SPARING * self.took) && self.every > Duration::ZERO {
            return;
        }
        if let Err(error) = self.write(trainer) {
            tracing::warn!("no checkpoint: {error}");
        }
    }

    /// Writes a checkpoint.
    ///
    /// # Errors
    /// [`CheckpointError::Write`] when the file cannot be written, [`CheckpointError::Fetch`] when a device fails.
    pub fn write(&mut self, trainer: &mut Trainer) -> Result<(), CheckpointError> {
        let begun = Instant::now();
        trainer.fetch()?;
        self.log.elapsed_s = self.begun.elapsed().as_secs_f64();
        let contents = Contents {
            identity: Cow::Borrowed(self.identity),
            preprocessed: self.preprocessed.as_ref().map(Cow::Borrowed),
            log: Cow::Borrowed(&self.log),
            trainer: trainer.state(),
        };
        let written = write_atomically_with(&path_in(self.run), |file| {
            let mut out = BufWriter::with_capacity(1 << 20, Summed::new(file));
            out.get_mut().file.write_all(MAGIC)?;
            postcard::to_io(&contents, &mut out).map_err(|error| std::io::Error::other(error.to_string()))?;
            out.flush()?;
            out.get_mut().finish()
        });
        self.last = Instant::now();
        self.took = begun.elapsed();
        Ok(written?)
    }
}

/// A file and the checksum of the bytes written to it.
struct Summed<'f> {
    file: &'f mut dyn Write,
    sum: Sha256,
    fault: Option<std::io::Error>,
}

impl<'f> Summed<'f> {
    fn new(file: &'f mut dyn Write) -> Self {
        let (sum, fault) = (Sha256::new(), None);
        Self { file, sum, fault }
    }

    fn finish(&mut self) -> std::io::Result<()> {
        if let Some(fault) = self.fault.take() {
            return Err(fault);
        }
        let sum = self.sum.finalize_reset();
        self.file.write_all(&sum)
    }
}

impl Write for Summed<'_> {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        // The encoder drops the cause of its failure (such as a full disk), so the error is kept here and returned at
        // the end.
        if self.fault.is_none() {
            self.sum.update(bytes);
            self.fault = self.file.write_all(bytes).err();
        }
        Ok(bytes.len())
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_difference_between_two_trainings_is_told() {
        assert_eq!(difference("a\nb = 1\n", "a\nb = 1\n"), None);
        let text = difference("a\nb = 1\nc", "a\nb = 2\nd").expect("they differ");
        assert_eq!(text, "then: b = 1, now: b = 2");
        assert!(difference("a", "a\nb").is_some());
    }

    #[test]
    fn what_is_no_whole_checkpoint_is_refused_without_a_guess() {
        let message = |bytes: &[u8]| match decode::<()>(bytes, "x", Path::new("run")) {
            Err(CheckpointError::Damaged(_, reason)) => reason,
            _ => String::new(),
        };
        assert!(message(b"anything").contains("no checkpoint"));
        assert!(message(MAGIC).contains("truncated"));
        let mut bytes = MAGIC.to_vec();
        bytes.extend([7; 100]);
        assert!(message(&bytes).contains("check sum"));
        // A sum that is right about contents that are none.
        let mut bytes = MAGIC.to_vec();
        bytes.extend([255; 60]);
        bytes.extend(Sha256::digest([255; 60]));
        assert!(!message(&bytes).is_empty());
    }
}
