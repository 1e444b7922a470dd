//! Beams of GEDI L1B.
//!
//! Source of names and units: GEDI L1B product data dictionary, version 2.

use wavex_formats::Result;

use super::beam::Shots;
use super::dataset::Dataset;
use super::group::{Link, links};
use super::input::Input;
use super::members::{Column, MOST_SAMPLES, Members};
use super::shot::{Position, Shot};

/// GPS seconds at the begin of 2018, the epoch of GEDI.
const EPOCH_2018_S: f64 = 1_198_800_018.0;

/// Values of a shot that are passed on: group and name.
const COLUMNS: &[(&str, &str)] = &[
    ("", "stale_return_flag"),
    ("", "rx_energy"),
    ("geolocation", "degrade"),
    ("geolocation", "digital_elevation_model"),
    ("geolocation", "solar_elevation"),
    ("geolocation", "elevation_bin0_error"),
    ("geophys_corr", "geoid"),
    ("geophys_corr", "tide_earth"),
    ("geophys_corr", "tide_load"),
    ("geophys_corr", "tide_ocean"),
    ("geophys_corr", "tide_ocean_pole"),
    ("geophys_corr", "tide_pole"),
    ("geophys_corr", "dynamic_atmosphere_correction"),
];

/// Data sets of a beam.
pub struct GediBeam {
    members: Members,
    shots: usize,
    epoch_s: f64,
    shot_number: Dataset,
    delta_time: Column,
    received: Waveforms,
    outgoing: Option<Waveforms>,
    noise_mean: Column,
    noise_sd: Column,
    first_bin: [Column; 3],
    last_bin: [Column; 3],
    instrument: [Column; 3],
    delays: [Column; 2],
    columns: Vec<(&'static str, Column)>,
}

/// Returns whether a group is a beam with waveforms.
pub fn has_waveforms(members: &[Link]) -> bool {
    let has = |name: &str| members.iter().any(|(link, _)| link == name);
    has("rxwaveform") && has("rx_sample_count") && has("shot_number")
}

impl GediBeam {
    /// Opens the beam with this name and these members.
    ///
    /// # Errors
    /// If a data set is missing or damaged, or has no value for each shot.
    pub fn open(input: Input, name: &str, group: Vec<Link>) -> Result<GediBeam> {
        let find = |name: &str| group.iter().find(|(link, _)| link == name).map(|&(_, at)| at);
        let groups = ["ancillary", "geolocation", "geophys_corr"].map(|name| (name, find(name)));

        let mut members = Members::new(input, name, group);
        let shot_number = members.required("shot_number")?;
        let rows = shot_number.rows();
        let shots = members.check_shots(rows)?;
        let delta_time = members.column("delta_time", rows)?;
        let received = members.required("rxwaveform")?;
        let received = Waveforms::open(&mut members, received, "rx", rows)?;
        let outgoing = match members.optional("txwaveform")? {
            Some(samples) => Some(Waveforms::open(&mut members, samples, "tx", rows)?),
            None => None,
        };
        let noise_mean = members.column("noise_mean_corrected", rows)?;
        let noise_sd = members.column("noise_stddev_corrected", rows)?;

        let mut epoch_s = EPOCH_2018_S;
        let (mut first_bin, mut last_bin, mut instrument, mut delays) = Default::default();
        let mut columns = Vec::new();
        carry(&mut members, "", rows, &mut columns)?;
        for (group, at) in groups {
            let Some(at) = at else { continue };
            let within = links(&members.input, at)?;
            members.enter(&format!("{name}/{group}"), within);
            match group {
                "ancillary" => {
                    if let Some(mut epoch) = members.optional("master_time_epoch")? {
                        epoch_s = epoch.f64_at(&members.input, &mut members.decoder, 0)?;
                    }
                }
                "geolocation" => {
                    first_bin = position(&mut members, "bin0", "elevation", rows)?;
                    last_bin = position(&mut members, "lastbin", "elevation", rows)?;
                    instrument = position(&mut members, "instrument", "altitude", rows)?;
                    delays = [
                        members.column("bounce_time_offset_bin0", rows)?,
                        members.column("bounce_time_offset_lastbin", rows)?,
                    ];
                }
                _ => {}
            }
            carry(&mut members, group, rows, &mut columns)?;
        }
        Ok(GediBeam {
            members,
            shots,
            epoch_s,
            shot_number,
            delta_time,
            received,
            outgoing,
            noise_mean,
            noise_sd,
            first_bin,
            last_bin,
            instrument,
            delays,
            columns,
        })
    }
}

impl Shots for GediBeam {
    fn len(&self) -> usize {
        self.shots
    }

    fn columns(&self) -> Vec<&'static str> {
        self.columns.iter().map(|&(name, _)| name).collect()
    }

    fn number(&mut self, index: u64) -> Result<u64> {
        self.members.whole(&mut self.shot_number, index)
    }

