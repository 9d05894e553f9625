//! The initial surface, the result of the plane sweep: one altitude per cell.

use super::seen::FEWEST_VIEWS;
use glam::Vec3;
use heliosplat_grid::{Grid, lowest_within};

/// Least probability of a known altitude: that of all other altitudes together.
const KNOWN_PROBABILITY: f32 = 0.5;

/// Altitudes on a regular ground grid, with their uncertainties.
#[derive(Debug, Clone, PartialEq, Default, serde::Serialize, serde::Deserialize)]
pub struct Surface {
    /// Columns.
    pub width: usize,
    /// Rows; row 0 is the northern one.
    pub height: usize,
    /// Western edge of the grid, metres; the first cell's centre lies half a cell further east.
    pub west_m: f32,
    /// Northern edge of the grid, metres; the first cell's centre lies half a cell further south.
    pub north_m: f32,
    /// Width of a cell, metres.
    pub cell_m: f32,
    /// Altitude of each cell, metres; never NaN.
    pub altitude: Vec<f32>,
    /// Alternative altitude, metres: the matched one where the ground was preferred to it, else the altitude itself.
    pub above: Vec<f32>,
    /// Confidence of each match, before speckles were filled: 0 (a guess) to 1.
    pub confidence: Vec<f32>,
    /// Standard deviation of each matched altitude, metres.
    pub deviation_m: Vec<f32>,
    /// Probability that each altitude was matched right to within two height steps, 0 to 1.
    pub probability: Vec<f32>,
    /// One flag for each cell, true if the views agree there better than by chance.
    pub matched: Vec<bool>,
    /// Number of views that see each cell at its altitude.
    pub views: Vec<u8>,
    /// Base-to-height ratio of these views, defined as in [`Witnesses`](super::Witnesses).
    pub base_to_height: Vec<f32>,
    /// Step of the height hypotheses, metres: the height resolution of the views.
    pub resolution_m: f32,
    /// One flag for each cell, true if its altitude was not matched but taken from its neighbours.
    pub filled: Vec<bool>,
}

impl Surface {
    /// True if every list has one entry per cell.
    pub fn is_whole(&self) -> bool {
        let cells = self.width.checked_mul(self.height);
        [
            self.altitude.len(),
            self.above.len(),
            self.confidence.len(),
            self.deviation_m.len(),
            self.probability.len(),
            self.matched.len(),
            self.views.len(),
            self.base_to_height.len(),
            self.filled.len(),
        ]
        .into_iter()
        .all(|length| Some(length) == cells)
    }

    /// Gives a cell the facts about a cell `at` of another surface, all but the altitudes.
    pub(super) fn take_facts(&mut self, cell: usize, other: &Self, at: usize) {
        self.confidence[cell] = other.confidence[at];
        self.deviation_m[cell] = other.deviation_m[at];
        self.probability[cell] = other.probability[at];
        self.matched[cell] = other.matched[at];
        self.views[cell] = other.views[at];
        self.base_to_height[cell] = other.base_to_height[at];
        self.filled[cell] = other.filled[at];
    }

    /// True if the altitude of a cell is known: at least [`FEWEST_VIEWS`] views see it there and agree better than by
    /// chance, and its probability is at least that of all other altitudes together.
    pub fn is_known(&self, cell: usize) -> bool {
        self.is_supported(cell) && self.probability[cell] >= KNOWN_PROBABILITY
    }

    /// True if at least [`FEWEST_VIEWS`] views see a cell at its altitude and agree better than by chance. The
    /// probability of other altitudes is not tested.
    pub fn is_supported(&self, cell: usize) -> bool {
        self.views[cell] >= FEWEST_VIEWS && self.matched[cell]
    }

    /// Mask of the cells for which [`Self::is_supported`] is true, `[row][column]`.
    pub fn supported(&self) -> Vec<bool> {
        (0..self.altitude.len()).map(|cell| self.is_supported(cell)).collect()
    }

