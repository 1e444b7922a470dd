//! Reasons why a stage drops shots, blocks or returns.
//!
//! Every item that a run drops has one of these reasons. [`page`] lists them for users
//! (`docs/reference/reasons.md`).

use std::cmp::Ordering;
use std::fmt::{self, Display, Formatter};

mod page;

pub use page::page;

/// Items counted by stages.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Item {
    /// Shots.
    Shots,
    /// Sample blocks.
    Blocks,
    /// Returns and points.
    Returns,
}

impl Item {
    /// All item types.
    pub const ALL: [Item; 3] = [Item::Shots, Item::Blocks, Item::Returns];

    /// Name in reports.
    pub fn name(self) -> &'static str {
        match self {
            Item::Shots => "shots",
            Item::Blocks => "blocks",
            Item::Returns => "returns",
        }
    }
}

/// Counter in which a dropped item appears.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Counter {
    /// `rejected` of the stage.
    Rejected,
    /// `rejected` of the stage, for the shot and for its blocks.
    RejectedWithBlocks,
    /// `rejected` of the stage; the loss is expected, and no reason for a warning.
    Expected,
    /// `np_filtered` of the scan line, and `filtered_by_reason` of the report.
    Filtered,
    /// `rejected` of the stage, and as [`Counter::Filtered`].
    RejectedAndFiltered,
}

/// Description of a reason.
#[derive(Clone, Copy, Debug)]
pub struct Description {
    /// Items that it drops.
    pub item: Item,
    /// Text in reports, logs and pages.
    pub text: &'static str,
    /// Counter of the dropped items.
    pub counter: Counter,
    /// Stages that use it; empty: a stage outside of this crate.
    pub stages: &'static [&'static str],
    /// What the user can do.
    pub remedy: &'static str,
}

/// A description whose items are counted in `rejected` of the stage.
const fn rejected(
    item: Item,
    text: &'static str,
    stages: &'static [&'static str],
    remedy: &'static str,
) -> Description {
    Description { item, text, counter: Counter::Rejected, stages, remedy }
}

