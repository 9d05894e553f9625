//! Random numbers of a pixel's paths: stratified over all paths of the pixel (Sobol) where few dimensions are drawn,
//! independent in random walks, whose number of dimensions has no bound.

use nalgebra::Vector2;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg32;

/// Dimensions that one turn of a path uses: a choice and a place for each of two samples.
const PER_TURN: u32 = 6;
/// Dimensions of the place within the pixel, which come first.
const OF_PIXEL: u32 = 2;

/// The random numbers of one path of a pixel. For each purpose the paths of a pixel draw from a Sobol sequence,
/// scrambled after Owen (B. Burley, "Practical hash-based Owen scrambling", JCGT 9(4), 2020) with the pixel's seed:
/// best where the number of paths is a power of two.
pub(crate) struct PathSampler {
    seed: u32,
    path: u32,
    random: Pcg32,
}

impl PathSampler {
    /// Random numbers of path number `path` of the pixel with the seed `seed`.
    pub(crate) fn new(seed: u64, path: u32) -> Self {
        let mut random = Pcg32::new(seed, u64::from(path));
        // Neighbouring streams begin with similar numbers.
        let _: u32 = random.random();
        Self {
            seed: Pcg32::seed_from_u64(seed).random(),
            path,
            random,
        }
    }

    fn sobol(&self, dimension: u32) -> f64 {
        f64::from(sobol_burley::sample(self.path, dimension, self.seed))
    }

    /// Position within the pixel, both coordinates in [0, 1).
    pub(crate) fn within_pixel(&self) -> Vector2<f64> {
        Vector2::new(self.sobol(0), self.sobol(1))
    }

    /// One number and a pair of numbers in [0, 1) for one of the two samples (0 or 1) at a turn of the path.
    pub(crate) fn at_turn(&self, turn: usize, sample: u32) -> (f64, Vector2<f64>) {
        let first = OF_PIXEL + PER_TURN * turn as u32 + 3 * sample;
        let pair = Vector2::new(self.sobol(first + 1), self.sobol(first + 2));
        (self.sobol(first), pair)
    }

    /// Number in [0, 1), independent of those of other paths.
    pub(crate) fn any(&mut self) -> f64 {
        self.random.random()
    }

    /// Two numbers of [`Self::any`].
    pub(crate) fn any_pair(&mut self) -> Vector2<f64> {
        Vector2::new(self.any(), self.any())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sixteen_paths_put_one_place_in_each_of_sixteen_squares_and_pixels_differ() {
        let places = |seed| (0..16).map(move |path| PathSampler::new(seed, path).within_pixel());
        for seed in [1, 77] {
            let mut squares: Vec<_> = places(seed).map(|u| ((u.x * 4.0) as u8, (u.y * 4.0) as u8)).collect();
            squares.sort_unstable();
            squares.dedup();
            assert_eq!(squares.len(), 16);
        }
        assert!(places(1).zip(places(2)).all(|(a, b)| a != b));
    }

    #[test]
    fn unrelated_numbers_are_even_over_paths() {
        let paths = 1 << 12;
        let mean = (0..paths).map(|path| PathSampler::new(5, path).any()).sum::<f64>() / f64::from(paths);
        assert!((mean - 0.5).abs() < 0.02, "{mean}");
    }
}
