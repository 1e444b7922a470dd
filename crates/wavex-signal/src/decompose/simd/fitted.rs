//! Fit results: values, standard deviations, and convergence.

use wavex_simd::{LANES, Simd, Sixteen};

use super::layout::{U_MAX, Values};
use super::template::Pulses;

/// A fitted pulse.
#[derive(Clone, Copy)]
pub(super) struct FittedPulse {
    pub(super) values: Values,
    /// Standard deviations of the values.
    pub(super) sds: Values,
    pub(super) width_ratio: f32,
    /// Decrease of the values per DN of background; 0 for a known background.
    ///
    /// `level_information` is the information on the background that the pulse absorbs, 1/DN². The
    /// first pulse of a cluster holds that of the whole cluster.
    pub(super) by_level: Values,
    pub(super) level_information: f32,
}

impl FittedPulse {
    pub(super) const NOTHING: FittedPulse = FittedPulse {
        values: [0.0; 3],
        sds: [0.0; 3],
        width_ratio: 0.0,
        by_level: [0.0; 3],
        level_information: 0.0,
    };

    /// Whether the width is inside the tables.
    pub(super) fn is_held(&self) -> bool {
        self.values[2] < U_MAX as f32
    }

    /// Whether the standard deviations are known.
    #[inline(always)]
    pub(super) fn is_known(&self) -> bool {
        self.sds.iter().all(|sd| sd.is_finite() && *sd > 0.0)
    }
}

/// Sixteen fitted pulses, one per lane.
pub(super) struct FittedLanes {
    values: [Sixteen; 3],
    sds: [Sixteen; 3],
    width_ratios: Sixteen,
    /// Lanes with known standard deviations.
    known: u16,
    /// Lanes with a width inside the tables.
    held: u16,
}

impl FittedLanes {
    #[inline(always)]
    pub(super) fn of<S: Simd>(s: S, pulses: &Pulses<S::V>, variances: [S::V; 3]) -> FittedLanes {
        let (mut values, mut sds, mut width_ratios) = ([[0.0; LANES]; 3], [[0.0; LANES]; 3], [0.0; LANES]);
        s.store(pulses.height, &mut values[0]);
        s.store(pulses.position, &mut values[1]);
        s.store(pulses.width, &mut values[2]);
        let mut known = u16::MAX;
        for (variance, sds) in variances.into_iter().zip(&mut sds) {
            let sd = s.sqrt(variance);
            known &= s.gt(sd, s.splat(0.0)) & s.gt(s.splat(f32::INFINITY), sd);
            s.store(sd, sds);
        }
        s.store(exponential(s, pulses.width), &mut width_ratios);
        let held = s.gt(s.splat(U_MAX as f32), pulses.width);
        FittedLanes { values, sds, width_ratios, known, held }
    }

    /// Lanes with known standard deviations and a width inside the tables.
    pub(super) fn known_and_held(&self) -> u16 {
        self.known & self.held
    }

    #[inline(always)]
    pub(super) fn get(&self, lane: usize) -> FittedPulse {
        let FittedLanes { values, sds, width_ratios, .. } = self;
        FittedPulse {
            values: [values[0][lane], values[1][lane], values[2][lane]],
            sds: [sds[0][lane], sds[1][lane], sds[2][lane]],
            width_ratio: width_ratios[lane],
            ..FittedPulse::NOTHING
        }
    }
}

/// Exponential of `ln` widths within the tables, relative error 5e-7.
///
/// Squares the series for a quarter of the exponent twice.
#[inline(always)]
fn exponential<S: Simd>(s: S, ln_width_ratio: S::V) -> S::V {
    let quarter = s.mul(ln_width_ratio, s.splat(0.25));
    let mut sum = s.splat(1.0);
    for k in [8.0, 7.0, 6.0, 5.0, 4.0, 3.0, 2.0, 1.0_f32] {
        sum = s.fma(s.mul(sum, s.splat(1.0 / k)), quarter, s.splat(1.0));
    }
    let half = s.mul(sum, sum);
    s.mul(half, half)
}

/// The fitted pulses of one job.
#[derive(Clone, Copy)]
pub(super) struct Fitted<const P: usize> {
    pub(super) pulses: [FittedPulse; P],
    /// Whether the fit ended at an optimum inside tables and frame.
    pub(super) is_optimum: bool,
    /// Whether more iterations may reach the optimum.
    pub(super) may_go_on: bool,
    /// Chi-square with the prior terms, and the decrease promised by the next step.
    pub(super) objective: f32,
    pub(super) promised: f32,
    /// Decrease promised by the undamped step, regardless of the limits of the tables.
    pub(super) beyond: f32,
}

impl<const P: usize> Fitted<P> {
    pub(super) fn values(&self) -> [Values; P] {
        self.pulses.map(|pulse| pulse.values)
    }

    pub(super) const NOTHING: Fitted<P> = Fitted {
        pulses: [FittedPulse::NOTHING; P],
        is_optimum: false,
        may_go_on: false,
        objective: 0.0,
        promised: 0.0,
        beyond: 0.0,
    };
}
