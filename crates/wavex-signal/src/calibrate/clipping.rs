//! Level at which a receiver clips, from an accumulation of the highest samples.

use crate::decompose::Waveform;

/// Range of highest samples below the top value whose density predicts its count, relative to it.
const RANGE_PART: f64 = 0.1;
/// Smallest number of blocks that reach the top value …
const MIN_BLOCKS: u32 = 10;
/// … its smallest ratio to the number predicted …
const LEAST_RATIO: f64 = 3.0;
/// … and the smallest excess, in standard deviations of a count.
const LEAST_EXCESS_SD: f64 = 5.0;
/// Largest fraction of blocks that reach the top value: constant pulses do not accumulate.
const LARGEST_PART: f64 = 0.5;

/// Level at which the samples of echoes are clipped, DN.
///
/// Counts the highest sample of each block. A clipped receiver puts all higher ones on one value,
/// which then has many more blocks than the density just below predicts. `None` without such an
/// accumulation.
pub fn clipping_level_dn<'a>(blocks: impl Iterator<Item = Waveform<'a>>) -> Option<u16> {
    let mut counts = vec![0u32; usize::from(u16::MAX) + 1];
    for highest in blocks.filter_map(|block| block.samples.iter().max().copied()) {
        counts[usize::from(highest)] += 1;
    }
    clipping_level_of_counts(&counts)
}

/// The same from the number of blocks by their highest sample, DN.
pub(crate) fn clipping_level_of_counts(counts: &[u32]) -> Option<u16> {
    let total: u32 = counts.iter().sum();
    let top = counts.iter().rposition(|&count| count > 0)?;
    // Digitisers with coarse steps near full scale have unused values below the top.
    let step = top - counts[..top].iter().rposition(|&count| count > 0)?;
    let range = ((RANGE_PART * top as f64) as usize).max(step);
    let below: u32 = counts[top.saturating_sub(range)..top].iter().sum();
    let predicted = f64::from(below) * step as f64 / range as f64;
    let reached = counts[top];
    let is_accumulated = f64::from(reached) > LEAST_RATIO * predicted
        && f64::from(reached) > predicted + LEAST_EXCESS_SD * predicted.max(1.0).sqrt();
    let is_share = f64::from(reached) <= LARGEST_PART * f64::from(total);
    (reached >= MIN_BLOCKS && is_share && is_accumulated).then_some(top as u16)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::noise::ArNoise;
    use crate::simulated::{Random, analogue, digitised, pulse};

    /// Echoes up to `highest_dn` of a receiver that clips at `clip_dn`.
    fn found(highest_dn: f64, clip_dn: u16) -> Option<u16> {
        let mut random = Random::new(81);
        let process = ArNoise::new(&[], 1.0).unwrap();
        let blocks: Vec<Vec<u16>> = (0..2000)
            .map(|_| {
                let echo = pulse(20.0 + (highest_dn - 20.0) * random.uniform(), 20.0 + random.uniform(), 1.0);
                digitised(&analogue(&mut random, &process, 40, 10.0, 4.4, &[echo]), clip_dn)
            })
            .collect();
        clipping_level_dn(blocks.iter().map(|samples| Waveform { samples }))
    }

    #[test]
    fn a_receiver_that_clips_shows_its_level() {
        assert_eq!(found(300.0, 240), Some(240));
        assert_eq!(found(260.0, 240), Some(240));
        assert_eq!(found(5000.0, 4000), Some(4000));
    }

    #[test]
    fn echoes_that_end_below_full_scale_do_not_clip() {
        assert_eq!(found(200.0, 255), None);
        let same = vec![vec![10, 50, 10]; 300];
        let views = || same.iter().map(|samples| Waveform { samples });
        assert_eq!(clipping_level_dn(views()), None);
        assert_eq!(clipping_level_dn(views().take(0)), None);
    }
}
