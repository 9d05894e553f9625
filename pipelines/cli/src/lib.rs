//! The program `heliosplat`: verbs for people and machines over the libraries of this workspace.
//!
//! [`command_line`] parses arguments and runs one of [`verbs`]. Nothing below this crate knows of arguments or exit codes.

pub mod args;
pub mod command_line;
pub mod names;
pub mod outcome;
pub mod parse;
pub mod verbs;
