//! Computation of the tables.

use super::*;
use crate::parallel::map_parts;

impl Tables {
    pub(super) fn add_node(&mut self, series: &Series, peak_dn: f64, filter: &Whitening, is_first: bool) {
        let mut node = TemplateNode {
            peak_dn: peak_dn as f32,
            entries: Aligned::zeros(KNOTS * self.steps() * ENTRY),
            tails: Aligned::zeros(self.steps() * self.tail_stride),
        };
        let tail_samples = self.tail_stride - 2 * LANES;
        let calibrated = series.widened(0.0, ROW_AND_BEFORE + tail_samples);
        for (step, tail) in node.tails.as_mut_slice().chunks_exact_mut(self.tail_stride).enumerate() {
            let whitened = filter.of(&calibrated.row(step, 0)[ROW..]);
            tail[LANES..].iter_mut().zip(whitened).for_each(|(out, value)| *out = value as f32);
        }
        let ln_widths: Vec<f64> = (0..KNOTS).map(|knot| U_MIN + knot as f64 * U_STEP).collect();
        let widened = map_parts(&ln_widths, 1, |u| series.widened(u[0], ROW_AND_BEFORE));
        let of_knots = node.entries.as_mut_slice().chunks_exact_mut(ENTRY * self.steps());
        for (knot, (entries, widened)) in of_knots.zip(widened).enumerate() {
            if is_first {
                self.tail_gain[knot] = (calibrated.top / widened.top) as f32;
            }
            for (step, entry) in entries.chunks_exact_mut(ENTRY).enumerate() {
                let fisher = fill_entry(entry, &widened, step, filter);
                if is_first {
                    let inverse = inverse(fisher);
                    self.inverse_fisher.push(inverse);
                    let row = |k: usize| &entry[LANES + k * ROW_STRIDE..][..ROW];
                    let [pulse, by_time, by_width] = [row(0), row(1), row(3)];
                    if let Some(level) = &mut self.level {
                        let [a, t, u] = [pulse, by_time, by_width].map(|row| row.iter().sum::<f32>());
                        level.push(&inverse, [a, -t, u]);
                    }
                    let of_pulse = holding(pulse, NEGLIGIBLE_ENERGY);
                    let of_values =
                        [pulse, by_time, by_width].map(|row| holding(row, NEGLIGIBLE_INFORMATION));
                    if step == 0 {
                        (self.needed[knot], self.telling[knot]) = (of_pulse, of_values[0]);
                    }
                    self.needed[knot] = both(self.needed[knot], of_pulse);
                    self.telling[knot] = of_values.into_iter().fold(self.telling[knot], both);
                }
            }
        }
        self.nodes.push(node);
    }

    pub(super) fn fill_bank(&mut self) {
        for step in 0..self.steps() {
            for k in 0..BANK {
                let entry = *self.entry(0, self.index(BANK_FIRST + k * BANK_STRIDE, step as i32));
                let row = &entry[LANES..LANES + ROW];
                let scale = row.iter().map(|&v| f64::from(v).powi(2)).sum::<f64>().sqrt().recip();
                let at = (step * BANK + k) * ROW;
                for (out, &value) in self.bank.as_mut_slice()[at..at + ROW].iter_mut().zip(row) {
                    *out = (f64::from(value) * scale) as f32;
                }
                // The energy hardly depends on the position: one is used for all.
                if step == PHASES / 2 {
                    self.bank_scale[k] = scale as f32;
                }
            }
        }
    }

    /// Combines whitening and matched filter into taps of unit output variance.
    ///
    /// For even and for odd positions. At the edges of a block missing samples are taken as
    /// background. The gain there is the inverse standard deviation, or 0 if too little energy is
    /// left.
    pub(super) fn set_filter(
        &mut self,
        pulse: &Widened,
        filter: &Whitening,
        noise: &ArNoise,
        background_dn: &[f64; 4],
    ) {
        let pulses = [0, self.steps() - PHASES].map(|step| pulse.row(step, 0));
        let templates = pulses.map(|pulse| {
            let mut template = [0.0; FILTER_LAGS];
            let whitened = filter.of(&pulse[BEFORE - MAX_ORDER - FILTER_BEFORE as usize..]);
            template.iter_mut().zip(whitened).for_each(|(out, value)| *out = value);
            template
        });
        let norms = templates.map(|template| template.iter().map(|v| v * v).sum::<f64>().sqrt().recip());
        let mut taps = [[0.0; TAPS]; 2];
        for ((taps, template), norm) in taps.iter_mut().zip(&templates).zip(norms) {
            for (i, value) in template.iter().enumerate() {
                for (lag, tap) in filter.taps.iter().enumerate() {
                    taps[i + MAX_ORDER - lag] += norm * tap * value;
                }
            }
        }
        let mut lags = [0.0; TAPS];
        noise.autocovariance_into(&mut lags);
        let part = |parity: usize, used: std::ops::Range<usize>| {
            let (pulse, taps) = (&pulses[parity][BEFORE - TAPS_BEFORE..], &taps[parity]);
            let signal: f64 = used.clone().map(|i| taps[i] * pulse[i]).sum();
            let pairs = used.clone().flat_map(|i| used.clone().map(move |j| (i, j)));
            let variance: f64 = pairs.map(|(i, j)| taps[i] * taps[j] * lags[i.abs_diff(j)]).sum();
            (signal, variance)
        };
        let gain = |parity: usize, used| {
            let whole = part(parity, 0..TAPS).0.powi(2);
            let (signal, variance) = part(parity, used);
            let enough = signal > 0.0 && signal * signal >= LEAST_ENERGY_PART * whole * variance;
            if enough { variance.sqrt().recip() as f32 } else { 0.0 }
        };
        self.filter = Filter::new(&taps, background_dn, gain);
        if let Some(level) = &mut self.level {
            level.filter = Filter::new(&taps, &[1.0; 4], gain);
        }
        let scale = f64::from(self.filter.scale());
        self.matched = [0, 1].map(|k| templates[k].map(|value| (value * norms[k] / scale) as f32));
    }
}

