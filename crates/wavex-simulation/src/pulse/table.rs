//! Tabulated response, which avoids exponentials per sample.

use std::cell::OnceCell;

use super::super::whole_and_part;
use super::{FWHM_OF_NORMAL, PulseShape};

/// Table steps per sample. The error of linear interpolation is below 1e-5 of the peak.
const PHASES: usize = 64;
/// Step of the logarithm of the width ratio.
const WIDTH_STEP: f64 = 0.01;
/// Index of the maximum width ratio, 2.5.
const WIDTHS: usize = 92;

/// A [`PulseShape`] tabulated finely in time, for width ratios from 1 to 2.5 in steps of 1 %.
///
/// A target uses the nearest of these widths, and the ground truth reports that width, so the
/// recorded pulse is exact for it. The table of a width is computed on first use.
#[derive(Clone, Debug)]
pub struct PulseTable {
    shape: PulseShape,
    interval_ns: f64,
    /// Variance of a normal distribution with the FWHM of the shape, ns².
    variance_ns2: f64,
    /// Decay of the slow tail over one sample, where only the tail remains; 0: no tail.
    tail_factor: f64,
    rows: Vec<OnceCell<WidthRow>>,
}

/// One width: the response at all samples, for each phase of the first sample relative to the peak.
#[derive(Clone, Debug)]
struct WidthRow {
    /// Number of samples before the one at or before the peak.
    lead: i64,
    /// Total number of samples.
    len: usize,
    /// `PHASES + 1` runs of `len` samples: run p holds the response at `(k - lead - p / PHASES)`
    /// samples.
    samples: Vec<f64>,
    /// Peak amplitude relative to the peak amplitude of a flat target.
    peak: f64,
}

/// Index of a width in a [`PulseTable`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct WidthIndex(usize);

impl PulseTable {
    /// Tabulates a response for this sampling interval, ns.
    pub fn new(shape: PulseShape, interval_ns: f64) -> PulseTable {
        let sd_ns = shape.fwhm_ns() / FWHM_OF_NORMAL;
        let (decay_ns, _) = shape.end(0.0);
        let tail_factor = if decay_ns > 0.0 { libm::exp(-interval_ns / decay_ns) } else { 0.0 };
        let rows = vec![OnceCell::new(); WIDTHS + 1];
        PulseTable { shape, interval_ns, variance_ns2: sd_ns * sd_ns, tail_factor, rows }
    }

    /// Nearest width for a target that spreads the pulse by this standard deviation, ns.
    pub fn width(&self, spread_ns: f64) -> WidthIndex {
        let log_ratio = 0.5 * libm::log1p(spread_ns * spread_ns / self.variance_ns2);
        WidthIndex(((log_ratio / WIDTH_STEP + 0.5) as usize).min(WIDTHS))
    }

    /// Width ratio relative to a flat target.
    ///
    /// `sqrt(1 + v / v0)` with the variance `v` of the target and the variance `v0` of a normal
    /// distribution with the FWHM of the response.
    pub fn width_ratio(&self, width: WidthIndex) -> f64 {
        libm::exp(WIDTH_STEP * width.0 as f64)
    }

    /// Peak amplitude relative to a flat target's echo of the same energy.
    pub fn peak(&self, width: WidthIndex) -> f64 {
        self.row(width).peak
    }

    /// Adds a response to samples.
    ///
    /// `energy` is the peak amplitude for a flat target; `position` is time 0 of the response,
    /// samples from the first one.
    pub fn add(&self, width: WidthIndex, position: f64, energy: f64, samples: &mut [f64]) {
        let row = self.row(width);
        let (whole, phase) = whole_and_part(position);
        let phase = phase * PHASES as f64;
        let (lower, part) = (phase as usize, phase - (phase as usize) as f64);
        let (weight, weight_next) = (energy * (1.0 - part), energy * part);
        let runs = row.samples.get(lower * row.len..(lower + 2) * row.len).unwrap_or_default();
        let (run, run_next) = runs.split_at(runs.len() / 2);

        let start = whole - row.lead;
        let skipped = (-start).clamp(0, run.len() as i64) as usize;
        let first = start.clamp(0, samples.len() as i64) as usize;
        let pairs = run[skipped..].iter().zip(&run_next[skipped..]);
        for (sample, (&value, &next)) in samples[first..].iter_mut().zip(pairs) {
            *sample += weight * value + weight_next * next;
        }
        let last = weight * run[row.len - 1] + weight_next * run_next[row.len - 1];
        self.add_tail(start + row.len as i64, last, samples);
    }

