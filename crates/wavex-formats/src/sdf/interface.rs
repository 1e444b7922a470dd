//! Declarations of RIEGL's `fwifc` interface, with all its `unsafe` code.
//!
//! Types and argument order follow RIEGL's public interface description. Names that the linker does
//! not need are our own.

mod block;

use std::ffi::{CStr, c_char, c_void};
use std::mem::ManuallyDrop;
use std::path::Path;
use std::sync::{Mutex, MutexGuard};

use libloading::Library;

use super::fault::{CallResult, LibraryFault, code};
use super::{MAX_TABLE, SdfInfo, SdfRecord};
use block::{RawBlock, check_array, check_block, copy_block};

/// `fwifc_file`, an opaque handle.
type RawFile = *mut c_void;
/// `fwifc_csz`.
type RawText = *const c_char;

type GetLibraryVersion = unsafe extern "C" fn(*mut u16, *mut u16, *mut RawText, *mut RawText) -> i32;
type GetLastError = unsafe extern "C" fn(*mut RawText) -> i32;
type OpenFile = unsafe extern "C" fn(RawText, *mut RawFile) -> i32;
type OnFile = unsafe extern "C" fn(RawFile) -> i32;
type SetRelative = unsafe extern "C" fn(RawFile, i32) -> i32;
type GetInfo = unsafe extern "C" fn(
    RawFile,
    *mut RawText,
    *mut RawText,
    *mut RawText,
    *mut f64,
    *mut f64,
    *mut u16,
    *mut u16,
) -> i32;
type GetCalib = unsafe extern "C" fn(RawFile, u16, *mut u32, *mut *const f64, *mut *const f64) -> i32;
type ReadRecord = unsafe extern "C" fn(
    RawFile,
    *mut f64,
    *mut f64,
    *mut f64,
    *mut f64,
    *mut u16,
    *mut u16,
    *mut u32,
    *mut u32,
    *mut *const RawBlock,
) -> i32;
type Seek = unsafe extern "C" fn(RawFile, u32) -> i32;
type Tell = unsafe extern "C" fn(RawFile, *mut u32) -> i32;
type SeekTime = unsafe extern "C" fn(RawFile, f64) -> i32;

/// The thirteen functions of a library.
///
/// The library stays loaded until the process ends.
#[derive(Clone, Copy)]
pub(super) struct Functions {
    get_library_version: GetLibraryVersion,
    get_last_error: GetLastError,
    open: OpenFile,
    close: OnFile,
    reindex: OnFile,
    set_sosbl_relative: SetRelative,
    get_info: GetInfo,
    get_calib: GetCalib,
    read: ReadRecord,
    seek: Seek,
    tell: Tell,
    seek_time: SeekTime,
    seek_time_external: SeekTime,
}

/// Version of a library (`fwifc_get_library_version`).
#[derive(Clone, Debug, PartialEq)]
pub struct LibraryVersion {
    /// Major version; a different one is a different interface.
    pub major: u16,
    /// Minor version; newer ones only extend the interface.
    pub minor: u16,
    /// Build name given by the library.
    pub build: String,
}

/// Lock held from a call until its results are copied.
///
/// One lock serves all libraries: repeated `dlopen` of the same file yields the same variables.
static ONE_CALLER: Mutex<()> = Mutex::new(());

fn alone() -> MutexGuard<'static, ()> {
    // A panic cannot leave inconsistent data: the lock guards the library, not a Rust value.
    ONE_CALLER.lock().unwrap_or_else(|poisoned| poisoned.into_inner())
}

impl Functions {
    /// Loads a library; the system searches for a bare name.
    pub(super) fn load(path: &Path) -> Result<Functions, libloading::Error> {
        let _alone = alone();
        // SAFETY: loading runs the library's initialisers. The user vouches for the library they
        // name, as for any program they install.
        let library = unsafe { Library::new(path) }?;
        // Never unloaded: its threads and exit handlers may still run, and the function pointers
        // must stay valid.
        let library = ManuallyDrop::new(library);
        // SAFETY: each type is the interface's type for that name, and the library stays loaded.
        unsafe {
            Ok(Functions {
                get_library_version: function(&library, c"fwifc_get_library_version")?,
                get_last_error: function(&library, c"fwifc_get_last_error")?,
                open: function(&library, c"fwifc_open")?,
                close: function(&library, c"fwifc_close")?,
                reindex: function(&library, c"fwifc_reindex")?,
                set_sosbl_relative: function(&library, c"fwifc_set_sosbl_relative")?,
                get_info: function(&library, c"fwifc_get_info")?,
                get_calib: function(&library, c"fwifc_get_calib")?,
                read: function(&library, c"fwifc_read")?,
                seek: function(&library, c"fwifc_seek")?,
                tell: function(&library, c"fwifc_tell")?,
                seek_time: function(&library, c"fwifc_seek_time")?,
                seek_time_external: function(&library, c"fwifc_seek_time_external")?,
            })
        }
    }

