//! Division of a recording into stretches of scan lines, for halves and jackknife.

use super::Triple;

/// Number of stretches, about.
pub(super) const STRETCHES: usize = 40;
/// Triples whose middle shots are closer share echoes.
const SHARED_ECHOES_SHOTS: u64 = 3;

/// Stretch of every triple, from 0, and number of stretches.
///
/// A stretch ends where its last triple and the next one share no echo; one without such a place
/// ends after twice its length.
pub(super) fn stretches(triples: &[Triple]) -> (Vec<usize>, usize) {
    let length = triples.len().div_ceil(STRETCHES).max(1);
    let (mut stretch, mut first) = (0, 0);
    let mut of_triples = Vec::with_capacity(triples.len());
    for (i, triple) in triples.iter().enumerate() {
        let is_apart = i > 0 && triple.shot.abs_diff(triples[i - 1].shot) >= SHARED_ECHOES_SHOTS;
        if i - first >= length && (is_apart || i - first >= 2 * length) {
            (stretch, first) = (stretch + 1, i);
        }
        of_triples.push(stretch);
    }
    (of_triples, stretch + 1)
}

/// Variance of an estimate by the jackknife, from the estimates without one stretch each.
pub(super) fn jackknife_variance(all: f64, without_one: impl Iterator<Item = f64>) -> f64 {
    let (mut squares, mut count) = (0.0, 0.0);
    for estimate in without_one {
        squares += (estimate - all).powi(2);
        count += 1.0;
    }
    squares * (count - 1.0) / count
}
