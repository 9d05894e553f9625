//! From trainings to Pareto fronts, and to cost and gain of each change.

use super::Row;
use super::points::Point;
use std::collections::BTreeMap;

/// Measure of accuracy for the scenes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Quality {
    /// Mean absolute error of the DSM, metres: where there is truth.
    DsmMae,
    /// Peak signal-to-noise ratio of held-out images, dB.
    PsnrHeldOut,
    /// PSNR of training images, dB, if no other accuracy is known.
    PsnrTrain,
}

impl Quality {
    /// The best that every row knows.
    fn of(rows: &[Row]) -> Self {
        if rows.iter().all(|row| row.mae_m.is_some()) {
            Self::DsmMae
        } else if rows.iter().all(|row| row.psnr_held_out.is_some()) {
            Self::PsnrHeldOut
        } else {
            Self::PsnrTrain
        }
    }

    /// Label of the measure on an axis.
    pub fn label(self) -> &'static str {
        match self {
            Self::DsmMae => "DSM mean absolute error, m (raw)",
            Self::PsnrHeldOut => "PSNR of held-out images, dB",
            Self::PsnrTrain => "PSNR of training images, dB",
        }
    }

    /// True if lower values are better.
    pub fn less_is_better(self) -> bool {
        self == Self::DsmMae
    }

    fn value(self, row: &Row) -> f64 {
        let value = match self {
            Self::DsmMae => row.mae_m,
            Self::PsnrHeldOut => row.psnr_held_out,
            Self::PsnrTrain => row.psnr_train,
        };
        value.unwrap_or(f64::NAN)
    }
}

/// Mean, standard deviation and confidence of the mean.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct Spread {
    /// Mean over the trainings.
    pub mean: f64,
    /// Standard deviation between trainings; none of a single one.
    pub deviation: Option<f64>,
    /// Half of the 95 % confidence interval of the mean, by Student's t: over scenes, the trainings of each averaged before, where there
    /// are several scenes, else over trainings.
    pub confidence_95: Option<f64>,
}

impl Spread {
    /// Statistics of values by the name of their scene.
    fn of(values: &[(&str, f64)]) -> Self {
        let all: Vec<f64> = values.iter().map(|(_, value)| *value).collect();
        let mut scenes: BTreeMap<&str, Vec<f64>> = BTreeMap::new();
        for (scene, value) in values {
            scenes.entry(scene).or_default().push(*value);
        }
        let of_scenes: Vec<f64> = scenes.values().map(|of_scene| mean(of_scene)).collect();
        let independent = if of_scenes.len() > 1 { &of_scenes } else { &all };
        let n = independent.len() as f64;
        Self {
            mean: mean(&all),
            deviation: deviation(&all),
            confidence_95: deviation(independent).map(|d| students_t_95(independent.len() - 1) * d / n.sqrt()),
        }
    }
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

/// Standard deviation; none of a single value.
fn deviation(values: &[f64]) -> Option<f64> {
    let mean = mean(values);
    let square: f64 = values.iter().map(|v| (v - mean).powi(2)).sum();
    (values.len() > 1).then(|| (square / (values.len() as f64 - 1.0)).sqrt())
}

/// The number that Student's t exceeds in size with a probability of 5 %, with these degrees of freedom (at least one). Beyond ten by
/// its expansion about the normal distribution (Abramowitz and Stegun 26.7.5), to two thousandths.
fn students_t_95(freedom: usize) -> f64 {
    const FEW: [f64; 10] = [12.706, 4.303, 3.182, 2.776, 2.571, 2.447, 2.365, 2.306, 2.262, 2.228];
    let (z, n) = (1.959_964_f64, freedom as f64);
    let first = (z.powi(3) + z) / (4.0 * n);
    let second = (5.0 * z.powi(5) + 16.0 * z.powi(3) + 3.0 * z) / (96.0 * n * n);
    *FEW.get(freedom.saturating_sub(1)).unwrap_or(&(z + first + second))
}

/// A point against the one it is compared with: means of the differences between trainings of the same scene and seed.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct Comparison {
    /// The other point.
    pub base: String,
    /// Pairs of trainings.
    pub pairs: usize,
    /// Seconds more.
    pub seconds: Spread,
    /// Bytes more at the peak.
    pub peak_bytes: Spread,
    /// More of the quality's number.
    pub quality: Spread,
    /// True if the difference in quality exceeds twice its standard error; `None` below three pairs.
    pub clear: Option<bool>,
}

