//! Work outside the GIL that Ctrl-C ends.

use std::sync::mpsc::{RecvTimeoutError, channel};
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
    let (sender, receiver) = channel();
    // The receiver belongs to this thread, which the GIL leaves and takes again.
    let receiver = std::sync::Mutex::new(receiver);
    std::thread::scope(|scope| {
        let body = move || {
            let done = work();
            // The receiver lives until the thread has ended.
            let _ = sender.send(done);
        };
        let name = "wavex:python".to_owned();
        std::thread::Builder::new().name(name).spawn_scoped(scope, body).map_err(|error| {
            errors::data(format!("cannot start a thread: {error}"), "raise the process limit of the system")
        })?;
        let next = |time: Duration| {
            py.detach(|| receiver.lock().unwrap_or_else(|poisoned| poisoned.into_inner()).recv_timeout(time))
        };
        loop {
            match next(SIGNALS) {
                Ok(done) => return Ok(done),
                Err(RecvTimeoutError::Timeout) => {
                    if let Err(error) = py.check_signals().and_then(|()| look(py)) {
                        cancel.cancel();
                        py.detach(|| {
                            let receiver = receiver.lock().unwrap_or_else(|poisoned| poisoned.into_inner());
                            // What the interrupted work returns does not matter.
                            drop(receiver.recv());
                        });
                        return Err(error);
                    }
                }
                Err(RecvTimeoutError::Disconnected) => {
                    return Err(errors::data(
                        "a thread of wavex ended early",
                        "please report this bug in wavex",
                    ));
                }
            }
        }
    })
}
