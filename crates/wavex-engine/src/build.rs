//! What the program was built from.

/// Version of the program.
pub const VERSION: &str = env!("CARGO_PKG_VERSION");

/// Commit of the sources, followed by `+` if they differ from it; empty if unknown.
pub const COMMIT: &str = env!("WAVEX_BUILD_COMMIT");

/// Compiler with its version.
pub const RUSTC: &str = env!("WAVEX_BUILD_RUSTC");

/// Target of the compiler.
pub const TARGET: &str = env!("WAVEX_BUILD_TARGET");

/// Profile of the build: `release` or `debug`.
pub const PROFILE: &str = env!("WAVEX_BUILD_PROFILE");
