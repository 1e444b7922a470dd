//! The versions of the classic command line.

use super::options::Version;
use super::v10::V10;
use super::v11::V11;

/// Both versions, oldest first.
pub const VERSIONS: [&Version; 2] = [&V10, &V11];

/// Returns the version of this name.
pub fn find(name: &str) -> Option<&'static Version> {
    VERSIONS.into_iter().find(|version| version.name == name)
}
