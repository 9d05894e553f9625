//! Common parts of the end-to-end tests: a slow, obvious f64 reference of the engine's forward pass, small scenes and
//! captures, readers to fuzz, and the program itself.

pub mod account;
pub mod canvas;
pub mod capture;
pub mod harmonics;
pub mod measured;
pub mod mutate;
pub mod program;
pub mod readers;
pub mod reference;
pub mod results;
pub mod scene_fuzz;
pub mod scenes;
pub mod shared;
pub mod terrain;
pub mod town;
