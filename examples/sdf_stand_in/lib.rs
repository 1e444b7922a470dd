//! Stand-in for RIEGL's Waveform Extraction Library, for testing `read_sdf`.
//!
//! It implements the thirteen functions of the interface on any waveform container (`.arrow`)
//! renamed to `.sdf`. It cannot read SDF.
//!
//! It is as strict as the interface allows: the memory of its pointers is overwritten at the
//! next call, and a concurrent call from a second thread fails. A file `NAME.sdf.txt` next to the
//! data injects faults, one per line (see `mischief.rs`). The environment variable
//! `SDF_STAND_IN_MAJOR` changes its version.
//!
//! Data without a counterpart in the interface are not served: nominal pulse rate, zones, scan
//! angles, scan direction, returns of the instrument itself, the frame and its scale, and sampling
//! intervals of single blocks.
#![allow(clippy::missing_safety_doc, reason = "the contract of each function is that of RIEGL's interface")]
#![allow(clippy::too_many_arguments, reason = "RIEGL's interface has so many")]

mod mischief;
mod recording;

use std::ffi::{CStr, CString, c_char, c_void};
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{LazyLock, Mutex, MutexGuard};
use std::time::Duration;

use mischief::Mischief;
use recording::{Record, Recording};
use wavex_formats::container::TimeScale;

const END_OF_FILE: i32 = -1;
const DONE: i32 = 0;
const BAD_ARGUMENT: i32 = 1;
const UNSUPPORTED_FORMAT: i32 = 2;
const MISSING_INDEX: i32 = 3;
const RUNTIME: i32 = 6;

/// `fwifc_sbl_t`.
#[repr(C)]
#[derive(Clone, Copy)]
struct Block {
    time_sosbl: f64,
    channel: u32,
    sample_count: u32,
    sample_size: u32,
    sample: *const u16,
}

/// Open file, the target of a handle.
struct File {
    path: PathBuf,
    recording: Recording,
    mischief: Mischief,
    is_relative: bool,
}

/// Memory of the pointers returned to the caller.
#[derive(Default)]
struct Shared {
    error: CString,
    texts: [CString; 3],
    blocks: Vec<u8>,
    samples: Vec<u16>,
    abscissa: Vec<f64>,
    ordinate: Vec<f64>,
}

static SHARED: LazyLock<Mutex<Shared>> = LazyLock::new(Mutex::default);
static BUSY: AtomicBool = AtomicBool::new(false);

/// Guard of a running call.
struct Call {
    shared: MutexGuard<'static, Shared>,
}

impl Call {
    /// Begins a call and invalidates all earlier pointers.
    ///
    /// `None` during another call.
    fn begin() -> Option<Call> {
        if BUSY.swap(true, Ordering::AcqRel) {
            return None;
        }
        let mut shared = SHARED.lock().unwrap_or_else(|poisoned| poisoned.into_inner());
        shared.blocks.fill(0xee);
        shared.samples.fill(0xeeee);
        shared.abscissa.fill(f64::NAN);
        shared.ordinate.fill(f64::NAN);
        Some(Call { shared })
    }

    fn fail(&mut self, code: i32, words: &str) -> i32 {
        self.shared.error = CString::new(words).unwrap_or_default();
        code
    }

    /// Stores a text and returns a pointer to it.
    fn keep(&mut self, place: usize, text: &str) -> *const c_char {
        self.shared.texts[place] = CString::new(text).unwrap_or_default();
        self.shared.texts[place].as_ptr()
    }
}

impl Drop for Call {
    fn drop(&mut self) {
        BUSY.store(false, Ordering::Release);
    }
}

/// Runs a function on an open file, unless it should fail.
///
/// `at` is a kind of table; otherwise the next record is meant.
unsafe fn on_file(
    name: &str,
    file: *mut c_void,
    at: Option<u32>,
    run: impl FnOnce(&mut File, &mut Call) -> i32,
) -> i32 {
    let Some(mut call) = Call::begin() else { return RUNTIME };
    // SAFETY: a handle is a pointer created by `fwifc_open`, and `BUSY` prevents concurrent access.
    let Some(file) = (unsafe { file.cast::<File>().as_mut() }) else {
        return call.fail(BAD_ARGUMENT, "no file");
    };
    std::thread::sleep(Duration::from_micros(file.mischief.slow_us));
    match file.mischief.code(name, Some(at.unwrap_or(file.recording.tell()))) {
        Some(code) => call.fail(code, "injected failure"),
        None => run(file, &mut call),
    }
}

