//! Selection of a few shots, independent of the order of lines.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use wavex_line::scan_line::{Return, flags};
use wavex_line::stage::{DecomposedLine, FittedBlock, FittedShot};

/// Reason why a shot is shown.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ShownKind {
    /// One clear return that agrees with the model.
    Good,
    /// Overlapping returns.
    Overlapping,
    /// Saturated samples.
    Saturated,
    /// The worst fit.
    Worst,
}

/// A shot with its results.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
pub struct ShownShot {
    /// Reason why it is shown.
    pub kind: ShownKind,
    /// Scan line number.
    pub line: u32,
    /// Shot number in the input.
    pub shot: u64,
    /// Time on the input's scale, s; absent if unknown.
    pub gps_time_s: Option<f64>,
    /// Largest deviation ratio of its returns.
    pub deviation_ratio: f64,
    /// Blocks with echoes, in time order.
    pub blocks: Vec<FittedBlock>,
    /// Returns, in time order.
    pub returns: Vec<ShownReturn>,
}

/// Summary of a return.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
pub struct ShownReturn {
    /// Return number, from 1.
    pub number: u8,
    /// Range, m.
    pub range_m: Option<f64>,
    /// Standard deviation of the range, m.
    pub range_sd_m: Option<f64>,
    /// Height above the background, DN.
    pub amplitude_dn: Option<f64>,
    /// Standard deviation of the amplitude, DN.
    pub amplitude_sd_dn: Option<f64>,
    /// Width relative to the system response.
    pub width_ratio: Option<f64>,
    /// Names of its flags.
    pub flags: String,
}

impl From<&Return> for ShownReturn {
    fn from(found: &Return) -> ShownReturn {
        let known = |value: f64| value.is_finite().then_some(value);
        ShownReturn {
            number: found.return_number,
            range_m: known(found.range_m),
            range_sd_m: known(found.range_sd_m),
            amplitude_dn: known(found.amplitude_dn),
            amplitude_sd_dn: known(found.amplitude_sd_dn),
            width_ratio: known(found.width_ratio),
            flags: flags::words(found.flags),
        }
    }
}

/// The best shot of each kind so far; independent of the order of lines.
#[derive(Clone, Debug, Default)]
pub(super) struct Gallery {
    shown: BTreeMap<ShownKind, (Merit, ShownShot)>,
}

/// Suitability of a shot for its kind.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Merit {
    value: f64,
    line: u32,
    shot: u64,
}

impl Merit {
    /// Whether this merit is higher; of equal ones the first wins.
    fn exceeds(&self, other: &Merit) -> bool {
        let earlier = (other.line, other.shot).cmp(&(self.line, self.shot));
        self.value.total_cmp(&other.value).then(earlier).is_gt()
    }
}

/// A shot that improves on the current one of its kind.
#[derive(Clone, Copy, Debug)]
pub(super) struct ShotCandidate {
    kind: ShownKind,
    merit: Merit,
    /// Index of its emission in the line.
    pub(super) emission: u32,
    /// Largest deviation ratio of its returns.
    deviation_ratio: f64,
}

/// Minimum amplitude of a clear return, in standard deviations.
const CLEAR: f64 = 20.0;

impl Gallery {
    /// The best shots of a line, for each kind that they improve.
    pub(super) fn candidates(&self, of: &DecomposedLine) -> Vec<ShotCandidate> {
        let DecomposedLine { line, emissions, returns } = *of;
        let mut best: BTreeMap<ShownKind, ShotCandidate> = BTreeMap::new();
        for of_shot in returns.chunk_by(|a, b| a.emission == b.emission) {
            let Some(emission) = of_shot.first().map(|found| found.emission) else { continue };
            let Some(shot) = emissions.get(emission as usize).map(|emission| emission.shot) else { continue };
            let deviation_ratio = of_shot.iter().map(|found| found.deviation_ratio).fold(f64::MIN, f64::max);
            if !deviation_ratio.is_finite() || deviation_ratio == f64::MIN {
                continue;
            }
            for (kind, value) in merits(of_shot, deviation_ratio).into_iter().flatten() {
                let merit = Merit { value, line, shot };
                let rival = best.get(&kind).map(|best| best.merit);
                let rival = rival.or(self.shown.get(&kind).map(|(merit, _)| *merit));
                if rival.is_none_or(|rival| merit.exceeds(&rival)) {
                    best.insert(kind, ShotCandidate { kind, merit, emission, deviation_ratio });
                }
            }
        }
        best.into_values().collect()
    }

