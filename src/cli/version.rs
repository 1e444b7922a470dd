//! `wavex --version --verbose`: what this build is made of.

use crate::archive::Program;
use crate::kernels::lockstep;

/// Version, commit, compiler, target, licence and features, a line each.
pub(super) fn details() -> String {
    let program = Program::this();
    let proj =
        if cfg!(feature = "proj") { "proj" } else { "none (proj: coordinate systems by the library PROJ)" };
    format!(
        "wavex {}\ncommit: {}\ncompiler: {}\ntarget: {}, {} build\nlicence: {}\nfeatures: {proj}\n\
         instructions: {:?} on this machine\nSDF and WFM: through RIEGL's library, loaded at run time\n",
        program.version,
        program.commit.as_deref().unwrap_or("not known"),
        program.rustc,
        program.target,
        program.profile,
        env!("CARGO_PKG_LICENSE"),
        lockstep::Path::best(),
    )
}
