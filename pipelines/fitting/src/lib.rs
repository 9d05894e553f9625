//! The loop around a trainer, whatever the model: settings in layers, a budget of time, checkpoints, and the folder of a run.
//!
//! A pipeline resolves its [`settings`], is given a [`request`], opens a [`run_folder`], and hands its trainer to [`training::train`], which takes steps until
//! the model, the user or the budget says that it is enough, and keeps a [`checkpoint`] on the way. Nothing here knows satellites or
//! objects.

pub mod budget;
pub mod checkpoint;
pub mod curve;
pub mod lock;
pub mod program;
pub mod request;
pub mod run_folder;
pub mod settings;
pub mod training;
