#!/usr/bin/env bash
# Makes the files of a release: .deb, portable tarball and wheel, and their SHA-256 sums, in target/release-files. Publishes nothing.
#
# Usage: scripts/release.sh VERSION     (as in Cargo.toml; CHANGELOG.md and CITATION.cff must have it too)
set -euo pipefail
cd "$(dirname "$0")/.."
export PATH="$HOME/.cargo/bin:$PATH"

version=${1:?usage: scripts/release.sh VERSION}
fail() { echo "release: $*" >&2; exit 1; }
grep -qx "version = \"$version\"" Cargo.toml || fail "Cargo.toml has another version"
grep -qx "version: $version" CITATION.cff || fail "CITATION.cff has another version"
grep -q "^## \[$version\]" CHANGELOG.md || fail "CHANGELOG.md has no section [$version]"
[ -z "$(git status --porcelain --untracked-files=no)" ] || fail "there are uncommitted changes"

readonly OUT=target/release-files
rm -rf "$OUT"
make build
scripts/package.sh "$OUT"
scripts/portable.sh "$OUT"
(cd "$OUT" && sha256sum -- * >SHA256SUMS && cat SHA256SUMS)
