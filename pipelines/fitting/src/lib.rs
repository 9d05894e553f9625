//! Training of any model: settings in layers, a budget of time, checkpoints, and the folder of a run.
//!
//! A pipeline resolves its [`settings`], gets a [`request`], opens a [`run_folder`], and passes its trainer to
//! [`training::train`]. The loop steps until the model has converged, the user stops it or the budget is spent, and
//! writes a [`checkpoint`] on the way. Nothing here depends on satellites or objects.

pub mod budget;
pub mod checkpoint;
pub mod curve;
pub mod lock;
pub mod program;
pub mod request;
pub mod run_folder;
pub mod settings;
pub mod training;
