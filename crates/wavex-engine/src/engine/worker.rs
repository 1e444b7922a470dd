//! Thread bodies of the stages, one function per role.

use std::sync::Arc;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};

use super::failure::Failure;
use super::link::{Inlet, Outlet};
use super::meter::Meter;
use super::pool::Permits;
use super::totals::LineTotals;
use wavex_line::scan_line::{Blocks, Budget, NoRoom, ScanLine};
use wavex_line::stage::{Context, Map, Output, Result, Sink, Source, StageError, Transform};
use wavex_line::system::Unpoisoned as _;
use wavex_signal::calibrate::CalibrationProgress;

/// State shared by the threads of one chain.
pub(super) struct ChainState<'a> {
    pub(super) failure: Failure,
    pub(super) budget: Arc<Budget>,
    /// Workers of maps, of all inputs, that may work at the same time.
    pub(super) workers: &'a Permits,
    pub(super) may_hold_bytes: usize,
    /// Maximum number of transforms that hold lines at the same time.
    pub(super) holders: usize,
    pub(super) largest_line_bytes: usize,
    /// Largest announced memory demand of a stage, bytes, and its name.
    pub(super) foreseen: Mutex<(usize, String)>,
    /// Whether lines keep their sample blocks after `decompose`.
    pub(super) keeps_waveforms: bool,
    pub(super) gauge: &'a Gauge,
    pub(super) totals: Mutex<LineTotals>,
    /// Parent of all workers' contexts.
    pub(super) cx: Context,
}

/// Progress of an input.
#[derive(Debug, Default)]
pub struct Gauge {
    /// Fraction of the input read, ppm; `u64::MAX` if unknown.
    pub(super) read_ppm: Arc<AtomicU64>,
    pub(super) calibration: Arc<CalibrationProgress>,
    pub(super) lines_read: AtomicU64,
    pub(super) shots_read: AtomicU64,
    /// Lines and shots that have left the chain.
    pub(super) lines: AtomicU64,
    pub(super) shots: AtomicU64,
}

impl Gauge {
    /// Counts a line that was read; `fraction` is the part of the input read so far, if known.
    pub fn read(&self, shots: u64, fraction: Option<f64>) {
        let ppm = fraction.map_or(u64::MAX, |part| (part.clamp(0.0, 1.0) * 1e6) as u64);
        self.read_ppm.store(ppm, Ordering::Relaxed);
        self.lines_read.fetch_add(1, Ordering::Relaxed);
        self.shots_read.fetch_add(shots, Ordering::Relaxed);
    }

    /// Counts a line that is done.
    pub fn passed(&self, shots: u64) {
        self.lines.fetch_add(1, Ordering::Relaxed);
        self.shots.fetch_add(shots, Ordering::Relaxed);
    }
}

/// Destination of a worker's lines: the next stage, or the end of the chain.
pub(super) enum Downstream {
    To(Outlet),
    Out,
}

/// State of one worker.
pub(super) struct WorkerContext<'a> {
    /// Name of the stage in the job.
    pub(super) stage: &'a str,
    pub(super) shared: &'a ChainState<'a>,
    pub(super) exit: Downstream,
    pub(super) meter: Meter,
    pub(super) cx: Context,
}

impl WorkerContext<'_> {
    /// Sends a line to the next stage or out of the chain.
    fn send(&mut self, place: u64, mut scan_line: ScanLine) -> Result<()> {
        scan_line.recount();
        self.meter.gave(&scan_line);
        match &self.exit {
            Downstream::To(outlet) => outlet.send(place, scan_line)?,
            Downstream::Out => self.leave(&scan_line),
        }
        if self.shared.cx.observer().is_some() && matches!(self.exit, Downstream::Out) {
            // Observing a line that leaves is work: no stage follows that could block.
            self.meter.worked();
        }
        self.meter.was_blocked();
        Ok(())
    }

    /// Adds the counters of a line that leaves the chain to the totals, and shows it to the observer.
    fn leave(&self, scan_line: &ScanLine) {
        self.shared.gauge.passed(scan_line.emissions.len() as u64);
        self.shared.totals.lock().unpoisoned().add(scan_line);
        if let Some(observer) = self.shared.cx.observer() {
            observer.line(scan_line);
        }
    }

    /// Records the maximum memory that the stage will hold back.
    fn foresee(&self, bytes: usize) {
        if bytes > 0 {
            let mut foreseen = self.shared.foreseen.lock().unpoisoned();
            if bytes > foreseen.0 {
                *foreseen = (bytes, self.stage.to_owned());
            }
        }
    }

    fn end(&mut self) -> Result<()> {
        match &self.exit {
            Downstream::To(outlet) => outlet.end(),
            Downstream::Out => Ok(()),
        }
    }

    /// Receives the next line, unless the run is ending.
    fn take(&mut self, inlet: &mut Inlet) -> Result<Option<(u64, ScanLine)>> {
        let next = inlet.next()?;
        self.meter.waited();
        if self.shared.failure.stopping() {
            return Err(StageError::Stopped);
        }
        if let Some((_, scan_line)) = &next {
            self.meter.took(scan_line);
        }
        Ok(next)
    }
}

