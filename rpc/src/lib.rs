//! Rational polynomial cameras (RPC) of satellite images: projection, localisation, fitting, bias correction, and the
//! sun.
//!
//! Vendors deliver a satellite image with an RPC: two ratios of cubic polynomials that map longitude, latitude and
//! height to column and row. This crate reads such cameras, evaluates and inverts them, corrects their biases, and
//! brings them into a local frame in which computer vision can work. It takes text and numbers and returns numbers: it
//! reads no pixels, opens no files, and needs neither GDAL nor PROJ.
//!
//! | module | content |
//! |---|---|
//! | [`mod@read`] | RPC and metadata from RPB, `_RPC.TXT`, DIMAP, Maxar XML, Sat-NeRF JSON, GeoTIFF tag, GDAL domains |
//! | [`mod@write`] | RPC as `_RPC.TXT`, Sat-NeRF JSON, GeoTIFF tag or GDAL domain |
//! | [`rpc`] | image position of a ground point ([`Rpc::project`]), ground point at a height ([`Rpc::localise`]) |
//! | [`frame`] | WGS 84 longitude, latitude, height to local east, north, up, and back |
//! | [`pinhole`] | the projective camera that is nearest to an RPC over a window, with its largest error in pixels |
//! | [`parallax`] | precision of altitudes from images of different directions |
//! | [`triangulate`] | the ground point of corresponding pixels |
//! | [`adjust`] | RPC bias correction: small corrections of all images from tie points (block adjustment) |
//! | [`fit`] | an RPC from pairs of ground and image points |
//! | [`sun`] | azimuth and elevation of the sun from time and place |
//!
//! # Conventions
//! - All numbers are `f64`.
//! - Image coordinates have pixel centres at integers, as RPC00B has: the upper left pixel's centre is (0, 0). GDAL's
//!   pixel corners are half a pixel off; the reader of the image converts them.
//! - Heights are metres above the WGS 84 ellipsoid, not above the geoid.
//! - Angles are degrees where a name ends in `_deg`, else radians. Azimuths count clockwise from north.
//!
//! # Example
//! A ground point projected through a camera that looks straight down, and back again:
//!
//! ```
//! use heliosplat_rpc::{GeoPoint, Rpc};
//!
//! // The terms are 1, L (longitude), P (latitude), H (height), and sixteen of higher order, all normalised.
//! let polynomial = |first: [f64; 4]| -> [f64; 20] { std::array::from_fn(|k| first.get(k).copied().unwrap_or(0.0)) };
//! let rpc = Rpc {
//!     line_offset: 5_000.0,
//!     sample_offset: 5_000.0,
//!     line_scale: 5_000.0,
//!     sample_scale: 5_000.0,
//!     latitude_offset_deg: 48.1,
//!     longitude_offset_deg: 11.6,
//!     height_offset_m: 560.0,
//!     latitude_scale_deg: 0.02,
//!     longitude_scale_deg: 0.03,
//!     height_scale_m: 500.0,
//!     line_numerator: polynomial([0.0, 0.0, -1.0, 0.0]),
//!     line_denominator: polynomial([1.0, 0.0, 0.0, 0.0]),
//!     sample_numerator: polynomial([0.0, 1.0, 0.0, 0.0]),
//!     sample_denominator: polynomial([1.0, 0.0, 0.0, 0.0]),
//!     error_bias_m: None,
//!     error_random_m: None,
//! };
//!
//! // Half a scale east and half a scale north of the centre.
//! let ground = GeoPoint { lon_deg: 11.615, lat_deg: 48.11, height_m: 560.0 };
//! let pixel = rpc.project(ground);
//! assert!((pixel.col - 7_500.0).abs() < 1e-6 && (pixel.row - 2_500.0).abs() < 1e-6);
//!
//! let back = rpc.localise(pixel, 560.0)?;
//! assert!((back.lon_deg - ground.lon_deg).abs() < 1e-9 && (back.lat_deg - ground.lat_deg).abs() < 1e-9);
//! # Ok::<(), heliosplat_rpc::RpcError>(())
//! ```
//!
//! # Limits
//! RPC00B with two denominators; no rigorous sensor models, no datums besides WGS 84, no geoid.

mod batch;
mod localise;
mod polynomial;

pub mod adjust;
mod example;
pub mod fit;
pub mod frame;
pub mod parallax;
pub mod pinhole;
pub mod read;
pub mod rpc;
pub mod sun;
pub mod triangulate;
pub mod write;

pub use frame::LocalFrame;
pub use pinhole::{ImageWindow, PinholeFit, ProjectiveMap};
pub use rpc::{GeoPoint, ImagePoint, Rpc, RpcError};
pub use sun::{SunPosition, sun_position};
