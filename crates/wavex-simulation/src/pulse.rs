//! Shape of a pulse as recorded by the receiver.

mod table;

pub use table::{PulseTable, WidthIndex};

/// FWHM of a normal distribution of SD 1: `2 sqrt(2 ln 2)`.
pub const FWHM_OF_NORMAL: f64 = 2.354_820_045_030_949_3;

/// A system response (laser pulse, receiver and digitiser), with peak 1 at time 0.
///
/// It is a sum of exponential decays, each convolved with the same normal distribution. A target
/// that spreads the pulse by a normal distribution of variance `v` adds `v` to the variance, so the
/// widened response also has a closed form (docs/explanation/method.md, signal model: response convolved with a
/// Gaussian).
#[derive(Clone, Debug, PartialEq)]
pub struct PulseShape {
    /// Variance of the normal distribution, ns².
    variance_ns2: f64,
    terms: Vec<Term>,
    /// Peak time of the sum of terms, ns, and the inverse of its peak.
    peak_ns: f64,
    scale: f64,
}

/// An exponential decay.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Term {
    /// Area.
    area: f64,
    /// Start, ns.
    delay_ns: f64,
    /// Decay constant, ns; 0 for an impulse.
    decay_ns: f64,
}

/// Main lobe of an airborne instrument's pulse: a slightly skewed bell.
const LOBE: Term = Term { area: 1.0, delay_ns: 0.0, decay_ns: 0.6 };
/// SD of its normal part, ns; gives a FWHM of 4.5 ns.
const LOBE_SD_NS: f64 = 1.806;
/// After-pulse of the receiver: 5 % of the peak 10.6 ns after it, including the slow tail.
const AFTER_PULSE: Term = Term { area: 0.0265, delay_ns: 10.75, decay_ns: LOBE.decay_ns };
/// Slow recovery of the receiver: 1.6 % of the peak 20 ns after it.
const TAIL: Term = Term { area: 0.198, delay_ns: 0.0, decay_ns: 23.0 };

impl PulseShape {
    /// A normal distribution with this FWHM, ns.
    pub fn gaussian(fwhm_ns: f64) -> PulseShape {
        let sd_ns = fwhm_ns / FWHM_OF_NORMAL;
        PulseShape::new(sd_ns, vec![Term { area: 1.0, delay_ns: 0.0, decay_ns: 0.0 }])
    }

    /// Response of a low-power receiver, as recorded by a RIEGL LMS-Q680i: FWHM 4.5 ns, with
    /// after-pulse and slow tail.
    pub fn riegl() -> PulseShape {
        PulseShape::new(LOBE_SD_NS, vec![LOBE, AFTER_PULSE, TAIL])
    }

    /// Outgoing pulse of the same instrument; its recording has neither after-pulse nor tail.
    pub fn riegl_reference() -> PulseShape {
        PulseShape::new(LOBE_SD_NS, vec![LOBE])
    }

    fn new(sd_ns: f64, terms: Vec<Term>) -> PulseShape {
        let mut shape = PulseShape { variance_ns2: sd_ns * sd_ns, terms, peak_ns: 0.0, scale: 1.0 };
        shape.peak_ns = shape.peak_ns(0.0);
        shape.scale = 1.0 / shape.at(0.0, 0.0);
        shape
    }

    /// Response at a time from its peak, widened by a target.
    ///
    /// `widening_ns2` is the variance of the target (0: flat). Widening preserves the area, so the
    /// peak falls.
    pub fn at(&self, time_ns: f64, widening_ns2: f64) -> f64 {
        let sd_ns = self.sd_ns(widening_ns2);
        let time_ns = time_ns + self.peak_ns;
        self.scale * self.terms.iter().map(|term| term.at(time_ns, sd_ns)).sum::<f64>()
    }

    /// Peak time of the widened response relative to the peak of the response, ns.
    pub fn peak_ns(&self, widening_ns2: f64) -> f64 {
        let sd_ns = self.sd_ns(widening_ns2);
        // The derivative changes sign between the start of the rise and the decay of the lobe.
        let falls = |time_ns: f64| {
            self.terms.iter().map(|term| term.slope(time_ns + self.peak_ns, sd_ns)).sum::<f64>() < 0.0
        };
        boundary(-sd_ns, sd_ns, falls)
    }

    /// Full width at half maximum, ns.
    pub fn fwhm_ns(&self) -> f64 {
        let far = 4.0 * self.variance_ns2.sqrt();
        boundary(0.0, far, |t| self.at(t, 0.0) < 0.5) - boundary(-far, 0.0, |t| self.at(t, 0.0) > 0.5)
    }

    /// SD of the normal part of the widened response, ns.
    fn sd_ns(&self, widening_ns2: f64) -> f64 {
        (self.variance_ns2 + widening_ns2).sqrt()
    }

    /// Decay constant of the slowest term, ns, and the time from which only that term remains, ns
    /// from the peak.
    ///
    /// From then on, the response is one exponential or zero.
    fn end(&self, widening_ns2: f64) -> (f64, f64) {
        let sd_ns = self.sd_ns(widening_ns2);
        let decay_ns = self.terms.iter().map(|term| term.decay_ns).fold(0.0, f64::max);
        let last = |term: &Term| {
            let short = if term.decay_ns < decay_ns { 20.0 * term.decay_ns } else { 0.0 };
            term.delay_ns + short + 6.0 * sd_ns
        };
        (decay_ns, self.terms.iter().map(last).fold(0.0, f64::max))
    }
}

