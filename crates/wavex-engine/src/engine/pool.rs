//! Threads for tasks within a stage, such as the compression of points, and permits for workers.

use std::sync::Arc;

use crossbeam_channel::{Receiver, Sender};
use rayon::{ThreadPool, ThreadPoolBuilder};

use super::failure::{THREAD_PREFIX, no_thread};
use super::{Options, RunError};

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
        Err(error) => Err(no_thread(&error)),
    }
}

/// Permits to work, so that the workers of several inputs together keep no more cores busy than those
/// of one.
pub(super) struct Permits {
    free: Receiver<()>,
    back: Sender<()>,
}

/// A permit; returned when dropped.
pub(super) struct Permit<'a>(&'a Sender<()>);

impl Permits {
    pub(super) fn new(permits: usize) -> Permits {
        let (back, free) = crossbeam_channel::bounded(permits.max(1));
        for _ in 0..permits.max(1) {
            let _ = back.try_send(());
        }
        Permits { free, back }
    }

    /// Waits for a permit.
    pub(super) fn take(&self) -> Permit<'_> {
        // Cannot fail: both ends live as long as `self`.
        let _ = self.free.recv();
        Permit(&self.back)
    }
}

impl Drop for Permit<'_> {
    fn drop(&mut self) {
        let _ = self.0.try_send(());
    }
}