/// Statistics of the trainings of a point.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct PointSummary {
    /// The point.
    #[serde(flatten)]
    pub point: Point,
    /// Trainings.
    pub trainings: usize,
    /// Seconds.
    pub seconds: Spread,
    /// Processor seconds of all threads.
    pub processor_s: Spread,
    /// Most memory used, bytes.
    pub peak_bytes: Spread,
    /// Accuracy.
    pub quality: Spread,
    /// Share of shadows that are right, where known.
    pub shadows_right: Option<Spread>,
    /// PSNR of held-out images, dB, where there are any.
    pub psnr_held_out: Option<Spread>,
    /// No other point is both quicker and better.
    pub on_time_front: bool,
    /// No other point needs less memory and is better.
    pub on_memory_front: bool,
    /// Against the point it is compared with.
    pub against_base: Option<Comparison>,
}

/// Summary of all trainings.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct Summary {
    /// Measure of accuracy.
    pub quality: Quality,
    /// The points, in their order.
    pub points: Vec<PointSummary>,
}

/// Summarises the trainings of `points`.
pub fn summarise(points: &[Point], rows: &[Row]) -> Summary {
    let quality = Quality::of(rows);
    let mut out: Vec<PointSummary> = points
        .iter()
        .filter_map(|point| summary_of(point, rows, quality))
        .collect();
    let front = |cost: &dyn Fn(&PointSummary) -> f64| -> Vec<bool> {
        let better = |a: f64, b: f64| if quality.less_is_better() { a < b } else { a > b };
        let beats = |a: &PointSummary, b: &PointSummary| {
            let (x, y) = (a.quality.mean, b.quality.mean);
            (cost(a) <= cost(b) && better(x, y)) || (cost(a) < cost(b) && !better(y, x))
        };
        out.iter().map(|p| !out.iter().any(|other| beats(other, p))).collect()
    };
    let (time, memory) = (front(&|p| p.seconds.mean), front(&|p| p.peak_bytes.mean));
    for ((point, time), memory) in out.iter_mut().zip(time).zip(memory) {
        (point.on_time_front, point.on_memory_front) = (time, memory);
    }
    Summary { quality, points: out }
}

fn summary_of(point: &Point, rows: &[Row], quality: Quality) -> Option<PointSummary> {
    let own: Vec<&Row> = rows.iter().filter(|row| row.point == point.name).collect();
    if own.is_empty() {
        return None;
    }
    let spread = |pick: &dyn Fn(&Row) -> f64| spread_of(own.iter().map(|row| (*row, pick(row))));
    let known = |pick: &dyn Fn(&Row) -> Option<f64>| -> Option<Spread> {
        let values: Vec<(&Row, f64)> = own.iter().filter_map(|row| Some((*row, pick(row)?))).collect();
        (!values.is_empty()).then(|| spread_of(values.into_iter()))
    };
    Some(PointSummary {
        trainings: own.len(),
        seconds: spread(&|row| row.seconds),
        processor_s: spread(&|row| row.processor_s),
        peak_bytes: spread(&|row| row.peak_bytes),
        quality: spread(&|row| quality.value(row)),
        shadows_right: known(&|row| row.shadows_right),
        psnr_held_out: known(&|row| row.psnr_held_out),
        on_time_front: false,
        on_memory_front: false,
        against_base: point.base.as_ref().and_then(|base| compare(&own, base, rows, quality)),
        point: point.clone(),
    })
}

fn spread_of<'a>(values: impl Iterator<Item = (&'a Row, f64)>) -> Spread {
    let by_scene: Vec<(&str, f64)> = values.map(|(row, value)| (row.scene.as_str(), value)).collect();
    Spread::of(&by_scene)
}

