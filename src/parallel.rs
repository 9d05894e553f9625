//! New memory, initialised on all threads: the first write to a page is expensive, since the system clears the page
//! then.

use rayon::prelude::*;

/// Values per parallel job, at least.
const CHUNK: usize = 4096;

/// A vector of `count` default values.
pub(crate) fn defaults<T: Default + Send>(count: usize) -> Vec<T> {
    let mut values = Vec::new();
    set_defaults(&mut values, count);
    values
}

/// Replaces the contents of `values` by `count` default values and reuses its memory.
pub(crate) fn set_defaults<T: Default + Send>(values: &mut Vec<T>, count: usize) {
    let numbers = (0..count).into_par_iter().with_min_len(CHUNK);
    numbers.map(|_| T::default()).collect_into_vec(values);
}
