#!/usr/bin/env bash
# Builds the Python wheel. Where target/release/heliosplat is built, the wheel carries it: `pip install` then gives the program, too.
#
# Usage: scripts/wheel.sh [OUT]     (default: target/wheels)
#
# The module needs numpy alone. The program needs the GDAL that it was linked to; on Debian 12 that is the package libgdal32.
set -euo pipefail
cd "$(dirname "$0")/.."
export PATH="$HOME/.cargo/bin:$PATH"

readonly OUT=${1:-target/wheels} TOOLS=target/python/tools PROGRAM=target/release/heliosplat
if ! [ -x "$TOOLS/bin/maturin" ] || ! [ -x "$TOOLS/bin/wheel" ]; then
  python3 -m venv "$TOOLS"
  "$TOOLS/bin/pip" install --quiet --disable-pip-version-check 'maturin>=1.9.4,<2' 'wheel>=0.45'
fi
mkdir -p "$OUT"
rm -f "$OUT"/heliosplat-*.whl
"$TOOLS/bin/maturin" build --release --locked --manifest-path python/Cargo.toml --out "$OUT"
[ -x "$PROGRAM" ] || exit 0

# maturin packs a module or a program, not both: a wheel's scripts are what pip puts into bin.
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
"$TOOLS/bin/wheel" unpack --dest "$work" "$OUT"/heliosplat-*.whl >/dev/null
tree=("$work"/heliosplat-*)
install -D -m 755 -s "$PROGRAM" "${tree[0]}/$(basename "${tree[0]}").data/scripts/heliosplat"
"$TOOLS/bin/wheel" pack --dest-dir "$OUT" "${tree[0]}" >/dev/null
