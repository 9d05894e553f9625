//! Files that other programs read, as bytes: splats and meshes as PLY, glTF, SPZ and 3D Tiles.
//!
//! [`splats`] has the common type of all writers of splats. [`glb`] frames glTF, [`ply`] frames tables of floats,
//! [`spz`] packs splats, [`merge`] merges splats into coarser ones, and [`tiles`] cuts them into a tree of tiles.
//! Nothing here opens a file or depends on a model.

pub mod glb;
pub mod merge;
pub mod mesh;
pub mod ply;
pub mod splat_ply;
pub mod splats;
pub mod spz;
pub mod tiles;
