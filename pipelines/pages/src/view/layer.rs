//! Maps of a page besides its surface and albedo.

use heliosplat::Raster;

/// Colour ramp of a map.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Ramp {
    /// From blue over white to red; zero is white.
    Diverging,
    /// From dark to bright.
    Sequential,
    /// A picture: red, green and blue, or grey.
    Picture,
}

impl Ramp {
    /// Its name in the page.
    pub fn name(self) -> &'static str {
        match self {
            Self::Diverging => "diverging",
            Self::Sequential => "sequential",
            Self::Picture => "picture",
        }
    }
}

/// A map on the page's grid.
#[derive(Debug, Clone)]
pub struct Layer {
    /// Its key in the page.
    pub id: String,
    /// Its name for people.
    pub name: String,
    /// The unit of its values; empty for a picture.
    pub unit: &'static str,
    /// Its colours.
    pub ramp: Ramp,
    /// Values at the two ends of the ramp.
    pub range: [f32; 2],
    /// Its values; NaN where unknown.
    pub values: Raster,
}

impl Layer {
    /// A map of one value per cell.
    pub fn map(id: &str, name: &str, (ramp, range): (Ramp, [f32; 2]), values: Raster) -> Self {
        Self {
            id: id.into(),
            name: name.into(),
            unit: "m",
            ramp,
            range,
            values,
        }
    }

    /// A picture with red, green and blue.
    pub fn picture(id: &str, name: &str, values: Raster) -> Self {
        Self {
            id: id.into(),
            name: name.into(),
            unit: "",
            ramp: Ramp::Picture,
            range: [0.0, 255.0],
            values,
        }
    }
}
