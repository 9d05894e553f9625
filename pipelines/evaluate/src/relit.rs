//! Relit images against truth under suns that no image had.
//!
//! * **One gain**: a gain and an offset per band, by least squares over all suns together. Only this score measures the
//!   darkening of a scene as its sun sinks, which a gain per sun hides.
//! * **Own gain**: a gain and an offset per band for each sun by itself, as after a manual exposure correction.
//! * **Brightness**: mean of the predicted values after the one gain, relative to that of the truth.
//! * **Shadows**: balanced error rate and intersection over union of the traced masks.
//!
//! The peak of PSNR is the 99.5th percentile of the brightest truth: the largest such percentile of all suns, over all
//! bands.

use crate::image::psnr_db;
use crate::shadow::ShadowCounts;
use heliosplat::Raster;
use heliosplat_grid::statistics::quantile;

/// The quantile of the brightest truth that is the peak.
const PEAK_QUANTILE: f64 = 0.995;

/// Rasters compared under one sun, all on one grid.
#[derive(Debug, Clone, Copy)]
pub struct RelitPair<'a> {
    /// Predicted image, in any unit that is linear in radiance.
    pub ours: &'a Raster,
    /// True image with as many bands, linear in radiance.
    pub truth: &'a Raster,
    /// Predicted shadow mask: 1 in shadow, 0 in the sun; values between are rounded.
    pub our_shadow: &'a Raster,
    /// True shadow mask: 1 in shadow, 0 in the sun.
    pub true_shadow: &'a Raster,
}

/// Scores of one sun.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct RelitScore {
    /// PSNR of all bands after the one gain and offset per band, dB.
    pub psnr_one_gain_db: f64,
    /// PSNR of all bands after this sun's own gain and offset per band, dB.
    pub psnr_own_gain_db: f64,
    /// Mean of the prediction after the one gain over the mean of the truth, all bands together.
    pub brightness_ratio: f64,
    /// Balanced error rate of the shadow mask, 0 to 1.
    pub ber: f64,
    /// Intersection over union of the shadows, 0 to 1.
    pub iou: f64,
    /// Share of the truth's values that the prediction has too, 0 to 1.
    pub completeness: f64,
}

/// Scores of all suns, with the gains and offsets from prediction to truth.
#[derive(Debug, Clone, PartialEq)]
pub struct RelitScores {
    /// Score of each sun, in the order of the pairs.
    pub suns: Vec<RelitScore>,
    /// Mean of the scores over all suns.
    pub mean: RelitScore,
    /// The one gain and offset of each band: truth is about `gain * prediction + offset`.
    pub gains: Vec<[f64; 2]>,
    /// The peak of PSNR, in the truth's unit.
    pub peak: f64,
}

/// Scores relit images, one pair for each sun. `None` without pairs, or where under some sun a band, or the pair of
/// shadow masks, has no pixel known in both.
pub fn score_relit(pairs: &[RelitPair]) -> Option<RelitScores> {
    let bands = pairs.first()?.truth.bands;
    let peak = pairs.iter().filter_map(|pair| peak_of(pair.truth)).reduce(f64::max)?;
    let gains = (0..bands).map(|band| line_through(pairs.iter().map(|pair| (pair, band))));
    let gains: Vec<[f64; 2]> = gains.collect::<Option<_>>()?;
    let scores = pairs.iter().map(|pair| score_one(pair, &gains, peak));
    let suns: Vec<RelitScore> = scores.collect::<Option<_>>()?;
    Some(RelitScores {
        mean: mean(&suns),
        suns,
        gains,
        peak,
    })
}

fn peak_of(truth: &Raster) -> Option<f64> {
    let mut known: Vec<f32> = truth.values.iter().copied().filter(|v| v.is_finite()).collect();
    quantile(&mut known, PEAK_QUANTILE).map(f64::from)
}

