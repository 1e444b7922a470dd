//! A batch and the buffers with which it is decomposed.

use wavex_simd::{Kernel, LANES, Processor, Simd};

use super::Mode;
use super::candidates::Candidates;
use super::columns::Columns;
use super::detection::ByCount;
use super::fit::FitJob;
use super::fit_queue::{Queues, Results};
use super::pulse_model::{PulseComponent, PulseModel};
use super::rows::{BATCH, EMPTY, Rows};
use super::tables::Tables;
use super::thresholds::Thresholds;
use super::trial::Trial;
use crate::decompose::{DecomposeSettings, Decomposer, Waveform};

/// Buffers of one thread, reused from batch to batch.
///
/// Every phase uses the first four; each of the others belongs to a phase.
pub(super) struct Workspace {
    pub(super) rows: Rows,
    pub(super) pulse_models: Vec<PulseModel>,
    /// Rows that the next kernel processes.
    pub(super) which: Vec<usize>,
    /// Chi-square of these rows.
    pub(super) squares: Vec<f32>,
    pub(super) detection: DetectionBuffers,
    pub(super) fits: FitBuffers,
    pub(super) search: SearchBuffers,
}

/// Buffers of the matched filter, for samples and for residuals.
pub(super) struct DetectionBuffers {
    pub(super) columns: Columns,
    pub(super) candidates: Vec<Candidates>,
    /// Fast waveforms by number of detected pulses.
    pub(super) by_count: ByCount,
}

/// Buffers of the fits of clusters and trials.
pub(super) struct FitBuffers {
    pub(super) queues: Queues,
    pub(super) done: Results,
    /// Waveforms whose clusters need a fit.
    pub(super) due: Vec<usize>,
    /// Waveforms of `due` that have a cluster of the current number.
    pub(super) round: Vec<usize>,
    /// Single pulses that start from the width bank.
    pub(super) singles: Vec<FitJob<1>>,
    /// Indices of these pulses in their waveforms.
    pub(super) single_tags: Vec<usize>,
    /// Rows and indices of pulses that one step cannot handle.
    pub(super) to_fit: Vec<(usize, usize)>,
}

/// Buffers of the residual search.
pub(super) struct SearchBuffers {
    /// Waveforms whose residual still needs a search.
    pub(super) active: Vec<usize>,
    /// By waveform, least chi-square of its pulses before the residual search, had the tables wider
    /// ones.
    pub(super) rivals: Vec<f32>,
    /// Row and pulse model, before the residual search, of waveforms with a pulse at the width limit and perhaps
    /// a good fit.
    pub(super) wide: Vec<(usize, PulseModel)>,
    pub(super) trials: Vec<Trial>,
    /// Levels of trials, DN, and the information on them absorbed by the pulses, 1/DN².
    pub(super) levels: Vec<[f32; 2]>,
    /// Rows and pulses that may be two; `suspect_numbers` holds their indices in the waveform.
    pub(super) suspects: Vec<(usize, PulseComponent)>,
    pub(super) suspect_numbers: Vec<usize>,
    /// Score test of the suspects: the statistic, and whether the stronger pulse is the earlier one.
    pub(super) scores: Vec<(f32, bool)>,
}

/// Largest block decomposed in lock-step, samples.
const MAX_SAMPLES: usize = 4096;

impl Workspace {
    /// Makes room for the longest of the blocks.
    pub(super) fn make_room(&mut self, blocks: &[Waveform<'_>]) {
        let longest = blocks.iter().map(|block| block.samples.len()).max().unwrap_or(0).min(MAX_SAMPLES);
        if longest > self.rows.capacity() {
            self.rows = Rows::new(longest);
            self.detection.columns = Columns::new(self.rows.capacity());
        }
    }

    pub(super) fn new(samples: usize) -> Workspace {
        let rows = Rows::new(samples);
        Workspace {
            detection: DetectionBuffers {
                columns: Columns::new(rows.capacity()),
                candidates: Vec::with_capacity(BATCH),
                by_count: ByCount::new(),
            },
            rows,
            pulse_models: Vec::with_capacity(BATCH),
            which: Vec::with_capacity(BATCH),
            squares: Vec::with_capacity(BATCH),
            fits: FitBuffers {
                queues: Queues::default(),
                done: Results::default(),
                due: Vec::with_capacity(BATCH),
                round: Vec::with_capacity(BATCH),
                singles: Vec::with_capacity(BATCH),
                single_tags: Vec::with_capacity(BATCH),
                to_fit: Vec::with_capacity(BATCH),
            },
            search: SearchBuffers {
                active: Vec::with_capacity(BATCH),
                rivals: Vec::with_capacity(BATCH),
                wide: Vec::new(),
                trials: Vec::with_capacity(BATCH),
                levels: Vec::with_capacity(BATCH),
                suspects: Vec::with_capacity(BATCH),
                suspect_numbers: Vec::with_capacity(BATCH),
                scores: Vec::with_capacity(BATCH),
            },
        }
    }
}

/// Processes at most [`BATCH`] blocks into pulse models in the workspace.
pub(super) struct Decompose<'a> {
    pub(super) on: Processor,
    pub(super) tables: &'a Tables,
    pub(super) thresholds: &'a mut Thresholds,
    pub(super) plain: &'a mut Decomposer,
    pub(super) settings: &'a DecomposeSettings,
    pub(super) mode: Mode,
    pub(super) full_scale_dn: f64,
    /// Whether the background is so high that a sample of 0 is clipped.
    pub(super) clear_of_zero: bool,
    pub(super) work: &'a mut Workspace,
    pub(super) blocks: &'a [Waveform<'a>],
}

/// Computes chi-square of rows.
pub(super) struct ChiSquares<'a> {
    pub(super) rows: &'a Rows,
    pub(super) which: &'a [usize],
    pub(super) out: &'a mut Vec<f32>,
}

impl Kernel for ChiSquares<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, s: S) {
        self.out.clear();
        for which in self.which.chunks(LANES) {
            let mut rows = [EMPTY; LANES];
            rows[..which.len()].copy_from_slice(which);
            self.out.extend_from_slice(&self.rows.chi_squares(s, &rows)[..which.len()]);
        }
    }
}
