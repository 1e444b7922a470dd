//! Lookup tables: whitened templates by height, width and phase, inverse Fisher matrices, filters.

mod build;

use wavex_simd::LANES;

use super::filter::Filter;
use super::fourier_response::{BEFORE, Series, Widened};
use super::layout::*;
use super::level_tables::LevelTables;
use crate::detect::LEAST_ENERGY_PART;
use crate::noise::ArNoise;
use crate::sensor_model::ChannelModel;
use crate::sensor_model::response::{ResponseNode, STEPS_PER_SAMPLE, SystemResponse};
use crate::shape::{FOUR_LN_2, Shape};
use crate::whitening::Whitener;

use build::*;

/// The same with the samples before it that whitening needs.
const ROW_AND_BEFORE: usize = ROW + MAX_ORDER;
/// Supported full widths at half maximum, samples.
const FWHM_RANGE: std::ops::RangeInclusive<f64> = 1.5..=6.0;
/// Number of widths in the bank, at knots `first + k stride`.
pub(super) const BANK: usize = 6;
const BANK_FIRST: usize = 12;
const BANK_STRIDE: usize = 7;

/// Fraction of a pulse's energy that may be missing at either end of its row.
///
/// At a signal-to-noise ratio of 100 it is a tenth of a standard deviation.
const NEGLIGIBLE_ENERGY: f32 = 1e-6;
/// Fraction of the information on any value that may be missing at either end.
///
/// Up to it the tabulated Fisher matrix is used. Standard deviations are then too small by about
/// half of it.
const NEGLIGIBLE_INFORMATION: f32 = 0.01;

/// Values that start on a cache line.
pub(super) struct Aligned {
    values: Vec<f32>,
    start: usize,
}

impl Aligned {
    pub(super) fn zeros(length: usize) -> Aligned {
        let mut values = vec![0.0; length + LANES];
        // An unaligned start only costs time.
        let start = values.as_ptr().align_offset(64).min(LANES);
        values.truncate(start + length);
        Aligned { values, start }
    }

    #[inline(always)]
    pub(super) fn as_slice(&self) -> &[f32] {
        &self.values[self.start..]
    }

    #[inline(always)]
    pub(super) fn as_mut_slice(&mut self) -> &mut [f32] {
        &mut self.values[self.start..]
    }
}

/// Templates of the response for one height of the peak.
pub(super) struct TemplateNode {
    pub(super) peak_dn: f32,
    entries: Aligned,
    /// Whitened response after the row, by position, with sixteen zeros before and after.
    tails: Aligned,
}

/// Tables of one channel's response and noise, shared by all threads.
///
/// 1 MB of templates for each height with its own response. The part for one width, 19 KB, stays in
/// the first-level cache. Late odd samples double both.
pub struct Tables {
    /// Binary logarithm of the number of positions per width.
    ///
    /// They cover one sample, or an even and an odd one if odd samples are late.
    step_bits: u32,
    pub(super) nodes: Vec<TemplateNode>,
    /// Inverse Fisher matrix of a pulse of height 1, by entry.
    ///
    /// Lower triangle: aa, aτ, ττ, au, τu, uu.
    inverse_fisher: Vec<[f32; 8]>,
    /// The six rows of the bank, each of unit energy, by position.
    bank: Aligned,
    /// Inverse square root of the energies of the bank's rows.
    pub(super) bank_scale: [f32; BANK],
    /// Factor on the tail of a pulse of height 1, by knot.
    ///
    /// Widening lowers the peak but not the tail.
    tail_gain: [f32; KNOTS],
    /// First and end sample of the part of a row that holds a pulse, by knot.
    needed: [[i32; 2]; KNOTS],
    /// First and end sample of the part that holds its information, by knot.
    telling: [[i32; 2]; KNOTS],
    /// Number of values of a tail, including the zeros.
    tail_stride: usize,
    pub(super) filter: Filter,
    /// Matched filter on whitened samples, in the units of `filter`'s taps.
    ///
    /// For even and for odd positions.
    pub(super) matched: [[f32; FILTER_LAGS]; 2],
    /// Whitening taps: for the sample, then for those before it.
    pub(super) whitening: [f32; MAX_ORDER + 1],
    pub(super) order: usize,
    /// Whitening of the first samples, as many as the order.
    ///
    /// Each row has the factors of the earlier samples, then that of the sample itself.
    pub(super) begin: [[f32; MAX_ORDER]; MAX_ORDER],
    /// Background by sample number modulo 4, DN, and its whitened values.
    pub(super) background: [f32; 4],
    pub(super) whitened_background: [f32; 4],
    /// Tables for waveforms with their own background; `None` for the channel's.
    pub(super) level: Option<LevelTables>,
    /// Full width at half maximum of a pulse of width ratio 1, samples.
    pub(super) fwhm_samples: f64,
    /// The pulse shape for the scalar kernels.
    pub(super) shape: Shape,
}

