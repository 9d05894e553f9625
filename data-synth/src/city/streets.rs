//! Plan of the streets: blocks cut from a plane by streets, in gently bent coordinates.

use crate::noise::stream;
use rand::RngExt;
use rand_pcg::Pcg64Mcg;

/// Longest side of a large park, metres.
const PARK_M: f64 = 260.0;

/// City coordinates in metres: (u, v) is (east, north) turned by an angle and gently bent.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Bend {
    /// Sine and cosine of the turn.
    turn: [f64; 2],
    amplitude_m: [f64; 2],
    wave_number: [f64; 2],
    phase: [f64; 2],
}

impl Bend {
    /// Random coordinates, turned by up to 0.6 radians and bent by up to 3 m over some 200 m.
    pub(crate) fn new(seed: u64) -> Self {
        let mut random = stream(seed, 0xBE);
        let mut draw = |low: f64, high: f64| random.random_range(low..high);
        Self {
            turn: draw(-0.6, 0.6).sin_cos().into(),
            amplitude_m: [draw(1.0, 3.0), draw(1.0, 3.0)],
            wave_number: [draw(0.02, 0.034), draw(0.02, 0.034)],
            phase: [draw(0.0, 6.2), draw(0.0, 6.2)],
        }
    }

    /// City coordinates of a place (metres east and north of the site's centre).
    pub(crate) fn uv_from_xy(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let [sin, cos] = self.turn;
        let (u, v) = (x * cos + y * sin, y * cos - x * sin);
        [u + self.shift(0, v), v + self.shift(1, u)]
    }

    /// Place of city coordinates, by fixed-point iteration; each step shrinks the error at least tenfold.
    pub(crate) fn xy_from_uv(&self, [u, v]: [f64; 2]) -> [f64; 2] {
        let (mut p, mut q) = (u, v);
        for _ in 0..30 {
            (p, q) = (u - self.shift(0, q), v - self.shift(1, p));
        }
        let [sin, cos] = self.turn;
        [p * cos - q * sin, p * sin + q * cos]
    }

    /// Direction of u at city coordinates, radians from east; v is a quarter turn on, within the bend.
    pub(crate) fn direction_rad(&self, [u, v]: [f64; 2]) -> f64 {
        let (a, b) = (self.xy_from_uv([u - 3.0, v]), self.xy_from_uv([u + 3.0, v]));
        let (c, d) = (self.xy_from_uv([u, v - 3.0]), self.xy_from_uv([u, v + 3.0]));
        // The mean of both axes' turns, so that neither side of a block is favoured.
        let along_u = (b[1] - a[1]).atan2(b[0] - a[0]);
        let along_v = (c[0] - d[0]).atan2(d[1] - c[1]);
        0.5 * (along_u + along_v)
    }

    fn shift(&self, axis: usize, other: f64) -> f64 {
        self.amplitude_m[axis] * (self.wave_number[axis] * other + self.phase[axis]).sin()
    }
}

/// A rectangle in city coordinates, metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Block {
    /// Least u and v.
    pub(crate) low: [f64; 2],
    /// Largest u and v.
    pub(crate) high: [f64; 2],
}

impl Block {
    /// Centre (u, v).
    pub(crate) fn centre(&self) -> [f64; 2] {
        [0, 1].map(|k| 0.5 * (self.low[k] + self.high[k]))
    }

    /// True if a place (u, v) lies in the block.
    pub(crate) fn contains(&self, uv: [f64; 2]) -> bool {
        (0..2).all(|k| (self.low[k]..self.high[k]).contains(&uv[k]))
    }

    /// Half size along u and v.
    pub(crate) fn half(&self) -> [f64; 2] {
        [0, 1].map(|k| 0.5 * (self.high[k] - self.low[k]))
    }
}

/// A straight stretch of carriageway in city coordinates, metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Street {
    /// Centre (u, v).
    pub(crate) centre: [f64; 2],
    /// True if the street runs along u.
    pub(crate) along_u: bool,
    /// Half of the length.
    pub(crate) half_length: f64,
    /// Half of the width.
    pub(crate) half_width: f64,
}

/// Streets and the blocks between them.
#[derive(Debug, Clone, Default)]
pub(crate) struct StreetPlan {
    /// Blocks, pavements included.
    pub(crate) blocks: Vec<Block>,
    /// Streets, which fill the rest of the plane.
    pub(crate) streets: Vec<Street>,
}

impl StreetPlan {
    /// Cuts a square of `half_extent_m` on either side of the origin until no block is longer than `longest_m`, metres.
    /// The block at `park` (u, v) may be longer, up to [`PARK_M`].
    pub(crate) fn new(seed: u64, half_extent_m: f64, longest_m: f64, park: Option<[f64; 2]>) -> Self {
        let mut random = stream(seed, 0x57);
        let mut plan = Self::default();
        let whole = Block {
            low: [-half_extent_m; 2],
            high: [half_extent_m; 2],
        };
        plan.cut(whole, &mut random, longest_m, park);
        plan
    }

    fn cut(&mut self, block: Block, random: &mut Pcg64Mcg, longest_m: f64, park: Option<[f64; 2]>) {
        let size = block.half().map(|h| 2.0 * h);
        let axis = usize::from(size[1] * 1.25 > size[0]);
        let is_park = park.is_some_and(|uv| block.contains(uv)) && size[0].max(size[1]) <= PARK_M;
        if is_park || size[0] <= longest_m && size[1] <= 0.8 * longest_m {
            self.blocks.push(block);
            return;
        }
        let share: f64 = random.random_range(0.42..0.58);
        let width_m = match size[axis] / longest_m {
            r if r > 2.6 => random.random_range(11.0..13.0),
            r if r > 1.7 => random.random_range(9.0..10.5),
            _ => random.random_range(8.0..9.0),
        };
        let at = block.low[axis] + share * size[axis];
        let (mut before, mut after) = (block, block);
        before.high[axis] = at - 0.5 * width_m;
        after.low[axis] = at + 0.5 * width_m;
        let mut centre = block.centre();
        centre[axis] = at;
        self.streets.push(Street {
            centre,
            along_u: axis == 1,
            half_length: 0.5 * size[1 - axis],
            half_width: 0.5 * width_m,
        });
        self.cut(before, random, longest_m, park);
        self.cut(after, random, longest_m, park);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bend_is_inverted() {
        let bend = Bend::new(4);
        for k in 0..100 {
            let (x, y) = (f64::from(k) * 3.1 - 150.0, f64::from(k) * -2.3 + 110.0);
            let [x_back, y_back] = bend.xy_from_uv(bend.uv_from_xy([x, y]));
            assert!((x - x_back).abs() < 1e-9 && (y - y_back).abs() < 1e-9);
        }
    }

    #[test]
    fn blocks_and_streets_fill_the_plane_without_overlap() {
        let plan = StreetPlan::new(8, 200.0, 60.0, None);
        let area = |half: [f64; 2]| 4.0 * half[0] * half[1];
        let blocks: f64 = plan.blocks.iter().map(|b| area(b.half())).sum();
        let streets: f64 = plan.streets.iter().map(|s| area([s.half_length, s.half_width])).sum();
        assert!((blocks + streets - 400.0 * 400.0).abs() < 1e-6);
        for street in &plan.streets {
            assert!((3.9..7.1).contains(&street.half_width));
        }
        assert!(plan.blocks.iter().all(|b| b.half()[0] <= 30.0 && b.half()[1] <= 24.0));
    }
}
