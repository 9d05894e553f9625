#!/usr/bin/env bash
# Makes a tarball and a Python wheel that run on x86-64 Linux with glibc 2.28 or newer (RHEL 8, Debian 10, Ubuntu 20.04) without an
# installed GDAL. Builds the program and the module in target/portable.
#
# Usage: scripts/portable.sh [OUT]     (default: target/packages)
#
# Zig links against the symbols of glibc 2.28. GDAL, PROJ, what they need and their data come from the wheel of rasterio, except Expat,
# which is compiled from Debian's source. PROJ finds ../share/proj beside its library, the program lib/heliosplat/share/gdal. Needs Debian
# 12 with libgdal-dev (for licences) and dpkg-dev, Rust, and PyPI; downloads 140 MB.
set -euo pipefail
cd "$(dirname "$0")/.."

readonly OUT=$(realpath -m "${1:-target/packages}") WORK=$PWD/target/portable GLIBC=2.28 TARGET=x86_64-unknown-linux-gnu
readonly RASTERIO=rasterio-1.5.2-cp313-cp313-manylinux_2_28_x86_64.whl
readonly RASTERIO_SHA256=be2d2a825d545e6c6e8b2aa0d67c963e9ffc44ce3cecbab4ffe95dc87c0fc0de
export GDAL_VERSION=3.12.2 GDAL_LIB_DIR=$WORK/link CARGO_TARGET_DIR=$WORK PATH="$WORK/tools/bin:$HOME/.cargo/bin:$PATH"
export SOURCE_DATE_EPOCH=${SOURCE_DATE_EPOCH:-$(git log -1 --format=%ct 2>/dev/null || echo 0)}
fail() { echo "portable: $*" >&2; exit 1; }
umask 022
mkdir -p "$WORK" "$OUT"

if ! cmp -s scripts/portable_tools.txt "$WORK/tools/installed.txt"; then
  rm -rf "$WORK/tools"
  python3 -m venv "$WORK/tools"
  pip install --quiet --disable-pip-version-check --no-deps --require-hashes --requirement scripts/portable_tools.txt
  cp scripts/portable_tools.txt "$WORK/tools/installed.txt"
fi

# GDAL, PROJ and their data.
if [ ! -f "$WORK/$RASTERIO" ]; then
  pip download --quiet --disable-pip-version-check --no-deps --only-binary :all: --platform manylinux_2_28_x86_64 --python-version 3.13 \
    --dest "$WORK" rasterio==1.5.2
fi
(cd "$WORK" && echo "$RASTERIO_SHA256  $RASTERIO" | sha256sum --check --quiet) || fail "$WORK/$RASTERIO has another hash"
rm -rf "$WORK"/{rasterio,link,tree}
unzip -q "$WORK/$RASTERIO" -d "$WORK/rasterio"
libraries=$WORK/rasterio/rasterio.libs
mkdir "$WORK/link"
ln -s "$libraries"/libgdal-*.so.* "$WORK/link/libgdal.so"

# Expat, which rasterio's wheel expects of the system, as manylinux allows: bare containers have none.
if [ ! -f "$WORK/libexpat.so.1" ]; then
  apt=$WORK/apt
  mkdir -p "$apt/lists/partial" "$apt/cache" "$apt/parts"
  # The sources of the packages that this machine installs.
  for list in /etc/apt/sources.list /etc/apt/sources.list.d/*; do
    [ -f "$list" ] && sed 's/^deb /deb-src /; s/^Types:.*/Types: deb-src/' "$list" >"$apt/parts/$(basename "$list" | sed 's/^sources.list$/main.list/')"
  done
  options=(-qq -o Dir::Etc::sourcelist=- -o "Dir::Etc::sourceparts=$apt/parts" -o "Dir::State::lists=$apt/lists" -o "Dir::Cache=$apt/cache")
  # The newest, else that of the release: not every mirror has the sources of updates.
  (cd "$apt" && apt-get "${options[@]}" update && for source in expat "expat/$(. /etc/os-release && echo "$VERSION_CODENAME")"; do
    apt-get "${options[@]}" source "$source" >/dev/null && break
  done)
  (cd "$apt"/expat-*/expat/lib && touch expat_config.h && python-zig cc -target "x86_64-linux-gnu.$GLIBC" -O2 -s -fPIC -shared -I. \
    -Wl,-soname,libexpat.so.1 -DHAVE_GETRANDOM -DXML_NS -DXML_DTD -DXML_CONTEXT_BYTES=1024 -DBYTEORDER=1234 \
    -o "$WORK/libexpat.so.1" xmlparse.c xmlrole.c xmltok.c)
