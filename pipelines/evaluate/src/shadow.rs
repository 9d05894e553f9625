//! Shadow masks against truth.

use heliosplat::Raster;

/// Scores of shadow masks: `shadow` of `metrics.json`.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct ShadowScore {
    /// Balanced error rate: mean of the share of shadow predicted as lit and the share of lit pixels predicted as
    /// shadow, 0..1.
    pub ber: f64,
    /// Share of pixels predicted correctly, 0..1.
    pub accuracy: f64,
}

/// Counts of one or more images; images are scored together by adding them up.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct ShadowCounts {
    /// Pixels of shadow predicted as shadow.
    pub shadow_right: u64,
    /// Pixels of shadow predicted as lit.
    pub shadow_wrong: u64,
    /// Lit pixels predicted as lit.
    pub lit_right: u64,
    /// Lit pixels predicted as shadow.
    pub lit_wrong: u64,
}

impl ShadowCounts {
    /// Compares a visibility of the sun (0 = in shadow, 1 = lit; first band) with a truth mask (1 = in shadow). Pixels
    /// missing in either do not count.
    pub fn of(visibility: &Raster, truth: &Raster) -> Self {
        let mut counts = Self::default();
        for (&lit, &shadow) in visibility.plane(0).iter().zip(truth.plane(0)) {
            if lit.is_finite() && shadow.is_finite() {
                *match (shadow >= 0.5, lit < 0.5) {
                    (true, true) => &mut counts.shadow_right,
                    (true, false) => &mut counts.shadow_wrong,
                    (false, false) => &mut counts.lit_right,
                    (false, true) => &mut counts.lit_wrong,
                } += 1;
            }
        }
        counts
    }

    /// Adds another image's counts.
    pub fn add(&mut self, other: Self) {
        self.shadow_right += other.shadow_right;
        self.shadow_wrong += other.shadow_wrong;
        self.lit_right += other.lit_right;
        self.lit_wrong += other.lit_wrong;
    }

    /// Intersection over union of the shadows, 0..1; 1 where neither has any.
    pub fn iou(&self) -> f64 {
        match self.shadow_right + self.shadow_wrong + self.lit_wrong {
            0 => 1.0,
            union => self.shadow_right as f64 / union as f64,
        }
    }

    /// The score; `None` without any pixel. A class that does not occur has no error.
    pub fn score(&self) -> Option<ShadowScore> {
        let share = |wrong: u64, right: u64| match wrong + right {
            0 => 0.0,
            all => wrong as f64 / all as f64,
        };
        let right = self.shadow_right + self.lit_right;
        let all = right + self.shadow_wrong + self.lit_wrong;
        (all > 0).then(|| ShadowScore {
            ber: (share(self.shadow_wrong, self.shadow_right) + share(self.lit_wrong, self.lit_right)) / 2.0,
            accuracy: right as f64 / all as f64,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(values: &[f32]) -> Raster {
        Raster::of_plane(values.len(), 1, values.to_vec())
    }

    #[test]
    fn rates_are_balanced_over_rare_shadow() {
        let truth = row(&[1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, f32::NAN]);
        let visibility = row(&[0.1, 0.9, 0.9, 0.9, 0.9, 0.9, 0.9, 0.2, 0.0]);
        let score = ShadowCounts::of(&visibility, &truth).score().expect("pixels");
        assert!((score.ber - (0.5 + 1.0 / 6.0) / 2.0).abs() < 1e-12);
        assert!((score.accuracy - 6.0 / 8.0).abs() < 1e-12);
    }

    #[test]
    fn a_scene_without_shadow_is_not_punished_for_it() {
        let score = ShadowCounts::of(&row(&[1.0, 1.0]), &row(&[0.0, 0.0]))
            .score()
            .expect("pixels");
        assert_eq!((score.ber, score.accuracy), (0.0, 1.0));
    }
}
