#!/usr/bin/env bash
# Installs a Debian package in a new root and uses it there; needs root and debootstrap.
#
#     packaging/check_deb.sh target/wavex.deb
set -euo pipefail
package="$(realpath "$1")"
root="$(mktemp -d)"
trap 'rm -rf "$root"' EXIT
# Programs of packages run as other users, too.
chmod 755 "$root"

debootstrap --variant=minbase --include=man-db bookworm "$root" > "$root.log" 2>&1 ||
    { tail -5 "$root.log"; exit 1; }
rm "$root.log"
cp "$package" "$root/wavex.deb"
inside() { chroot "$root" env -i HOME=/ PATH=/usr/sbin:/usr/bin:/sbin:/bin LC_ALL=C.UTF-8 "$@"; }
inside dpkg --install /wavex.deb > /dev/null
inside wavex doctor
inside wavex --quiet run --set job.output_dir=/out /usr/share/doc/wavex/jobs/demo.toml
inside sh -c 'ls /out/*.laz'
inside sh -c 'grep -q "pkg:cargo/laz@" /usr/share/doc/wavex/sbom.cdx.json'
inside sh -c 'man wavex-run | grep -q "wavex-run" && man wavex | grep -q "wavex-copc"'
echo "the package works in a root of $(du -sm "$root" | cut -f 1) MB"
