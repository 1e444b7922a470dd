#!/usr/bin/env bash
# Measures a first build: an empty registry, an empty target folder, two cores.
#
#     packaging/measure_install.sh            # `cargo run --release -- run jobs/demo.toml`
#     packaging/measure_install.sh test       # `cargo test --workspace`
set -euo pipefail
cd "$(dirname "$0")/.."
folder="$(mktemp -d)"
trap 'rm -rf "$folder"' EXIT
mkdir "$folder/cargo"
# Settings that name a mirror stay; everything downloaded does not.
if [ -f "${CARGO_HOME:-$HOME/.cargo}/config.toml" ]; then
    cp "${CARGO_HOME:-$HOME/.cargo}/config.toml" "$folder/cargo"
fi
export CARGO_HOME="$folder/cargo" CARGO_TARGET_DIR="$folder/target" CARGO_INCREMENTAL=0 CARGO_BUILD_JOBS=2
command=(cargo run --quiet --release -- --quiet run --set "job.output_dir=$folder/out" jobs/demo.toml)
if [ "${1:-run}" = test ]; then command=(cargo test --quiet --workspace); fi
TIMEFORMAT='%R s (%U s of processor time)'
time "${command[@]}" > "$folder/log" 2>&1 || { tail -20 "$folder/log"; exit 1; }
program="$folder/target/release/wavex"
if [ -f "$program" ]; then echo "program: $(du -k --apparent-size "$program" | cut -f 1) kB"; fi
