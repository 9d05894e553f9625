#!/usr/bin/env bash
# Builds the wheel of the Python module for this system. The wheel of scripts/portable.sh fits other systems, and carries the program.
#
# Usage: scripts/wheel.sh [OUT]     (default: target/wheels)
set -euo pipefail
cd "$(dirname "$0")/.."
export PATH="$HOME/.cargo/bin:$PATH"

readonly OUT=${1:-target/wheels} TOOLS=target/python/tools
if ! [ -x "$TOOLS/bin/maturin" ]; then
  python3 -m venv "$TOOLS"
  "$TOOLS/bin/pip" install --quiet --disable-pip-version-check 'maturin>=1.9.4,<2'
fi
mkdir -p "$OUT"
rm -f "$OUT"/heliosplat-*.whl
"$TOOLS/bin/maturin" build --release --locked --manifest-path python/Cargo.toml --out "$OUT"
