//! Writes a pair of images of a town: `town FOLDER SIZE_PX [LONGITUDE LATITUDE]` (docs/lab/streaming.md).

use heliosplat_tests::town::Pair;

fn main() {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let number = |index: usize| words.get(index).and_then(|word| word.parse::<f64>().ok());
    let (Some(folder), Some(size_px)) = (words.first(), number(1)) else {
        eprintln!("town FOLDER SIZE_PX [LONGITUDE LATITUDE]");
        std::process::exit(2);
    };
    let centre_deg = [number(2).unwrap_or(36.91), number(3).unwrap_or(37.58)];
    Pair::new(size_px as usize, centre_deg).write(folder.as_ref());
}
