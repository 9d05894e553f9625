//! Memory of a plane sweep, as an upper bound before its pixels are read.
//!
//! Most of it is the cost volume: one byte of matching cost and two of summed costs for each height hypothesis of each
//! cell. A cell of the finest level searches around the result of coarser levels, all hypotheses at most; their number
//! follows from the range of altitudes and the widest base of two images. A range of twice the width may need twice the
//! memory.

use heliosplat_scene::survey::Survey;
use heliosplat_stereo::height_levels;

/// Memory of the program itself with its libraries and their buffers, bytes.
pub const PROGRAM_BYTES: f64 = 100.0 * 1_048_576.0;
/// Bytes per height hypothesis of a cell: a cost, and the sum over all paths.
const BYTES_PER_LEVEL: f64 = 3.0;
/// Further bytes per cell: heights chosen at two levels of the search with their candidates, ranges, the guide image,
/// the surface.
const BYTES_PER_CELL: f64 = 100.0;
/// Bytes per pixel and band of the images: the copy that was read, and the copy that is swept.
const BYTES_PER_PIXEL_AND_BAND: f64 = 8.0;
/// Further bytes per pixel: mean of the bands and its contrast, a copy during its computation, the first visible
/// surface, the index.
const BYTES_PER_PIXEL: f64 = 36.0;
/// Bytes per pixel of the largest image while it is read.
const BYTES_PER_PIXEL_READ: f64 = 12.0;
/// Bytes per cell of the map while a surface model is made and written: its bands twice, and the finished file.
const BYTES_PER_MAP_CELL: f64 = 40.0;
/// Further bytes while reading: GDAL's block cache, and a sample of all values.
const READING_BYTES: f64 = 96.0 * 1_048_576.0;
/// Factor for the overhead of allocators.
const SPARE: f64 = 1.1;

/// Quantities of the memory of a sweep that are equal for all parts of a scene.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct SweepModel {
    /// Number of height hypotheses of a cell.
    pub(super) levels: usize,
    /// Number of bands of every image.
    pub(super) bands: usize,
}

/// The ground and the images of one sweep.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct SweepExtent {
    /// Number of cells of the ground grid.
    pub(super) cells: f64,
    /// Number of cells of the surface model's map.
    pub(super) map_cells: f64,
    /// Number of pixels of all images.
    pub(super) pixels: f64,
    /// Number of pixels of the largest image.
    pub(super) largest: f64,
}

impl SweepModel {
    /// Model for a scene that is swept in cells of `cell_m` metres.
    pub(super) fn of(survey: &Survey, cell_m: f64) -> Self {
        let (low_m, high_m) = survey.altitude_range_m;
        let widest = survey.widest_base_to_height;
        Self {
            levels: height_levels((high_m - low_m) as f32, cell_m as f32, widest as f32),
            bands: survey.bands,
        }
    }

    /// Largest memory of the process during the sweep, bytes.
    pub(super) fn bytes(&self, extent: &SweepExtent) -> f64 {
        let read = BYTES_PER_PIXEL_AND_BAND * self.bands as f64 * extent.pixels;
        let search = search_bytes(extent.cells, self.levels, extent.pixels);
        let reading = BYTES_PER_PIXEL_READ * extent.largest;
        let writing = BYTES_PER_CELL * extent.cells + BYTES_PER_MAP_CELL * extent.map_cells;
        PROGRAM_BYTES + READING_BYTES + SPARE * (read + search.max(reading).max(writing))
    }
}

/// Largest memory that the search of `cells` cells with `levels` height hypotheses adds to images of `pixels` pixels,
/// bytes.
pub(super) fn search_bytes(cells: f64, levels: usize, pixels: f64) -> f64 {
    cells * (BYTES_PER_CELL + BYTES_PER_LEVEL * levels as f64) + BYTES_PER_PIXEL * pixels
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn memory_grows_with_the_range_of_altitudes_and_with_the_ground() {
        let extent = SweepExtent {
            cells: 1e6,
            map_cells: 1e6,
            pixels: 2e6,
            largest: 1e6,
        };
        let bytes = |levels: usize, extent: &SweepExtent| SweepModel { levels, bands: 1 }.bytes(extent);
        assert!((bytes(300, &extent) - bytes(200, &extent) - SPARE * 3e8).abs() < 1.0);
        let fixed = PROGRAM_BYTES + READING_BYTES;
        let larger = SweepExtent {
            cells: 4e6,
            map_cells: 4e6,
            pixels: 8e6,
            largest: 4e6,
        };
        assert!((bytes(100, &larger) - fixed - 4.0 * (bytes(100, &extent) - fixed)).abs() < 1.0);
    }
}
