//! Coarse mask of an image's data, for visibility without the image.

/// Side of a tile, pixels.
const TILE_PX: usize = 8;

/// Mask of an image (or a crop of one) by tiles of 8 × 8 pixels: true where more than half of a tile's pixels have
/// data.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct KnownTiles {
    /// Rows of tiles, one text each: `1` has data, `0` has none.
    rows: Vec<String>,
}

impl KnownTiles {
    /// Tiles of an image of `width` columns from its mask, row by row; `None` where all pixels have data.
    pub fn of(width: usize, known: &[bool]) -> Option<Self> {
        if width == 0 || known.iter().all(|&known| known) {
            return None;
        }
        let height = known.len() / width;
        let most = |col: usize, row: usize| {
            let rows = row * TILE_PX..((row + 1) * TILE_PX).min(height);
            let columns = col * TILE_PX..((col + 1) * TILE_PX).min(width);
            let cells = rows.len() * columns.len();
            let known_in = |r: usize| known[r * width..][columns.clone()].iter().filter(|&&k| k).count();
            let with_data: usize = rows.map(known_in).sum();
            if 2 * with_data > cells { '1' } else { '0' }
        };
        let row = |row: usize| (0..width.div_ceil(TILE_PX)).map(|col| most(col, row)).collect();
        let rows = (0..height.div_ceil(TILE_PX)).map(row).collect();
        Some(Self { rows })
    }

    /// True if the tile of a pixel (column, row) has data; false outside of the image.
    pub fn at(&self, (col, row): (usize, usize)) -> bool {
        let tiles = self.rows.get(row / TILE_PX);
        tiles.is_some_and(|tiles| tiles.as_bytes().get(col / TILE_PX) == Some(&b'1'))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_collar_of_an_image_has_no_data_and_a_whole_image_needs_no_tiles() {
        const WIDTH: usize = 20;
        let known: Vec<bool> = (0..WIDTH * 17).map(|i| i % WIDTH < 15).collect();
        let tiles = KnownTiles::of(WIDTH, &known).expect("some pixels have no data");
        assert!(tiles.at((0, 0)) && tiles.at((7, 16)) && tiles.at((14, 3)));
        assert!(!tiles.at((19, 0)) && !tiles.at((0, 24)) && !tiles.at((24, 0)));
        assert_eq!(KnownTiles::of(WIDTH, &[true; 40]), None);
    }
}
