//! Logs on stderr, written around a progress bar if there is one, and a copy with times in the folder of a run.

use indicatif::MultiProgress;
use std::fs::File;
use std::io::{IsTerminal, Write};
use std::path::Path;
use std::sync::{LazyLock, Mutex, MutexGuard, PoisonError};
use tracing_subscriber::EnvFilter;
use tracing_subscriber::fmt;
use tracing_subscriber::layer::SubscriberExt;
use tracing_subscriber::util::SubscriberInitExt;

/// All bars of the process, so that log lines can step around them.
pub(crate) static BARS: LazyLock<MultiProgress> = LazyLock::new(MultiProgress::new);

struct Stderr;

impl Write for Stderr {
    /// A line that cannot be written, because its reader has ended or the disk is full, is lost; the work continues.
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        let _ = BARS.suspend(|| std::io::stderr().write_all(bytes));
        Ok(bytes.len())
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

/// Name of the copy of the log in the folder of a run.
pub const FILE: &str = "log.txt";
/// Bytes of log lines that wait for a folder, at most.
const WAITING_BYTES: usize = 1 << 20;

/// The copy of the log: the lines written before the run had a folder, and the file from then on.
struct KeptLog {
    waiting: Vec<u8>,
    file: Option<File>,
}

static KEPT: Mutex<KeptLog> = Mutex::new(KeptLog {
    waiting: Vec::new(),
    file: None,
});

fn kept() -> MutexGuard<'static, KeptLog> {
    KEPT.lock().unwrap_or_else(PoisonError::into_inner)
}

struct CopyWriter;

impl Write for CopyWriter {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        let mut kept = kept();
        if let Some(file) = &mut kept.file {
            // As on stderr, a line that cannot be written is lost.
            let _ = file.write_all(bytes);
        } else if kept.waiting.len() + bytes.len() <= WAITING_BYTES {
            kept.waiting.extend_from_slice(bytes);
        }
        Ok(bytes.len())
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

/// Appends the log with times to the file [`FILE`] of a folder: all lines so far, and those that follow. Nothing
/// happens where the file cannot be opened.
pub fn keep_in(folder: &Path) {
    let mut kept = kept();
    let file = File::options().create(true).append(true).open(folder.join(FILE));
    let Ok(mut file) = file else { return };
    let waiting = std::mem::take(&mut kept.waiting);
    let _ = file.write_all(&waiting);
    kept.file = Some(file);
}

/// Starts logging: warnings if `quiet`, else `info`, `debug` (`verbose` 1) or `trace` (2 and more). `HELIOSPLAT_LOG`,
/// in the syntax of `RUST_LOG`, overrides both. No colours are used where `NO_COLOR` is set (no-color.org).
pub fn start(verbose: u8, quiet: bool) {
    let level = match (quiet, verbose) {
        (true, _) => "warn",
        (false, 0) => "info",
        (false, 1) => "debug",
        (false, _) => "trace",
    };
    let filter = EnvFilter::try_from_env("HELIOSPLAT_LOG").unwrap_or_else(|_| EnvFilter::new(level));
    let is_plain = std::env::var_os("NO_COLOR").is_some_and(|value| !value.is_empty());
    let on_stderr = fmt::layer()
        .with_writer(|| Stderr)
        .with_ansi(!is_plain && std::io::stderr().is_terminal())
        .log_internal_errors(false)
        .without_time()
        .with_target(false);
    let in_file = fmt::layer()
        .with_writer(|| CopyWriter)
        .with_ansi(false)
        .log_internal_errors(false)
        .with_target(false);
    // A second start, as in tests, keeps the first logger.
    let _ = tracing_subscriber::registry()
        .with(filter)
        .with(on_stderr)
        .with(in_file)
        .try_init();
}

/// A count as text with commas between thousands: `161,532`.
pub fn grouped(count: usize) -> String {
    let digits = count.to_string();
    let mut text = String::with_capacity(digits.len() + digits.len() / 3);
    for (place, digit) in digits.chars().enumerate() {
        if place > 0 && (digits.len() - place).is_multiple_of(3) {
            text.push(',');
        }
        text.push(digit);
    }
    text
}

/// One line on stderr, whatever the log level.
pub fn line_on_stderr(line: &str) {
    let _ = writeln!(Stderr, "{}", printable(line));
}

/// A text without control characters other than line ends and tabs: names of files may have them, terminals obey them,
/// and no HTML allows them.
pub fn printable(text: &str) -> String {
    let is_control = |c: char| c.is_control() && c != '\n' && c != '\t';
    text.replace(is_control, "\u{fffd}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn thousands_stand_apart() {
        for (count, text) in [
            (0, "0"),
            (999, "999"),
            (1000, "1,000"),
            (161_532, "161,532"),
            (12_345_678, "12,345,678"),
        ] {
            assert_eq!(grouped(count), text);
        }
    }
}
