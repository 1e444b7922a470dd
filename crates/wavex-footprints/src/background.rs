//! Background and noise of one waveform, from its samples without signal.

/// Fewest samples without signal from which background and noise are estimated.
pub(super) const LEAST_FREE: usize = 100;
/// Distance from the level, in robust SDs, within which samples may be free of signal.
const FREE_SDS: f32 = 3.0;
/// Number of times that the level is estimated again.
const ROUNDS: usize = 4;

/// Background and noise of a waveform.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Background {
    /// Level, DN.
    pub(super) mean_dn: f64,
    /// Standard deviation of a sample, DN.
    pub(super) sd_dn: f64,
    /// Number of samples without signal.
    pub(super) free: usize,
}

/// Scratch of [`estimate`].
#[derive(Default)]
pub(super) struct Scratch {
    ordered: Vec<f32>,
    is_free: Vec<bool>,
}

impl Scratch {
    /// Whether each sample of the last waveform is free of signal.
    pub(super) fn is_free(&self) -> &[bool] {
        &self.is_free
    }
}

/// Estimates background and noise of a waveform whose signal takes less than half of its samples.
///
/// Samples within `reach` of a smoothed sample far from the level are not used. `None` if fewer than
/// [`LEAST_FREE`] samples are left.
pub(super) fn estimate(
    samples: &[f32],
    smoothed: &[f32],
    reach: usize,
    scratch: &mut Scratch,
) -> Option<Background> {
    let [mut level, mut sd] = robust(smoothed, &mut scratch.ordered)?;
    for _ in 0..ROUNDS {
        mark_free(smoothed, level, FREE_SDS * sd, reach, &mut scratch.is_free);
        let free = || smoothed.iter().zip(&scratch.is_free).filter(|(_, free)| **free).map(|(dn, _)| *dn);
        let count = free().count();
        if count < LEAST_FREE {
            return None;
        }
        level = (free().map(f64::from).sum::<f64>() / count as f64) as f32;
        let of_level = |dn: f32| f64::from(dn - level).powi(2);
        sd = (free().map(of_level).sum::<f64>() / count as f64).sqrt() as f32;
    }
    let free =
        || samples.iter().zip(&scratch.is_free).filter(|(_, free)| **free).map(|(dn, _)| f64::from(*dn));
    let count = free().count();
    let mean_dn = free().sum::<f64>() / count as f64;
    let sd_dn = (free().map(|dn| (dn - mean_dn).powi(2)).sum::<f64>() / (count - 1) as f64).sqrt();
    Some(Background { mean_dn, sd_dn, free: count }).filter(|found| found.sd_dn > 0.0)
}

/// Median, and a robust SD of what lies below it: signals are positive.
fn robust(values: &[f32], ordered: &mut Vec<f32>) -> Option<[f32; 2]> {
    ordered.clear();
    ordered.extend(values.iter().filter(|value| value.is_finite()));
    let count = ordered.len() as f64;
    let mut at = |part: f64| {
        let index = (part * count) as usize;
        (index < ordered.len()).then(|| *ordered.select_nth_unstable_by(index, f32::total_cmp).1)
    };
    // The lower third of the samples is background, whatever the signal adds above it.
    let [low, middle] = [at(0.15)?, at(0.35)?];
    Some([middle, ((middle - low) / 0.65).max(f32::MIN_POSITIVE)])
}

/// Marks samples as free whose smoothed neighbours within `reach` are all near the level.
fn mark_free(smoothed: &[f32], level: f32, limit: f32, reach: usize, is_free: &mut Vec<bool>) {
    is_free.clear();
    is_free.resize(smoothed.len(), true);
    let mut until = 0;
    for (k, dn) in smoothed.iter().enumerate() {
        if (dn - level).abs() <= limit {
            continue;
        }
        let from = k.saturating_sub(reach).max(until);
        until = (k + reach + 1).min(smoothed.len());
        is_free.get_mut(from..until).unwrap_or_default().fill(false);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Noise of SD 1 about 200 with a signal of 50 DN in a third of the samples.
    fn waveform() -> Vec<f32> {
        let mut state = 1u32;
        let mut next = move || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            f64::from(state >> 8) / f64::from(1 << 24) - 0.5
        };
        let noise = |next: &mut dyn FnMut() -> f64| (0..12).map(|_| next()).sum::<f64>();
        (0..900)
            .map(|k| {
                let signal = if (300..600).contains(&k) { 50.0 } else { 0.0 };
                (200.0 + signal + noise(&mut next)) as f32
            })
            .collect()
    }

    #[test]
    fn the_signal_does_not_move_the_background() {
        let (samples, mut scratch) = (waveform(), Scratch::default());
        let found = estimate(&samples, &samples, 10, &mut scratch).unwrap();
        assert!((found.mean_dn - 200.0).abs() < 0.15, "{found:?}");
        assert!((found.sd_dn - 1.0).abs() < 0.1 && found.free > 400, "{found:?}");
        assert!(scratch.is_free().iter().enumerate().all(|(k, free)| !(*free && (300..600).contains(&k))));
    }

    #[test]
    fn too_few_free_samples_give_none() {
        let mut scratch = Scratch::default();
        assert_eq!(estimate(&waveform()[..90], &waveform()[..90], 10, &mut scratch), None);
        assert_eq!(estimate(&[], &[], 10, &mut scratch), None);
        assert_eq!(estimate(&[5.0; 400], &[5.0; 400], 10, &mut scratch), None, "without noise");
    }
}
