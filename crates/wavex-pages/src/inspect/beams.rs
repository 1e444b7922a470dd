//! Beams of an instrument with several: shots, flags and noise as the file records them.

use schemars::JsonSchema;
use serde::Serialize;

use wavex_line::scan_line::{FootprintRecord, ScanLine};

/// Column of the flag for degraded pointing or positioning.
const DEGRADED: &str = "degrade";
/// Column of the flag for a waveform that repeats an older one.
const STALE: &str = "stale_return_flag";

/// Shots of one beam.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct BeamSummary {
    /// Name as in the file.
    pub name: String,
    /// Power: full or coverage; null if beams do not differ.
    pub power: Option<&'static str>,
    /// Number of shots.
    pub shots: u64,
    /// Shots with the flag `degrade`; null if the file has no such flag.
    pub degraded_shots: Option<u64>,
    /// Shots with the flag `stale_return_flag`; null if the file has no such flag.
    pub stale_shots: Option<u64>,
    /// Background that the file records, mean of the shots, DN.
    pub recorded_noise_mean_dn: Option<f64>,
    /// Standard deviation of the noise that the file records, mean of the shots, DN.
    pub recorded_noise_sd_dn: Option<f64>,
    /// Earliest time of a shot, s.
    pub first_shot_s: Option<f64>,
    /// Latest time of a shot, s.
    pub last_shot_s: Option<f64>,
    /// Shots whose noise is recorded.
    #[serde(skip)]
    with_noise: u64,
}

impl BeamSummary {
    /// Creates the summary of the beam of a line; `None` if the instrument names none.
    pub(super) fn of(line: &ScanLine) -> Option<BeamSummary> {
        let input = &line.input;
        let flag = |name: &str| input.columns.contains(&name).then_some(0);
        Some(BeamSummary {
            name: input.beam.clone()?,
            power: input.beam_power,
            shots: 0,
            degraded_shots: flag(DEGRADED),
            stale_shots: flag(STALE),
            recorded_noise_mean_dn: None,
            recorded_noise_sd_dn: None,
            first_shot_s: None,
            last_shot_s: None,
            with_noise: 0,
        })
    }

    /// Adds the shots of a line of this beam.
    pub(super) fn add(&mut self, line: &ScanLine) {
        self.shots += line.emissions.len() as u64;
        for time_s in line.emissions.iter().map(|shot| shot.gps_time_s).filter(|time_s| time_s.is_finite()) {
            self.first_shot_s = Some(self.first_shot_s.map_or(time_s, |first_s| first_s.min(time_s)));
            self.last_shot_s = Some(self.last_shot_s.map_or(time_s, |last_s| last_s.max(time_s)));
        }
        let flags = [(DEGRADED, &mut self.degraded_shots), (STALE, &mut self.stale_shots)];
        let records = line.blocks().map_or(&[][..], |blocks| &blocks.footprints);
        for (name, count) in flags {
            let index = line.input.columns.iter().position(|column| *column == name);
            let is_set = |record: &&FootprintRecord| {
                index.and_then(|index| record.columns.get(index)).is_some_and(|flag| *flag != 0.0)
            };
            *count = count.map(|count| count + records.iter().filter(is_set).count() as u64);
        }
        for noise in records.iter().filter_map(|record| record.noise) {
            self.with_noise += 1;
            let weight = 1.0 / self.with_noise as f64;
            for (mean, value) in [
                (&mut self.recorded_noise_mean_dn, noise.mean_dn),
                (&mut self.recorded_noise_sd_dn, noise.sd_dn),
            ] {
                *mean = Some(mean.map_or(value, |mean| mean + weight * (value - mean)));
            }
        }
    }
}
