//! Settings of zone assignment.

/// Prior knowledge of ranges.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Prior {
    /// Only [`Settings::range_m`].
    None,
    /// Height above flat ground: the range of a shot is `agl_m / cos_nadir`.
    Agl {
        /// Height above ground, m.
        agl_m: f64,
        /// Standard deviation of the terrain about flat ground, m.
        sd_m: f64,
    },
    /// [`Emission::prior_range_m`](super::Emission::prior_range_m), from a terrain model or a trajectory.
    PerEmission {
        /// Standard deviation of the terrain about the expected range, m.
        sd_m: f64,
    },
}

/// Method of MTA zone assignment.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Method {
    /// Evidence of blocks of neighbouring echoes, combined over the line window.
    Blocks,
    /// Least variance of consecutive ranges in a buffer of fixed length.
    Variance {
        /// Length of the buffer, ranges; 50 is usual.
        buffer: usize,
    },
    /// The same zone for all echoes.
    Fixed(u16),
}

/// Settings of a [`Resolver`](super::Resolver).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// Method of zone assignment.
    pub method: Method,
    /// Prior knowledge of ranges.
    pub prior: Prior,
    /// Smallest and largest feasible range, m. At most 126 pulse intervals are considered.
    pub range_m: [f64; 2],
    /// Speed of the pulse, m/s.
    pub group_velocity_mps: f64,
    /// Echoes this close to an emission are flagged, ns.
    pub blind_gap_ns: f64,
    /// Scan angles are azimuths of a conical scan: they increase with time and wrap at 360 degrees.
    /// Lines are merged into revolutions.
    pub is_cyclic: bool,
}

impl Default for Settings {
    fn default() -> Settings {
        Settings {
            method: Method::Blocks,
            prior: Prior::None,
            range_m: [30.0, 5000.0],
            group_velocity_mps: 299_710_540.0,
            blind_gap_ns: 15.0,
            is_cyclic: false,
        }
    }
}
