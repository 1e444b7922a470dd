//! `wavex --version --verbose`: build details.

use wavex_simd::SimdLevel;

use wavex_run::archive::Program;

/// Lines with version, commit, compiler, target, licence and features.
pub(super) fn details() -> String {
    let program = Program::this();
    let proj = if cfg!(feature = "proj") {
        "proj"
    } else {
        "none (proj: coordinate systems through the PROJ library)"
    };
    format!(
        "wavex {}\ncommit: {}\ncompiler: {}\ntarget: {}, {} build\nlicence: {}\nfeatures: {proj}\n\
         instructions: {:?} on this machine\nSDF and WFM: read through RIEGL's library, loaded at run time\n",
        program.version,
        program.commit.as_deref().unwrap_or("unknown"),
        program.rustc,
        program.target,
        program.profile,
        env!("CARGO_PKG_LICENSE"),
        SimdLevel::best(),
    )
}