/// A shot that is dropped with its blocks.
const fn shot(text: &'static str, stages: &'static [&'static str], remedy: &'static str) -> Description {
    Description { counter: Counter::RejectedWithBlocks, ..rejected(Item::Shots, text, stages, remedy) }
}

/// A shot of HDF5 that the job does not ask for.
const fn cut(text: &'static str, remedy: &'static str) -> Description {
    Description { counter: Counter::Expected, ..rejected(Item::Shots, text, HDF5, remedy) }
}

const fn block(text: &'static str, stages: &'static [&'static str], remedy: &'static str) -> Description {
    rejected(Item::Blocks, text, stages, remedy)
}

/// A candidate of a return that is counted in `np_filtered` alone.
const fn candidate(text: &'static str, stages: &'static [&'static str], remedy: &'static str) -> Description {
    Description { counter: Counter::Filtered, ..of_return(text, stages, remedy) }
}

const fn of_return(text: &'static str, stages: &'static [&'static str], remedy: &'static str) -> Description {
    rejected(Item::Returns, text, stages, remedy)
}

const ARROW: &[&str] = &["read_arrow"];
const ARROW_AND_HDF5: &[&str] = &["read_arrow", "read_hdf5"];
const ARROW_AND_SDF: &[&str] = &["read_arrow", "read_sdf"];
const LOCATING: &[&str] = &["read_arrow", "read_sdf", "read_hdf5"];
const LAS: &[&str] = &["read_las"];
const PULSEWAVES: &[&str] = &["read_pulsewaves"];
const PULSEWAVES_AND_HDF5: &[&str] = &["read_pulsewaves", "read_hdf5"];
const HDF5: &[&str] = &["read_hdf5"];
const FOOTPRINTS: &[&str] = &["measure_footprints"];
const SDF: &[&str] = &["read_sdf"];
const READERS: &[&str] = &["read_las", "read_pulsewaves", "read_sdf", "read_arrow", "read_hdf5"];
const SOURCES: &[&str] = &["read_las", "read_pulsewaves", "read_sdf", "read_arrow", "read_hdf5", "simulate"];
const MTA: &[&str] = &["resolve_mta"];
const CALIBRATE: &[&str] = &["calibrate"];
const DECOMPOSE: &[&str] = &["decompose"];

const EXPORT_AGAIN: &str = "export the recording again";
const CORRECT_WRITER: &str = "correct the program that wrote the container";

/// Defines [`Reason`], so that no reason is without its description or missing in [`Reason::ALL`].
macro_rules! reasons {
    ($($(#[$doc:meta])* $name:ident => $description:expr,)*) => {
        /// Reason to drop an item.
        ///
        /// Two reasons are equal, and sorted, by their texts and items.
        #[derive(Clone, Copy, Debug)]
        pub enum Reason {
            $($(#[$doc])* $name,)*
            /// Reason of a stage outside of this crate: its items, and its text in reports.
            ///
            /// The text is a constant of that stage, or lives as long as the program
            /// (`Box::leak`), because reports name reasons after the stage has ended. It is not
            /// part of [`Reason::ALL`] and of the page of reasons.
            Custom(Item, &'static str),
        }

        impl Reason {
            /// All reasons of this crate, in the order of the processing.
            pub const ALL: &[Reason] = &[$(Reason::$name),*];

            /// Returns its description.
            pub const fn description(self) -> Description {
                match self {
                    $(Reason::$name => $description,)*
                    Reason::Custom(item, text) => rejected(item, text, &[], "see the documents of the stage"),
                }
            }
        }
    };
}

reasons! {
    /// LAS: the waveform of a point cannot be read.
    UnreadableWaveform => block("a point's waveform that cannot be read", LAS, "copy or export the file again; the warning names the first one"),
    /// LAS: a point without a waveform.
    PointWithoutWaveform => of_return("a point without waveform", LAS, "none if the instrument records waveforms of some shots only; else export the file with all waveforms"),
    /// LAS: a point without a direction or a return location.
    PointWithoutBeam => of_return("a point without direction or location", LAS, EXPORT_AGAIN),
    /// LAS: a waveform that belongs to points of several pulses.
    SharedWaveform => block("a waveform that was read with an earlier pulse", LAS, "none: its returns belong to the earlier pulse; points sorted by time have no such waveforms"),
    /// PulseWaves: the waves of a pulse cannot be read.
    UnreadableWaves => rejected(Item::Shots, "a pulse whose waves cannot be read", PULSEWAVES, "copy or export the files again; the warning names the first one"),
    /// PulseWaves: anchor and target of a pulse are equal.
    PulseWithoutDirection => rejected(Item::Shots, "a pulse without direction", PULSEWAVES, EXPORT_AGAIN),
    /// PulseWaves and SPD: a block of a channel without a receiver.
    UnknownChannel => block("a block of an unknown channel", PULSEWAVES_AND_HDF5, "export it with channel 0 (high power), 1 (low power) or 2 (saturation)"),
    /// HDF5: the values of a shot cannot be read.
    UnreadableShot => rejected(Item::Shots, "a shot that cannot be read", HDF5, "copy or download the file again; the warning names the first one"),
    /// SPD: a pulse without received samples.
    PulseWithoutWaveform => rejected(Item::Shots, "a pulse without received samples", HDF5, "none if the instrument records waveforms of some pulses only; else write the file with all waveforms"),
    /// HDF5: the positions of a shot's first and last sample are missing.
    ShotWithoutPosition => rejected(Item::Shots, "a shot without the positions of its first and last sample", HDF5, "none: the product did not locate it"),
    /// HDF5: the first sample of a shot is outside of the area of the job.
    OutsideExtent => cut("outside `extent_deg`", "none: the job reads a part of the recording; widen `extent_deg` for more"),
    /// HDF5: the time of a shot is outside of the window of the job.
    OutsideTimes => cut("outside `time_s`", "none: the job reads a part of the recording; widen `time_s` for more"),
    /// HDF5: the job has a list of shots without this one.
    NotInShots => cut("not in `shots`", "none: the job reads a part of the recording; add the number to `shots` for more"),
    /// Container: the clock of a shot is earlier than the one before.
    BackwardClock => shot("the clock runs backwards", ARROW, CORRECT_WRITER),
    /// Container: two rows in sequence have the same shot number.
    RepeatedShotNumber => shot("the shot number is that of the row before", ARROW, CORRECT_WRITER),
    /// The origin of a shot is not finite.
    OriginNotFinite => shot("the origin is not finite", LOCATING, EXPORT_AGAIN),
    /// The direction of a shot is not finite.
    DirectionNotFinite => shot("the direction is not finite", LOCATING, EXPORT_AGAIN),
    /// The direction of a shot does not have the length 1.
    DirectionNotUnit => shot("the direction is not a unit vector", ARROW_AND_SDF, EXPORT_AGAIN),
    /// The time of a shot is infinite.
    TimeInfinite => shot("the time is infinite", ARROW_AND_SDF, EXPORT_AGAIN),
    /// Container: the frame scale of a shot is impossible.
    WrongFrameScale => shot("the frame scale is not between 0.1 and 10", ARROW, CORRECT_WRITER),
    /// Container: the scan angle of a shot is more than half a turn.
    WrongScanAngle => shot("the scan angle is not between -180 and 180 degrees", ARROW, CORRECT_WRITER),
    /// A shot with a block of an unknown channel.
    ShotWithUnknownChannel => shot("a block of an unknown channel", ARROW_AND_SDF, "write the block with a channel code of the format"),
    /// A shot with a block without a time.
    BlockWithoutTime => shot("a block without a time", ARROW_AND_SDF, EXPORT_AGAIN),
    /// Container and SPD: a shot with a block that is too far away.
    FarBlock => shot("a block more than 0.01 s from its shot", ARROW_AND_HDF5, "correct the program that wrote the file"),
    /// Container: a shot with a block of an impossible sampling interval.
    WrongInterval => shot("a block whose interval is not between 0.05 and 20 ns", ARROW, CORRECT_WRITER),
    /// Container: a shot with a block of an impossible gain.
    WrongGain => shot("a block whose gain is not between 1/1024 and 1024", ARROW, CORRECT_WRITER),
    /// Container: a shot with a return of the instrument that has no time.
    OnlineWithoutTime => shot("an online return without a time", ARROW, CORRECT_WRITER),
    /// A sample that is NaN or infinite.
    SampleNotFinite => shot("a sample is not finite", ARROW, CORRECT_WRITER),
    /// SDF: the clock of a shot is not finite.
    ClockNotFinite => shot("the clock is not finite", SDF, EXPORT_AGAIN),
    /// SDF: the clock of a shot does not fit into whole picoseconds.
    ClockTooLate => shot("the clock is beyond 106 days", SDF, EXPORT_AGAIN),
    /// SDF: a block of a record that is not a shot.
    Housekeeping => block("a block of a housekeeping record", SDF, "none: it has no echoes"),
    /// A shot without a time, if a time window is set.
    WithoutTime => shot("no time, although `time_s` is set", READERS, "remove `time_s`, or cut the window from a recording with times"),
    /// A shot at a time without a pose.
    OutsideTrajectory => shot("outside the trajectory", SOURCES, "give a trajectory of the whole flight; check `trajectory_time` of `[job.geometry]` and `time_offset_s` of the reader"),
    /// Range ambiguity: no shot can have caused the block.
    NoEmission => block("no emission at a distance within `range_m`", MTA, "widen `range_m` if the ground or the air between is outside of it"),
    /// Range ambiguity: a block too far from the shot in whose record it is.
    BlockFarFromShot => block("a block a second or more from its shot", MTA, EXPORT_AGAIN),
    /// A block whose shot the line does not have.
    BlockWithoutShot => block("its shot is not in the line", &["resolve_mta", "decompose"], "report it as a bug, unless a stage of your own removed the shot"),
    /// The receiver of a block always gives the same value.
    DeadReceiver => block("the receiver is dead: all samples are equal", CALIBRATE, "check the receiver"),
    /// The receiver of a block gives a constant level far from its background.
    FlatSamples => block("the samples are flat, far from the background", CALIBRATE, "check the receiver, or calibrate from this recording"),
    /// A block with too many samples.
    LongBlock => block("a block of more than 16384 samples", DECOMPOSE, "split the block into blocks of at most 16384 samples"),
    /// A block of a receiver without a sensor model.
    UnknownReceiver => block("its receiver is not in the sensor model", DECOMPOSE, "calibrate on a part of the recording with echoes of this receiver, or give a model that has it"),
    /// A waveform that cannot be measured as a large footprint.
    WithoutBackground => block("a waveform without background beside its signal", FOOTPRINTS, "none if the signal fills the block; else check the sample type of the file"),
    /// A shot of a beam without noise and response: they were neither learnt nor loaded.
    BeamNotLearnt => rejected(Item::Shots, "its beam has too few shots to learn noise and response, or no loaded model", FOOTPRINTS, "read a longer part of the beam, load its model, or leave it out with `beams` of read_hdf5"),
    /// A block without samples.
    EmptyBlock => block("a block without samples", DECOMPOSE, "none: nothing was recorded"),
    /// A high-power block whose echoes the low-power receiver has as well.
    RecordedTwice => Description {
        counter: Counter::Expected,
        ..block("the low-power receiver recorded it as well", DECOMPOSE, "none: no echo is lost; `fuse_channels` uses both receivers where the low-power one is overdriven")
    },
    /// Candidate: the responses of stronger candidates explain it.
    Screened => candidate("explained by a stronger one", DECOMPOSE, "none if the receiver rings after strong echoes; else calibrate on more waveforms"),
    /// Candidate: stronger ones fill the limit of returns per waveform.
    InExcess => candidate("in excess of the strongest 24", DECOMPOSE, "none: a waveform has at most 24 returns"),
    /// Candidate: its fit has no optimum.
    Undetermined => candidate("not determined by the samples", DECOMPOSE, "look at the shot with `wavex explain`; saturated or cut off echoes have too few samples"),
    /// Candidate: below the threshold.
    TooWeak => candidate("too weak", DECOMPOSE, "lower `detection_sigma` or `detection_sigma_last`"),
    /// Candidate: narrower than the range of widths.
    TooNarrow => candidate("too narrow", DECOMPOSE, "lower the first value of `width_ratio`, or calibrate again if many are too narrow"),
    /// Candidate: wider than the range of widths.
    TooWide => candidate("too wide", DECOMPOSE, "raise the second value of `width_ratio`, or calibrate again if many are too wide"),
    /// Candidate: its peak is before or after the samples.
    OutsideBlock => candidate("outside its block", DECOMPOSE, "none: its peak was not recorded"),
    /// Candidate: the smoothed waveform has no maximum there.
    WithoutMode => candidate("without a maximum of the waveform", DECOMPOSE, "calibrate on a recording whose echoes determine the response"),
    /// Candidate of the high-power receiver that the low-power receiver lacks.
    NotInLowPower => candidate("not found by the low-power receiver", DECOMPOSE, "none: the low-power receiver recorded its time; without `fuse_channels` receivers are not compared"),
    /// Candidate of an overdriven low-power receiver that the high-power receiver lacks.
    NotInHighPower => candidate("not found by the high-power receiver", DECOMPOSE, "none: the error of the response next to an overdriven echo explains it; without `fuse_channels` receivers are not compared"),
    /// A return of a waveform that jumps from its neighbours.
    DeviatingWaveform => Description {
        counter: Counter::RejectedAndFiltered,
        ..of_return("a return of a waveform that deviates from its line", &["filter_outliers"], "raise `max_height_m`, or set `waves = false`")
    },
    /// A return that a stage outside of this crate rejects.
    OwnStage => candidate("rejected by a stage of your own", &[], "see `rejected` of that stage for its reasons"),
    /// LAS output: a waveform of a kind for which no descriptor is left.
    IndescribableWaveform => block("a waveform of a kind that the file cannot describe", &["write_las"], "write fewer kinds of waveforms (lengths and intervals) into one file, or use `write_arrow`; the points are written"),
    /// LAS output: a point beyond the range of 32-bit coordinates.
    PointTooFar => of_return("a point too far away for the coordinates of the file", &["write_las"], "increase `coordinate_step` if the point is right"),
    /// Table: a return whose shot the line does not have.
    ReturnWithoutShot => of_return("its shot is not in the line", &["write_table"], "report it as a bug, unless a stage of your own removed the shot"),
}

impl Reason {
    /// Text in reports, logs and pages.
    pub const fn text(self) -> &'static str {
        self.description().text
    }

    /// Items that it drops.
    pub const fn item(self) -> Item {
        self.description().item
    }

    /// Whether a stage may use it, by the list of its stages.
    ///
    /// The engine applies poses to every source, so any source may have shots outside the trajectory.
    pub fn is_of(self, stage: &str) -> bool {
        let stages = self.description().stages;
        stages.is_empty() || stages.contains(&stage) || self == Reason::OutsideTrajectory
    }

    /// Whether the loss is expected, and no reason for a warning.
    pub const fn is_expected(self) -> bool {
        matches!(self.description().counter, Counter::Expected)
    }
}

impl Display for Reason {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        f.write_str(self.text())
    }
}

impl Ord for Reason {
    fn cmp(&self, other: &Reason) -> Ordering {
        (self.text(), self.item()).cmp(&(other.text(), other.item()))
    }
}

impl PartialOrd for Reason {
    fn partial_cmp(&self, other: &Reason) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl PartialEq for Reason {
    fn eq(&self, other: &Reason) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}

impl Eq for Reason {}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    #[test]
    fn reasons_differ_and_are_described() {
        let different: BTreeSet<Reason> = Reason::ALL.iter().copied().collect();
        assert_eq!(different.len(), Reason::ALL.len(), "two reasons have the same text and item");
        for reason in Reason::ALL {
            let Description { text, stages, remedy, .. } = reason.description();
            assert!(!text.is_empty() && !remedy.is_empty(), "{reason:?}");
            assert!(!stages.is_empty() || matches!(reason, Reason::OwnStage), "{reason:?}");
        }
    }

    #[test]
    fn reasons_belong_to_their_stages() {
        assert!(Reason::TooWeak.is_of("decompose") && !Reason::TooWeak.is_of("calibrate"));
        assert!(Reason::OutsideTrajectory.is_of("a source of a user"));
        assert!(Reason::Custom(Item::Shots, "truncated").is_of("a stage of a user"));
    }

    #[test]
    fn custom_reasons_have_their_text_and_item() {
        let reason = Reason::Custom(Item::Shots, "truncated");
        assert_eq!((reason.text(), reason.item(), reason.is_expected()), ("truncated", Item::Shots, false));
        assert_eq!(reason.to_string(), "truncated");
        assert_ne!(reason, Reason::Custom(Item::Blocks, "truncated"));
    }
}
