//! The engine: Gaussians that are rasterised, lit, shaded and optimised, on the CPU, differentiable from pixels to
//! parameters.
//!
//! It depends on no files, coordinate systems or command line. Lengths are metres (or scene units, for objects) from
//! the scene's centre, angles are radians, pixel centres are at integers.
//!
//! # Map, in the order data flows
//!
//! | module | content |
//! |---|---|
//! | [`gaussians`] | the parameter table: positions, log scales, rotations, opacities, and the groups a model adds |
//! | [`camera`], [`light`], [`raster`] | projective camera, directional or point light, small planar image |
//! | [`splat`] | Gaussians to splats, splats to tiles, tiles to composited maps; backward of each |
//! | [`trace`] | transmittance from every Gaussian toward the light; backward to occluders and origins |
//! | [`shade`] | shading formulas with their gradients |
//! | [`model`] | trait of a scene model, and its implementations: rasterised channels and their composition to pixels |
//! | [`render`] | one pass: project, trace, features, rasterise, compose; and its backward pass |
//! | [`loss`] | photometric, geometric and shadow losses on images and maps; smoothness between neighbours |
//! | [`optim`] | Adam, learning rates of parameter groups, density control |
//! | [`train`] | the trainer: one view a step, losses, update, density control, early stopping, resumable state |
//! | [`simd`], [`fast`] | instruction sets chosen at run time; exponential and logarithm that vectorise |
//! | [`timeline`] | wall and processor seconds of the stages of a run |
//! | [`bench_fixture`] | a standard site for benchmarks |
//!
//! Data goes down this list once; gradients retrace the same functions in reverse and are next to them in the code.
//!
//! # Invariants
//!
//! *Same bytes.* The same inputs, options and seed give the same bytes for any number of threads and any instruction
//! set. Parallel loops write to disjoint places; reductions have a fixed order, by chunks whose size is a constant;
//! kernels evaluate `a * b + c` without contraction; nothing calls a transcendental function of the platform inside a
//! vectorised loop.
//!
//! *No number is lost.* A training step with a loss or gradient that is not finite changes nothing; Gaussians with such
//! numbers are left out of a view and counted.
//!
//! *Unused parts cost nothing.* Channel counts are compiled constants, and a part of a model that the options leave out
//! has no parameters.
//!
//! # Why so much is written by hand
//!
//! Adam, the multilayer perceptron, spherical harmonics, the exponential and the SSIM window are here and not from
//! crates because of the first invariant: crates for linear algebra and neural networks choose block sizes, contraction
//! and the order of sums by thread count and processor, and promise no equal bits across instruction sets. Parts whose
//! result does not depend on such choices do come from crates: the bounding volume hierarchy (`obvhs`), random numbers
//! (`rand_pcg`), vectors (`glam`), threads (`rayon`).

pub mod bench_fixture;
mod binning;
pub mod camera;
pub mod fast;
pub mod gaussians;
pub mod light;
pub mod loss;
pub mod model;
pub mod optim;
mod parallel;
pub mod raster;
pub mod render;
pub mod shade;
pub mod simd;
pub mod splat;
pub mod timeline;
pub mod trace;
pub mod train;

pub use camera::ProjectiveCamera;
pub use raster::Raster;
