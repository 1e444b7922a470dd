//! The stage `simulate`: a flight over a small scene whose truth is known.

use std::io::Write;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::batch::{Batch, Kind, MAX_SHOTS_PER_LINE};
use crate::formats::Error;
use crate::simulation::pulse::Shape;
use crate::simulation::receiver::Settings;
use crate::simulation::scanner::Scanner;
use crate::simulation::scene::Scene;
use crate::simulation::truth::{COLUMNS, TrueReturn};
use crate::stage::{
    Config, Context, InvalidKey, OutputFile, Paths, Result, Site, Source, SourceConfig, StageSpec,
};

mod flight;
#[cfg(test)]
mod tests;

use flight::Flight;

/// The place of `simulate` in the registry.
pub const STAGE: StageSpec = StageSpec::source::<Simulate>("simulate", Kind::Shots);

/// Time between samples, ns.
const INTERVAL_NS: f64 = 1.0;
/// The largest value of the 8-bit digitiser.
const FULL_SCALE_DN: u16 = 255;
/// Full width at half maximum of a Gaussian response, ns.
const GAUSSIAN_FWHM_NS: f64 = 4.5;

/// Makes the recording of a flight that never took place.
///
/// A scanner with a rotating mirror flies over level ground, a building and a wood, and records them as an airborne
/// instrument with one receiver does. The truth of every return can be
/// written beside it.
///
/// The same keys give the same bytes on every machine, and a scan line does not depend on the others.
/// The geometry is already in a map (UTM zone 33 north, metres), so that no trajectory is needed.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Simulate {
    /// What the outputs of the run are named after.
    pub stem: String,
    /// Start of the random numbers: another one gives other noise and another grain of the scene.
    pub seed: u64,
    /// Scan lines.
    #[schemars(range(min = 1))]
    pub lines: u32,
    /// Shots of each scan line.
    #[schemars(range(min = 1, max = 4096))]
    pub shots_per_line: u32,
    /// Pulses per second. Echoes that return after the next pulse are given to the pulse that caused them.
    #[schemars(range(min = 1000.0, max = 2000000.0))]
    pub pulse_rate_hz: f64,
    /// The first and the last shot's angle from straight down, positive to the right.
    pub scan_angle_deg: [f64; 2],
    /// Height above the level ground.
    #[schemars(range(min = 20.0, max = 10000.0))]
    pub flying_height_m: f64,
    /// Speed over ground.
    #[schemars(range(min = 1.0, max = 1000.0))]
    pub speed_mps: f64,
    /// Height of the building; 0: none.
    #[schemars(range(min = 0.0, max = 200.0))]
    pub building_height_m: f64,
    /// Height of the wood; 0: none.
    #[schemars(range(min = 0.0, max = 200.0))]
    pub canopy_height_m: f64,
    /// Mean height of the echoes of level ground straight below the aircraft, above the background. The digitiser ends at
    /// 255.
    #[schemars(range(min = 1.0, max = 10000.0))]
    pub ground_amplitude_dn: f64,
    /// Share of the shots that nothing comes back from.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub dropout_rate: f64,
    /// What the echo of a flat target looks like.
    pub response: Response,
    /// Background of the even and of the odd samples of a block.
    pub background_dn: [f64; 2],
    /// Standard deviation of the recorded noise, the digitiser's rounding included; 0: rounding alone.
    #[schemars(range(min = 0.0, max = 100.0))]
    pub noise_sd_dn: f64,
    /// Autocorrelation of the recorded noise at 1, 2, ... samples; `[]`: none.
    pub noise_autocorrelation: Vec<f64>,
    /// A CSV file of what a perfect evaluation would find (`*` is the stem); not written when not given. A return stands
    /// there when its peak lies in a recorded block, however weak it is.
    pub truth: Option<String>,
}

/// What the echo of a flat target looks like.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Response {
    /// A Gaussian of 4.5 ns full width at half maximum, for comparisons with formulas.
    Gaussian,
    /// As measured on a RIEGL LMS-Q680i: a skewed lobe of 4.5 ns, an after-pulse of 5 % 10.5 ns behind it, and a slow
    /// tail. The default, because whoever takes this for a sum of Gaussians finds points that are not there.
    Riegl,
}

impl Default for Simulate {
    fn default() -> Simulate {
        Simulate {
            stem: "simulated".to_owned(),
            seed: 1,
            lines: 200,
            shots_per_line: 1000,
            pulse_rate_hz: 150_000.0,
            scan_angle_deg: [-30.0, 30.0],
            flying_height_m: 600.0,
            speed_mps: 60.0,
            building_height_m: 8.0,
            canopy_height_m: 18.0,
            ground_amplitude_dn: 110.0,
            dropout_rate: 0.002,
            response: Response::Riegl,
            background_dn: [2.18, 2.41],
            noise_sd_dn: 0.93,
            noise_autocorrelation: vec![0.63, 0.42, 0.22, 0.11],
            truth: None,
        }
    }
}

