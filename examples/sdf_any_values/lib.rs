//! A library with the interface of RIEGL's that returns any values: those of the file's bytes.
//!
//! For fuzzing and testing `read_sdf`. Numbers, texts, return codes and null pointers are taken from
//! the file one after the other; without bytes they are zero, and records end. Its memory is honest:
//! a pointer that is not null refers to as much memory as stated, unless a size exceeds the limits
//! of the reader, which must then not read at all.
#![allow(clippy::missing_safety_doc, reason = "the contract of each function is that of RIEGL's interface")]
#![allow(clippy::too_many_arguments, reason = "RIEGL's interface has so many")]

use std::ffi::{CStr, c_char, c_void};
use std::path::Path;

const END_OF_FILE: i32 = -1;
const DONE: i32 = 0;
const BAD_ARGUMENT: i32 = 1;
/// Sizes up to this have memory.
const MOST: u32 = 1 << 16;
/// Most samples of a record with memory.
const MOST_SAMPLES: usize = 1 << 20;
/// The file ends after so many samples, because they take time.
const MOST_OF_ALL: usize = 1 << 22;

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

/// Open file: its bytes, and the memory of the pointers returned last.
#[derive(Default)]
struct File {
    bytes: Vec<u8>,
    at: usize,
    records: u32,
    served: usize,
    texts: [Vec<u8>; 3],
    blocks: Vec<u8>,
    samples: Vec<u16>,
    numbers: [Vec<f64>; 2],
}

impl File {
    fn take<const N: usize>(&mut self) -> [u8; N] {
        let mut taken = [0; N];
        let rest = self.bytes.get(self.at..).unwrap_or_default();
        taken.iter_mut().zip(rest).for_each(|(to, from)| *to = *from);
        self.at = self.bytes.len().min(self.at + N);
        taken
    }

    fn byte(&mut self) -> u8 {
        self.take::<1>()[0]
    }

    fn f64(&mut self) -> f64 {
        f64::from_le_bytes(self.take())
    }

    fn u16(&mut self) -> u16 {
        u16::from_le_bytes(self.take())
    }

    /// A size: mostly of one byte.
    fn size(&mut self) -> u32 {
        match self.byte() {
            255 => u32::from_le_bytes(self.take()),
            254 => u32::from(self.u16()),
            size => u32::from(size),
        }
    }

    /// A return code: mostly success.
    fn code(&mut self) -> i32 {
        match self.byte() {
            255 => i32::from_le_bytes(self.take()),
            code @ 240.. => i32::from(code) - 241,
            _ => DONE,
        }
    }

    /// A text in memory; null for a length of 255.
    fn text(&mut self, place: usize) -> *const c_char {
        let length = self.byte();
        if length == 255 {
            return std::ptr::null();
        }
        let mut text: Vec<u8> = (0..length).map(|_| self.byte()).collect();
        text.push(0);
        self.texts[place] = text;
        self.texts[place].as_ptr().cast()
    }
}

/// Runs a function on an open file; the file may return a failure instead.
unsafe fn on_file(file: *mut c_void, run: impl FnOnce(&mut File) -> i32) -> i32 {
    // SAFETY: a handle is a pointer created by `fwifc_open`, and callers use it from one thread at a time.
    let Some(file) = (unsafe { file.cast::<File>().as_mut() }) else { return BAD_ARGUMENT };
    match file.code() {
        DONE => run(file),
        code => code,
    }
}

/// `fwifc_get_library_version`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fwifc_get_library_version(
    major: *mut u16,
    minor: *mut u16,
    build_version: *mut *const c_char,
    build_tag: *mut *const c_char,
) -> i32 {
    // SAFETY: the interface requires four valid output pointers.
    unsafe {
        major.write(1);
        minor.write(7);
        build_version.write(c"1.7".as_ptr());
        build_tag.write(c"any values".as_ptr());
    }
    DONE
}

/// `fwifc_get_last_error`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fwifc_get_last_error(message: *mut *const c_char) -> i32 {
    // SAFETY: the interface requires a valid output pointer.
    unsafe { message.write(c"a failure of the file".as_ptr()) };
    DONE
}

/// `fwifc_open`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fwifc_open(path: *const c_char, file: *mut *mut c_void) -> i32 {
    // SAFETY: the interface requires a C string.
    let Ok(path) = (unsafe { CStr::from_ptr(path) }).to_str() else { return BAD_ARGUMENT };
    let Ok(bytes) = std::fs::read(Path::new(path)) else { return BAD_ARGUMENT };
    let opened = Box::new(File { bytes, ..File::default() });
    // SAFETY: the interface requires a valid output pointer.
    unsafe { file.write(Box::into_raw(opened).cast()) };
    DONE
}

/// `fwifc_close`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fwifc_close(file: *mut c_void) -> i32 {
    if !file.is_null() {
        // SAFETY: a handle is a pointer created by `fwifc_open`, and is closed once.
        drop(unsafe { Box::from_raw(file.cast::<File>()) });
    }
    DONE
}

/// `fwifc_reindex`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fwifc_reindex(file: *mut c_void) -> i32 {
    // SAFETY: the handle comes from the caller.
    unsafe { on_file(file, |_| DONE) }
}

/// `fwifc_set_sosbl_relative`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fwifc_set_sosbl_relative(file: *mut c_void, _value: i32) -> i32 {
    // SAFETY: the handle comes from the caller.
    unsafe { on_file(file, |_| DONE) }
}

