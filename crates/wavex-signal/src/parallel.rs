//! Work shared by the threads of a `rayon` pool.

use rayon::iter::ParallelIterator;
use rayon::slice::ParallelSlice;

/// Maps consecutive parts of a list; in parallel if called from a thread of a `rayon` pool.
///
/// Parts have `length` items, the last one possibly fewer. Neither they nor the order of the results
/// depend on the number of threads.
pub(crate) fn map_parts<T: Sync, R: Send>(
    items: &[T],
    length: usize,
    map: impl Fn(&[T]) -> R + Sync + Send,
) -> Vec<R> {
    let length = length.max(1);
    match rayon::current_thread_index() {
        Some(_) => items.par_chunks(length).map(map).collect(),
        None => items.chunks(length).map(map).collect(),
    }
}