impl Config for Simulate {
    fn check(&self) -> std::result::Result<(), InvalidKey> {
        let unless = InvalidKey::unless;
        let within = |value: f64, low: f64, high: f64| (low..=high).contains(&value);
        let is_name = !self.stem.is_empty() && !self.stem.contains(['/', '\\']);
        unless(is_name, "stem", "must be a file name without folders")?;
        unless(self.lines >= 1, "lines", "must be at least 1")?;
        let most = MAX_SHOTS_PER_LINE as u32;
        unless((1..=most).contains(&self.shots_per_line), "shots_per_line", "must lie between 1 and 4096")?;
        unless(within(self.pulse_rate_hz, 1e3, 2e6), "pulse_rate_hz", "must lie between 1000 and 2000000")?;
        let [first, last] = self.scan_angle_deg;
        let angles = within(first, -60.0, 60.0) && within(last, -60.0, 60.0) && first < last;
        unless(angles, "scan_angle_deg", "must be two ascending angles between -60 and 60")?;
        unless(within(self.speed_mps, 1.0, 1000.0), "speed_mps", "must lie between 1 and 1000")?;
        let heights = "must lie between 0 and 200";
        unless(within(self.building_height_m, 0.0, 200.0), "building_height_m", heights)?;
        unless(within(self.canopy_height_m, 0.0, 200.0), "canopy_height_m", heights)?;
        let lowest = self.building_height_m.max(self.canopy_height_m) + 20.0;
        let flight = "must lie between 20 m above building and wood, and 10000";
        unless(within(self.flying_height_m, lowest, 10_000.0), "flying_height_m", flight)?;
        let amplitude = "must lie between 1 and 10000";
        unless(within(self.ground_amplitude_dn, 1.0, 10_000.0), "ground_amplitude_dn", amplitude)?;
        unless(within(self.dropout_rate, 0.0, 1.0), "dropout_rate", "must lie between 0 and 1")?;
        let background = self.background_dn.iter().all(|&dn| within(dn, 0.0, 100.0));
        unless(background, "background_dn", "must be two values between 0 and 100")?;
        // Below half a step the rounding is no longer independent of the noise.
        let noise = self.noise_sd_dn == 0.0 || within(self.noise_sd_dn, 0.5, 100.0);
        unless(noise, "noise_sd_dn", "must be 0, or lie between 0.5 and 100")?;
        unless(
            self.noise_autocorrelation.len() <= 16,
            "noise_autocorrelation",
            "must have at most 16 values",
        )?;
        let possible = self.receiver().noise().is_ok();
        unless(
            possible,
            "noise_autocorrelation",
            "belongs to no noise that can be recorded at this noise_sd_dn",
        )
    }
}

impl SourceConfig for Simulate {
    fn paths(&self) -> Option<&Paths> {
        None
    }

    fn stem(&self) -> &str {
        &self.stem
    }

    fn outputs(&self) -> Vec<&str> {
        self.truth.iter().map(String::as_str).collect()
    }

    fn make(&self, site: &Site) -> Result<Box<dyn Source>> {
        let truth = match &self.truth {
            Some(pattern) => Some(TruthFile::create(site, pattern)?),
            None => None,
        };
        Ok(Box::new(Simulator { flight: Flight::new(self)?, line: 0, lines: self.lines, truth }))
    }
}

impl Simulate {
    fn scanner(&self) -> Scanner {
        Scanner {
            shots_per_line: self.shots_per_line,
            pulse_rate_hz: self.pulse_rate_hz,
            scan_angle_rad: self.scan_angle_deg.map(f64::to_radians),
            flying_height_m: self.flying_height_m,
            speed_mps: self.speed_mps,
        }
    }

    fn scene(&self) -> Scene {
        let swath = self.scanner().swath(self.lines);
        Scene::new(self.seed, swath, self.flying_height_m, self.building_height_m, self.canopy_height_m)
    }

    fn receiver(&self) -> Settings {
        let (response, reference) = match self.response {
            Response::Gaussian => (Shape::gaussian(GAUSSIAN_FWHM_NS), Shape::gaussian(GAUSSIAN_FWHM_NS)),
            Response::Riegl => (Shape::riegl(), Shape::riegl_reference()),
        };
        Settings {
            interval_ns: INTERVAL_NS,
            full_scale_dn: FULL_SCALE_DN,
            background_dn: self.background_dn,
            noise_sd_dn: self.noise_sd_dn,
            noise_autocorrelation: self.noise_autocorrelation.clone(),
            response,
            reference,
        }
    }
}

/// The source: one scan line after the other.
struct Simulator {
    flight: Flight,
    /// The next line.
    line: u32,
    lines: u32,
    /// The table of truth, until it is whole.
    truth: Option<TruthFile>,
}

impl Source for Simulator {
    fn next(&mut self, cx: &mut Context) -> Result<Option<Batch>> {
        if self.line == self.lines {
            if let Some(truth) = self.truth.take() {
                cx.keep(truth.file.finish()?);
            }
            return Ok(None);
        }
        let (batch, returns) = self.flight.line(self.line);
        self.line += 1;
        if let Some(truth) = &mut self.truth {
            truth.write(&returns)?;
        }
        Ok(Some(batch))
    }

    fn progress(&self) -> Option<f64> {
        Some(f64::from(self.line) / f64::from(self.lines))
    }
}

/// A table of truth that is being written.
struct TruthFile {
    file: OutputFile,
    rows: Vec<u8>,
}

impl TruthFile {
    fn create(site: &Site, pattern: &str) -> Result<TruthFile> {
        let mut truth = TruthFile { file: site.create(pattern)?, rows: format!("{COLUMNS}\n").into_bytes() };
        truth.flush()?;
        Ok(truth)
    }

    fn write(&mut self, returns: &[TrueReturn]) -> Result<()> {
        for truth in returns {
            truth.write(&mut self.rows);
        }
        self.flush()
    }

    fn flush(&mut self) -> Result<()> {
        let written = self.file.write_all(&self.rows);
        self.rows.clear();
        Ok(written.map_err(Error::io(self.file.path(), "write"))?)
    }
}