    /// Continues after a row that ended before sample `end` with the value `last`: there the
    /// response is one exponential.
    fn add_tail(&self, end: i64, last: f64, samples: &mut [f64]) {
        if end >= samples.len() as i64 || self.tail_factor == 0.0 {
            return;
        }
        let first = end.max(0);
        let mut value = last;
        if first > end {
            value *= libm::pow(self.tail_factor, (first - end) as f64);
        }
        for sample in &mut samples[first as usize..] {
            value *= self.tail_factor;
            *sample += value;
        }
    }

    fn row(&self, width: WidthIndex) -> &WidthRow {
        self.rows[width.0].get_or_init(|| {
            let ratio = self.width_ratio(width);
            let widening_ns2 = self.variance_ns2 * (ratio * ratio - 1.0);
            let (_, end_ns) = self.shape.end(widening_ns2);
            let lead = (6.0 * self.shape.sd_ns(widening_ns2) / self.interval_ns).ceil() as i64;
            let len = lead as usize + 1 + (end_ns / self.interval_ns).ceil() as usize;
            let value = |phase: usize, k: usize| {
                let samples = (k as i64 - lead) as f64 - phase as f64 / PHASES as f64;
                self.shape.at(samples * self.interval_ns, widening_ns2)
            };
            let samples = (0..=PHASES).flat_map(|phase| (0..len).map(move |k| value(phase, k))).collect();
            let peak = self.shape.at(self.shape.peak_ns(widening_ns2), widening_ns2);
            WidthRow { lead, len, samples, peak }
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The table agrees with the closed form at any phase, width and position in a block.
    #[test]
    fn the_table_equals_the_response() {
        for shape in [PulseShape::riegl(), PulseShape::gaussian(4.5), PulseShape::riegl_reference()] {
            let table = PulseTable::new(shape.clone(), 1.0);
            for (spread, position) in [(0.0, 16.0), (0.3, 16.37), (1.0, 3.992), (2.5, -7.01), (4.0, 70.6)] {
                let width = table.width(spread);
                let widening = table.variance_ns2 * (table.width_ratio(width).powi(2) - 1.0);
                let mut samples = [0.0; 120];
                table.add(width, position, 200.0, &mut samples);
                for (k, &sample) in samples.iter().enumerate() {
                    let expected = 200.0 * shape.at(k as f64 - position, widening);
                    assert!((sample - expected).abs() < 200.0 * 1e-5, "{spread} {position} {k}: {sample}");
                }
            }
        }
    }

    #[test]
    fn a_pulse_far_outside_the_block_leaves_its_tail_at_most() {
        let table = PulseTable::new(PulseShape::riegl(), 1.0);
        let mut samples = [0.0; 4];
        table.add(table.width(0.0), 1000.0, 100.0, &mut samples);
        assert_eq!(samples, [0.0; 4]);
        table.add(table.width(0.0), -200.0, 100.0, &mut samples);
        let expected = [200.0, 201.0, 202.0, 203.0].map(|t| 100.0 * PulseShape::riegl().at(t, 0.0));
        assert!(samples.iter().zip(expected).all(|(s, e)| (s / e - 1.0).abs() < 1e-4), "{samples:?}");
    }

    #[test]
    fn widths_are_rounded_to_the_table() {
        let table = PulseTable::new(PulseShape::gaussian(4.5), 1.0);
        assert_eq!(table.width(0.0), WidthIndex(0));
        assert_eq!(table.width_ratio(WidthIndex(0)), 1.0);
        assert_eq!(table.width(1e6), WidthIndex(WIDTHS));
        assert!((table.width_ratio(WidthIndex(WIDTHS)) - 2.5).abs() < 0.01);
        let sd = 4.5 / FWHM_OF_NORMAL;
        let width = table.width(sd);
        assert!((table.width_ratio(width) / 2f64.sqrt() - 1.0).abs() < 0.5 * WIDTH_STEP);
        assert!((table.peak(width) * table.width_ratio(width) - 1.0).abs() < 1e-12);
    }
}
