//! What is worth knowing of a return beside its numbers: 16 bits, of which the low byte is the user data of the
//! returns in LAS (BayesWavEx 1.1, "User data byte").

/// Refined by iteration; the plain form refines every return.
pub const REFINED: u16 = 1 << 0;
/// Its pulse overlaps another's.
pub const OVERLAP: u16 = 1 << 1;
/// The fit went astray at first and was started anew, or ended without an optimum.
pub const DIVERGED: u16 = 1 << 2;
/// The echo overlaps what leaks in from an emission.
pub const EMISSION_ON_ECHO: u16 = 1 << 3;
/// The block holds what leaks in from an emission, away from this echo.
pub const EMISSION_IN_BLOCK: u16 = 1 << 4;
/// The outgoing pulse is overlapped by an echo: its timing cannot be relied upon.
pub const ECHO_ON_OUTGOING: u16 = 1 << 5;
/// Samples of the pulse are saturated.
pub const SATURATED: u16 = 1 << 6;
/// So many samples are saturated that the pulse is told by its flanks alone, or by one of them.
pub const EXTREMELY_SATURATED: u16 = 1 << 7;
/// The receiver was overdriven without a sample being saturated.
pub const OVERDRIVEN: u16 = 1 << 8;
/// The block begins or ends on the pulse.
pub const TRUNCATED: u16 = 1 << 9;
/// The return stems from dividing one widened pulse into two.
pub const SPLIT: u16 = 1 << 10;
/// The MTA zone was decided against little evidence.
pub const ZONE_UNCERTAIN: u16 = 1 << 11;
/// The instrument's own return: it was not computed from a waveform.
pub const INSTRUMENT: u16 = 1 << 12;

/// The flags of cross-talk between emissions and echoes.
pub const CROSSTALK: u16 = EMISSION_ON_ECHO | EMISSION_IN_BLOCK | ECHO_ON_OUTGOING;

/// Every flag with its name in words, by bit.
pub const NAMES: [(u16, &str); 13] = [
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
];

/// The flags that are set, in words: `refined, overlap`; `none` where none is.
pub fn words(flags: u16) -> String {
    let set: Vec<&str> = NAMES.iter().filter(|(bit, _)| flags & bit != 0).map(|(_, name)| *name).collect();
    if set.is_empty() { "none".to_owned() } else { set.join(", ") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn flags_are_told_in_words() {
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
        ];
        for (bit, flag) in all.into_iter().enumerate() {
            assert_eq!(flag, 1 << bit);
        }
    }
}
