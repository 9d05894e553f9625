//! Results of a verb: an [`Outcome`], or a [`CliError`] with its exit code.

use heliosplat_batch::BatchError;
use heliosplat_evaluate::EvaluateError;
use heliosplat_fitting::checkpoint::CheckpointError;
use heliosplat_fitting::run_folder::RunError;
use heliosplat_fitting::settings::ConfigError;
use heliosplat_fitting::training::TrainingError;
use heliosplat_objects::{CaptureError, ObjectError};
use heliosplat_pages::view::ViewError;
use heliosplat_products::export::ExportError;
use heliosplat_products::relight::RelightError;
use heliosplat_raster::RasterError;
use heliosplat_satellite::SatelliteError;
use heliosplat_scene::SceneError;
use heliosplat_session::SessionError;

/// Result of a finished verb.
#[derive(Debug, Clone)]
pub struct Outcome {
    /// Result as a JSON object, for `--json`.
    pub json: serde_json::Value,
    /// Result as text.
    pub text: String,
}

impl Outcome {
    /// Results of a verb, as text and as JSON.
    pub fn new(text: impl Into<String>, json: serde_json::Value) -> Self {
        let text = text.into();
        Self { json, text }
    }
}

/// Failure of a verb, with the message for the user.
#[derive(Debug, thiserror::Error)]
pub enum CliError {
    /// Bad usage or bad input: exit code 2.
    #[error("{0}")]
    Input(String),
    /// Failure without a fault of the user, such as a full disk: exit code 1.
    #[error("{0}")]
    Failed(String),
    /// Stopped by the user after the state was saved: exit code 130.
    #[error("{0}")]
    Interrupted(String),
}

impl CliError {
    /// Exit code of the process.
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::Input(_) => 2,
            Self::Failed(_) => 1,
            Self::Interrupted(_) => 130,
        }
    }

    /// Refuses options of `verb` if they are given; `why` states the reason and the remedy.
    pub(crate) fn refuse(verb: &str, options: &[(bool, &str)], why: &str) -> Result<(), Self> {
        match options.iter().find(|(given, _)| *given) {
            Some((_, name)) => Err(Self::Input(format!("{verb} --{name}: {why}"))),
            None => Ok(()),
        }
    }

    pub(crate) fn sorted(is_input_fault: bool, message: String) -> Self {
        let kind = if is_input_fault { Self::Input } else { Self::Failed };
        kind(message)
    }
}

/// Conversion of errors that distinguish faults of the input from faults of the machine.
macro_rules! by_fault {
    ($($error:ty),*) => {$(
        impl From<$error> for CliError {
            fn from(error: $error) -> Self {
                Self::sorted(error.is_input_fault(), error.to_string())
            }
        }
    )*};
}

by_fault!(
    SceneError,
    RasterError,
    EvaluateError,
    CheckpointError,
    RunError,
    RelightError,
    ExportError,
    ViewError
);

/// Conversion of errors that always have one kind of cause.
macro_rules! always {
    ($($error:ty => $kind:ident),*) => {$(
        impl From<$error> for CliError {
            fn from(error: $error) -> Self {
                Self::$kind(error.to_string())
            }
        }
    )*};
}

always!(SessionError => Failed, ConfigError => Input, CaptureError => Input);

impl From<TrainingError> for CliError {
    fn from(error: TrainingError) -> Self {
        match error {
            TrainingError::Checkpoint(error) => error.into(),
            TrainingError::Interrupted(_) => Self::Interrupted(error.to_string()),
            TrainingError::Train(_) | TrainingError::GaveUp(..) => Self::Failed(error.to_string()),
        }
    }
}

impl From<SatelliteError> for CliError {
    fn from(error: SatelliteError) -> Self {
        match error {
            SatelliteError::Scene(error) => error.into(),
            SatelliteError::Config(error) => error.into(),
            SatelliteError::Training(error) => error.into(),
            SatelliteError::Run(error) => error.into(),
            SatelliteError::Raster(error) => error.into(),
            SatelliteError::Evaluate(error) => error.into(),
            SatelliteError::Relight(error) => error.into(),
            SatelliteError::Input(_) | SatelliteError::SceneOfRun { .. } => Self::Input(error.to_string()),
            SatelliteError::Stopped => Self::Interrupted(error.to_string()),
            SatelliteError::Unwritable(_) => Self::Failed(error.to_string()),
        }
    }
}

impl From<BatchError> for CliError {
    fn from(error: BatchError) -> Self {
        match error {
            BatchError::Satellite(error) => error.into(),
            BatchError::Training(error) => error.into(),
            BatchError::Config(error) => error.into(),
            BatchError::Run(error) => error.into(),
            BatchError::View(error) => error.into(),
            BatchError::Relight(error) => error.into(),
            BatchError::Export(error) => error.into(),
            BatchError::Evaluate(error) => error.into(),
            BatchError::Scene(error) => error.into(),
            BatchError::Raster(error) => error.into(),
            BatchError::Interrupted(_) => Self::Interrupted(error.to_string()),
            BatchError::Failed(_) => Self::Failed(error.to_string()),
            BatchError::Refused(_) => Self::Input(error.to_string()),
        }
    }
}

impl From<ObjectError> for CliError {
    fn from(error: ObjectError) -> Self {
        match error {
            ObjectError::Capture(error) => error.into(),
            ObjectError::Config(error) => error.into(),
            ObjectError::Training(error) => error.into(),
            ObjectError::Run(error) => error.into(),
            ObjectError::Raster(error) => error.into(),
            ObjectError::Memory(_) => Self::Input(error.to_string()),
            ObjectError::Settings(_) => Self::Failed(error.to_string()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn faults_have_the_exit_codes_of_the_conventions() {
        assert_eq!(CliError::from(SceneError::NoRpc("a.tif".into())).exit_code(), 2);
        assert_eq!(CliError::from(RasterError::DiskFull("a.tif".into())).exit_code(), 1);
        assert_eq!(CliError::Interrupted("saved".to_owned()).exit_code(), 130);
    }
}
