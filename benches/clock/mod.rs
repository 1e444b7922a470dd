//! What time a bench counts.

/// Seconds of CPU time of this thread since some moment; of wall-clock time where the system does not tell. On a busy
/// machine a thread waits the rest of the time.
pub fn cpu_s() -> f64 {
    #[cfg(unix)]
    {
        let time = rustix::time::clock_gettime(rustix::time::ClockId::ThreadCPUTime);
        time.tv_sec as f64 + 1e-9 * time.tv_nsec as f64
    }
    #[cfg(not(unix))]
    {
        static STARTED: std::sync::LazyLock<std::time::Instant> =
            std::sync::LazyLock::new(std::time::Instant::now);
        STARTED.elapsed().as_secs_f64()
    }
}