    /// Returns the version of the library; needs no file.
    pub(super) fn version(&self) -> CallResult<LibraryVersion> {
        const NAME: &str = "fwifc_get_library_version";
        let alone = alone();
        let (mut major, mut minor) = (0, 0);
        let (mut build, mut tag): (RawText, RawText) = (std::ptr::null(), std::ptr::null());
        // SAFETY: all four output pointers are valid.
        let code = unsafe { (self.get_library_version)(&mut major, &mut minor, &mut build, &mut tag) };
        self.check(NAME, code, &alone)?;
        // SAFETY: the library has set both texts, the lock is held, and no other call was made.
        let build = unsafe { [text(build), text(tag)] };
        Ok(LibraryVersion { major, minor, build: build.join(" ").trim().to_owned() })
    }

    /// Opens a file.
    pub(super) fn open(&self, path: &CStr) -> CallResult<Handle> {
        const NAME: &str = "fwifc_open";
        let alone = alone();
        let mut file = std::ptr::null_mut();
        // SAFETY: the path is a C string and the output pointer is valid.
        let code = unsafe { (self.open)(path.as_ptr(), &mut file) };
        self.check(NAME, code, &alone)?;
        match file.is_null() {
            false => Ok(Handle { functions: *self, file }),
            true => Err(LibraryFault::nonsense(NAME, "neither a file nor an error")),
        }
    }

    /// Returns an error unless `code` is 0.
    ///
    /// The lock is still held since the call, because the library's error message belongs to it.
    fn check(&self, function: &'static str, code: i32, _alone: &MutexGuard<'static, ()>) -> CallResult<()> {
        if code == code::DONE {
            return Ok(());
        }
        let mut words: RawText = std::ptr::null();
        // SAFETY: the output pointer is valid; the text is copied before the next call.
        let words = unsafe {
            match (self.get_last_error)(&mut words) {
                code::DONE => text(words),
                _ => String::new(),
            }
        };
        Err(LibraryFault::Refused { function, code, words })
    }
}

/// Looks up a function of the library.
///
/// # Safety
/// `T` must be the type of the function, and the library must stay loaded while it is called.
unsafe fn function<T: Copy>(library: &Library, name: &CStr) -> Result<T, libloading::Error> {
    // SAFETY: guaranteed by the caller.
    unsafe { library.get::<T>(name.to_bytes_with_nul()).map(|symbol| *symbol) }
}

/// Longest text read from the library, bytes.
const MAX_TEXT: usize = 1 << 12;

/// Copies a text of the library.
///
/// Empty for a null pointer.
///
/// # Safety
/// `from` is null or points to a C string, and no other thread calls the library meanwhile.
unsafe fn text(from: RawText) -> String {
    if from.is_null() {
        return String::new();
    }
    let from = from.cast::<u8>();
    // SAFETY: bytes are read one by one, none beyond the terminating 0.
    let bytes = (0..MAX_TEXT).map(|at| unsafe { from.add(at).read() });
    let bytes: Vec<u8> = bytes.take_while(|byte| *byte != 0).collect();
    String::from_utf8_lossy(&bytes).into_owned()
}

/// Open file; closed when dropped.
pub(super) struct Handle {
    functions: Functions,
    file: RawFile,
}

// SAFETY: every call holds the process-wide lock of `alone`, whatever its thread, and a handle is no
// reference to data of a thread: the library's interface passes it as a plain pointer.
unsafe impl Send for Handle {}

impl Drop for Handle {
    fn drop(&mut self) {
        let _alone = alone();
        // SAFETY: the file was opened by this library and is closed once. A failure cannot be
        // handled here.
        unsafe { (self.functions.close)(self.file) };
    }
}

impl Handle {
    /// Rebuilds the index next to the data.
    ///
    /// Reads the whole file.
    pub(super) fn reindex(&mut self) -> CallResult<()> {
        let alone = alone();
        // SAFETY: the file is open.
        let code = unsafe { (self.functions.reindex)(self.file) };
        self.functions.check("fwifc_reindex", code, &alone)
    }

    /// Makes block times relative to the time of their record.
    pub(super) fn set_relative(&mut self) -> CallResult<()> {
        let alone = alone();
        // SAFETY: the file is open.
        let code = unsafe { (self.functions.set_sosbl_relative)(self.file, 1) };
        self.functions.check("fwifc_set_sosbl_relative", code, &alone)
    }

    /// Returns the metadata of the file.
    pub(super) fn info(&mut self) -> CallResult<SdfInfo> {
        let alone = alone();
        let (mut instrument, mut serial, mut epoch): (RawText, RawText, RawText) =
            (std::ptr::null(), std::ptr::null(), std::ptr::null());
        let (mut group_velocity_mps, mut sampling_interval_s) = (f64::NAN, f64::NAN);
        let (mut flags, mut facets) = (0, 0);
        // SAFETY: the file is open, and all seven output pointers are valid.
        let code = unsafe {
            (self.functions.get_info)(
                self.file,
                &mut instrument,
                &mut serial,
                &mut epoch,
                &mut group_velocity_mps,
                &mut sampling_interval_s,
                &mut flags,
                &mut facets,
            )
        };
        self.functions.check("fwifc_get_info", code, &alone)?;
        // SAFETY: the library has set all three texts, the lock is held, and no other call was
        // made.
        let (instrument, serial, epoch) = unsafe { (text(instrument), text(serial), text(epoch)) };
        Ok(SdfInfo { instrument, serial, epoch, group_velocity_mps, sampling_interval_s, flags, facets })
    }

