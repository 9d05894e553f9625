//! One tile of the image: planes of accumulated values and of gradients, read and written eight pixels at a time.

use crate::splat::bins::{TILE_HEIGHT, TILE_WIDTH};

/// Number of pixels processed together.
pub(super) const LANES: usize = 8;
/// Distance between the rows of a tile in memory: its pixels, and room for eight that begin in its last column.
pub const STRIDE: usize = TILE_WIDTH + LANES;
/// Number of values of one plane of a tile.
pub const PLANE: usize = TILE_HEIGHT * STRIDE;
/// Transmittance below which a pixel is opaque: no further splat changes it.
pub(super) const T_MIN: f32 = 1e-4;
/// Transmittances at the near, the median and the far depth: those of a normal distribution at one deviation to either
/// side of its median.
pub(super) const QUANTILES: [f32; 3] = [0.84, 0.5, 0.16];
/// Numbers besides the channels in a splat's gradient record: Σh, Σhx, Σhy, Σhx², Σhxy, Σhy², Σm, Σmx, Σmy.
pub const GEOMETRY: usize = 9;

/// Values of eight pixels of a row.
pub(super) type Lane = [f32; LANES];
/// Values of a tile, [`STRIDE`] to a row.
pub(super) type Plane = [f32; PLANE];

/// Accumulated values of one tile.
#[derive(Clone)]
pub struct TileMaps<const K: usize> {
    /// Transmittance behind the splats composited so far; zero outside the image.
    pub transmittance: Plane,
    /// Composited channels.
    pub channels: [Plane; K],
    /// Sum of depths `Σ w z`, metres.
    pub depth: Plane,
    /// Sum of squared depths `Σ w z²`, metres².
    pub depth_square: Plane,
    /// Depths where the transmittance falls through 0.84, 0.5 and 0.16, metres; the depth of the last splat seen if it
    /// never does, zero if no splat is seen.
    pub depth_quantiles: [Plane; 3],
    /// Number of (splat, pixel) pairs inside the footprints.
    pub pairs: u64,
}

impl<const K: usize> TileMaps<K> {
    /// Maps of a tile, on the heap.
    pub fn boxed() -> Box<Self> {
        Box::new(Self {
            transmittance: [0.0; PLANE],
            channels: [[0.0; PLANE]; K],
            depth: [0.0; PLANE],
            depth_square: [0.0; PLANE],
            depth_quantiles: [[0.0; PLANE]; 3],
            pairs: 0,
        })
    }

    /// Empties the tile, but keeps the count of pairs; `depths` empties the planes of the other depths too.
    pub(super) fn clear(&mut self, frame: &TileFrame, depths: bool) {
        frame.reset_transmittance(&mut self.transmittance);
        self.channels.fill([0.0; PLANE]);
        self.depth.fill(0.0);
        if depths {
            self.depth_square.fill(0.0);
            self.depth_quantiles.fill([0.0; PLANE]);
        }
    }
}

/// Gradients of a loss to the maps of one tile; zero outside the image.
#[derive(Clone)]
pub struct TileGradients<const K: usize> {
    /// Gradients to the composited channels.
    pub channels: [Plane; K],
    /// Gradient to the accumulated alpha `Σ w`.
    pub alpha: Plane,
    /// Gradient to `Σ w z`.
    pub depth: Plane,
    /// `Σ_j w_j d_j`: sum of the maps' values times these gradients.
    pub total: Plane,
}

impl<const K: usize> TileGradients<K> {
    /// Gradients of a tile, all zero, on the heap.
    pub fn boxed() -> Box<Self> {
        Box::new(Self {
            channels: [[0.0; PLANE]; K],
            alpha: [0.0; PLANE],
            depth: [0.0; PLANE],
            total: [0.0; PLANE],
        })
    }
}

/// Position of a tile in the image, and its size inside it.
#[derive(Clone, Copy)]
pub struct TileFrame {
    /// First column, pixels.
    pub col0: f32,
    /// First row, pixels.
    pub row0: f32,
    /// Number of columns inside the image.
    pub width: usize,
    /// Number of rows inside the image.
    pub height: usize,
}

impl TileFrame {
    /// Fills `plane` with the transmittance before the first splat: one in the image, zero outside, where no splat adds
    /// anything then.
    pub(super) fn reset_transmittance(&self, plane: &mut Plane) {
        for (number, row) in plane.chunks_exact_mut(STRIDE).enumerate() {
            let width = if number < self.height { self.width } else { 0 };
            row[..width].fill(1.0);
            row[width..].fill(0.0);
        }
    }
}

/// Reads the eight values of a plane from place `at` on.
#[inline(always)]
pub(super) fn load(values: &Plane, at: usize) -> Lane {
    let mut lane = [0.0; LANES];
    lane.copy_from_slice(&values[at..at + LANES]);
    lane
}

/// Writes eight values of a plane from place `at` on.
#[inline(always)]
pub(super) fn store(values: &mut Plane, at: usize, lane: Lane) {
    values[at..at + LANES].copy_from_slice(&lane);
}

/// True if every pixel of the tile is opaque.
#[inline(always)]
pub(super) fn is_opaque(transmittance: &Plane) -> bool {
    let mut highest = [0.0f32; LANES];
    for lane in transmittance.chunks_exact(LANES) {
        for l in 0..LANES {
            highest[l] = most(lane[l], highest[l]);
        }
    }
    highest.iter().all(|&t| t < T_MIN)
}

/// The lesser, `b` where `a` is not a number; unlike `f32::min` one instruction.
#[inline(always)]
pub(super) fn least(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}

/// The greater, `b` where `a` is not a number.
#[inline(always)]
pub(super) fn most(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}
