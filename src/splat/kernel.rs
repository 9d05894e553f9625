//! The inner loops: one tile, front to back, forward and backward, any number of channels.
//!
//! Plain loops over eight pixels of a row, compiled for several instruction sets and chosen at run time. They use
//! `a*b + c` without contraction, so every instruction set gives the same bits. The backward pass goes front to back
//! too and repeats the forward arithmetic exactly, so it needs no saved transmittance: with `G = Σ_j w_j d_j`, `d_j`
//! the product of splat j's values with the pixel's gradients, `∂L/∂α_i = T_i d_i - (G - Σ_{j≤i} w_j d_j) / (1 - α_i)`.
//!
//! Splats are small, so the overhead around the arithmetic matters. Splats are loaded in batches, whose cache misses
//! overlap; the eight pixels begin where the ellipse begins in a row, not at a multiple of eight, and may reach past
//! the tile into columns whose transmittance is zero; all groups of pixels of a splat are listed first, eight rows at
//! once, and then worked through.
//!
//! `tile` holds the planes of a tile, `footprint` the pixels and alphas of a splat, `forward` and `backward` the two
//! passes.

mod backward;
mod footprint;
mod forward;
mod tile;

pub use backward::backward;
pub use footprint::exp2;
pub use forward::forward;
pub use tile::{GEOMETRY, PLANE, STRIDE, TileFrame, TileGradients, TileMaps};
