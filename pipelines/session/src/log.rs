//! Logs on stderr, written around a progress bar if there is one.

use indicatif::MultiProgress;
use std::io::{IsTerminal, Write};
use std::sync::LazyLock;
use tracing_subscriber::EnvFilter;
use tracing_subscriber::fmt::MakeWriter;

/// All bars of the process, so that log lines can step around them.
pub(crate) static BARS: LazyLock<MultiProgress> = LazyLock::new(MultiProgress::new);

struct Stderr;

impl Write for Stderr {
    /// A line that cannot be written, because its reader is gone or the disk is full, is lost; the work goes on.
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        let _ = BARS.suspend(|| std::io::stderr().write_all(bytes));
        Ok(bytes.len())
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

struct StderrMaker;

impl<'a> MakeWriter<'a> for StderrMaker {
    type Writer = Stderr;

    fn make_writer(&'a self) -> Stderr {
        Stderr
    }
}

/// Starts logging; `HELIOSPLAT_LOG` (as `RUST_LOG` elsewhere) wins over `verbose`.
pub fn start(verbose: u8) {
    let level = match verbose {
        0 => "info",
        1 => "debug",
        _ => "trace",
    };
    let filter = EnvFilter::try_from_env("HELIOSPLAT_LOG").unwrap_or_else(|_| EnvFilter::new(level));
    // A second start, as in tests, keeps the first logger.
    let _ = tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(StderrMaker)
        .with_ansi(std::io::stderr().is_terminal())
        .log_internal_errors(false)
        .without_time()
        .with_target(false)
        .try_init();
}

/// A count with its thousands apart, for people: `161,532`.
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

/// A text without control characters other than line ends and tabs: names of files may have them, terminals obey them, and no HTML allows them.
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
