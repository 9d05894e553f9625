//! Scenes with known truth, rendered by a plain ray tracer that shares no code with the engine.
//!
//! [`write_satellite`] makes a place (terrain, streets, buildings, trees, water), photographs it on several dates with
//! a push-broom satellite whose RPC is fitted as a vendor would, and writes images and exact truth.
//!
//! ```no_run
//! use heliosplat_synth::{SatelliteRequest, Site, write_satellite};
//! let request = SatelliteRequest { site: Site::Tiny, seed: 7, ..Default::default() };
//! let summary = write_satellite(&request, "scene".as_ref(), &|done, total| eprintln!("{done}/{total}"))?;
//! println!("{} images", summary.images.len());
//! # Ok::<(), heliosplat_synth::SynthError>(())
//! ```
//!
//! Rooms: `terrain`, `city`, `vegetation`, `cars` and `solid` make the place; `materials` its colours; `raytrace` answers
//! what a ray meets; `sensor` is the camera, `known` and `rational` those of real images; `radiometry` the light, `clouds` what is in its way; `plan` decides
//! where, when and from which side; `render` and `truth` make the rasters; `write` the files; `satellite` calls them in order.
//! `objects` makes captures of an object from all around ([`write_object`]), by a path tracer of its own.

mod cars;
mod city;
mod clouds;
mod crop;
mod error;
mod known;
mod materials;
mod noise;
mod objects;
mod plan;
mod radiometry;
mod rational;
mod ray;
mod raytrace;
mod render;
mod request;
mod satellite;
mod sensor;
mod solid;
mod summary;
mod terrain;
mod truth;
pub mod utm;
mod vegetation;
mod write;

pub use error::SynthError;
pub use objects::{Capture, Look, ObjectRequest, ObjectSummary, write_object};
pub use request::{BandSet, SatelliteRequest, Site};
pub use satellite::write_satellite;
pub use summary::{ImageSummary, Summary};
pub use truth::TruthGrid;
