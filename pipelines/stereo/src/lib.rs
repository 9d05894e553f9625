//! Where training starts from: a surface in seconds, swept through the views in object space.
//!
//! For each cell of a local ground grid and each altitude of a ladder, [`sweep::sweep`] asks how well the views agree
//! on what they see there (census over a window on the ground plane, of brightness and, where views have one, of an index;
//! pairs of views, robustly combined), makes the
//! answers consistent with their neighbours (semi-global matching on the ground grid), drops the views that the surface
//! itself hides, and refines below the step of the ladder. Views of other dates take part with less weight: what
//! changed, moved with the sun or is hidden must not veto. [`align::coarse_shifts`] finds the pointing bias between
//! the images with the same machinery; [`ties`] finds single points of the ground in several images, for a camera adjustment.
//!
//! Limits: one altitude per cell (no overhangs, façades are steps), and a surface a few cells wide at best: trees
//! without leaves, wires and narrow courtyards are left to training.

pub mod align;
mod bands;
mod census;
pub mod clouds;
mod cost;
mod grid;
mod ortho;
mod pairs;
mod pick;
mod search;
mod settle;
mod sgm;
mod smooth;
pub mod surface;
pub mod sweep;
pub mod ties;
mod views;
mod visibility;

pub use search::MANY_VIEWS;
pub use surface::Surface;
pub use sweep::{SweepOptions, SweepRequest};
pub use views::SweepView;
