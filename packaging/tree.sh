#!/usr/bin/env bash
# Installs the program with manual pages, completions, documents and example jobs in a folder such as `/usr`.
#
#     packaging/tree.sh target/release/wavex FOLDER
set -euo pipefail
program="$(realpath "$1")"
tree="$(realpath -m "$2")"
cd "$(dirname "$0")/.."

install -D -m 755 "$program" "$tree/bin/wavex"
"$program" --quiet man "$tree/share/man/man1"
gzip -9n "$tree"/share/man/man1/*
completions() { mkdir -p "$tree/share/$(dirname "$2")" && "$program" completions "$1" > "$tree/share/$2"; }
completions bash bash-completion/completions/wavex
completions zsh zsh/vendor-completions/_wavex
completions fish fish/vendor_completions.d/wavex.fish
documents="$tree/share/doc/wavex"
mkdir -p "$documents"
cp -r README.md CHANGELOG.md SECURITY.md LICENSE-MIT LICENSE-APACHE docs jobs schemas "$documents"
python3 packaging/sbom.py "$documents/sbom.cdx.json" > /dev/null
find "$tree" -type d -exec chmod 755 {} +
find "$tree" -type f ! -path '*/bin/*' -exec chmod 644 {} +
