//! The stand-in exercises the full freedom of the interface; tests of reader functions that no
//! stage uses yet.

use std::ffi::{CString, c_char, c_void};
use std::os::raw::c_int;

use wavex_formats::sdf::{SdfReader, SdfRecord};

use wavex_testkit::container::container;
use wavex_testkit::sdf::{NAME, header, place, plain_line, stand_in};

type Open = unsafe extern "C" fn(*const c_char, *mut *mut c_void) -> c_int;
type Close = unsafe extern "C" fn(*mut c_void) -> c_int;
type Tell = unsafe extern "C" fn(*mut c_void, *mut u32) -> c_int;
type Table = unsafe extern "C" fn(*mut c_void, u16, *mut u32, *mut *const f64, *mut *const f64) -> c_int;

#[test]
fn what_it_points_to_is_gone_after_the_next_call() {
    // A copy is a separate library with its own variables, which no other test uses.
    let place = place(&container(&header(), &[plain_line(0..5, 0)]), "");
    let copy = place.path("a_copy_of_the_stand_in");
    std::fs::copy(stand_in(), &copy).unwrap();
    let path = CString::new(place.path(NAME).to_str().unwrap()).unwrap();
    // SAFETY: the types are those of the interface, the handle is open, and a table's memory is
    // valid until the next table.
    unsafe {
        let library = libloading::Library::new(copy).unwrap();
        let open = library.get::<Open>(c"fwifc_open").unwrap();
        let table = library.get::<Table>(c"fwifc_get_calib").unwrap();
        let tell = library.get::<Tell>(c"fwifc_tell").unwrap();
        let close = library.get::<Close>(c"fwifc_close").unwrap();
        let mut file = std::ptr::null_mut();
        assert_eq!(open(path.as_ptr(), &mut file), 0);
        let (mut count, mut x, mut y) = (0, std::ptr::null(), std::ptr::null());
        assert_eq!(table(file, 1, &mut count, &mut x, &mut y), 0);
        assert_eq!((count, x.read(), y.read()), (3, 9.0, 0.0));
        let mut record = 0;
        assert_eq!((tell(file, &mut record), record), (0, 1));
        assert!(x.read().is_nan() && y.read().is_nan());
        assert_eq!(close(file), 0);
    }
}

#[test]
fn records_count_from_one_and_the_last_has_a_name() {
    let lines = [plain_line(0..5, 0), plain_line(5..10, 1)];
    let place = place(&container(&header(), &lines), "");
    let mut reader = SdfReader::open(&place.path(NAME), Some(&stand_in()), None, &|_| {}).unwrap();
    let mut record = SdfRecord::default();
    let mut at = |number: u32| {
        let found = reader.seek(number).unwrap();
        let next = reader.next_record();
        (found && reader.next(&mut record).unwrap()).then_some((next, record.time_s, record.blocks.len()))
    };
    assert_eq!(at(1), Some((1, 5.0, 2)));
    assert_eq!(at(7), Some((7, 5.5, 2)));
    assert_eq!(
        at(u32::MAX).map(|(next, _, blocks)| (next, blocks)),
        Some((12, 0)),
        "the end of the second line"
    );
    assert_eq!(at(2), Some((2, 5.1, 2)));
    assert_eq!((at(0), at(13)), (None, None));
    assert!(reader.seek_time(5.85).unwrap());
    assert_eq!(reader.next_record(), 11);
    assert!(!reader.seek_time_external(208_801.0).unwrap());
}
