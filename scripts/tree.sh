#!/usr/bin/env bash
# Adds the other files of a package to PREFIX/bin/heliosplat: manual pages, completions of shells, guides, licences.
#
# Usage: scripts/tree.sh PREFIX
set -euo pipefail
tree=$(realpath "${1:?}")
cd "$(dirname "$0")/.."
umask 022

program=$tree/bin/heliosplat
mkdir -p "$tree/share/man/man1"
"$program" man --out "$tree/share/man/man1" >/dev/null
find "$tree/share/man" -type f -exec gzip -9n {} +
for shell in bash zsh fish; do
  case $shell in
    bash) place=bash-completion/completions/heliosplat ;;
    zsh) place=zsh/vendor-completions/_heliosplat ;;
    fish) place=fish/vendor_completions.d/heliosplat.fish ;;
  esac
  mkdir -p "$(dirname "$tree/share/$place")"
  "$program" completions "$shell" >"$tree/share/$place"
done
doc="$tree/share/doc/heliosplat"
mkdir -p "$doc"
gzip -9nc CHANGELOG.md >"$doc/changelog.gz"
cp -r docs/guide "$doc/guide"
cat LICENSE-MIT - LICENSE-APACHE >"$doc/copyright" <<<'
---- or, at your choice ----
'
