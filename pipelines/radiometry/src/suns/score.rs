//! Correlation of the shadows of a sun with dark ground.

use heliosplat_grid::relief::Relief;

/// Blocks of ground on each side, the units of the bootstrap: each holds whole shadows.
pub(super) const BLOCKS: usize = 8;

/// Darkness of a sampled cell.
#[derive(Debug, Clone, Copy)]
pub(super) struct CellDarkness {
    /// Its index among the sampled cells.
    place: usize,
    block: usize,
    darkness: f64,
}

/// Samples of the `cells` whose `darkness` (one value each) on a date is known.
pub(super) fn samples(relief: &Relief, cells: &[usize], darkness: &[f32]) -> Vec<CellDarkness> {
    let block = |cell: usize| {
        let (col, row) = (cell % relief.width, cell / relief.width);
        row * BLOCKS / relief.height * BLOCKS + col * BLOCKS / relief.width
    };
    let known = cells
        .iter()
        .zip(darkness)
        .enumerate()
        .filter(|(_, (_, d))| d.is_finite());
    known
        .map(|(place, (&cell, &d))| CellDarkness {
            place,
            block: block(cell),
            darkness: d.into(),
        })
        .collect()
}

/// Number, sum and sum of squares of the darkness of some cells.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Moments {
    count: f64,
    sum: f64,
    squares: f64,
}

impl Moments {
    fn add(&mut self, darkness: f64) {
        self.count += 1.0;
        self.sum += darkness;
        self.squares += darkness * darkness;
    }

    pub(super) fn plus(&mut self, other: &Self, times: f64) {
        self.count += times * other.count;
        self.sum += times * other.sum;
        self.squares += times * other.squares;
    }

    /// Sum over all blocks, each multiplied by its number of repetitions.
    pub(super) fn weighted(blocks: &[Self], times: &[u32]) -> Self {
        let mut total = Self::default();
        for (block, &times) in blocks.iter().zip(times) {
            total.plus(block, f64::from(times));
        }
        total
    }

    /// Correlation between membership in the `shaded` cells among these and darkness, -1 to 1; 0 where it is undefined.
    pub(super) fn correlation(&self, shaded: &Self) -> f64 {
        let share = shaded.count / self.count;
        let mean = self.sum / self.count;
        let covariance = shaded.sum / self.count - share * mean;
        let variances = share * (1.0 - share) * (self.squares / self.count - mean * mean);
        if variances > 1e-12 {
            covariance / variances.sqrt()
        } else {
            0.0
        }
    }
}

/// Moments of all samples, block by block.
pub(super) fn all_sums(samples: &[CellDarkness]) -> Vec<Moments> {
    let mut sums = vec![Moments::default(); BLOCKS * BLOCKS];
    samples
        .iter()
        .for_each(|sample| sums[sample.block].add(sample.darkness));
    sums
}

/// Moments of the samples in shadow, `[elevation][block]`, for ascending `elevations_deg`; `horizons` are the tangents
/// of the horizons of all sampled cells toward the sun's azimuth.
pub(super) fn shaded_sums(horizons: &[f32], samples: &[CellDarkness], elevations_deg: &[f64]) -> Vec<Vec<Moments>> {
    let tangents: Vec<f32> = elevations_deg.iter().map(|e| e.to_radians().tan() as f32).collect();
    let mut sums = vec![vec![Moments::default(); BLOCKS * BLOCKS]; elevations_deg.len()];
    for sample in samples {
        let horizon = horizons[sample.place];
        // A cell is in shadow for all suns below its horizon: it is added to the highest one, and sums from there down
        // follow.
        let below = tangents.partition_point(|&tangent| tangent < horizon);
        if let Some(highest) = below.checked_sub(1) {
            sums[highest][sample.block].add(sample.darkness);
        }
    }
    for elevation in (1..sums.len()).rev() {
        let (lower, higher) = sums.split_at_mut(elevation);
        for (into, from) in lower[elevation - 1].iter_mut().zip(&higher[0]) {
            into.plus(from, 1.0);
        }
    }
    sums
}

/// Scores of suns at the ascending `elevations_deg` of one azimuth: correlation of shadow and darkness, -1 to 1.
pub(super) fn of_azimuth(horizons: &[f32], samples: &[CellDarkness], elevations_deg: &[f64]) -> Vec<f64> {
    let once = vec![1; BLOCKS * BLOCKS];
    let total = Moments::weighted(&all_sums(samples), &once);
    let shaded = shaded_sums(horizons, samples, elevations_deg);
    let score = |blocks: &Vec<Moments>| total.correlation(&Moments::weighted(blocks, &once));
    shaded.iter().map(score).collect()
}

/// Bootstrap draws of blocks with replacement, from a fixed seed.
pub(super) struct Draws {
    state: u64,
}

impl Draws {
    /// Generator at its fixed seed.
    pub(super) fn new() -> Self {
        Self { state: 1 }
    }

    /// Number of times that each block is drawn, for the next draw.
    pub(super) fn next(&mut self) -> Vec<u32> {
        let blocks = BLOCKS * BLOCKS;
        let mut times = vec![0; blocks];
        for _ in 0..blocks {
            // SplitMix64 (Steele, Lea and Flood 2014).
            self.state = self.state.wrapping_add(0x9e37_79b9_7f4a_7c15);
            let mut mixed = self.state;
            mixed = (mixed ^ (mixed >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
            mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
            times[((mixed ^ (mixed >> 31)) % blocks as u64) as usize] += 1;
        }
        times
    }
}
