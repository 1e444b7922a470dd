//! A granule: one file with the beams that it contains.

use std::path::{Path, PathBuf};

use wavex_formats::{Error, Result};

use super::beam::BeamReader;
use super::dataset::Dataset;
use super::gedi::{self, GediBeam};
use super::group::{Link, links};
use super::input::Input;
use super::lvis::LvisBeam;
use super::product::{Product, recognise};
use super::shot::TimeScale;
use super::superblock;

/// Name of the only beam of LVIS.
const LVIS: &str = "LVIS";

/// Power of a beam of GEDI.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Power {
    /// Full power.
    Full,
    /// Half of the power, from the laser that is split into two beams.
    Coverage,
}

impl Power {
    /// Returns the name: `full` or `coverage`.
    pub fn name(self) -> &'static str {
        match self {
            Power::Full => "full",
            Power::Coverage => "coverage",
        }
    }
}

/// Beam of a granule.
#[derive(Clone, Debug, PartialEq)]
pub struct Beam {
    /// Name of its group, such as `BEAM0101`; `LVIS` for LVIS.
    pub name: String,
    /// Power, if beams differ.
    pub power: Option<Power>,
    /// Number of shots; 0 if the beam has no waveforms.
    pub shots: u64,
}

/// A file with waveforms.
#[derive(Debug)]
pub struct Granule {
    path: PathBuf,
    product: Product,
    beams: Vec<Beam>,
}

impl Granule {
    /// Opens a file and lists its beams.
    ///
    /// # Errors
    /// If it cannot be read, or is no supported product with beams.
    pub fn open(path: &Path) -> Result<Granule> {
        let (input, root) = open(path)?;
        let product = recognise(&input, &root)?;
        let mut beams = Vec::new();
        match product {
            Product::Spd => return Err(without_beams(path)),
            Product::LvisL1b => {
                beams.push(Beam {
                    name: LVIS.to_owned(),
                    power: None,
                    shots: shots(&input, "SHOTNUMBER", &root)?,
                });
            }
            Product::GediL1b => {
                for (name, at) in root.iter().filter(|(name, _)| name.starts_with("BEAM")) {
                    let members = links(&input, *at)?;
                    let shots = if gedi::has_waveforms(&members) {
                        shots(&input, "shot_number", &members)?
                    } else {
                        0
                    };
                    beams.push(Beam { name: name.clone(), power: power(name), shots });
                }
                beams.sort_by(|one, other| one.name.cmp(&other.name));
                // A damaged group can name a member twice; the first is read.
                beams.dedup_by(|later, first| later.name == first.name);
            }
        }
        Ok(Granule { path: path.to_owned(), product, beams })
    }

    /// Returns the product.
    pub fn product(&self) -> Product {
        self.product
    }

    /// Returns the beams, sorted by name; beams without waveforms have no shots.
    pub fn beams(&self) -> &[Beam] {
        &self.beams
    }

    /// Returns the scale of the shots' times.
    pub fn time_scale(&self) -> TimeScale {
        match self.product {
            Product::GediL1b => TimeScale::Gps,
            Product::LvisL1b | Product::Spd => TimeScale::UtcOfDay,
        }
    }

    /// Opens a beam.
    ///
    /// # Errors
    /// If no beam has this name, or the beam has no shots or damaged data sets.
    pub fn beam(&self, name: &str) -> Result<BeamReader> {
        let refused = |problem: String, remedy: String| Err(Error::unusable(&self.path, problem, remedy));
        let beams: Vec<&str> = self.beams.iter().map(|beam| beam.name.as_str()).collect();
        let Some(beam) = self.beams.iter().find(|beam| beam.name == name) else {
            return refused(format!("no beam {name}"), format!("choose one of: {}", beams.join(", ")));
        };
        if beam.shots == 0 {
            return refused(format!("beam {name} has no shots"), "choose another beam".to_owned());
        }
        let (input, root) = open(&self.path)?;
        match self.product {
            Product::Spd => Err(without_beams(&self.path)),
            Product::LvisL1b => Ok(BeamReader::new(name, LvisBeam::open(input, root)?)),
            Product::GediL1b => {
                let group = root.iter().find(|(link, _)| link == name).map_or(0, |&(_, at)| at);
                let members = links(&input, group)?;
                Ok(BeamReader::new(name, GediBeam::open(input, name, members)?))
            }
        }
    }
}

/// Creates the error of a file with pulses of a scanner.
fn without_beams(path: &Path) -> Error {
    Error::unusable(path, "an SPD file, which has pulses but no beams", "open it with `SpdReader`")
}

/// Opens a file and lists the members of its root group.
fn open(path: &Path) -> Result<(Input, Vec<Link>)> {
    let mut input = Input::open(path)?;
    let root = superblock::root(&mut input)?;
    let root = links(&input, root)?;
    Ok((input, root))
}

/// Returns the number of shots of a beam, from its data set of shot numbers.
fn shots(input: &Input, name: &str, members: &[Link]) -> Result<u64> {
    match members.iter().find(|(member, _)| member.eq_ignore_ascii_case(name)) {
        Some((_, at)) => Ok(Dataset::open(input, name, *at)?.rows()),
        None => Ok(0),
    }
}

/// Returns the power of a beam of GEDI by its name.
fn power(name: &str) -> Option<Power> {
    match name {
        "BEAM0000" | "BEAM0001" | "BEAM0010" | "BEAM0011" => Some(Power::Coverage),
        "BEAM0101" | "BEAM0110" | "BEAM1000" | "BEAM1011" => Some(Power::Full),
        _ => None,
    }
}
