//! Pages for people, each one file that fetches nothing.
//!
//! [`report`] and [`view`] show a run or the mosaic of a batch, [`summary`] the units of a
//! batch. [`page`] holds the document, the stylesheet and the charts of all. Nothing here trains or knows of arguments.

pub mod page;
pub mod report;
pub mod summary;
pub mod view;
