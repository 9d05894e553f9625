#!/usr/bin/env bash
# Builds the Python wheel, installs it into an empty virtual environment and runs its tests and the example notebook.
#
# Usage: scripts/test_python.sh [--speed]     (--speed: also the comparison of rates with rpcm, on a machine that does nothing else)
#
# Needs Rust, Python 3.10 or newer with venv, and PyPI. Where target/release/heliosplat is built, runs are opened and relit as well.
set -euo pipefail
cd "$(dirname "$0")/.."
export PATH="$HOME/.cargo/bin:$PATH"

marks='not speed'
[ "${1:-}" = --speed ] && marks=''
readonly EMPTY=target/python/empty

mkdir -p target/python
rm -rf "$EMPTY"
scripts/wheel.sh target/wheels
wheel=$(ls target/wheels/heliosplat-*.whl)
if unzip -p "$wheel" 'heliosplat/*.so' 2>/dev/null | grep -aq 'libgdal'; then
  echo "the wheel links GDAL" >&2
  exit 1
fi

python3 -m venv "$EMPTY"
"$EMPTY/bin/pip" install --quiet --disable-pip-version-check "$wheel"
# What the wheel itself needs is there now, and nothing else: numpy.
"$EMPTY/bin/python" -c 'import heliosplat; print(heliosplat.sun_position("2026-06-21T09:00Z", 37.58, 36.91))'
"$EMPTY/bin/pip" install --quiet --disable-pip-version-check "$wheel[test]" rpcm mypy

if [ -x target/release/heliosplat ]; then
  export HELIOSPLAT="$PWD/target/release/heliosplat" HELIOSPLAT_TEST_RUN="$PWD/target/python/run"
  if [ ! -d "$HELIOSPLAT_TEST_RUN/products" ]; then
    rm -rf "$HELIOSPLAT_TEST_RUN" target/python/scene
    "$HELIOSPLAT" synth satellite --site tiny --views 4 --seed 1 --out target/python/scene >/dev/null
    "$HELIOSPLAT" train target/python/scene --preset fast --set train.iterations=60 --overwrite --out "$HELIOSPLAT_TEST_RUN" >/dev/null
    "$HELIOSPLAT" products "$HELIOSPLAT_TEST_RUN" >/dev/null
  fi
fi
"$EMPTY/bin/python" -m pytest -q -m "$marks" python/tests
"$EMPTY/bin/python" -m mypy --strict -p heliosplat
