//! The `wavex` binary: see [`wavex::cli`].

use std::process::ExitCode;

fn main() -> ExitCode {
    wavex::cli::main()
}
