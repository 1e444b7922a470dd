//! Statistics of the assignment, of constant size.

use super::held::Held;
use super::pulses::REGULAR_PART;
use super::{Assigned, Method, MtaError, Prior, Settings};

/// Number of counters for zones; the last also counts all larger zones.
const ZONES: usize = 128;
/// Number of margin bins of 1 nat.
const MARGINS: usize = 200;
/// RMS variation of the intervals below which zones cannot be distinguished, ns.
const LEAST_MODULATION_NS: f64 = 0.5;
/// RMS variation below which a prior is advisable, ns.
const WEAK_MODULATION_NS: f64 = 5.0;
/// Range difference above which neighbouring echoes are on different surfaces, m.
const NEIGHBOURS_M: f64 = 5.0;
/// Fraction of the recorded variation below which clock jitter is reported.
///
/// The deficit must also exceed this many standard deviations.
const LEAST_FOLLOWING: f64 = 0.5;
const FOLLOWING_SDS: f64 = 4.0;
/// Median margin below which the zones are unreliable, nats.
const WEAK_MARGIN_NATS: f64 = 10.0;

/// Counts over all finished lines.
#[derive(Debug, Clone, PartialEq)]
pub struct Summary {
    /// Echoes by zone; the last entry also counts all larger zones.
    pub zones: Vec<u64>,
    /// Number of echoes.
    pub echoes: u64,
    /// Echoes without a feasible emission.
    pub without_cause: u64,
    /// Echoes with weak evidence, including those without a cause.
    pub uncertain: u64,
    /// Echoes in a blind gap.
    pub in_blind_gap: u64,
    /// Echoes by margin in bins of 1 nat from 0; the last entry also counts all larger margins.
    pub margins: Vec<u64>,
    intervals: u64,
    interval_sum_ps: f64,
    deviation_sum_ps2: f64,
    /// Sums over neighbouring echoes: products of emission-time deviation and range difference, m²;
    /// squares of the former, m²; squares of the products, m⁴.
    products_m2: f64,
    departures_m2: f64,
    products_m4: f64,
}

impl Default for Summary {
    fn default() -> Summary {
        Summary {
            zones: vec![0; ZONES],
            echoes: 0,
            without_cause: 0,
            uncertain: 0,
            in_blind_gap: 0,
            margins: vec![0; MARGINS],
            intervals: 0,
            interval_sum_ps: 0.0,
            deviation_sum_ps2: 0.0,
            products_m2: 0.0,
            departures_m2: 0.0,
            products_m4: 0.0,
        }
    }
}

/// Reasons to distrust the zones.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Warning {
    /// The median margin is low.
    WeakEvidence {
        /// The median margin, nats.
        median_margin_nats: f64,
    },
    /// Pulse intervals vary little and there is no prior.
    WeakModulation {
        /// RMS variation of the intervals, ns.
        rms_ns: f64,
    },
}

impl std::fmt::Display for Warning {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Warning::WeakEvidence { median_margin_nats } => write!(
                f,
                "the median margin over the second-best zone is only {median_margin_nats:.0} nats: give a prior"
            ),
            Warning::WeakModulation { rms_ns } => write!(
                f,
                "pulse intervals vary by only {rms_ns:.2} ns RMS and there is no prior: check the margins, or give a prior"
            ),
        }
    }
}

impl Summary {
    /// Adds a line's intervals without lost records.
    pub(super) fn add_line(&mut self, line: &Held) {
        let usual = line.pulses.interval_ps;
        let regular = || {
            let intervals =
                line.pulses.own_clocks().windows(2).map(|pair| pair[1].saturating_sub(pair[0]) as f64);
            intervals.filter(move |interval| (interval - usual).abs() <= REGULAR_PART * usual)
        };
        let count = regular().count() as u64;
        if count > 0 {
            let sum: f64 = regular().sum();
            let mean = sum / count as f64;
            self.intervals += count;
            self.interval_sum_ps += sum;
            self.deviation_sum_ps2 += regular().map(|interval| (interval - mean).powi(2)).sum::<f64>();
        }
    }

