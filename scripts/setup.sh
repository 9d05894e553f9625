#!/usr/bin/env bash
# Makes a Debian 12 or Ubuntu machine ready to build heliosplat, and says what it installs. Running it again does nothing.
#
#   system packages   build-essential pkg-config libgdal-dev curl ca-certificates   (apt-get, with sudo unless root)
#   Rust toolchain    by rustup-init, whose hash is checked, into ~/.cargo, only where no cargo of the needed version is found;
#                     rustup checks the hashes of the toolchain itself
set -euo pipefail

readonly PACKAGES=(build-essential pkg-config libgdal-dev curl ca-certificates)
readonly RUSTUP=1.28.2
readonly RUST_MINOR=89 # rust-version of Cargo.toml: 1.89

say() { printf 'setup: %s\n' "$*"; }

as_root() {
  if [ "$(id -u)" -eq 0 ]; then "$@"; else sudo "$@"; fi
}

missing_packages() {
  local package
  for package in "${PACKAGES[@]}"; do
    if ! dpkg-query -W -f '${Status}' "$package" 2>/dev/null | grep -q 'install ok installed'; then
      printf '%s ' "$package"
    fi
  done
}

install_packages() {
  if ! command -v apt-get >/dev/null; then
    if command -v gdal-config >/dev/null && command -v cc >/dev/null; then
      say "no apt-get here, but a compiler and GDAL $(gdal-config --version) are"
      return
    fi
    say "no apt-get here: install a C compiler, pkg-config and GDAL 3.4 or newer with its headers, then run this again"
    exit 1
  fi
  local missing
  missing=$(missing_packages)
  [ -n "$missing" ] || return 0
  say "installing system packages: $missing"
  as_root apt-get -o DPkg::Lock::Timeout=300 update -qq
  # shellcheck disable=SC2086 # one word per package
  as_root env DEBIAN_FRONTEND=noninteractive apt-get -o DPkg::Lock::Timeout=300 install -y -qq --no-install-recommends $missing
}

has_rust() {
  local version
  version=$(cargo --version 2>/dev/null) || return 1
  version=${version#cargo 1.}
  version=${version%%.*}
  [ "$version" -ge "$RUST_MINOR" ] 2>/dev/null
}

install_rust() {
  export PATH="$HOME/.cargo/bin:$PATH"
  has_rust && return 0
  say "installing the stable Rust toolchain with rustup $RUSTUP into $HOME/.cargo"
  local machine hash folder
  machine=$(uname -m)
  case "$machine" in
    x86_64) hash=20a06e644b0d9bd2fbdbfd52d42540bdde820ea7df86e92e533c073da0cdd43c ;;
    aarch64) hash=e3853c5a252fca15252d07cb23a1bdd9377a8c6f3efa01531109281ae47f841c ;;
    *)
      say "no installer of Rust is known for $machine: install Rust 1.$RUST_MINOR or newer, then run this again"
      exit 1
      ;;
  esac
  folder=$(mktemp -d)
  curl --proto '=https' --tlsv1.2 -sSf -o "$folder/rustup-init" \
    "https://static.rust-lang.org/rustup/archive/$RUSTUP/$machine-unknown-linux-gnu/rustup-init"
  printf '%s  %s\n' "$hash" "$folder/rustup-init" | sha256sum --check --quiet
  chmod +x "$folder/rustup-init"
  "$folder/rustup-init" -y --profile minimal --component rustfmt --component clippy
  rm -r "$folder"
  if ! has_rust; then
    say "cargo is still older than 1.$RUST_MINOR: run 'rustup update stable'"
    exit 1
  fi
}

install_packages
install_rust
say "ready: $(cargo --version), GDAL $(gdal-config --version)"
