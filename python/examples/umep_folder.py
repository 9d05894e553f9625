"""Makes a folder for UMEP and SOLWEIG of a run: DSM, DEM, CDSM, wall heights and aspects, and svfs.zip, by UMEP's own functions.

usage: python umep_folder.py RUN OUT        (pip install "heliosplat[raster]" umep scipy; GPL, so that it stays a package of its own)

RUN has its products (`heliosplat products RUN`). UMEP takes no unknown cells: holes of the surface are filled, and the rasters are cut to
the largest rectangle that is known. DSM is ground and buildings, DEM the ground, CDSM the height of vegetation above ground.
"""

import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

import heliosplat


def largest_rectangle(known):
    """First and one past last row and column of the largest rectangle of known cells."""
    best, heights = (0, (0, 0, 0, 0)), np.zeros(known.shape[1] + 1, dtype=int)
    for row, line in enumerate(known):
        heights[:-1] = np.where(line, heights[:-1] + 1, 0)
        stack = []
        for col, height in enumerate(heights):
            left = col
            while stack and stack[-1][1] >= height:
                left, high = stack.pop()
                best = max(best, (high * (col - left), (row + 1 - high, row + 1, left, col)))
            stack.append((left, height))
    return best[1]


def cut(grid, values, rectangle, name):
    """A part of a grid with other values."""
    top, bottom, left, right = rectangle
    x0, dx, _, y0, _, dy = grid.transform
    part = np.ascontiguousarray(values[top:bottom, left:right], dtype=np.float32)
    return replace(grid, values=part[np.newaxis], bands=(name,), transform=(x0 + left * dx, dx, 0.0, y0 + top * dy, 0.0, dy))


def main(run_folder, out):
    from umep.skyviewfactor_algorithm import generate_svf
    from umep.wall_heightaspect_algorithm import generate_wall_hts

    run, out = heliosplat.open_run(run_folder), Path(out)
    out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        dsm = heliosplat.dsm(run_folder, Path(folder, "filled.tif"), fill=True, progress=False)
    dtm = run.raster("dtm")
    if (dsm.transform, dsm.shape) != (dtm.transform, dtm.shape):
        sys.exit("products on another grid: run `heliosplat products` without --gsd and --crs")
    surface, ground = np.asarray(dsm), np.asarray(dtm)
    ground = np.fmin(np.where(np.isfinite(ground), ground, surface), surface)
    is_leaf = np.asarray(run.raster("vegetation"), dtype=float) == 1 if "vegetation" in run.products else np.zeros(surface.shape, bool)
    rectangle = largest_rectangle(np.isfinite(surface))
    for name, values in (
        ("DSM", np.where(is_leaf, ground, surface)),
        ("DEM", ground),
        ("CDSM", np.where(is_leaf, surface - ground, 0.0)),
    ):
        cut(dsm, values, rectangle, name.lower()).to_geotiff(out / f"{name}.tif")
    top, bottom, left, right = rectangle
    x0, dx, _, y0, _, dy = dsm.transform
    box = [x0 + left * dx, y0 + bottom * dy, x0 + right * dx, y0 + top * dy]
    generate_wall_hts(str(out / "DSM.tif"), box, str(out), wall_limit=2)
    generate_svf(str(out / "DSM.tif"), box, str(out), dem_path=str(out / "DEM.tif"), cdsm_path=str(out / "CDSM.tif"))


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    main(*sys.argv[1:])
