#!/usr/bin/env bash
# Measures first builds: an empty registry, an empty target folder, two cores, no real recordings.
#
#     packaging/measure_install.sh            # both of these
#     packaging/measure_install.sh run        # `cargo run --release -- run jobs/demo.toml`
#     packaging/measure_install.sh test       # `cargo test --workspace`: its build, then all tests
#
# Prints elapsed time, processor time and, for `run`, the size of the program.
set -euo pipefail
cd "$(dirname "$0")/.."
case "${1:-both}" in
    both | run | test) ;;
    *) echo "usage: $0 [run | test]" >&2; exit 2 ;;
esac
folder="$(mktemp -d)"
trap 'rm -rf "$folder"' EXIT
settings="${CARGO_HOME:-$HOME/.cargo}/config.toml"
unset WAVEX_DATA
export CARGO_INCREMENTAL=0 CARGO_BUILD_JOBS=2
TIMEFORMAT='%R s, of processor time %U s and %S s in the kernel'

# Starts with an empty registry and an empty target folder.
empty() {
    rm -rf "$folder"/*
    mkdir "$folder/cargo"
    # Settings that name a mirror stay; everything downloaded does not.
    if [ -f "$settings" ]; then cp "$settings" "$folder/cargo"; fi
    export CARGO_HOME="$folder/cargo" CARGO_TARGET_DIR="$folder/target"
}

# Runs a command and prints its times; if it fails, also the end of its output.
measure() {
    echo "$*"
    time "$@" > "$folder/log" 2>&1 || { tail -20 "$folder/log"; exit 1; }
}

if [ "${1:-both}" != test ]; then
    empty
    measure cargo run --release -- --quiet run --set "job.output_dir=$folder/out" jobs/demo.toml
    echo "program: $(du -k --apparent-size "$folder/target/release/wavex" | cut -f 1) kB"
fi
if [ "${1:-both}" != run ]; then
    empty
    measure cargo test --workspace --no-run
    measure cargo test --workspace
fi
