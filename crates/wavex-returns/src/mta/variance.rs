//! The method `Variance`: the zone with the least variance of consecutive ranges in a circular
//! buffer.
//!
//! All zones are followed in parallel. At each echo the chain of a zone continues with its own zone
//! or an adjacent one, whichever is nearest to its last range, and so follows a surface through a
//! change of zone. A buffer holds the squared differences of its consecutive ranges; a second buffer
//! holds those of the zone alone. If the first is faulty, it is overwritten with the second. The
//! chain with the least sum decides the echo in the middle of the buffer. Every second line is
//! processed from its other end, so that consecutive lines connect; revolutions connect without
//! this. This is the method of HydroVISH's documentation, which gives a buffer length of 50 and does
//! not specify when a buffer is faulty. tests/python/mta_variance.py is the same in NumPy.

use std::collections::VecDeque;

use super::held::{Held, HeldEcho};
use super::pending;
use super::summary::Summary;
use super::{MtaError, Prior, Resolved, Settings};

/// Largest number of lines held back.
const MOST_LINES: usize = 64;
/// Number of adjacent zones on either side of a chain's own.
const OVERLAP: usize = 1;
/// A buffer with overlap is faulty if the zone alone has less than this part of its sum.
///
/// Sums in vegetation differ by chance. If the smaller one were always taken, each wrong zone would
/// have two chances to have the least.
const FAULTY_PART: f64 = 0.5;
/// Variances below this are treated as equal, m².
const LEAST_VARIANCE_M2: f64 = 1e-6;
const LEAST_MARGIN_NATS: f32 = 5.0;
/// Largest zone.
const MOST_ZONES: f64 = 125.0;
const PRIOR_CAP_NATS: f64 = 50.0;

/// The last squared differences and their sum.
#[derive(Debug, Clone)]
struct Ring {
    values: Vec<f64>,
    next: usize,
    sum: f64,
}

impl Ring {
    fn new(length: usize) -> Ring {
        Ring { values: vec![0.0; length], next: 0, sum: 0.0 }
    }

    fn add(&mut self, value: f64) {
        self.sum += value - self.values[self.next];
        self.values[self.next] = value;
        self.next += 1;
        // Recomputed once per round, so that rounding errors from large values do not persist.
        if self.next == self.values.len() {
            self.next = 0;
            self.sum = self.values.iter().sum();
        }
    }
}

/// The chain of one zone.
#[derive(Debug, Clone)]
struct ZoneChain {
    /// Buffer including adjacent zones, then of the zone alone.
    overlapping: Ring,
    alone: Ring,
    last_m: f64,
    last_alone_m: f64,
}

/// A pending line and the decisions for its echoes: index of the cause, and margin.
#[derive(Debug)]
struct Waiting {
    line: Held,
    decided: Vec<(Option<usize>, f32)>,
}

/// The state of the method.
#[derive(Debug)]
pub(super) struct Variance {
    settings: Settings,
    half: usize,
    lines: VecDeque<Waiting>,
    chains: Vec<ZoneChain>,
    length: usize,
    /// Echoes that wait for the second half of the buffer: line, and index in it.
    pending: VecDeque<(u64, u32)>,
    /// For each pending echo, the zone with which each chain continued.
    zones: VecDeque<u8>,
}

impl Variance {
    pub fn new(settings: &Settings, length: usize) -> Variance {
        Variance {
            settings: *settings,
            half: length / 2,
            lines: VecDeque::new(),
            chains: Vec::new(),
            length,
            pending: VecDeque::new(),
            zones: VecDeque::new(),
        }
    }

    pub fn look_ahead_lines(&self) -> usize {
        MOST_LINES
    }

