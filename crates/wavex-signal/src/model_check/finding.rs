//! A difference between a model and a recording, and its text.

/// Part of the model that a finding concerns.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Area {
    /// SD of the noise.
    Noise,
    /// Correlation of the noise between neighbouring samples.
    Correlation,
    /// Level without an echo.
    Background,
    /// Width of single echoes.
    PulseWidth,
    /// Shape of the pulse: flanks, after-pulse, tail.
    PulseShape,
    /// Error of the pulse shape that the model states.
    TemplateError,
    /// Level at which samples are clipped.
    FullScale,
    /// Number of echoes.
    Echoes,
    /// Noise along the recording: gain.
    NoiseDrift,
    /// Background along the recording.
    BackgroundDrift,
}

/// A measured value outside its accepted interval.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Finding {
    /// Part of the model.
    pub area: Area,
    /// Measured value.
    pub measured: f64,
    /// Value of the model.
    pub expected: f64,
    /// Smallest and largest accepted measured value.
    pub accepted: [f64; 2],
    /// Unit of these values; empty for ratios.
    pub unit: &'static str,
}

impl Finding {
    /// The finding, if the measured value is outside the accepted interval.
    pub(super) fn unless_accepted(self) -> Option<Finding> {
        let [least, most] = self.accepted;
        (self.measured < least || self.measured > most).then_some(self)
    }
}

impl std::fmt::Display for Finding {
    /// One clause with the figures, and a second one with the remedy.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let (quantity, remedy) = self.area.words();
        let Finding { measured, expected, accepted: [least, most], unit, .. } = *self;
        let figure = |value: f64| format!("{} {unit}", short(value)).trim_end().to_owned();
        let accepted = match (least.is_finite(), most.is_finite()) {
            (true, true) => format!("{} to {}", figure(least), figure(most)),
            (true, false) => format!("from {}", figure(least)),
            _ => format!("up to {}", figure(most)),
        };
        let [measured, expected] = [measured, expected].map(figure);
        write!(f, "{quantity} {measured}, expected {expected} (accepted: {accepted}): {remedy}")
    }
}

impl Area {
    /// The measured quantity, and the remedy.
    fn words(self) -> (&'static str, &'static str) {
        match self {
            Area::Noise => (
                "the noise differs from the sensor model: SD",
                "calibrate from this recording, or load a model of this instrument and setting",
            ),
            Area::Correlation => (
                "the correlation of the noise differs from the sensor model: at a lag of one sample",
                "calibrate from this recording",
            ),
            Area::Background => (
                "the background differs from the sensor model: quiet samples lie above it by",
                "calibrate from this recording, or set `background = \"per_waveform\"`",
            ),
            Area::PulseWidth => (
                "the width of single echoes differs from the response of the sensor model: ratio",
                "calibrate from this recording, with more waveforms or over open terrain",
            ),
            Area::PulseShape => (
                "the shape of single echoes differs from the response of the sensor model: largest mean residual over the peak",
                "calibrate from this recording, with more waveforms or over open terrain; weak returns near strong ones may be false",
            ),
            Area::TemplateError => (
                "the template error of the sensor model contradicts single echoes: increase of chi-square per degree of freedom from weak to strong ones",
                "calibrate from this recording; deviation ratios are not meaningful until then",
            ),
            Area::FullScale => (
                "samples contradict the clipping level (full scale) of the sensor model: level",
                "set the reader's key `full_scale_dn`, or calibrate from this recording",
            ),
            Area::Echoes => (
                "hardly any waveform has an echo: share",
                "check the receiver, its channel and the noise of the sensor model",
            ),
            Area::NoiseDrift => (
                "the noise changes along the recording: ratio of its largest to its smallest part",
                "the gain changed or the receiver is defective; process the parts with calibrations of their own",
            ),
            Area::BackgroundDrift => (
                "the background changes along the recording: difference of its parts",
                "set `background = \"per_waveform\"` of calibrate, or process the parts with calibrations of their own",
            ),
        }
    }
}

/// A number with three significant digits.
fn short(value: f64) -> String {
    let digits = match value.abs() {
        0.0 => 0,
        small if small < 0.1 => 4,
        one if one < 10.0 => 2,
        ten if ten < 100.0 => 1,
        _ => 0,
    };
    format!("{value:.digits$}")
}
