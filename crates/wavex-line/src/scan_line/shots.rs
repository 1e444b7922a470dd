//! Shots and the sample blocks recorded for them.

use wavex_footprints::RecordedNoise;

/// Receiver channels of an instrument.
///
/// Their codes in files are defined in `formats` only.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Channel {
    /// High-power receiver, for strong echoes (RIEGL: HI).
    HighPower,
    /// Low-power receiver, for weak echoes (RIEGL: LO).
    LowPower,
    /// A receiver that only indicates saturation.
    Saturation,
    /// The outgoing pulse.
    Reference,
}

/// One laser shot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Emission {
    /// Running number of the shot in its input, from 0.
    pub shot: u64,
    /// Time on the input's [`super::TimeScale`], s; NaN where unknown.
    pub gps_time_s: f64,
    /// The shot's time on the instrument's clock, ps from any origin: ranges are formed from this.
    pub clock_ps: i64,
    /// Where the beam starts, m, in the input's [`super::Frame`].
    pub origin_m: [f64; 3],
    /// Unit vector along the outgoing beam, in the input's frame.
    pub direction: [f64; 3],
    /// Length in the frame per metre of range along this beam, in units of the frame: 1, but for map
    /// projections.
    pub frame_scale: f64,
    /// The emission's time after `clock_ps`, ns: the peak of the outgoing pulse once it is fitted, else 0.
    pub emission_ns: f64,
    /// Standard deviation of `emission_ns`, ns; NaN until it is known.
    pub emission_sd_ns: f64,
    /// Mirror facet.
    pub facet: u16,
    /// Bits of [`emission_flags`].
    pub flags: u16,
    /// Emissions between this shot and the reception of its echoes; `None` while unresolved.
    pub mta_zone: Option<i16>,
    /// Scan angle, degrees, NaN where unknown; positive to the right of the flight direction.
    pub scan_angle_deg: f32,
}

impl Emission {
    /// Whether the waveform is a copy of the previous shot's waveform.
    pub fn is_copy(&self) -> bool {
        self.flags & emission_flags::COPY != 0
    }

    /// GPS time if it has one, else time of the instrument clock, s.
    pub fn time_s(&self) -> f64 {
        if self.gps_time_s.is_finite() { self.gps_time_s } else { self.clock_ps as f64 * 1e-12 }
    }
}

impl Default for Emission {
    /// A shot straight down from the frame's origin, of which nothing else is known.
    fn default() -> Emission {
        Emission {
            shot: 0,
            gps_time_s: f64::NAN,
            clock_ps: 0,
            origin_m: [0.0; 3],
            direction: [0.0, 0.0, -1.0],
            frame_scale: 1.0,
            emission_ns: 0.0,
            emission_sd_ns: f64::NAN,
            facet: 0,
            flags: 0,
            mta_zone: None,
            scan_angle_deg: f32::NAN,
        }
    }
}

/// Bits of [`Emission::flags`]; 0 to 2 as in the container and RIEGL files.
pub mod emission_flags {
    /// The clock is synchronised with GPS.
    pub const SYNCHRONISED: u16 = 1;
    /// The clock was synchronised within the last second.
    pub const SYNCHRONISED_WITHIN_LAST_SECOND: u16 = 1 << 1;
    /// Housekeeping record of the instrument.
    pub const HOUSEKEEPING: u16 = 1 << 2;
    /// The mirror moves in the positive direction (LAS: scan direction flag).
    pub const SCAN_DIRECTION_POSITIVE: u16 = 1 << 8;
    /// Last shot of a scan line (LAS: edge of flight line).
    pub const EDGE_OF_FLIGHT_LINE: u16 = 1 << 9;
    /// The echo blocks are byte-identical copies of the previous shot's blocks; set by readers.
    pub const COPY: u16 = 1 << 10;
    /// The trajectory had no pose for the shot when its line was decomposed, so that its returns are unknown; set by
    /// `read_returns`.
    pub const NOT_DECOMPOSED: u16 = 1 << 11;
}

