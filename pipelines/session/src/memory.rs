//! Memory of the machine.

/// Bytes of memory of this machine, or the limit of its control group; `None` where the system does not report it.
pub fn machine_bytes() -> Option<u64> {
    let installed = std::fs::read_to_string("/proc/meminfo").ok().as_deref().and_then(total);
    let limits = [
        "/sys/fs/cgroup/memory.max",
        "/sys/fs/cgroup/memory/memory.limit_in_bytes",
    ];
    let mut limits = limits.iter();
    let allowed = limits.find_map(|path| std::fs::read_to_string(path).ok()?.trim().parse().ok());
    installed.into_iter().chain(allowed).min()
}

/// The total of `/proc/meminfo`, which counts in KiB.
fn total(text: &str) -> Option<u64> {
    let line = text.lines().find_map(|line| line.strip_prefix("MemTotal:"))?;
    let kib: u64 = line.split_whitespace().next()?.parse().ok()?;
    Some(kib * 1024)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_total_is_said_in_kibibytes() {
        let text = "MemFree:  1 kB\nMemTotal:       24589676 kB\nMemFree:  3 kB\n";
        assert_eq!(total(text), Some(24_589_676 * 1024));
        assert_eq!(total("nothing"), None);
    }
}
