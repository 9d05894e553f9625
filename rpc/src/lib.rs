//! Rational cameras, local frames, pinhole fits and the sun: the geometry of the camera, the Earth and the sun.
//!
//! Everything here is `f64`, knows no pixels and no files' locations: readers take text and tags, not paths. Image
//! coordinates have pixel centres at integers (RPC00B); heights are metres above the WGS84 ellipsoid.

mod batch;
mod localise;
mod polynomial;

pub mod adjust;
mod example;
pub mod fit;
pub mod frame;
pub mod pinhole;
pub mod read;
pub mod rpc;
pub mod statistics;
pub mod sun;
pub mod triangulate;
pub mod write;

pub use frame::LocalFrame;
pub use pinhole::{ImageWindow, PinholeFit, ProjectiveMap};
pub use rpc::{GeoPoint, ImagePoint, Rpc, RpcError};
pub use sun::{SunPosition, sun_position};