/// Contiguous samples of one receiver.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Block {
    /// Index of the block's shot in the line.
    pub emission: u32,
    /// The receiver.
    pub channel: Channel,
    /// Multiple-time-around zone of the block, if different from the shot's.
    pub zone: Option<i16>,
    /// Whether the zone was assigned on weak evidence.
    pub is_zone_uncertain: bool,
    /// Time of the first sample after the shot's `clock_ps`, ns.
    pub start_ns: f64,
    /// Sampling interval, ns.
    pub interval_ns: f64,
    /// Gain relative to the reference gain.
    ///
    /// Positive; 1 without automatic gain control.
    pub gain: f64,
    /// Whether samples are fractions of a digitiser step.
    has_fractions: bool,
    /// Index of the first sample in its arena; [`NOT_HELD`] if samples were not read.
    first: u32,
    /// Number of samples.
    len: u32,
}

/// Index for samples that were not read, beyond any arena.
const NOT_HELD: u32 = u32::MAX;

/// A return computed by the instrument.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OnlineReturn {
    /// Index of the shot in the line.
    pub emission: u32,
    /// Time after the shot's `clock_ps`, ns.
    pub time_ns: f64,
    /// Amplitude in the instrument's own unit; NaN if unknown.
    pub amplitude: f32,
}

/// What a recording of large footprints says of a shot besides its samples.
#[derive(Clone, Debug, PartialEq)]
pub struct FootprintRecord {
    /// Index of the shot in the line.
    pub emission: u32,
    /// Number of the shot in its mission.
    pub shot_number: u64,
    /// Background and noise by the instrument's processing, if it states them.
    pub noise: Option<RecordedNoise>,
    /// Whether the instrument's own flags advise against the shot.
    pub is_degraded: bool,
    /// Values of the recording's further columns ([`super::InputInfo::columns`]).
    pub columns: Box<[f64]>,
}

/// Sample blocks of a line, ordered by shot; their samples are in one buffer per sample type.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Blocks {
    list: Vec<Block>,
    arena: Vec<u16>,
    fractions: Vec<f32>,
    /// The instrument's own returns, ordered by shot.
    pub online: Vec<OnlineReturn>,
    /// Records of large footprints, ordered by shot.
    pub footprints: Vec<FootprintRecord>,
}

impl Blocks {
    /// Creates an empty list with capacity for blocks and for samples.
    pub fn with_capacity(blocks: usize, samples: usize) -> Blocks {
        Blocks { list: Vec::with_capacity(blocks), arena: Vec::with_capacity(samples), ..Blocks::default() }
    }

    /// Creates an empty list with room for as many blocks and samples.
    pub fn of_same_size(&self) -> Blocks {
        Blocks::with_capacity(self.list.len(), self.arena.len())
    }

    /// Adds a block of `samples` (digitiser steps).
    ///
    /// Blocks must be added in order of their shots.
    ///
    /// # Panics
    /// The arena would exceed 2^32 samples; [`super::MAX_SHOTS_PER_LINE`] prevents this.
    pub fn push(
        &mut self,
        emission: u32,
        channel: Channel,
        zone: Option<i16>,
        start_ns: f64,
        interval_ns: f64,
        samples: &[u16],
    ) {
        debug_assert!(self.list.last().is_none_or(|last| last.emission <= emission));
        assert!(self.arena.len() + samples.len() <= u32::MAX as usize, "a scan line of over 2^32 samples");
        let (first, len) = (self.arena.len() as u32, samples.len() as u32);
        let is_zone_uncertain = false;
        self.list.push(Block {
            emission,
            channel,
            zone,
            is_zone_uncertain,
            start_ns,
            interval_ns,
            gain: 1.0,
            has_fractions: false,
            first,
            len,
        });
        self.arena.extend_from_slice(samples);
    }

