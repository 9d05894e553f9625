//! Captures of objects: images from around an object with cameras in `transforms_*.json` (the format of NeRF and of
//! nerfstudio), in a model of COLMAP or in a table.
//!
//! `transforms`, `colmap` and `camera_table` read cameras, `pixels` images, `points` clouds, and `capture` combines
//! them. `plan` selects a model by the short fits of `trial`; `start`, `views` and `fit` train it, `run` stores it,
//! `measure` scores it, and `training` is the whole pipeline.

pub mod camera_table;
pub mod capture;
pub mod colmap;
pub mod config;
pub mod error;
pub mod export;
pub mod fit;
pub mod frame_spec;
pub mod measure;
pub mod mesh;
pub mod model;
mod model_file;
mod paired;
pub mod pinhole;
pub mod pixels;
pub mod plan;
pub mod points;
mod prepare;
pub mod run;
pub mod start;
pub mod surroundings;
pub mod training;
pub mod transforms;
mod trial;
pub mod views;

pub use capture::{Capture, is_capture};
pub use error::{CaptureError, ObjectError};