    pub fn push(
        &mut self,
        line: Held,
        summary: &mut Summary,
        ready: &mut VecDeque<Resolved>,
    ) -> Result<(), MtaError> {
        self.take(line);
        while self.lines.len() > MOST_LINES {
            let front = self.lines.front().map(|waiting| waiting.line.number);
            while self.pending.front().is_some_and(|&(line, _)| Some(line) == front) {
                self.decide_first();
            }
            self.finish_first(summary, ready)?;
        }
        let first_pending = self.pending.front().map_or(u64::MAX, |&(line, _)| line);
        // The last line waits for the emissions that follow it.
        while self.lines.len() > 1
            && self.lines.front().is_some_and(|waiting| waiting.line.number < first_pending)
        {
            self.finish_first(summary, ready)?;
        }
        Ok(())
    }

    pub fn finish(&mut self, summary: &mut Summary, ready: &mut VecDeque<Resolved>) -> Result<(), MtaError> {
        while !self.pending.is_empty() {
            self.decide_first();
        }
        while !self.lines.is_empty() {
            self.finish_first(summary, ready)?;
        }
        Ok(())
    }

    /// Adds a line's echoes to the chains; decides echoes whose second half of the buffer is full.
    fn take(&mut self, line: Held) {
        let (number, count, is_ring) = (line.number, line.echoes.len(), line.ring > 0);
        if self.chains.is_empty() && count > 0 {
            let most = self.settings.range_m[1] / f64::from(line.pulses.interval_m);
            let zones = most.ceil().clamp(1.0, MOST_ZONES) as usize + 1;
            self.chains = vec![ZoneChain::new(self.length); zones];
        }
        let mut ranges = vec![f64::NAN; self.chains.len()];
        self.lines.push_back(Waiting { line, decided: vec![(None, 0.0); count] });
        for turn in 0..count {
            let i = if number % 2 == 0 || is_ring { turn } else { count - 1 - turn };
            if let Some(Waiting { line, .. }) = self.lines.back() {
                ranges_of(line, &line.echoes[i], &self.settings, &mut ranges);
            }
            self.extend(&ranges);
            self.pending.push_back((number, i as u32));
            while self.pending.len() > self.half {
                self.decide_first();
            }
        }
    }

    /// Continues every chain with an echo, given its ranges by zone.
    fn extend(&mut self, ranges: &[f64]) {
        for (zone, chain) in self.chains.iter_mut().enumerate() {
            let beside = zone.saturating_sub(OVERLAP)..(zone + OVERLAP + 1).min(ranges.len());
            let apart = |other: usize| (ranges[other] - chain.last_m).abs();
            let other = beside.min_by(|&a, &b| apart(a).total_cmp(&apart(b))).unwrap_or(zone);
            let other = if chain.last_m.is_nan() { zone } else { other };
            self.zones.push_back(other as u8);
            chain.go_on(ranges[other], ranges[zone]);
        }
    }

    /// Decides the oldest pending echo from the present buffers.
    fn decide_first(&mut self) {
        let Some((number, i)) = self.pending.pop_front() else { return };
        let zones: Vec<u8> = self.zones.drain(..self.chains.len()).collect();
        let first = self.lines.front().map_or(0, |waiting| waiting.line.number);
        let Some(waiting) = self.lines.get_mut((number - first) as usize) else { return };
        let (line, echo) = (&waiting.line, &waiting.line.echoes[i as usize]);
        let count = self.length as f64;
        let cost = |chain: &ZoneChain, zone: usize| {
            let variance = (chain.overlapping.sum / count).max(LEAST_VARIANCE_M2);
            0.5 * count * variance.ln() + prior_nats(line, echo, zone, &self.settings)
        };
        let [nearest_m, farthest_m] = self.settings.range_m;
        let is_possible = |zone: usize| {
            let range_m = place(echo, zone).map(|place| f64::from(line.range_m(echo, place, &self.settings)));
            range_m.is_some_and(|range_m| (nearest_m..=farthest_m).contains(&range_m))
        };
        let mut costs = vec![f64::INFINITY; self.chains.len()];
        // Chains count for their own zones if they all continued with impossible ones.
        for is_own in [false, true] {
            for (own, (chain, &zone)) in self.chains.iter().zip(&zones).enumerate() {
                let zone = if is_own { own } else { usize::from(zone) };
                if is_possible(zone) {
                    costs[zone] = costs[zone].min(cost(chain, zone));
                }
            }
            if costs.iter().any(|cost| cost.is_finite()) {
                break;
            }
        }
        let Some(best) = (0..costs.len()).min_by(|&a, &b| costs[a].total_cmp(&costs[b])) else { return };
        let least = std::mem::replace(&mut costs[best], f64::INFINITY);
        if least.is_finite() {
            let second = costs.iter().copied().fold(f64::INFINITY, f64::min);
            waiting.decided[i as usize] = (place(echo, best), (second - least) as f32);
        }
    }

