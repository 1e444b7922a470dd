//! Calls to the operating system that the standard library lacks, and locks.
//!
//! On other systems than Unix the calls do nothing.

use std::sync::PoisonError;

/// Access to a mutex that another thread may have poisoned.
pub trait Unpoisoned<T> {
    /// Returns the guard or value, whether or not a holder has panicked.
    ///
    /// For data that are valid between any two statements; the panic itself ends the run elsewhere.
    fn unpoisoned(self) -> T;
}

impl<T> Unpoisoned<T> for Result<T, PoisonError<T>> {
    fn unpoisoned(self) -> T {
        self.unwrap_or_else(PoisonError::into_inner)
    }
}

/// Lets writes beyond the limit of file sizes (`ulimit -f`) fail, instead of ending the process.
pub fn ignore_file_size_signal() {
    #[cfg(unix)]
    // SAFETY: ignoring a signal installs no handler, so no code runs in its context.
    unsafe {
        libc::signal(libc::SIGXFSZ, libc::SIG_IGN);
    }
}

#[cfg(unix)]
pub mod pipe {
    //! A pipe whose reader can be told to stop.

    use std::fs::File;
    use std::io::{self, Read};
    use std::os::fd::{AsRawFd, OwnedFd};
    use std::os::unix::fs::OpenOptionsExt;
    use std::path::Path;
    use std::sync::Arc;
    use std::sync::atomic::{AtomicBool, Ordering};

    /// Time between two looks at whether to stop, ms.
    const LOOK_EVERY_MS: i32 = 100;

    /// Reads a pipe until its end, or until `cancelled` is set.
    pub struct Pipe {
        file: File,
        cancelled: Arc<AtomicBool>,
    }

    impl Pipe {
        /// Opens a named pipe; does not wait for a writer.
        ///
        /// # Errors
        /// If the system refuses.
        pub fn open(path: &Path, cancelled: Arc<AtomicBool>) -> io::Result<Pipe> {
            let file = File::options().read(true).custom_flags(libc::O_NONBLOCK).open(path)?;
            Ok(Pipe { file, cancelled })
        }

        /// Reads standard input.
        ///
        /// # Errors
        /// If the system refuses.
        pub fn standard_input(cancelled: Arc<AtomicBool>) -> io::Result<Pipe> {
            let input: OwnedFd = std::os::fd::AsFd::as_fd(&io::stdin()).try_clone_to_owned()?;
            Ok(Pipe { file: File::from(input), cancelled })
        }

        /// Waits until there are bytes or an end; false if nothing came.
        fn is_ready(&self) -> io::Result<bool> {
            let mut wanted = libc::pollfd { fd: self.file.as_raw_fd(), events: libc::POLLIN, revents: 0 };
            // SAFETY: the pointer is to one `pollfd`, as the count says, which lives until the call returns.
            let ready = unsafe { libc::poll(&raw mut wanted, 1, LOOK_EVERY_MS) };
            match ready {
                0 => Ok(false),
                1.. => Ok(true),
                _ => match io::Error::last_os_error() {
                    error if error.kind() == io::ErrorKind::Interrupted => Ok(false),
                    error => Err(error),
                },
            }
        }
    }

    impl Read for Pipe {
        fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
            while !self.is_ready()? {
                if self.cancelled.load(Ordering::Relaxed) {
                    return Err(io::Error::other("the run was interrupted"));
                }
            }
            self.file.read(bytes)
        }
    }

    #[cfg(test)]
    mod tests {
        use super::*;
        use std::io::Write;
        use std::process::Command;

        #[test]
        fn pipes_are_read_to_their_end_or_cancellation() {
            let folder = tempfile::tempdir().unwrap();
            let path = folder.path().join("pipe");
            assert!(Command::new("mkfifo").arg(&path).status().unwrap().success());
            let cancelled = Arc::<AtomicBool>::default();
            let mut pipe = Pipe::open(&path, Arc::clone(&cancelled)).unwrap();
            let mut writer = File::options().write(true).open(&path).unwrap();
            writer.write_all(b"abc").unwrap();
            let mut bytes = [0; 3];
            pipe.read_exact(&mut bytes).unwrap();
            assert_eq!(&bytes, b"abc");
            cancelled.store(true, Ordering::Relaxed);
            assert_eq!(pipe.read(&mut bytes).unwrap_err().to_string(), "the run was interrupted");
            drop(writer);
            assert_eq!(pipe.read(&mut bytes).unwrap(), 0);
        }
    }
}
