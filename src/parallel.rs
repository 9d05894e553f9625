//! Memory written on all threads: the first write to a page is what costs, and one thread would do it for all.

use rayon::prelude::*;

/// Values per parallel job, at least.
const CHUNK: usize = 4096;

/// So many default values.
pub(crate) fn defaults<T: Default + Send>(count: usize) -> Vec<T> {
    let mut values = Vec::new();
    set_defaults(&mut values, count);
    values
}

/// So many default values in place of what `values` holds; its memory is used again.
pub(crate) fn set_defaults<T: Default + Send>(values: &mut Vec<T>, count: usize) {
    let numbers = (0..count).into_par_iter().with_min_len(CHUNK);
    numbers.map(|_| T::default()).collect_into_vec(values);
}
