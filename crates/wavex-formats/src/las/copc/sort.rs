//! External merge sort of records by key.

use std::cmp::Reverse;
use std::collections::BinaryHeap;
use std::io::{self, BufReader, Read};
use std::path::Path;

use crate::{Error, Result};

/// Stores a run and returns a reader of it.
pub type Keep<'a> = &'a mut dyn FnMut(&[u8]) -> Result<Box<dyn Read>>;

/// Length of the key before each record, bytes.
const KEY: usize = 8;
/// Memory overhead per record, bytes.
const BESIDE: usize = 2 * size_of::<(u64, u32)>() + KEY;

/// Sorts records by key; the sort is stable.
pub(super) struct Sorter<'a> {
    record_length: usize,
    /// Maximum number of records in memory before they become a run.
    most: usize,
    keys: Vec<u64>,
    records: Vec<u8>,
    runs: Vec<Box<dyn Read>>,
    keep: Keep<'a>,
}

impl<'a> Sorter<'a> {
    /// Creates a sorter for records of this length.
    ///
    /// It uses about `memory_bytes`.
    pub(super) fn new(record_length: usize, memory_bytes: usize, keep: Keep<'a>) -> Sorter<'a> {
        // A sorted run is in memory next to its records until it is stored.
        let most = (memory_bytes / (2 * record_length + BESIDE)).clamp(1, u32::MAX as usize);
        Sorter { record_length, most, keys: Vec::new(), records: Vec::new(), runs: Vec::new(), keep }
    }

    /// Adds a record.
    ///
    /// # Errors
    /// A run cannot be stored.
    pub(super) fn push(&mut self, key: u64, record: &[u8]) -> Result<()> {
        if self.keys.len() >= self.most {
            let run = self.sorted();
            self.keys.clear();
            self.records.clear();
            self.runs.push((self.keep)(&run)?);
        }
        self.keys.push(key);
        self.records.extend_from_slice(record);
        Ok(())
    }

    /// Passes each record with its key to `take`, in order.
    ///
    /// `path` names the output in errors.
    ///
    /// # Errors
    /// `take` fails, or a run cannot be read.
    pub(super) fn finish(
        mut self,
        path: &Path,
        mut take: impl FnMut(u64, &[u8]) -> Result<()>,
    ) -> Result<()> {
        let last = self.sorted();
        drop((self.keys, self.records));
        self.runs.push(Box::new(io::Cursor::new(last)));
        let mut runs: Vec<SortedRun> =
            self.runs.into_iter().map(|input| SortedRun::new(input, KEY + self.record_length)).collect();
        let failed = Error::io(path, "read the points sorted before");
        let mut heads = BinaryHeap::new();
        for (number, run) in runs.iter_mut().enumerate() {
            heads.extend(run.next().map_err(&failed)?.map(|key| Reverse((key, number))));
        }
        while let Some(Reverse((key, number))) = heads.pop() {
            let Some(run) = runs.get_mut(number) else { continue };
            take(key, run.record())?;
            heads.extend(run.next().map_err(&failed)?.map(|key| Reverse((key, number))));
        }
        Ok(())
    }

    /// Returns the buffered records in order, each after its key.
    fn sorted(&self) -> Vec<u8> {
        let mut order: Vec<(u64, u32)> = self.keys.iter().copied().zip(0..).collect();
        order.sort_unstable();
        let mut run = Vec::with_capacity(order.len() * (KEY + self.record_length));
        for (key, number) in order {
            let start = number as usize * self.record_length;
            run.extend(key.to_le_bytes());
            run.extend_from_slice(self.records.get(start..start + self.record_length).unwrap_or_default());
        }
        run
    }
}

/// Reader of a stored run.
struct SortedRun {
    input: BufReader<Box<dyn Read>>,
    /// Key and record read last.
    entry: Vec<u8>,
}

impl SortedRun {
    fn new(input: Box<dyn Read>, entry: usize) -> SortedRun {
        SortedRun { input: BufReader::with_capacity(1 << 18, input), entry: vec![0; entry] }
    }

    /// Advances to the next record and returns its key.
    ///
    /// `None` at the end.
    fn next(&mut self) -> io::Result<Option<u64>> {
        use io::BufRead;
        if self.input.fill_buf()?.is_empty() {
            return Ok(None);
        }
        self.input.read_exact(&mut self.entry)?;
        Ok(self.entry.first_chunk().map(|key| u64::from_le_bytes(*key)))
    }

    fn record(&self) -> &[u8] {
        self.entry.get(KEY..).unwrap_or_default()
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn sort(keys: &[u64], memory_bytes: usize) -> (Vec<(u64, u32)>, usize) {
        let mut runs = 0;
        let mut keep = |run: &[u8]| {
            runs += 1;
            Ok(Box::new(io::Cursor::new(run.to_vec())) as Box<dyn Read>)
        };
        let mut sorter = Sorter::new(4, memory_bytes, &mut keep);
        for (key, number) in keys.iter().zip(0u32..) {
            sorter.push(*key, &number.to_le_bytes()).unwrap();
        }
        let mut sorted = Vec::new();
        let take = |key, record: &[u8]| {
            sorted.push((key, u32::from_le_bytes(record.try_into().unwrap())));
            Ok(())
        };
        sorter.finish(Path::new("a.copc.laz"), take).unwrap();
        (sorted, runs)
    }

    #[test]
    fn what_fits_is_not_kept_elsewhere() {
        assert_eq!(sort(&[3, 1, 2], 1 << 20), (vec![(1, 1), (2, 2), (3, 0)], 0));
        assert_eq!(sort(&[3, 1, 2], 0), (vec![(1, 1), (2, 2), (3, 0)], 2));
        assert_eq!(sort(&[], 0), (vec![], 0));
    }

    #[test]
    fn a_run_that_cannot_be_kept_ends_it() {
        let mut keep = |_: &[u8]| Err(Error::unusable(Path::new("b"), "the disk is full", "make room"));
        let mut sorter = Sorter::new(1, 0, &mut keep);
        sorter.push(0, &[0]).unwrap();
        assert_eq!(sorter.push(0, &[0]).unwrap_err().to_string(), "b: the disk is full; make room");
    }

    #[test]
    fn cut_off_runs_are_errors() {
        let mut keep = |run: &[u8]| Ok(Box::new(io::Cursor::new(run[..5].to_vec())) as Box<dyn Read>);
        let mut sorter = Sorter::new(1, 0, &mut keep);
        (0..3).for_each(|key| sorter.push(key, &[0]).unwrap());
        let error = sorter.finish(Path::new("a.copc.laz"), |_, _| Ok(())).unwrap_err().to_string();
        assert_eq!(error, "a.copc.laz: cannot read the points sorted before: failed to fill whole buffer");
    }

    proptest! {
        #[test]
        fn runs_do_not_show(keys in prop::collection::vec(0u64..20, 0..200), memory in 0usize..4000) {
            let mut expected: Vec<(u64, u32)> = keys.iter().copied().zip(0..).collect();
            expected.sort();
            prop_assert_eq!(sort(&keys, memory).0, expected);
        }
    }
}
