//! Returns with their positions on the map.

use super::session::Placing;
use wavex_line::scan_line::{Return, ScanLine};

/// A return with its position on the map, m.
#[derive(Clone, Debug)]
pub(super) struct PlacedReturn {
    pub(super) found: Return,
    pub(super) position: Option<[f64; 3]>,
}

/// Returns of each emission of a line, with their positions on the map.
pub(super) fn placed(line: &ScanLine, placing: Option<&Placing>) -> Vec<Vec<PlacedReturn>> {
    let mut placed = vec![Vec::new(); line.emissions.len()];
    let position = |at: usize| {
        let on_map = placing?.on_map(*line.points()?.get(at)?);
        on_map.iter().all(|coordinate| coordinate.is_finite()).then_some(on_map)
    };
    for (at, found) in line.returns().into_iter().flatten().enumerate() {
        if let Some(of_emission) = placed.get_mut(found.emission as usize) {
            of_emission.push(PlacedReturn { found: *found, position: position(at) });
        }
    }
    placed
}

pub(super) fn text(error: impl std::fmt::Display) -> String {
    error.to_string()
}