impl File {
    fn index(&self) -> PathBuf {
        let mut index = self.path.clone().into_os_string();
        index.push(".idx");
        index.into()
    }

    fn lacks_index(&self) -> bool {
        self.mischief.hides_index && !self.index().exists()
    }
}

/// Runs a function that needs the index.
unsafe fn navigate(
    name: &str,
    file: *mut c_void,
    go: impl FnOnce(&mut Recording) -> wavex_formats::Result<bool>,
) -> i32 {
    let run = |file: &mut File, call: &mut Call| {
        if file.lacks_index() {
            return call.fail(MISSING_INDEX, "the index is missing");
        }
        match go(&mut file.recording) {
            Ok(true) => DONE,
            Ok(false) => END_OF_FILE,
            Err(error) => call.fail(RUNTIME, &error.to_string()),
        }
    };
    // SAFETY: the handle comes from the caller.
    unsafe { on_file(name, file, None, run) }
}

/// `fwifc_get_library_version`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fwifc_get_library_version(
    major: *mut u16,
    minor: *mut u16,
    build_version: *mut *const c_char,
    build_tag: *mut *const c_char,
) -> i32 {
    let Some(mut call) = Call::begin() else { return RUNTIME };
    let said = std::env::var("SDF_STAND_IN_MAJOR").ok().and_then(|major| major.parse().ok());
    // SAFETY: the interface requires four valid output pointers.
    unsafe {
        major.write(said.unwrap_or(1));
        minor.write(7);
        build_version.write(call.keep(0, "1.7"));
        build_tag.write(call.keep(1, "stand-in"));
    }
    DONE
}

/// `fwifc_get_last_error`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fwifc_get_last_error(message: *mut *const c_char) -> i32 {
    let Some(call) = Call::begin() else { return RUNTIME };
    // SAFETY: the interface requires a valid output pointer.
    unsafe { message.write(call.shared.error.as_ptr()) };
    DONE
}

/// `fwifc_open`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fwifc_open(path: *const c_char, file: *mut *mut c_void) -> i32 {
    let Some(mut call) = Call::begin() else { return RUNTIME };
    // SAFETY: the interface requires a C string.
    let Ok(path) = (unsafe { CStr::from_ptr(path) }).to_str().map(PathBuf::from) else {
        return call.fail(BAD_ARGUMENT, "the path is not UTF-8");
    };
    let Some(mischief) = Mischief::beside(&path) else {
        return call.fail(BAD_ARGUMENT, "unknown fault in the .txt file");
    };
    if let Some(code) = mischief.code("fwifc_open", None) {
        return call.fail(code, "injected failure");
    }
    match Recording::open(&path) {
        Ok(recording) => {
            let opened = Box::new(File { path, recording, mischief, is_relative: false });
            // SAFETY: the interface requires a valid output pointer.
            unsafe { file.write(Box::into_raw(opened).cast()) };
            DONE
        }
        Err(error) => call.fail(UNSUPPORTED_FORMAT, &error.to_string()),
    }
}

/// `fwifc_close`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fwifc_close(file: *mut c_void) -> i32 {
    let Some(_call) = Call::begin() else { return RUNTIME };
    if !file.is_null() {
        // SAFETY: a handle is a pointer created by `fwifc_open`, and is closed once.
        drop(unsafe { Box::from_raw(file.cast::<File>()) });
    }
    DONE
}

/// `fwifc_reindex`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fwifc_reindex(file: *mut c_void) -> i32 {
    let run = |file: &mut File, call: &mut Call| {
        if file.mischief.read_only.as_deref() == file.path.parent() {
            return call.fail(RUNTIME, "the index cannot be written");
        }
        match std::fs::write(file.index(), "the index of the stand-in") {
            Ok(()) => DONE,
            Err(error) => call.fail(RUNTIME, &error.to_string()),
        }
    };
    // SAFETY: the handle comes from the caller.
    unsafe { on_file("fwifc_reindex", file, None, run) }
}

