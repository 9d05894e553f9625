#!/usr/bin/env python3
"""Write the licences of everything that a portable package carries: shared libraries, their data, and Rust crates.

Usage: scripts/third_party.py LIBRARIES OUT     (LIBRARIES: the folder of shared libraries of scripts/portable.sh)

A library that `CARRIED` does not name is an error. Texts of libraries are those that Debian 12 collected (libgdal-dev
installs them); texts of crates come from their sources. Standard library only.
"""

import json
import re
import subprocess
import sys
from pathlib import Path

# Names of the files up to the first hyphen or dot, project, version in rasterio 1.5.2, licence, Debian's package, source.
CARRIED = [
    ("libgdal", "GDAL", "3.12.2", "MIT", "libgdal32", "https://gdal.org"),
    ("libproj", "PROJ", "9.8.1", "MIT", "libproj25", "https://proj.org"),
    ("libgeos libgeos_c", "GEOS", "3.14.1", "LGPL-2.1", "libgeos3.11.1", "https://libgeos.org"),
    ("libtiff", "libtiff", "4.7.1", "libtiff", "libtiff6", "https://libtiff.gitlab.io/libtiff"),
    ("libjpeg", "libjpeg-turbo", "3.1.4", "IJG AND BSD-3-Clause", "libjpeg62-turbo", "https://libjpeg-turbo.org"),
    ("libpng16", "libpng", "1.6.58", "libpng-2.0", "libpng16-16", "http://www.libpng.org"),
    ("libgif", "giflib", "5.2", "MIT", "libgif7", "https://giflib.sourceforge.net"),
    ("libwebp libsharpyuv", "libwebp", "1.6.0", "BSD-3-Clause", "libwebp7", "https://developers.google.com/speed/webp"),
    ("libopenjp2", "OpenJPEG", "2.5.4", "BSD-2-Clause", "libopenjp2-7", "https://www.openjpeg.org"),
    ("libLerc", "LERC", "4", "Apache-2.0", "liblerc4", "https://github.com/Esri/lerc"),
    ("libaec libsz", "libaec", "1.1.7", "BSD-2-Clause", "libaec0", "https://gitlab.dkrz.de/k202009/libaec"),
    ("libblosc", "Blosc", "1.21.6", "BSD-3-Clause", "libblosc1", "https://www.blosc.org"),
    ("libdeflate", "libdeflate", "1", "MIT", "libdeflate0", "https://github.com/ebiggers/libdeflate"),
    ("liblzma", "XZ Utils", "5.8.3", "0BSD", "liblzma5", "https://tukaani.org/xz"),
    ("libzstd", "Zstandard", "1.5.7", "BSD-3-Clause", "libzstd1", "https://facebook.github.io/zstd"),
    ("libhdf5 libhdf5_hl", "HDF5", "2.2.0", "BSD-3-Clause", "libhdf5-103-1", "https://www.hdfgroup.org"),
    ("libnetcdf", "netCDF", "4.10.1", "BSD-3-Clause", "libnetcdf19", "https://www.unidata.ucar.edu/software/netcdf"),
    ("libsqlite3", "SQLite", "3.53.1", "public domain", "libsqlite3-0", "https://sqlite.org"),
    ("libcurl", "curl", "8.20.0", "curl", "libcurl4", "https://curl.se"),
    ("libnghttp2", "nghttp2", "1.69.0", "MIT", "libnghttp2-14", "https://nghttp2.org"),
    ("libcrypto libssl", "OpenSSL", "3.6.2", "Apache-2.0", "libssl3", "https://openssl.org"),
    ("libjson", "JSON-C", "0.18", "MIT", "libjson-c5", "https://github.com/json-c/json-c"),
    ("libpcre2", "PCRE2", "10.47", "BSD-3-Clause", "libpcre2-8-0", "https://www.pcre.org"),
    ("libexpat", "Expat", "2.5.0", "MIT", "libexpat1", "https://libexpat.github.io"),
]

HEAD = """Heliosplat (MIT OR Apache-2.0) carries these works of others. The shared libraries are unmodified files of the package
rasterio 1.5.2 on PyPI, and Expat of Debian 12's source; each can be replaced by another build of it. Data: those of GDAL
(MIT) and of PROJ (MIT), with the EPSG Geodetic Parameter Dataset (https://epsg.org/terms-of-use.html). Linked into the
program: the standard library of Rust (MIT OR Apache-2.0), start-up code of Zig (MIT), and the crates below.
"""

LICENCE_FILE = re.compile(r"(UN)?LICEN[CS]E|COPYING|COPYRIGHT|NOTICE", re.IGNORECASE)


def crates():
    """(name, version, licence, folder) of each crate of other authors in the program and the Python module."""
    command = ["cargo", "metadata", "--locked", "--format-version=1", "--filter-platform=x86_64-unknown-linux-gnu"]
    metadata = json.loads(subprocess.run(command, check=True, capture_output=True).stdout)
    packages = {package["id"]: package for package in metadata["packages"]}
    nodes = {node["id"]: node for node in metadata["resolve"]["nodes"]}
    seen, left = set(), [key for key, package in packages.items() if package["name"] in ("heliosplat", "heliosplat-python")]
    while left:
        key = left.pop()
        if key not in seen:
            seen.add(key)
            linked = (edge for edge in nodes[key]["deps"] if any(kind["kind"] is None for kind in edge["dep_kinds"]))
            left += [edge["pkg"] for edge in linked]
    found = (packages[key] for key in seen if packages[key]["source"])
    return sorted((p["name"], p["version"], p["license"], Path(p["manifest_path"]).parent) for p in found)


def texts_of_crate(folder):
    files = (path for path in sorted(folder.rglob("*")) if LICENCE_FILE.match(path.name) and path.is_file())
    return [path.read_text(errors="replace").strip() for path in files if path.suffix != ".rs"]


def main():
    libraries, out = Path(sys.argv[1]), Path(sys.argv[2])
    named = {name for row in CARRIED for name in row[0].split()}
    unknown = sorted(path.name for path in libraries.iterdir() if re.split(r"[-.]", path.name)[0] not in named)
    if unknown:
        sys.exit(f"no licence is stated for {', '.join(unknown)}")
    listed = crates()
    lines = [HEAD, "LIBRARIES\n"]
    lines += [f"{project} {version}: {licence}; {source}" for _, project, version, licence, _, source in CARRIED]
    lines += ["\nCRATES\n"] + [f"{name} {version}: {licence}" for name, version, licence, _ in listed]
    owners = {}
    for _, project, _, _, package, _ in CARRIED:
        text = Path(f"/usr/share/doc/{package}/copyright").read_text(errors="replace").strip()
        owners.setdefault(text, []).append(project)
    for licence in ("LGPL-2.1", "Apache-2.0"):
        owners.setdefault(Path(f"/usr/share/common-licenses/{licence}").read_text().strip(), []).append(licence)
    for name, version, _, folder in listed:
        for text in texts_of_crate(folder):
            owners.setdefault(text, []).append(f"{name} {version}")
    lines += [f"\n{'=' * 78}\n{', '.join(names)}\n{'=' * 78}\n\n{text}" for text, names in owners.items()]
    out.write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
