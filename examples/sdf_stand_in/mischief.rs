//! Faults injected into the stand-in, one per line in `NAME.sdf.txt`.
//!
//! Records count from 1.
//!
//! | line | effect |
//! |---|---|
//! | `fail FUNCTION CODE [N]` | the function fails; with `N`, only at that record or for that kind of table |
//! | `end_after N` | the file ends after record `N` |
//! | `nan N` | record `N` has vectors of NaN |
//! | `stride BYTES` | distance between blocks |
//! | `samples N COUNT`, `blocks N COUNT`, `table COUNT` | a false count |
//! | `null N` | the sample pointers of record `N` are null |
//! | `index hidden` | seeking fails with 3 until the index is built; with `index needed`, so does reading |
//! | `read_only FOLDER` | no index can be written to the folder |
//! | `slow_us TIME` | duration of every call |
//! | `epoch TEXT`, `v_group MPS`, `sampling_time S`, `unsynchronised` | different metadata |

use std::path::{Path, PathBuf};

#[derive(Clone, Debug, Default)]
pub(crate) struct Mischief {
    fail: Vec<(String, i32, Option<u32>)>,
    pub(crate) end_after: Option<u32>,
    nan: Vec<u32>,
    pub(crate) stride: Option<usize>,
    samples: Vec<(u32, u32)>,
    blocks: Vec<(u32, u32)>,
    pub(crate) table: Option<u32>,
    null: Vec<u32>,
    pub(crate) hides_index: bool,
    pub(crate) needs_index: bool,
    pub(crate) read_only: Option<PathBuf>,
    pub(crate) slow_us: u64,
    pub(crate) epoch: Option<String>,
    pub(crate) v_group: Option<f64>,
    pub(crate) sampling_time: Option<f64>,
    pub(crate) unsynchronised: bool,
}

impl Mischief {
    /// Reads the faults from the file next to the data or to the target of a link.
    ///
    /// `None` if a line is invalid.
    pub(crate) fn beside(data: &Path) -> Option<Mischief> {
        let target = data.canonicalize().unwrap_or_else(|_| data.to_path_buf());
        let mut file = target.into_os_string();
        file.push(".txt");
        let text = std::fs::read_to_string(file).unwrap_or_default();
        let mut mischief = Mischief::default();
        text.lines().try_for_each(|line| mischief.add(line))?;
        Some(mischief)
    }

    fn add(&mut self, line: &str) -> Option<()> {
        let (word, rest) = line.split_once(' ').unwrap_or((line, ""));
        let mut numbers = rest.split(' ').map(|number| number.parse::<u32>().ok());
        let mut number = || numbers.next().flatten();
        match word {
            "fail" => {
                let mut words = rest.split(' ');
                let (function, code) = (words.next()?.to_owned(), words.next()?.parse().ok()?);
                self.fail.push((function, code, words.next().and_then(|at| at.parse().ok())));
            }
            "end_after" => self.end_after = Some(number()?),
            "nan" => self.nan.push(number()?),
            "stride" => self.stride = Some(number()? as usize),
            "samples" => self.samples.push((number()?, number()?)),
            "blocks" => self.blocks.push((number()?, number()?)),
            "table" => self.table = Some(number()?),
            "null" => self.null.push(number()?),
            "index" => {
                self.hides_index = true;
                self.needs_index = rest == "needed";
            }
            "read_only" => self.read_only = Some(rest.into()),
            "slow_us" => self.slow_us = u64::from(number()?),
            "epoch" => self.epoch = Some(rest.to_owned()),
            "v_group" => self.v_group = Some(rest.parse().ok()?),
            "sampling_time" => self.sampling_time = Some(rest.parse().ok()?),
            "unsynchronised" => self.unsynchronised = true,
            _ => return None,
        }
        Some(())
    }

    /// Returns the injected return code of a function.
    ///
    /// `at` is a record or a kind of table.
    pub(crate) fn code(&self, function: &str, at: Option<u32>) -> Option<i32> {
        let is_meant = |(name, _, place): &&(String, i32, Option<u32>)| {
            name == function && (place.is_none() || *place == at)
        };
        self.fail.iter().find(is_meant).map(|(_, code, _)| *code)
    }

    pub(crate) fn is_nan(&self, record: u32) -> bool {
        self.nan.contains(&record)
    }

    pub(crate) fn is_null(&self, record: u32) -> bool {
        self.null.contains(&record)
    }

    /// Returns the false counts of a record.
    ///
    /// Blocks, and samples per block.
    pub(crate) fn claims(&self, record: u32) -> (Option<u32>, Option<u32>) {
        let of = |claims: &[(u32, u32)]| claims.iter().find(|claim| claim.0 == record).map(|claim| claim.1);
        (of(&self.blocks), of(&self.samples))
    }
}
