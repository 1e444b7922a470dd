//! Results of several installations: their parameters, what connects them, strips in the wrong job.

use super::jobs::JobPlace;
use super::strips::SurveyStrips;
use wavex_align::estimable::{FlightFacts, Verdict};
use wavex_align::result::{Alignment, ParameterResult};

/// Results of an installation.
pub(super) struct InstallationResult<'a> {
    /// Name; `None` for a single job.
    pub(super) name: Option<&'a str>,
    pub(super) parameters: &'a [ParameterResult],
    pub(super) facts: &'a FlightFacts,
}

/// Results of all installations, in the order of the jobs.
pub(super) fn installations<'a>(
    places: &'a [JobPlace<'_>],
    result: &'a Alignment,
) -> impl Iterator<Item = InstallationResult<'a>> {
    let facts = result.installation_facts.iter();
    places.iter().zip(&result.parameters).zip(facts).map(|((place, parameters), facts)| InstallationResult {
        name: place.name.as_deref(),
        parameters,
        facts,
    })
}

/// Whether a strip of the installation has pairs.
pub(super) fn is_aligned(survey: &SurveyStrips, result: &Alignment, installation: usize) -> bool {
    let mut strips = survey.strips.iter().zip(&result.strips);
    strips.any(|(strip, found)| strip.installation == installation && found.n_pairs > 0)
}

/// Installations that share no surface, and what follows.
pub(super) fn unconnected_jobs(
    places: &[JobPlace<'_>],
    survey: &SurveyStrips,
    result: &Alignment,
) -> Vec<String> {
    let mut groups: Vec<usize> = (0..places.len()).collect();
    for overlap in result.overlaps.iter().filter(|overlap| overlap.n_pairs > overlap.n_rejected) {
        let [a, b] = overlap.strips.map(|strip| groups[survey.strips[strip as usize].installation]);
        groups.iter_mut().filter(|group| **group == b).for_each(|group| *group = a);
    }
    let names = |group: usize| {
        let own = places.iter().zip(&groups).filter(|(_, own)| **own == group);
        own.map(|(place, _)| place.job.name.as_str()).collect::<Vec<_>>().join(", ")
    };
    let first = groups.first().copied().unwrap_or_default();
    let mut others: Vec<usize> = groups.iter().copied().filter(|group| *group != first).collect();
    others.sort_unstable();
    others.dedup();
    let text = |other| {
        format!(
            "{} and {} share no smooth surface: each is aligned by itself, and a shift or tilt of one against the other is not \
             determined; add strips that overlap both, or control points in both",
            names(first),
            names(other)
        )
    };
    others.into_iter().map(text).collect()
}

/// Warning about strips that were probably given to the wrong job; `None` without such strips or other jobs.
pub(super) fn misplaced(survey: &SurveyStrips, result: &Alignment) -> Option<String> {
    const OFFSETS: [&str; 6] = ["north", "east", "down", "roll", "pitch", "heading"];
    if survey.scanners.len() < 2 || result.verdict == Verdict::Bad {
        return None;
    }
    let found = result.misplaced_strips();
    let list: Vec<String> = found
        .iter()
        .map(|own| {
            let value = match own.offset {
                0..3 => format!("{:.3} m", own.mean),
                _ => format!("{:.3}°", own.mean.to_degrees()),
            };
            let name = &survey.strips[own.strip].name;
            format!("`{name}` by {value} in {}, {:.0} SDs", OFFSETS[own.offset], own.sds)
        })
        .collect();
    (!list.is_empty()).then(|| {
        format!(
            "trajectories are corrected by far more than their SDs: {}; the first was probably flown with the installation of \
             another job",
            list.join(", ")
        )
    })
}
