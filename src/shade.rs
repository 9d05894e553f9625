//! What surfaces do with light: formulas, each with its gradient.

pub mod asg;
pub mod sh;
