//! Dense stereo for satellite images: an initial surface in seconds, by an object-space plane sweep with semi-global
//! matching on the ground grid; also tie points for camera adjustment and a search for clouds.
//!
//! From views to surface, step by step:
//!
//! 1. `views.rs`: the input, images with cameras, dates and suns; `pairs.rs`: the pairs of them to compare, with
//!    weights.
//! 2. `parameters.rs`: the matching parameters that depend on the scene, chosen from the views' geometry before any
//!    pixel is read ([`MatchingParameters`]).
//! 3. `request.rs`: the part of space to search and those parameters; [`Grid`](heliosplat_grid::Grid) and `heights.rs`:
//!    its cells and height hypotheses.
//! 4. `pyramid.rs`: the search from coarse to fine cells; `ranges.rs`: each cell searches around the candidates of the
//!    coarser level.
//! 5. `level.rs`, `sampling.rs`: views averaged down to the cells of a level, and sampled on the plane of a height
//!    hypothesis.
//! 6. `cost.rs`, `census.rs`: disagreement of pairs of views on each cell at each height.
//! 7. `sgm.rs`: semi-global aggregation of the costs; `ortho.rs` makes the guide image of its penalties.
//! 8. `wta.rs`: the cheapest height of each cell, refined below the height step, with its confidence.
//! 9. `visibility.rs`: at full resolution, cells hidden from a view are left out, and steps 6 to 8 are repeated.
//! 10. `plane_sweep.rs`: [`plane_sweep()`] runs all this, then removes speckles (`postprocess.rs`) and smooths
//!     uncertain heights ([`heliosplat_grid::smooth_by_deviation`]), or smooths by planes where the base is short
//!     (`plane_smoothing.rs`), and places edges where the views change (`edges.rs`). The result is a [`Surface`]
//!     (`surface.rs`).
//! 11. `agreement.rs`, `evidence.rs`: the views are resampled to the surface, and cells where they agree no better than
//!     by chance become unknown.
//!
//! On a coarse surface of the same search, [`pointing`] corrects cameras by shifts and tie points, and [`clouds`] finds
//! the pixels that show clouds. [`change`] sweeps the images before and after a day. Evidence of light is
//! `heliosplat-radiometry`.
//!
//! Limits: one altitude per cell (no overhangs, façades are steps); structures narrower than a few cells (trees without
//! leaves, wires, courtyards) are missed. Views of other dates have less weight; changes between them count as no
//! match. Results are the same bytes for any number of threads.

mod agreement;
mod census;
pub mod change;
pub mod clouds;
mod contrast;
mod cost;
mod edges;
mod evidence;
#[cfg(test)]
mod fixture;
mod floor;
mod heights;
mod level;
mod ortho;
mod pairs;
mod parameters;
mod plane_smoothing;
mod plane_sweep;
pub mod pointing;
mod postprocess;
mod pyramid;
mod ranges;
mod request;
mod sampling;
mod second_opinion;
mod seen;
mod sgm;
mod surface;
mod views;
mod visibility;
mod volume;
mod wta;

pub use census::CENSUS_CELLS;
pub use heights::height_levels;
pub use pairs::{Widest, weight_of_geometry, widest_base};
pub use parameters::{CandidateTolerance, FEW_VIEWS, MANY_VIEWS, MatchingFacts, MatchingParameters, no_match_weight};
pub use plane_sweep::plane_sweep;
pub use request::PlaneSweepRequest;
pub use seen::{AltitudeGrid, FEWEST_VIEWS, Witnesses, views_seeing};
pub use surface::Surface;
pub use views::{SweepView, ViewGeometry};
pub use volume::SearchVolume;
