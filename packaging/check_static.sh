#!/usr/bin/env bash
# Runs the program of an archive in a root without libraries, and compares its outputs with those of another program;
# needs root and readelf.
#
#     packaging/check_static.sh wavex-0.1.0-x86_64-linux.tar.gz target/release/wavex
set -euo pipefail
archive="$(realpath "$1")"
other="$(realpath "$2")"
cd "$(dirname "$0")"
work="$(mktemp -d)"
truth=(--set 'simulate.truth=*_truth.csv')
trap 'rm -rf "$work"' EXIT
root="$work/root"
mkdir -p "$root" "$work/archive"
tar -xzf "$archive" -C "$work/archive" --strip-components=1
cp -r "$work/archive/bin/wavex" "$work/archive/share/doc/wavex/jobs" "$root"

readelf --program-headers --dynamic "$root/wavex" > "$work/headers"
if grep -E 'INTERP|NEEDED' "$work/headers"; then
    echo "the program is not static" >&2
    exit 1
fi
inside() { env -i "$(command -v chroot)" "$root" /wavex "$@"; }
inside doctor | grep 'a static program cannot load it'
inside --quiet run "${truth[@]}" /jobs/demo.toml
"$other" --quiet run "${truth[@]}" --set "job.output_dir=$work/other" ../jobs/demo.toml
./compare_outputs.sh --other-library "$root/out/demo" "$work/other"
echo "the static program works in a root of $(find "$root" -path "$root/out" -prune -o -type f -print | wc -l) files"
