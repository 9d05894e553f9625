//! What surfaces do with light: formulas, each with its gradient.

pub mod asg;
pub mod dipole;
pub mod display;
pub mod falloff;
pub mod ggx;
pub mod sh;
pub mod split_sum;
