//! Image files that a DIMAP v2 lists; a large image has several tiles.

use super::fields::number;
use super::kind::{TextKind, kind};
use super::xml::{find, find_all, parse, text as text_of};
use roxmltree::Node;

/// One file of an image.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DataFile {
    /// Row and column of the tile, counted from one.
    pub tile: [u32; 2],
    /// Path relative to the DIMAP.
    pub href: String,
}

/// Images of a DIMAP and their tiles.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DataFiles {
    /// Files of each image. Pléiades Neo has its bands in two images.
    pub images: Vec<Vec<DataFile>>,
    /// Columns and rows from one tile to the next; `None` where tiles are not regular.
    pub step_px: Option<[usize; 2]>,
}

/// Files listed in a `DIM_*.XML`; `None` for other texts, or where none is listed.
pub fn data_files(text: &str) -> Option<DataFiles> {
    if kind(text) != TextKind::Dimap {
        return None;
    }
    let document = parse("DIMAP", text).ok()?;
    let root = document.root_element();
    let attribute = |node: Node, name: &str| node.attribute(name).and_then(number);
    let file = |node: Node| {
        let index = |name: &str| attribute(node, name).map_or(1, |value| value as u32);
        Some(DataFile {
            tile: [index("tile_R"), index("tile_C")],
            href: find(node, "DATA_FILE_PATH")?.attribute("href")?.to_owned(),
        })
    };
    let images = find_all(root, "Data_Files").map(|list| find_all(list, "Data_File").filter_map(file).collect());
    let images: Vec<Vec<DataFile>> = images.filter(|files: &Vec<DataFile>| !files.is_empty()).collect();
    let step = |node: Node, size: &str, overlap: &str| {
        let overlap_px = text_of(root, overlap).and_then(number).unwrap_or(0.0);
        // `as` saturates.
        Some((attribute(node, size)? - overlap_px) as usize).filter(|step| *step > 0)
    };
    let steps = |node: Node| Some([step(node, "ncols", "OVERLAP_COL")?, step(node, "nrows", "OVERLAP_ROW")?]);
    (!images.is_empty()).then(|| DataFiles {
        images,
        step_px: find(root, "NTILES_SIZE").and_then(steps),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_dimap_lists_its_tiles_and_how_far_apart_they_are() {
        let file = |row: u32, col: u32, name: &str| {
            format!("<Data_File tile_R=\"{row}\" tile_C=\"{col}\"><DATA_FILE_PATH href=\"{name}\"/></Data_File>")
        };
        let text = format!(
            "<?xml version=\"1.0\"?><Dimap_Document><Raster_Data><Data_Access><Data_Files>{}{}</Data_Files></Data_Access><Raster_Dimensions>\
             <Tile_Set><NTILES>2</NTILES><Regular_Tiling><NTILES_SIZE nrows=\"4096\" ncols=\"2048\"/><OVERLAP_ROW>96</OVERLAP_ROW>\
             <OVERLAP_COL>0</OVERLAP_COL></Regular_Tiling></Tile_Set></Raster_Dimensions></Raster_Data></Dimap_Document>",
            file(1, 1, "north.jp2"),
            file(2, 1, "south.jp2"),
        );
        let found = data_files(&text).expect("two files");
        assert_eq!(found.step_px, Some([2048, 4000]));
        assert_eq!(found.images.len(), 1);
        assert_eq!(found.images[0][1].tile, [2, 1]);
        assert_eq!(found.images[0][1].href, "south.jp2");
        assert_eq!(data_files("<isd/>"), None);
        assert_eq!(data_files("<Dimap_Document/>"), None);
    }
}
