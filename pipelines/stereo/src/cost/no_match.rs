//! The weight of the no-match cost of each cell, so that hidden heights do not win by chance.
//!
//! It is a share of the weights of all comparisons between the views of the cell's own piece of ground, for any number
//! of views elsewhere in the scene. Views count where they would show the middle of the search range: the weight must
//! not depend on the height that is tested.

use super::super::parameters::no_match_weight;
use super::super::seen::pixel_of;
use super::MatchingCost;
use rayon::prelude::*;

impl MatchingCost<'_> {
    /// Weight of the no-match cost of each cell of the grid, in the unit of the pairs' weights; at least 1.
    pub(super) fn no_match_weights(&self) -> Vec<u32> {
        let middle_m = self.heights.altitude(0.5 * (self.heights.levels - 1) as f32);
        let totals: Vec<u32> = self.pairs.iter().map(|pair| self.total_weight(pair)).collect();
        let width = self.grid.width;
        let of_cell = |seen: &mut Vec<bool>, cell: usize| {
            let at = self
                .grid
                .point((cell % width) as isize, (cell / width) as isize, middle_m);
            seen.clear();
            seen.extend(self.views.iter().map(|view| {
                let pixel = pixel_of(&view.camera, at);
                pixel.is_some_and(|pixel| view.mean.pixels[pixel].is_finite())
            }));
            let both = self
                .pairs
                .iter()
                .zip(&totals)
                .filter(|(pair, _)| seen[pair.a] && seen[pair.b]);
            let all: u32 = both.map(|(_, total)| total).sum();
            let views = seen.iter().filter(|&&seen| seen).count();
            ((all as f32 * no_match_weight(views as f32)) as u32).max(1)
        };
        (0..self.grid.len())
            .into_par_iter()
            .with_min_len(1024)
            .map_init(Vec::new, of_cell)
            .collect()
    }
}
