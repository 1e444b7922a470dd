//! Origin of a run: the program with its dependencies, and the machine.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use wavex_engine::build;

/// A program with its dependencies.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
pub struct Program {
    /// Version.
    pub version: String,
    /// Commit of the build, with a `+` if files were modified; none if unknown.
    pub commit: Option<String>,
    /// Compiler version.
    pub rustc: String,
    /// Target of the build.
    pub target: String,
    /// Build profile: `release` or `debug`.
    pub profile: String,
    /// Crates available to the build, in the versions of `Cargo.lock`.
    pub crates: Vec<Package>,
}

/// A crate.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
pub struct Package {
    /// Name.
    pub name: String,
    /// Version.
    pub version: String,
    /// SHA-256 of the source, from `Cargo.lock`; none for wavex itself.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub checksum: Option<String>,
}

/// A machine; unknown properties are omitted.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
pub struct Machine {
    /// Host name.
    pub host: Option<String>,
    /// Operating system.
    pub os: String,
    /// Processor architecture.
    pub architecture: String,
    /// Processor model.
    pub processor: Option<String>,
    /// Number of available cores.
    pub cores: Option<usize>,
    /// Memory, MB.
    pub memory_mb: Option<u64>,
}

/// The used part of `Cargo.lock`.
#[derive(Deserialize)]
struct Lock {
    package: Vec<Package>,
}

const LOCK: &str = include_str!(env!("WAVEX_BUILD_LOCK"));

impl Program {
    /// This program.
    pub fn this() -> Program {
        let lock: Result<Lock, _> = toml::from_str(LOCK);
        Program {
            version: build::VERSION.to_owned(),
            commit: Some(build::COMMIT.to_owned()).filter(|commit| !commit.is_empty()),
            rustc: build::RUSTC.to_owned(),
            target: build::TARGET.to_owned(),
            profile: build::PROFILE.to_owned(),
            crates: lock.map_or_else(|_| Vec::new(), |lock| lock.package),
        }
    }

    /// Text form: `0.1.0 (commit, rustc, target, profile)`.
    pub fn words(&self) -> String {
        let commit = self.commit.as_deref().unwrap_or("unknown commit");
        format!("{} ({commit}, {}, {}, {})", self.version, self.rustc, self.target, self.profile)
    }
}

impl Machine {
    /// This machine.
    pub fn this() -> Machine {
        let read = |path: &str| std::fs::read_to_string(path).ok();
        let processor = read("/proc/cpuinfo").and_then(|text| value(&text, "model name").map(str::to_owned));
        let memory_kb =
            read("/proc/meminfo").and_then(|text| value(&text, "MemTotal")?.split(' ').next()?.parse().ok());
        Machine {
            host: wavex_engine::engine::host(),
            os: std::env::consts::OS.to_owned(),
            architecture: std::env::consts::ARCH.to_owned(),
            processor,
            cores: wavex_engine::engine::cores(),
            memory_mb: memory_kb.map(|kb: u64| kb / 1000),
        }
    }
}

/// Value after `name:` in one of the lines.
fn value<'t>(text: &'t str, name: &str) -> Option<&'t str> {
    let mut pairs = text.lines().filter_map(|line| line.split_once(':'));
    pairs.find(|(key, _)| key.trim() == name).map(|(_, value)| value.trim())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_program_knows_what_it_is_made_of() {
        let program = Program::this();
        assert!(program.rustc.starts_with("rustc 1."), "{}", program.rustc);
        let own = program.crates.iter().find(|package| package.name == "wavex").unwrap();
        assert_eq!((own.version.as_str(), &own.checksum), (env!("CARGO_PKG_VERSION"), &None));
        let blake3 = program.crates.iter().find(|package| package.name == "blake3").unwrap();
        assert_eq!(blake3.checksum.as_ref().map(String::len), Some(64));
    }

    #[test]
    fn lines_of_proc_are_read_by_their_names() {
        let text = "processor\t: 0\nmodel name\t: A Processor: fast\nMemTotal:   24000 kB\n";
        assert_eq!(value(text, "model name"), Some("A Processor: fast"));
        assert_eq!(value(text, "MemTotal"), Some("24000 kB"));
        assert_eq!(value(text, "MemFree"), None);
    }
}