/// Reads the whole input; each line waits until it fits into the memory budget.
pub(super) fn run_source(mut source: Box<dyn Source>, worker: &mut WorkerContext) -> Result<()> {
    let mut place = 0;
    loop {
        let next = source.next(&mut worker.cx);
        worker.meter.worked();
        worker.meter.line_done();
        let Some(mut scan_line) = next? else { break };
        worker.shared.gauge.read(scan_line.emissions.len() as u64, source.progress());
        scan_line.waveforms = worker.shared.keeps_waveforms.then(Blocks::default);
        let bytes = scan_line.bytes();
        if bytes > worker.shared.largest_line_bytes {
            return Err(too_large(scan_line.line, bytes, worker.shared));
        }
        let failure = &worker.shared.failure;
        match worker.shared.budget.take(bytes, || failure.stopping()) {
            Ok(_) | Err(NoRoom::Cancelled) if failure.stopping() => return Err(StageError::Stopped),
            Ok(ticket) => scan_line.ticket = Some(ticket),
            Err(NoRoom::Cancelled) => return Err(StageError::Stopped),
            Err(NoRoom::Full(held)) => return Err(no_room(scan_line.line, bytes, held, worker.shared)),
        }
        worker.send(place, scan_line)?;
        place += 1;
    }
    worker.end()
}

fn too_large(line: u32, bytes: usize, shared: &ChainState) -> StageError {
    let needed_mb =
        (shared.budget.limit() as f64 * bytes as f64 / shared.largest_line_bytes as f64 / 1e6).ceil();
    StageError::failed(
        format!("scan line {line} needs {:.1} MB, too much for the job's memory_mb", bytes as f64 / 1e6),
        format!("set memory_mb to {needed_mb} or more"),
    )
}

/// Error if a line does not fit because stages require all `held` bytes that they hold back.
fn no_room(line: u32, bytes: usize, held: usize, shared: &ChainState) -> StageError {
    let (foreseen, stage) = &*shared.foreseen.lock().unpoisoned();
    let needs = match stage.as_str() {
        "" => String::new(),
        stage => format!(", and `{stage}` needs up to {:.1} MB", *foreseen as f64 / 1e6),
    };
    // The other transforms additionally use up to their shares.
    let holders = shared.holders as f64;
    let needed = ((*foreseen).max(held) + 2 * bytes) as f64 * 2.0 * holders / (holders + 1.0);
    StageError::failed(
        format!(
            "scan line {line} ({:.1} MB) does not fit into memory_mb: stages hold back {:.1} MB{needs}",
            bytes as f64 / 1e6,
            held as f64 / 1e6
        ),
        format!("set memory_mb to {} or more", (1.05 * needed / 1e6).ceil()),
    )
}

/// Maps lines one by one; one of several workers.
pub(super) fn run_map(mut map: Box<dyn Map>, inlet: &mut Inlet, worker: &mut WorkerContext) -> Result<()> {
    while let Some((place, scan_line)) = worker.take(inlet)? {
        let permit = worker.shared.workers.take();
        worker.meter.waited();
        let result = map.map(scan_line, &mut worker.cx);
        drop(permit);
        worker.meter.worked();
        worker.meter.line_done();
        worker.send(place, result?)?;
    }
    worker.end()
}

/// Passes lines to a transform, which emits lines when it is ready.
pub(super) fn run_transform(
    mut stage: Box<dyn Transform>,
    inlet: &mut Inlet,
    worker: &mut WorkerContext,
) -> Result<()> {
    let mut place = 0;
    loop {
        let mut next = worker.take(inlet)?;
        let ended = next.is_none();
        let budget = Arc::clone(&worker.shared.budget);
        let at_work = budget.at_work();
        set_inside(next.as_mut().map(|(_, scan_line)| scan_line), true);
        // The stage borrows the context while it emits lines, so take it out of the worker's state.
        let mut cx = std::mem::take(&mut worker.cx);
        let may_hold_bytes = worker.shared.may_hold_bytes;
        let mut emit = |mut scan_line: ScanLine| {
            worker.meter.worked();
            place += 1;
            set_inside(Some(&mut scan_line), false);
            worker.send(place - 1, scan_line)
        };
        let mut out = Output::new(&mut cx, may_hold_bytes, &mut emit);
        let result = match next {
            Some((_, scan_line)) => stage.process(scan_line, &mut out),
            None => stage.finish(&mut out),
        };
        let foreseen_bytes = out.foreseen_bytes();
        worker.cx = cx;
        worker.foresee(foreseen_bytes);
        drop(at_work);
        worker.meter.worked();
        worker.meter.line_done();
        result?;
        if ended {
            return worker.end();
        }
    }
}

/// Marks whether a transform holds a line.
fn set_inside(scan_line: Option<&mut ScanLine>, is_inside: bool) {
    if let Some(ticket) = scan_line.and_then(|scan_line| scan_line.ticket.as_mut()) {
        ticket.set_inside(is_inside);
    }
}

/// Writes lines and passes them on.
pub(super) fn run_sink(mut sink: Box<dyn Sink>, inlet: &mut Inlet, worker: &mut WorkerContext) -> Result<()> {
    while let Some((place, scan_line)) = worker.take(inlet)? {
        let result = sink.write(&scan_line, &mut worker.cx);
        worker.meter.worked();
        worker.meter.line_done();
        result?;
        worker.send(place, scan_line)?;
    }
    sink.finish(&mut worker.cx)?;
    worker.meter.worked();
    worker.meter.line_done();
    worker.end()
}
