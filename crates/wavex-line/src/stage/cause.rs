//! Causes of several warnings.

/// Cause with consequences in several stages; one stage warns of the cause itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cause {
    /// The beams are not georeferenced, because there is no trajectory.
    NoTrajectory,
}

impl Cause {
    /// Words that begin a sentence about a consequence.
    pub fn words(self) -> &'static str {
        match self {
            Cause::NoTrajectory => "without a trajectory",
        }
    }
}
