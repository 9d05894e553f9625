//! What a running verb shares with the terminal: whether the user wants it to stop, and how far it is.

use super::{CliError, log};
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::io::IsTerminal;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// The run of one verb.
#[derive(Debug, Clone, Default)]
pub struct Session {
    stop: Arc<AtomicBool>,
}

impl Session {
    /// A session that SIGINT and SIGTERM ask to stop; a second signal ends the process at once.
    ///
    /// # Errors
    /// When the signal handler cannot be installed.
    pub fn start() -> Result<Self, CliError> {
        let session = Self::default();
        let stop = Arc::clone(&session.stop);
        ctrlc::set_handler(move || {
            if stop.swap(true, Ordering::SeqCst) {
                std::process::exit(130);
            }
            log::line_on_stderr("stopping: saving what there is (once more to stop at once)");
        })
        .map_err(|error| CliError::Failed(format!("the signal handler cannot be installed: {error}")))?;
        Ok(session)
    }

    /// A session nobody will stop, for tests and for use as a library.
    pub fn quiet() -> Self {
        Self::default()
    }

    /// Whether the user asked to stop.
    pub fn stopped(&self) -> bool {
        self.stop.load(Ordering::SeqCst)
    }

    /// The flag itself, for loops that know nothing of sessions.
    pub fn stop_flag(&self) -> Arc<AtomicBool> {
        Arc::clone(&self.stop)
    }

    /// A progress bar of `total` steps; on a terminal only.
    pub fn progress(&self, label: &str, total: u64) -> Progress {
        let bar = ProgressBar::new(total);
        if std::io::stderr().is_terminal() {
            let bar = log::BARS.add(bar);
            let style = "{prefix} [{bar:30}] {pos}/{len} {per_sec} left {eta} {msg}";
            if let Ok(style) = ProgressStyle::with_template(style) {
                bar.set_style(style.progress_chars("=> "));
            }
            bar.set_prefix(label.to_owned());
            bar.enable_steady_tick(Duration::from_millis(250));
            return Progress { bar };
        }
        bar.set_draw_target(ProgressDrawTarget::hidden());
        Progress { bar }
    }
}

/// A progress bar; gone when dropped.
#[derive(Debug)]
pub struct Progress {
    bar: ProgressBar,
}

impl Progress {
    /// Sets the number of steps done.
    pub fn set(&self, done: u64) {
        self.bar.set_position(done);
    }

    /// Changes how many steps there are.
    pub fn set_total(&self, total: u64) {
        self.bar.set_length(total);
    }

    /// Says something short beside the bar, such as the loss.
    pub fn say(&self, message: &str) {
        self.bar.set_message(message.to_owned());
    }
}

impl Drop for Progress {
    fn drop(&mut self) {
        self.bar.finish_and_clear();
    }
}
