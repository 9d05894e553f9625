//! Sampling a plane of pixels along a line of the ground: project, then interpolate.
//!
//! This is the inner loop of matching, so points are projected eight at a time and values are interpolated from the
//! four pixels around. A camera's three forms are linear in the ground point, so along a line of cells each of them
//! grows by a constant.

use heliosplat::fast::floor;
use heliosplat::vectorised;

/// Points of the ground at equal distances in a camera's three forms: the column of point k is
/// `(u + k du) / (w + k dw)`, the row likewise with v.
pub(super) struct Line {
    /// The forms u, v, w at the first point.
    pub(super) start: [f32; 3],
    /// Their change from one point to the next.
    pub(super) step: [f32; 3],
}

/// Positions in an image, each between four pixels.
#[derive(Debug, Clone, Default)]
pub(super) struct Places {
    /// Index of the upper left of the four pixels.
    index: Vec<u32>,
    /// Fraction of the column; NaN outside the image.
    across: Vec<f32>,
    /// Fraction of the row.
    down: Vec<f32>,
    /// Index of the pixel nearest to each position; 0 outside the image.
    pub(super) nearest: Vec<u32>,
}

impl Places {
    /// Room for `count` positions and for the rest of a last group of [`POINTS`].
    pub(super) fn new(count: usize) -> Self {
        let room = count + POINTS;
        Self {
            index: vec![0; room],
            across: vec![0.0; room],
            down: vec![0.0; room],
            nearest: vec![0; room],
        }
    }

    /// Sets the positions from `at` on.
    #[inline(always)]
    fn set(&mut self, at: usize, (index, across, down, nearest): Lanes) {
        debug_assert!(at + POINTS <= self.index.len(), "no room for whole groups of places");
        let lists = (
            self.index[at..].first_chunk_mut(),
            self.across[at..].first_chunk_mut(),
            self.down[at..].first_chunk_mut(),
            self.nearest[at..].first_chunk_mut(),
        );
        if let (Some(i), Some(a), Some(d), Some(n)) = lists {
            (*i, *a, *d, *n) = (index, across, down, nearest);
        }
    }
}

/// Indices, fractions of columns and rows, and nearest pixels of some positions.
type Lanes = ([u32; POINTS], [f32; POINTS], [f32; POINTS], [u32; POINTS]);

vectorised! {
    /// Projects `count` points of a line into an image of `width × height` pixels, into `places` from `start` on. A few
    /// places behind the last one are overwritten, so lines must be processed in the order of their places.
    pub(super) fn find(line: &Line, width: usize, height: usize, start: usize, count: usize, places: &mut Places) {
        let (columns, rows) = ((width - 1) as f32, (height - 1) as f32);
        let width = width as u32;
        for first in (0..count).step_by(POINTS) {
            let (mut index, mut across, mut down, mut nearest): Lanes = Default::default();
            for l in 0..POINTS {
                let k = first as f32 + l as f32;
                let inverse = 1.0 / (line.start[2] + k * line.step[2]);
                let col = (line.start[0] + k * line.step[0]) * inverse;
                let row = (line.start[1] + k * line.step[1]) * inverse;
                // Written so that a NaN position is outside too.
                let inside = (col >= 0.0) & (row >= 0.0) & (col < columns) & (row < rows);
                let (col, row) = if inside { (col, row) } else { (0.0, 0.0) };
                let (c, r) = (floor(col), floor(row));
                index[l] = r.1 * width + c.1;
                across[l] = if inside { col - c.0 } else { f32::NAN };
                down[l] = row - r.0;
                let further = if down[l] >= 0.5 { width } else { 0 };
                nearest[l] = index[l] + further + u32::from(across[l] >= 0.5);
            }
            places.set(start + first, (index, across, down, nearest));
        }
    }
}

/// Points that are processed together: a register of AVX2 has eight lanes.
pub(super) const POINTS: usize = 8;

vectorised! {
    // With AVX-512 the compiler makes gathers, which are a third as fast as loads (docs/lab/speed.md).
    up to Avx2;
    /// Bilinear values of a plane at the first `count` places; NaN outside the image and next to missing pixels. `out`
    /// has room for [`POINTS`] more.
    pub(super) fn bilinear(pixels: &[f32], width: usize, places: &Places, count: usize, out: &mut [f32]) {
        for at in (0..count).step_by(POINTS) {
            let lists = (
                places.index[at..].first_chunk::<POINTS>(),
                places.across[at..].first_chunk::<POINTS>(),
                places.down[at..].first_chunk::<POINTS>(),
                out[at..].first_chunk_mut::<POINTS>(),
            );
            let (Some(index), Some(across), Some(down), Some(out)) = lists else {
                debug_assert!(false, "no room for whole groups of places");
                return;
            };
            // All corners of the existing places, so that one check of an index covers all four.
            let reached = index.iter().fold(0, |most, &i| if i > most { i } else { most }) as usize + 1;
            let corner = |step: usize| pixels.get(step..step + reached);
            let (Some(upper), Some(upper_right), Some(lower), Some(lower_right)) =
                (corner(0), corner(1), corner(width), corner(width + 1))
            else {
                // Entries behind the last place may stem from a larger image, and an image may be too small for any
                // place.
                for l in 0..POINTS {
                    let pixel = |step: usize| pixels.get(index[l] as usize + step).copied().unwrap_or(f32::NAN);
                    let top = pixel(0) + (pixel(1) - pixel(0)) * across[l];
                    let bottom = pixel(width) + (pixel(width + 1) - pixel(width)) * across[l];
                    out[l] = top + (bottom - top) * down[l];
                }
                continue;
            };
            let (mut a, mut b, mut c, mut d) = ([0.0; POINTS], [0.0; POINTS], [0.0; POINTS], [0.0; POINTS]);
            for l in 0..POINTS {
                let i = index[l] as usize;
                (a[l], b[l], c[l], d[l]) = (upper[i], upper_right[i], lower[i], lower_right[i]);
            }
            for l in 0..POINTS {
                let top = a[l] + (b[l] - a[l]) * across[l];
                let bottom = c[l] + (d[l] - c[l]) * across[l];
                out[l] = top + (bottom - top) * down[l];
            }
        }
    }
}

/// Weights of four neighbours at a fraction of the way from the second to the third: the cubic of Catmull and Rom
/// (1974), which keeps more detail than linear interpolation and treats all fractions more alike.
pub(super) fn cubic_weights(t: f32) -> [f32; 4] {
    let (t2, t3) = (t * t, t * t * t);
    [
        0.5 * (-t3 + 2.0 * t2 - t),
        0.5 * (3.0 * t3 - 5.0 * t2 + 2.0),
        0.5 * (-3.0 * t3 + 4.0 * t2 + t),
        0.5 * (t3 - t2),
    ]
}
