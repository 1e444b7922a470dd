//! Echoes and sensor positions of a recording from above.

use maud::Markup;

use super::reservoir::Thinned;
use crate::page::figure;
use crate::plot::{MapFrame, Svg, extent};
use crate::report::overview::view::MapProjection;
use wavex_line::scan_line::{Emission, Frame, InputInfo};

/// Maximum number of echoes, and of sensor positions, that are kept.
const KEPT: usize = 3000;

/// Positions of some echoes and of the sensor, in recordings with map or earth-centred coordinates.
#[derive(Debug)]
pub struct PlanView {
    /// The view, set by the first echo.
    view: Option<MapProjection>,
    echoes: Thinned<[f64; 2]>,
    track: Thinned<[f64; 2]>,
}

impl Default for PlanView {
    fn default() -> PlanView {
        PlanView { view: None, echoes: Thinned::new(KEPT), track: Thinned::new(KEPT) }
    }
}

impl PlanView {
    /// Adds an echo of a shot, received this time after its emission.
    pub(super) fn add(&mut self, input: &InputInfo, emission: &Emission, flight_ns: f64) {
        if !matches!(input.frame, Frame::Map | Frame::Earth) {
            return;
        }
        let range_m = flight_ns * 0.5e-9 * input.group_velocity_mps * emission.frame_scale;
        let echo: [f64; 3] =
            std::array::from_fn(|axis| emission.origin_m[axis] + range_m * emission.direction[axis]);
        if !echo.iter().chain(&emission.origin_m).all(|coordinate| coordinate.is_finite()) {
            return;
        }
        let view = self.view.get_or_insert_with(|| MapProjection::of(input, echo));
        let flat = |point: [f64; 3]| {
            let [east, north, _] = view.place(point);
            [east, north]
        };
        self.echoes.add(|| flat(echo));
        if input.origin_is_sensor {
            self.track.add(|| flat(emission.origin_m));
        }
    }

    /// Draws the view; `None` without echoes.
    pub(super) fn figure(&self) -> Option<Markup> {
        let view = self.view.as_ref()?;
        let all = || self.echoes.items().iter().chain(self.track.items());
        let span = |axis: usize| {
            let [low, high] = extent(all().map(|place| place[axis]));
            let room = (0.03 * (high - low)).max(1e-6);
            [low - room, high + room]
        };
        let middle = self.echoes.items().first().map_or(0.0, |place| place[1]);
        let unit = view.unit();
        let slimmer = if unit == "°" { middle.to_radians().cos().max(0.02) } else { 1.0 };
        let frame =
            MapFrame::new(span(0), span(1), slimmer, ["east", "north"].map(|name| format!("{name}, {unit}")));
        let mut svg = Svg::new();
        frame.grid(&mut svg);
        self.echoes.items().iter().for_each(|place| svg.circle("dot", frame.plot.at(*place), 1.2));
        self.track.items().iter().for_each(|place| svg.circle("high dot", frame.plot.at(*place), 1.2));
        let title = match self.track.items().is_empty() {
            true => "plan view: some echoes",
            false => "plan view: some echoes (blue) and sensor positions (orange)",
        };
        Some(figure(title, frame.finish(svg, title), ""))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn echoes_lie_along_the_beam() {
        let input = InputInfo {
            frame: Frame::Map,
            origin_is_sensor: true,
            group_velocity_mps: 3e8,
            ..InputInfo::default()
        };
        let emission =
            Emission { origin_m: [100.0, 200.0, 600.0], direction: [0.6, 0.0, -0.8], ..Emission::default() };
        let mut plan = PlanView::default();
        assert!(plan.figure().is_none());
        plan.add(&input, &emission, 1000.0);
        assert_eq!((plan.echoes.items(), plan.track.items()), (&[[190.0, 200.0]][..], &[[100.0, 200.0]][..]));
        assert!(plan.figure().unwrap().0.contains("east, m"));
        let mut scanner = PlanView::default();
        scanner.add(&InputInfo { frame: Frame::Scanner, ..input }, &emission, 1000.0);
        assert!(scanner.figure().is_none(), "a scanner has no place");
    }
}