    fn locate(&mut self, index: u64, shot: &mut Shot) -> Result<()> {
        shot.shot_number = self.number(index)?;
        let members = &mut self.members;
        shot.time_s = self.epoch_s + members.value(&mut self.delta_time, index)?;
        let places = [
            (&mut self.first_bin, &mut shot.first_bin),
            (&mut self.last_bin, &mut shot.last_bin),
            (&mut self.instrument, &mut shot.instrument),
        ];
        for ([longitude, latitude, height], place) in places {
            let longitude_deg = members.value(longitude, index)?;
            let latitude_deg = members.value(latitude, index)?;
            *place = Position::from_degrees(longitude_deg, latitude_deg, members.value(height, index)?);
        }
        Ok(())
    }

    fn read(&mut self, index: u64, shot: &mut Shot) -> Result<()> {
        self.locate(index, shot)?;
        let members = &mut self.members;
        shot.noise_mean_dn = members.value(&mut self.noise_mean, index)? as f32;
        shot.noise_sd_dn = members.value(&mut self.noise_sd, index)? as f32;
        let [first_delay, last_delay] = &mut self.delays;
        shot.first_bin_delay_s = members.value(first_delay, index)?;
        shot.last_bin_delay_s = members.value(last_delay, index)?;
        shot.columns.clear();
        for (_, column) in &mut self.columns {
            shot.columns.push(members.value(column, index)?);
        }
        self.received.read(members, index, &mut shot.received_dn)?;
        match &mut self.outgoing {
            Some(outgoing) => outgoing.read(members, index, &mut shot.outgoing_dn)?,
            None => shot.outgoing_dn.clear(),
        }
        Ok(())
    }
}

/// Opens the columns of [`COLUMNS`] in a group.
fn carry(
    members: &mut Members,
    group: &str,
    shots: u64,
    columns: &mut Vec<(&'static str, Column)>,
) -> Result<()> {
    for &(_, name) in COLUMNS.iter().filter(|&&(of, _)| of == group) {
        if let column @ Some(_) = members.column(name, shots)? {
            columns.push((name, column));
        }
    }
    Ok(())
}

/// Opens longitude, latitude and height of a point.
fn position(members: &mut Members, of: &str, height: &str, shots: u64) -> Result<[Column; 3]> {
    Ok([
        members.column(&format!("longitude_{of}"), shots)?,
        members.column(&format!("latitude_{of}"), shots)?,
        members.column(&format!("{height}_{of}"), shots)?,
    ])
}

/// Waveforms of all shots, one after the other in a data set.
struct Waveforms {
    samples: Dataset,
    count: Dataset,
    place: Place,
}

/// Where the waveform of a shot begins.
enum Place {
    /// The file says it, counted from 1.
    Start(Box<Dataset>),
    /// The waveform follows the previous one: end of each shot's samples.
    Ends(Vec<u64>),
}

impl Waveforms {
    /// Opens the waveforms `rx` or `tx`.
    ///
    /// Programs that cut granules may keep the start indices of the whole granule. If those do not fit
    /// the samples, but the number of samples is the sum of all counts, each waveform follows the
    /// previous one.
    fn open(members: &mut Members, samples: Dataset, direction: &str, shots: u64) -> Result<Waveforms> {
        let mut count = members.required(&format!("{direction}_sample_count"))?;
        members.check_rows(&count, shots)?;
        let mut start = members.column(&format!("{direction}_sample_start_index"), shots)?;
        let (mut all_fit, mut sum) = (start.is_some(), 0_u64);
        let mut ends = Vec::new();
        for shot in 0..shots {
            let Ok(count) = members.whole(&mut count, shot) else { break };
            if let Some(start) = &mut start {
                let first = members.whole(start, shot).ok().and_then(|start| start.checked_sub(1));
                let end = first.and_then(|first| first.checked_add(count));
                all_fit &= end.is_some_and(|end| end <= samples.len());
            }
            sum = sum.saturating_add(count);
            ends.push(sum);
        }
        let place = match start {
            Some(start) if all_fit || ends.len() as u64 != shots || sum != samples.len() => {
                Place::Start(Box::new(start))
            }
            _ => Place::Ends(ends),
        };
        Ok(Waveforms { samples, count, place })
    }

    /// Reads the waveform of a shot.
    fn read(&mut self, members: &mut Members, shot: u64, samples: &mut Vec<f32>) -> Result<()> {
        let name = self.samples.name();
        let count = members.whole(&mut self.count, shot)?;
        let first = match &mut self.place {
            Place::Start(start) => {
                let start = members.whole(start, shot)?;
                start.checked_sub(1).ok_or_else(|| members.unusable(format!("{name}: start index 0")))?
            }
            Place::Ends(ends) => {
                let end = ends.get(shot as usize).copied().unwrap_or(u64::MAX);
                end.saturating_sub(count)
            }
        };
        let end = first.checked_add(count).filter(|&end| end <= self.samples.len() && count <= MOST_SAMPLES);
        let end = end.ok_or_else(|| {
            let length = self.samples.len();
            members.unusable(format!("{name}: {count} samples from sample {first} on, it has {length}"))
        })?;
        members.samples(&mut self.samples, first..end, samples)
    }
}
