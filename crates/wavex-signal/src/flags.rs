//! Flags of a return: 16 bits.
//!
//! The low byte is the user data of LAS returns (BayesWavEx 1.1, "User data byte").

/// Refined by iteration; the scalar form refines every return.
pub const REFINED: u16 = 1 << 0;
/// The pulse overlaps another one.
pub const OVERLAP: u16 = 1 << 1;
/// The fit diverged and was restarted, or ended without an optimum.
pub const DIVERGED: u16 = 1 << 2;
/// The echo overlaps crosstalk from an emission.
pub const EMISSION_ON_ECHO: u16 = 1 << 3;
/// The block contains crosstalk from an emission, away from this echo.
pub const EMISSION_IN_BLOCK: u16 = 1 << 4;
/// The outgoing pulse overlaps an echo: its timing is unreliable.
pub const ECHO_ON_OUTGOING: u16 = 1 << 5;
/// Samples of the pulse are saturated.
pub const SATURATED: u16 = 1 << 6;
/// So many samples are saturated that only the flanks, or one of them, determine the pulse.
pub const EXTREMELY_SATURATED: u16 = 1 << 7;
/// The receiver was overdriven without saturated samples.
pub const OVERDRIVEN: u16 = 1 << 8;
/// The block begins or ends within the pulse.
pub const TRUNCATED: u16 = 1 << 9;
/// The return results from splitting one widened pulse into two.
pub const SPLIT: u16 = 1 << 10;
/// The MTA zone has weak evidence.
pub const ZONE_UNCERTAIN: u16 = 1 << 11;
/// A return of the instrument, not computed from a waveform.
pub const INSTRUMENT: u16 = 1 << 12;

/// The waveform is not explained to its noise: its standard deviations are raised by the misfit.
pub const MISFIT: u16 = 1 << 13;
/// A clear pulse that the rules for width or separation would drop, or that no fit determines.
pub const UNUSUAL: u16 = 1 << 14;

/// Flags of crosstalk between emissions and echoes.
pub const CROSSTALK: u16 = EMISSION_ON_ECHO | EMISSION_IN_BLOCK | ECHO_ON_OUTGOING;

/// All flags and their names, by bit.
pub const NAMES: [(u16, &str); 15] = [
    (REFINED, "refined"),
    (OVERLAP, "overlap"),
    (DIVERGED, "diverged"),
    (EMISSION_ON_ECHO, "emission on echo"),
    (EMISSION_IN_BLOCK, "emission in block"),
    (ECHO_ON_OUTGOING, "echo on outgoing pulse"),
    (SATURATED, "saturated"),
    (EXTREMELY_SATURATED, "extremely saturated"),
    (OVERDRIVEN, "overdriven"),
    (TRUNCATED, "truncated"),
    (SPLIT, "split"),
    (ZONE_UNCERTAIN, "zone uncertain"),
    (INSTRUMENT, "instrument's own return"),
    (MISFIT, "misfit"),
    (UNUSUAL, "unusual"),
];

/// Names of the flags that are set: `refined, overlap`; `none` without flags.
pub fn words(flags: u16) -> String {
    let set: Vec<&str> = NAMES.iter().filter(|(bit, _)| flags & bit != 0).map(|(_, name)| *name).collect();
    if set.is_empty() { "none".to_owned() } else { set.join(", ") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn flags_are_written_as_words() {
        assert_eq!(words(0), "none");
        assert_eq!(words(REFINED | OVERLAP | SATURATED), "refined, overlap, saturated");
        for (bit, (flag, _)) in NAMES.into_iter().enumerate() {
            assert_eq!(flag, 1 << bit);
        }
    }

    #[test]
    fn every_flag_has_its_own_bit_in_the_documented_order() {
        let all = [
            REFINED,
            OVERLAP,
            DIVERGED,
            EMISSION_ON_ECHO,
            EMISSION_IN_BLOCK,
            ECHO_ON_OUTGOING,
            SATURATED,
            EXTREMELY_SATURATED,
            OVERDRIVEN,
            TRUNCATED,
            SPLIT,
            ZONE_UNCERTAIN,
            INSTRUMENT,
            MISFIT,
            UNUSUAL,
        ];
        for (bit, flag) in all.into_iter().enumerate() {
            assert_eq!(flag, 1 << bit);
        }
    }
}
