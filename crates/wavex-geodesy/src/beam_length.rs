//! Beam length per nanosecond in files that store beams as rounded vectors.

/// Length per nanosecond along a beam, m, as a function of its direction.
///
/// A file that stores a beam as two rounded points makes every beam slightly too long or too short:
/// with a grid of 1 cm and points 150 m apart by 4 mm, which is 14 mm at a range of 500 m. The true
/// length is the same for all beams in a Cartesian frame. In a projected CRS, which scales only
/// horizontal distances, its square is linear in the square of the vertical direction cosine. This
/// line is fitted, and used if the residual does not exceed the rounding.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BeamLength {
    model: Option<LengthModel>,
}

/// Squared length as a linear function of the squared vertical cosine.
#[derive(Clone, Copy, Debug, PartialEq)]
struct LengthModel {
    horizontal: f64,
    slope: f64,
}

/// Largest accepted ratio of the residual to the rounding error.
const TOLERANCE: f64 = 1.5;
/// Relative deviation from the median length that marks a damaged record; projections scale by a
/// tenth of it.
const STRAY_PART: f64 = 0.01;
/// With more than one damaged record per this many beams, no model is used.
const BEAMS_PER_STRAY: usize = 20;
/// Minimum number of beams for a model.
const FEWEST_BEAMS: usize = 30;
/// Significance of the slope, in standard deviations. Below it the slope is attributed to rounding:
/// extrapolated to the vertical, it would cause larger range errors than a scale that small.
const SIGNIFICANT_SLOPE_SD: f64 = 4.0;

impl BeamLength {
    /// Fits the model to `beams`, in m per ns.
    ///
    /// Each is the difference of two points rounded to `grid_m` and `baseline_ns` apart. A few
    /// damaged beams are tolerated. `projected`: the frame may be a projected CRS, which scales
    /// horizontal distances.
    pub fn learn(beams: &[[f64; 3]], grid_m: [f64; 3], baseline_ns: f64, projected: bool) -> BeamLength {
        // Each coordinate difference has two rounding errors, uniform over a grid step.
        let rounding_m_per_ns =
            grid_m.iter().fold(0.0, |most: f64, step| most.max(*step)) / 6f64.sqrt() / baseline_ns;
        let sound = sound(beams);
        let enough =
            sound.len() >= FEWEST_BEAMS && (beams.len() - sound.len()) * BEAMS_PER_STRAY <= beams.len();
        let fitted = fit(&sound, projected);
        let rms_m_per_ns = fitted.map_or(f64::INFINITY, |line| line.rms_m_per_ns(&sound));
        let explained = enough && rms_m_per_ns <= TOLERANCE * rounding_m_per_ns;
        BeamLength { model: fitted.filter(|_| explained) }
    }

    /// Length per nanosecond of a beam, m: from the model if there is one, else its own.
    pub fn of(&self, beam: [f64; 3]) -> f64 {
        let square = dot(beam, beam);
        match self.model {
            Some(line) if square > 0.0 => line.square(beam[2] * beam[2] / square).sqrt(),
            _ => square.sqrt(),
        }
    }

    /// Length per nanosecond of a vertical beam, which projections do not scale, m; `None` without
    /// a model.
    pub fn vertical(&self) -> Option<f64> {
        self.model.map(|line| line.square(1.0).sqrt())
    }
}

impl LengthModel {
    fn square(&self, vertical_square: f64) -> f64 {
        self.horizontal + self.slope * vertical_square
    }

    fn rms_m_per_ns(&self, beams: &[[f64; 3]]) -> f64 {
        let squares = beams.iter().map(|beam| {
            let square = dot(*beam, *beam);
            (square.sqrt() - self.square(beam[2] * beam[2] / square).max(0.0).sqrt()).powi(2)
        });
        (squares.sum::<f64>() / beams.len() as f64).sqrt()
    }
}

/// Selects the beams close to the median length.
fn sound(beams: &[[f64; 3]]) -> Vec<[f64; 3]> {
    let mut lengths: Vec<f64> = beams.iter().map(|beam| dot(*beam, *beam).sqrt()).collect();
    lengths.sort_by(f64::total_cmp);
    let usual = lengths.get(lengths.len() / 2).copied().unwrap_or(f64::NAN);
    let is_sound = |beam: &&[f64; 3]| (dot(**beam, **beam).sqrt() / usual - 1.0).abs() <= STRAY_PART;
    beams.iter().filter(is_sound).copied().collect()
}

