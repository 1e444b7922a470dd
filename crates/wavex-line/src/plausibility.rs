//! Description of a plausibility check.
//!
//! An input that contradicts physics or itself is refused, left out or reported. Each module that checks one
//! describes its checks, with the limits that it uses; `wavex_stages::checks` lists them.

use std::fmt::{self, Display, Formatter};

/// A comparison of an input with physics, or with itself.
#[derive(Clone)]
pub struct Check {
    /// What is compared.
    pub compared: &'static str,
    /// Accepted values, with their unit.
    pub accepted: String,
    /// Why these values are accepted.
    pub source: &'static str,
    /// What follows otherwise.
    pub otherwise: Otherwise,
    /// Words of the message.
    pub message: &'static str,
    /// Key of the job that overrides the check; `None` if only another input helps.
    pub key: Option<&'static str>,
}

impl Check {
    /// A check that fails the run.
    pub fn error(
        compared: &'static str,
        accepted: impl Into<String>,
        source: &'static str,
        message: &'static str,
    ) -> Check {
        Check { compared, accepted: accepted.into(), source, otherwise: Otherwise::Error, message, key: None }
    }

    /// A check that only warns.
    pub fn warning(
        compared: &'static str,
        accepted: impl Into<String>,
        source: &'static str,
        message: &'static str,
    ) -> Check {
        Check { otherwise: Otherwise::Warning, ..Check::error(compared, accepted, source, message) }
    }

    /// A check that leaves items out.
    pub fn left_out(
        compared: &'static str,
        accepted: impl Into<String>,
        source: &'static str,
        message: &'static str,
    ) -> Check {
        Check { otherwise: Otherwise::LeftOut, ..Check::error(compared, accepted, source, message) }
    }

    /// The same with the key that overrides it.
    pub fn with_key(self, key: &'static str) -> Check {
        Check { key: Some(key), ..self }
    }
}

/// What follows if a check fails.
#[derive(Clone, Copy)]
pub enum Otherwise {
    /// The run fails.
    Error,
    /// The run goes on, with a warning.
    Warning,
    /// The items are left out and counted, with a warning.
    LeftOut,
}

impl Display for Otherwise {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Otherwise::Error => "error",
            Otherwise::Warning => "warning",
            Otherwise::LeftOut => "left out",
        })
    }
}
