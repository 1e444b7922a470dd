//! Warns if the misfit of the waveforms of a recording is larger or smaller than expected.

use super::receivers::SharedTables;
use wavex_line::stage::Context;
use wavex_signal::decompose::Decomposition;
use wavex_signal::sensor_model::{Provenance, ResponseSource};

/// Chi-square over the expected one, with the error of the response, of a waveform that is not
/// explained …
const CHI_SQUARE: f64 = 2.0;
/// … and the largest fraction of such waveforms: the median is then the limit.
const CHI_SQUARE_PART: f64 = 0.5;
/// The same for the deviation ratio.
const DEVIATION_RATIO: f64 = 3.0;
const DEVIATION_RATIO_PART: f64 = 0.1;
/// Largest fraction of waveforms in which the expected contribution of the response's error exceeds
/// chi-square.
const EXCEEDED_PART: f64 = 0.01;
/// Fewest waveforms for a warning.
const MIN_WAVEFORMS: u64 = 100;

/// Counts of waveforms by the quality of their fits.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct FitCounts {
    waveforms: u64,
    by_chi_square: u64,
    by_deviation_ratio: u64,
    /// Deviation ratio below the negative limit.
    overestimated: u64,
    /// Expected contribution of the response's error above chi-square.
    exceeded: u64,
}

impl FitCounts {
    /// Adds a block of echoes.
    pub(super) fn add(&mut self, result: &Decomposition) {
        let freedom = result.degrees_of_freedom();
        if freedom > 0 {
            self.waveforms += 1;
            let expected = freedom as f64 + result.expected_excess;
            self.by_chi_square += u64::from(result.chi_square > CHI_SQUARE * expected);
            self.by_deviation_ratio += u64::from(result.deviation_ratio() > DEVIATION_RATIO);
            self.overestimated += u64::from(result.deviation_ratio() < -DEVIATION_RATIO);
            self.exceeded += u64::from(result.expected_excess > result.chi_square);
        }
    }

    /// Moves the counts to the counters of the stage.
    pub(super) fn report(&mut self, cx: &mut Context) {
        let FitCounts { waveforms, by_chi_square, by_deviation_ratio, overestimated, exceeded } =
            std::mem::take(self);
        let counts = [waveforms, by_chi_square, by_deviation_ratio, overestimated, exceeded];
        NAMES.into_iter().zip(counts).for_each(|(name, n)| cx.count(name, n));
    }
}

const NAMES: [&str; 5] = [
    "waveforms",
    "unexplained_by_chi_square",
    "unexplained_by_deviation_ratio",
    "overestimated_by_deviation_ratio",
    "overestimated_response_error",
];

/// Warns if the counts of all workers exceed the limits.
pub(super) fn conclude(tables: &SharedTables, cx: &mut Context) {
    let [waveforms, by_chi_square, by_deviation_ratio, overestimated, exceeded] =
        NAMES.map(|name| cx.counters().counts.get(name).copied().unwrap_or(0));
    if waveforms < MIN_WAVEFORMS {
        return;
    }
    let part = |n: u64| n as f64 / waveforms as f64;
    let unexplained =
        part(by_chi_square) > CHI_SQUARE_PART || part(by_deviation_ratio) > DEVIATION_RATIO_PART;
    let overestimates = part(overestimated) > DEVIATION_RATIO_PART || part(exceeded) > EXCEEDED_PART;
    let unexplained = unexplained.then(|| {
        format!(
            "the returns do not explain the waveforms: chi-square per degree of freedom is above {CHI_SQUARE} \
             in {:.0} % of them, and the deviation ratio above {DEVIATION_RATIO} in {:.0} %; \
             standard deviations may be too small there",
            100.0 * part(by_chi_square),
            100.0 * part(by_deviation_ratio),
        )
    });
    let overestimates = overestimates.then(|| {
        format!(
            "the sensor model overestimates the misfit of the waveforms: the deviation ratio is below \
             -{DEVIATION_RATIO} in {:.0} % of them, and the error of the response alone should add more than \
             the whole chi-square in {:.1} %; its noise or the error of its response is too large: standard \
             deviations may be too large, and waveforms that returns do not explain go unnoticed",
            100.0 * part(overestimated),
            100.0 * part(exceeded),
        )
    });
    // One model is the cause of both.
    let remedy = if unexplained.is_some() { REMEDY } else { CALIBRATE };
    let findings: Vec<String> = unexplained.into_iter().chain(overestimates).collect();
    if !findings.is_empty() {
        let shape = pulse_shape(&tables.provenance());
        let instead = if tables.have_large_footprints() { INSTEAD } else { "" };
        cx.warn(format!("{}. Used: {shape}. {remedy}{instead}", findings.join(". Elsewhere, ")));
    }
}

