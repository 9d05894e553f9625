//! Description of the bands of a raster file, and windows of its pixels.

/// Colour interpretation of a band.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Colour {
    /// Grey.
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
    /// Not stated, or any other colour.
    Undefined,
}

/// One band of a file.
#[derive(Debug, Clone, PartialEq)]
pub struct BandInfo {
    /// Description, empty where the file has none.
    pub description: String,
    /// Colour interpretation.
    pub colour: Colour,
    /// GDAL's name of the data type, such as `UInt16`.
    pub data_type: String,
    /// Unit of its values, empty where the file states none.
    pub unit: String,
    /// Value of missing pixels, if the file states one.
    pub nodata: Option<f64>,
    /// Factor from counts to the unit, if the file states it.
    pub scale: Option<f64>,
    /// Offset, in the unit, added after the factor, if the file states it.
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
