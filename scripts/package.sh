#!/usr/bin/env bash
# Makes a Debian package of the program in target/release, with manual pages and completions of shells.
#
# Usage: scripts/package.sh [OUT]     (default: target/packages; build the program first: make build)
#
# The package depends on the shared libraries that the program was linked to here, so it fits the release of Debian or Ubuntu it was made on;
# scripts/portable.sh makes packages for other systems. The same program gives the same bytes.
set -euo pipefail
cd "$(dirname "$0")/.."

readonly PROGRAM=target/release/heliosplat OUT=$(realpath -m "${1:-target/packages}")
[ -x "$PROGRAM" ] || { echo "build $PROGRAM first: make build" >&2; exit 1; }
command -v dpkg-deb >/dev/null && command -v dpkg-shlibdeps >/dev/null || { echo "needs dpkg-deb and dpkg-shlibdeps: apt-get install dpkg-dev" >&2; exit 1; }
version=$("$PROGRAM" --version | awk '{print $2}')
architecture=$(dpkg --print-architecture)
export SOURCE_DATE_EPOCH=${SOURCE_DATE_EPOCH:-$(git log -1 --format=%ct 2>/dev/null || echo 0)}
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
umask 022

mkdir -p "$work/debian" "$work/package/DEBIAN" "$OUT"
install -D -m 755 -s "$PROGRAM" "$work/package/usr/bin/heliosplat"
scripts/tree.sh "$work/package/usr"
printf 'Source: heliosplat\n\nPackage: heliosplat\nArchitecture: any\n' >"$work/debian/control"
depends=$(cd "$work" && dpkg-shlibdeps -O package/usr/bin/heliosplat 2>/dev/null | sed -n 's/^shlibs:Depends=//p')
cat >"$work/package/DEBIAN/control" <<CONTROL
Package: heliosplat
Version: $version
Architecture: $architecture
Maintainer: The heliosplat authors <heliosplat@localhost>
Installed-Size: $(du -sk "$work/package/usr" | cut -f1)
Depends: $depends
Recommends: proj-data
Section: science
Priority: optional
Description: surface models from satellite images, with their shadows explained
 Makes a digital surface model from satellite images of several dates with RPC
 cameras, and images of the same ground under any sun, shadow masks, albedo, a
 point cloud and STAC metadata.
CONTROL
(cd "$work/package" && find usr -type f -exec md5sum {} + | LC_ALL=C sort -k2 >DEBIAN/md5sums)
deb="$OUT/heliosplat_${version}_$architecture.deb"
dpkg-deb --root-owner-group --build "$work/package" "$deb.part" >/dev/null
mv "$deb.part" "$deb"
ls -l "$deb"