    /// Returns a calibration table.
    ///
    /// Amplitude of channels 0 and 1 (kinds 0, 1), range of channels 0 and 1 (kinds 2, 3).
    pub(super) fn table(&mut self, kind: u16) -> CallResult<Vec<(f64, f64)>> {
        const NAME: &str = "fwifc_get_calib";
        let alone = alone();
        let mut count = 0;
        let (mut abscissa, mut ordinate): (*const f64, *const f64) = (std::ptr::null(), std::ptr::null());
        // SAFETY: the file is open, and all three output pointers are valid.
        let code =
            unsafe { (self.functions.get_calib)(self.file, kind, &mut count, &mut abscissa, &mut ordinate) };
        self.functions.check(NAME, code, &alone)?;
        if count > MAX_TABLE {
            return Err(LibraryFault::nonsense(NAME, format!("a table of {count} entries")));
        }
        if count > 0 && (abscissa.is_null() || ordinate.is_null()) {
            return Err(LibraryFault::nonsense(NAME, "a null pointer to a table"));
        }
        // SAFETY: the library states that both arrays have `count` numbers, and the lock is held.
        // They may be unaligned.
        let pair =
            |at: usize| unsafe { (abscissa.add(at).read_unaligned(), ordinate.add(at).read_unaligned()) };
        Ok((0..count as usize).map(pair).collect())
    }

    /// Copies the next record; fails with [`code::END_OF_FILE`] after the last.
    pub(super) fn read(&mut self, record: &mut SdfRecord) -> CallResult<()> {
        const NAME: &str = "fwifc_read";
        record.clear();
        let alone = alone();
        let (mut count, mut stride) = (0, 0);
        let mut blocks: *const RawBlock = std::ptr::null();
        // SAFETY: the file is open, and all nine output pointers are valid, two of them for three
        // numbers.
        let code = unsafe {
            (self.functions.read)(
                self.file,
                &mut record.time_s,
                &mut record.time_external_s,
                record.origin_m.as_mut_ptr(),
                record.direction.as_mut_ptr(),
                &mut record.flags,
                &mut record.facet,
                &mut count,
                &mut stride,
                &mut blocks,
            )
        };
        self.functions.check(NAME, code, &alone)?;
        check_array(count, stride, blocks).map_err(|problem| LibraryFault::nonsense(NAME, problem))?;
        for index in 0..count as usize {
            // SAFETY: the library states that there are `count` blocks, `stride` bytes apart, each
            // at least as large as `RawBlock`. They may be unaligned.
            let block = unsafe {
                blocks.cast::<u8>().add(index * stride as usize).cast::<RawBlock>().read_unaligned()
            };
            check_block(&block, record.n_samples())
                .map_err(|problem| LibraryFault::nonsense(NAME, problem))?;
            // SAFETY: `check_block` ensures that the pointer is not null and the count within the
            // limit, and the lock is still held.
            unsafe { copy_block(&block, record) };
        }
        Ok(())
    }

    /// Seeks to a record; records count from 1.
    pub(super) fn seek(&mut self, record: u32) -> CallResult<()> {
        let alone = alone();
        // SAFETY: the file is open.
        let code = unsafe { (self.functions.seek)(self.file, record) };
        self.functions.check("fwifc_seek", code, &alone)
    }

    /// Returns the number of the next record, from 1.
    pub(super) fn tell(&mut self) -> CallResult<u32> {
        let alone = alone();
        let mut record = 0;
        // SAFETY: the file is open, and the output pointer is valid.
        let code = unsafe { (self.functions.tell)(self.file, &mut record) };
        self.functions.check("fwifc_tell", code, &alone)?;
        Ok(record)
    }

    /// Seeks to a time of the instrument's clock, s.
    pub(super) fn seek_time(&mut self, time_s: f64) -> CallResult<()> {
        let alone = alone();
        // SAFETY: the file is open.
        let code = unsafe { (self.functions.seek_time)(self.file, time_s) };
        self.functions.check("fwifc_seek_time", code, &alone)
    }

    /// Seeks to an external time, s.
    pub(super) fn seek_time_external(&mut self, time_s: f64) -> CallResult<()> {
        let alone = alone();
        // SAFETY: the file is open.
        let code = unsafe { (self.functions.seek_time_external)(self.file, time_s) };
        self.functions.check("fwifc_seek_time_external", code, &alone)
    }
}

#[cfg(test)]
mod tests;
