//! Blocks of a mosaic: rectangles of cells that are merged one by one, so that memory does not grow with the area.

/// Least side of a block, cells.
pub(super) const SIDE_LEAST: usize = 64;
/// Side of the smallest block that memory leads to, cells: 60 MiB.
const FITTED_LEAST: usize = 512;
/// Ground around a block that its products see, metres. The ground below buildings needs the width of the widest
/// building (64 m); within this distance, a building of 45 m hides a sun 10 degrees high.
const AROUND_M: f64 = 256.0;

/// Block of a mosaic.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Block {
    /// Row of the block, counted from the north.
    row: usize,
    /// Column of the block, counted from the west.
    col: usize,
    /// West, south, east, north of the block, map units.
    pub bounds: [f64; 4],
    /// West, south, east, north of the block with the ground around it, within the mosaic, map units.
    pub around: [f64; 4],
}

impl Block {
    /// Name of the block within its area: `block-rROWcCOLUMN`.
    pub(super) fn name(&self) -> String {
        format!("block-r{}c{}", self.row, self.col)
    }

    /// True if bounds have ground in common with the block or the ground around it.
    pub(super) fn sees(&self, bounds: &[f64; 4]) -> bool {
        overlap(&self.around, bounds)
    }
}

/// True if two bounds (west, south, east, north) have ground in common.
pub(super) fn overlap(a: &[f64; 4], b: &[f64; 4]) -> bool {
    a[0] < b[2] && b[0] < a[2] && a[1] < b[3] && b[1] < a[3]
}

/// Common ground of two bounds (west, south, east, north).
pub(super) fn common(a: [f64; 4], b: [f64; 4]) -> [f64; 4] {
    [a[0].max(b[0]), a[1].max(b[1]), a[2].min(b[2]), a[3].min(b[3])]
}

/// Side of the blocks, cells: the largest up to `most` whose block with the ground around it fits into memory.
/// `fits` gets the cells of a block, and those of the block with the ground around it.
pub(super) fn side(most: usize, gsd_m: f64, fits: impl Fn(f64, f64) -> bool) -> usize {
    let cells = |side: usize| (side * side) as f64;
    let around = |side: usize| cells(side + 2 * reach_cells(gsd_m));
    // Multiples of the least side, so that the coarse cells of an overview end where blocks end.
    let sides = (1..=most / SIDE_LEAST).rev().map(|count| count * SIDE_LEAST);
    let mut fitting = sides.filter(|&side| side <= FITTED_LEAST || fits(cells(side), around(side)));
    fitting.next().unwrap_or(SIDE_LEAST)
}

/// Cells of the ground around a block on one side; whole, so that the ground begins on the grid.
fn reach_cells(gsd_m: f64) -> usize {
    (AROUND_M / gsd_m).ceil() as usize
}

/// Cuts a mosaic of cells of `gsd_m` into blocks of `side` cells from its north-western corner on; one block if it is no
/// larger.
pub(super) fn cut(bounds: [f64; 4], gsd_m: f64, side: usize) -> Vec<Block> {
    let [west, south, east, north] = bounds;
    let count = |length: f64| ((length / gsd_m).round() as usize).div_ceil(side).max(1);
    let step = side as f64 * gsd_m;
    let (rows, cols) = (count(north - south), count(east - west));
    let block = |(row, col): (usize, usize)| {
        let (left, top) = (west + col as f64 * step, north - row as f64 * step);
        let right = if col + 1 == cols { east } else { left + step };
        let bottom = if row + 1 == rows { south } else { top - step };
        let reach = reach_cells(gsd_m) as f64 * gsd_m;
        let around = common([left - reach, bottom - reach, right + reach, top + reach], bounds);
        Block {
            row,
            col,
            bounds: [left, bottom, right, top],
            around,
        }
    };
    let places = (0..rows).flat_map(|row| (0..cols).map(move |col| (row, col)));
    places.map(block).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blocks_cover_a_mosaic_once_and_look_at_the_ground_around_them() {
        let whole = [1000.0, 2000.0, 4250.0, 4048.0];
        let blocks = cut(whole, 0.5, 4096);
        let names: Vec<String> = blocks.iter().map(Block::name).collect();
        assert_eq!(names, ["block-r0c0", "block-r0c1"]);
        assert_eq!(blocks[0].bounds, [1000.0, 2000.0, 3048.0, 4048.0]);
        assert_eq!(blocks[1].bounds, [3048.0, 2000.0, 4250.0, 4048.0]);
        assert_eq!(blocks[1].around, [2792.0, 2000.0, 4250.0, 4048.0]);
        assert!(
            blocks[1].sees(&[2700.0, 2100.0, 2800.0, 2200.0]) && !blocks[1].sees(&[2700.0, 2100.0, 2792.0, 2200.0])
        );
        let one = cut(whole, 0.5, 10_000);
        assert!(one.len() == 1 && one[0].bounds == whole && one[0].around == whole);
    }

    #[test]
    fn blocks_are_smaller_where_memory_is_scarce() {
        assert_eq!(side(4096, 0.5, |cells, _| cells * 200.0 < 4e9), 4096);
        assert_eq!(side(4096, 0.5, |cells, _| cells * 200.0 < 2e8), 960);
        assert_eq!(side(4096, 0.5, |_, around| around * 100.0 < 4e8), 960);
        assert_eq!(side(4096, 0.5, |_, _| false), FITTED_LEAST);
        assert_eq!(side(100, 0.5, |_, _| true), SIDE_LEAST);
    }
}
