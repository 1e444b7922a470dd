//! Allocations: their number in the kernels, and their size in readers of wrong files.
//!
//! The tests run one after the other, because they share the allocator and its figures.
#![allow(clippy::print_stdout, reason = "a test prints its figures")]

mod container;
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
}

/// Largest request of any thread, bytes.
static LARGEST: AtomicUsize = AtomicUsize::new(0);
/// Held by the running test.
static RUNNING: Mutex<()> = Mutex::new(());

fn count(bytes: usize) {
    REQUESTS.set(REQUESTS.get() + 1);
    LARGEST.fetch_max(bytes, Ordering::Relaxed);
}

// SAFETY: every request is forwarded unchanged to the system allocator.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        count(layout.size());
        // SAFETY: the caller upholds the contract of `System`, which is the same.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: the caller upholds the contract of `System`, which is the same.
        unsafe { System.dealloc(pointer, layout) }
    }

    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        count(size);
        // SAFETY: the caller upholds the contract of `System`, which is the same.
        unsafe { System.realloc(pointer, layout, size) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;