/// `fwifc_get_info`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fwifc_get_info(
    file: *mut c_void,
    instrument: *mut *const c_char,
    serial: *mut *const c_char,
    epoch: *mut *const c_char,
    v_group: *mut f64,
    sampling_time: *mut f64,
    flags: *mut u16,
    num_facets: *mut u16,
) -> i32 {
    let run = |file: &mut File| {
        // SAFETY: the interface requires seven valid output pointers.
        unsafe {
            instrument.write(file.text(0));
            serial.write(file.text(1));
            epoch.write(file.text(2));
            v_group.write(file.f64());
            sampling_time.write(file.f64());
            flags.write(file.u16());
            num_facets.write(file.u16());
        }
        DONE
    };
    // SAFETY: the handle comes from the caller.
    unsafe { on_file(file, run) }
}

/// `fwifc_get_calib`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fwifc_get_calib(
    file: *mut c_void,
    _kind: u16,
    count: *mut u32,
    abscissa: *mut *const f64,
    ordinate: *mut *const f64,
) -> i32 {
    let run = |file: &mut File| {
        let size = file.size();
        let held = if size > MOST { 0 } else { size };
        let null = file.byte();
        for place in 0..2 {
            file.numbers[place] = (0..held).map(|_| file.f64()).collect();
        }
        let pointer = |place: usize, bit: u8| match null & bit {
            0 => file.numbers[place].as_ptr(),
            _ => std::ptr::null(),
        };
        // SAFETY: the interface requires three valid output pointers.
        unsafe {
            count.write(size);
            abscissa.write(pointer(0, 64));
            ordinate.write(pointer(1, 128));
        }
        DONE
    };
    // SAFETY: the handle comes from the caller.
    unsafe { on_file(file, run) }
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
    let run = |file: &mut File| {
        if file.at >= file.bytes.len() || file.served > MOST_OF_ALL {
            return END_OF_FILE;
        }
        file.records += 1;
        // SAFETY: the interface requires nine valid output pointers, two of them to three numbers.
        unsafe {
            time_sorg.write(file.f64());
            time_external.write(file.f64());
            origin.cast::<[f64; 3]>().write([file.f64(), file.f64(), file.f64()]);
            direction.cast::<[f64; 3]>().write([file.f64(), file.f64(), file.f64()]);
            flags.write(file.u16());
            facet.write(file.u16());
            let count = file.size();
            let stride = if file.byte() < 200 { size_of::<Block>() as u32 } else { file.size() };
            let null = file.byte();
            serve(file, count, stride);
            sbl_count.write(count);
            sbl_size.write(stride);
            blocks.write(if null < 240 { file.blocks.as_ptr().cast() } else { std::ptr::null() });
        }
        DONE
    };
    // SAFETY: the handle comes from the caller.
    unsafe { on_file(file, run) }
}

/// Makes the blocks of a record: none for sizes that a reader must refuse.
fn serve(file: &mut File, count: u32, stride: u32) {
    let width = size_of::<Block>();
    file.blocks.clear();
    if count > 1 << 12 || (stride as usize) < width || stride > 1 << 12 {
        return;
    }
    file.blocks.resize(count as usize * stride as usize, 0xee);
    // Pointers to samples are set once all are stored.
    let mut made: Vec<(Block, Option<usize>)> = Vec::new();
    file.samples.clear();
    for _ in 0..count {
        let (time_sosbl, channel) = (file.f64(), file.size());
        let (sample_count, null) = (file.size(), file.byte());
        let is_held = sample_count <= MOST && file.samples.len() + sample_count as usize <= MOST_SAMPLES;
        let first = (null < 240 && is_held).then_some(file.samples.len());
        if first.is_some() {
            let step = file.byte();
            let start = file.u16();
            let more =
                (0..sample_count).map(|k| start.wrapping_add(u16::from(step).wrapping_mul(k as u16 % 9)));
            file.samples.extend(more);
        }
        let block = Block { time_sosbl, channel, sample_count, sample_size: 2, sample: std::ptr::null() };
        made.push((block, first));
    }
    file.served += file.samples.len();
    for (index, (block, first)) in made.into_iter().enumerate() {
        let sample = first.map_or(std::ptr::null(), |first| file.samples[first..].as_ptr());
        let block = Block { sample, ..block };
        // SAFETY: `blocks` has room for all blocks, `stride` bytes apart.
        unsafe {
            let to = file.blocks.as_mut_ptr().add(index * stride as usize);
            to.cast::<Block>().write_unaligned(block);
        }
    }
}

/// `fwifc_seek`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fwifc_seek(file: *mut c_void, record: u32) -> i32 {
    let run = |file: &mut File| {
        file.records = record.saturating_sub(1);
        DONE
    };
    // SAFETY: the handle comes from the caller.
    unsafe { on_file(file, run) }
}

/// `fwifc_tell`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fwifc_tell(file: *mut c_void, record: *mut u32) -> i32 {
    let run = |file: &mut File| {
        // SAFETY: the interface requires a valid output pointer.
        unsafe { record.write(file.records.wrapping_add(1)) };
        DONE
    };
    // SAFETY: the handle comes from the caller.
    unsafe { on_file(file, run) }
}

/// `fwifc_seek_time`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fwifc_seek_time(file: *mut c_void, _time: f64) -> i32 {
    // SAFETY: the handle comes from the caller.
    unsafe { on_file(file, |_| DONE) }
}

/// `fwifc_seek_time_external`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fwifc_seek_time_external(file: *mut c_void, _time: f64) -> i32 {
    // SAFETY: the handle comes from the caller.
    unsafe { on_file(file, |_| DONE) }
}
