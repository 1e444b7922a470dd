//! Heights of accepted objects around a place.

use super::objects::{Cells, Column, Object};

/// Number of widths of columns, each twice the one before.
const LEVELS: usize = 8;

/// Lowest and highest accepted point by column, at several widths.
#[derive(Debug)]
pub(super) struct Envelope {
    levels: Vec<Cells<[f64; 2]>>,
}

impl Default for Envelope {
    fn default() -> Envelope {
        Envelope { levels: (0..LEVELS).map(|_| Cells::default()).collect() }
    }
}

/// Free heights between an object and accepted ones, m; negative if they overlap in height.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Place {
    /// Smallest free height below the object.
    pub(super) above_m: f64,
    /// Smallest free height above the object.
    pub(super) below_m: f64,
}

impl Envelope {
    /// Adds an accepted object.
    pub(super) fn add(&mut self, object: &Object) {
        for (column, heights_m) in &object.columns {
            for (level, cells) in self.levels.iter_mut().enumerate() {
                let key = key(column.map(|index| index >> level));
                let cell = cells.entry(key).or_insert([f64::INFINITY, f64::NEG_INFINITY]);
                *cell = [cell[0].min(heights_m[0]), cell[1].max(heights_m[1])];
            }
        }
    }

    /// Place of an object relative to the accepted ones; zeros if none is near.
    pub(super) fn place_of(&self, object: &Object) -> Place {
        let mut place: Option<Place> = None;
        for (column, heights_m) in &object.columns {
            let Some(around_m) = self.around(*column) else { continue };
            let (above_m, below_m) = (heights_m[0] - around_m[1], around_m[0] - heights_m[1]);
            let least = place.get_or_insert(Place { above_m, below_m });
            *least = Place { above_m: least.above_m.min(above_m), below_m: least.below_m.min(below_m) };
        }
        place.unwrap_or_default()
    }

    /// Whether the middle of an object is nearer to the lowest accepted point around than to the highest.
    pub(super) fn is_below(&self, object: &Object) -> bool {
        let Some((column, heights_m)) = object.columns.first() else { return false };
        self.around(*column).is_some_and(|around_m| heights_m[0] < around_m[0])
    }

    /// Lowest and highest accepted point around a column.
    fn around(&self, column: Column) -> Option<[f64; 2]> {
        (0..LEVELS).find_map(|level| {
            let cells = &self.levels[level];
            let [i, j] = column.map(|index| index >> level);
            let mut found: Option<[f64; 2]> = None;
            for di in -1..=1 {
                for dj in -1..=1 {
                    let Some(cell) = cells.get(&key([i + di, j + dj])) else { continue };
                    let heights_m = found.get_or_insert(*cell);
                    *heights_m = [heights_m[0].min(cell[0]), heights_m[1].max(cell[1])];
                }
            }
            found
        })
    }
}

fn key([i, j]: Column) -> u64 {
    u64::from(i as u32) << 32 | u64::from(j as u32)
}