    /// Replaces the current shot of the kind, if this one is still better.
    pub(super) fn show(&mut self, candidate: &ShotCandidate, fitted: FittedShot) {
        let ShotCandidate { kind, merit, deviation_ratio, .. } = *candidate;
        if self.shown.get(&kind).is_some_and(|(kept, _)| !merit.exceeds(kept)) {
            return;
        }
        let gps_time_s = fitted.emission.gps_time_s;
        let shot = ShownShot {
            kind,
            line: merit.line,
            shot: fitted.emission.shot,
            gps_time_s: gps_time_s.is_finite().then_some(gps_time_s),
            deviation_ratio,
            blocks: fitted.blocks,
            returns: fitted.returns.iter().map(ShownReturn::from).collect(),
        };
        self.shown.insert(kind, (merit, shot));
    }

    /// The selected shots, one per kind.
    pub(super) fn finish(self) -> Vec<ShownShot> {
        self.shown.into_values().map(|(_, shot)| shot).collect()
    }
}

/// Kinds that the returns of a shot represent, with their suitability.
fn merits(of_shot: &[Return], deviation_ratio: f64) -> [Option<(ShownKind, f64)>; 4] {
    let any = of_shot.iter().fold(0, |any, found| any | found.flags);
    let with = |flag: u16| of_shot.iter().filter(|found| found.flags & flag != 0).count();
    let usual = -deviation_ratio.abs();
    let is_clear = |found: &Return| {
        found.flags & !flags::REFINED == 0 && found.amplitude_dn >= CLEAR * found.amplitude_sd_dn
    };
    let is_good = of_shot.len() == 1 && of_shot.iter().all(is_clear);
    let is_saturated = any & flags::SATURATED != 0;
    let n_overlapping = with(flags::OVERLAP);
    // More returns rank first, up to four; the deviation ratio decides among equals.
    let overlapping = 1000.0 * n_overlapping.min(4) as f64 + usual.max(-999.0);
    [
        is_good.then_some((ShownKind::Good, usual)),
        (n_overlapping >= 2 && !is_saturated).then_some((ShownKind::Overlapping, overlapping)),
        is_saturated.then_some((ShownKind::Saturated, usual)),
        Some((ShownKind::Worst, deviation_ratio)),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use wavex_line::scan_line::Emission;

    fn found(emission: u32, deviation_ratio: f64, flags: u16) -> Return {
        Return {
            emission,
            deviation_ratio,
            flags,
            amplitude_dn: 100.0,
            amplitude_sd_dn: 1.0,
            ..Return::default()
        }
    }

    fn decomposed() -> (Vec<Emission>, Vec<Return>) {
        let emissions = (0..6).map(|i| Emission { shot: 40 + i, ..Emission::default() }).collect();
        let returns = vec![
            found(0, -0.3, flags::REFINED),
            found(1, 0.1, 0),
            found(2, 0.9, flags::OVERLAP),
            found(2, 0.9, flags::OVERLAP),
            found(3, 2.0, flags::SATURATED),
            found(4, 9.0, flags::TRUNCATED),
            found(5, f64::NAN, 0),
        ];
        (emissions, returns)
    }

    /// Shows the best shots of a line; returns their number.
    fn add(gallery: &mut Gallery, line: u32) -> usize {
        let (emissions, returns) = decomposed();
        let candidates =
            gallery.candidates(&DecomposedLine { line, emissions: &emissions, returns: &returns });
        for candidate in &candidates {
            let emission = emissions[candidate.emission as usize];
            gallery.show(candidate, FittedShot { emission, returns: Vec::new(), blocks: Vec::new() });
        }
        candidates.len()
    }

    fn gallery(lines: &[u32]) -> Gallery {
        let mut gallery = Gallery::default();
        for line in lines {
            add(&mut gallery, *line);
        }
        gallery
    }

    #[test]
    fn each_sort_has_the_shot_that_shows_it_best() {
        let shots: Vec<(ShownKind, u64)> =
            gallery(&[0]).finish().iter().map(|shot| (shot.kind, shot.shot)).collect();
        let [good, overlapping, saturated, worst] = [41, 42, 43, 44];
        let wanted = [
            (ShownKind::Good, good),
            (ShownKind::Overlapping, overlapping),
            (ShownKind::Saturated, saturated),
            (ShownKind::Worst, worst),
        ];
        assert_eq!(shots, wanted);
    }

    #[test]
    fn of_shots_that_are_alike_the_first_is_shown_whoever_saw_it() {
        let wanted = gallery(&[3, 4, 5]).finish();
        assert!(wanted.iter().all(|shot| shot.line == 3));
        assert_eq!(gallery(&[5, 3, 4]).finish(), wanted);
        assert_eq!(add(&mut gallery(&[3]), 4), 0, "shots that are not better are not fitted again");
    }

    #[test]
    fn returns_of_no_emission_are_passed_over() {
        let line = DecomposedLine { line: 0, emissions: &[], returns: &decomposed().1 };
        assert!(Gallery::default().candidates(&line).is_empty());
    }
}
