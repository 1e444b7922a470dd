//! Threads for tasks within a stage, such as the compression of points.

use std::sync::Arc;

use rayon::{ThreadPool, ThreadPoolBuilder};

use super::failure::THREAD_PREFIX;
use super::{Options, RunError};
use crate::stage::StageError;

/// Starts one thread per worker; `None` with one worker: stages do such tasks themselves.
///
/// # Errors
/// If the system refuses a thread.
pub(super) fn start(options: &Options) -> Result<Option<Arc<ThreadPool>>, RunError> {
    if options.workers() < 2 {
        return Ok(None);
    }
    let pool = ThreadPoolBuilder::new()
        .num_threads(options.workers())
        .thread_name(|index| format!("{THREAD_PREFIX}pool-{index}"))
        // The stage that waits for the result of the task reports the panic.
        .panic_handler(|_| {})
        .build();
    match pool {
        Ok(pool) => Ok(Some(Arc::new(pool))),
        Err(error) => Err(RunError::of_job(StageError::failed(
            format!("cannot start a thread: {error}"),
            "lower `threads` or raise the process limit of the system",
        ))),
    }
}
