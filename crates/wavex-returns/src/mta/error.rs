//! Errors of zone assignment.

/// Reasons why zones cannot be assigned.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum MtaError {
    /// Contradictory settings.
    #[error("{0}")]
    Settings(&'static str),
    /// An echo refers to an emission that the line does not have.
    #[error("line {line}: echo {echo} refers to emission {emission}, but the line has {emissions} emissions")]
    NoSuchEmission {
        /// Number of the line.
        line: u64,
        /// Index of the echo.
        echo: usize,
        /// Emission index of the echo.
        emission: u32,
        /// Number of emissions in the line.
        emissions: usize,
    },
    /// The time of an echo is NaN or over 1 s.
    #[error("line {line}: echo {echo} has an invalid time: {time_ns} ns after its emission")]
    EchoTime {
        /// Number of the line.
        line: u64,
        /// Index of the echo.
        echo: usize,
        /// Its time, ns.
        time_ns: f64,
    },
    /// The clock does not ascend within a line.
    #[error(
        "line {line}: the clock does not increase at shot {shot}: {clock_ps} ps after {before_ps} ps; start a new line there"
    )]
    ClockOrder {
        /// Number of the line.
        line: u64,
        /// Shot number.
        shot: u64,
        /// Its clock, ps.
        clock_ps: i64,
        /// Clock of the previous emission, ps.
        before_ps: i64,
    },
    /// Constant pulse rate: all zones give equally smooth surfaces.
    #[error(
        "the pulse rate is constant: intervals of {interval_ns:.3} ns vary by {rms_ns:.3} ns RMS, but at least {least_ns} ns are \
         needed to assign echoes to pulses; give a prior (height above ground, terrain model, trajectory) or a fixed zone"
    )]
    ConstantRate {
        /// Median pulse interval, ns.
        interval_ns: f64,
        /// RMS variation of the intervals, ns.
        rms_ns: f64,
        /// Smallest variation at which zones can be distinguished, ns.
        least_ns: f64,
    },
    /// Recorded intervals vary, but the ranges do not follow: clock jitter, or wrong zones
    /// throughout.
    #[error(
        "the time stamps jitter, not the pulses: intervals vary by {rms_ns:.3} ns RMS on the clock, but neighbouring ranges contain {:.0} % of that; give a prior (height above ground, terrain model, trajectory) or a fixed zone",
        100.0 * following.max(0.0)
    )]
    JitteringClock {
        /// RMS variation of the recorded intervals, ns.
        rms_ns: f64,
        /// Fraction of the variation that the echoes follow.
        following: f64,
    },
}
