//! Runs a chain on its own threads and hands out its results one by one.

use std::fmt;
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::Duration;

use crossbeam_channel::{Receiver, RecvTimeoutError, Sender};

use super::failure::{THREAD_PREFIX, guarded, no_thread};
use super::observe::run_one;
use super::{Cancel, Input, InputSummary, Options, RunError};
use crate::job::Job;
use wavex_line::scan_line::{Kind, ScanLine};
use wavex_line::stage::{Context, Plan, Result, RoleName, RunContext, Sink, SinkPlan, StageError, StageSpec};
use wavex_line::system::Unpoisoned as _;

/// Converts the lines of a chain, in their order, to items of a [`Stream`].
pub trait Convert: Send {
    /// Item of the stream.
    type Item: Send + 'static;

    /// Converts a line; `None` if no item is complete.
    ///
    /// # Errors
    /// If the line cannot be converted; ends the run.
    fn line(&mut self, line: &ScanLine) -> Result<Option<Self::Item>>;

    /// Converts what is left after the last line.
    ///
    /// # Errors
    /// As [`Convert::line`].
    fn finish(&mut self) -> Result<Option<Self::Item>> {
        Ok(None)
    }
}

/// Results of a chain that runs on its own threads.
///
/// At most as many items as requested wait. Dropping the stream ends the run and waits for its threads.
pub struct Stream<T> {
    /// `None` after the end.
    items: Option<Receiver<T>>,
    run: Option<JoinHandle<StreamResult>>,
    summary: Option<Box<InputSummary>>,
    cancel: Cancel,
    process: u32,
}

type StreamResult = std::result::Result<Box<InputSummary>, RunError>;

/// Next result of a [`Stream`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Next<T> {
    /// An item.
    Item(T),
    /// None within the time.
    Waiting,
    /// The end.
    End,
}

/// Starts a chain over one input; `convert` receives the lines at its end.
///
/// Stages that write files have no place in the chain: [`RunContext::has_outputs`] is `false`. At most
/// `capacity` items wait.
///
/// # Errors
/// If the system refuses a thread, or the job has no source.
pub fn stream<C>(
    job: &Job,
    input: Input,
    options: &Options,
    capacity: usize,
    convert: C,
) -> std::result::Result<Stream<C::Item>, RunError>
where
    C: Convert + 'static,
{
    let (sender, items) = crossbeam_channel::bounded(capacity.max(1));
    let cancel = options.cancel.child();
    let exit = Exit(Mutex::new(Some(Forward { convert, sender, cancel: cancel.clone() })));
    let mut job = job.clone();
    job.append(EXIT.name, &EXIT, Plan::Sink(Arc::new(exit))).map_err(RunError::of_job)?;
    let options = Options { cancel: cancel.clone(), ..options.clone() };
    let body = move || {
        let ended = guarded(|| Ok(run_one(&job, input, &options, Context::of_run())));
        match ended.map_err(|cause| RunError { stage: None, input: None, cause })?? {
            (_, Some(error)) => Err(error),
            (summary, None) => Ok(Box::new(summary)),
        }
    };
    let run = std::thread::Builder::new().name(format!("{THREAD_PREFIX}stream")).spawn(body);
    let run = Some(run.map_err(|error| no_thread(&error))?);
    Ok(Stream { items: Some(items), run, summary: None, cancel, process: std::process::id() })
}

impl<T> Stream<T> {
    /// Waits for the next item for at most `time`.
    ///
    /// # Errors
    /// The first cause with which the run ended, once. A stream made before the process was forked
    /// fails in the child, which has none of its threads.
    pub fn next_within(&mut self, time: Duration) -> std::result::Result<Next<T>, RunError> {
        if self.process != std::process::id() {
            return Err(RunError::of_job(StageError::failed(
                "the stream was started by another process",
                "start it after the process is forked",
            )));
        }
        let Some(items) = &self.items else { return Ok(Next::End) };
        match items.recv_timeout(time) {
            Ok(item) => Ok(Next::Item(item)),
            Err(RecvTimeoutError::Timeout) => Ok(Next::Waiting),
            Err(RecvTimeoutError::Disconnected) => {
                self.items = None;
                match self.run.take().map(JoinHandle::join) {
                    Some(Ok(Ok(summary))) => self.summary = Some(summary),
                    Some(Ok(Err(error))) => return Err(error),
                    Some(Err(_)) | None => {}
                }
                Ok(Next::End)
            }
        }
    }

    /// Ends the run early and waits for its threads.
    pub fn close(&mut self) {
        let (items, run) = (self.items.take(), self.run.take());
        if self.process != std::process::id() {
            // The threads and the other end of the channel are in another process.
            std::mem::forget((items, run));
            return;
        }
        self.cancel.cancel();
        drop(items);
        if let Some(run) = run {
            // A panic was reported by the thread.
            let _ = run.join();
        }
    }

    /// Work done by the run, after its end.
    pub fn summary(&self) -> Option<&InputSummary> {
        self.summary.as_deref()
    }
}

impl<T> Drop for Stream<T> {
    fn drop(&mut self) {
        self.close();
    }
}

impl<T> fmt::Debug for Stream<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Stream").field("has_ended", &self.items.is_none()).finish_non_exhaustive()
    }
}

/// The end of the chain.
static EXIT: StageSpec =
    StageSpec::in_code("stream", RoleName::Sink, &[Kind::Shots, Kind::Returns, Kind::Points]);

/// Makes the only [`Forward`].
struct Exit<C: Convert>(Mutex<Option<Forward<C>>>);

impl<C: Convert + 'static> SinkPlan for Exit<C> {
    fn make(&self, _: &RunContext) -> Result<Box<dyn Sink>> {
        let forward = self.0.lock().unpoisoned().take();
        forward.map_or(Err(StageError::Stopped), |forward| Ok(Box::new(forward)))
    }
}

/// Converts lines and sends the items.
struct Forward<C: Convert> {
    convert: C,
    sender: Sender<C::Item>,
    cancel: Cancel,
}

impl<C: Convert> Forward<C> {
    fn send(&self, item: Option<C::Item>) -> Result<()> {
        let Some(item) = item else { return Ok(()) };
        self.sender.send(item).map_err(|_| {
            self.cancel.cancel();
            StageError::Stopped
        })
    }
}

impl<C: Convert> Sink for Forward<C> {
    fn write(&mut self, line: &ScanLine, _: &mut Context) -> Result<()> {
        let item = self.convert.line(line)?;
        self.send(item)
    }

    fn finish(mut self: Box<Self>, _: &mut Context) -> Result<()> {
        let item = self.convert.finish()?;
        self.send(item)
    }
}
