//! Pulse descriptors: layout of waves in the waves file.

use std::path::Path;

use crate::Result;
use crate::bytes::Fields;

/// Size of every description, bytes.
pub(super) const DESCRIPTION_BYTES: usize = 64;
/// Size of the composition record in version 0.3, description included, bytes.
const COMPOSITION_BYTES: u32 = 92;
/// Size of a sampling record in version 0.3, description included, bytes.
const SAMPLING_BYTES: u32 = 104;
/// Value of "optical center to anchor point" if it is not constant.
const NO_CONSTANT: u32 = 0x8FFF_FFFF;

/// Kind of a sampling.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SegmentKind {
    /// Outgoing pulse.
    Outgoing,
    /// Returning waveform.
    Returning,
    /// Type not defined by the specification.
    Other(u8),
}

/// Pulse descriptor (`PulseWaves_Spec` 200001 to 200255): composition record and samplings.
///
/// Layout: specification 0.3, "Composition Record". Files of the reference library have the
/// compression field before the scanner index, in reverse of the specification's table; this reader
/// follows the files.
#[derive(Debug, Clone, PartialEq)]
pub struct PulseDescriptor {
    /// Sampling units from the optical centre to the anchor.
    ///
    /// `None` if not constant; 0 if they coincide.
    pub optical_center_to_anchor: Option<i32>,
    /// Bytes before the waves of each pulse, skipped.
    pub extra_wave_bytes: u16,
    /// Sampling unit, ns.
    ///
    /// A thousandth of the time from anchor to target.
    pub sample_units_ns: f64,
    /// Index of the scanner ([`super::Reader::scanners`]); 0 if unspecified.
    pub scanner_index: u32,
    /// Compression of the waves; only 0 is defined.
    pub compression: u32,
    /// Description of the descriptor.
    pub description: String,
    /// Samplings, in the order of their segments in the waves file.
    pub samplings: Vec<SamplingRecord>,
}

/// Sampling of a pulse (specification 0.3, "Sampling Records").
///
/// One or more segments of a detector. Version 0.3 declares neither gain nor offset of the
/// digitiser.
#[derive(Debug, Clone, PartialEq)]
pub struct SamplingRecord {
    /// Outgoing or returning.
    pub kind: SegmentKind,
    /// Channel, from 0.
    ///
    /// In RIEGL's files 0 high power, 1 low power, 2 saturation, 3 reference.
    pub channel: u8,
    /// Bits of the stored duration, a signed integer.
    ///
    /// 0, 8, 16 or 32.
    pub duration_bits: u8,
    /// Sampling units per step of the stored duration.
    pub duration_scale: f64,
    /// Sampling units added to the scaled duration.
    pub duration_offset: f64,
    /// Bits of the stored number of segments.
    ///
    /// 0, 8 or 16.
    pub segment_count_bits: u8,
    /// Bits of the stored number of samples.
    ///
    /// 0, 8 or 16.
    pub sample_count_bits: u8,
    /// Number of segments of every pulse, if not stored.
    pub segment_count: u16,
    /// Number of samples of every segment, if not stored.
    pub sample_count: u32,
    /// Bits per sample: 8 or 16.
    pub bits_per_sample: u16,
    /// Index of the lookup table of the samples ([`super::Reader::tables`]).
    ///
    /// 0 for none.
    pub lookup_table_index: u16,
    /// Sample spacing, ns.
    pub sample_units_ns: f64,
    /// Compression of the samples; only 0 is defined.
    pub compression: u32,
    /// Description of the sampling.
    pub description: String,
}

impl PulseDescriptor {
    /// Parses the payload of a descriptor record at byte `base` of `file`.
    pub(super) fn parse(file: &Path, base: u64, payload: &[u8]) -> Result<PulseDescriptor> {
        let mut f = Fields::new(file, base, payload);
        let (mut head, description) = record(file, &mut f, "composition record", COMPOSITION_BYTES)?;
        head.skip(8, "composition record: size, reserved")?;
        let center = head.u32("optical center to anchor point")?;
        let extra_wave_bytes = head.u16("number of extra wave bytes")?;
        let count = head.u16("number of samplings")?;
        let sample_units_ns = f64::from(head.f32("sample units")?);
        let compression = head.u32("compression")?;
        let scanner_index = head.u32("scanner index")?;
        let mut samplings = Vec::new();
        for _ in 0..count {
            samplings.push(SamplingRecord::parse(file, &mut f)?);
        }
        Ok(PulseDescriptor {
            optical_center_to_anchor: (center != NO_CONSTANT).then_some(center as i32),
            extra_wave_bytes,
            sample_units_ns,
            scanner_index,
            compression,
            description,
            samplings,
        })
    }

