//! Horizontal frames of the cells of patches.

use std::collections::BTreeMap;

use wavex_geodesy::ellipsoid::{Geodetic, WGS84};
use wavex_geodesy::frames::{LocalFrame, Rotation, Vector, inverse, rotate};

use crate::vector::{difference, sum};

/// A local horizontal frame: east, north, up of an origin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Horizon {
    origin_in_ecef_m: Vector,
    local_from_ecef: Rotation,
}

impl Horizon {
    /// The frame at a position.
    pub fn at(place: Geodetic) -> Horizon {
        Horizon {
            origin_in_ecef_m: WGS84.ecef_of(place),
            local_from_ecef: inverse(LocalFrame::at(WGS84, place).ecef_from_local()),
        }
    }

    /// East, north, up of a position in the earth-centred frame, m.
    pub fn local_m(&self, ecef_m: Vector) -> Vector {
        rotate(&self.local_from_ecef, difference(ecef_m, self.origin_in_ecef_m))
    }

    /// Position in the earth-centred frame of east, north, up, m.
    pub(super) fn ecef_m(&self, local_m: Vector) -> Vector {
        sum(self.ecef_direction(local_m), self.origin_in_ecef_m)
    }

    /// Direction in the earth-centred frame of components east, north, up.
    pub fn ecef_direction(&self, local: Vector) -> Vector {
        rotate(&inverse(&self.local_from_ecef), local)
    }

    /// Components east, north, up of a direction in the earth-centred frame.
    pub fn local_direction(&self, in_ecef: Vector) -> Vector {
        rotate(&self.local_from_ecef, in_ecef)
    }
}

/// Index of a tile of the earth: geocentric latitude and longitude in steps of [`TILE_RAD`].
pub(super) type Tile = (i32, i32);

/// Edge of a tile: 28 km, so that the horizon of its centre is level to 3 mrad and true to 3 ppm.
const TILE_RAD: f64 = core::f64::consts::PI / 720.0;

/// Frame in which the cells of patches are.
#[derive(Debug)]
pub(super) enum Frame {
    /// One horizon for all cells.
    One(Horizon),
    /// The horizon of the centre of each tile.
    Tiles(Tiles),
}

/// Horizons of tiles.
#[derive(Debug, Default)]
pub(super) struct Tiles {
    horizons: BTreeMap<Tile, Horizon>,
    latest: Option<LatestTile>,
}

/// The tile used last, with its bounds.
#[derive(Clone, Copy, Debug)]
struct LatestTile {
    tile: Tile,
    horizon: Horizon,
    /// Tangents of its latitudes.
    latitude_tangents: [f64; 2],
    /// Sines and cosines of its longitudes.
    longitudes: [(f64, f64); 2],
}

impl LatestTile {
    /// Whether a position is in the tile; saves two arc tangents.
    fn contains(&self, [x, y, z]: Vector) -> bool {
        let from_axis = (x * x + y * y).sqrt();
        let [south, north] = self.latitude_tangents.map(|tangent| z - from_axis * tangent);
        let [west, east] = self.longitudes.map(|(sine, cosine)| y * cosine - x * sine);
        south >= 0.0 && north < 0.0 && west >= 0.0 && east < 0.0
    }
}

impl Frame {
    /// Tile of a position in the earth-centred frame.
    pub(super) fn tile(&self, [x, y, z]: Vector) -> Tile {
        match self {
            Frame::One(_) => (0, 0),
            Frame::Tiles(Tiles { latest: Some(latest), .. }) if latest.contains([x, y, z]) => latest.tile,
            Frame::Tiles(_) => {
                let index = |angle_rad: f64| (angle_rad / TILE_RAD).floor() as i32;
                (index(libm::atan2(z, (x * x + y * y).sqrt())), index(libm::atan2(y, x)))
            }
        }
    }

    /// Horizon of the cells of a tile.
    pub(super) fn horizon(&mut self, tile: Tile) -> Horizon {
        match self {
            Frame::One(horizon) => *horizon,
            Frame::Tiles(tiles) => match tiles.latest {
                Some(latest) if latest.tile == tile => latest.horizon,
                _ => {
                    let horizon = *tiles.horizons.entry(tile).or_insert_with(|| tile_horizon(tile));
                    let edges_rad = |index: i32| [index, index + 1].map(|edge| f64::from(edge) * TILE_RAD);
                    tiles.latest = Some(LatestTile {
                        tile,
                        horizon,
                        latitude_tangents: edges_rad(tile.0).map(libm::tan),
                        longitudes: edges_rad(tile.1).map(libm::sincos),
                    });
                    horizon
                }
            },
        }
    }
}

/// Horizon of the centre of a tile, on the ellipsoid.
pub(super) fn tile_horizon((latitude, longitude): Tile) -> Horizon {
    let middle_rad = |index: i32| (f64::from(index) + 0.5) * TILE_RAD;
    let ((sine, cosine), (east, north)) =
        (libm::sincos(middle_rad(latitude)), libm::sincos(middle_rad(longitude)));
    let ecef_m = [cosine * north, cosine * east, sine].map(|part| part * 6_371_000.0);
    Horizon::at(Geodetic { height_m: 0.0, ..WGS84.geodetic_of(ecef_m) })
}