    /// Grid of the cells.
    pub fn grid(&self) -> Grid {
        Grid {
            width: self.width,
            height: self.height,
            west_m: self.west_m,
            north_m: self.north_m,
            cell_m: self.cell_m,
        }
    }

    /// True if a ground position (metres) lies on the grid.
    pub fn contains(&self, x_m: f32, y_m: f32) -> bool {
        self.cell_at(x_m, y_m).is_some()
    }

    /// Index of the cell that contains a ground position (metres); `None` off the grid.
    pub fn cell_at(&self, x_m: f32, y_m: f32) -> Option<usize> {
        let (col, row) = ((x_m - self.west_m) / self.cell_m, (self.north_m - y_m) / self.cell_m);
        let inside = col >= 0.0 && row >= 0.0 && col < self.width as f32 && row < self.height as f32;
        inside.then(|| row as usize * self.width + col as usize)
    }

    /// Centre of a cell on the surface, metres.
    pub fn point(&self, col: usize, row: usize) -> Vec3 {
        Vec3::new(
            self.west_m + (col as f32 + 0.5) * self.cell_m,
            self.north_m - (row as f32 + 0.5) * self.cell_m,
            self.altitude[row * self.width + col],
        )
    }

    /// Altitude at a ground position, metres, bilinear between cell centres and constant beyond the outermost ones; the
    /// cell's own where one of the four is unknown, so that guesses do not distort it. `None` off the grid.
    pub fn altitude_at(&self, x_m: f32, y_m: f32) -> Option<f32> {
        let own = self.cell_at(x_m, y_m)?;
        let col = ((x_m - self.west_m) / self.cell_m - 0.5).clamp(0.0, self.width as f32 - 1.0);
        let row = ((self.north_m - y_m) / self.cell_m - 0.5).clamp(0.0, self.height as f32 - 1.0);
        let (c0, r0) = (col as usize, row as usize);
        let (c1, r1) = ((c0 + 1).min(self.width - 1), (r0 + 1).min(self.height - 1));
        let (fc, fr) = (col - c0 as f32, row - r0 as f32);
        let corners = [(c0, r0), (c1, r0), (c0, r1), (c1, r1)].map(|(c, r)| r * self.width + c);
        if self.is_known(own) && !corners.iter().all(|&cell| self.is_known(cell)) {
            return Some(self.altitude[own]);
        }
        let at = |c: usize, r: usize| self.altitude[r * self.width + c];
        let north = at(c0, r0) * (1.0 - fc) + at(c1, r0) * fc;
        let south = at(c0, r1) * (1.0 - fc) + at(c1, r1) * fc;
        Some(north * (1.0 - fr) + south * fr)
    }

    /// The lowest altitude within `radius` cells of each cell (a square window), metres.
    pub fn lowest(&self, radius: usize) -> Vec<f32> {
        lowest_within((self.width, self.height), &self.altitude, [radius; 2])
    }

    /// East and north slope of the surface at a cell (metres per metre), from the neighbour on the side where the
    /// surface changes less, so that a wall does not tilt the roof and the ground next to it.
    pub fn slope(&self, col: usize, row: usize) -> (f32, f32) {
        let at = |c: usize, r: usize| self.altitude[r * self.width + c];
        let here = at(col, row);
        let gentler = |back: Option<f32>, ahead: Option<f32>| match (back, ahead) {
            (Some(b), Some(a)) if b.abs() < a.abs() => b,
            (_, Some(a)) => a,
            (Some(b), None) => b,
            (None, None) => 0.0,
        };
        let west = (col > 0).then(|| here - at(col - 1, row));
        let east = (col + 1 < self.width).then(|| at(col + 1, row) - here);
        let south = (row + 1 < self.height).then(|| here - at(col, row + 1));
        let north = (row > 0).then(|| at(col, row - 1) - here);
        (gentler(west, east) / self.cell_m, gentler(south, north) / self.cell_m)
    }
}