const CALIBRATE: &str = "Calibrate from this recording, or load a sensor model of this instrument";

/// Alternative for waveforms that are profiles.
const INSTEAD: &str = ". The footprints are large: `measure_footprints` in place of calibrate and decompose measures \
                       ground and heights, and needs no response of single echoes; `wavex init` writes such a job";

const REMEDY: &str = "Look at single shots with `wavex explain`. If pulses are clipped, set the reader's \
                      `full_scale_dn`; if the shape is wrong, set `response` of calibrate or load a sensor \
                      model; if the level differs between waveforms, set its `background = \"per_waveform\"`; \
                      to accept the error of the shape, raise `template_error` of decompose";

/// Pulse shape of the model, and the shapes with which it was compared.
fn pulse_shape(provenance: &Provenance) -> String {
    let shape = match provenance.response {
        ResponseSource::Echoes => "the response of single echoes",
        ResponseSource::OtherReceiver => "the response of the other receiver",
        ResponseSource::OutgoingPulse => "the outgoing pulse as response",
        ResponseSource::Gaussian => "Gaussian pulses",
        ResponseSource::Unknown => "the pulse shape of the given sensor model",
    };
    let [of_echoes, of_outgoing] = provenance.residual_over_peak.map(|part| 100.0 * part);
    match of_outgoing > 0.0 {
        true => format!(
            "{shape}; residuals over the peak are {of_echoes:.1} % with the shape of the echoes and \
             {of_outgoing:.1} % with the outgoing pulse"
        ),
        false => shape.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn warnings(counts: FitCounts) -> Vec<String> {
        let mut cx = Context::default();
        { counts }.report(&mut cx);
        conclude(&SharedTables::default(), &mut cx);
        cx.counters().notes.clone()
    }

    #[test]
    fn most_waveforms_must_be_explained() {
        let of = |waveforms, by_chi_square, by_deviation_ratio| FitCounts {
            waveforms,
            by_chi_square,
            by_deviation_ratio,
            ..FitCounts::default()
        };
        assert_eq!(warnings(of(1000, 500, 100)), Vec::<String>::new());
        assert_eq!(warnings(of(50, 50, 50)), Vec::<String>::new());
        let text = warnings(of(1000, 510, 20)).pop().unwrap();
        assert!(text.contains("in 51 % of them") && text.contains("in 2 %"), "{text}");
        assert_eq!(warnings(of(1000, 0, 101)).len(), 1);
    }

    #[test]
    fn a_misfit_far_below_the_expected_one_is_a_warning() {
        let of = |overestimated, exceeded| FitCounts {
            waveforms: 1000,
            overestimated,
            exceeded,
            ..FitCounts::default()
        };
        assert_eq!(warnings(of(100, 10)), Vec::<String>::new());
        let text = warnings(of(840, 0)).pop().unwrap();
        assert!(text.contains("below -3 in 84 % of them") && text.contains("in 0.0 %"), "{text}");
        assert_eq!(warnings(of(0, 11)).len(), 1);
    }

    #[test]
    fn blocks_count_by_their_fits() {
        let fit = |chi_square| Decomposition { chi_square, samples: 60, ..Decomposition::default() };
        let mut explained = FitCounts::default();
        [60.0, 110.0, 130.0].iter().for_each(|&chi_square| explained.add(&fit(chi_square)));
        explained.add(&Decomposition::default());
        // The response's error should add 200 to a chi-square of 60.
        explained.add(&Decomposition { expected_excess: 200.0, ..fit(60.0) });
        let expected = FitCounts {
            waveforms: 4,
            by_chi_square: 1,
            by_deviation_ratio: 2,
            overestimated: 1,
            exceeded: 1,
        };
        assert_eq!(explained, expected);
    }
}
