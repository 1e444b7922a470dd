//! Work outside the GIL that Ctrl-C ends.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Condvar, Mutex, PoisonError};
use std::time::Duration;

use pyo3::prelude::*;

use wavex::engine::Cancel;

use crate::errors;

/// Time between two looks for signals.
pub const SIGNALS: Duration = Duration::from_millis(50);

/// Runs `work` on a thread of its own; the GIL is free meanwhile.
///
/// `look` is called every 50 ms with the GIL. A signal, such as Ctrl-C, or an error of `look` sets
/// `cancel`; the work then ends, and the error is returned.
pub fn interruptible<T: Send>(
    py: Python<'_>,
    cancel: &Cancel,
    mut look: impl FnMut(Python<'_>) -> PyResult<()>,
    work: impl FnOnce() -> T + Send,
) -> PyResult<T> {
    let done: Done<T> = (Mutex::new(None), Condvar::new());
    std::thread::scope(|scope| {
        let done = &done;
        let body = move || {
            // A panic is a result, too: without one, the caller would wait for ever.
            let result = catch_unwind(AssertUnwindSafe(work));
            *done.0.lock().unwrap_or_else(PoisonError::into_inner) = Some(result);
            done.1.notify_all();
        };
        let name = "wavex:python".to_owned();
        std::thread::Builder::new().name(name).spawn_scoped(scope, body).map_err(|error| {
            errors::data(format!("cannot start a thread: {error}"), "raise the process limit of the system")
        })?;
        loop {
            match py.detach(|| within(done, SIGNALS)) {
                Some(Ok(result)) => return Ok(result),
                Some(Err(_)) => {
                    return Err(errors::data("a thread of wavex failed", "please report this bug in wavex"));
                }
                None => {
                    if let Err(error) = py.check_signals().and_then(|()| look(py)) {
                        cancel.cancel();
                        // What the interrupted work returns does not matter.
                        py.detach(|| while within(done, SIGNALS).is_none() {});
                        return Err(error);
                    }
                }
            }
        }
    })
}

/// Result of a thread, and the signal that it is there.
type Done<T> = (Mutex<Option<std::thread::Result<T>>>, Condvar);

/// Takes the result, if it is there within this time.
fn within<T>(done: &Done<T>, time: Duration) -> Option<std::thread::Result<T>> {
    let result = done.0.lock().unwrap_or_else(PoisonError::into_inner);
    let waited = done.1.wait_timeout_while(result, time, |result| result.is_none());
    waited.unwrap_or_else(PoisonError::into_inner).0.take()
}
