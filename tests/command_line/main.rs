//! Commands, jobs, their errors, and the documents made from them.
#![allow(
    clippy::panic,
    clippy::print_stdout,
    clippy::unwrap_used,
    reason = "a test fails by panicking, and prints its figures and what it skips"
)]

mod bounds;
mod cases;
mod check;
mod cli;
mod documents;
mod errors_page;
mod examples;
mod explain;
mod generated;
mod import;
mod init_from;
mod job;
mod job_errors;
mod jobs;
mod limits;
mod manual;
mod options;
mod places;
mod run_messages;
mod scan;
mod view;
