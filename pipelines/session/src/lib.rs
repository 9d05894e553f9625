//! Terminal output of all verbs: progress bars, log lines written around them, and the user's request to stop.
//!
//! Libraries take a [`Session`] to report progress and to stop early; [`Session::quiet`] is for use without a terminal.

pub mod log;
pub mod memory;

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::io::IsTerminal;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Duration;

/// Environment variable that requests progress in lines where stderr is no terminal.
const PROGRESS_VARIABLE: &str = "HELIOSPLAT_PROGRESS";

/// The signal handler cannot be installed.
#[derive(Debug, thiserror::Error)]
#[error("the signal handler cannot be installed: {0}")]
pub struct SessionError(ctrlc::Error);

/// Exit code of a process that the user stopped.
const INTERRUPTED: i32 = 130;

/// Progress output and stop requests during one verb.
#[derive(Debug, Clone, Default)]
pub struct Session {
    stop: Arc<AtomicBool>,
    gentle: Arc<AtomicBool>,
    is_quiet: bool,
}

impl Session {
    /// A session that SIGINT and SIGTERM stop: at once, or after a call of [`Self::stop_gently`] when the caller polls
    /// [`Self::stopped`]; then a second signal ends the process at once.
    ///
    /// # Errors
    /// When the signal handler cannot be installed.
    pub fn start() -> Result<Self, SessionError> {
        let session = Self::default();
        let signalled = session.clone();
        ctrlc::set_handler(move || {
            if signalled.stop.swap(true, Ordering::SeqCst) || !signalled.saves() {
                std::process::exit(INTERRUPTED);
            }
            log::line_on_stderr("stopping after the results are saved (press again to stop at once)");
        })
        .map_err(SessionError)?;
        Ok(session)
    }

    /// A session without a stop, for tests and for use as a library.
    pub fn quiet() -> Self {
        Self::default()
    }

    /// The session without progress bars if `is_quiet`.
    pub fn quietly(self, is_quiet: bool) -> Self {
        Self { is_quiet, ..self }
    }

    /// Leaves the stop to the caller, who polls [`Self::stopped`] from now on and saves the results so far.
    pub fn stop_gently(&self) {
        self.gentle.store(true, Ordering::SeqCst);
    }

    fn saves(&self) -> bool {
        self.gentle.load(Ordering::SeqCst)
    }

    /// True if the user requested a stop.
    pub fn stopped(&self) -> bool {
        self.stop.load(Ordering::SeqCst)
    }

    /// Also stops when standard input ends: the parent process has ended or requests a stop.
    pub fn stop_with_input(&self) {
        let session = self.clone();
        std::thread::spawn(move || {
            // The input itself is ignored; only its end matters.
            let _ = std::io::copy(&mut std::io::stdin().lock(), &mut std::io::sink());
            session.stop.store(true, Ordering::SeqCst);
            if !session.saves() {
                std::process::exit(INTERRUPTED);
            }
        });
    }

    /// Starts a line for one of several parallel tasks, with its elapsed time and a message; on a terminal only.
    pub fn watch(&self, label: &str) -> Progress {
        self.bar(label, ProgressBar::no_length(), "{prefix} {elapsed} {msg}")
    }

    /// Starts a progress bar of `total` steps on a terminal. Elsewhere, if `HELIOSPLAT_PROGRESS=lines` is set for a
    /// program that reads stderr, each percent is reported there as a line `progress LABEL N %`.
    pub fn progress(&self, label: &str, total: u64) -> Progress {
        let style = "{prefix} [{bar:30}] {pos}/{len} {per_sec} left {eta} {msg}";
        self.bar(label, ProgressBar::new(total), style)
    }

    fn bar(&self, label: &str, bar: ProgressBar, style: &str) -> Progress {
        if std::io::stderr().is_terminal() && !self.is_quiet {
            let bar = log::BARS.add(bar);
            if let Ok(style) = ProgressStyle::with_template(style) {
                bar.set_style(style.progress_chars("=> "));
            }
            bar.set_prefix(label.to_owned());
            bar.enable_steady_tick(Duration::from_millis(250));
            return Progress { bar, lines: None };
        }
        bar.set_draw_target(ProgressDrawTarget::hidden());
        let wanted = std::env::var_os(PROGRESS_VARIABLE).is_some_and(|value| value == "lines");
        let lines = wanted.then(|| Lines {
            label: label.to_owned(),
            reported: AtomicU64::new(0),
        });
        Progress { bar, lines }
    }
}

/// A progress bar or line, removed when dropped.
#[derive(Debug)]
pub struct Progress {
    bar: ProgressBar,
    lines: Option<Lines>,
}

/// Progress in lines, for programs that read stderr.
#[derive(Debug)]
struct Lines {
    label: String,
    /// Percent already reported.
    reported: AtomicU64,
}

impl Lines {
    fn at(&self, done: u64, total: Option<u64>) {
        let Some(total) = total.filter(|&total| total > 0) else {
            return;
        };
        let hundredths = done.min(total).saturating_mul(100) / total;
        if self.reported.fetch_max(hundredths, Ordering::Relaxed) < hundredths {
            log::line_on_stderr(&format!("progress {} {hundredths} %", self.label));
        }
    }
}

impl Progress {
    /// Sets the number of steps done.
    pub fn set(&self, done: u64) {
        self.bar.set_position(done);
        if let Some(lines) = &self.lines {
            lines.at(done, self.bar.length());
        }
    }

    /// Changes the number of steps.
    pub fn set_total(&self, total: u64) {
        self.bar.set_length(total);
    }

    /// Shows a short message next to the bar, such as the loss.
    pub fn message(&self, message: &str) {
        self.bar.set_message(message.to_owned());
    }
}

impl Drop for Progress {
    fn drop(&mut self) {
        self.bar.finish_and_clear();
    }
}
