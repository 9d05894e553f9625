// Parts of the radix sort: four bits a pass, the order of equals kept. Blocks of keys are counted by digit, the counts
// are summed over digits and blocks, and each block moves its keys to their places.

struct SortPass {
    // First bit of the digit; true if the keys are those of entries, false if those of Gaussians.
    shift: u32,
    of_entries: u32,
    unused: vec2u,
}

const DIGITS: u32 = 16u;
const THREADS: u32 = 128u;
const KEYS: u32 = 8u;
const BLOCK: u32 = THREADS * KEYS;

fn keys_in_use(entries: u32) -> u32 {
    return select(step.counts.x, min(entries, step.counts.y), sort_pass.of_entries == 1u);
}
