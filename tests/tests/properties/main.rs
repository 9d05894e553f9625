//! Properties under any legal input: finite numbers, no panic, physically possible values, the same result as the slow
//! reference where that is affordable, the same bytes for any number of threads.
//!
//! A run is the same every time. `HELIOSPLAT_PROPERTY_FACTOR=20` draws twenty times as many cases,
//! `HELIOSPLAT_PROPERTY_SEED=7` others.

mod draw;
mod earth;
mod extremes;
mod images;
mod light;
mod numbers;
mod surfaces;
mod view;

use proptest::test_runner::{Config, RngSeed};

/// Least number of cases of every property.
const CASES: [(&str, u32); 16] = [
    ("numbers", 2000),
    ("rates", 500),
    ("light_bounds", 2500),
    ("light_reference", 2000),
    ("light_threads", 200),
    ("view_bounds", 2000),
    ("view_reference", 700),
    ("view_threads", 200),
    ("view_strips", 30),
    ("photometric", 1500),
    ("map_losses", 600),
    ("frames", 2500),
    ("cameras", 150),
    ("suns", 1500),
    ("microfacets", 1000),
    ("objects", 1200),
];

fn from_environment(name: &str, otherwise: u64) -> u64 {
    match std::env::var(name) {
        Ok(text) => text
            .parse()
            .unwrap_or_else(|_| panic!("{name}={text} is no whole number")),
        Err(_) => otherwise,
    }
}

/// The configuration of a property.
fn config(property: &str) -> Config {
    let cases = CASES
        .iter()
        .find(|(name, _)| *name == property)
        .expect("a known property")
        .1;
    let factor = from_environment("HELIOSPLAT_PROPERTY_FACTOR", 1);
    Config {
        cases: cases.saturating_mul(u32::try_from(factor).unwrap_or(u32::MAX)),
        rng_seed: RngSeed::Fixed(from_environment("HELIOSPLAT_PROPERTY_SEED", 6)),
        // Failing cases become tests of their own.
        failure_persistence: None,
        max_shrink_iters: 2000,
        ..Config::default()
    }
}

#[test]
fn ten_thousand_cases_are_drawn() {
    assert!(CASES.iter().map(|(_, cases)| cases).sum::<u32>() >= 10_000);
}
