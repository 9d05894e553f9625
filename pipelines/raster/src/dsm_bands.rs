//! Bands of a surface model's GeoTIFF: a file format that products write and the evaluator reads.

/// Altitude, metres above the ellipsoid or a geoid.
pub const ALTITUDE: &str = "altitude";
/// Standard deviation of the altitude, metres.
pub const STANDARD_DEVIATION: &str = "standard_deviation";
/// Accumulated alpha, or confidence of the plane sweep, 0 to 1.
pub const COVERAGE: &str = "coverage";
/// Number of images that see the cell at its altitude.
pub const VIEWS: &str = "views";
