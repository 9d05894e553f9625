//! The page of results: the measured runs, the values kept of each, and the tables made of them.
//!
//! Every run of the program is one [`Record`], a line of JSON in the work folder. The page is assembled from the
//! records alone, so that arenas can be measured one after another, on different days, and a table is never written by
//! hand.

mod arena;
mod bench;
mod page;
mod request;

pub use arena::{Arena, Record};
pub use page::page;
pub use request::Request;

/// Measures every run without a record, then writes the page of all records of the program.
///
/// # Errors
/// A sentence with the fault: the program cannot be run, a command fails, or a file cannot be written.
pub fn write(request: &Request) -> Result<(), String> {
    let bench = bench::Bench::new(request)?;
    let mut records = bench.records()?;
    if !request.page_only {
        for &arena in &request.arenas {
            bench.measure(arena, &mut records)?;
        }
    }
    std::fs::write(&request.out, page(&records)).map_err(|fault| format!("{}: {fault}", request.out.display()))
}
