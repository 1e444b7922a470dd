//! Recognises the kind of a recording from its name and first shots.

use std::path::Path;

use super::place::check_recording;
use super::{Failure, scan};
use wavex_formats::format::reader_of;
use wavex_line::scan_line::Frame;
use wavex_pages::inspect::Inspection;

/// Number of shots read to recognise a recording.
const LOOKED_AT: u64 = 20_000;
/// Properties of a recording that select its job.
pub(super) struct Recording {
    /// Name of the stage that reads it.
    pub(super) reader: &'static str,
    /// Job for this kind of recording.
    pub(super) kind: JobTemplate,
    /// Properties that identified the kind, as text.
    pub(super) facts: String,
}

/// Kinds of recordings, one job template each.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum JobTemplate {
    /// Raw recording in the scanner's frame.
    Raw,
    /// LAS with waveforms.
    Las,
    /// PulseWaves.
    PulseWaves,
    /// Container with beams in map coordinates.
    Container,
    /// Footprints of 10 m and more.
    LargeFootprint,
    /// The same, in HDF5: GEDI and LVIS.
    Hdf5,
    /// SPD.
    Spd,
}

impl JobTemplate {
    /// File name of the job in the folder `jobs`.
    pub(super) fn file(self) -> &'static str {
        match self {
            JobTemplate::Raw => "sdf.toml",
            JobTemplate::Las => "las.toml",
            JobTemplate::PulseWaves => "pulsewaves.toml",
            JobTemplate::Container => "container.toml",
            JobTemplate::LargeFootprint => "large_footprint.toml",
            JobTemplate::Hdf5 => "gedi.toml",
            JobTemplate::Spd => "spd.toml",
        }
    }

    /// Text of the job.
    pub(super) fn template(self) -> &'static str {
        match self {
            JobTemplate::Raw => include_str!("../../jobs/sdf.toml"),
            JobTemplate::Las => include_str!("../../jobs/las.toml"),
            JobTemplate::PulseWaves => include_str!("../../jobs/pulsewaves.toml"),
            JobTemplate::Container => include_str!("../../jobs/container.toml"),
            JobTemplate::LargeFootprint => include_str!("../../jobs/large_footprint.toml"),
            JobTemplate::Hdf5 => include_str!("../../jobs/gedi.toml"),
            JobTemplate::Spd => include_str!("../../jobs/spd.toml"),
        }
    }
}

impl Recording {
    /// Recognises the kind of a recording.
    ///
    /// SDF and WFM are recognised by extension because reading them requires RIEGL's library.
    ///
    /// # Errors
    /// If the file does not exist, its format is not supported, or no shot can be read.
    pub(super) fn recognise(path: &Path) -> Result<Recording, Failure> {
        check_recording(path)?;
        let name = path.display().to_string();
        let reader = reader_of(&name).map_err(Failure::Wrong)?;
        if reader == "read_sdf" {
            return Ok(Recording {
                reader,
                kind: JobTemplate::Raw,
                facts: "RIEGL SDF or WFM, by its extension".into(),
            });
        }
        let (inspection, _, ended) = scan::look_at(path, &[], true, LOOKED_AT, |_, _| ())?;
        if inspection.shots.count == 0 {
            let problem =
                ended.err().map_or(format!("{name}: the recording has no shots"), |error| error.to_string());
            return Err(Failure::Run(problem));
        }
        let (kind, reason) = kind_of(reader, &inspection);
        Ok(Recording { reader, kind, facts: facts(&inspection) + reason })
    }
}

/// Selects the kind, with the reason if the format alone does not decide.
fn kind_of(reader: &str, inspection: &Inspection) -> (JobTemplate, &'static str) {
    let input = inspection.input.as_deref();
    if reader == "read_hdf5" && inspection.has_fractions {
        return (JobTemplate::Hdf5, ": profiles of ground and canopy");
    }
    if inspection.has_large_footprints() {
        return (JobTemplate::LargeFootprint, ": profiles of ground and canopy");
    }
    match (reader, input.map(|input| input.frame)) {
        ("read_las", _) => (JobTemplate::Las, ""),
        ("read_pulsewaves", _) => (JobTemplate::PulseWaves, ""),
        ("read_hdf5", _) => (JobTemplate::Spd, ""),
        (_, Some(Frame::Scanner | Frame::Body)) => (JobTemplate::Raw, ", in the instrument's frame"),
        _ => (JobTemplate::Container, ", in map coordinates"),
    }
}

fn facts(inspection: &Inspection) -> String {
    let input = inspection.input.as_deref();
    let format = input.map_or(String::new(), |input| input.format.clone());
    let instrument = input.and_then(|input| input.instrument.clone()).filter(|name| !name.is_empty());
    let rate = inspection.pulse_rate_hz().map(|hz| format!("{hz:.0} pulses per second"));
    let samples = inspection.waveform_samples().map(|samples| format!("waveforms of {samples:.0} samples"));
    let facts = [Some(format), instrument, rate, samples];
    // The text must fit in one comment line, whatever characters the instrument's name contains.
    facts.into_iter().flatten().collect::<Vec<_>>().join(", ").replace(char::is_control, " ")
}