/// `fwifc_set_sosbl_relative`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fwifc_set_sosbl_relative(file: *mut c_void, value: i32) -> i32 {
    let run = |file: &mut File, _: &mut Call| {
        file.is_relative = value == 1;
        DONE
    };
    // SAFETY: the handle comes from the caller.
    unsafe { on_file("fwifc_set_sosbl_relative", file, None, run) }
}

/// Returns the epoch in the interface's notation.
///
/// Adjusted seconds have a known epoch.
fn epoch(file: &File) -> String {
    let scale = match file.recording.header().time_scale {
        TimeScale::Week => "WEEKSEC",
        TimeScale::Day => "DAYSEC",
        TimeScale::Adjusted => "2011-09-14T01:46:40",
        TimeScale::Unknown => "UNKNOWN",
    };
    file.mischief.epoch.clone().unwrap_or_else(|| scale.to_owned())
}

/// `fwifc_get_info`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fwifc_get_info(
    file: *mut c_void,
    instrument: *mut *const c_char,
    serial: *mut *const c_char,
    epoch_text: *mut *const c_char,
    v_group: *mut f64,
    sampling_time: *mut f64,
    flags: *mut u16,
    num_facets: *mut u16,
) -> i32 {
    let run = |file: &mut File, call: &mut Call| {
        let header = file.recording.header();
        let text = |text: &Option<String>| text.clone().unwrap_or_default();
        // SAFETY: the interface requires seven valid output pointers.
        unsafe {
            instrument.write(call.keep(0, &text(&header.instrument)));
            serial.write(call.keep(1, &text(&header.serial)));
            epoch_text.write(call.keep(2, &epoch(file)));
            v_group.write(file.mischief.v_group.unwrap_or(header.group_velocity_mps));
            sampling_time.write(file.mischief.sampling_time.unwrap_or(header.sampling_interval_ns / 1e9));
            flags.write(u16::from(!file.mischief.unsynchronised));
            num_facets.write(4);
        }
        DONE
    };
    // SAFETY: the handle comes from the caller.
    unsafe { on_file("fwifc_get_info", file, None, run) }
}

/// `fwifc_get_calib`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fwifc_get_calib(
    file: *mut c_void,
    kind: u16,
    count: *mut u32,
    abscissa: *mut *const f64,
    ordinate: *mut *const f64,
) -> i32 {
    let run = |file: &mut File, call: &mut Call| {
        let header = file.recording.header();
        let table = match kind {
            0 => &header.amplitude_high,
            1 => &header.amplitude_low,
            2 => &header.range_high,
            3 => &header.range_low,
            _ => return call.fail(BAD_ARGUMENT, "no such table"),
        };
        let (x, y) = table.iter().flatten().copied().unzip();
        (call.shared.abscissa, call.shared.ordinate) = (x, y);
        let true_count = call.shared.abscissa.len() as u32;
        // SAFETY: the interface requires three valid output pointers.
        unsafe {
            count.write(file.mischief.table.unwrap_or(true_count));
            abscissa.write(call.shared.abscissa.as_ptr());
            ordinate.write(call.shared.ordinate.as_ptr());
        }
        DONE
    };
    // SAFETY: the handle comes from the caller.
    unsafe { on_file("fwifc_get_calib", file, Some(u32::from(kind)), run) }
}

