//! Passes the commit, compiler, target and profile of the build to the program.
//!
//! The commit comes from the environment variable `WAVEX_COMMIT`, else from git in release builds.
//! Other builds have none, because each new commit would rebuild them. A `+` after it marks sources
//! that differ from that commit.
#![allow(clippy::print_stdout, reason = "cargo reads instructions from standard output")]

use std::env;
use std::process::Command;

/// Paths whose changes mark the commit as modified.
const SOURCES: [&str; 4] = ["../../src", "../../crates", "../../Cargo.toml", "../../Cargo.lock"];

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

/// The checked-out commit, followed by `+` if one of [`SOURCES`] differs from it.
fn commit_of_git() -> Option<String> {
    let log = output("git", &["rev-parse", "--git-path", "logs/HEAD"])?;
    println!("cargo:rerun-if-changed={log}");
    // An edit without a new commit changes the mark.
    SOURCES.iter().for_each(|source| println!("cargo:rerun-if-changed={source}"));
    let commit = output("git", &["rev-parse", "HEAD"])?;
    let status = ["status", "--porcelain", "--untracked-files=no", "--"];
    let changed = output("git", &[&status[..], &SOURCES[..]].concat())?;
    Some(if changed.is_empty() { commit } else { format!("{commit}+") })
}

/// Standard output of a program; `None` if it cannot run or fails.
fn output(program: &str, arguments: &[&str]) -> Option<String> {
    let output = Command::new(program).args(arguments).output().ok()?;
    let text = String::from_utf8(output.stdout).ok()?;
    output.status.success().then(|| text.trim().to_owned())
}
