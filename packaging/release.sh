#!/usr/bin/env bash
# Makes what a release page offers, from the checked-out commit. The same commit gives the same bytes.
#
#     packaging/release.sh [FOLDER]                   # build, pack and try everything; default: target/dist
#     packaging/release.sh --quick PROGRAM [FOLDER]   # pack a program that is already built, and no wheel
#
# docs/reference/releases.md lists the files, what a build needs and what is tried.
set -euo pipefail
cd "$(dirname "$0")/.."
quick=
if [ "${1:-}" = --quick ]; then
    quick="$(realpath "$2")"
    shift 2
fi
dist="$(realpath -m "${1:-target/dist}")"
[ ! -e "$dist" ] || { echo "$dist exists: remove it, or name another folder" >&2; exit 1; }
version="$(sed -n 's/^version = "\(.*\)"$/\1/p' Cargo.toml | head -1)"
WAVEX_COMMIT="$(git rev-parse HEAD)"
SOURCE_DATE_EPOCH="$(git log -1 --format=%ct)"
export WAVEX_COMMIT SOURCE_DATE_EPOCH TZ=UTC LC_ALL=C
target="$(realpath -m "${CARGO_TARGET_DIR:-target}")"
umask 022
work="$(mktemp -d)"
trap 'rm -rf "$work"' EXIT
mkdir -p "$dist"
step() { printf '== %s (%s s)\n' "$1" "$SECONDS"; }

# Paths of this machine are not part of programs.
cargo_home="${CARGO_HOME:-$HOME/.cargo}"
printf -v CARGO_ENCODED_RUSTFLAGS '%s\x1f%s' "--remap-path-prefix=$PWD=/wavex" "--remap-path-prefix=$cargo_home=/cargo"
export CARGO_ENCODED_RUSTFLAGS
build() { cargo build --release --locked --bin wavex --target "$1"; }

# Packs a folder of `$work`: bytes depend on names, modes and contents only.
pack() {
    tar --sort=name --owner=0 --group=0 --numeric-owner --mtime="@$SOURCE_DATE_EPOCH" --format=gnu \
        -C "$work" -c "$1" | gzip -9n > "$dist/$1.tar.gz"
}

static="$quick"
linked="$quick"
if [ -z "$quick" ]; then
    [ -z "$(git status --porcelain)" ] || { echo 'files differ from the commit: commit or remove them' >&2; exit 1; }
    step 'tools'
    python3 -m venv "$work/venv"
    export PATH="$work/venv/bin:$PATH"
    pip install --quiet --disable-pip-version-check 'maturin[zig]>=1.9,<2' pyyaml
    step 'static program for Linux'
    build x86_64-unknown-linux-musl
    static="$target/x86_64-unknown-linux-musl/release/wavex"
    step 'program for Debian'
    build x86_64-unknown-linux-gnu
    linked="$target/x86_64-unknown-linux-gnu/release/wavex"
    step 'program for Windows'
    build x86_64-pc-windows-gnu
    windows="$target/x86_64-pc-windows-gnu/release/wavex.exe"
fi

step 'archives'
packaging/tree.sh "$static" "$work/wavex-$version-x86_64-linux"
pack "wavex-$version-x86_64-linux"
git archive --format=tar --prefix="wavex-$version/" "$WAVEX_COMMIT" | gzip -9n > "$dist/wavex-$version-source.tar.gz"
packaging/deb.sh "$linked" "$dist/wavex_${version}_amd64.deb"
if [ -z "$quick" ]; then
    folder="$work/wavex-$version-x86_64-windows"
    mkdir "$folder"
    cp -r README.md CHANGELOG.md SECURITY.md LICENSE-MIT LICENSE-APACHE docs jobs "$windows" "$folder"
    packaging/sbom.py "$folder/sbom.cdx.json" x86_64-pc-windows-gnu
    "$linked" completions powershell > "$folder/wavex.ps1"
    find "$folder" -exec touch -h -d "@$SOURCE_DATE_EPOCH" {} +
    (cd "$work" && python3 -m zipfile -c "$dist/$(basename "$folder").zip" "$(basename "$folder")")

    step 'wheel'
    # Zig links against any version of glibc: 2.17 of 2012 is the oldest that Rust supports.
    (cd python && maturin build --quiet --release --locked --zig --target x86_64-unknown-linux-gnu \
        --compatibility manylinux2014 --out "$dist")
fi

step 'bill of materials, notes, recipes, checksums'
packaging/sbom.py "$dist/wavex-$version.cdx.json"
packaging/recipes.py fill "$dist"
(cd "$dist" && sha256sum -- * > "$work/SHA256SUMS" && mv "$work/SHA256SUMS" .)

if [ -z "$quick" ]; then
    step 'everything in clean roots'
    packaging/check_static.sh "$dist/wavex-$version-x86_64-linux.tar.gz" "$linked"
    packaging/check_wheel.sh "$dist"/wavex-"$version"-*.whl "$linked"
    packaging/check_windows.sh "$dist/wavex-$version-x86_64-windows.zip" "$linked"
    packaging/check_deb.sh "$dist/wavex_${version}_amd64.deb"
fi
step "$dist"
(cd "$dist" && sha256sum --quiet -c SHA256SUMS && du -k --apparent-size -- *)
