//! Polygons of longitude and latitude.

/// Distance from an edge within which a place is on it, degrees; 0.1 mm.
const BORDER_DEG: f64 = 1e-9;
/// Turns by which longitudes of one place differ, degrees.
const TURNS_DEG: [f64; 3] = [-360.0, 0.0, 360.0];

/// A polygon, with holes; degrees of longitude and latitude.
///
/// Edges are straight in longitude and latitude. Longitudes beyond 180 degrees cross the antimeridian.
#[derive(Clone, Debug, PartialEq)]
pub struct Polygon {
    /// Corners of the outer ring and of the holes; the last one differs from the first.
    rings: Vec<Vec<[f64; 2]>>,
    /// West, south, east and north.
    bounds_deg: [f64; 4],
}

/// Why rings are no polygon.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum PolygonError {
    /// Too few corners.
    #[error("a polygon has {found} points, and 3 are needed")]
    FewPoints {
        /// Number of different successive points.
        found: usize,
    },
    /// The corners are on one line, or the area of a ring that crosses itself is 0.
    #[error("the points of a polygon enclose no area")]
    Flat,
    /// A longitude is not on the earth.
    #[error("the longitude {longitude_deg} is not from -180 to 360 degrees")]
    Longitude {
        /// The longitude, degrees.
        longitude_deg: f64,
    },
    /// A latitude is not on the earth.
    #[error("the latitude {latitude_deg} is not from -90 to 90 degrees: points are [longitude, latitude]")]
    Latitude {
        /// The latitude, degrees.
        latitude_deg: f64,
    },
    /// An edge has two sides on the earth.
    #[error(
        "the edge from longitude {from_deg} to {to_deg} is longer than 180 degrees: across the antimeridian, count \
         longitudes beyond 180 (190 instead of -170); else add points"
    )]
    LongEdge {
        /// Longitude of its beginning, degrees.
        from_deg: f64,
        /// Longitude of its end, degrees.
        to_deg: f64,
    },
}

impl Polygon {
    /// A polygon of an outer ring and holes; each ring may repeat its first point at its end.
    ///
    /// # Errors
    /// If a ring has no area, a point is not on the earth, or an edge spans more than 180 degrees of longitude.
    pub fn new(mut rings: Vec<Vec<[f64; 2]>>) -> Result<Polygon, PolygonError> {
        if rings.is_empty() {
            return Err(PolygonError::FewPoints { found: 0 });
        }
        let mut bounds_deg = [f64::INFINITY, f64::INFINITY, f64::NEG_INFINITY, f64::NEG_INFINITY];
        for ring in &mut rings {
            check_places(ring)?;
            ring.dedup();
            if ring.len() > 1 && ring.first() == ring.last() {
                ring.pop();
            }
            if ring.len() < 3 {
                return Err(PolygonError::FewPoints { found: ring.len() });
            }
            let long = edges(ring).find(|[from, to]| (to[0] - from[0]).abs() > 180.0);
            if let Some([[from_deg, _], [to_deg, _]]) = long {
                return Err(PolygonError::LongEdge { from_deg, to_deg });
            }
            let [x, y] = ring[0];
            let twice_area: f64 =
                edges(ring).map(|[from, to]| (from[0] - x) * (to[1] - y) - (to[0] - x) * (from[1] - y)).sum();
            if twice_area == 0.0 {
                return Err(PolygonError::Flat);
            }
            for [longitude_deg, latitude_deg] in ring.iter().copied() {
                let [west, south, east, north] = bounds_deg;
                bounds_deg = [
                    west.min(longitude_deg),
                    south.min(latitude_deg),
                    east.max(longitude_deg),
                    north.max(latitude_deg),
                ];
            }
        }
        Ok(Polygon { rings, bounds_deg })
    }

    /// West, south, east and north, degrees.
    pub fn bounds_deg(&self) -> [f64; 4] {
        self.bounds_deg
    }

    /// Whether a place is in the polygon and in no hole, or on a border.
    ///
    /// Longitudes count modulo 360 degrees.
    pub fn includes(&self, longitude_deg: f64, latitude_deg: f64) -> bool {
        TURNS_DEG.iter().any(|turn_deg| self.includes_turned([longitude_deg + turn_deg, latitude_deg]))
    }

    fn includes_turned(&self, place: [f64; 2]) -> bool {
        let [west, south, east, north] = self.bounds_deg;
        let [x, y] = place;
        let within =
            |value: f64, least: f64, most: f64| value >= least - BORDER_DEG && value <= most + BORDER_DEG;
        if !within(x, west, east) || !within(y, south, north) {
            return false;
        }
        // An edge is crossed by the ray to the east; its lower end is part of it, the upper one is not.
        let mut is_inside = false;
        for edge in self.rings.iter().flat_map(|ring| edges(ring)) {
            if distance_deg(edge, place) <= BORDER_DEG {
                return true;
            }
            let [[from_x, from_y], [to_x, to_y]] = edge;
            if (from_y > y) != (to_y > y) && x < from_x + (y - from_y) / (to_y - from_y) * (to_x - from_x) {
                is_inside = !is_inside;
            }
        }
        is_inside
    }
}