    /// Adds a block of samples that are fractions of a digitiser step, as [`Blocks::push`].
    ///
    /// # Panics
    /// The arena would exceed 2^32 samples; [`super::MAX_SHOTS_PER_LINE`] prevents this.
    pub fn push_fractions(
        &mut self,
        emission: u32,
        channel: Channel,
        start_ns: f64,
        interval_ns: f64,
        samples: &[f32],
    ) {
        assert!(
            self.fractions.len() + samples.len() <= u32::MAX as usize,
            "a scan line of over 2^32 samples"
        );
        self.push_without_samples(emission, channel, None, start_ns, interval_ns, samples.len() as u32);
        if let Some(last) = self.list.last_mut() {
            last.has_fractions = true;
            last.first = self.fractions.len() as u32;
        }
        self.fractions.extend_from_slice(samples);
    }

    /// Adds a block with a known number of samples but no samples.
    ///
    /// [`Blocks::samples`] is empty for it.
    pub fn push_without_samples(
        &mut self,
        emission: u32,
        channel: Channel,
        zone: Option<i16>,
        start_ns: f64,
        interval_ns: f64,
        len: u32,
    ) {
        debug_assert!(self.list.last().is_none_or(|last| last.emission <= emission));
        self.list.push(Block {
            emission,
            channel,
            zone,
            start_ns,
            interval_ns,
            gain: 1.0,
            has_fractions: false,
            first: NOT_HELD,
            len,
            is_zone_uncertain: false,
        });
    }

    /// Sets the gain of the last block; dimensionless, positive.
    pub fn set_last_gain(&mut self, gain: f64) {
        self.list.last_mut().into_iter().for_each(|last| last.gain = gain);
    }

    /// Sets the zone of the last block.
    pub fn set_last_zone(&mut self, zone: Option<i16>) {
        self.list.last_mut().into_iter().for_each(|last| last.zone = zone);
    }

    /// Marks the zone of the last block as assigned on weak evidence.
    pub fn doubt_last_zone(&mut self) {
        self.list.last_mut().into_iter().for_each(|last| last.is_zone_uncertain = true);
    }

    /// Returns the block at an index.
    pub fn get(&self, index: usize) -> Option<&Block> {
        self.list.get(index)
    }

