//! Allocations: their number in the kernels, their size in readers of wrong files, and readers without memory.
//!
//! The tests run one after the other, because they share the allocator and its figures.
#![allow(clippy::print_stdout, reason = "a test prints its figures")]

mod container;
mod failing;
mod kernels;

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

/// The system allocator with figures of its requests.
struct Counting;

thread_local! {
    /// Number of requests of this thread.
    static REQUESTS: Cell<usize> = const { Cell::new(0) };
    /// Number of large requests of this thread until one fails; 0: none fails.
    static LARGE_UNTIL_FAILURE: Cell<usize> = const { Cell::new(0) };
}

/// Smallest request that can fail, bytes: more than any buffer of fixed size.
const LARGE: usize = 1 << 20;

/// Largest request of any thread, bytes.
static LARGEST: AtomicUsize = AtomicUsize::new(0);
/// Held by the running test.
static RUNNING: Mutex<()> = Mutex::new(());

fn count(bytes: usize) {
    REQUESTS.set(REQUESTS.get() + 1);
    LARGEST.fetch_max(bytes, Ordering::Relaxed);
}

/// Whether this request is the one that fails.
fn fails(bytes: usize) -> bool {
    let left = LARGE_UNTIL_FAILURE.get();
    if bytes < LARGE || left == 0 {
        return false;
    }
    LARGE_UNTIL_FAILURE.set(left - 1);
    left == 1
}

// SAFETY: every request is forwarded unchanged to the system allocator, or gets a null pointer, which
// means that there is no memory.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        count(layout.size());
        if fails(layout.size()) {
            return std::ptr::null_mut();
        }
        // SAFETY: the caller upholds the contract of `System`, which is the same.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: the caller upholds the contract of `System`, which is the same.
        unsafe { System.dealloc(pointer, layout) }
    }

    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        count(size);
        if fails(size) {
            return std::ptr::null_mut();
        }
        // SAFETY: the caller upholds the contract of `System`, which is the same.
        unsafe { System.realloc(pointer, layout, size) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;
