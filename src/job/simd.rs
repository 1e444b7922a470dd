//! The key `simd` of `[job]`.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::kernels::lockstep::Path;
use crate::stage::listed;

/// Instructions of a processor that compute on several numbers at once.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Simd {
    /// The fastest that the processor has.
    #[default]
    Auto,
    /// AVX-512.
    Avx512,
    /// AVX2 and FMA.
    Avx2,
    /// What every processor has (NEON on ARM).
    Portable,
}

impl From<Path> for Simd {
    fn from(path: Path) -> Simd {
        match path {
            Path::Avx512 => Simd::Avx512,
            Path::Avx2 => Simd::Avx2,
            Path::Portable => Simd::Portable,
        }
    }
}

impl Simd {
    /// The path of the kernels that is meant on this processor.
    pub fn path(self) -> Path {
        match self {
            Simd::Auto => Path::best(),
            Simd::Avx512 => Path::Avx512,
            Simd::Avx2 => Path::Avx2,
            Simd::Portable => Path::Portable,
        }
    }

    /// What a job calls it.
    fn name(self) -> &'static str {
        match self {
            Simd::Auto => "auto",
            Simd::Avx512 => "avx512",
            Simd::Avx2 => "avx2",
            Simd::Portable => "portable",
        }
    }

    /// An error where a processor that `has` some paths lacks the one that is asked for.
    pub(super) fn check(self, has: impl Fn(Path) -> bool) -> Result<(), String> {
        if self == Simd::Auto || has(self.path()) {
            return Ok(());
        }
        let available = Path::ALL.into_iter().filter(|&path| has(path));
        let names: Vec<String> = available.map(|path| format!("`{}`", Simd::from(path).name())).collect();
        let (asked, has) = (self.name(), listed(&names, "and"));
        Err(format!("this processor has no `{asked}`; it has {has}, and `auto` takes the fastest"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_the_processor_lacks_is_an_error() {
        let without_avx512 = |path: Path| path != Path::Avx512;
        let message =
            "this processor has no `avx512`; it has `avx2` and `portable`, and `auto` takes the fastest";
        assert_eq!(Simd::Avx512.check(without_avx512).unwrap_err(), message);
        for simd in [Simd::Auto, Simd::Avx2, Simd::Portable] {
            assert_eq!(simd.check(without_avx512), Ok(()));
        }
        let message = "this processor has no `avx2`; it has `portable`, and `auto` takes the fastest";
        assert_eq!(Simd::Avx2.check(|path| path == Path::Portable).unwrap_err(), message);
    }

    #[test]
    fn every_path_has_its_name_and_back() {
        for path in Path::ALL {
            assert_eq!(Simd::from(path).path(), path);
            assert_eq!(serde_json::to_value(Simd::from(path)).unwrap(), Simd::from(path).name());
        }
        assert_eq!(Simd::Auto.path(), Path::best());
    }
}