fn score_one(pair: &RelitPair, gains: &[[f64; 2]], peak: f64) -> Option<RelitScore> {
    let own = (0..gains.len()).map(|band| line_through(std::iter::once((pair, band))));
    let own: Vec<[f64; 2]> = own.collect::<Option<_>>()?;
    let (one, own) = (Difference::of(pair, gains)?, Difference::of(pair, &own)?);
    let lit = Raster {
        values: pair.our_shadow.values.iter().map(|shadow| 1.0 - shadow).collect(),
        ..*pair.our_shadow
    };
    let shadows = ShadowCounts::of(&lit, pair.true_shadow);
    Some(RelitScore {
        psnr_one_gain_db: psnr_db(one.mean_square, peak),
        psnr_own_gain_db: psnr_db(own.mean_square, peak),
        brightness_ratio: one.ours / one.truth,
        ber: shadows.score()?.ber,
        iou: shadows.iou(),
        completeness: one.completeness,
    })
}

/// Values of one band that are known in both, the predicted one first.
fn known<'a>(pair: &'a RelitPair, band: usize) -> impl Iterator<Item = (f64, f64)> + 'a {
    let values = pair.ours.plane(band).iter().zip(pair.truth.plane(band));
    let both = values.filter(|(ours, truth)| ours.is_finite() && truth.is_finite());
    both.map(|(&ours, &truth)| (f64::from(ours), f64::from(truth)))
}

/// Gain and offset through one band of some pairs. Where the prediction is constant, the gain is zero and the
/// offset the truth's mean.
fn line_through<'a>(bands: impl Iterator<Item = (&'a RelitPair<'a>, usize)> + Clone) -> Option<[f64; 2]> {
    let values = || bands.clone().flat_map(|(pair, band)| known(pair, band));
    let (mut count, mut sums) = (0.0, [0.0; 2]);
    for (ours, truth) in values() {
        count += 1.0;
        sums = [sums[0] + ours, sums[1] + truth];
    }
    if count == 0.0 {
        return None;
    }
    let [ours_mean, truth_mean] = sums.map(|sum| sum / count);
    let (mut variance, mut covariance) = (0.0, 0.0);
    for (ours, truth) in values() {
        variance += (ours - ours_mean).powi(2);
        covariance += (ours - ours_mean) * (truth - truth_mean);
    }
    let gain = if variance > 0.0 { covariance / variance } else { 0.0 };
    Some([gain, truth_mean - gain * ours_mean])
}

/// Difference of prediction and truth after a gain and an offset per band.
struct Difference {
    mean_square: f64,
    /// Means over all bands.
    ours: f64,
    truth: f64,
    completeness: f64,
}

impl Difference {
    fn of(pair: &RelitPair, gains: &[[f64; 2]]) -> Option<Self> {
        let (mut count, mut squares, mut ours_sum, mut truth_sum) = (0usize, 0.0, 0.0, 0.0);
        for (band, [gain, offset]) in gains.iter().enumerate() {
            for (ours, truth) in known(pair, band) {
                let ours = gain * ours + offset;
                squares += (ours - truth).powi(2);
                ours_sum += ours;
                truth_sum += truth;
                count += 1;
            }
        }
        let wanted = pair.truth.values.iter().filter(|v| v.is_finite()).count();
        let mean = |sum: f64| sum / count as f64;
        (count > 0).then(|| Self {
            mean_square: mean(squares),
            ours: mean(ours_sum),
            truth: mean(truth_sum),
            completeness: count as f64 / wanted as f64,
        })
    }
}

