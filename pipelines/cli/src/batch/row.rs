//! What is known of one unit of a batch: where it stands, and what came of it.

use super::plan::{Unit, Work};
use super::stamp::Stamp;
use serde_json::Value;
use std::path::{Path, PathBuf};

/// Where the log of a unit is.
pub fn log_of(out: &Path, unit: &Unit) -> PathBuf {
    out.join(&unit.id).join("log.txt")
}

/// Where a unit stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum State {
    /// Not begun, or interrupted.
    Pending,
    /// Running now.
    Running,
    /// Finished now.
    Done,
    /// Finished before.
    Skipped,
    /// Failed; its log says why.
    Failed,
    /// What it waits for failed.
    Blocked,
}

impl State {
    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Pending => "pending",
            Self::Running => "running",
            Self::Done => "done",
            Self::Skipped => "finished before",
            Self::Failed => "failed",
            Self::Blocked => "blocked",
        }
    }

    /// Whether its products are there.
    pub fn is_done(self) -> bool {
        matches!(self, Self::Done | Self::Skipped)
    }

    /// Whether they will not be.
    pub fn is_lost(self) -> bool {
        matches!(self, Self::Failed | Self::Blocked)
    }

    /// Whether nothing more will come of it now.
    pub fn is_final(self) -> bool {
        self.is_done() || self.is_lost()
    }
}

/// A unit in the table.
#[derive(Debug, Clone, serde::Serialize)]
pub struct Row {
    /// The unit.
    pub unit: String,
    /// `tile`, `mosaic`, or `refused` where the scene cannot be used.
    pub kind: &'static str,
    /// Where it stands.
    pub state: State,
    /// Seconds it took, pauses not counted.
    pub seconds: Option<f64>,
    /// Most memory it used, bytes.
    pub peak_rss_bytes: Option<u64>,
    /// Memory it was expected to use, MiB.
    pub mem_mb: u64,
    /// Mean absolute error of its surface model where there is truth, metres, protocol `raw`.
    pub mae_m: Option<f64>,
    /// Share of it that is known.
    pub completeness: Option<f64>,
    /// Its log.
    pub log: String,
    /// Why it failed.
    pub error: Option<String>,
    /// What was measured.
    pub metrics: Value,
}

impl Row {
    /// A unit of which nothing is known yet.
    pub fn pending(unit: &Unit, out: &Path) -> Self {
        Self {
            unit: unit.id.clone(),
            kind: match unit.work {
                Work::Tile(_) => "tile",
                Work::Mosaic(_) => "mosaic",
                Work::Refused { .. } => "refused",
            },
            state: State::Pending,
            seconds: None,
            peak_rss_bytes: None,
            mem_mb: unit.mem_mb,
            mae_m: None,
            completeness: None,
            log: log_of(out, unit).display().to_string(),
            error: None,
            metrics: Value::Null,
        }
    }

    /// Notes what its stamp says.
    pub fn finish(&mut self, state: State, stamp: &Stamp) {
        let number = |pointer: &str| stamp.metrics.pointer(pointer).and_then(Value::as_f64);
        self.state = state;
        self.seconds = Some(stamp.seconds);
        self.peak_rss_bytes = Some(stamp.peak_rss_bytes);
        self.mae_m = number("/dsm/mae_m");
        self.completeness = number("/completeness");
        self.metrics = stamp.metrics.clone();
    }

    /// Notes that it failed.
    pub fn fail(&mut self, error: String) {
        self.state = State::Failed;
        self.error = Some(error);
    }
}
