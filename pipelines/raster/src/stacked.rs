//! An image whose bands are in several files, read as one.

use super::file::{Composite, RasterFile};
use super::{RasterError, Result, Window};

impl RasterFile {
    /// Files of equal size as one image with the bands of all; path and metadata are those of the first.
    ///
    /// # Errors
    /// [`RasterError::NotAnImage`] when their sizes differ, `RasterError::Gdal` without files.
    pub fn stacked(files: Vec<Self>) -> Result<Self> {
        let Some(first) = files.first() else {
            return Err(RasterError::Gdal("an image of no files".to_owned()));
        };
        if let Some(other) = files.iter().find(|file| file.size() != first.size()) {
            let reason = format!(
                "its size is not that of {}, whose other bands it has",
                first.path().display()
            );
            return Err(RasterError::NotAnImage(other.path().to_owned(), reason));
        }
        let (path, size) = (first.path().to_owned(), first.size());
        let others = files[1..].iter().flat_map(Self::files).cloned().collect();
        let bands = files.iter().flat_map(|file| file.bands.clone()).collect();
        Ok(Self::composed(path, others, size, bands, Stack(files)))
    }
}

/// Files of equal size, at least one, in the order of their bands.
struct Stack(Vec<RasterFile>);

impl Composite for Stack {
    fn first(&self) -> &RasterFile {
        &self.0[0]
    }

    /// Bands of separate files have no opacity.
    fn set_opacity(&mut self, _band: Option<usize>) {}

    fn read(&self, window: Window, bands: &[usize]) -> Result<Vec<f32>> {
        let mut values = Vec::with_capacity(window.width * window.height * bands.len());
        let places = || {
            let files = self.0.iter();
            files.flat_map(|file| (0..file.bands.len()).map(move |place| (file, place)))
        };
        for (file, place) in bands.iter().filter_map(|band| places().nth(*band)) {
            values.extend(file.read_part(window, &[place])?);
        }
        Ok(values)
    }
}
