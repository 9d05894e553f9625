//! Which views are compared with which, and how much each comparison is worth.

use super::views::SweepView;
use glam::Vec3;

/// Two views to compare and the weight of the comparison.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Pair {
    pub(super) a: usize,
    pub(super) b: usize,
    pub(super) weight: u32,
    pub(super) same: bool,
    /// Base-to-height ratio: ground metres of relative parallax per metre of altitude.
    pub(super) base_to_height: f32,
}

/// Weight of a perfect pair.
const FULL_WEIGHT: f32 = 64.0;
/// Base-to-height ratio at which half of the attainable sharpness in altitude is reached.
const HALF_BASE: f32 = 0.15;
/// Intersection angle over which surfaces stop looking alike, radians (about 40 degrees).
const ALIKE_ANGLE_RAD: f32 = 0.7;
/// What a comparison across dates with the sun in one place is worth beside one within a date.
const OTHER_DATE: f32 = 0.5;
/// Partners each view brings in; more only cost time.
const PARTNERS: usize = 8;

/// The comparisons worth making, in a fixed order.
pub(super) fn choose(views: &[SweepView], centre: Vec3) -> Vec<Pair> {
    let mut chosen: Vec<(usize, usize)> = Vec::new();
    for a in 0..views.len() {
        let mut partners: Vec<(f32, usize)> = (0..views.len())
            .filter(|&b| b != a)
            .map(|b| (worth(&views[a], &views[b], centre).0, b))
            .collect();
        partners.sort_by(|x, y| y.0.total_cmp(&x.0).then(x.1.cmp(&y.1)));
        chosen.extend(partners.iter().take(PARTNERS).map(|&(_, b)| (a.min(b), a.max(b))));
    }
    chosen.sort_unstable();
    chosen.dedup();
    chosen
        .into_iter()
        .map(|(a, b)| {
            let (worth, base_to_height) = worth(&views[a], &views[b], centre);
            Pair {
                a,
                b,
                weight: ((worth * FULL_WEIGHT).round() as u32).max(1),
                base_to_height,
                same: views[a].date_group == views[b].date_group,
            }
        })
        .collect()
}

/// Weight in 0..1 and base-to-height ratio of a pair.
fn worth(a: &SweepView, b: &SweepView, centre: Vec3) -> (f32, f32) {
    let base_to_height = (a.parallax(centre) - b.parallax(centre)).length();
    let angle = a.toward(centre).angle_between(b.toward(centre));
    let sharp = base_to_height / (base_to_height + HALF_BASE);
    let alike = (-(angle / ALIKE_ANGLE_RAD).powi(2)).exp();
    let light = if a.date_group == b.date_group {
        1.0
    } else {
        OTHER_DATE * a.sun.dot(b.sun).clamp(0.3, 1.0)
    };
    (sharp * alike * light, base_to_height)
}
