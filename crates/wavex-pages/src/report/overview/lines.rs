//! Counts along the flight, in groups of scan lines.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use wavex_line::scan_line::ScanLine;
use wavex_line::stage::packed;

/// Maximum number of groups.
const MOST_GROUPS: usize = 512;

/// Counters of scan lines, in groups.
#[derive(Clone, Debug, Default, PartialEq, Deserialize, Serialize, JsonSchema)]
pub struct LineGroups {
    /// Scan lines per group, by line number from 0; a power of two.
    pub lines_per_group: u32,
    /// Number of lines per group, separated by spaces, as are the other counts.
    #[serde(serialize_with = "packed::serialize", deserialize_with = "packed::deserialize")]
    #[schemars(with = "String")]
    pub lines: Vec<u64>,
    /// Waveforms.
    #[serde(serialize_with = "packed::serialize", deserialize_with = "packed::deserialize")]
    #[schemars(with = "String")]
    pub waveforms: Vec<u64>,
    /// Returns, including withheld ones.
    #[serde(serialize_with = "packed::serialize", deserialize_with = "packed::deserialize")]
    #[schemars(with = "String")]
    pub returns: Vec<u64>,
    /// Points: returns with coordinates that are not withheld.
    #[serde(serialize_with = "packed::serialize", deserialize_with = "packed::deserialize")]
    #[schemars(with = "String")]
    pub points: Vec<u64>,
}

/// Groups being filled: lines, waveforms, returns and points of each.
#[derive(Clone, Debug)]
pub(super) struct Groups {
    lines_per_group: u32,
    counts: Vec<[u64; 4]>,
}

impl Default for Groups {
    fn default() -> Groups {
        Groups { lines_per_group: 1, counts: Vec::new() }
    }
}

impl Groups {
    pub(super) fn add(&mut self, scan_line: &ScanLine) {
        let kept = |returns: &[wavex_line::scan_line::Return]| {
            returns.iter().filter(|found| !found.withheld).count()
        };
        let points = scan_line.points().and(scan_line.returns()).map_or(0, |returns| kept(returns));
        self.count(scan_line.line, [1, scan_line.stats.nw, scan_line.n_returns() as u64, points as u64]);
    }

    fn count(&mut self, line: u32, counted: [u64; 4]) {
        while line / self.lines_per_group >= MOST_GROUPS as u32 {
            self.lines_per_group = self.lines_per_group.saturating_mul(2);
            self.counts = self.counts.chunks(2).map(sum).collect();
        }
        let group = (line / self.lines_per_group) as usize;
        if self.counts.len() <= group {
            self.counts.resize(group + 1, [0; 4]);
        }
        if let Some(counts) = self.counts.get_mut(group) {
            *counts = sum(&[*counts, counted]);
        }
    }

    pub(super) fn finish(self) -> LineGroups {
        let column = |i: usize| self.counts.iter().filter_map(|counts| counts.get(i).copied()).collect();
        LineGroups {
            lines_per_group: self.lines_per_group,
            lines: column(0),
            waveforms: column(1),
            returns: column(2),
            points: column(3),
        }
    }
}

fn sum(rows: &[[u64; 4]]) -> [u64; 4] {
    rows.iter().fold([0; 4], |sum, row| std::array::from_fn(|i| sum[i] + row[i]))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn groups_double_and_lose_nothing() {
        let of = |order: &mut dyn Iterator<Item = u32>| {
            let mut groups = Groups::default();
            order.for_each(|line| groups.count(line, [1, 10, u64::from(line % 3), 2]));
            groups.finish()
        };
        let few = of(&mut (0..5));
        assert_eq!((few.lines_per_group, few.returns.as_slice()), (1, &[0, 1, 2, 0, 1][..]));
        let many = of(&mut (0..1500));
        assert_eq!((many.lines_per_group, many.lines.len()), (4, 375));
        assert_eq!(many.waveforms.iter().sum::<u64>(), 15_000);
        assert_eq!(many, of(&mut (0..1500).rev()), "independent of the order");
        assert_eq!(of(&mut [u32::MAX, 0].into_iter()).lines.iter().sum::<u64>(), 2);
    }
}