fn check_places(ring: &[[f64; 2]]) -> Result<(), PolygonError> {
    for [longitude_deg, latitude_deg] in ring.iter().copied() {
        if !(-90.0..=90.0).contains(&latitude_deg) {
            return Err(PolygonError::Latitude { latitude_deg });
        }
        if !(-180.0..=360.0).contains(&longitude_deg) {
            return Err(PolygonError::Longitude { longitude_deg });
        }
    }
    Ok(())
}

/// Edges of a ring, the closing one included.
fn edges(ring: &[[f64; 2]]) -> impl Iterator<Item = [[f64; 2]; 2]> {
    ring.iter().zip(ring.iter().cycle().skip(1)).map(|(from, to)| [*from, *to])
}

/// Distance of a place from an edge, degrees.
fn distance_deg([[from_x, from_y], [to_x, to_y]]: [[f64; 2]; 2], [x, y]: [f64; 2]) -> f64 {
    let (along_x, along_y) = (to_x - from_x, to_y - from_y);
    let square = along_x * along_x + along_y * along_y;
    let part = (((x - from_x) * along_x + (y - from_y) * along_y) / square).clamp(0.0, 1.0);
    libm::hypot(x - from_x - part * along_x, y - from_y - part * along_y)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn polygon(rings: &[&[[f64; 2]]]) -> Polygon {
        Polygon::new(rings.iter().map(|ring| ring.to_vec()).collect()).unwrap()
    }

    #[test]
    fn borders_are_inside_and_holes_are_not() {
        let outer: &[[f64; 2]] = &[[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [2.0, 1.0], [0.0, 4.0], [0.0, 0.0]];
        let hole: &[[f64; 2]] = &[[1.0, 0.2], [3.0, 0.2], [2.0, 0.8]];
        let shape = polygon(&[outer, hole]);
        assert_eq!(shape.bounds_deg(), [0.0, 0.0, 4.0, 4.0]);
        for place in [[0.5, 1.0], [3.5, 2.0], [0.1, 0.1], [1.0, 0.19]] {
            assert!(shape.includes(place[0], place[1]), "{place:?}");
        }
        for place in [[2.0, 2.0], [2.0, 0.5], [-0.1, 1.0], [4.1, 0.0], [2.0, -0.1], [2.0, 4.0]] {
            assert!(!shape.includes(place[0], place[1]), "{place:?}");
        }
        // Corners and edges, slanted ones and those of the hole.
        for place in [[0.0, 0.0], [4.0, 4.0], [2.0, 1.0], [4.0, 2.0], [3.0, 2.5], [2.0, 0.2], [2.5, 0.5]] {
            assert!(shape.includes(place[0], place[1]), "{place:?}");
        }
        // A ray through corners counts each once.
        let diamond = polygon(&[&[[0.0, -1.0], [1.0, 0.0], [0.0, 1.0], [-1.0, 0.0]]]);
        assert!(diamond.includes(-0.5, 0.0) && !diamond.includes(-1.5, 0.0) && !diamond.includes(1.5, 0.0));
        assert!(!diamond.includes(-0.9, 1.0) && !diamond.includes(-0.9, -1.0));
        assert!(!diamond.includes(f64::NAN, 0.0));
    }

    #[test]
    fn longitudes_count_modulo_a_turn() {
        let pacific = polygon(&[&[[170.0, -10.0], [190.0, -10.0], [190.0, 10.0], [170.0, 10.0]]]);
        for (longitude_deg, is_inside) in
            [(175.0, true), (-175.0, true), (185.0, true), (-170.0, true), (0.0, false)]
        {
            assert_eq!(pacific.includes(longitude_deg, 0.0), is_inside, "{longitude_deg}");
        }
        let greenland = polygon(&[&[[310.0, 60.0], [320.0, 60.0], [320.0, 70.0], [310.0, 70.0]]]);
        assert!(greenland.includes(-45.0, 65.0) && greenland.includes(315.0, 65.0));
        let greenwich = polygon(&[&[[-1.0, 50.0], [1.0, 50.0], [1.0, 52.0], [-1.0, 52.0]]]);
        assert!(greenwich.includes(359.5, 51.0) && greenwich.includes(0.5, 51.0));
    }

    #[test]
    fn rings_without_area_or_place_are_refused() {
        let error = |ring: &[[f64; 2]]| Polygon::new(vec![ring.to_vec()]).unwrap_err().to_string();
        let begins = |found: String, expected: &str| assert!(found.starts_with(expected), "{found}");
        begins(error(&[]), "a polygon has 0 points, and 3 are needed");
        begins(error(&[[1.0, 2.0], [3.0, 4.0], [1.0, 2.0]]), "a polygon has 2 points");
        begins(error(&[[1.0, 1.0], [2.0, 2.0], [3.0, 3.0]]), "the points of a polygon enclose no area");
        begins(
            error(&[[1.0, 170.0], [2.0, 2.0], [3.0, 5.0]]),
            "the latitude 170 is not from -90 to 90 degrees: points",
        );
        begins(error(&[[5e5, 1.0], [2.0, 2.0], [3.0, 5.0]]), "the longitude 500000 is not from -180 to 360");
        begins(
            error(&[[170.0, 1.0], [-170.0, 1.0], [-170.0, 5.0]]),
            "the edge from longitude 170 to -170 is longer",
        );
        assert_eq!(Polygon::new(Vec::new()), Err(PolygonError::FewPoints { found: 0 }));
    }
}
