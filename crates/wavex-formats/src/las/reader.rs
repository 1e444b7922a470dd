//! Point-by-point reader of full-waveform LAS and LAZ files.

use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};

use super::descriptor::{Descriptors, PacketDescriptor};
use super::extent;
use super::extra_bytes::{self, ExtraBytes};
use super::header::LasHeader;
use super::packet_decoder::PacketDecoder;
use super::packets::{self, Packets};
use super::point::{Point, PointLayout, Wave};
use super::records::RecordReader;
use super::vlr::{self, PROJECTION, SPEC, Vlr};
use crate::{Error, RecordedCrs, Result, regular_file};

/// Full-waveform LAS or LAZ file.
///
/// Supports versions 1.0 to 1.5 and point formats 4, 5, 9 and 10. For these formats LAS 1.5 changes
/// only the header.
pub struct Reader {
    path: PathBuf,
    header: LasHeader,
    vlrs: Vec<Vlr>,
    evlrs: Vec<Vlr>,
    descriptors: Descriptors,
    extra_bytes: Vec<ExtraBytes>,
    layout: PointLayout,
    records: RecordReader,
    packets: Option<Packets>,
    surplus_bytes: u64,
    /// Samples of packets that are only checked.
    unwanted: Vec<u16>,
}

impl Reader {
    /// Opens a file and reads everything but its points and waveforms.
    ///
    /// # Errors
    /// The file is not LAS, has points without waveforms, is cut off, or has contradictory sizes or
    /// more points than declared; or declared waveforms are neither inside nor next to it.
    pub fn open(path: &Path) -> Result<Reader> {
        let (reader, missing) = Reader::open_partial(path)?;
        missing.map_or(Ok(reader), Err)
    }

    /// As [`Reader::open`]; a file with fewer points than declared is read to its end.
    ///
    /// The second value is then the error that [`Reader::open`] returns.
    ///
    /// # Errors
    /// As [`Reader::open`], except for missing points.
    pub fn open_partial(path: &Path) -> Result<(Reader, Option<Error>)> {
        let file = regular_file(path)?;
        let file_length = file.metadata().map_err(Error::io(path, "find the length"))?.len();
        let mut input = BufReader::new(file);
        let (header, missing) = LasHeader::read_partial(&mut input, path, file_length)?;
        match Reader::begin(path, header, input, file_length) {
            Ok(reader) => Ok((reader, missing)),
            Err(error) => Err(missing.unwrap_or(error)),
        }
    }

    fn begin(path: &Path, header: LasHeader, mut input: BufReader<File>, file_length: u64) -> Result<Reader> {
        let layout = PointLayout::of(header.point_format);
        if layout.wave.is_none() {
            let problem = format!("no waveforms in point data format {}", header.point_format);
            let remedy = "export the flight with waveforms, as LAS point format 4, 5, 9 or 10";
            return Err(Error::malformed(path, 104, "point data record format", problem, remedy));
        }
        let vlrs = vlr::read_vlrs(&mut input, path, &header)?;
        let evlrs = vlr::read_evlrs(&mut input, path, &header, file_length)?;
        let descriptors = Descriptors::collect(path, vlrs.iter().chain(&evlrs));
        let extra_bytes = match vlrs.iter().chain(&evlrs).find(|vlr| vlr.is(SPEC, vlr::EXTRA_BYTES)) {
            Some(vlr) => extra_bytes::parse(path, vlr)?,
            None => Vec::new(),
        };
        let mut packets = packets::find(path, &header, &evlrs, &descriptors, &mut input, file_length)?;
        if packets.is_none() && descriptors.describe_anything() {
            return Err(packets::missing(path, &descriptors));
        }
        if let Some(packets) = packets.as_mut().filter(|_| descriptors.are_compressed()) {
            packets.check_descriptors(&descriptors)?;
        }
        let inside = packets.as_ref().and_then(|packets| packets.start_in(path));
        let surplus_bytes = extent::surplus_bytes(&mut input, path, &header, &evlrs, inside, file_length)?;
        let records = RecordReader::open(path, &header, &vlrs, file_length)?;
        let path = path.to_path_buf();
        Ok(Reader {
            path,
            header,
            vlrs,
            evlrs,
            descriptors,
            extra_bytes,
            layout,
            records,
            packets,
            surplus_bytes,
            unwanted: Vec::new(),
        })
    }

    /// Returns the public header block.
    pub fn header(&self) -> &LasHeader {
        &self.header
    }

    /// Returns the VLRs between the header and the points.
    pub fn vlrs(&self) -> &[Vlr] {
        &self.vlrs
    }

    /// Returns the EVLRs after the points.
    ///
    /// Waveform packets without their data.
    pub fn evlrs(&self) -> &[Vlr] {
        &self.evlrs
    }

    /// Returns the coordinate reference system, and what is wrong with its records.
    pub fn crs(&self) -> RecordedCrs {
        vlr::recorded_crs(&self.header, self.vlrs.iter().chain(&self.evlrs))
    }

    /// Returns a record of `LASF_Projection`.
    ///
    /// 2112 is WKT; 34735, 34736 and 34737 are the GeoTIFF keys, their numbers and their texts.
    pub fn projection(&self, record_id: u16) -> Option<&Vlr> {
        self.vlrs.iter().chain(&self.evlrs).find(|vlr| vlr.is(PROJECTION, record_id))
    }