    /// Adds the range differences of neighbouring echoes; `causes` are in the order of
    /// [`Held::echoes`].
    pub(super) fn add_differences(&mut self, line: &Held, causes: &[Option<usize>], settings: &Settings) {
        let pulses = &line.pulses;
        let caused = line.echoes.iter().zip(causes).filter_map(|(echo, cause)| {
            let place = (*cause)?;
            Some((place, f64::from(pulses.offset_m[place]), f64::from(line.range_m(echo, place, settings))))
        });
        let caused: Vec<_> = caused.collect();
        let differences = caused.windows(2).filter(|pair| pair[0].0 != pair[1].0);
        let differences: Vec<(f64, f64)> = differences
            .map(|pair| (pair[1].1 - pair[0].1, pair[1].2 - pair[0].2))
            .filter(|(departure_m, range_m)| {
                // Pairs across a lost record or an edge carry no information.
                departure_m.abs() <= REGULAR_PART * f64::from(pulses.interval_m)
                    && range_m.abs() <= NEIGHBOURS_M
            })
            .collect();
        let count = differences.len().max(1) as f64;
        let mean = |of: fn(&(f64, f64)) -> f64| differences.iter().map(of).sum::<f64>() / count;
        let means_m = (mean(|pair| pair.0), mean(|pair| pair.1));
        for (departure_m, range_m) in &differences {
            let departure_m = departure_m - means_m.0;
            let product_m2 = departure_m * (range_m - means_m.1);
            self.products_m2 += product_m2;
            self.departures_m2 += departure_m * departure_m;
            self.products_m4 += product_m2 * product_m2;
        }
    }

    /// Fraction of the recorded interval variation present in the ranges, and its standard
    /// deviation.
    ///
    /// 1 if pulses left at the recorded times and zones are right; 0 if no echo follows the
    /// recorded variation. NaN before there were neighbours.
    pub fn following(&self) -> (f64, f64) {
        (1.0 + self.products_m2 / self.departures_m2, self.products_m4.sqrt() / self.departures_m2)
    }

    /// Checks that ranges follow the recorded interval variation.
    ///
    /// Otherwise the recorded times vary and not the emissions.
    pub(super) fn check_clock(&self, settings: &Settings) -> Result<(), MtaError> {
        let (following, sd) = self.following();
        if settings.prior == Prior::None
            && following < LEAST_FOLLOWING
            && 1.0 - following > FOLLOWING_SDS * sd
        {
            return Err(MtaError::JitteringClock { rms_ns: self.interval_rms_ns(), following });
        }
        Ok(())
    }

    pub(super) fn add(&mut self, echo: &Assigned, settings: &Settings) {
        self.echoes += 1;
        match echo.cause {
            Some(_) => self.zones[usize::from(echo.zone).min(ZONES - 1)] += 1,
            None => self.without_cause += 1,
        }
        self.uncertain += u64::from(echo.uncertain);
        self.in_blind_gap += u64::from(echo.in_blind_gap);
        if !matches!(settings.method, Method::Fixed(_)) {
            let margin = echo.margin_nats.clamp(0.0, (MARGINS - 1) as f32);
            self.margins[margin as usize] += 1;
        }
    }

    /// Mean interval between emissions, ns; NaN before the first.
    pub fn interval_ns(&self) -> f64 {
        self.interval_sum_ps / self.intervals as f64 * 1e-3
    }

    /// RMS variation of intervals within a line, ns, without lost records; NaN before two
    /// intervals.
    pub fn interval_rms_ns(&self) -> f64 {
        if self.intervals < 2 {
            return f64::NAN;
        }
        (self.deviation_sum_ps2 / self.intervals as f64).sqrt() * 1e-3
    }

    /// Median margin, nats, rounded down; `None` before the first echo.
    pub(crate) fn median_margin_nats(&self) -> Option<f64> {
        let count: u64 = self.margins.iter().sum();
        let mut below = 0;
        let bin = self.margins.iter().position(|&bin| {
            below += bin;
            count > 0 && 2 * below >= count
        });
        bin.map(|bin| bin as f64)
    }

    /// Checks that zones are distinguishable by pulse rate or prior.
    pub(super) fn check_rate(&self, settings: &Settings) -> Result<(), MtaError> {
        let rms_ns = self.interval_rms_ns();
        if settings.prior == Prior::None && rms_ns < LEAST_MODULATION_NS {
            let interval_ns = self.interval_ns();
            return Err(MtaError::ConstantRate { interval_ns, rms_ns, least_ns: LEAST_MODULATION_NS });
        }
        Ok(())
    }

    pub(super) fn warnings(&self, settings: &Settings) -> Vec<Warning> {
        if matches!(settings.method, Method::Fixed(_)) {
            return Vec::new();
        }
        let mut warnings = Vec::new();
        if let Some(median_margin_nats) =
            self.median_margin_nats().filter(|&margin| margin < WEAK_MARGIN_NATS)
        {
            warnings.push(Warning::WeakEvidence { median_margin_nats });
        }
        let rms_ns = self.interval_rms_ns();
        if settings.prior == Prior::None && rms_ns < WEAK_MODULATION_NS {
            warnings.push(Warning::WeakModulation { rms_ns });
        }
        warnings
    }
}
