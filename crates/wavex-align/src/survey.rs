//! Strips, their patches, and the state of an adjustment.

use rayon::prelude::*;
use wavex_geodesy::frames::Vector;
use wavex_geodesy::trajectory::corrections::TrajectoryCorrections;
use wavex_geodesy::trajectory::{Poses, Trajectory};

use crate::parameters::GlobalPriors;
use crate::patch::{Horizon, Patch};
use crate::residual::{centre, normal};
use crate::scanner::Scanner;

/// A strip.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Strip {
    /// Index of its trajectory.
    pub trajectory: usize,
    /// Index of its installation.
    pub installation: usize,
}

/// A scanner with the SDs of its start values.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Installation {
    /// Start values.
    pub scanner: Scanner,
    /// SDs of the start values.
    pub priors: GlobalPriors,
}

/// What an adjustment needs of a survey.
#[derive(Clone, Copy, Debug)]
pub struct Survey<'a> {
    /// Trajectories, as recorded.
    pub trajectories: &'a [Trajectory],
    /// Installations of scanners.
    pub installations: &'a [Installation],
    /// Strips.
    pub strips: &'a [Strip],
    /// Patches of all strips, in any order.
    pub patches: &'a [Patch],
    /// Horizontal frame in which patches are matched.
    pub horizon: Horizon,
}

/// Values of all parameters.
#[derive(Clone, Debug, PartialEq)]
pub struct State {
    /// Scanner of each installation.
    pub scanners: Vec<Scanner>,
    /// Corrections of each strip; `None` if it has none.
    pub corrections: Vec<Option<TrajectoryCorrections>>,
}

/// A patch at its place, east, north, up, for matching. Single precision: 8 mm at 100 km.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Located {
    centre_m: [f32; 3],
    normal: [f32; 3],
}

impl Located {
    pub(crate) fn new(centre_m: [f32; 3], normal: [f32; 3]) -> Located {
        Located { centre_m, normal }
    }

    pub(crate) fn centre_m(&self) -> Vector {
        self.centre_m.map(f64::from)
    }

    pub(crate) fn normal(&self) -> Vector {
        self.normal.map(f64::from)
    }
}

impl<'a> Survey<'a> {
    /// Sequential access to the poses of all trajectories.
    pub(crate) fn poses(&self) -> Vec<Poses<'a>> {
        self.trajectories.iter().map(Trajectory::poses).collect()
    }

    /// Ends of the beams of a patch in the earth-centred frame; `None` without a pose.
    pub(crate) fn ends(&self, patch: &Patch, state: &State, poses: &mut [Poses<'_>]) -> Option<[Vector; 3]> {
        let strip = self.strips.get(patch.strip as usize)?;
        let scanner = state.scanners.get(strip.installation)?;
        let corrections = state.corrections.get(patch.strip as usize)?.as_ref();
        let poses = poses.get_mut(strip.trajectory)?;
        let mut ends = [[0.0; 3]; 3];
        for (end, beam) in ends.iter_mut().zip(&patch.beams) {
            *end = scanner.locate(&patch.source, beam, poses, corrections)?;
        }
        Some(ends)
    }

    pub(crate) fn locate(&self, patch: &Patch, state: &State, poses: &mut [Poses<'_>]) -> Option<Located> {
        let ends = self.ends(patch, state, poses)?;
        Some(Located {
            centre_m: self.horizon.local_m(centre(&ends)).map(|along_m| along_m as f32),
            normal: self.horizon.local_direction(normal(&ends)?).map(|part| part as f32),
        })
    }

    /// All patches at their places; `None` without a pose.
    pub(crate) fn locate_all(&self, state: &State) -> Vec<Option<Located>> {
        let chunks = self.patches.par_chunks(1024).flat_map_iter(|chunk| {
            let mut poses = self.poses();
            chunk.iter().map(move |patch| self.locate(patch, state, &mut poses)).collect::<Vec<_>>()
        });
        chunks.collect()
    }
}
