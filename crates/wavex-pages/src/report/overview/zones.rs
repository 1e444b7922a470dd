//! MTA overview: returns by zone, and some shots as they would appear in each zone.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use wavex_line::scan_line::{Emission, Return, ScanLine, flags::ZONE_UNCERTAIN};
use wavex_line::stage::packed;

/// Returns by MTA zone.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
pub struct Zones {
    /// Zones with returns, in ascending order.
    pub shares: Vec<ZoneShare>,
    /// Ranges of some shots in each candidate zone, if the clocks allow it.
    pub clouds: Option<ZoneClouds>,
}

/// Returns of a zone.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
pub struct ZoneShare {
    /// Number of emissions between the causing shot and the reception; -1 if unresolved.
    pub zone: i16,
    /// Number of returns.
    pub returns: u64,
    /// Number of returns assigned on weak evidence.
    pub uncertain: u64,
}

/// Consecutive shots of one scan line, computed for each candidate zone.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
pub struct ZoneClouds {
    /// Scan line number.
    pub line: u32,
    /// One cloud per candidate zone, in ascending order.
    pub clouds: Vec<ZoneCloud>,
}

/// Last returns of these shots, computed for one zone.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
pub struct ZoneCloud {
    /// The zone.
    pub zone: i16,
    /// Pairs of causing shot, counted from the first shot, and range, m; separated by spaces.
    #[serde(serialize_with = "packed::serialize", deserialize_with = "packed::deserialize")]
    #[schemars(with = "String")]
    pub points: Vec<f64>,
    /// Median range difference of neighbouring shots, m; smallest in the true zone if intervals
    /// vary.
    pub roughness_m: Option<f64>,
}

/// Number of shots in a cloud.
const SHOTS: usize = 400;
/// Number of candidate zones.
const CLOUDS: i16 = 6;
/// Minimum number of returns of a cloud.
const LEAST_RETURNS: usize = 20;

/// Counts collected while lines leave the chain.
#[derive(Clone, Debug, Default)]
pub(super) struct ZoneCounts {
    /// Number of returns, and of uncertain ones, by zone.
    shares: BTreeMap<i16, [u64; 2]>,
    /// The line with the most returns so far, the first of equals: its number of returns, and its
    /// last returns.
    best: Option<(usize, LineSection)>,
}

/// The middle section of a line.
#[derive(Clone, Debug)]
struct LineSection {
    line: u32,
    /// Shot number and emission time, ns after the first shot.
    shots: Vec<(u64, f64)>,
    /// Index in `shots`, zone and range of last returns.
    returns: Vec<(usize, i16, f64)>,
    m_per_ns: f64,
}

impl ZoneCounts {
    pub(super) fn add(&mut self, scan_line: &ScanLine, returns: &[Return]) {
        for found in returns {
            let share = self.shares.entry(found.mta_zone).or_default();
            share[0] += 1;
            share[1] += u64::from(found.flags & ZONE_UNCERTAIN != 0);
        }
        let is_better = |(most, window): &(usize, LineSection)| {
            returns.len() > *most || (returns.len() == *most && scan_line.line < window.line)
        };
        if self.best.as_ref().is_none_or(is_better) && returns.iter().any(|found| found.mta_zone > 0) {
            self.best = Some((returns.len(), LineSection::of(scan_line, returns)));
        }
    }

    /// Returns the zones; `None` if all returns are in zone 0, so that nothing was resolved.
    pub(super) fn finish(self) -> Option<Zones> {
        self.shares.keys().any(|zone| *zone > 0).then(|| {
            let share =
                |(&zone, &[returns, uncertain]): (&i16, &[u64; 2])| ZoneShare { zone, returns, uncertain };
            let most =
                self.shares.iter().max_by_key(|(_, [returns, _])| *returns).map_or(0, |(zone, _)| *zone);
            Zones {
                shares: self.shares.iter().map(share).collect(),
                clouds: self.best.and_then(|(_, window)| window.clouds(most)),
            }
        })
    }
}

impl LineSection {
    fn of(scan_line: &ScanLine, returns: &[Return]) -> LineSection {
        let emissions = &scan_line.emissions;
        let from = emissions.len().saturating_sub(SHOTS) / 2;
        let until = (from + SHOTS).min(emissions.len());
        let first_ps = emissions.get(from).map_or(0, |first| first.clock_ps);
        let left = |emission: &Emission| {
            let after_ns = emission.clock_ps.saturating_sub(first_ps) as f64 / 1000.0;
            (emission.shot, after_ns + emission.emission_ns)
        };
        let is_last = |found: &&Return| {
            found.return_number == found.number_of_returns && found.mta_zone >= 0 && !found.withheld
        };
        let within = returns.iter().filter(is_last).filter_map(|found| {
            let shot = found.emission as usize;
            (from..until).contains(&shot).then(|| (shot - from, found.mta_zone, found.range_m))
        });
        LineSection {
            line: scan_line.line,
            shots: emissions[from..until].iter().map(left).collect(),
            returns: within.collect(),
            m_per_ns: 0.5e-9 * scan_line.input.group_velocity_mps,
        }
    }

    /// Clouds for the zones around the most frequent one.
    fn clouds(&self, most: i16) -> Option<ZoneClouds> {
        let first = (most - CLOUDS + 2).max(0);
        let clouds: Vec<ZoneCloud> = (first..first + CLOUDS).map(|zone| self.cloud(zone)).collect();
        let is_enough = clouds.iter().any(|cloud| cloud.points.len() >= 2 * LEAST_RETURNS);
        is_enough.then_some(ZoneClouds { line: self.line, clouds })
    }

    /// Ranges as if all shots had this zone.
    fn cloud(&self, zone: i16) -> ZoneCloud {
        let place = |&(shot, of_return, range_m): &(usize, i16, f64)| {
            let other = shot.checked_add_signed(isize::from(of_return) - isize::from(zone))?;
            let ((number, left_ns), (cause, cause_ns)) = (*self.shots.get(shot)?, *self.shots.get(other)?);
            let is_counted = cause.abs_diff(number) == u64::from(of_return.abs_diff(zone));
            let range_m = range_m + (left_ns - cause_ns) * self.m_per_ns;
            (is_counted && range_m > 0.0).then_some((other, range_m))
        };
        let mut places: Vec<(usize, f64)> = self.returns.iter().filter_map(place).collect();
        places.sort_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)));
        let neighbours = places.windows(2).filter(|pair| pair[1].0 == pair[0].0 + 1);
        let mut apart_m: Vec<f64> = neighbours.map(|pair| (pair[1].1 - pair[0].1).abs()).collect();
        apart_m.sort_by(f64::total_cmp);
        ZoneCloud {
            zone,
            points: places.into_iter().flat_map(|(shot, range_m)| [shot as f64, range_m]).collect(),
            roughness_m: apart_m.get(apart_m.len() / 2).copied(),
        }
    }
}
