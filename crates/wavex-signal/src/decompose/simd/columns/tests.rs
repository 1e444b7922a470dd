use wavex_simd::{Kernel, SimdLevel};

use super::*;
use crate::noise::ArNoise;
use crate::simulated::{Random, channel};

struct Run<'a> {
    tables: &'a Tables,
    columns: &'a mut Columns,
    rows: &'a mut Rows,
    blocks: &'a [&'a [u16]],
}

impl Kernel for Run<'_> {
    type Output = [[u16; 2]; LANES];

    fn run<S: Simd>(self, s: S) -> [[u16; 2]; LANES] {
        let extremes = self.columns.load(s, self.blocks);
        self.columns.whiten(s, self.tables, self.rows, 0, self.blocks.len());
        self.columns.filter_samples(s, self.tables);
        self.columns.mark_maxima(s, 4.0);
        extremes
    }
}

/// Blocks of all lengths in one vector: extremes, whitening and statistic follow their formulas
/// in every lane, on every path and with any previous contents.
#[test]
fn every_lane_is_filtered_by_itself() {
    for coefficients in [&[0.6][..], &[0.5, -0.2, 0.1, 0.05]] {
        let noise = ArNoise::new(coefficients, 1.3).unwrap();
        let tables = Tables::new(&channel(&noise, 4.4, 20.0)).unwrap();
        let mut random = Random::new(5);
        let longest: Vec<Vec<u16>> =
            (0..LANES).map(|_| (0..192).map(|_| (20.0 + 60.0 * random.uniform()) as u16).collect()).collect();
        let lengths =
            [[60; LANES], std::array::from_fn(|w| [0, 1, 9, 16, 47, 64, 65, 130][w % 8]), [192; LANES]];
        for path in SimdLevel::ALL.into_iter().filter(|path| path.is_available()) {
            let mut rows = Rows::new(192);
            let mut columns = Columns::new(rows.capacity());
            for lengths in lengths {
                let blocks: Vec<&[u16]> = longest.iter().zip(lengths).map(|(b, n)| &b[..n]).collect();
                let (columns, rows) = (&mut columns, &mut rows);
                let run = Run { tables: &tables, columns, rows, blocks: &blocks };
                let extremes = path.run(run);
                for (w, block) in blocks.iter().enumerate() {
                    check(&tables, columns, rows, w, block);
                    let least = block.iter().min().copied().unwrap_or(u16::MAX);
                    assert_eq!(extremes[w], [least, block.iter().max().copied().unwrap_or(0)]);
                }
            }
        }
    }
}

fn check(tables: &Tables, columns: &Columns, rows: &Rows, w: usize, block: &[u16]) {
    let at = |i: isize| match usize::try_from(i).ok().and_then(|i| Some((i, block.get(i)?))) {
        Some((i, &sample)) => f64::from(sample) - f64::from(tables.background[i % 4]),
        None => 0.0,
    };
    let white = |i: isize| -> f64 {
        let taps = tables.whitening.iter().enumerate();
        taps.map(|(lag, tap)| f64::from(*tap) * at(i - lag as isize)).sum()
    };
    for k in 0..block.len() {
        let matched = tables.matched[k % 2].iter().enumerate();
        let first = k as isize - FILTER_BEFORE as isize;
        let sum: f64 = matched.map(|(i, value)| f64::from(*value) * white(first + i as isize)).sum();
        let [scale, _] = tables.filter.scale_and_level(k, (block.len() - k).min(LANES - 1)).map(f64::from);
        // Each tap may be rounded by 0.5.
        let samples = k as isize - TAPS_BEFORE as isize..(k + TAPS - TAPS_BEFORE) as isize;
        let rounding: f64 = samples.map(|i| 0.5 * scale * at(i).abs()).sum();
        let (found, expected) = (f64::from(columns.statistic(w, k)), scale * sum);
        let bound = rounding + 1e-3;
        assert!((found - expected).abs() < bound, "lane {w}, position {k}: {found} {expected}");
        if k >= tables.order {
            let found = f64::from(rows.residual_sixteen(w, k)[0]);
            let expected = white(k as isize);
            assert!((found - expected).abs() < 1e-3, "lane {w}, sample {k}: {found} {expected}");
        }
    }
    assert_eq!(rows.length(w), block.len());
    assert_eq!(*rows.residual_sixteen(w, block.len()), [0.0; LANES], "values after a block are 0");
}
