//! Products of a trained satellite model, as files: surface models, true orthos, relit images, shadow masks, point
//! clouds, STAC items.
//!
//! [`model`] reads a run; [`surface`] and [`dsm`] compute its surface as seen from above; [`views`] renders its images;
//! [`relight`] renders it under another sun; [`set`] writes all products for a GIS through [`writer`], and [`stac`]
//! describes them.

pub mod blend;
pub mod change;
pub mod dsm;
pub mod export;
mod fill;
mod ground_doubt;
mod leaves;
pub mod model;
mod model_file;
pub mod nadir;
pub mod ortho;
pub mod ply;
pub mod points;
pub mod relight;
pub mod relit_light;
pub mod seams;
pub mod seen;
pub mod set;
pub mod shadow_mask;
pub mod stac;
pub mod stored;
pub mod style;
pub mod sunshine;
pub mod surface;
pub mod surface_shadow;
pub mod views;
pub mod writer;