/// Least-squares line of length² over (vertical part)².
///
/// It is flat if the slope is not significant: for similar beams, or in a Cartesian frame. No beam
/// has length 0.
fn fit(beams: &[[f64; 3]], projected: bool) -> Option<LengthModel> {
    let pair = |beam: &[f64; 3]| (beam[2] * beam[2] / dot(*beam, *beam), dot(*beam, *beam));
    let pairs: Vec<(f64, f64)> = beams.iter().map(pair).collect();
    if pairs.is_empty() {
        return None;
    }
    let n = pairs.len() as f64;
    let (x, y) = pairs.iter().fold((0.0, 0.0), |(x, y), pair| (x + pair.0 / n, y + pair.1 / n));
    let (xx, xy) = pairs.iter().fold((0.0, 0.0), |(xx, xy), pair| {
        let dx = pair.0 - x;
        (xx + dx * dx / n, xy + dx * (pair.1 - y) / n)
    });
    // Below a spread of about 2 degrees the slope is undetermined.
    let slope = if xx > 1e-6 { xy / xx } else { 0.0 };
    let left = pairs.iter().map(|pair| (pair.1 - y - slope * (pair.0 - x)).powi(2)).sum::<f64>() / n;
    let slope_sd = (left / (n * xx.max(1e-6))).sqrt();
    let seen = projected && slope.abs() > SIGNIFICANT_SLOPE_SD * slope_sd;
    let slope = if seen { slope } else { 0.0 };
    Some(LengthModel { horizontal: y - slope * x, slope })
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[cfg(test)]
mod tests {
    use super::*;

    const SPEED: f64 = 0.149_853_751;

    /// Beams across a swath, scaled horizontally by `scale` and rounded to `grid_m` over 1000 ns.
    fn beams(scale: f64, grid_m: f64) -> Vec<[f64; 3]> {
        let beam = |i: i32| {
            let (sin, cos) = (f64::from(i) * 0.0005).sin_cos();
            let metres =
                [SPEED * sin * 0.6 * scale, SPEED * sin * 0.8 * scale, -SPEED * cos].map(|m| m * 1000.0);
            let start = [f64::from(i) * 0.377, f64::from(i) * 0.613, 700.0 + f64::from(i) * 0.0137];
            let round = |m: f64| (m / grid_m).round() * grid_m;
            std::array::from_fn(|axis| (round(start[axis] + metres[axis]) - round(start[axis])) / 1000.0)
        };
        (-1000..1000).map(beam).collect()
    }

    #[test]
    fn rounding_is_averaged_away() {
        for scale in [1.0, 0.9996, 1.0006] {
            let beams = beams(scale, 0.01);
            let length = BeamLength::learn(&beams, [0.01; 3], 1000.0, true);
            assert!((length.vertical().unwrap() / SPEED - 1.0).abs() < 2e-6);
            for beam in beams {
                let vertical = beam[2] / length.of(beam);
                let true_length =
                    SPEED / (vertical.powi(2) + (1.0 - vertical.powi(2)) / scale.powi(2)).sqrt();
                // 500 m of range are accurate to 2 mm; with each beam's own length the error is up
                // to 40 mm.
                assert!((length.of(beam) / true_length - 1.0).abs() < 4e-6, "{scale} {beam:?}");
            }
        }
    }

    /// Oblique beams only, as in a geocentric frame: the vertical is far outside the sampled
    /// directions.
    #[test]
    fn a_slope_within_rounding_is_ignored() {
        let oblique: Vec<[f64; 3]> = beams(1.0, 0.01)
            .iter()
            .map(|b| [b[0], 0.8 * b[1] - 0.6 * b[2], 0.6 * b[1] + 0.8 * b[2]])
            .filter(|b| b[0].abs() < 0.03)
            .map(|b| b.map(|x| (x * 150.0 / 0.01).round() * 0.01 / 150.0))
            .collect();
        let vertical = BeamLength::learn(&oblique, [0.01; 3], 150.0, true).vertical().unwrap();
        assert!((vertical / SPEED - 1.0).abs() < 4e-6, "{}", vertical / SPEED - 1.0);
        let whole = beams(1.0, 0.01);
        let cartesian = BeamLength::learn(&whole, [0.01; 3], 1000.0, false);
        assert_eq!(Some(cartesian.of(whole[0])), cartesian.vertical());
    }

    #[test]
    fn lengths_that_rounding_does_not_explain_are_kept() {
        let mut beams = beams(1.0, 0.01);
        beams.iter_mut().step_by(2).for_each(|beam| beam.iter_mut().for_each(|x| *x *= 1.001));
        let length = BeamLength::learn(&beams, [0.01; 3], 1000.0, true);
        assert_eq!(length.vertical(), None);
        assert_eq!(length.of(beams[0]), dot(beams[0], beams[0]).sqrt());
    }

    #[test]
    fn few_damaged_records_are_tolerated() {
        let whole = beams(1.0, 0.01);
        let vertical = |beams: &[[f64; 3]]| BeamLength::learn(beams, [0.01; 3], 1000.0, true).vertical();
        for stray in [[0.0; 3], [f64::NAN; 3], [f64::INFINITY, 0.0, 1.0], [1e9, 0.0, 0.1], [1e-9, 0.0, 0.0]] {
            let mut few = whole.clone();
            few.insert(1000, stray);
            assert_eq!(vertical(&few), vertical(&whole), "{stray:?}");
            few.extend([stray; 200]);
            assert_eq!(vertical(&few), None, "{stray:?}");
        }
    }

    #[test]
    fn without_beams_there_is_no_model() {
        let length = BeamLength::learn(&[], [0.01; 3], 1000.0, true);
        assert_eq!(length.of([3.0, 0.0, 4.0]), 5.0);
        assert_eq!(BeamLength::learn(&[[0.0; 3]; 50], [0.01; 3], 1000.0, true).vertical(), None);
    }
}
