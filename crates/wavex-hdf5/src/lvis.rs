//! The beam of LVIS L1B.
//!
//! Source: LVIS Data Structure 1.04, 1.05 and 2.0.3 to 2.0.5. All have the same data sets in the root
//! group; the names of the last sample's position contain its index: `Z431`, `Z527`, `Z1023`, `Z1215`.

use wavex_formats::Result;

use super::beam::Shots;
use super::dataset::Dataset;
use super::group::Link;
use super::input::Input;
use super::members::{Column, MOST_SAMPLES, Members};
use super::shot::{Position, Shot};

/// Values of a shot that are passed on: name in the file, name here.
const COLUMNS: &[(&str, &str)] = &[
    ("LFID", "lfid"),
    ("DATE", "date"),
    ("AZIMUTH", "azimuth_deg"),
    ("INCIDENTANGLE", "incident_angle_deg"),
    ("RANGE", "range_m"),
];

/// Data sets of the beam.
pub struct LvisBeam {
    members: Members,
    shots: usize,
    shot_number: Dataset,
    time: Column,
    received: Dataset,
    outgoing: Column,
    noise_mean: Column,
    first_bin: [Column; 3],
    last_bin: [Column; 3],
    columns: Vec<(&'static str, Column)>,
}

/// Returns whether the root group has waveforms of LVIS.
pub fn has_waveforms(members: &[Link]) -> bool {
    let has = |name: &str| members.iter().any(|(link, _)| link.eq_ignore_ascii_case(name));
    has("RXWAVE") && has("SHOTNUMBER") && has("Z0")
}

impl LvisBeam {
    /// Opens the beam with these members of the root group.
    ///
    /// # Errors
    /// If a data set is missing or damaged, or has no value for each shot.
    pub fn open(input: Input, root: Vec<Link>) -> Result<LvisBeam> {
        let mut members = Members::new(input, "", root.clone());
        let shot_number = members.required("SHOTNUMBER")?;
        let rows = shot_number.rows();
        let shots = members.check_shots(rows)?;
        let received = members.required("RXWAVE")?;
        members.check_rows(&received, rows)?;
        let outgoing = members.column("TXWAVE", rows)?;
        for waveforms in [Some(&received), outgoing.as_ref()].into_iter().flatten() {
            if waveforms.columns() > MOST_SAMPLES {
                let (name, samples) = (waveforms.name(), waveforms.columns());
                let problem = format!("{name}: {samples} samples per shot, at most {MOST_SAMPLES}");
                return Err(members.unusable(problem));
            }
        }
        let last = last_sample(&root, received.columns());
        let mut position = |of: &str| -> Result<[Column; 3]> {
            Ok([
                members.column(&format!("LON{of}"), rows)?,
                members.column(&format!("LAT{of}"), rows)?,
                members.column(&format!("Z{of}"), rows)?,
            ])
        };
        let (first_bin, last_bin) = (position("0")?, position(&last)?);
        let mut columns = Vec::new();
        for &(stored, name) in COLUMNS {
            if let column @ Some(_) = members.column(stored, rows)? {
                columns.push((name, column));
            }
        }
        Ok(LvisBeam {
            shots,
            shot_number,
            time: members.column("TIME", rows)?,
            received,
            outgoing,
            noise_mean: members.column("SIGMEAN", rows)?,
            first_bin,
            last_bin,
            columns,
            members,
        })
    }
}

impl Shots for LvisBeam {
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
        shot.time_s = members.value(&mut self.time, index)?;
        let places = [(&mut self.first_bin, &mut shot.first_bin), (&mut self.last_bin, &mut shot.last_bin)];
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
        shot.columns.clear();
        for (_, column) in &mut self.columns {
            shot.columns.push(members.value(column, index)?);
        }
        let mut row = |dataset: &mut Dataset, samples: &mut Vec<f32>| {
            let columns = dataset.columns();
            members.samples(dataset, index * columns..(index + 1) * columns, samples)
        };
        row(&mut self.received, &mut shot.received_dn)?;
        match &mut self.outgoing {
            Some(outgoing) => row(outgoing, &mut shot.outgoing_dn),
            None => {
                shot.outgoing_dn.clear();
                Ok(())
            }
        }
    }
}

/// Returns the index in the names of the last sample's position.
///
/// It is the number of samples less one, or the largest one if there is no such name.
fn last_sample(root: &[Link], samples: u64) -> String {
    let indices = root.iter().filter_map(|(name, _)| name.strip_prefix(['Z', 'z'])?.parse::<u64>().ok());
    let expected = samples.saturating_sub(1);
    let indices: Vec<u64> = indices.filter(|&index| index > 0).collect();
    let found = if indices.contains(&expected) { Some(expected) } else { indices.into_iter().max() };
    found.unwrap_or(expected).to_string()
}