    /// Iterates over the blocks, ordered by shot.
    pub fn iter(&self) -> impl ExactSizeIterator<Item = &Block> + Clone + '_ {
        self.list.iter()
    }

    /// Number of blocks.
    pub fn len(&self) -> usize {
        self.list.len()
    }

    /// Whether there are no blocks.
    pub fn is_empty(&self) -> bool {
        self.list.is_empty()
    }

    /// Shifts the times of a receiver's blocks, ns.
    pub fn shift(&mut self, channel: Channel, by_ns: f64) {
        let of_channel = self.list.iter_mut().filter(|block| block.channel == channel);
        of_channel.for_each(|block| block.start_ns += by_ns);
    }

    /// Samples of a block, digitiser steps; empty if they were not read, or are fractions.
    pub fn samples(&self, block: &Block) -> &[u16] {
        held(&self.arena, block, false)
    }

    /// Samples of a block that are fractions of a digitiser step; empty if they were not read, or are whole steps.
    pub fn fractions(&self, block: &Block) -> &[f32] {
        held(&self.fractions, block, true)
    }

    /// Replaces the content of `into` by the samples of a block of either type, digitiser steps; by none if
    /// they were not read.
    pub fn fractions_into(&self, block: &Block, into: &mut Vec<f32>) {
        into.clear();
        into.extend_from_slice(self.fractions(block));
        into.extend(self.samples(block).iter().map(|&sample| f32::from(sample)));
    }

    /// Whether samples are fractions of a digitiser step.
    pub fn has_fractions(&self) -> bool {
        self.list.iter().any(|block| block.has_fractions)
    }

    /// Groups the blocks by shot: `(shot, its blocks)`, in order.
    pub fn by_emission(&self) -> impl Iterator<Item = (u32, &[Block])> + '_ {
        self.list.chunk_by(|a, b| a.emission == b.emission).map(|blocks| (blocks[0].emission, blocks))
    }

    /// Blocks of one shot, each with its index.
    pub fn of_emission(&self, emission: u32) -> impl Iterator<Item = (usize, &Block)> + Clone + '_ {
        let from = self.list.partition_point(|block| block.emission < emission);
        let until = self.list.partition_point(|block| block.emission <= emission);
        (from..until).zip(&self.list[from..until])
    }

    /// The instrument's own returns of one shot.
    pub fn online_of(&self, emission: u32) -> &[OnlineReturn] {
        let from = self.online.partition_point(|online| online.emission < emission);
        let until = self.online.partition_point(|online| online.emission <= emission);
        &self.online[from..until]
    }

    /// The record of the large footprint of a shot.
    pub fn footprint_of(&self, emission: u32) -> Option<&FootprintRecord> {
        let found = self.footprints.binary_search_by_key(&emission, |record| record.emission);
        self.footprints.get(found.ok()?)
    }

    /// Number of waveforms: shots with at least one echo block (`nw`).
    pub fn waveforms(&self) -> usize {
        self.by_emission().filter(|(_, blocks)| blocks.iter().any(|block| block.channel.is_echo())).count()
    }

    /// Keeps the blocks for which `keep` returns `true`; it gets each block with its samples.
    ///
    /// Samples of removed blocks stay in the arena until the line is dropped.
    pub fn retain(&mut self, mut keep: impl FnMut(&Block, &[u16]) -> bool) {
        let Blocks { list, arena, .. } = self;
        list.retain(|block| keep(block, held(arena, block, false)));
    }

    /// Keeps the blocks of the shots that have a new index.
    ///
    /// `place` is the new index by old index. Samples of removed blocks stay in the arena until the
    /// line is dropped.
    pub fn keep(&mut self, place: &[Option<u32>]) {
        let keep = |emission: &mut u32| match place.get(*emission as usize).copied().flatten() {
            Some(place) => {
                *emission = place;
                true
            }
            None => false,
        };
        self.list.retain_mut(|block| keep(&mut block.emission));
        self.online.retain_mut(|online| keep(&mut online.emission));
        self.footprints.retain_mut(|record| keep(&mut record.emission));
    }

    /// Memory used, bytes.
    pub fn bytes(&self) -> usize {
        self.list.capacity() * size_of::<Block>()
            + self.arena.capacity() * size_of::<u16>()
            + self.fractions.capacity() * size_of::<f32>()
            + self.online.capacity() * size_of::<OnlineReturn>()
            + self.footprints.capacity() * size_of::<FootprintRecord>()
    }
}

/// Samples of a block in the arena of its sample type; empty if they are of the other type, or not held.
fn held<'a, T>(arena: &'a [T], block: &Block, fractions: bool) -> &'a [T] {
    let from = (block.has_fractions == fractions).then(|| arena.get(block.first as usize..)).flatten();
    from.and_then(|samples| samples.get(..block.len as usize)).unwrap_or_default()
}

impl Channel {
    /// Whether the channel records echoes.
    pub fn is_echo(self) -> bool {
        matches!(self, Channel::HighPower | Channel::LowPower)
    }
}

/// Most samples of a block that is decomposed.
const MOST_SAMPLES: u32 = 16_384;

impl Block {
    /// Number of samples, whether they were read or not.
    pub fn len(&self) -> usize {
        self.len as usize
    }

    /// Whether its samples are fractions of a digitiser step.
    pub fn has_fractions(&self) -> bool {
        self.has_fractions
    }

    /// Whether the block has no samples.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// Whether the block has too many samples to be decomposed: the cost grows with the square of their number.
    ///
    /// Light travels 2.4 km and back in 16 384 samples of 1 ns.
    pub fn is_too_long(&self) -> bool {
        self.len > MOST_SAMPLES
    }

