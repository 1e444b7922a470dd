//! Fits waveforms of one pulse, the most frequent kind.
//!
//! Processes them from the width bank to chi-square while their rows are in the cache.

use wavex_simd::{Kernel, LANES, Simd};

use super::fit::{Aim, FitJob, fit};
use super::fit_queue::{ITERATIONS, add_pulse, is_strong};
use super::fitted::Fitted;
use super::initial_guess::{BankSums, SOMEWHERE, from_bank};
use super::level::set_levels;
use super::pulse_model::PulseModel;
use super::rows::{EMPTY, Rows};
use super::tables::{BANK, Tables};

/// Settles waveforms of one pulse that converge in the first iterations.
///
/// The response must not depend on the height of the pulse. Other waveforms stay unchanged for the
/// queued fits.
pub(super) struct FitSingles<'a> {
    pub(super) tables: &'a Tables,
    pub(super) rows: &'a mut Rows,
    pub(super) pulse_models: &'a mut [PulseModel],
    pub(super) which: &'a [usize],
    /// Collects waveforms that need a new fit.
    ///
    /// Their pulse moves far with the level.
    pub(super) moved: &'a mut Vec<usize>,
}

impl Kernel for FitSingles<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, s: S) {
        let FitSingles { tables, rows, pulse_models, moved, .. } = self;
        let none = s.halved(s.splat(0.0));
        let mut bank: BankSums<S::Half> = [[none; LANES]; BANK];
        let mut sums = [[none; LANES]; 10];
        let mut fitted = [Fitted::NOTHING; LANES];
        for which in self.which.chunks(LANES) {
            let (mut positions, mut heights, mut widths) = (SOMEWHERE, [0.0; LANES], [0.0; LANES]);
            for (position, &row) in positions.iter_mut().zip(which) {
                *position = pulse_models[row].pulses()[0].position();
            }
            let (height, width) = from_bank(s, tables, rows, which, s.load(&positions), &mut bank);
            s.store(height, &mut heights);
            s.store(width, &mut widths);
            let (mut jobs, mut count) = ([FitJob::<1>::IDLE; LANES], 0);
            for (w, &row) in which.iter().enumerate() {
                let pulses = [[heights[w], positions[w], widths[w]]];
                // The response of stronger pulses depends on their height; the queued fits support that.
                if !is_strong(tables, &pulses) {
                    jobs[count] = FitJob { row, pulses, aim: Aim::OPTIMUM };
                    count += 1;
                }
            }
            let (jobs, fitted) = (&jobs[..count], &mut fitted[..count]);
            fit::<S, 1, 3, 2, 10, false>(s, tables, rows, jobs, 0.0, ITERATIONS[0], &mut sums, fitted);
            let (mut settled, mut count) = ([EMPTY; LANES], 0);
            for (job, fitted) in jobs.iter().zip(fitted) {
                let [pulse] = &fitted.pulses;
                // A fit may end above the height up to which its response is valid.
                if fitted.is_optimum && pulse.is_held() && pulse.values[0] <= tables.strong_dn() {
                    pulse_models[job.row].settle(pulse);
                    add_pulse(s, tables, rows, job.row, pulse.values, -1.0);
                    settled[count] = job.row;
                    count += 1;
                }
            }
            if let Some(level) = &tables.level {
                // It also computes chi-square, which depends on the level.
                set_levels(s, tables, level, rows, pulse_models, &settled[..count], true, moved);
                continue;
            }
            for (square, &row) in rows.chi_squares(s, &settled).into_iter().zip(&settled[..count]) {
                (pulse_models[row].chi_square, pulse_models[row].samples) = (square, rows.counted(row));
            }
        }
    }
}
