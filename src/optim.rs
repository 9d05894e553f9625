//! Optimisation: Adam, learning-rate schedules, density control.

pub mod adam;
pub mod density;
pub mod schedule;

pub use adam::Adam;
pub use density::{DensityOptions, DensityStatistics};
pub use schedule::{LearningRate, ParameterGroup, exponential_decay};
