//! Trees of a city: requested by plots, and placed at the end, away from walls, other trees and water.

use super::palette;
use super::planner::{Planner, Plot};
use super::streets::Block;
use crate::vegetation::{Tree, TreeKind};
use rand::RngExt;

impl Planner {
    /// Requests a tree at the place `at` of a plot, metres. [`Self::grow`] makes it if nothing is in its way.
    pub(crate) fn plant(&mut self, plot: &Plot, at: [f64; 2], radius_m: f64, kind: TreeKind) {
        self.wanted_trees.push((plot.uv(at), radius_m, kind));
    }

    /// Grows the requested trees, except where a wall, another tree or water is in the way.
    pub(crate) fn grow(&mut self) {
        for (uv, radius_m, kind) in std::mem::take(&mut self.wanted_trees) {
            let [x, y] = self.bend.xy_from_uv(uv);
            let near_wall = (self.buildings.iter()).any(|b| b.footprint.distance_m(x, y) < 0.7 * radius_m + 0.4);
            let near_tree = (self.trees.iter()).any(|t| (t.x - x).hypot(t.y - y) < 0.62 * (t.radius_m + radius_m));
            let near_water = (self.ponds.iter()).any(|p| p.zone.distance_m(uv) < 0.6 * radius_m + 0.5);
            if near_wall || near_tree || near_water {
                continue;
            }
            let seed = self.next_seed();
            let slender = match kind {
                TreeKind::Conifer => self.range(2.6, 3.6),
                _ => self.range(1.9, 2.6),
            };
            let height_m = (slender * radius_m + self.range(0.5, 2.5)).min(16.0);
            let leaf = palette::leaf(self, kind);
            self.trees.push(Tree {
                x,
                y,
                radius_m,
                height_m,
                kind,
                leaf,
                seed,
            });
        }
    }

    /// Random kind of tree: seven in ten are broad-leaved.
    pub(crate) fn any_tree(&mut self) -> TreeKind {
        match self.random.random_range(0..10) {
            0..7 => TreeKind::Broadleaf,
            7..9 => TreeKind::Evergreen,
            _ => TreeKind::Conifer,
        }
    }
}

/// Requests rows of trees along the four sides of a block's pavement.
pub(super) fn along_pavement(planner: &mut Planner, block: &Block) {
    let plot = Plot::inside(block, 1.1);
    let kind = planner.pick(&[TreeKind::Broadleaf, TreeKind::Broadleaf, TreeKind::Evergreen]);
    for side in [-1.0, 1.0] {
        for (axis, chance) in [(0, 0.75), (1, 0.6)] {
            if !planner.chance(chance) {
                continue;
            }
            let spacing_m = planner.range(8.5, 13.0);
            let radius_m = planner.range(1.9, 3.1);
            let reach = plot.half[axis] - 4.0;
            let mut place = -reach;
            while place < reach {
                let mut at = [place; 2];
                at[1 - axis] = side * plot.half[1 - axis];
                if planner.chance(0.85) {
                    let grown = radius_m * planner.range(0.85, 1.15);
                    planner.plant(&plot, at, grown, kind);
                }
                place += spacing_m;
            }
        }
    }
}
