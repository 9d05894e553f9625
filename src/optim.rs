//! Moving parameters: Adam, learning-rate schedules, density control.

pub mod adam;
pub mod density;

pub use adam::{Adam, exponential_decay};
pub use density::{DensityOptions, DensityStatistics};
