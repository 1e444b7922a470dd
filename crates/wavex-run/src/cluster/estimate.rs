//! Cores, memory and time of a task, estimated from the sizes of its files.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Memory besides the scan lines in the pipeline, MB: program, threads, buffers of writers.
const BASE_MEMORY_MB: u64 = 500;
/// Memory of a shared file such as a trajectory per byte of the file.
const SHARED_BYTES_FACTOR: u64 = 3;
/// Memory of a strip in the reports of a survey page, MB.
const SURVEY_PAGE_MB_PER_STRIP: u64 = 1;
/// Memory of the rasters of a survey page per byte of the inputs, at one shot in 2 m²; fewer with more shots.
const RASTER_BYTES_FACTOR: f64 = 0.5;
/// Memory of an alignment with the most patches, MB; each strip beyond may add 1 MB.
const MOST_PATCHES_MB: u64 = 1500;
/// Factor on the expected time, for slow machines and disks.
const TIME_MARGIN: f64 = 2.0;

/// Estimated resources of a task.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
pub struct Estimate {
    /// Number of cores.
    pub cores: usize,
    /// Memory, MB.
    pub memory_mb: u64,
    /// Time, minutes.
    pub minutes: u64,
}

/// What tasks are estimated by.
#[derive(Clone, Copy, Debug)]
pub(super) struct Estimator {
    /// Number of cores per task.
    pub cores: usize,
    /// Throughput of one core, MB of input per second.
    pub mb_per_s: f64,
    /// Memory limit of the scan lines in the pipeline, MB.
    pub line_memory_mb: u64,
    /// Size of the files that all tasks read, bytes.
    pub shared_bytes: u64,
}

impl Estimator {
    /// Memory of the files that all tasks read, MB.
    fn shared_mb(&self) -> u64 {
        self.shared_bytes.saturating_mul(SHARED_BYTES_FACTOR).div_ceil(1_000_000)
    }

    /// Resources of a task with this much input.
    pub(super) fn task(&self, bytes: u64) -> Estimate {
        let memory_mb = self.line_memory_mb.saturating_add(BASE_MEMORY_MB).saturating_add(self.shared_mb());
        let seconds = bytes as f64 / 1e6 / self.mb_per_s / self.cores as f64;
        let minutes = 1 + (TIME_MARGIN * seconds / 60.0).ceil() as u64;
        Estimate { cores: self.cores, memory_mb, minutes }
    }

    /// Resources of the task that calibrates from this many inputs.
    pub(super) fn calibration(&self, inputs: usize) -> Estimate {
        Estimate { minutes: 10 + inputs as u64 / 20, ..self.task(0) }
    }

    /// Resources of the task that collects the results of this many tasks.
    ///
    /// An alignment holds patches of all tasks, up to a limit, and the trajectories. A survey page of inputs of
    /// `survey_page_bytes` holds the rasters of all strips.
    pub(super) fn collect(&self, tasks: usize, aligns: bool, survey_page_bytes: Option<u64>) -> Estimate {
        let tasks = tasks as u64;
        let page_mb = survey_page_bytes.map_or(0, |bytes| {
            SURVEY_PAGE_MB_PER_STRIP * tasks + (RASTER_BYTES_FACTOR * bytes as f64 / 1e6).ceil() as u64
        });
        let memory_mb = 500 + tasks / 2 + page_mb;
        let collects = Estimate { cores: 1, memory_mb, minutes: 5 + tasks / 500 };
        if !aligns {
            return collects;
        }
        let patches_mb = (20 * tasks).min(MOST_PATCHES_MB + tasks);
        let memory_mb = collects.memory_mb.saturating_add(patches_mb).saturating_add(self.shared_mb());
        Estimate { memory_mb, minutes: collects.minutes + 5 + tasks / 20, ..collects }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn resources_grow_with_the_files() {
        let estimator = Estimator { cores: 4, mb_per_s: 2.0, line_memory_mb: 1024, shared_bytes: 0 };
        let small = Estimate { cores: 4, memory_mb: 1524, minutes: 1 };
        assert_eq!(estimator.task(0), small);
        // 4.8 GB by 4 cores of 2 MB/s: 10 min, twice as long with the margin.
        assert_eq!(estimator.task(4_800_000_000), Estimate { minutes: 21, ..small });
        let with_trajectory = Estimator { shared_bytes: 100_000_000, ..estimator };
        assert_eq!(with_trajectory.task(0), Estimate { memory_mb: 1824, ..small });
        let collected = Estimate { cores: 1, memory_mb: 5500, minutes: 25 };
        assert_eq!(with_trajectory.collect(10_000, false, None), collected);
        let aligned = Estimate { memory_mb: 17_300, minutes: 530, ..collected };
        assert_eq!(with_trajectory.collect(10_000, true, None), aligned);
        assert_eq!(estimator.collect(12, true, None).memory_mb, 500 + 6 + 240);
        let page = estimator.collect(300, false, Some(3_600_000_000));
        assert_eq!(page.memory_mb, 500 + 150 + 300 + 1800);
    }
}
