//! Correction of widths for amplitude.

use super::WidthKey;
use wavex_line::keys::InvalidKey;
use wavex_line::scan_line::{Return, ReturnChannel, ScanLine, flags};
use wavex_line::stage::Context;
use wavex_returns::width_by_amplitude::{
    IsolatedPulse, NoCurve, WidthNode, ln_width_at, proven_width_by_amplitude,
};
use wavex_signal::sensor_model::SensorModel;

/// Receivers with a width correction, in the order of the keys.
pub(super) const CHANNELS: [ReturnChannel; 2] = [ReturnChannel::Low, ReturnChannel::High];
/// Reference amplitude of a power, DN.
const POWER_FROM_DN: f64 = 100.0;
/// Returns with any of these flags are unsuitable for the width of flat targets and the range walk.
pub(super) const NOT_PLAIN: u16 = flags::INSTRUMENT
    | flags::OVERLAP
    | flags::DIVERGED
    | flags::EMISSION_ON_ECHO
    | flags::SATURATED
    | flags::EXTREMELY_SATURATED
    | flags::OVERDRIVEN
    | flags::TRUNCATED
    | flags::SPLIT;

/// Width ratio of a flat target as a function of amplitude.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum WidthCorrection {
    /// Independent of amplitude.
    None,
    /// A power of the amplitude.
    Power(f64),
    /// Linear between these nodes, constant beyond them.
    Nodes(Vec<WidthNode>),
}

/// Checks a width key.
pub(super) fn check(name: &'static str, key: &WidthKey) -> Result<(), InvalidKey> {
    let holds = match key {
        WidthKey::Pairs(pairs) => {
            !pairs.is_empty()
                && pairs.iter().all(|[_, width]| (0.1..=10.0).contains(width))
                && pairs.is_sorted_by(|a, b| a[0] < b[0])
        }
        _ => true,
    };
    let problem = "pairs must have ascending amplitudes and width ratios between 0.1 and 10";
    InvalidKey::unless(holds, name, problem)
}

impl WidthCorrection {
    /// The correction given by a key; `None` if it must be estimated.
    pub(super) fn given(key: &WidthKey) -> Option<WidthCorrection> {
        let node = |&[dn, width]: &[f64; 2]| WidthNode { ln_amplitude: dn.ln(), ln_width: width.ln() };
        match key {
            WidthKey::Auto(_) => None,
            WidthKey::Power(power) => Some(WidthCorrection::Power(*power)),
            WidthKey::Pairs(pairs) => Some(WidthCorrection::Nodes(pairs.iter().map(node).collect())),
            WidthKey::Without(_) => Some(WidthCorrection::None),
        }
    }

    /// Estimates the correction from single returns.
    ///
    /// None, with a note, if they are insufficient, do not depend on the amplitude, or if the response
    /// of the sensor model already does.
    pub(super) fn learnt(lines: &[ScanLine], channel: ReturnChannel, cx: &mut Context) -> WidthCorrection {
        let returns = lines.iter().filter_map(ScanLine::returns).flatten();
        let of_channel: Vec<&Return> = returns.filter(|r| r.channel == channel).collect();
        if of_channel.is_empty() {
            return WidthCorrection::None;
        }
        if lines
            .iter()
            .find_map(|line| line.model.as_deref())
            .is_some_and(|model| has_heights(model, channel))
        {
            cx.info(format!(
                "{}: widths need no correction for amplitude: the response of the sensor model depends on it",
                name(channel)
            ));
            return WidthCorrection::None;
        }
        let plain = |r: &&&Return| r.number_of_returns == 1 && r.flags & NOT_PLAIN == 0;
        let pulse = |r: &&Return| IsolatedPulse {
            ln_amplitude: r.amplitude_at_unit_gain_dn().0.ln(),
            ln_width: r.width_ratio.ln(),
            ln_width_sd: r.width_ratio_sd / r.width_ratio,
        };
        let pulses: Vec<IsolatedPulse> = of_channel.iter().filter(plain).map(pulse).collect();
        let nodes = match proven_width_by_amplitude(&pulses) {
            Ok(nodes) => nodes,
            Err(reason) => {
                let text = format!(
                    "{}: widths are not corrected for amplitude: {reason} ({})",
                    name(channel),
                    pulses.len()
                );
                match reason {
                    NoCurve::TooFewPulses => cx.warn(text),
                    NoCurve::Constant | NoCurve::Unproven(_) => cx.info(text),
                }
                return WidthCorrection::None;
            }
        };
        let quantity = match channel {
            ReturnChannel::Low => "flat_target_width_ratio_low",
            _ => "flat_target_width_ratio_high",
        };
        nodes.iter().for_each(|node| cx.observe(quantity, node.ln_width.exp()));
        WidthCorrection::Nodes(nodes)
    }

    /// Width ratio of a flat target at an amplitude, DN.
    pub(super) fn flat_target(&self, amplitude_dn: f64) -> f64 {
        match self {
            WidthCorrection::None => 1.0,
            WidthCorrection::Power(power) => (amplitude_dn / POWER_FROM_DN).powf(*power),
            WidthCorrection::Nodes(nodes) => ln_width_at(nodes, amplitude_dn.ln()).exp(),
        }
    }
}

/// Whether the response of a receiver has several heights.
fn has_heights(model: &SensorModel, channel: ReturnChannel) -> bool {
    let of_channel = match channel {
        ReturnChannel::Low => &model.low_power,
        _ => &model.high_power,
    };
    let response = of_channel.as_ref().and_then(|channel| channel.response.as_ref());
    response.is_some_and(|response| response.nodes.len() > 1)
}

/// Name of the receiver in notes.
pub(super) fn name(channel: ReturnChannel) -> &'static str {
    match channel {
        ReturnChannel::Low => "the low power receiver",
        _ => "the high power receiver",
    }
}
