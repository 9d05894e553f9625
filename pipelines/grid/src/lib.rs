//! Values on a regular grid: statistics, windows, filters, horizons and cast shadows. The functions take and return
//! slices, row by row from north to south, without files, cameras or coordinate systems. Results are the same bytes for
//! any number of threads.

mod cells;
pub mod drape;
mod peak;
mod plane;
pub mod relief;
mod sampling;
pub mod statistics;
mod total_variation;

pub use cells::{Grid, around, in_parallel, lowest_within, opening};
pub use peak::parabola_top;
pub use plane::PlaneFit;
pub use sampling::{bilinear, bilinear_to_the_edge};
pub use total_variation::smooth_by_deviation;
