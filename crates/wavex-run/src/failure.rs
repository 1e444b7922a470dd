//! Reasons why a command fails.

use wavex_engine::job::JobErrors;

/// Reason why a command failed.
#[derive(Debug)]
pub enum Failure {
    /// The job is invalid.
    Job(JobErrors),
    /// The command line or a file named on it is invalid: problem and remedy.
    Wrong(String),
    /// The run failed: problem and remedy.
    Run(String),
}

impl Failure {
    /// The problem and its remedy.
    pub fn text(&self) -> String {
        match self {
            Failure::Job(errors) => errors.to_string(),
            Failure::Wrong(problem) | Failure::Run(problem) => problem.clone(),
        }
    }
}

impl From<JobErrors> for Failure {
    fn from(errors: JobErrors) -> Failure {
        Failure::Job(errors)
    }
}
