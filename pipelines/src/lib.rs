//! Scenes in, products out: ingest, the satellite pipeline, evaluation and the command line.

pub mod batch;
pub mod cli;
pub mod evaluate;
pub mod objects;
pub mod page;
pub mod ply;
pub mod product;
pub mod raster;
pub mod report;
pub mod run;
pub mod satellite;
pub mod scene;
pub mod tradeoff;
pub mod trust;
