//! Captures of objects: images from around an object with cameras and lights in `transforms_*.json`, the format of
//! NeRF.
//!
//! `transforms` reads cameras and lights, `pixels` images, and `capture` combines them. `plan` selects a model by the
//! short fits of `trial`; `start`, `views` and `fit` train it, `run` stores it, `measure` scores it, and `training` is
//! the whole pipeline.

pub mod capture;
pub mod config;
pub mod error;
pub mod export;
pub mod fit;
pub mod measure;
pub mod mesh;
pub mod model;
mod model_file;
mod paired;
pub mod pinhole;
pub mod pixels;
pub mod plan;
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
