//! The key `simd` of `[job]`.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use wavex_simd::SimdLevel;

use wavex_line::keys::listed;

/// SIMD instruction set of a processor.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Simd {
    /// The fastest set that the processor supports.
    #[default]
    Auto,
    /// AVX-512.
    Avx512,
    /// AVX2 and FMA.
    Avx2,
    /// Instructions of every processor of the architecture (NEON on ARM).
    Portable,
}

impl From<SimdLevel> for Simd {
    fn from(path: SimdLevel) -> Simd {
        match path {
            SimdLevel::Avx512 => Simd::Avx512,
            SimdLevel::Avx2 => Simd::Avx2,
            SimdLevel::Portable => Simd::Portable,
        }
    }
}

impl Simd {
    /// Instruction set of the kernels on this processor.
    pub fn path(self) -> SimdLevel {
        match self {
            Simd::Auto => SimdLevel::best(),
            Simd::Avx512 => SimdLevel::Avx512,
            Simd::Avx2 => SimdLevel::Avx2,
            Simd::Portable => SimdLevel::Portable,
        }
    }

    /// Name in a job.
    fn name(self) -> &'static str {
        match self {
            Simd::Auto => "auto",
            Simd::Avx512 => "avx512",
            Simd::Avx2 => "avx2",
            Simd::Portable => "portable",
        }
    }

    /// Checks that the processor supports the instruction set.
    ///
    /// `has` returns whether it supports a given one.
    pub(super) fn check(self, has: impl Fn(SimdLevel) -> bool) -> Result<(), String> {
        if self == Simd::Auto || has(self.path()) {
            return Ok(());
        }
        let available = SimdLevel::ALL.into_iter().filter(|&path| has(path));
        let names: Vec<String> = available.map(|path| format!("`{}`", Simd::from(path).name())).collect();
        let (asked, has) = (self.name(), listed(&names, "and"));
        Err(format!(
            "this processor does not support `{asked}`; it supports {has}; `auto` selects the fastest"
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_the_processor_lacks_is_an_error() {
        let without_avx512 = |path: SimdLevel| path != SimdLevel::Avx512;
        let message = "this processor does not support `avx512`; it supports `avx2` and `portable`; `auto` selects the fastest";
        assert_eq!(Simd::Avx512.check(without_avx512).unwrap_err(), message);
        for simd in [Simd::Auto, Simd::Avx2, Simd::Portable] {
            assert_eq!(simd.check(without_avx512), Ok(()));
        }
        let message =
            "this processor does not support `avx2`; it supports `portable`; `auto` selects the fastest";
        assert_eq!(Simd::Avx2.check(|path| path == SimdLevel::Portable).unwrap_err(), message);
    }

    #[test]
    fn every_path_has_its_name_and_back() {
        for path in SimdLevel::ALL {
            assert_eq!(Simd::from(path).path(), path);
            assert_eq!(serde_json::to_value(Simd::from(path)).unwrap(), Simd::from(path).name());
        }
        assert_eq!(Simd::Auto.path(), SimdLevel::best());
    }
}
