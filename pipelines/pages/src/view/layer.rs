//! Maps of a page other than its surface and albedo.

use heliosplat::Raster;

/// Colour ramp of a map.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Ramp {
    /// From blue over white to red; zero is white.
    Diverging,
    /// From dark to bright.
    Sequential,
    /// A picture: red, green and blue, or grey.
    Picture,
}

/// Map or picture on the page's grid.
#[derive(Debug, Clone)]
pub struct Layer {
    /// Key in the data of the page.
    pub id: String,
    /// Name shown to the user.
    pub name: String,
    /// Unit of the values; empty for counts and pictures.
    pub unit: &'static str,
    /// Colour ramp.
    pub ramp: Ramp,
    /// Values at the two ends of the ramp.
    pub range: [f32; 2],
    /// One band, or red, green and blue of a picture; NaN where unknown.
    pub values: Raster,
}

impl Layer {
    /// Map of one value per cell, metres.
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

    /// Picture with red, green and blue, 0 to 255.
    pub fn picture(id: &str, name: &str, values: Raster) -> Self {
        let unit = "";
        Self {
            unit,
            ..Self::map(id, name, (Ramp::Picture, [0.0, 255.0]), values)
        }
    }
}