    /// Returns the sampling units per sample.
    ///
    /// 1, unless the descriptor mixes resolutions.
    pub fn units_per_sample(&self, sampling: &SamplingRecord) -> f64 {
        sampling.sample_units_ns / self.sample_units_ns
    }

    /// Returns the field that prevents reading the waves, if any.
    ///
    /// Field name and problem.
    pub(super) fn problem(&self) -> Option<(String, String)> {
        let of = |field: &str, problem: String| Some((field.to_string(), problem));
        if self.compression != 0 {
            return of("compression", format!("scheme {} is unknown", self.compression));
        }
        if !positive(self.sample_units_ns) {
            return of("sample units", format!("{} ns is not a time above zero", self.sample_units_ns));
        }
        self.samplings.iter().enumerate().find_map(|(number, sampling)| {
            let (field, problem) = sampling.problem()?;
            Some((format!("sampling {number}: {field}"), problem))
        })
    }
}

impl SamplingRecord {
    fn parse<'a>(file: &'a Path, f: &mut Fields<'a>) -> Result<SamplingRecord> {
        let (mut f, description) = record(file, f, "sampling record", SAMPLING_BYTES)?;
        f.skip(8, "sampling record: size, reserved")?;
        let kind = match f.u8("type")? {
            1 => SegmentKind::Outgoing,
            2 => SegmentKind::Returning,
            other => SegmentKind::Other(other),
        };
        let channel = f.u8("channel")?;
        f.skip(1, "unused")?;
        Ok(SamplingRecord {
            kind,
            channel,
            duration_bits: f.u8("bits for duration from anchor")?,
            duration_scale: f64::from(f.f32("scale for duration from anchor")?),
            duration_offset: f64::from(f.f32("offset for duration from anchor")?),
            segment_count_bits: f.u8("bits for number of segments")?,
            sample_count_bits: f.u8("bits for number of samples")?,
            segment_count: f.u16("number of segments")?,
            sample_count: f.u32("number of samples")?,
            bits_per_sample: f.u16("bits per sample")?,
            lookup_table_index: f.u16("lookup table index")?,
            sample_units_ns: f64::from(f.f32("sample units")?),
            compression: f.u32("compression")?,
            description,
        })
    }

    /// Returns the field that prevents reading the segments, if any.
    ///
    /// Field name and problem.
    fn problem(&self) -> Option<(&'static str, String)> {
        if !matches!(self.bits_per_sample, 8 | 16) {
            let problem = format!("{} bits are not supported, only 8 and 16", self.bits_per_sample);
            return Some(("bits per sample", problem));
        }
        if !matches!(self.duration_bits, 0 | 8 | 16 | 32) {
            let problem = format!("{} bits are not supported, only 0, 8, 16 and 32", self.duration_bits);
            return Some(("bits for duration from anchor", problem));
        }
        if !(positive(self.duration_scale) && self.duration_offset.is_finite()) {
            let problem =
                format!("{} and {} are not a valid time", self.duration_scale, self.duration_offset);
            return Some(("scale and offset for duration from anchor", problem));
        }
        let counts = [
            ("bits for number of segments", self.segment_count_bits, self.segment_count == 0),
            ("bits for number of samples", self.sample_count_bits, self.sample_count == 0),
        ];
        for (field, bits, none) in counts {
            if !matches!(bits, 0 | 8 | 16) {
                return Some((field, format!("{bits} bits are not supported, only 0, 8 and 16")));
            }
            if bits == 0 && none {
                return Some((field, "neither a stored number nor a fixed one is declared".to_string()));
            }
        }
        if !positive(self.sample_units_ns) {
            return Some(("sample units", format!("{} ns is not a time above zero", self.sample_units_ns)));
        }
        (self.compression != 0).then(|| ("compression", format!("scheme {} is unknown", self.compression)))
    }
}

fn positive(value: f64) -> bool {
    value.is_finite() && value > 0.0
}

/// Reads a record with a size and a description.
///
/// Returns the fields, from the size field to the description, and the description. `least` is the
/// size in version 0.3; later versions insert fields before the description.
pub(super) fn record<'a>(
    file: &'a Path,
    f: &mut Fields<'a>,
    name: &str,
    least: u32,
) -> Result<(Fields<'a>, String)> {
    let base = f.offset();
    let size = f.clone().u32(&format!("{name}: size"))?;
    if size < least {
        let problem = format!("{size} is below {least}");
        return Err(f.bad(&format!("{name}: size"), problem, "export the file again from its source"));
    }
    let bytes = f.take(size as usize, name)?;
    let fields = Fields::new(file, base, bytes);
    let mut end = fields.clone();
    end.skip(size as usize - DESCRIPTION_BYTES, name)?;
    let description = end.text(DESCRIPTION_BYTES, name)?;
    Ok((fields, description))
}
