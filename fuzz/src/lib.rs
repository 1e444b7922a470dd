//! What all fuzz targets share: a limit of memory, and their entry point.

use std::alloc::{GlobalAlloc, Layout, System};

pub use libfuzzer_sys;
pub use wavex_testkit;

/// Largest single allocation, bytes.
///
/// libFuzzer's `-malloc_limit_mb` needs a sanitizer, which stable Rust lacks.
const MOST_BYTES: usize = 1 << 30;

/// Allocator of the system that aborts on requests above [`MOST_BYTES`].
struct Limited;

fn check(bytes: usize) {
    if bytes > MOST_BYTES {
        // Without allocation, which would come here again.
        eprintln!("allocation of {bytes} bytes");
        std::process::abort();
    }
}

// SAFETY: all calls are passed on to the allocator of the system.
unsafe impl GlobalAlloc for Limited {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        check(layout.size());
        // SAFETY: as of this function.
        unsafe { System.alloc(layout) }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        check(layout.size());
        // SAFETY: as of this function.
        unsafe { System.alloc_zeroed(layout) }
    }

    unsafe fn realloc(&self, memory: *mut u8, layout: Layout, bytes: usize) -> *mut u8 {
        check(bytes);
        // SAFETY: as of this function.
        unsafe { System.realloc(memory, layout, bytes) }
    }

    unsafe fn dealloc(&self, memory: *mut u8, layout: Layout) {
        // SAFETY: as of this function.
        unsafe { System.dealloc(memory, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Limited = Limited;

/// Entry point of a target: the function of this name in `wavex_testkit::fuzz`.
#[macro_export]
macro_rules! target {
    ($name:ident) => {
        $crate::libfuzzer_sys::fuzz_target!(|bytes: &[u8]| $crate::wavex_testkit::fuzz::$name(bytes));
    };
}
