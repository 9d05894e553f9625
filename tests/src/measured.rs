//! The program run as a child, with its time and its peak memory.

use crate::program::binary;
use std::ffi::OsStr;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

/// A finished child process with its output, memory and time.
#[derive(Debug)]
pub struct Measured {
    /// Exit code; `None` when a signal ended the child.
    pub code: Option<i32>,
    /// Text on stdout.
    pub stdout: String,
    /// Text on stderr.
    pub stderr: String,
    /// Peak memory, bytes.
    pub peak_bytes: u64,
    /// Bytes read from files, its own executable among them.
    pub read_bytes: u64,
    /// Wall time.
    pub took: Duration,
}

/// Runs the program `heliosplat`; it is killed after `limit`.
pub fn run<S: AsRef<OsStr>>(arguments: &[S], limit: Duration) -> Measured {
    run_program(binary(), arguments, limit)
}

/// Runs `program`; it is killed after `limit`.
#[expect(clippy::zombie_processes, reason = "`ended` waits for the child")]
pub fn run_program<S: AsRef<OsStr>>(program: &Path, arguments: &[S], limit: Duration) -> Measured {
    let [out, err] = [(), ()].map(|()| tempfile::NamedTempFile::new().expect("a temporary file"));
    let begun = Instant::now();
    let mut child = Command::new(program)
        .args(arguments)
        .env_remove("HELIOSPLAT_LOG")
        .stdin(Stdio::null())
        .stdout(out.reopen().expect("the same file"))
        .stderr(err.reopen().expect("the same file"))
        .spawn()
        .expect("the program runs");
    let mut killed = false;
    let (status, peak_bytes, read_bytes) = loop {
        if let Some(ended) = ended(child.id()) {
            break ended;
        }
        if !killed && begun.elapsed() > limit {
            child.kill().expect("a child can be killed");
            killed = true;
        }
        std::thread::sleep(Duration::from_millis(3));
    };
    let exited = libc::WIFEXITED(status);
    let text = |file: &tempfile::NamedTempFile| {
        String::from_utf8_lossy(&std::fs::read(file.path()).expect("readable")).into_owned()
    };
    Measured {
        code: exited.then(|| libc::WEXITSTATUS(status)),
        stdout: text(&out),
        stderr: text(&err),
        peak_bytes,
        read_bytes,
        took: begun.elapsed(),
    }
}

/// Status, peak memory and bytes read of a child that has ended; `None` while it runs.
#[allow(
    unsafe_code,
    reason = "the standard library waits without telling what the child used"
)]
fn ended(id: u32) -> Option<(i32, u64, u64)> {
    let mut status = 0;
    // Read before the child is waited for, because its counters are gone afterwards.
    let io = std::fs::read_to_string(format!("/proc/{id}/io")).unwrap_or_default();
    let read = io.lines().find_map(|line| line.strip_prefix("rchar: ")?.parse().ok());
    // SAFETY: `rusage` is a plain structure of numbers, for which zeros are valid.
    let mut usage: libc::rusage = unsafe { std::mem::zeroed() };
    // SAFETY: both pointers are to locals that outlive the call; the child is ours and nobody else waits for it.
    let found = unsafe { libc::wait4(id as libc::pid_t, &raw mut status, libc::WNOHANG, &raw mut usage) };
    assert!(found >= 0, "wait4 fails");
    // Linux counts kibibytes.
    (found > 0).then_some((status, usage.ru_maxrss as u64 * 1024, read.unwrap_or(0)))
}
