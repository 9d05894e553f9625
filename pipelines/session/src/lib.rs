//! Terminal output of all verbs: progress bars, log lines written around them, and the user's request to stop.
//!
//! Libraries take a [`Session`] to report progress and to stop early; [`Session::quiet`] is for use without a terminal.

pub mod log;
pub mod memory;

use indicatif::{HumanDuration, ProgressBar, ProgressDrawTarget, ProgressState, ProgressStyle};
use std::fmt::Write;
use std::io::IsTerminal;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

/// Environment variable that requests progress in lines where stderr is no terminal.
const PROGRESS_VARIABLE: &str = "HELIOSPLAT_PROGRESS";

/// The signal handler cannot be installed.
#[derive(Debug, thiserror::Error)]
#[error("the signal handler cannot be installed: {0}")]
pub struct SessionError(ctrlc::Error);

/// Exit code of a process that the user stopped.
const INTERRUPTED: i32 = 130;

/// Steps of the bar of a whole.
const STEPS_OF_WHOLE: f64 = 1000.0;

/// Progress output and stop requests during one verb.
#[derive(Debug, Clone, Default)]
pub struct Session {
    stop: Arc<AtomicBool>,
    gentle: Arc<AtomicBool>,
    is_quiet: bool,
    whole: Arc<Mutex<Vec<Part>>>,
}

/// A part of a whole: its share of the bar.
#[derive(Debug, Clone)]
struct Part {
    label: &'static str,
    /// First and last step of the bar.
    steps: [f64; 2],
    bar: Arc<Progress>,
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

    /// Starts one bar over `parts`, in their order with their expected shares of the time, in any unit. While the
    /// result lives, [`Self::progress`] moves this bar.
    pub fn whole(&self, label: &str, parts: &[(&'static str, f64)]) -> Whole {
        let style = "{prefix} [{bar:30}] {percent} % {left} {msg}";
        let bar = Arc::new(self.bar(label, ProgressBar::new(STEPS_OF_WHOLE as u64), style));
        let all: f64 = parts.iter().map(|(_, share)| share).sum();
        let mut end = 0.0;
        let parts = parts.iter().map(|&(label, share)| {
            let begin = end;
            end += STEPS_OF_WHOLE * share / all;
            let (steps, bar) = ([begin, end], Arc::clone(&bar));
            Part { label, steps, bar }
        });
        *self.parts() = parts.collect();
        Whole(self.clone())
    }

    fn parts(&self) -> std::sync::MutexGuard<'_, Vec<Part>> {
        self.whole.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Starts a progress bar of `total` steps on a terminal, or its part of the bar of a whole. Elsewhere, if
    /// `HELIOSPLAT_PROGRESS=lines` is set for a program that reads stderr, each percent is reported there as a line
    /// `progress LABEL N %`.
    pub fn progress(&self, label: &str, total: u64) -> Progress {
        let part = self.parts().iter().find(|part| part.label == label).cloned();
        if let Some(part) = part {
            part.bar.message(label);
            let bar = ProgressBar::with_draw_target(Some(total), ProgressDrawTarget::hidden());
            let (lines, part) = (None, Some(part));
            let progress = Progress { bar, lines, part };
            progress.set(0);
            return progress;
        }
        let style = "{prefix} [{bar:30}] {pos}/{len} {per_sec} left {eta} {msg}";
        self.bar(label, ProgressBar::new(total), style)
    }

    fn bar(&self, label: &str, bar: ProgressBar, style: &str) -> Progress {
        let part = None;
        if std::io::stderr().is_terminal() && !self.is_quiet {
            let (bar, lines) = (log::BARS.add(bar), None);
            if let Ok(style) = ProgressStyle::with_template(style) {
                bar.set_style(style.progress_chars("=> ").with_key("left", time_left));
            }
            bar.set_prefix(label.to_owned());
            bar.enable_steady_tick(Duration::from_millis(250));
            return Progress { bar, lines, part };
        }
        bar.set_draw_target(ProgressDrawTarget::hidden());
        let wanted = std::env::var_os(PROGRESS_VARIABLE).is_some_and(|value| value == "lines");
        let lines = wanted.then(|| Lines {
            label: label.to_owned(),
            reported: AtomicU64::new(0),
        });
        Progress { bar, lines, part }
    }
}

/// A time left in words, such as "about 5 minutes left".
pub fn about_left(seconds: f64) -> String {
    let whole = Duration::try_from_secs_f64(seconds.round()).unwrap_or(Duration::MAX);
    format!("about {} left", HumanDuration(whole))
}

/// Writes the time left of a bar; nothing before its first step, when it is not known.
fn time_left(state: &ProgressState, out: &mut dyn Write) {
    if state.pos() > 0 {
        // A bar that cannot be written is not shown.
        let _ = write!(out, "left {:#}", HumanDuration(state.eta()));
    }
}

/// The bar of a whole, removed when dropped.
pub struct Whole(Session);

impl Drop for Whole {
    fn drop(&mut self) {
        self.0.parts().clear();
    }
}

/// A progress bar or line, removed when dropped.
#[derive(Debug)]
pub struct Progress {
    bar: ProgressBar,
    lines: Option<Lines>,
    part: Option<Part>,
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
        if let Some(Part { steps, bar, .. }) = &self.part {
            let share = done as f64 / self.bar.length().unwrap_or_default().max(1) as f64;
            bar.set((steps[0] + (steps[1] - steps[0]) * share.min(1.0)) as u64);
        }
    }

    /// Changes the number of steps.
    pub fn set_total(&self, total: u64) {
        self.bar.set_length(total);
    }

    /// Shows a short message next to the bar, such as the loss.
    pub fn message(&self, message: &str) {
        match &self.part {
            Some(part) => part.bar.message(&format!("{}: {message}", part.label)),
            None => self.bar.set_message(message.to_owned()),
        }
    }
}

impl Drop for Progress {
    fn drop(&mut self) {
        self.bar.finish_and_clear();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_time_left_is_in_words_and_never_fails() {
        assert_eq!(about_left(1515.0), "about 25 minutes left");
        assert_eq!(about_left(1.2), "about 1 second left");
        assert!(about_left(f64::INFINITY).ends_with("left") && about_left(f64::NAN).ends_with("left"));
    }
}
