//! Levenberg–Marquardt loop of the scalar fits.
//!
//! Each linearisation gives a normal matrix `N` and a gradient `g`. Steps `δ` solve
//! `(N + λ diag N) δ = g`. The damping `λ` falls tenfold after a step that does not raise the
//! objective, and rises tenfold after any other (Levenberg 1944, Marquardt 1963).

/// A least-squares problem with a current point, a step and a trial point.
pub(crate) trait LeastSquares {
    /// Objective at the trial point; initially that is the start point.
    fn objective(&mut self) -> f64;
    /// Makes the trial point the current one.
    fn accept(&mut self);
    /// Computes the normal matrix and the gradient at the current point.
    fn linearise(&mut self);
    /// Solves for the step; `false` if the damped matrix is not positive definite.
    fn solve(&mut self, damping: f64) -> bool;
    /// Whether a nearly undamped step leaves the objective too high.
    fn is_out_of_reach(&self, _objective: f64) -> bool {
        false
    }
    /// Limits the step and sets the trial point.
    fn take_step(&mut self);
    /// Decrease of the objective promised by the step.
    fn promised(&self) -> f64;
}

/// Damping and termination of the loop.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Rules {
    /// Initial and smallest damping.
    pub(crate) damping: [f64; 2],
    /// Damping from which on a step is too short to be tried.
    pub(crate) most_damping: f64,
    /// Largest number of linearisations.
    pub(crate) linearisations: usize,
    /// Largest number of steps tried.
    pub(crate) steps: usize,
    /// Promised decrease below which the fit has converged …
    pub(crate) decrease: f64,
    /// … if the damping is at most this.
    pub(crate) near_newton: f64,
    /// Whether the step that promises so little is still tried.
    pub(crate) takes_last_step: bool,
    /// Whether a matrix that is not positive definite ends the fit instead of raising the damping.
    pub(crate) ends_if_singular: bool,
}

/// Reason why a fit ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Termination {
    /// The predicted decrease of the next step is negligible: the optimum.
    Converged,
    /// Converged with a width or a position at its bound.
    AtBound,
    /// No step decreases the objective: the optimum to rounding.
    NoDecrease,
    /// The iteration limit was reached.
    IterationLimit,
    /// The objective cannot become small enough.
    OutOfReach,
    /// Fewer used samples than parameters; nothing was fitted.
    TooFewSamples,
    /// More pulses than the workspace supports; nothing was fitted.
    TooManyPulses,
    /// Start values, samples or normal matrix are not finite, or the matrix is singular.
    Singular,
}

impl Termination {
    /// Whether the parameters are an optimum with known covariance.
    pub(crate) fn is_optimum(self) -> bool {
        matches!(self, Termination::Converged | Termination::AtBound | Termination::NoDecrease)
    }
}

/// Minimises a problem; returns the reason for the end and the number of linearisations.
pub(crate) fn minimise(problem: &mut impl LeastSquares, rules: &Rules) -> (Termination, usize) {
    let mut objective = problem.objective();
    problem.accept();
    if !objective.is_finite() {
        return (Termination::Singular, 0);
    }
    let [mut damping, least_damping] = rules.damping;
    let mut steps = 0;
    for linearisations in 1..=rules.linearisations {
        problem.linearise();
        loop {
            if damping >= rules.most_damping {
                return (Termination::NoDecrease, linearisations);
            }
            if steps == rules.steps {
                return (Termination::IterationLimit, linearisations);
            }
            steps += 1;
            if !problem.solve(damping) {
                if rules.ends_if_singular {
                    return (Termination::Singular, linearisations);
                }
                damping *= 10.0;
                continue;
            }
            // A strongly damped step promises little anywhere: it indicates neither the optimum nor the reach.
            let is_newton = damping <= rules.near_newton;
            if is_newton && problem.is_out_of_reach(objective) {
                return (Termination::OutOfReach, linearisations);
            }
            problem.take_step();
            let has_converged = is_newton && problem.promised() < rules.decrease;
            if has_converged && !rules.takes_last_step {
                return (Termination::Converged, linearisations);
            }
            let trial = problem.objective();
            let is_better = trial <= objective;
            if is_better {
                objective = trial;
                problem.accept();
                damping = (0.1 * damping).max(least_damping);
            } else {
                damping *= 10.0;
            }
            if has_converged {
                return (Termination::Converged, linearisations);
            }
            if is_better {
                break;
            }
        }
    }
    (Termination::IterationLimit, rules.linearisations)
}
