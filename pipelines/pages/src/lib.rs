//! HTML pages, each one file that loads nothing from the network.
//!
//! [`report`] and [`view`] show a run or the mosaic of a batch, [`summary`] the units of a batch. [`page`] holds the
//! document, the stylesheet and the charts of all. The crate neither trains nor parses arguments.

pub mod page;
pub mod report;
pub mod summary;
pub mod view;
