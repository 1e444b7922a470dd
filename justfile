# The commands of every day. `just` lists them.

default:
    @just --list

# Everything that must hold before a change lands
ci:
    bash .ci/run

# Tests; set WAVEX_DATA to a folder of real recordings to run those on them, too
test *ARGS:
    cargo test {{ARGS}}

# Fail every call of small runs to the system, one per run (about 20 minutes); docs/explanation/testing.md
faults STEP='all':
    WAVEX_FAULTS={{STEP}} cargo test --test faults -- --nocapture

# Break every diagnostic on simulated recordings, and print what the runs notice; docs/explanation/sabotage.md
sabotage RECORDINGS='100':
    WAVEX_SABOTAGE={{RECORDINGS}} cargo test --test sabotage -- --nocapture

# Format and lint
lint:
    cargo fmt --all
    cargo clippy --all-targets -- -D warnings

# The demo job
demo:
    cargo run --release -- run jobs/demo.toml

# What the engine costs, and where a whole job spends its time
bench:
    cargo bench --bench engine
    cargo bench --bench whole_chain
    cargo build --release --example sdf_stand_in
    cargo bench --bench sdf

# Line coverage of the tests by file (needs cargo-llvm-cov and the component llvm-tools; builds all anew)
coverage *ARGS:
    cargo llvm-cov --workspace --exclude wavex-python --summary-only {{ARGS}}

# Bill of materials of the program: linked libraries with versions, licences and checksums
sbom FILE='target/sbom.cdx.json':
    packaging/sbom.py {{FILE}}

# What a release page offers, built and tried; docs/reference/releases.md
release FOLDER='target/dist':
    packaging/release.sh {{FOLDER}}

# Licences and advisories of the dependencies (needs cargo-deny)
deny:
    cargo deny check

# Fuzz a target for some hours (needs cargo-fuzz); docs/explanation/testing.md lists the targets
fuzz TARGET HOURS:
    fuzz/run {{TARGET}} {{HOURS}}

# Write the inputs from which fuzzing starts to fuzz/corpus
fuzz-seeds:
    cargo test --test robustness write_seeds -- --ignored

# Add the inputs that fuzzing found to the corpus of a target
fuzz-minimise TARGET:
    fuzz/minimise {{TARGET}}
