#!/usr/bin/env bash
# Installs a wheel in a new environment and uses it there. NumPy is downloaded.
#
#     packaging/check_wheel.sh target/dist/wavex-0.1.0-*.whl target/release/wavex
set -euo pipefail
wheel="$(realpath "$1")"
other="$(realpath "$2")"
cd "$(dirname "$0")"
work="$(mktemp -d)"
truth=(--set 'simulate.truth=*_truth.csv')
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/tools"
"$work/tools/bin/pip" install --quiet --disable-pip-version-check auditwheel
# The name claims what the symbols need, or newer.
"$work/tools/bin/auditwheel" show "$wheel" | tr '\n' ' ' > "$work/shown"
tag="$(grep -o 'platform tag: "[^"]*"' "$work/shown" | cut -d '"' -f 2)"
case "$wheel" in
    *-abi3-*"$tag"*.whl) ;;
    *) echo "the symbols are those of \"$tag\", but the name is $(basename "$wheel")" >&2; exit 1 ;;
esac
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install --quiet --disable-pip-version-check "$wheel"
version="$(basename "$wheel" | cut -d - -f 2)"
(cd "$work" && venv/bin/python -c "import wavex; assert wavex.__version__ == '$version', wavex.__version__")
"$work/venv/bin/wavex" --quiet run "${truth[@]}" --set "job.output_dir=$work/wheel" ../jobs/demo.toml
"$other" --quiet run "${truth[@]}" --set "job.output_dir=$work/other" ../jobs/demo.toml
./compare_outputs.sh "$work/wheel" "$work/other"
echo "the wheel works: $tag"