    fn finish_first(
        &mut self,
        summary: &mut Summary,
        ready: &mut VecDeque<Resolved>,
    ) -> Result<(), MtaError> {
        summary.check_rate(&self.settings)?;
        let Some(Waiting { line, decided }) = self.lines.pop_front() else { return Ok(()) };
        let next = self.lines.front().map(|waiting| &waiting.line);
        let assigned = line.echoes.iter().zip(&decided).map(|(echo, &(place, margin))| {
            let last = line.last_emission(echo, next);
            let uncertain = place.is_none() || margin < LEAST_MARGIN_NATS;
            (echo.input, line.assigned(echo, place, margin, uncertain, &last, &self.settings))
        });
        ready.push_back(pending::finish(&line, assigned, next, &self.settings, summary));
        Ok(())
    }
}

impl ZoneChain {
    fn new(length: usize) -> ZoneChain {
        let ring = Ring::new(length);
        ZoneChain { overlapping: ring.clone(), alone: ring, last_m: f64::NAN, last_alone_m: f64::NAN }
    }

    /// Continues with a range of the chain's or an adjacent zone, and with that of the zone alone.
    fn go_on(&mut self, range_m: f64, alone_m: f64) {
        if self.last_m.is_finite() {
            self.overlapping.add((range_m - self.last_m).powi(2));
            self.alone.add((alone_m - self.last_alone_m).powi(2));
        }
        (self.last_m, self.last_alone_m) = (range_m, alone_m);
        if self.alone.sum < FAULTY_PART * self.overlapping.sum {
            self.overlapping.clone_from(&self.alone);
            self.last_m = alone_m;
        }
    }
}

/// Emission of a zone; `None` beyond the line's last emission, where zones continue at even
/// intervals.
fn place(echo: &HeldEcho, zone: usize) -> Option<usize> {
    let place = usize::try_from(echo.base).ok()?.checked_sub(zone)?;
    (place <= echo.last as usize).then_some(place)
}

/// Range of an echo in each zone, m; at even intervals where there is no emission.
fn ranges_of(line: &Held, echo: &HeldEcho, settings: &Settings, ranges: &mut [f64]) {
    let m_per_ns = 0.5e-9 * settings.group_velocity_mps;
    let interval_m = f64::from(line.pulses.interval_m);
    for (zone, range_m) in ranges.iter_mut().enumerate() {
        *range_m = match place(echo, zone) {
            Some(place) => line.flight_ns(echo, place) * m_per_ns,
            None => f64::from(echo.range_m) + zone as f64 * interval_m,
        };
    }
}

/// Cost of a zone under the prior, nats.
fn prior_nats(line: &Held, echo: &HeldEcho, zone: usize, settings: &Settings) -> f64 {
    let sd_m = match settings.prior {
        Prior::None => return 0.0,
        Prior::Agl { sd_m, .. } | Prior::PerEmission { sd_m } => sd_m,
    };
    let expected = place(echo, zone).and_then(|place| Some((place, *line.pulses.expected_m.get(place)?)));
    match expected.filter(|(_, expected_m)| expected_m.is_finite()) {
        Some((place, expected_m)) => {
            let apart = f64::from(line.range_m(echo, place, settings) - expected_m) / sd_m;
            (0.5 * apart * apart).min(PRIOR_CAP_NATS)
        }
        None => 0.0,
    }
}
