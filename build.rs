//! Tells the program what it is made of: the commit, where that is known, the compiler, and what it is made for.
//!
//! The commit is that of the environment variable `WAVEX_COMMIT`, else of git, in release builds only: others would be built
//! anew after every commit. What follows it says whether the program is made of that commit and nothing else.
#![allow(clippy::print_stdout, reason = "cargo listens to standard output")]

use std::env;
use std::process::Command;

/// What the program is made of.
const SOURCES: [&str; 4] = ["src", "build.rs", "Cargo.toml", "Cargo.lock"];

fn main() {
    println!("cargo:rerun-if-changed=build.rs");
    println!("cargo:rerun-if-env-changed=WAVEX_COMMIT");
    let profile = env::var("PROFILE").unwrap_or_default();
    let given = env::var("WAVEX_COMMIT").ok().filter(|commit| !commit.is_empty());
    let commit = given.or_else(|| if profile == "release" { commit_of_git() } else { None });
    let rustc = env::var("RUSTC").ok().and_then(|rustc| output(&rustc, &["--version"]));
    let target = env::var("TARGET").unwrap_or_default();
    println!("cargo:rustc-env=WAVEX_BUILD_COMMIT={}", commit.unwrap_or_default());
    println!("cargo:rustc-env=WAVEX_BUILD_RUSTC={}", rustc.unwrap_or_default());
    println!("cargo:rustc-env=WAVEX_BUILD_TARGET={target}");
    println!("cargo:rustc-env=WAVEX_BUILD_PROFILE={profile}");
}

/// The commit that is checked out, with a `+` where a file differs from it that the program is made of.
fn commit_of_git() -> Option<String> {
    let log = output("git", &["rev-parse", "--git-path", "logs/HEAD"])?;
    println!("cargo:rerun-if-changed={log}");
    // Without these, a file that is edited behind a build would leave the commit as it was told then.
    SOURCES.iter().for_each(|source| println!("cargo:rerun-if-changed={source}"));
    let commit = output("git", &["rev-parse", "HEAD"])?;
    let status = ["status", "--porcelain", "--untracked-files=no", "--"];
    let changed = output("git", &[&status[..], &SOURCES[..]].concat())?;
    Some(if changed.is_empty() { commit } else { format!("{commit}+") })
}

/// What a program prints, if it is there and succeeds.
fn output(program: &str, arguments: &[&str]) -> Option<String> {
    let output = Command::new(program).args(arguments).output().ok()?;
    let text = String::from_utf8(output.stdout).ok()?;
    output.status.success().then(|| text.trim().to_owned())
}
