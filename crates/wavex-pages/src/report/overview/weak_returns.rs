//! Weak returns behind strong ones, by distance and relative amplitude.
//!
//! Targets lie at any distance behind others. Weak returns that pile up at one distance behind strong
//! ones, with similar relative amplitudes, come from the receiver or from an error of its response.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use wavex_line::scan_line::{Return, ScanLine};
use wavex_line::stage::packed;

/// Smallest amplitude of a strong return, in its standard deviations.
const STRONG: f64 = 100.0;
/// Largest amplitude of a weak return relative to a strong one: a power of 1/2.
const WEAK_OCTAVE: i32 = -4;
/// Number of octaves of relative amplitudes.
const OCTAVES: usize = 6;
/// Number of lags, each one pulse width.
const LAGS: usize = 40;
/// First lag at which a pile-up counts; returns before it overlap.
const FIRST_LAG: usize = 2;
/// Lags joined in the search: a pile-up may lie across an edge.
const JOINED: usize = 2;
/// Smallest ratio of a pile-up to the median over all lags.
const OVER_MEDIAN: f64 = 4.0;
/// Fewest returns of a pile-up: chance alone does not reach it.
const LEAST_RETURNS: u64 = 20;

/// Counts of weak returns behind strong ones.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
pub struct WeakReturns {
    /// Number of shots with a strong return: at least 100 standard deviations of its amplitude.
    pub strong_shots: u64,
    /// Calibrated pulse width, ns: the bin of the lag.
    pub pulse_fwhm_ns: f64,
    /// Number of returns of at most 1/16 of the strongest return before them, by lag in pulse widths and
    /// relative amplitude: six octaves downwards for each lag; the last one includes weaker returns.
    #[serde(serialize_with = "packed::serialize", deserialize_with = "packed::deserialize")]
    #[schemars(with = "String")]
    pub counts: Vec<u64>,
}

/// Weak returns that pile up at one distance behind strong ones.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in crate::report) struct PileUp {
    /// First and last lag, ns.
    pub(in crate::report) lag_ns: [f64; 2],
    /// Shots with such a return, of the shots with a strong one, %.
    pub(in crate::report) percent: f64,
}

/// Collects [`WeakReturns`] line by line.
#[derive(Clone, Debug, Default)]
pub(super) struct WeakReturnCounts {
    strong_shots: u64,
    pulse_fwhm_ns: Option<f64>,
    counts: Vec<u64>,
}

impl WeakReturnCounts {
    pub(super) fn add(&mut self, line: &ScanLine, returns: &[Return]) {
        let model =
            line.model.as_deref().and_then(|model| model.low_power.as_ref().or(model.high_power.as_ref()));
        let Some(model) = model else { return };
        let fwhm_ns = *self.pulse_fwhm_ns.get_or_insert(model.pulse_fwhm_ns);
        self.counts.resize(LAGS * OCTAVES, 0);
        let is_copy = |shot: &&[Return]| {
            line.emissions.get(shot[0].emission as usize).is_some_and(|emission| emission.is_copy())
        };
        let shots = returns.chunk_by(|a, b| a.emission == b.emission).filter(|shot| !is_copy(shot));
        shots.for_each(|shot| self.add_shot(shot, fwhm_ns));
    }

    fn add_shot(&mut self, shot: &[Return], fwhm_ns: f64) {
        let Some(at) = (0..shot.len()).max_by(|&i, &j| shot[i].amplitude_dn.total_cmp(&shot[j].amplitude_dn))
        else {
            return;
        };
        let strong = &shot[at];
        let is_strong = strong.amplitude_dn >= STRONG * strong.amplitude_sd_dn;
        if !is_strong {
            return;
        }
        self.strong_shots += 1;
        for weak in &shot[at + 1..] {
            let lag = (weak.time_of_flight_ns - strong.time_of_flight_ns) / fwhm_ns;
            let octave = f64::from(WEAK_OCTAVE) - libm::log2(weak.amplitude_dn / strong.amplitude_dn);
            if octave >= 0.0 && (0.0..LAGS as f64).contains(&lag) {
                self.counts[lag as usize * OCTAVES + (octave as usize).min(OCTAVES - 1)] += 1;
            }
        }
    }

