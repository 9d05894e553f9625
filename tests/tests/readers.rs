//! Every reader of outside bytes over a corpus and mutations of it: no panic, no hang, no memory beyond that justified
//! by the input.
//!
//! The same functions are the targets of `fuzz/`. `HELIOSPLAT_FUZZ_CASES=100000` tries more per input.

use heliosplat_tests::mutate::mutations;
use heliosplat_tests::readers::READERS;
use peak_alloc::PeakAlloc;
use std::time::{Duration, Instant};

#[global_allocator]
static ALLOCATOR: PeakAlloc = PeakAlloc;

/// Memory per byte of input, and besides: trees of XML, JSON and TOML have nodes far larger than their shortest texts.
const BYTES_PER_BYTE: usize = 400;
const BYTES_BESIDES: usize = 4 << 20;
/// A reader that takes longer hangs, on any machine.
const LONGEST: Duration = Duration::from_secs(20);

// One test alone in this binary: allocations of other tests would be counted too.
#[test]
fn readers_survive_whatever_they_are_given() {
    let cases = std::env::var("HELIOSPLAT_FUZZ_CASES").map_or(250, |n| n.parse().expect("a whole number"));
    let mut all = 0;
    for reader in READERS {
        let corpus = (reader.corpus)();
        let (mut accepted, mut inputs, mut worst) = (0, 0, 0.0f64);
        for (number, sound) in corpus.iter().enumerate() {
            assert!(
                (reader.read)(sound),
                "{} {number}: the sound input is refused",
                reader.name
            );
            for (case, input) in mutations(sound, number as u64, cases).into_iter().enumerate() {
                ALLOCATOR.reset_peak_usage();
                let before = ALLOCATOR.current_usage();
                let begun = Instant::now();
                let input_shown = || String::from_utf8_lossy(&input[..input.len().min(300)]).into_owned();
                accepted += usize::from((reader.read)(&input));
                let (took, used) = (begun.elapsed(), ALLOCATOR.peak_usage().saturating_sub(before));
                let allowed = BYTES_PER_BYTE * input.len() + BYTES_BESIDES;
                assert!(
                    used <= allowed,
                    "{} {number}.{case}: {used} bytes for {}: {}",
                    reader.name,
                    input.len(),
                    input_shown()
                );
                assert!(
                    took < LONGEST,
                    "{} {number}.{case}: {took:?}: {}",
                    reader.name,
                    input_shown()
                );
                worst = worst.max(used as f64 / allowed as f64);
                inputs += 1;
            }
        }
        println!(
            "{}: {inputs} inputs, {accepted} accepted, at most {:.0} % of the memory allowed",
            reader.name,
            100.0 * worst
        );
        all += inputs;
    }
    assert!(all > 3000, "{all}");
}
