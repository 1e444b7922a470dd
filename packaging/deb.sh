#!/usr/bin/env bash
# Builds a Debian package of the release program, with manual pages, completions, documents and example jobs.
# With SOURCE_DATE_EPOCH set, the same inputs give the same bytes.
#
#     packaging/deb.sh target/release/wavex target/wavex.deb
set -euo pipefail
program="$(realpath "$1")"
package="$(realpath -m "$2")"
cd "$(dirname "$0")/.."

root="$(mktemp -d)"
trap 'rm -rf "$root"' EXIT
chmod 755 "$root"
packaging/tree.sh "$program" "$root/usr"
cat > "$root/usr/share/doc/wavex/copyright" << 'TEXT'
Format: https://www.debian.org/doc/packaging-manuals/copyright-format/1.0/
Upstream-Name: wavex

Files: *
Copyright: the wavex authors
License: MIT or Apache-2.0
TEXT
chmod 644 "$root/usr/share/doc/wavex/copyright"
# The oldest C library that has all functions which the program uses.
libc="$(objdump -T "$program" | grep -o 'GLIBC_2\.[0-9.]*' | sort -Vu | tail -1)"
mkdir "$root/DEBIAN"
cat > "$root/DEBIAN/control" << TEXT
Package: wavex
Version: $("$program" --version | cut -d ' ' -f 2)
Architecture: $(dpkg --print-architecture)
Maintainer: the wavex authors <wavex@example.org>
Depends: libc6 (>= ${libc#GLIBC_}), libgcc-s1
Installed-Size: $(du -sk --apparent-size "$root/usr" | cut -f 1)
Section: science
Priority: optional
Description: full-waveform lidar to point clouds with uncertainties
 Decomposes recorded waveforms of airborne laser scanners into returns with
 standard deviations and writes LAS, LAZ, COPC, Parquet and text, driven by a
 job file. Runs repeat to the bit.
TEXT
mkdir -p "$(dirname "$package")"
dpkg-deb --root-owner-group --build "$root" "$package" > /dev/null
echo "$package: $(du -k "$package" | cut -f 1) kB"