    /// The counts; `None` without strong returns.
    pub(super) fn finish(self) -> Option<WeakReturns> {
        let WeakReturnCounts { strong_shots, pulse_fwhm_ns, counts } = self;
        let is_known = strong_shots > 0;
        pulse_fwhm_ns.filter(|_| is_known).map(|pulse_fwhm_ns| WeakReturns {
            strong_shots,
            pulse_fwhm_ns,
            counts,
        })
    }
}

impl WeakReturns {
    /// Number of weak returns by lag.
    pub(in crate::report) fn by_lag(&self) -> Vec<u64> {
        self.counts.chunks(OCTAVES).map(saturating_sum).collect()
    }

    /// The largest pile-up; 0 % without one that exceeds the returns at other lags clearly.
    pub(in crate::report) fn pile_up(&self) -> PileUp {
        let by_lag = self.by_lag();
        let joined: Vec<u64> = by_lag.windows(JOINED).skip(FIRST_LAG).map(saturating_sum).collect();
        let mut sorted = joined.clone();
        sorted.sort_unstable();
        let median = sorted.get(sorted.len() / 2).copied().unwrap_or(0);
        let largest = (0..joined.len()).max_by_key(|&i| joined[i]).unwrap_or(0);
        let count = joined.get(largest).copied().unwrap_or(0);
        let first = (FIRST_LAG + largest) as f64;
        let is_clear = count >= LEAST_RETURNS && count as f64 > OVER_MEDIAN * median as f64;
        PileUp {
            lag_ns: [first, first + JOINED as f64].map(|lag| lag * self.pulse_fwhm_ns),
            percent: if is_clear { 100.0 * count as f64 / self.strong_shots.max(1) as f64 } else { 0.0 },
        }
    }
}

/// Sum of counts, which a report may state as any number.
fn saturating_sum(counts: &[u64]) -> u64 {
    counts.iter().fold(0, |sum, count| sum.saturating_add(*count))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Shots with a return of 200 DN and weak ones at these lags, widths, and relative amplitudes.
    fn counted(shots: usize, weak: impl Fn(usize) -> Option<(f64, f64)>) -> WeakReturns {
        let mut counted = WeakReturnCounts { counts: vec![0; LAGS * OCTAVES], ..WeakReturnCounts::default() };
        counted.pulse_fwhm_ns = Some(5.0);
        let of = |lag: f64, amplitude_dn: f64| Return {
            time_of_flight_ns: 1000.0 + 5.0 * lag,
            amplitude_dn,
            amplitude_sd_dn: 1.0,
            ..Return::default()
        };
        for i in 0..shots {
            let mut shot = vec![of(0.0, 200.0)];
            shot.extend(weak(i).map(|(lag, part)| of(lag, part * 200.0)));
            counted.add_shot(&shot, 5.0);
        }
        counted.finish().unwrap()
    }

    #[test]
    fn weak_returns_at_one_distance_are_a_pile_up() {
        // One in seven shots has a return of 2 % at 9.2 to 10.6 widths.
        let found = counted(700, |i| (i % 7 == 0).then_some((9.2 + 0.002 * i as f64, 0.02)));
        let pile_up = found.pile_up();
        assert_eq!((pile_up.lag_ns, found.strong_shots), ([45.0, 55.0], 700));
        assert!((pile_up.percent - 100.0 / 7.0).abs() < 0.01, "{pile_up:?}");
    }

    #[test]
    fn targets_at_any_distance_are_none() {
        let found = counted(2000, |i| Some((2.0 + 38.0 * (i as f64 * 0.618).fract(), 0.03)));
        assert_eq!(found.pile_up().percent, 0.0);
        // Returns of an eighth are not weak.
        assert_eq!(counted(500, |_| Some((9.0, 0.125))).pile_up().percent, 0.0);
        // A few are chance.
        assert_eq!(counted(500, |i| (i < 19).then_some((9.0, 0.01))).pile_up().percent, 0.0);
    }
}