fn compare(own: &[&Row], base: &str, rows: &[Row], quality: Quality) -> Option<Comparison> {
    let bases: BTreeMap<(&str, u64), &Row> = rows
        .iter()
        .filter(|row| row.point == base)
        .map(|row| ((row.scene.as_str(), row.seed), row))
        .collect();
    let pairs: Vec<(&Row, &Row)> = own
        .iter()
        .filter_map(|row| Some((*row, *bases.get(&(row.scene.as_str(), row.seed))?)))
        .collect();
    if pairs.is_empty() {
        return None;
    }
    let spread = |pick: &dyn Fn(&Row) -> f64| spread_of(pairs.iter().map(|(a, b)| (*a, pick(a) - pick(b))));
    let difference = spread(&|row| quality.value(row));
    let error = difference.deviation.map(|d| d / (pairs.len() as f64).sqrt());
    Some(Comparison {
        base: base.to_owned(),
        pairs: pairs.len(),
        seconds: spread(&|row| row.seconds),
        peak_bytes: spread(&|row| row.peak_bytes),
        clear: error
            .filter(|_| pairs.len() >= 3)
            .map(|e| difference.mean.abs() > 2.0 * e),
        quality: difference,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tradeoff::points::Seeds;

    fn point(name: &str, base: Option<&str>) -> Point {
        Point {
            name: name.into(),
            axis: "a".into(),
            preset: "fast".into(),
            base: base.map(str::to_owned),
            seeds: Seeds::All,
            set: BTreeMap::new(),
            why: String::new(),
        }
    }

    fn row(point: &str, seed: u64, seconds: f64, mae_m: f64) -> Row {
        Row {
            scene: "s".into(),
            point: point.into(),
            seed,
            seconds,
            processor_s: 2.0 * seconds,
            peak_bytes: 1e6 * seconds,
            gaussians: 1.0,
            steps: 1.0,
            mae_m: Some(mae_m),
            median_m: None,
            shadows_right: None,
            psnr_train: None,
            psnr_held_out: None,
        }
    }

    #[test]
    fn a_point_that_another_beats_in_both_is_off_the_front() {
        let points = [point("quick", None), point("good", None), point("bad", None)];
        let rows = [
            row("quick", 1, 1.0, 0.9),
            row("good", 1, 5.0, 0.5),
            row("bad", 1, 6.0, 0.7),
        ];
        let summary = summarise(&points, &rows);
        let fronts: Vec<bool> = summary.points.iter().map(|p| p.on_time_front).collect();
        assert_eq!(fronts, [true, true, false]);
        assert_eq!(summary.quality, Quality::DsmMae);
    }

    #[test]
    fn confidence_is_over_scenes_with_the_seeds_of_each_averaged() {
        let spread = Spread::of(&[("a", 1.0), ("a", 3.0), ("b", 4.0), ("b", 6.0)]);
        // Means of 2 and 5: a deviation of 2.1213 over the root of two, times t of one degree of freedom.
        assert_eq!(spread.mean, 3.5);
        assert!((spread.confidence_95.expect("two scenes") - 12.706 * 1.5).abs() < 1e-9);
        let one_scene = Spread::of(&[("a", 1.0), ("a", 2.0), ("a", 3.0)]);
        assert!((one_scene.confidence_95.expect("three seeds") - 4.303 / 3f64.sqrt()).abs() < 1e-9);
        assert_eq!(Spread::of(&[("a", 1.0)]).confidence_95, None);
        // Tables say 2.201, 2.042 and 1.960.
        for (freedom, t) in [(11, 2.201), (30, 2.042), (1_000_000, 1.960)] {
            assert!((students_t_95(freedom) - t).abs() < 3e-3, "{freedom}");
        }
    }

    #[test]
    fn differences_are_between_trainings_of_one_seed_and_clear_beyond_their_noise() {
        let points = [
            point("base", None),
            point("same", Some("base")),
            point("worse", Some("base")),
        ];
        let mut rows = Vec::new();
        for (seed, own) in [(1, 0.5), (2, 0.9), (3, 0.7)] {
            let noise = 0.01 * (seed as f64 - 2.0);
            rows.push(row("base", seed, 1.0, own));
            rows.push(row("same", seed, 2.0, own + noise));
            rows.push(row("worse", seed, 2.0, own + 0.1 + noise));
        }
        let summary = summarise(&points, &rows);
        let comparison = |i: usize| summary.points[i].against_base.clone().expect("a base");
        assert_eq!((comparison(1).clear, comparison(2).clear), (Some(false), Some(true)));
        assert!((comparison(2).quality.mean - 0.1).abs() < 1e-12 && (comparison(2).seconds.mean - 1.0).abs() < 1e-12);
    }
}