    /// Time of a position in the block after the shot's clock, ns.
    ///
    /// The position is in samples, with fraction.
    pub fn time_ns(&self, position_samples: f64) -> f64 {
        self.start_ns + position_samples * self.interval_ns
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blocks_share_an_arena_and_keep_their_emission() {
        let mut blocks = Blocks::default();
        blocks.push(0, Channel::Reference, None, 0.0, 1.0, &[1, 2]);
        blocks.push(0, Channel::LowPower, None, 100.0, 1.0, &[3, 4, 5]);
        blocks.push(2, Channel::Reference, None, 0.0, 1.0, &[6]);
        let groups: Vec<(u32, usize)> = blocks.by_emission().map(|(e, blocks)| (e, blocks.len())).collect();
        assert_eq!(groups, [(0, 2), (2, 1)]);
        let samples: Vec<&[u16]> = blocks.iter().map(|block| blocks.samples(block)).collect();
        assert_eq!(samples, [&[1, 2][..], &[3, 4, 5], &[6]]);
        blocks.shift(Channel::LowPower, -0.5);
        let starts: Vec<f64> = blocks.iter().map(|block| block.start_ns).collect();
        assert_eq!(starts, [0.0, 99.5, 0.0]);
        assert_eq!(blocks.waveforms(), 1, "a shot with only its outgoing pulse is no waveform");
    }

    #[test]
    fn blocks_without_samples_keep_their_length() {
        let mut blocks = Blocks::default();
        blocks.push_without_samples(0, Channel::LowPower, None, 0.0, 1.0, 3);
        blocks.push(0, Channel::HighPower, None, 0.0, 1.0, &[1, 2, 3, 4]);
        let seen: Vec<(usize, &[u16])> =
            blocks.iter().map(|block| (block.len(), blocks.samples(block))).collect();
        assert_eq!(seen, [(3, &[][..]), (4, &[1, 2, 3, 4])]);
    }

    #[test]
    fn fractions_are_kept_beside_steps() {
        let mut blocks = Blocks::default();
        blocks.push_fractions(0, Channel::Reference, 0.0, 1.0, &[0.25, 0.5]);
        blocks.push(0, Channel::LowPower, None, 0.0, 1.0, &[7, 9]);
        blocks.push_fractions(1, Channel::LowPower, 5.0, 1.0, &[1.5]);
        let mut of_block = Vec::new();
        let all: Vec<Vec<f32>> = blocks
            .iter()
            .map(|block| {
                blocks.fractions_into(block, &mut of_block);
                of_block.clone()
            })
            .collect();
        assert_eq!(all, [vec![0.25, 0.5], vec![7.0, 9.0], vec![1.5]]);
        let steps: Vec<&[u16]> = blocks.iter().map(|block| blocks.samples(block)).collect();
        assert_eq!(steps, [&[][..], &[7, 9], &[]]);
        assert!(blocks.has_fractions() && !Blocks::default().has_fractions());
    }

    #[test]
    fn online_returns_are_found_by_emission() {
        let online = |emission, time_ns| OnlineReturn { emission, time_ns, amplitude: f32::NAN };
        let blocks =
            Blocks { online: vec![online(1, 5.0), online(1, 9.0), online(4, 7.0)], ..Blocks::default() };
        let times = |e| blocks.online_of(e).iter().map(|o| o.time_ns).collect::<Vec<_>>();
        assert_eq!(times(0), Vec::<f64>::new());
        assert_eq!(times(1), [5.0, 9.0]);
        assert_eq!(times(4), [7.0]);
    }

    #[test]
    fn blocks_go_with_their_emissions() {
        let mut blocks = Blocks::default();
        (0..4).for_each(|emission| {
            blocks.push(emission, Channel::LowPower, None, 0.0, 1.0, &[emission as u16])
        });
        let online = |emission| OnlineReturn { emission, time_ns: 0.0, amplitude: 1.0 };
        blocks.online = vec![online(0), online(3)];
        blocks.keep(&[None, Some(0), None, Some(1)]);
        let left: Vec<(u32, &[u16])> =
            blocks.iter().map(|block| (block.emission, blocks.samples(block))).collect();
        assert_eq!(left, [(0, &[1][..]), (1, &[3])]);
        assert_eq!(blocks.online, [online(1)]);
    }

    #[test]
    fn a_position_in_a_block_has_a_time() {
        let mut blocks = Blocks::default();
        blocks.push(0, Channel::LowPower, None, 100.5, 0.5, &[0; 8]);
        assert_eq!(blocks.iter().next().unwrap().time_ns(3.0), 102.0);
    }
}
