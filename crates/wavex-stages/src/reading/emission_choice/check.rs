//! Check of an emission reference that a file states or a job sets.

use super::{Choice, ChoiceMessage, Smoothness, WITH_LOCATIONS, WITH_OUTGOING, name};
use wavex_line::scan_line::{Block, Channel, EmissionReference, ScanLine};
use wavex_line::stage::Context;

/// A reference is contradicted if another leaves less than this part of its second differences. Peaks
/// of outgoing pulses are estimated more coarsely here than by the fit, so this is less than for a choice.
const CONTRADICTS: f64 = 0.5;
/// Smallest part of the second differences that are two samples, for a warning. A displaced shot causes a
/// second difference of two samples; a step of the ground does not.
const DISPLACED_PART: f64 = 0.03;
/// Largest number of shots that are checked along a recording.
const MOST_CHECKED_SHOTS: usize = 20_000;

impl Smoothness {
    /// Takes the reference that the job sets, with a warning if the points contradict it.
    pub(crate) fn set(&self, reference: EmissionReference) -> Choice {
        let choice = self.take(reference);
        let warning = self.contradiction(reference).map(ChoiceMessage::Warning);
        Choice { message: warning.or(choice.message), ..choice }
    }

    /// What contradicts a reference, if anything does: points that are smoother with another one, or
    /// that jump by a sample.
    pub(super) fn contradiction(&self, reference: EmissionReference) -> Option<String> {
        if self.points_ns.len() < super::LEAST_TRIPLES {
            return None;
        }
        let figures = self.figures(&self.points_ns);
        let (index, (_, own)) = figures.iter().enumerate().find(|(_, (of, _))| *of == reference)?;
        let smoother = figures.iter().filter(|(_, of)| of.is_below(CONTRADICTS, own));
        let smoothest = smoother.min_by(|(_, a), (_, b)| a.whole_ns.total_cmp(&b.whole_ns));
        if let Some((other, _)) = smoothest {
            return Some(format!(
                "the emission times are by `{}`, but points are smoother by `{}`: ranges may be wrong by \
                 the difference of both; correct the source of emission times that the file or the job states ({})",
                name(reference),
                name(*other),
                self.text()
            ));
        }
        // The standard deviation of a clock without proof already covers one sample.
        let is_displaced = self.displaced_part(index) >= DISPLACED_PART;
        (reference != EmissionReference::Clock && is_displaced).then(|| {
            format!(
                "the points of some shots are one sample from those of their neighbours: emission times or \
                 waveforms of these shots are displaced by a sample, and so are their ranges; export the recording \
                 again ({})",
                self.text()
            )
        })
    }
}

/// Check along a recording whose file states the reference.
#[derive(Default)]
pub(crate) struct EmissionCheck {
    /// Of the reference of the first line; `None` before, and without another source to compare it with.
    stated: Option<(EmissionReference, Smoothness)>,
    has_begun: bool,
}

impl EmissionCheck {
    /// Adds a line with marked copies, unless enough were seen.
    pub(crate) fn add(&mut self, line: &ScanLine) {
        if !self.has_begun {
            self.stated = of_line(line);
            self.has_begun = true;
        }
        if let Some((_, smoothness)) = &mut self.stated
            && smoothness.shots < MOST_CHECKED_SHOTS
            && !smoothness.is_enough()
        {
            smoothness.add(line);
        }
    }

    /// Warns if the points contradict what the file states.
    pub(crate) fn report(&self, cx: &mut Context) {
        let problem = self.stated.as_ref().and_then(|(stated, points)| points.contradiction(*stated));
        problem.into_iter().for_each(|problem| cx.warn(problem));
    }
}

/// The reference of a line, and the comparison of it with others.
fn of_line(line: &ScanLine) -> Option<(EmissionReference, Smoothness)> {
    let stated = line.input.emission_reference;
    let is_outgoing = |block: &Block| block.channel == Channel::Reference;
    let references = match stated {
        EmissionReference::ReturnLocations => WITH_LOCATIONS,
        _ if line.blocks()?.iter().any(is_outgoing) => WITH_OUTGOING,
        _ => return None,
    };
    Some((stated, Smoothness::by(references)))
}
