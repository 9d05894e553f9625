//! The bands of a raster file as it states them, and windows of its pixels.

/// Colour interpretation of a band.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Colour {
    /// Grey, or nothing said.
    Grey,
    /// Red.
    Red,
    /// Green.
    Green,
    /// Blue.
    Blue,
    /// Opacity.
    Alpha,
    /// Indices into a colour table.
    Palette,
    /// Not stated.
    Undefined,
}

/// One band of a file.
#[derive(Debug, Clone, PartialEq)]
pub struct BandInfo {
    /// Its description, empty where the file has none.
    pub description: String,
    /// Its colour interpretation.
    pub colour: Colour,
    /// GDAL's name of the data type, such as `UInt16`.
    pub data_type: String,
    /// The unit of its values, empty where the file says none.
    pub unit: String,
    /// The value that means "nothing here".
    pub nodata: Option<f64>,
    /// Factor from counts to the unit, if the file states it.
    pub scale: Option<f64>,
    /// Offset after the factor, if the file states it.
    pub offset: Option<f64>,
}

/// A pixel window: first column and row, columns and rows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Window {
    /// First column.
    pub col0: usize,
    /// First row.
    pub row0: usize,
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
}
