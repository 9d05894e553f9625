//! Surface models of tiles on disk, read row by row while they are blended.

use crate::blend::{Piece, blend};
use heliosplat::Raster;
use heliosplat_raster::RasterError;
use std::fs::File;
use std::io::{BufWriter, Read, Seek, SeekFrom, Write};
use std::ops::Range;
use std::path::PathBuf;

/// Bytes of a value.
const VALUE: usize = size_of::<f32>();

/// A tile's surface model in a file, one band after the other.
pub struct StoredPiece {
    file: PathBuf,
    /// The piece without its values.
    outline: Piece,
}

impl StoredPiece {
    /// Writes the values of `piece` to `file` and keeps the rest of it in memory.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn write(mut piece: Piece, file: PathBuf) -> Result<Self, RasterError> {
        let values = std::mem::take(&mut piece.raster.values);
        let write = || {
            let mut out = BufWriter::new(File::create(&file)?);
            for value in values {
                out.write_all(&value.to_le_bytes())?;
            }
            out.flush()
        };
        write().map_err(|error| RasterError::from_io(&file, &error))?;
        Ok(Self { file, outline: piece })
    }

    /// Part of the piece in some rows of the mosaic, with row numbers from the first of them; `None` where there is
    /// none.
    fn rows(&self, rows: &Range<isize>) -> Result<Option<Piece>, RasterError> {
        let piece = &self.outline;
        let (raster, at, core, bounds) = (&piece.raster, piece.at, piece.core, piece.bounds);
        let (first, end) = (rows.start.max(at[1]), rows.end.min(at[1] + raster.height as isize));
        if first >= end {
            return Ok(None);
        }
        let mut part = Raster::filled(raster.width, (end - first) as usize, raster.bands, f32::NAN);
        let mut read = || {
            let mut file = File::open(&self.file)?;
            let mut bytes = vec![0; part.plane_len() * VALUE];
            for band in 0..raster.bands {
                let before = (band * raster.height + (first - at[1]) as usize) * raster.width;
                file.seek(SeekFrom::Start((before * VALUE) as u64))?;
                file.read_exact(&mut bytes)?;
                for (value, bytes) in part.plane_mut(band).iter_mut().zip(bytes.as_chunks::<VALUE>().0) {
                    *value = f32::from_le_bytes(*bytes);
                }
            }
            Ok(())
        };
        read().map_err(|error: std::io::Error| RasterError::Damaged(self.file.clone(), error.to_string()))?;
        let moved = |span: &[isize; 2]| span.map(|row| row - rows.start);
        Ok(Some(Piece {
            unit: self.outline.unit.clone(),
            raster: part,
            at: [at[0], first - rows.start],
            core: [core[0], moved(&core[1])],
            bounds: [bounds[0], moved(&bounds[1])],
        }))
    }
}

/// Rows of the mosaic, `width` cells of `gsd_m` metres wide, as [`blend`] merges them from all pieces.
///
/// # Errors
/// When a piece cannot be read again.
pub fn blend_rows(pieces: &[StoredPiece], width: usize, rows: Range<usize>, gsd_m: f32) -> Result<Raster, RasterError> {
    let wanted = rows.start as isize..rows.end as isize;
    let mut here = Vec::new();
    for piece in pieces {
        here.extend(piece.rows(&wanted)?);
    }
    Ok(blend(&here, (width, rows.len()), gsd_m))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::blend::BANDS;

    #[test]
    fn rows_blended_in_turn_are_those_blended_at_once() {
        let piece = |at: [isize; 2], core: [[isize; 2]; 2], bounds: [[isize; 2]; 2], unit: &str| {
            let (width, height) = (bounds[0][1] - at[0], bounds[1][1] - at[1]);
            let mut raster = Raster::filled(width as usize, height as usize, BANDS, 0.3);
            let rise = at[0] as f32 * 0.01;
            let altitude = raster.plane_mut(0).iter_mut().enumerate();
            altitude.for_each(|(i, z)| {
                *z = if i % 37 == 5 {
                    f32::NAN
                } else {
                    50.0 + rise + (i % 7) as f32 * 0.1
                }
            });
            Piece {
                unit: unit.into(),
                raster,
                at,
                core,
                bounds,
            }
        };
        let pieces = || {
            vec![
                piece([0, 0], [[0, 20], [0, 20]], [[0, 26], [0, 26]], "a"),
                piece([14, 0], [[20, 40], [0, 20]], [[14, 40], [0, 26]], "b"),
                piece([0, 14], [[0, 20], [20, 40]], [[0, 26], [14, 40]], "c"),
                piece([14, 14], [[20, 40], [20, 40]], [[14, 40], [14, 40]], "d"),
            ]
        };
        let whole = blend(&pieces(), (40, 40), 0.5);
        let folder = tempfile::tempdir().expect("a temporary folder");
        let stored: Vec<StoredPiece> = pieces()
            .into_iter()
            .map(|piece| {
                let file = folder.path().join(&piece.unit);
                StoredPiece::write(piece, file).expect("written")
            })
            .collect();
        for first in (0..40).step_by(7) {
            let end = (first + 7).min(40);
            let rows = blend_rows(&stored, 40, first..end, 0.5).expect("read");
            for band in 0..BANDS {
                let expected = &whole.plane(band)[first * 40..end * 40];
                let same = rows.plane(band).iter().zip(expected);
                assert!(
                    same.into_iter().all(|(a, b)| a.to_bits() == b.to_bits()),
                    "rows from {first}"
                );
            }
        }
    }
}
