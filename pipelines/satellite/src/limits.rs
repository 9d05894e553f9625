//! Tests whether a swept surface touches the limits of the searched altitudes and was thereby cut off, and whether the
//! images agree on it at all.

use heliosplat_scene::{Scene, crop};
use heliosplat_stereo::{FEWEST_VIEWS, Surface};

/// Least confidence of a matched cell: below it, cells matched by chance lie at the limits too (docs/lab/altitude.md).
const CONFIDENT: f32 = 0.5;
/// Share of the matched cells at a limit above which the surface is assumed to extend beyond it.
const TOUCHING: f64 = 0.01;
/// Widening of a range on the side that the surface touches, as a share of its width.
const WIDENING: f64 = 0.5;
/// Least widening of the range, metres.
const LEAST_WIDENING_M: f64 = 20.0;

/// Least share of the ground in two or more images that is known in a scene of sound cameras and altitudes: on the
/// smaller part of the ground images agree by chance too (docs/lab/deliveries.md).
const LEAST_KNOWN: f64 = 0.5;

/// Numbers of cells of a swept surface: matched, at the limits of the searched altitudes, seen and known.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct CellCounts {
    /// Cells at the lowest altitude.
    pub low: usize,
    /// Cells at the highest altitude.
    pub high: usize,
    /// All matched cells.
    pub matched: usize,
    /// Cells that two or more images show.
    pub seen: usize,
    /// Cells of known altitude.
    pub known: usize,
}

impl std::ops::AddAssign for CellCounts {
    fn add_assign(&mut self, other: Self) {
        self.low += other.low;
        self.high += other.high;
        self.matched += other.matched;
        self.seen += other.seen;
        self.known += other.known;
    }
}

impl CellCounts {
    /// Counts for a surface that was searched over the altitudes of `scene`, without cells that fewer than two images
    /// see.
    pub fn of(surface: &Surface, scene: &Scene) -> Self {
        let at = counted(surface, crop::altitude_range(scene));
        tracing::debug!(
            low = at.share(at.low),
            high = at.share(at.high),
            "matched cells at the limits of the altitudes searched"
        );
        at
    }

    /// Share of `count` in the matched cells, 0..1.
    fn share(&self, count: usize) -> f64 {
        count as f64 / self.matched.max(1) as f64
    }

    /// Range widened on each side that the surface touches, metres above the ellipsoid; `None` where it touches no
    /// limit.
    pub fn wider(&self, range_m: (f64, f64)) -> Option<(f64, f64)> {
        widened(self, range_m)
    }

    /// Warnings about too narrow a range of altitudes (metres above the ellipsoid), and about ground that is mostly
    /// unknown.
    pub fn warnings(&self, range_m: (f64, f64)) -> Vec<String> {
        let mut found = Vec::new();
        let known = self.known as f64 / self.seen.max(1) as f64;
        if self.seen > 0 && known < LEAST_KNOWN {
            found.push(format!(
                "only {:.0} % of the ground in two or more images is known; unless the rest is water, snow or cloud, check cameras and \
                 --altitude with `heliosplat inspect`",
                100.0 * known
            ));
        }
        if let Some(wider) = self.wider(range_m) {
            let ends = [(self.low, "lowest", range_m.0), (self.high, "highest", range_m.1)];
            let touched = ends.into_iter().filter(|(count, ..)| self.share(*count) > TOUCHING);
            let touched = touched.map(|(count, end, at_m)| {
                let share = 100.0 * self.share(count);
                format!("{share:.1} % of its matched cells lie at the {end}, {at_m:.0} m")
            });
            found.push(format!(
                "the surface touches the limits of the altitudes searched: {}; try --altitude {:.0},{:.0}",
                touched.collect::<Vec<_>>().join(", "),
                wider.0,
                wider.1
            ));
        }
        found
    }
}

fn counted(surface: &Surface, (low_m, high_m): (f64, f64)) -> CellCounts {
    let is_matched = |cell: &usize| {
        surface.confidence[*cell] >= CONFIDENT && !surface.filled[*cell] && surface.views[*cell] >= FEWEST_VIEWS
    };
    let matched: Vec<f64> = (0..surface.altitude.len())
        .filter(is_matched)
        .map(|cell| f64::from(surface.altitude[cell]))
        .collect();
    let step_m = f64::from(surface.resolution_m);
    CellCounts {
        low: matched.iter().filter(|&&up_m| up_m < low_m + step_m).count(),
        high: matched.iter().filter(|&&up_m| up_m > high_m - step_m).count(),
        matched: matched.len(),
        seen: surface.views.iter().filter(|&&views| views >= FEWEST_VIEWS).count(),
        known: (0..surface.altitude.len())
            .filter(|&cell| surface.is_known(cell))
            .count(),
    }
}

fn widened(at: &CellCounts, (low_m, high_m): (f64, f64)) -> Option<(f64, f64)> {
    let more_m = (WIDENING * (high_m - low_m)).max(LEAST_WIDENING_M).ceil();
    let by = |count: usize| if at.share(count) > TOUCHING { more_m } else { 0.0 };
    (at.share(at.low.max(at.high)) > TOUCHING).then(|| (low_m - by(at.low), high_m + by(at.high)))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn surface(altitude: Vec<f32>) -> Surface {
        Surface {
            width: altitude.len(),
            height: 1,
            confidence: vec![0.5; altitude.len()],
            filled: vec![false; altitude.len()],
            matched: vec![true; altitude.len()],
            probability: vec![0.5; altitude.len()],
            resolution_m: 1.0,
            altitude,
            ..Surface::default()
        }
    }

    #[test]
    fn cells_at_a_limit_are_counted_among_those_that_were_matched() {
        let mut cut_off = surface(vec![3.0, 9.5, 9.8, -4.0, 9.9]);
        cut_off.views = vec![2, 3, 2, 2, 1];
        let counts = |low, high, matched| CellCounts {
            low,
            high,
            matched,
            seen: 4,
            known: 4,
        };
        assert_eq!(counted(&cut_off, (-10.0, 10.0)), counts(0, 2, 4));
        cut_off.confidence[3] = 0.0;
        cut_off.filled[1] = true;
        assert_eq!(counted(&cut_off, (2.5, 10.0)), counts(1, 1, 2));
    }

    #[test]
    fn a_range_is_widened_on_the_side_that_the_surface_touches() {
        let widened = |low, high| {
            let at = CellCounts {
                low,
                high,
                matched: 100,
                ..CellCounts::default()
            };
            widened(&at, (100.0, 200.0))
        };
        assert_eq!(widened(1, 1), None);
        assert_eq!(widened(30, 0), Some((50.0, 200.0)));
        assert_eq!(widened(0, 6), Some((100.0, 250.0)));
    }

    #[test]
    fn ground_that_is_mostly_unknown_is_a_warning() {
        let warnings = |known| {
            let of_cells = CellCounts {
                seen: 100,
                known,
                matched: 100,
                ..CellCounts::default()
            };
            of_cells.warnings((0.0, 100.0))
        };
        assert!(warnings(50).is_empty());
        assert!(warnings(49)[0].starts_with("only 49 % of the ground"));
        assert!(CellCounts::default().warnings((0.0, 100.0)).is_empty());
    }
}