fn mean(suns: &[RelitScore]) -> RelitScore {
    let mean = |pick: &dyn Fn(&RelitScore) -> f64| suns.iter().map(pick).sum::<f64>() / suns.len() as f64;
    RelitScore {
        psnr_one_gain_db: mean(&|s| s.psnr_one_gain_db),
        psnr_own_gain_db: mean(&|s| s.psnr_own_gain_db),
        brightness_ratio: mean(&|s| s.brightness_ratio),
        ber: mean(&|s| s.ber),
        iou: mean(&|s| s.iou),
        completeness: mean(&|s| s.completeness),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(values: &[f32]) -> Raster {
        Raster::of_plane(values.len(), 1, values.to_vec())
    }

    struct Sun {
        ours: Raster,
        truth: Raster,
        our_shadow: Raster,
        true_shadow: Raster,
    }

    impl Sun {
        fn new(ours: &[f32], truth: &[f32]) -> Self {
            let lit = vec![0.0; truth.len()];
            Self {
                ours: row(ours),
                truth: row(truth),
                our_shadow: row(&lit),
                true_shadow: row(&lit),
            }
        }

        fn pair(&self) -> RelitPair<'_> {
            RelitPair {
                ours: &self.ours,
                truth: &self.truth,
                our_shadow: &self.our_shadow,
                true_shadow: &self.true_shadow,
            }
        }
    }

    #[test]
    fn a_scene_as_bright_under_every_sun_is_perfect_with_own_gains_and_wrong_with_one() {
        // Truth is half as bright under the second sun, and the prediction is not.
        let (high, low) = (
            Sun::new(&[1.0, 2.0, 3.0], &[2.0, 4.0, 6.0]),
            Sun::new(&[1.0, 2.0, 3.0], &[1.0, 2.0, 3.0]),
        );
        let scores = score_relit(&[high.pair(), low.pair()]).expect("pixels");
        assert!(scores.suns.iter().all(|sun| sun.psnr_own_gain_db > 200.0));
        // The one line through all six points has gain 1.5: it is 0.5, 1 and 1.5 off.
        let [gain, offset] = scores.gains[0];
        assert!((gain - 1.5).abs() < 1e-12 && offset.abs() < 1e-12);
        let wanted = 10.0 * (f64::from(scores.peak as f32).powi(2) / ((0.25 + 1.0 + 2.25) / 3.0)).log10();
        for sun in &scores.suns {
            assert!((sun.psnr_one_gain_db - wanted).abs() < 1e-9, "{}", sun.psnr_one_gain_db);
        }
        assert!((scores.suns[0].brightness_ratio - 0.75).abs() < 1e-12);
        assert!((scores.suns[1].brightness_ratio - 1.5).abs() < 1e-12);
        assert!((scores.mean.brightness_ratio - 1.125).abs() < 1e-12);
    }

    #[test]
    fn the_peak_is_of_the_brightest_truth_and_nearly_its_maximum() {
        let bright: Vec<f32> = (0..=1000).map(|v| v as f32).collect();
        let dim: Vec<f32> = bright.iter().map(|v| 0.5 * v).collect();
        let (a, b) = (Sun::new(&dim, &dim), Sun::new(&bright, &bright));
        let scores = score_relit(&[a.pair(), b.pair()]).expect("pixels");
        assert!((scores.peak - 995.0).abs() <= 1.0, "{}", scores.peak);
    }

    #[test]
    fn shadows_have_a_balanced_error_and_an_overlap() {
        let mut sun = Sun::new(&[1.0, 2.0, 3.0, 4.0, 5.0, 6.0], &[1.0, 2.0, 3.0, 4.0, 5.0, 6.0]);
        sun.true_shadow = row(&[1.0, 1.0, 0.0, 0.0, 0.0, 0.0]);
        sun.our_shadow = row(&[1.0, 0.2, 0.7, 0.0, 0.0, f32::NAN]);
        let score = score_relit(&[sun.pair()]).expect("pixels").suns[0];
        // One of two shadow pixels missed, one of three lit ones too dark; one of three pixels is shadow in both.
        assert!((score.ber - 0.5 * (1.0 / 2.0 + 1.0 / 3.0)).abs() < 1e-12);
        assert!((score.iou - 1.0 / 3.0).abs() < 1e-12);
    }

    #[test]
    fn what_is_not_known_does_not_count_and_is_said() {
        let sun = Sun::new(&[f32::NAN, 2.0, 3.0, 5.0], &[9.0, 4.0, 6.0, 10.0]);
        let score = score_relit(&[sun.pair()]).expect("pixels").suns[0];
        assert!((score.completeness - 0.75).abs() < 1e-12 && score.psnr_one_gain_db > 200.0);
        let nothing = Sun::new(&[f32::NAN; 2], &[1.0; 2]);
        assert!(score_relit(&[sun.pair(), nothing.pair()]).is_none() && score_relit(&[]).is_none());
    }

    #[test]
    fn an_image_of_one_value_gets_the_truth_s_mean() {
        let sun = Sun::new(&[3.0; 4], &[1.0, 3.0, 5.0, 7.0]);
        let scores = score_relit(&[sun.pair()]).expect("pixels");
        assert_eq!(scores.gains[0], [0.0, 4.0]);
        assert!((scores.suns[0].brightness_ratio - 1.0).abs() < 1e-12);
    }
}