/// `fwifc_read`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fwifc_read(
    file: *mut c_void,
    time_sorg: *mut f64,
    time_external: *mut f64,
    origin: *mut f64,
    direction: *mut f64,
    flags: *mut u16,
    facet: *mut u16,
    sbl_count: *mut u32,
    sbl_size: *mut u32,
    blocks: *mut *const c_void,
) -> i32 {
    let run = |file: &mut File, call: &mut Call| {
        let number = file.recording.tell();
        if file.mischief.needs_index && file.lacks_index() {
            return call.fail(MISSING_INDEX, "the index is missing");
        }
        if file.mischief.end_after.is_some_and(|last| number > last) {
            return END_OF_FILE;
        }
        let mut record = match file.recording.next() {
            Ok(Some(record)) => record,
            Ok(None) => return END_OF_FILE,
            Err(error) => return call.fail(RUNTIME, &error.to_string()),
        };
        if file.mischief.is_nan(number) {
            (record.origin, record.direction) = ([f64::NAN; 3], [f64::NAN; 3]);
        }
        let stride = serve(&record, number, file, &mut call.shared);
        let (claimed, _) = file.mischief.claims(number);
        // SAFETY: the interface requires nine valid output pointers, two of them to three numbers.
        unsafe {
            time_sorg.write(record.time_sorg);
            time_external.write(record.time_external);
            origin.cast::<[f64; 3]>().write(record.origin);
            direction.cast::<[f64; 3]>().write(record.direction);
            flags.write(record.flags);
            facet.write(record.facet);
            sbl_count.write(claimed.unwrap_or(record.blocks.len() as u32));
            sbl_size.write(stride as u32);
            blocks.write(call.shared.blocks.as_ptr().cast());
        }
        DONE
    };
    // SAFETY: the handle comes from the caller.
    unsafe { on_file("fwifc_read", file, None, run) }
}

/// Copies the blocks of a record to shared memory and returns their stride, bytes.
fn serve(record: &Record, number: u32, file: &File, shared: &mut Shared) -> usize {
    let stride = file.mischief.stride.unwrap_or(size_of::<Block>());
    let (_, claimed) = file.mischief.claims(number);
    shared.samples.clear();
    record.blocks.iter().for_each(|(_, _, samples)| shared.samples.extend_from_slice(samples));
    shared.blocks.clear();
    shared.blocks.resize(stride.max(size_of::<Block>()) * record.blocks.len(), 0xee);
    let mut first = 0;
    for (index, (channel, start_s, samples)) in record.blocks.iter().enumerate() {
        let shift_s = if file.is_relative { 0.0 } else { record.time_sorg };
        let sample = match file.mischief.is_null(number) {
            true => std::ptr::null(),
            false => shared.samples[first..].as_ptr(),
        };
        let block = Block {
            time_sosbl: start_s + shift_s,
            channel: *channel,
            sample_count: claimed.unwrap_or(samples.len() as u32),
            sample_size: size_of::<u16>() as u32,
            sample,
        };
        first += samples.len();
        // SAFETY: `blocks` has room for all blocks, `stride` bytes apart.
        unsafe {
            shared.blocks.as_mut_ptr().add(index * stride).cast::<Block>().write_unaligned(block);
        }
    }
    stride
}

/// `fwifc_seek`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fwifc_seek(file: *mut c_void, record: u32) -> i32 {
    let go = |recording: &mut Recording| match record {
        u32::MAX => recording.seek_last(),
        record => recording.seek(record),
    };
    // SAFETY: the handle comes from the caller.
    unsafe { navigate("fwifc_seek", file, go) }
}

/// `fwifc_tell`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fwifc_tell(file: *mut c_void, record: *mut u32) -> i32 {
    let run = |file: &mut File, _: &mut Call| {
        // SAFETY: the interface requires a valid output pointer.
        unsafe { record.write(file.recording.tell()) };
        DONE
    };
    // SAFETY: the handle comes from the caller.
    unsafe { on_file("fwifc_tell", file, None, run) }
}

/// `fwifc_seek_time`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fwifc_seek_time(file: *mut c_void, time: f64) -> i32 {
    // SAFETY: the handle comes from the caller.
    unsafe { navigate("fwifc_seek_time", file, |recording| recording.seek_time(time, recording::seconds)) }
}

/// `fwifc_seek_time_external`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fwifc_seek_time_external(file: *mut c_void, time: f64) -> i32 {
    let go = |recording: &mut Recording| recording.seek_time(time, recording::external);
    // SAFETY: the handle comes from the caller.
    unsafe { navigate("fwifc_seek_time_external", file, go) }
}