/// First and end sample of a row without negligible energy at either end.
pub(super) fn holding(row: &[f32], negligible: f32) -> [i32; 2] {
    let whole: f32 = row.iter().map(|v| v * v).sum();
    let (mut energy, mut first) = (0.0, 0);
    while first < row.len() && energy + row[first] * row[first] <= negligible * whole {
        energy += row[first] * row[first];
        first += 1;
    }
    let (mut energy, mut end) = (0.0, row.len());
    while end > first && energy + row[end - 1] * row[end - 1] <= negligible * whole {
        end -= 1;
        energy += row[end] * row[end];
    }
    [first as i32, end as i32]
}

/// Returns the smallest span that contains two spans.
pub(super) fn both(a: [i32; 2], b: [i32; 2]) -> [i32; 2] {
    [a[0].min(b[0]), a[1].max(b[1])]
}

/// Returns the exact whitening of the first samples of a block, row by row.
pub(super) fn beginning(noise: &ArNoise) -> [[f32; MAX_ORDER]; MAX_ORDER] {
    let mut whitener = Whitener::new(noise.clone(), MAX_ORDER);
    whitener.set_used(&[true; MAX_ORDER]);
    let mut begin = [[0.0; MAX_ORDER]; MAX_ORDER];
    for j in 0..MAX_ORDER {
        let mut unit = [0.0; MAX_ORDER];
        unit[j] = 1.0;
        whitener.whiten(&mut unit);
        for (row, value) in begin.iter_mut().zip(unit) {
            row[j] = value as f32;
        }
    }
    begin
}

/// The whitening filter in the steady state.
pub(super) struct Whitening {
    pub(super) taps: [f64; MAX_ORDER + 1],
}

impl Whitening {
    /// Whitened samples of a row, from the first with all earlier ones that count.
    fn of<'a>(&'a self, row: &'a [f64]) -> impl Iterator<Item = f64> + 'a {
        let whitened = |from: &[f64; MAX_ORDER + 1]| -> f64 {
            self.taps.iter().zip(from.iter().rev()).map(|(tap, value)| tap * value).sum()
        };
        row.array_windows().map(whitened)
    }
}

/// Fills the templates of a width and position; returns their Fisher matrix.
///
/// Of height, position and width, lower triangle.
fn fill_entry(entry: &mut [f32], widened: &Widened, step: usize, filter: &Whitening) -> [f64; 6] {
    let mut whitened = [[0.0; ROW]; TEMPLATES];
    for (shape, values) in whitened.iter_mut().enumerate() {
        let to = &mut entry[LANES + shape * ROW_STRIDE..];
        for ((value, to), of_row) in values.iter_mut().zip(to).zip(filter.of(widened.row(step, shape))) {
            (*value, *to) = (of_row, of_row as f32);
        }
    }
    let mut fisher = [0.0; 6];
    for k in 0..ROW {
        let row = [whitened[0][k], -whitened[1][k], whitened[3][k]];
        for (f, (i, j)) in fisher.iter_mut().zip(LOWER) {
            *f += row[i] * row[j];
        }
    }
    fisher
}

/// Lower triangle of a 3 x 3 matrix, row by row.
const LOWER: [(usize, usize); 6] = [(0, 0), (1, 0), (1, 1), (2, 0), (2, 1), (2, 2)];

pub(super) fn inverse(m: [f64; 6]) -> [f32; 8] {
    let [aa, at, tt, au, tu, uu] = m;
    let cofactors = [
        tt * uu - tu * tu,
        au * tu - at * uu,
        aa * uu - au * au,
        at * tu - au * tt,
        at * au - aa * tu,
        aa * tt - at * at,
    ];
    let determinant = aa * cofactors[0] + at * cofactors[1] + au * cofactors[3];
    let mut out = [0.0; 8];
    for (out, cofactor) in out.iter_mut().zip(cofactors) {
        *out = (cofactor / determinant) as f32;
    }
    out
}

/// Creates a Gaussian response of the calibrated width.
pub(super) fn gaussian_response(fwhm_samples: f64) -> SystemResponse {
    let reach = (2.5 * fwhm_samples).ceil() as i32;
    let steps = STEPS_PER_SAMPLE as i32;
    let value = |k: i32| (-FOUR_LN_2 * (f64::from(k) / f64::from(steps) / fwhm_samples).powi(2)).exp();
    let values = (-reach * steps..=reach * steps).map(value).collect();
    SystemResponse {
        first_sample: -reach,
        nodes: vec![ResponseNode { peak_dn: 1.0, values }],
        template_error: Vec::new(),
        echoes: 0,
        excess_part: 1.0,
        shape_sd: 0.0,
    }
}