    /// Returns whether the gains of waveform packet descriptors differ.
    pub fn has_different_gains(&self) -> bool {
        self.descriptors.have_different_gains()
    }

    /// Returns the descriptors of the extra bytes.
    pub fn extra_bytes_descriptors(&self) -> &[ExtraBytes] {
        &self.extra_bytes
    }

    /// Returns the number of bytes after the points that belong to nothing, if at least a record.
    pub fn surplus_bytes(&self) -> u64 {
        self.surplus_bytes
    }

    /// Reads the next point.
    ///
    /// `false` at the end, with `point` unchanged.
    ///
    /// # Errors
    /// The file cannot be read or its compressed points are damaged. No point follows after an
    /// error.
    pub fn next_point(&mut self, point: &mut Point) -> Result<bool> {
        let found = self.records.advance()?;
        if found {
            self.layout.decode(self.records.record(), &self.header.scale, &self.header.offset, point);
        }
        Ok(found)
    }

    /// Omits fields that the reading of waveforms does not need, where the file is compressed by
    /// layers (formats 6 to 10).
    ///
    /// Most points then have the classification, user data, point source ID, colours and extra bytes
    /// of an earlier point. Decoding takes time in proportion to the fields.
    pub fn skip_unused_fields(&mut self) {
        self.records.skip_unused_fields();
    }

    /// Continues with point `index`, from 0; at the end if the file has fewer.
    ///
    /// # Errors
    /// The file cannot be read, or its compressed points are damaged.
    pub fn seek(&mut self, index: u64) -> Result<()> {
        self.records.seek(index)
    }

    /// Returns the extra bytes of the last point.
    ///
    /// All bytes after the format's fields.
    pub fn extra_bytes(&self) -> &[u8] {
        self.records.record().get(self.layout.length..).unwrap_or_default()
    }

    /// Returns the storage descriptor of a point's waveform.
    ///
    /// # Errors
    /// The point has no waveform, or its descriptor is missing or unsupported. Other points may be
    /// valid.
    pub fn descriptor(&self, wave: &Wave) -> Result<&PacketDescriptor> {
        let index = wave.descriptor;
        let bad = |problem: String, remedy| Error::unusable(&self.path, problem, remedy);
        if index == 0 {
            let problem = "a point has no waveform (descriptor 0)";
            return Err(bad(problem.into(), "leave the point out"));
        }
        let id = 99 + u16::from(index);
        let Some(descriptor) = self.descriptors.get(index) else {
            let problem =
                format!("a point refers to waveform descriptor {index}, but LASF_Spec/{id} is missing");
            return Err(bad(problem, "the point or the header is damaged: export the file again"));
        };
        match descriptor.obstacle() {
            None => Ok(descriptor),
            Some((problem, remedy)) => {
                Err(bad(format!("waveform descriptor {index} (LASF_Spec/{id}): {problem}"), remedy))
            }
        }
    }

    /// Reads the waveform of a point, replacing `samples`.
    ///
    /// A packet may be longer than its samples (padding), never shorter. Consecutive packets are
    /// read from a window, not one by one.
    ///
    /// # Errors
    /// As [`Reader::descriptor`]; or the packet is too short or outside the waveform data. Other
    /// points may be valid.
    pub fn packet(&mut self, wave: &Wave, samples: &mut Vec<u16>) -> Result<PacketDescriptor> {
        samples.clear();
        let descriptor = self.located_packet(wave)?;
        let Some(packets) = &mut self.packets else { return Err(self.without_packets()) };
        packets.samples(wave, &descriptor, samples)?;
        Ok(descriptor)
    }

    /// Returns the descriptor of a waveform that [`Reader::packet`] can read.
    ///
    /// Only compressed packets are read: whether they are valid is not known otherwise.
    ///
    /// # Errors
    /// As [`Reader::packet`].
    pub fn packet_descriptor(&mut self, wave: &Wave) -> Result<PacketDescriptor> {
        let descriptor = self.located_packet(wave)?;
        if descriptor.is_compressed() {
            let mut samples = std::mem::take(&mut self.unwanted);
            let read = self.packet(wave, &mut samples);
            self.unwanted = samples;
            return read;
        }
        Ok(descriptor)
    }

    fn without_packets(&self) -> Error {
        packets::missing(&self.path, &self.descriptors)
    }

    /// Returns the descriptor of a waveform whose size and location are possible.
    fn located_packet(&self, wave: &Wave) -> Result<PacketDescriptor> {
        let descriptor = self.descriptor(wave)?.as_stored(wave);
        let (samples, size) = (descriptor.samples, u64::from(wave.size));
        let (length, problem) = if descriptor.is_compressed() {
            let most = PacketDecoder::most_bytes(&descriptor);
            let problem = || format!("{samples} compressed samples take at most {most}");
            (size, (size > most).then(problem))
        } else {
            let length = descriptor.packet_bytes();
            let problem = || format!("{samples} samples of {} bits need {length}", descriptor.bits);
            (length, (size < length).then(problem))
        };
        if let Some(problem) = problem {
            let problem =
                format!("the waveform packet at byte {} has {size} bytes, but {problem}", wave.offset);
            let remedy = "the point or its descriptor is damaged: export the file again";
            return Err(Error::unusable(&self.path, problem, remedy));
        }
        let Some(packets) = &self.packets else { return Err(self.without_packets()) };
        packets.check(wave.offset, length)?;
        Ok(descriptor)
    }
}
