//! Test scenes with exact truth for multi-view reconstruction: satellite images of a synthetic city, and captures of
//! objects.
//!
//! Real scenes have no exact truth: a lidar DSM is from another year, and the outlines of shadows are unknown. Here the
//! truth is exact: the altitude, class and albedo of each cell, the pixels in shadow or behind clouds, and the camera
//! without its error. A reconstruction can be measured to the centimetre, and no error can be blamed on the data.
//!
//! The renderer is a plain `f64` ray tracer with no approximations. It shares no code with the engine that it tests, so
//! that an error in one is not an error in both.
//!
//! # Satellite scenes
//! [`write_satellite`] makes a place (terrain, streets, buildings, trees, water), photographs it on several dates with
//! a push-broom satellite whose RPC is fitted as a vendor would, and writes images, metadata and truth:
//!
//! ```no_run
//! use heliosplat_synth::{SatelliteRequest, Site, write_satellite};
//! let request = SatelliteRequest { site: Site::Tiny, seed: 7, ..Default::default() };
//! let summary = write_satellite(&request, "scene".as_ref(), &|done, total| eprintln!("{done}/{total}"))?;
//! println!("{} images", summary.images.len());
//! # Ok::<(), heliosplat_synth::SynthError>(())
//! ```
//!
//! Modelled: sun by date and place, sky light, haze, clouds and their shadows, seasons of vegetation, cars that come
//! and go, glint on water, point spread, sensor noise, 8 or 16 bits, RPC bias, and cameras of real images (VisSat JSON)
//! instead of made-up ones. Not modelled: light through foliage, moving cars, and sensor artefacts such as striping.
//!
//! Real images have more faults. [`Fault`] lists those that are off by default: gains of bands, a layer of haze for
//! each date, interreflection (without it, light of an average neighbourhood), glossy surfaces, large clouds, and
//! display images that were stretched. [`Cover`] puts one half of a site under the sea or under snow.
//!
//! # Captures of objects
//! [`write_object`] photographs a small still life from all around, under a fixed sky, under one light at a time
//! (OLAT), or under an environment map with visible reflections. It uses a path tracer of its own and writes the
//! `transforms_*.json` that NeRF tools read.
//!
//! # Determinism
//! A request with a seed gives the same bytes on every run, for any number of threads. A folder is written beside its
//! target and moved into place at the end; a failure leaves nothing behind.
//!
//! # Modules
//! From the bottom up; arrows go one way.
//!
//! | modules | content |
//! |---|---|
//! | `noise`, `materials`, `panels` | random streams, hashes and value noise; albedos and textures of surfaces, solar panels |
//! | `ray`, `terrain`, `raytrace`, `solid` | rays, the height field, intersections, and primitives with their surfaces |
//! | `cover` | half of a site under sea or snow, and the sea's waves |
//! | `vegetation`, `cars`, `city` | trees and hedges, cars, and the city of streets and blocks that holds them |
//! | `crop`, `rational`, `sensor`, `known` | windows of images, cameras given as RPCs, the push-broom camera, cameras of real images |
//! | `clouds`, `faults`, `gloss` | clouds, gains, haze and stretch, the lobe of glossy surfaces |
//! | `radiometry` | sun, sky, interreflection, and the encoding of light in counts |
//! | `plan`, `render`, `studio`, `truth` | place, dates and views; images; their light and exposure; truth rasters |
//! | `nadir`, `relit` | the view from straight above; truth under additional suns, hours of sun |
//! | `write`, `truth_files`, `delivery`, `satellite` | files; truth rasters; images in two files as vendors pack them; the steps in order |
//! | `objects` | everything about captures of objects |
//! | [`utm`] | Transverse Mercator without PROJ, for the truth rasters |

mod cars;
mod city;
mod clouds;
mod cover;
mod crop;
mod delivery;
mod encoding;
mod error;
mod faults;
mod gloss;
mod known;
mod materials;
mod nadir;
mod noise;
mod objects;
mod panels;
mod plan;
mod radiometry;
mod rational;
mod ray;
mod raytrace;
mod relit;
mod render;
mod request;
mod satellite;
mod sensor;
mod solid;
mod studio;
mod summary;
mod terrain;
mod truth;
mod truth_files;
mod truth_grid;
pub mod utm;
mod vegetation;
mod write;

pub use error::SynthError;
pub use faults::{Haze, Stretch};
pub use objects::{Capture, Look, ObjectRequest, ObjectSummary, write_object};
pub use request::{BandSet, Cover, Delivery, Fault, Faults, SatelliteRequest, Site};
pub use satellite::write_satellite;
pub use summary::{ImageSummary, Summary};
pub use truth_grid::TruthGrid;
