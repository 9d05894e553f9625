//! Footprints on the ground: convex polygons, their intersections, and the ground that two views cover.

use super::Area;

/// Convex polygon in the plane; corners in order, metres.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Footprint(Vec<[f64; 2]>);

impl Footprint {
    /// Polygon from its corners, clockwise or anticlockwise.
    pub(super) fn new(mut corners: Vec<[f64; 2]>) -> Self {
        if signed_area(&corners) < 0.0 {
            corners.reverse();
        }
        Self(corners)
    }

    /// Corners in order, metres.
    pub(super) fn corners(&self) -> &[[f64; 2]] {
        &self.0
    }

    /// Area, square metres.
    pub(super) fn area_m2(&self) -> f64 {
        signed_area(&self.0)
    }

    /// Intersection with `other` by the algorithm of Sutherland and Hodgman (1974); it may be empty.
    pub(super) fn intersection(&self, other: &Self) -> Self {
        let mut kept = self.0.clone();
        for (index, &a) in other.0.iter().enumerate() {
            let b = other.0[(index + 1) % other.0.len()];
            let side = |p: [f64; 2]| (b[0] - a[0]) * (p[1] - a[1]) - (b[1] - a[1]) * (p[0] - a[0]);
            let mut next = Vec::with_capacity(kept.len() + 1);
            for (position, &p) in kept.iter().enumerate() {
                let q = kept[(position + 1) % kept.len()];
                let (sp, sq) = (side(p), side(q));
                if sp >= 0.0 {
                    next.push(p);
                }
                if (sp > 0.0 && sq < 0.0) || (sp < 0.0 && sq > 0.0) {
                    let t = sp / (sp - sq);
                    next.push([p[0] + t * (q[0] - p[0]), p[1] + t * (q[1] - p[1])]);
                }
            }
            kept = next;
            if kept.is_empty() {
                break;
            }
        }
        Self(kept)
    }

    /// True for a point (metres) inside the polygon.
    pub(super) fn contains(&self, point: [f64; 2]) -> bool {
        let count = self.0.len();
        count > 2
            && (0..count).all(|i| {
                let (a, b) = (self.0[i], self.0[(i + 1) % count]);
                (b[0] - a[0]) * (point[1] - a[1]) - (b[1] - a[1]) * (point[0] - a[0]) >= 0.0
            })
    }

    /// Centroid, metres; `None` for an empty polygon.
    pub(super) fn centre(&self) -> Option<[f64; 2]> {
        let twice = 2.0 * self.area_m2();
        if self.0.len() < 3 || twice <= 0.0 {
            return None;
        }
        // Coordinates relative to the first corner keep their precision far from the origin.
        let origin = self.0[0];
        let mut sum = [0.0; 2];
        for (index, p) in self.0.iter().enumerate() {
            let q = self.0[(index + 1) % self.0.len()];
            let (px, py, qx, qy) = (p[0] - origin[0], p[1] - origin[1], q[0] - origin[0], q[1] - origin[1]);
            let cross = px * qy - qx * py;
            sum[0] += (px + qx) * cross;
            sum[1] += (py + qy) * cross;
        }
        Some([origin[0] + sum[0] / (3.0 * twice), origin[1] + sum[1] / (3.0 * twice)])
    }
}

fn signed_area(corners: &[[f64; 2]]) -> f64 {
    let Some(&origin) = corners.first() else {
        return 0.0;
    };
    let mut twice = 0.0;
    for (index, p) in corners.iter().enumerate() {
        let q = corners[(index + 1) % corners.len()];
        twice += (p[0] - origin[0]) * (q[1] - origin[1]) - (q[0] - origin[0]) * (p[1] - origin[1]);
    }
    twice / 2.0
}

/// Bounding rectangle of the ground that at least two footprints cover, metres; `None` where no two overlap by
/// `least_m2` (square metres).
pub(super) fn covered_twice(footprints: &[Footprint], least_m2: f64) -> Option<Area> {
    let mut corners = Vec::new();
    for (index, first) in footprints.iter().enumerate() {
        for second in &footprints[index + 1..] {
            let shared = first.intersection(second);
            if shared.area_m2() >= least_m2 {
                corners.extend(shared.0);
            }
        }
    }
    (!corners.is_empty()).then(|| Area::covering(corners))
}

/// Ground that all footprints cover; it may be empty.
pub(super) fn common(footprints: &[Footprint]) -> Footprint {
    let mut footprints = footprints.iter();
    let first = footprints.next().cloned().unwrap_or(Footprint(Vec::new()));
    footprints.fold(first, |shared, next| shared.intersection(next))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn square(x: f64, y: f64, size: f64) -> Footprint {
        Footprint::new(vec![[x, y], [x, y + size], [x + size, y + size], [x + size, y]])
    }

    #[test]
    fn overlapping_squares_share_their_corner() {
        let shared = square(0.0, 0.0, 10.0).intersection(&square(6.0, 7.0, 10.0));
        assert!((shared.area_m2() - 12.0).abs() < 1e-9);
        assert_eq!(shared.centre(), Some([8.0, 8.5]));
    }

    #[test]
    fn squares_apart_share_nothing() {
        let shared = square(0.0, 0.0, 10.0).intersection(&square(20.0, 0.0, 10.0));
        assert_eq!((shared.area_m2(), shared.centre()), (0.0, None));
        assert_eq!(
            covered_twice(&[square(0.0, 0.0, 1.0), square(5.0, 5.0, 1.0)], 0.01),
            None
        );
    }

    #[test]
    fn the_area_is_what_two_views_cover_not_what_all_do() {
        let views = [square(0.0, 0.0, 10.0), square(5.0, 0.0, 10.0), square(10.0, 0.0, 10.0)];
        let area = covered_twice(&views, 1.0).expect("neighbours overlap");
        assert_eq!(
            (area.west_m, area.east_m, area.south_m, area.north_m),
            (5.0, 15.0, 0.0, 10.0)
        );
        assert!(common(&views).area_m2() < 1e-9);
    }
}
