//! Command-line program `heliosplat`: verbs over the libraries of this workspace, with text or JSON output.
//!
//! [`command_line`] parses arguments and runs one of [`verbs`]. Other crates handle neither arguments nor exit codes.

pub mod args;
pub mod command_line;
mod device;
pub mod outcome;
pub mod outputs;
pub mod parse;
pub mod verbs;
