//! Accuracy files of a trajectory: POQ or smrmsg.

use std::path::{Path, PathBuf};

use super::super::{Error, Result};
use super::clock_range::{TimeConversion, may_be};
use super::input::InputFile;
use super::{Recorded, poq, smrmsg};
use wavex_geodesy::time_axis::{Clock, TimeSpan, Unwrap, align};
use wavex_geodesy::trajectory::AccuracySample;

/// Reads the accuracies in the file `path`, on the time axis of a trajectory.
pub(super) fn on_axis(
    path: &Path,
    recorded: &Recorded,
    placed: TimeConversion,
) -> Result<Vec<AccuracySample>> {
    let mut samples = read(path)?;
    if samples.is_empty() || recorded.records.is_empty() {
        return Ok(samples);
    }
    place(path, &mut samples, recorded.times(), placed)?;
    Ok(samples)
}

/// Returns the POQ next to a POF.
pub(super) fn poq_of(pof: &Path) -> Option<PathBuf> {
    ["poq", "POQ"].map(|extension| pof.with_extension(extension)).into_iter().find(|path| path.is_file())
}

fn read(path: &Path) -> Result<Vec<AccuracySample>> {
    let mut input = InputFile::open(path)?;
    let head = input.head()?;
    if head.starts_with(poq::MAGIC) {
        return poq::read(&mut input);
    }
    if smrmsg::is_one(&head, input.length) {
        return smrmsg::read(&mut input);
    }
    let problem = "it holds no accuracies: it is neither a POQ nor records of ten numbers (smrmsg)";
    Err(Error::unusable(path, problem, "give the .poq of the POF, or the smrmsg_*.out of the SBET"))
}

/// Puts accuracies on the time axis of the trajectory.
///
/// They use its clock, unless the trajectory has adjusted times and the accuracies fit seconds of
/// the week.
fn place(
    path: &Path,
    samples: &mut [AccuracySample],
    trajectory: TimeSpan,
    placed: TimeConversion,
) -> Result<()> {
    let times_s = samples.iter().map(|sample| sample.time_s);
    let limits_s = times_s.fold([f64::INFINITY, f64::NEG_INFINITY], |[a, b], t| [a.min(t), b.max(t)]);
    let is_week = placed.clock == Clock::Adjusted && may_be(Clock::Week, limits_s);
    let clock = if is_week { Clock::Week } else { placed.clock };
    let mut unwrap = Unwrap::new(clock);
    for sample in samples.iter_mut() {
        sample.time_s = unwrap.next(sample.time_s) + placed.leap_s;
    }
    let ends_s =
        [samples.first(), samples.last()].map(|sample| sample.map_or(f64::NAN, |sample| sample.time_s));
    let own = TimeSpan { clock, first_s: ends_s[0], last_s: ends_s[1] };
    let alignment = align(own, trajectory).map_err(|_| {
        let problem = format!("its accuracies cover {own}, but the trajectory covers {trajectory}");
        Error::unusable(path, problem, "give the accuracies of this trajectory")
    })?;
    let shift_s = alignment.on_trajectory(own.first_s) - own.first_s;
    samples.iter_mut().for_each(|sample| sample.time_s += shift_s);
    Ok(())
}
