//! CPU time of a thread.

/// Returns the CPU time of this thread, s, with an arbitrary origin.
///
/// Wall-clock time if the system has no thread clock. CPU time excludes waiting on a busy machine.
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
