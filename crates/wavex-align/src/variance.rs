//! Variance components of the trajectories: factors of the SDs of their positions and attitudes.

use crate::normal::Problem;
use crate::parameters::OFFSETS;
use crate::sparse::SelectedInverse;
use crate::survey::State;

/// Components: position, and attitude, of all trajectories.
pub(crate) const COMPONENTS: usize = 2;
/// Most iterations; each needs a step.
const ITERATIONS: usize = 8;
/// Ratios of variances within this part of 1 end the iteration.
const CLOSE: f64 = 0.02;
/// Fewest offsets that determine a component.
const LEAST_SHOWN: f64 = 3.0;
/// A component differs from its prior if the logarithm of its variance does so by more than this many SDs.
const SIGNIFICANT_SDS: f64 = 2.0;
/// Smallest and largest factor of an SD. Too small an SD is worse than one that is too large.
const FACTORS: [f64; 2] = [0.25, 100.0];

/// Factor of the SDs that were given for the positions or attitudes of all trajectories.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VarianceComponent {
    /// Estimated factor.
    pub factor: f64,
    /// Number of independent offsets that determine it.
    pub shown: f64,
    /// Whether it was applied; otherwise it is too uncertain, or differs from 1 by chance.
    pub is_used: bool,
}

impl VarianceComponent {
    /// Factor that was applied to the SDs.
    pub fn applied(&self) -> f64 {
        if self.is_used { self.factor } else { 1.0 }
    }

    fn of(variance: f64, shown: f64) -> VarianceComponent {
        // A mean of n squares has the relative variance 2 / n.
        let is_significant = variance.ln().powi(2) > SIGNIFICANT_SDS.powi(2) * 2.0 / shown;
        VarianceComponent { factor: variance.sqrt(), shown, is_used: shown >= LEAST_SHOWN && is_significant }
    }
}

/// Squares of the offsets of a component at a solution, and what is expected of them.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Component {
    /// Mean squares over the variances of the prior, summed over strips and axes.
    pub(crate) squares: f64,
    /// What the squares are if the prior holds: the part of the prior's variance that the observations take away.
    ///
    /// It is also the number of independent offsets that the observations show, if the offsets of a strip count as one.
    pub(crate) shown: f64,
}

impl Component {
    /// Ratio of the variance to that of the prior; 1 if nothing is known of it.
    fn ratio(&self) -> f64 {
        let ratio = self.squares / self.shown;
        if ratio.is_finite() && ratio > 0.0 { ratio } else { 1.0 }
    }
}

impl Problem<'_> {
    /// Components at a solution, from the inverse of its normal matrix.
    ///
    /// For a prior that holds, an estimated offset has the variance `prior - posterior`.
    fn components(&self, state: &State, inverse: &SelectedInverse) -> [Component; COMPONENTS] {
        let x = self.deviation(state);
        let mut found = [Component::default(); COMPONENTS];
        for (strip, sds) in self.priors.offsets.iter().enumerate() {
            let knots = self.priors.knot_times_s[strip].len();
            for (component, sd) in sds.iter().enumerate().filter(|(_, sd)| **sd > 0.0) {
                let own = &mut found[component * COMPONENTS / OFFSETS];
                for knot in 0..knots {
                    let unknown = self.layout.knot(strip, knot) + component;
                    let place = self.layout.place(unknown);
                    let posterior = inverse.value(place, place).unwrap_or(sd * sd);
                    let weight = 1.0 / (knots as f64 * sd * sd);
                    own.squares += weight * x[unknown] * x[unknown];
                    own.shown += weight * (sd * sd - posterior).max(0.0);
                }
            }
        }
        found
    }

    /// Estimates the components and applies those that differ from 1; moves the state to the solution.
    ///
    /// `move_state` makes a step with the current SDs and returns the inverse of the normal matrix before it.
    pub(crate) fn fit_trajectory_sds<E>(
        &mut self,
        state: &mut State,
        mut move_state: impl FnMut(&Self, &mut State) -> Result<SelectedInverse, E>,
    ) -> Result<[VarianceComponent; COMPONENTS], E> {
        let given = self.priors.offsets.clone();
        let mut variances = [1.0; COMPONENTS];
        let mut shown = [0.0; COMPONENTS];
        move_state(self, state)?;
        for _ in 0..ITERATIONS {
            let at = state.clone();
            let inverse = move_state(self, state)?;
            let found = self.components(&at, &inverse);
            let mut is_close = true;
            for ((variance, shown), own) in variances.iter_mut().zip(&mut shown).zip(&found) {
                let [least, most] = FACTORS.map(|factor| factor * factor);
                let next = (*variance * own.ratio()).clamp(least, most);
                is_close &= (next / *variance - 1.0).abs() < CLOSE;
                (*variance, *shown) = (next, own.shown);
            }
            self.scale_trajectory_sds(&given, variances.map(f64::sqrt));
            if is_close {
                break;
            }
        }
        let [position, attitude] = [0, 1].map(|k| VarianceComponent::of(variances[k], shown[k]));
        let found = [position, attitude];
        self.scale_trajectory_sds(&given, found.map(|own| own.applied()));
        move_state(self, state)?;
        Ok(found)
    }

    fn scale_trajectory_sds(&mut self, given: &[[f64; OFFSETS]], factors: [f64; COMPONENTS]) {
        for (sds, given) in self.priors.offsets.iter_mut().zip(given) {
            *sds = core::array::from_fn(|k| given[k] * factors[k * COMPONENTS / OFFSETS]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn chance_and_few_offsets_change_nothing() {
        for (variance, shown, is_used) in
            [(1.0, 50.0, false), (2.0, 8.0, false), (2.0, 50.0, true), (0.2, 10.0, true), (0.001, 2.0, false)]
        {
            let found = VarianceComponent::of(variance, shown);
            assert_eq!(found.is_used, is_used, "{found:?}");
            assert_eq!(found.applied() == 1.0, !is_used);
        }
        assert!(!VarianceComponent::of(1.0, 0.0).is_used);
    }
}
