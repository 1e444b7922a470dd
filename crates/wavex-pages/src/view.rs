//! `wavex view`: recordings, fits and points in a browser.
//!
//! The chain of a job runs over its inputs without its sinks; the points are kept in memory
//! (`points`) and shown while it runs. A file of points without waveforms is read as it is (`point_file`). A shot that the user selects is read and decomposed again
//! (`lines`, `shots`), also with other keys. The page is a few static files (`page`); the server
//! (`server`) answers only to it.

use std::sync::Arc;

use wavex_engine::engine::Cancel;

mod attributes;
mod cloud;
mod compare;
mod extent;
mod http;
mod job_text;
mod keys;
mod layers;
mod lines;
mod page;
mod placed;
mod point_file;
mod points;
mod query;
mod server;
mod session;
mod shots;

pub use session::{Opened, ParseWith};

use session::{Session, SessionState};

/// A view that is served until the process ends.
pub struct View {
    session: Arc<Session>,
    /// Address of the page, with its token.
    pub address: String,
}

/// Opens a view and serves it on this port of the loopback interface; 0 chooses a free port.
///
/// `cancel` ends the reading.
///
/// # Errors
/// If the job has no input, the port is in use, or a thread cannot be started.
pub fn open(opened: Opened, port: u16, cancel: Cancel) -> Result<View, String> {
    let session = Arc::new(Session::new(opened, cancel)?);
    let running = server::start(&session, port)?;
    let reading = Arc::clone(&session);
    let reader = std::thread::Builder::new().name("wavex view".into());
    reader
        .spawn(move || reading.read(|session, input, shot| drop(shots::shot(session, input, shot, &[]))))
        .map_err(|error| format!("cannot start a thread: {error}; close other programs"))?;
    Ok(View { session, address: running.address })
}

impl View {
    /// Status and content of the answer to a request for an address below the token.
    ///
    /// The server gives the same answer to its page.
    pub fn answer(&self, address: &str) -> (u16, Vec<u8>) {
        server::content(&self.session, address)
    }

    /// Number of points, and why reading failed; `None` while it goes on.
    pub fn ended(&self) -> Option<Result<usize, String>> {
        match self.session.state().0 {
            SessionState::Reading => None,
            SessionState::Ready => Some(Ok(self.session.points().len())),
            SessionState::Failed(problem) => Some(Err(problem)),
        }
    }
}