impl Tables {
    /// Creates the tables for a channel, or `None` if it is unsupported.
    ///
    /// Unsupported: a digitiser with its own tail; an own background of each waveform if no sample
    /// was free of signal to measure the noise; noise of an order above 4; a pulse narrower than 1.5
    /// or wider than 6 samples; a model that fails its check.
    pub fn new(model: &ChannelModel) -> Option<Tables> {
        let fwhm = model.fwhm_samples();
        let noise = model.noise().ok()?;
        let has_tail = model.digitiser.decay.is_some();
        let fits = !has_tail && noise.order() <= MAX_ORDER && FWHM_RANGE.contains(&fwhm);
        let is_levelled = model.offset_precision().is_none() || !model.autocorrelation.is_empty();
        if !fits || !is_levelled || model.check().is_err() {
            return None;
        }
        let gaussian;
        let response = match &model.response {
            Some(response) => response,
            None => {
                gaussian = gaussian_response(fwhm);
                &gaussian
            }
        };
        let mut tables = Tables::empty(model, &noise, response, Shape::of(model).ok()?);
        let filter = Whitening { taps: tables.whitening.map(f64::from) };
        for (i, node) in response.nodes.iter().enumerate() {
            let reach = 2 * ROW;
            let shift = model.digitiser.odd_sample_shift;
            let series = Series::new(&node.values, response.first_sample, fwhm, reach).seen_late(shift);
            tables.add_node(&series, node.peak_dn, &filter, i == 0);
            if i == 0 {
                tables.set_filter(
                    &series.widened(0.0, ROW_AND_BEFORE),
                    &filter,
                    &noise,
                    &model.background_dn,
                );
            }
        }
        tables.fill_bank();
        Some(tables)
    }

    fn empty(model: &ChannelModel, noise: &ArNoise, response: &SystemResponse, shape: Shape) -> Tables {
        let mut whitening = [0.0; MAX_ORDER + 1];
        let scale = noise.innovation_variance().sqrt().recip();
        whitening[0] = scale as f32;
        for (tap, coefficient) in whitening[1..].iter_mut().zip(noise.coefficients()) {
            *tap = (-coefficient * scale) as f32;
        }
        let values = response.nodes.first().map_or(0, |node| node.values.len());
        let end = i64::from(response.first_sample) + values.div_ceil(STEPS_PER_SAMPLE) as i64;
        let tail = (end + MAX_ORDER as i64 - (ROW as i64 - i64::from(BEFORE_PEAK))).max(1) as usize;
        let steps = if model.digitiser.odd_sample_shift == 0.0 { PHASES } else { 2 * PHASES };
        Tables {
            step_bits: steps.ilog2(),
            nodes: Vec::with_capacity(response.nodes.len()),
            inverse_fisher: Vec::with_capacity(KNOTS * steps),
            bank: Aligned::zeros(steps * BANK * ROW),
            bank_scale: [0.0; BANK],
            tail_gain: [1.0; KNOTS],
            needed: [[0, ROW as i32]; KNOTS],
            telling: [[0, ROW as i32]; KNOTS],
            tail_stride: tail.div_ceil(LANES) * LANES + 2 * LANES,
            filter: Filter::NONE,
            matched: [[0.0; FILTER_LAGS]; 2],
            whitening,
            order: noise.order(),
            begin: beginning(noise),
            background: model.background_dn.map(|level| level as f32),
            whitened_background: std::array::from_fn(|k| {
                let taps = whitening.iter().enumerate();
                taps.map(|(lag, &tap)| f64::from(tap) * model.background_dn[(k + 4 - lag) % 4]).sum::<f64>()
                    as f32
            }),
            level: model.offset_precision().map(|precision| LevelTables::new(noise, precision)),
            fwhm_samples: model.fwhm_samples(),
            shape,
        }
    }

