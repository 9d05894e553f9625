//! Sampling a plane of pixels along a line of the ground: project, then interpolate.
//!
//! This is the inner loop of matching, so points are projected eight at a time and values are interpolated from the four pixels around.
//! A camera's three forms are linear in the ground point, so along a line of cells each of them grows by a constant.

use heliosplat::fast::floor;
use heliosplat::vectorised;

/// Points of the ground at equal distances in a camera's three forms: the column of point k is `(u + k du) / (w + k dw)`, the row
/// likewise with v.
pub(super) struct Line {
    /// The forms u, v, w at the first point.
    pub(super) start: [f32; 3],
    /// Their change from one point to the next.
    pub(super) step: [f32; 3],
}

/// A position in an image between four pixels.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Place {
    /// The upper left of four pixels.
    index: u32,
    /// Fractions of the column and of the row; NaN outside the image.
    fraction: [f32; 2],
}

impl Place {
    /// The pixel nearest to it, in an image of this width; the first one where it lies outside of the image.
    #[inline(always)]
    pub(super) fn nearest(&self, width: usize) -> usize {
        let further = |fraction: f32, step: usize| if fraction >= 0.5 { step } else { 0 };
        self.index as usize + further(self.fraction[0], 1) + further(self.fraction[1], width)
    }
}

vectorised! {
    /// Projects the points of a line into an image of `width × height` pixels.
    pub(super) fn find(line: &Line, width: usize, height: usize, places: &mut [Place]) {
        let (columns, rows) = ((width - 1) as f32, (height - 1) as f32);
        for (number, places) in places.chunks_mut(POINTS).enumerate() {
            let first = (number * POINTS) as f32;
            let (mut index, mut across, mut down) = ([0u32; POINTS], [0.0f32; POINTS], [0.0f32; POINTS]);
            for l in 0..POINTS {
                let k = first + l as f32;
                let inverse = 1.0 / (line.start[2] + k * line.step[2]);
                let col = (line.start[0] + k * line.step[0]) * inverse;
                let row = (line.start[1] + k * line.step[1]) * inverse;
                // Written so that a NaN position is outside too.
                let inside = (col >= 0.0) & (row >= 0.0) & (col < columns) & (row < rows);
                let (col, row) = if inside { (col, row) } else { (0.0, 0.0) };
                let (c, r) = (floor(col), floor(row));
                index[l] = r.1 * width as u32 + c.1;
                across[l] = if inside { col - c.0 } else { f32::NAN };
                down[l] = row - r.0;
            }
            for (l, place) in places.iter_mut().enumerate() {
                *place = Place {
                    index: index[l],
                    fraction: [across[l], down[l]],
                };
            }
        }
    }
}

/// Points that are projected together: a register of AVX2 holds eight.
const POINTS: usize = 8;

/// Bilinear values of a plane at positions; NaN outside the image and beside missing pixels.
pub(super) fn bilinear(pixels: &[f32], width: usize, places: &[Place], out: &mut [f32]) {
    for (place, value) in places.iter().zip(out) {
        let i = place.index as usize;
        // Two pixels of two rows; a place beyond the image has the index of the first and no weight.
        let (Some(&[a, b]), Some(&[c, d])) = (pixels[i..].first_chunk::<2>(), pixels[i + width..].first_chunk::<2>())
        else {
            *value = f32::NAN;
            continue;
        };
        let top = a + (b - a) * place.fraction[0];
        let bottom = c + (d - c) * place.fraction[0];
        *value = top + (bottom - top) * place.fraction[1];
    }
}

/// Weights of four neighbours at a fraction of the way from the second to the third: the cubic of Catmull and Rom (1974), which keeps
/// more detail than linear interpolation and treats all fractions more alike.
pub(super) fn cubic_weights(t: f32) -> [f32; 4] {
    let (t2, t3) = (t * t, t * t * t);
    [
        0.5 * (-t3 + 2.0 * t2 - t),
        0.5 * (3.0 * t3 - 5.0 * t2 + 2.0),
        0.5 * (-3.0 * t3 + 4.0 * t2 + t),
        0.5 * (t3 - t2),
    ]
}