fi

# The tree of both: bin, lib/heliosplat, share.
cargo zigbuild --release --locked --package heliosplat --target "$TARGET.$GLIBC"
tree=$WORK/tree
carried=$tree/lib/heliosplat
mkdir -p "$carried/share"
mv "$libraries" "$carried/lib"
install -m 644 "$WORK/libexpat.so.1" "$carried/lib"
mv "$WORK/rasterio/rasterio/gdal_data" "$carried/share/gdal"
mv "$WORK/rasterio/rasterio/proj_data" "$carried/share/proj"
install -D -m 755 -s "$WORK/$TARGET/release/heliosplat" "$tree/bin/heliosplat"
# An RPATH holds for the libraries of libraries, too; a RUNPATH, which the linker writes, does not. The second folder is that of the
# libraries in a wheel that is not installed, for auditwheel.
# shellcheck disable=SC2016 # the loader replaces $ORIGIN
patchelf --force-rpath --set-rpath '$ORIGIN/../lib/heliosplat/lib:$ORIGIN/../data/lib/heliosplat/lib' "$tree/bin/heliosplat"
scripts/tree.sh "$tree"
scripts/third_party.py "$carried/lib" "$tree/share/doc/heliosplat/THIRDPARTY.txt"
newest=$(objdump -T "$tree/bin/heliosplat" "$carried"/lib/*.so* | grep -o 'GLIBC_[0-9.]*' | sort -uV | tail -1)
[ "$(printf '%s\n' "GLIBC_$GLIBC" "$newest" | sort -V | tail -1)" = "GLIBC_$GLIBC" ] || fail "a file needs $newest"

# The wheel: maturin packs the module; pip puts a wheel's scripts into bin, and its data into the folder above.
rm -rf "$WORK/wheel" "$OUT"/heliosplat-*-manylinux_*.whl
maturin build --release --locked --zig --target "$TARGET" --compatibility "manylinux_${GLIBC/./_}" --manifest-path python/Cargo.toml \
  --out "$WORK/wheel"
wheel unpack --dest "$WORK/wheel" "$WORK"/wheel/*.whl >/dev/null
unpacked=$(echo "$WORK"/wheel/heliosplat-*/)
data="$unpacked/$(basename "$unpacked").data"
mkdir -p "$data/data"
cp -r "$tree/bin" "$data/scripts"
cp -r "$tree/lib" "$tree/share" "$data/data"
wheel pack --dest-dir "$OUT" "$unpacked" >/dev/null
auditwheel show "$OUT"/heliosplat-*-manylinux_*.whl | tr '\n' ' ' | grep -q "platform tag: \"manylinux_${GLIBC/./_}_x86_64\"" ||
  fail "the wheel does not fit its name"

# The tarball.
version=$("$tree/bin/heliosplat" --version | awk '{print $2}')
name="heliosplat-$version-linux-x86_64-glibc$GLIBC"
cp LICENSE-MIT LICENSE-APACHE README.md "$tree"
echo 'Run bin/heliosplat here, link to it, or copy bin, lib and share together into /usr/local or ~/.local.' >"$tree/INSTALL"
tarball="$OUT/$name.tar.gz"
tar -C "$WORK" --transform "s:^tree:$name:" --sort=name --owner=0 --group=0 --numeric-owner --mtime="@$SOURCE_DATE_EPOCH" -cf - tree |
  gzip -9n >"$tarball.part"
mv "$tarball.part" "$tarball"
ls -l "$tarball" "$OUT"/heliosplat-*-manylinux_*.whl
