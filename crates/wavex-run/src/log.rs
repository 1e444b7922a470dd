//! The log: on standard error, and in a file next to the outputs.

use std::fmt::Debug;
use std::fs::File;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, MutexGuard};

use tracing::field::Field;
use tracing::level_filters::LevelFilter;
use tracing_subscriber::filter::Targets;
use tracing_subscriber::fmt::{MakeWriter, format};
use tracing_subscriber::layer::SubscriberExt;
use tracing_subscriber::util::SubscriberInitExt;
use tracing_subscriber::{Layer, fmt};

use wavex_engine::engine::without_bar;
use wavex_formats::{Error, Result};
use wavex_line::printable::printable;
use wavex_line::stage::own_file;
use wavex_line::system::Unpoisoned as _;

/// Target of the error that ends a command.
const FATAL: &str = "wavex_fatal";

/// The log file of the run, opened after logging has started.
static FILE: Mutex<Option<LogFile>> = Mutex::new(None);

struct LogFile {
    file: File,
    path: PathBuf,
    /// First failure to write.
    failure: Option<io::Error>,
}

/// Copy of the log in memory, if a run archives it.
static KEPT: Mutex<Option<Vec<u8>>> = Mutex::new(None);

/// Whether more messages are requested.
static VERBOSE: AtomicBool = AtomicBool::new(false);

/// Whether logging was started with more messages than warnings.
pub fn is_verbose() -> bool {
    VERBOSE.load(Ordering::Relaxed)
}

/// Starts logging to standard error, with colours if it takes them.
///
/// The level is WARN by default. `RUST_LOG` overrides the arguments: levels, or `TARGET=LEVEL`, by commas.
/// A value that is neither is ignored.
pub fn begin(verbose: u8, quiet: bool, colour: bool) {
    VERBOSE.store(verbose > 0, Ordering::Relaxed);
    let level = match (quiet, verbose) {
        (true, _) => LevelFilter::ERROR,
        (false, 0) => LevelFilter::WARN,
        (false, 1) => LevelFilter::INFO,
        (false, _) => LevelFilter::DEBUG,
    };
    let given = std::env::var("RUST_LOG").ok().filter(|given| !given.is_empty());
    let wanted: Option<Targets> = given.and_then(|given| given.parse().ok());
    let wanted =
        wanted.unwrap_or_else(|| Targets::new().with_default(level)).with_target(FATAL, LevelFilter::OFF);
    let fields = format::debug_fn(write_message);
    let on_terminal = fmt::layer().fmt_fields(fields.clone()).with_writer(|| ToTerminal).with_target(false);
    let on_terminal = on_terminal.with_ansi(colour).without_time();
    let in_file = fmt::layer().fmt_fields(fields).with_writer(ToFile).with_target(false).with_ansi(false);
    let log = tracing_subscriber::registry()
        .with(on_terminal.with_filter(wanted))
        .with(in_file.with_filter(LevelFilter::DEBUG));
    // An existing subscriber is kept; only tests install one earlier.
    let _ = log.try_init();
}

/// Writes a message; control characters are replaced.
///
/// Further lines are indented: a text of a file cannot look like a message of its own.
fn write_message(out: &mut format::Writer<'_>, _: &Field, message: &dyn Debug) -> std::fmt::Result {
    let message = format!("{message:?}");
    write!(out, "{}", printable(&message).trim_end().replace('\n', "\n  "))
}

/// Writes the error that ends the command to the log, at ERROR.
///
/// The terminal gets it once, when the command ends.
pub fn fatal(error: &dyn std::fmt::Display) {
    tracing::error!(target: FATAL, "{error}");
}

/// Also writes the log to this file from now on.
pub fn to_file(path: &Path) -> Result<()> {
    if let Some(folder) = path.parent() {
        std::fs::create_dir_all(folder).map_err(Error::io(folder, "make the folder"))?;
    }
    let file = own_file::truncate(path).map_err(Error::io(path, "create the log"))?;
    *lock() = Some(LogFile { file, path: path.to_owned(), failure: None });
    Ok(())
}

/// Ends the log file; warns if a part of it could not be written.
pub fn end_file() {
    let ended = lock().take();
    if let Some(LogFile { path, failure: Some(error), .. }) = ended {
        tracing::warn!("{}: cannot write the log: {error}; it is incomplete", path.display());
    }
}

/// Also keeps the log in memory from now on.
pub fn keep() {
    *lock_kept() = Some(Vec::new());
}

/// Returns the log kept in memory.
pub fn kept() -> Vec<u8> {
    lock_kept().clone().unwrap_or_default()
}

fn lock_kept() -> MutexGuard<'static, Option<Vec<u8>>> {
    KEPT.lock().unpoisoned()
}

fn lock() -> MutexGuard<'static, Option<LogFile>> {
    FILE.lock().unpoisoned()
}

/// Writes to standard error, with the progress bar drawn again below.
struct ToTerminal;

impl Write for ToTerminal {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        without_bar(|| io::stderr().write(bytes))
    }

    fn flush(&mut self) -> io::Result<()> {
        io::stderr().flush()
    }
}

/// Writes to the log file, if any, and to the copy in memory.
struct ToFile;

impl<'a> MakeWriter<'a> for ToFile {
    type Writer = ToFile;

    fn make_writer(&'a self) -> ToFile {
        ToFile
    }
}

impl Write for ToFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        if let Some(kept) = lock_kept().as_mut() {
            kept.extend_from_slice(bytes);
        }
        if let Some(log) = lock().as_mut() {
            // Write everything: a partial write would be retried and kept twice in memory.
            if let Err(error) = log.file.write_all(bytes) {
                log.failure.get_or_insert(error);
            }
        }
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}
