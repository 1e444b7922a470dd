//! Passes the file of the resolved dependencies to the crate, for the origin of an archive.
#![allow(clippy::print_stdout, reason = "cargo reads instructions from standard output")]

use std::path::Path;

fn main() {
    let folder = std::env::var("CARGO_MANIFEST_DIR").unwrap_or_default();
    // A package has its own file; in the workspace it is that of all crates.
    let own = Path::new(&folder).join("Cargo.lock");
    let lock = if own.exists() { own } else { Path::new(&folder).join("../../Cargo.lock") };
    println!("cargo:rerun-if-changed={}", lock.display());
    println!("cargo:rustc-env=WAVEX_BUILD_LOCK={}", lock.display());
}