    /// Number of tabulated positions per width.
    fn steps(&self) -> usize {
        1 << self.step_bits
    }

    /// Whether odd samples are late.
    #[inline(always)]
    pub(super) fn has_late_samples(&self) -> bool {
        self.steps() > PHASES
    }

    /// Returns the entry of a knot and a position in steps of 1/16 sample.
    #[inline(always)]
    pub(super) fn index(&self, knot: usize, step: i32) -> usize {
        (knot << self.step_bits) + self.step_of(step as usize)
    }

    /// Returns the tabulated position of an entry, or of a position in steps of 1/16 sample.
    #[inline(always)]
    fn step_of(&self, index: usize) -> usize {
        index & (self.steps() - 1)
    }

    /// Returns the templates of a height and entry.
    ///
    /// The entry starts with zeros, and each row is followed by zeros.
    #[inline(always)]
    pub(super) fn entry(&self, node: usize, index: usize) -> &[f32; ENTRY] {
        const NOTHING: &[f32; ENTRY] = &[0.0; ENTRY];
        match self.nodes.get(node).and_then(|node| node.entries.as_slice().get(index * ENTRY..)) {
            Some(from) => from.first_chunk().unwrap_or(NOTHING),
            None => NOTHING,
        }
    }

    /// Returns the inverse Fisher matrix of a pulse of height 1.
    ///
    /// In the order aa, aτ, ττ, au, τu, uu. Two more values pad it to a power of two.
    #[inline(always)]
    pub(super) fn inverse_fisher(&self, index: usize) -> [f32; 8] {
        self.inverse_fisher.get(index).copied().unwrap_or([0.0; 8])
    }

    /// Returns the rows of the bank at a position in steps of 1/16 sample.
    #[inline(always)]
    pub(super) fn bank(&self, step: i32) -> &[f32; BANK * ROW] {
        const NOTHING: &[f32; BANK * ROW] = &[0.0; BANK * ROW];
        match self.bank.as_slice().get(self.step_of(step as usize) * BANK * ROW..) {
            Some(from) => from.first_chunk().unwrap_or(NOTHING),
            None => NOTHING,
        }
    }

    /// Returns `ln` of a width ratio of the bank.
    pub(super) fn bank_width(k: usize) -> f64 {
        U_MIN + (BANK_FIRST + k * BANK_STRIDE) as f64 * U_STEP
    }

    /// Returns the whitened response after the row of an entry.
    ///
    /// Sixteen zeros precede and follow it. Row and tail add up to the whole response.
    #[inline(always)]
    pub(super) fn tail(&self, node: usize, index: usize) -> &[f32] {
        let at = self.step_of(index) * self.tail_stride;
        let tails = self.nodes.get(node).map(|node| node.tails.as_slice());
        tails.and_then(|tails| tails.get(at..at + self.tail_stride)).unwrap_or(&[])
    }

    /// Returns the factor on the tail of an entry's pulse, in addition to its height.
    #[inline(always)]
    pub(super) fn tail_gain(&self, index: usize) -> f32 {
        self.tail_gain.get(index >> self.step_bits).copied().unwrap_or(1.0)
    }

    /// First and end sample of the part of a row that holds an entry's pulse.
    #[inline(always)]
    pub(super) fn needed(&self, index: usize) -> [i32; 2] {
        self.needed.get(index >> self.step_bits).copied().unwrap_or([0, ROW as i32])
    }

    /// First and end sample of the part that holds an entry's information.
    #[inline(always)]
    pub(super) fn telling(&self, index: usize) -> [i32; 2] {
        self.telling.get(index >> self.step_bits).copied().unwrap_or([0, ROW as i32])
    }

    /// Height above which the response differs from the first node's, DN.
    ///
    /// Infinite with one node.
    pub(super) fn strong_dn(&self) -> f32 {
        if self.nodes.len() > 1 { self.nodes[0].peak_dn } else { f32::INFINITY }
    }
}
