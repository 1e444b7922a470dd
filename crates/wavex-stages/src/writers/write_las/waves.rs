//! Waveform packets of points.

use std::sync::Arc;

use wavex_formats::Error;
use wavex_formats::las::{PacketDescriptor, PacketReference, PacketWriter, Wave};
use wavex_geodesy::frames::Vector;
use wavex_line::georef::Geometry;
use wavex_line::georef::output_crs::OutputCrs;
use wavex_line::scan_line::{Block, Blocks, Channel, Emission, Frame, Return, ReturnChannel, ScanLine};
use wavex_line::stage::{FinishedFile, OutputFile, Result, StageError};

/// Length over which beams are treated as straight in any projection, m.
const BEAM_M: f64 = 10.0;

/// The packets of a run's points.
pub(super) struct PacketFile {
    packets: PacketWriter<OutputFile>,
    geometry: Arc<Geometry>,
    /// Output CRS of points from the earth-centred frame.
    target: Option<OutputCrs>,
    /// Packet of each block of the current line, once a return has requested it.
    written: Vec<Option<Option<PacketReference>>>,
    /// Number of blocks that could not be written.
    pub(super) n_refused: u64,
}

impl PacketFile {
    /// Starts the packets in a new file.
    pub(super) fn new(file: OutputFile, geometry: &Arc<Geometry>) -> Result<PacketFile> {
        let path = file.path().to_path_buf();
        let packets = PacketWriter::new(file, &path)?;
        Ok(PacketFile {
            packets,
            geometry: Arc::clone(geometry),
            target: None,
            written: Vec::new(),
            n_refused: 0,
        })
    }

    /// Returns the recorded blocks of a line.
    pub(super) fn begin_line<'a>(&mut self, line: &'a ScanLine) -> Result<&'a Blocks> {
        let Some(blocks) = &line.waveforms else {
            return Err(StageError::failed(
                "the line has no waveforms",
                "put write_las with wave_packets after decompose, in the same job",
            ));
        };
        self.written.clear();
        self.written.resize(blocks.len(), None);
        Ok(blocks)
    }

    /// The waveform of a return at `point`; written with the first return that uses it.
    pub(super) fn of(&mut self, line: &ScanLine, blocks: &Blocks, r: &Return, point: Vector) -> Result<Wave> {
        let emission = &line.emissions[r.emission as usize];
        let time_ns = emission.emission_ns + r.time_of_flight_ns;
        let Some((index, block)) = block_of(blocks, r, time_ns) else { return Ok(Wave::default()) };
        let Some(packet) = self.packet(index, blocks, block)? else { return Ok(Wave::default()) };
        if self.target.is_none() {
            self.target = self.geometry.target(&line.input)?;
        }
        let to_sensor = self.to_sensor(line.input.frame, emission, r, point)?;
        let metres_per_ps = line.input.group_velocity_mps * 0.5e-12;
        Ok(Wave {
            descriptor: packet.descriptor,
            offset: packet.offset,
            size: packet.size,
            location_ps: ((time_ns - block.start_ns) * 1000.0) as f32,
            direction_per_ps: to_sensor.map(|per_metre| (per_metre * metres_per_ps) as f32),
        })
    }

    fn packet(&mut self, index: usize, blocks: &Blocks, block: &Block) -> Result<Option<PacketReference>> {
        if let Some(Some(packet)) = self.written.get(index) {
            return Ok(*packet);
        }
        // The cast saturates; a value that is not a valid spacing is rejected later.
        let spacing_ps = (block.interval_ns * 1000.0).round() as u32;
        let packet = self.packets.add(blocks.samples(block), spacing_ps)?;
        self.n_refused += u64::from(packet.is_none());
        if let Some(written) = self.written.get_mut(index) {
            *written = Some(packet);
        }
        Ok(packet)
    }

    /// Change of a point's coordinates per metre of range towards the sensor.
    fn to_sensor(&self, frame: Frame, emission: &Emission, r: &Return, point: Vector) -> Result<Vector> {
        if frame != Frame::Earth {
            return Ok(emission.direction.map(|along| -along * emission.frame_scale));
        }
        let Some(target) = &self.target else { return Ok([0.0; 3]) };
        let nearer_m = r.range_m - BEAM_M;
        let nearer =
            std::array::from_fn(|axis| emission.origin_m[axis] + emission.direction[axis] * nearer_m);
        let nearer = target.coordinates(nearer)?;
        Ok(std::array::from_fn(|axis| (nearer[axis] - point[axis]) / BEAM_M))
    }

    /// Completes the packet file; returns it with its descriptors.
    pub(super) fn finish(self) -> Result<(FinishedFile, Vec<PacketDescriptor>)> {
        let (file, kinds) = self.packets.finish()?;
        Ok((file.finish()?, kinds))
    }
}

/// Opens the packets, to be copied into another file.
pub(super) fn open(packets: &FinishedFile) -> Result<std::fs::File> {
    Ok(packets.open().map_err(Error::io(packets.path(), "read the waveform packets"))?)
}

/// Finds the block of a return: preferably of its receiver, containing or nearest to its peak.
fn block_of<'a>(blocks: &'a Blocks, r: &Return, time_ns: f64) -> Option<(usize, &'a Block)> {
    let receiver = match r.channel {
        ReturnChannel::High => Channel::HighPower,
        ReturnChannel::Low | ReturnChannel::Joint => Channel::LowPower,
    };
    let rank = |block: &Block| {
        let end_ns = block.start_ns + block.len() as f64 * block.interval_ns;
        let away_ns = (block.start_ns - time_ns).max(time_ns - end_ns).max(0.0);
        (block.channel != receiver, away_ns)
    };
    blocks
        .of_emission(r.emission)
        .filter(|(_, block)| block.channel.is_echo())
        .map(|(index, block)| (rank(block), index, block))
        .min_by(|(a, ..), (b, ..)| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)))
        .map(|(_, index, block)| (index, block))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_return_is_in_the_block_of_its_receiver_that_holds_it() {
        let mut blocks = Blocks::default();
        blocks.push(0, Channel::LowPower, None, 100.0, 1.0, &[1; 40]);
        blocks.push(1, Channel::Reference, None, 0.0, 1.0, &[1; 400]);
        blocks.push(1, Channel::LowPower, None, 100.0, 1.0, &[1; 40]);
        blocks.push(1, Channel::LowPower, None, 200.0, 1.0, &[1; 40]);
        blocks.push(1, Channel::HighPower, None, 100.0, 1.0, &[1; 40]);
        let of = |channel, time_ns| {
            let r = Return { emission: 1, channel, ..Return::default() };
            block_of(&blocks, &r, time_ns).map(|(index, _)| index)
        };
        assert_eq!(of(ReturnChannel::Low, 110.0), Some(2));
        assert_eq!(of(ReturnChannel::Low, 239.0), Some(3));
        assert_eq!(of(ReturnChannel::Joint, 180.0), Some(3), "the nearest block");
        assert_eq!(of(ReturnChannel::High, 239.0), Some(4));
        let elsewhere = Return { emission: 2, ..Return::default() };
        assert_eq!(block_of(&blocks, &elsewhere, 110.0), None);
    }
}