impl Term {
    /// Decay convolved with a normal distribution of SD `sd_ns` (exponentially modified Gaussian).
    fn at(&self, time_ns: f64, sd_ns: f64) -> f64 {
        let (t, decay) = (time_ns - self.delay_ns, self.decay_ns);
        if decay == 0.0 {
            return self.area * normal_density(t, sd_ns);
        }
        let ratio = sd_ns / decay;
        let below = libm::erfc((ratio - t / sd_ns) * core::f64::consts::FRAC_1_SQRT_2);
        self.area / (2.0 * decay) * libm::exp(0.5 * ratio * ratio - t / decay) * below
    }

    /// Time derivative of [`Term::at`].
    fn slope(&self, time_ns: f64, sd_ns: f64) -> f64 {
        let t = time_ns - self.delay_ns;
        let density = self.area * normal_density(t, sd_ns);
        if self.decay_ns == 0.0 {
            return -t / (sd_ns * sd_ns) * density;
        }
        (density - self.at(time_ns, sd_ns)) / self.decay_ns
    }
}

fn normal_density(x: f64, sd: f64) -> f64 {
    let z = x / sd;
    libm::exp(-0.5 * z * z) / (sd * (2.0 * core::f64::consts::PI).sqrt())
}

/// Position where `beyond` becomes true between `low` and `high`, to the last bit.
fn boundary(mut low: f64, mut high: f64, beyond: impl Fn(f64) -> bool) -> f64 {
    loop {
        let middle = 0.5 * (low + high);
        if middle <= low || middle >= high {
            return middle;
        }
        if beyond(middle) { high = middle } else { low = middle }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_gaussian_is_one() {
        let shape = PulseShape::gaussian(4.5);
        assert!((shape.fwhm_ns() - 4.5).abs() < 1e-12);
        assert!((shape.at(2.25, 0.0) - 0.5).abs() < 1e-12);
        assert!(shape.peak_ns(3.0).abs() < 1e-12);
        // Twice the variance: the peak falls by a factor of the square root of two.
        let variance = (4.5 / FWHM_OF_NORMAL).powi(2);
        assert!((shape.at(0.0, variance) - 0.5f64.sqrt()).abs() < 1e-12);
    }

    #[test]
    fn the_peak_has_height_one_at_time_zero() {
        for shape in [PulseShape::gaussian(3.0), PulseShape::riegl(), PulseShape::riegl_reference()] {
            assert!((shape.at(0.0, 0.0) - 1.0).abs() < 1e-15);
            assert!(shape.peak_ns(0.0).abs() < 1e-12, "{}", shape.peak_ns(0.0));
            assert!(shape.at(-0.01, 0.0) < 1.0 && shape.at(0.01, 0.0) < 1.0);
        }
    }

    /// Values measured on recordings of RIEGL LMS-Q680i and LMS-Q680.
    #[test]
    fn the_response_has_the_measured_width_after_pulse_and_tail() {
        let shape = PulseShape::riegl();
        assert!((shape.fwhm_ns() - 4.5).abs() < 0.005, "{}", shape.fwhm_ns());
        let at = |time_ns| shape.at(time_ns, 0.0);
        assert!((at(10.5) - 0.05).abs() < 0.001, "{}", at(10.5));
        assert!(at(10.5) > at(9.0) && at(10.5) > at(12.0) && at(7.0) < 0.035);
        for (time_ns, height) in [(20.0, 0.0160), (30.0, 0.0100), (40.0, 0.0065)] {
            assert!((at(time_ns) - height).abs() < 0.0007, "{time_ns} ns: {}", at(time_ns));
        }
        assert!(PulseShape::riegl_reference().at(10.5, 0.0) < 1e-5);
    }

    /// The closed form equals a direct sum of the convolution.
    #[test]
    fn widening_is_a_convolution_with_a_gaussian() {
        let (shape, sd, step) = (PulseShape::riegl(), 1.7, 0.01);
        for time_ns in [-4.0, 0.0, 1.3, 6.0, 11.0, 40.0] {
            let sum: f64 = (-1500..=1500)
                .map(|k| f64::from(k) * step)
                .map(|lag| shape.at(time_ns - lag, 0.0) * normal_density(lag, sd) * step)
                .sum();
            assert!((shape.at(time_ns, sd * sd) - sum).abs() < 1e-9, "{time_ns}");
        }
    }

    #[test]
    fn beyond_its_end_the_response_is_one_exponential() {
        for widening in [0.0, 16.0] {
            let shape = PulseShape::riegl();
            let (decay, end) = shape.end(widening);
            let ratio = shape.at(end + 5.0, widening) / shape.at(end, widening);
            assert!((ratio - (-5.0 / decay).exp()).abs() < 1e-6, "{ratio}");
            let gaussian = PulseShape::gaussian(4.5);
            let (decay, end) = gaussian.end(widening);
            assert!(decay == 0.0 && gaussian.at(end, widening) < 1e-7);
        }
    }
}
