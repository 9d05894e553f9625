//! The program `heliosplat`: verbs for people and machines over the libraries of this workspace.
//!
//! [`command_line`] parses arguments and runs one of [`verbs`]; [`batch`] does many trainings, [`tradeoff`] measures speed against
//! accuracy, [`report`] and [`view`] write pages from [`page`]'s parts. Nothing below this crate knows of arguments or exit codes.

pub mod args;
pub mod batch;
pub mod command_line;
pub mod names;
pub mod outcome;
pub mod outputs;
pub mod page;
pub mod parse;
pub mod report;
pub mod tradeoff;
pub mod verbs;
pub mod view;
