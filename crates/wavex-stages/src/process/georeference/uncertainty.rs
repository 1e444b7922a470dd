//! Total uncertainty of point positions.

use wavex_geodesy::frames::Vector;
use wavex_geodesy::trajectory::{Accuracy, Pose};
use wavex_geodesy::vertical::down_at;
use wavex_line::georef::Geometry;
use wavex_line::georef::transform::variance_m2;
use wavex_line::scan_line::{Emission, Frame, InputInfo, Return};

/// Computes the uncertainties of a line.
pub(super) struct Uncertainty<'g> {
    geometry: &'g Geometry,
    input: &'g InputInfo,
}

impl<'g> Uncertainty<'g> {
    pub(super) fn new(geometry: &'g Geometry, input: &'g InputInfo) -> Uncertainty<'g> {
        Uncertainty { geometry, input }
    }

    /// Sets the total standard deviation of each return, if the trajectory has accuracies.
    pub(super) fn set(&self, emissions: &[Emission], points: &[Vector], returns: &mut [Return]) {
        if !self.geometry.knows_accuracy() {
            return;
        }
        // The vertical at the start of the line is accurate enough for the whole line.
        let first_m = emissions.first().map_or([0.0; 3], |first| first.origin_m);
        let Some(down) = down_at(Frame::Earth, first_m) else { return };
        let mut last: Option<(u32, Option<(Pose, Accuracy)>)> = None;
        for (r, point) in returns.iter_mut().zip(points) {
            let known = match last {
                Some((emission, known)) if emission == r.emission => known,
                _ => self.pose(&emissions[r.emission as usize]),
            };
            last = Some((r.emission, known));
            if let Some((pose, accuracy)) = known {
                let from_nav_m = std::array::from_fn(|axis| point[axis] - pose.origin_in_ecef_m[axis]);
                r.total_sd_m = variance_m2(&accuracy, &pose, down, from_nav_m, r.range_sd_m).sqrt();
            }
        }
    }

    fn pose(&self, emission: &Emission) -> Option<(Pose, Accuracy)> {
        let pose = self.geometry.pose(self.input, emission.gps_time_s)?;
        pose.accuracy.map(|accuracy| (pose, accuracy))
    }
}
