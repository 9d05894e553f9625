//! Selection of the pairs of views to compare, and the weight of each comparison.
//!
//! A pair weighs more the longer its base, the more alike both views see a façade, and the more alike the light:
//! `B/H / (B/H + 0.15)`, times a bell curve of the intersection angle, times a factor for dates.

use super::views::{ViewGeometry, parallax};
use glam::{Vec2, Vec3};
use heliosplat_rpc::parallax::LEAST_BASE_TO_HEIGHT;

/// Two views to compare and the weight of the comparison.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Pair {
    /// Index of the first view.
    pub(super) a: usize,
    /// Index of the second view.
    pub(super) b: usize,
    /// Weight of a comparison of brightness; 64 for a perfect pair.
    pub(super) weight: u32,
    /// True if both views are of one date.
    pub(super) same_date: bool,
    /// Base-to-height ratio: ground metres of relative parallax per metre of altitude.
    pub(super) base_to_height: f32,
}

impl Pair {
    /// Weight of a comparison with `share` of the weight of one of brightness; at least 1.
    pub(super) fn weight_of(&self, share: f32) -> u32 {
        ((self.weight as f32 * share) as u32).max(1)
    }

    /// Weight of the pair relative to a perfect one, 0 to 1.
    pub(super) fn share(&self) -> f32 {
        self.weight as f32 / FULL_WEIGHT
    }
}

/// Weight of a perfect pair: weights are whole numbers, so that sums do not depend on their order.
const FULL_WEIGHT: f32 = 64.0;
/// Base-to-height ratio at which a pair has half of the weight of an infinitely long base.
const HALF_WEIGHT_BASE: f32 = 0.15;
/// Intersection angle at which surfaces no longer look alike (weight 1/e), radians: about 40 degrees.
const ALIKE_ANGLE_RAD: f32 = 0.7;
/// Weight of a comparison across dates with the sun in one place, relative to one within a date.
const OTHER_DATE: f32 = 0.5;
/// Least cosine between two suns that is used: opposite shadows still leave roofs to compare.
const LEAST_SUN_COSINE: f32 = 0.3;
/// The cosine between two suns when one is unknown: that of morning passes of two seasons, some 35 degrees apart.
const UNKNOWN_SUN_COSINE: f32 = 0.8;
/// Partners of each view, those of the largest weight; more only cost time.
const PARTNERS: usize = 8;

/// Pairs to compare, in a fixed order: each view with the partners of largest weight at `centre`, metres. Views without
/// parallax between them agree at every altitude and are not compared.
pub(super) fn choose(views: &[ViewGeometry], centre: Vec3) -> Vec<Pair> {
    let mut chosen: Vec<(usize, usize)> = Vec::new();
    for a in 0..views.len() {
        let mut partners: Vec<(f32, usize)> = (0..views.len())
            .filter(|&b| b != a)
            .map(|b| (weight(&views[a], &views[b], centre).0, b))
            .collect();
        partners.sort_by(|x, y| y.0.total_cmp(&x.0).then(x.1.cmp(&y.1)));
        chosen.extend(partners.iter().take(PARTNERS).map(|&(_, b)| (a.min(b), a.max(b))));
    }
    chosen.sort_unstable();
    chosen.dedup();
    let pairs = chosen.into_iter().map(|(a, b)| {
        let (weight, base_to_height) = weight(&views[a], &views[b], centre);
        Pair {
            a,
            b,
            weight: ((weight * FULL_WEIGHT).round() as u32).max(1),
            base_to_height,
            same_date: views[a].date_group == views[b].date_group,
        }
    });
    pairs
        .filter(|pair| f64::from(pair.base_to_height) >= LEAST_BASE_TO_HEIGHT)
        .collect()
}

/// Combined base-to-height ratio of all comparisons: the root of the sum of squares. The precision of a height from
/// independent pairs is proportional to it.
pub(super) fn combined_base_to_height(pairs: &[Pair]) -> f32 {
    pairs.iter().map(|pair| pair.base_to_height.powi(2)).sum::<f32>().sqrt()
}

/// The two views with the widest base.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Widest {
    /// Indices of the two views.
    pub views: [usize; 2],
    /// Their base-to-height ratio.
    pub base_to_height: f32,
}

/// The two of `views` (at least two) with the largest base-to-height ratio at `centre`, metres in the frame of the
/// cameras.
pub fn widest_base(views: &[ViewGeometry], centre: Vec3) -> Widest {
    let parallaxes: Vec<Vec2> = views.iter().map(|view| parallax(&view.camera, centre)).collect();
    let mut widest = Widest {
        views: [0, 1],
        base_to_height: 0.0,
    };
    for (b, second) in parallaxes.iter().enumerate() {
        for (a, first) in parallaxes[..b].iter().enumerate() {
            let base_to_height = (first - second).length();
            if base_to_height > widest.base_to_height {
                widest = Widest {
                    views: [a, b],
                    base_to_height,
                };
            }
        }
    }
    widest
}

/// Largest base-to-height ratio of the comparisons; 0 without pairs.
pub(super) fn widest_base_to_height(pairs: &[Pair]) -> f32 {
    pairs.iter().map(|pair| pair.base_to_height).fold(0.0, f32::max)
}

/// Weight in 0..1 and base-to-height ratio of a pair.
fn weight(a: &ViewGeometry, b: &ViewGeometry, centre: Vec3) -> (f32, f32) {
    let base_to_height = (parallax(&a.camera, centre) - parallax(&b.camera, centre)).length();
    let angle = a.toward(centre).angle_between(b.toward(centre));
    let light = if a.date_group == b.date_group {
        1.0
    } else {
        let cosine = a.sun.zip(b.sun).map(|(a, b)| a.dot(b));
        OTHER_DATE * cosine.map_or(UNKNOWN_SUN_COSINE, |cosine| cosine.clamp(LEAST_SUN_COSINE, 1.0))
    };
    (weight_of_geometry(base_to_height, angle) * light, base_to_height)
}

/// Weight of two views, 0 to 1, by their base-to-height ratio and the angle between their rays, radians: `b / (b +
/// HALF_WEIGHT_BASE) · exp(-(angle_rad / ALIKE_ANGLE_RAD)²)` for the ratio `b`.
pub fn weight_of_geometry(base_to_height: f32, angle_rad: f32) -> f32 {
    base_to_height / (base_to_height + HALF_WEIGHT_BASE) * (-(angle_rad / ALIKE_ANGLE_RAD).powi(2)).exp()
}
