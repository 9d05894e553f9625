//! Verbs of the program, with their arguments.

pub mod adjust;
pub mod batch;
pub mod bench;
pub mod completions;
pub mod config_file;
#[cfg(feature = "synth")]
pub mod demo;
pub mod evaluate;
pub mod evaluate_args;
pub mod export;
pub mod export_args;
pub mod inspect;
pub mod man;
pub mod model;
pub mod model_args;
pub mod object;
pub mod products;
pub mod report;
pub mod rpc;
pub mod satellite;
pub mod sun;
pub mod sweep_dsm;
#[cfg(feature = "synth")]
pub mod synth;
pub mod view;
