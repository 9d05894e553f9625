#!/usr/bin/env bash
# Runs the QGIS plugin without a window: `qgis_process` inspects a synthetic pair (or the scene given), makes a surface model of it, trains the
# pair, counts hours of sun, relights, and stops a run that is cancelled; the layer file of products is opened by QGIS.
#
# Usage: scripts/test_qgis.sh [SCENE [WEST,SOUTH,EAST,NORTH]]
#
# Needs target/release/heliosplat and QGIS: apt-get install --no-install-recommends qgis. `.ci/run` runs it where QGIS is installed.
set -euo pipefail
cd "$(dirname "$0")/.."
export HELIOSPLAT="$PWD/target/release/heliosplat" QGIS_PLUGINPATH="$PWD/qgis" QT_QPA_PLATFORM=offscreen PYTHONWARNINGS=ignore
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
export HOME="$work/home" XDG_RUNTIME_DIR="$work"
mkdir -p "$HOME"

# Debian's wrapper of 3.22 passes an option that the program does not know.
process=$(command -v qgis_process.bin || command -v qgis_process) || { echo "skipped: no qgis_process" >&2; exit 0; }
[ -x "$HELIOSPLAT" ] || { echo "build target/release/heliosplat first: make build" >&2; exit 1; }
say() { printf '\n== %s\n' "$*"; }

small="$work/scene"
"$HELIOSPLAT" synth satellite --site tiny --views 2 --seed 1 --out "$small" >/dev/null
scene="$small"
[ $# -gt 0 ] && scene=$(realpath "$1")
extent=()
# QGIS writes extents as west, east, south, north.
[ $# -gt 1 ] && IFS=, read -r w s e n <<<"$2" && extent=("EXTENT=$w,$e,$s,$n [EPSG:4326]")

say plugin
"$process" plugins enable heliosplat_qgis >/dev/null 2>&1
"$process" list 2>/dev/null | grep -A5 '^heliosplat$'

say inspect
"$process" run heliosplat:inspect -- SCENE="$scene" OUTPUT="$work/report.json" >"$work/log" 2>&1 || { tail "$work/log"; exit 1; }
grep '^IMAGES:' "$work/log"

say 'surface model from a sweep'
"$process" run heliosplat:dsm_from_sweep -- SCENE="$scene" "${extent[@]}" OUTPUT="$work/dsm.tif" >"$work/log" 2>&1 || { tail "$work/log"; exit 1; }
grep '^OUTPUT:' "$work/log"
gdalinfo -stats "$work/dsm.tif" 2>/dev/null | grep -E "Size is|Description|MINIMUM=" || true

say 'a fault is told'
if "$process" run heliosplat:relight -- RUN="$work/home" OUTPUT="$work/relit.tif" >"$work/log" 2>&1; then
  echo "relighting no run succeeded" >&2
  exit 1
fi
grep -i 'not a finished run' "$work/log" || { tail "$work/log"; exit 1; }

say 'cancel'
/usr/bin/python3 qgis/test_child.py "$HELIOSPLAT" "$scene"

say 'train, with products'
run="$work/run"
"$process" run heliosplat:train -- SCENE="$small" PRESET=0 RUN="$run" >"$work/log" 2>&1 || { tail "$work/log"; exit 1; }
grep '^DSM:\|^RUN:' "$work/log"
test -s "$run/model.ply" -a -s "$run/dsm.tif"

say 'hours of sun'
"$process" run heliosplat:sun_hours -- RUN="$run" FROM=2016-06-21 FOLDER="$work/hours" >"$work/log" 2>&1 || { tail "$work/log"; exit 1; }
grep "^SUN_HOURS:" "$work/log"
gdalinfo -stats "$work/hours/sun_hours.tif" | grep -E "MINIMUM=|MAXIMUM=|FROM="

say relight
"$process" run heliosplat:relight -- RUN="$run" AZIMUTH=250 ELEVATION=35 OUTPUT="$work/relit.tif" >"$work/log" 2>&1 || { tail "$work/log"; exit 1; }
test -s "$work/relit.tif" -a -s "$work/relit_shadow.tif"

say layers
/usr/bin/python3 qgis/test_layers.py "$run/products"
