#!/usr/bin/env python3
"""Errors of the ground (dtm.tif) beside other ground filters on the same surface model, as one table.

usage: compare_dtm.py RUN TRUTH [RUN TRUTH ...]

RUN is a run with products (`heliosplat products RUN`), TRUTH the truth of its scene: dsm.tif, class(es).tif and, where `synth` made it,
dtm.tif. Without dtm.tif the truth below buildings is interpolated from the ground around them. The filters that are installed run with
their defaults: bulldozer (`pip install bulldozer-dtm`), CSF (`pip install cloth-simulation-filter`), remove_off_terrain_objects of
Whitebox (`pip install whitebox-workflows`). Needs rasterio and scipy.
"""

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import rasterio
from rasterio.warp import Resampling, reproject
from scipy.interpolate import griddata

# Codes of ground (roads included) and buildings: LAS codes where `synth` wrote them, else those of the rendered cities.
CODES = {"classes.tif": ([2, 11], [6]), "class.tif": ([0], [1])}


def read(path):
    with rasterio.open(path) as file:
        values = file.read(1, masked=True).astype(float).filled(np.nan)
        return values, file.transform, file.crs


def onto(path, like, nearest=False):
    """A raster on the grid of another; NaN where it is unknown."""
    values, transform, crs = read(path)
    target, to_transform, to_crs = like
    out = np.full(target.shape, np.nan)
    how = Resampling.nearest if nearest else Resampling.bilinear
    reproject(values, out, src_transform=transform, src_crs=crs, dst_transform=to_transform, dst_crs=to_crs,
              src_nodata=np.nan, dst_nodata=np.nan, resampling=how)
    return out


def spanned(values, at):
    """Values interpolated linearly between the cells of `at`, from the nearest one outside of them."""
    here, everywhere = np.argwhere(at), np.argwhere(np.ones_like(at))
    out = griddata(here, values[at], everywhere, "linear")
    near = griddata(here, values[at], everywhere, "nearest")
    return np.where(np.isnan(out), near, out).reshape(values.shape)


def bulldozer(dsm, work):
    program = Path(sys.executable).with_name("bulldozer")
    if not (program.is_file() or shutil.which("bulldozer")):
        return None
    command = [str(program if program.is_file() else "bulldozer"), "-dsm", str(dsm), "-out", str(work)]
    subprocess.run(command, check=True, capture_output=True)
    return next(work.rglob("*dtm*.tif"))


def csf(dsm, work):
    try:
        import CSF
    except ImportError:
        return None
    like = read(dsm)
    values, transform, crs = like
    known = np.isfinite(values)
    rows, cols = np.nonzero(known)
    x, y = transform * (cols + 0.5, rows + 0.5)
    cloth = CSF.CSF()
    cloth.setPointCloud(np.c_[x - x.min(), y - y.min(), values[known]])
    ground, other = CSF.VecInt(), CSF.VecInt()
    cloth.do_filtering(ground, other, False)
    ground = np.array(ground)
    at = np.zeros(values.shape, bool)
    at[rows[ground], cols[ground]] = True
    return write(work / "csf.tif", spanned(values, at), transform, crs)


def whitebox(dsm, work):
    try:
        import whitebox_workflows
    except ImportError:
        return None
    environment = whitebox_workflows.WbEnvironment()
    _, transform, crs = read(dsm)
    ground = environment.remove_off_terrain_objects(environment.read_raster(str(dsm))).to_numpy()
    return write(work / "whitebox.tif", np.where(ground < -9000, np.nan, ground), transform, crs)


def write(path, values, transform, crs):
    height, width = values.shape
    values = np.where(np.isfinite(values), values, -9999).astype("float32")
    with rasterio.open(path, "w", "GTiff", width, height, 1, crs, transform, "float32", -9999) as file:
        file.write(values, 1)
    return path


def errors(run, truth):
    dsm = run / "dsm.tif"
    like = read(dsm)
    name = next(name for name in CODES if (truth / name).is_file())
    classes = onto(truth / name, like, nearest=True)
    is_ground, is_building = (np.isin(classes, codes) for codes in CODES[name])
    if (truth / "dtm.tif").is_file():
        ground = onto(truth / "dtm.tif", like)
    else:
        surface = onto(truth / "dsm.tif", like)
        ground = spanned(surface, is_ground & np.isfinite(surface))
    known = np.isfinite(like[0]) & np.isfinite(ground)
    with tempfile.TemporaryDirectory() as temporary:
        found = {"surface": lambda *_: dsm, "heliosplat": lambda *_: run / "products" / "dtm.tif"}
        for name, filter in {**found, "bulldozer": bulldozer, "CSF": csf, "Whitebox": whitebox}.items():
            work = Path(temporary) / name
            work.mkdir()
            path = filter(dsm, work)
            if path is None:
                continue
            error = np.abs(onto(path, like) - ground)
            means = [np.nanmean(error[known & of]) for of in (is_ground, is_building)]
            shares = [np.mean(np.isfinite(error[known & of])) for of in (is_ground, is_building)]
            print(f"| {run.name} | {name} | {means[0]:.2f} | {means[1]:.2f} | {100 * min(shares):.0f} % |", flush=True)


def main():
    if len(sys.argv) < 3 or len(sys.argv) % 2 == 0:
        sys.exit(__doc__)
    print("| run | filter | MAE of ground, m | below buildings, m | cells known |\n|---|---|---|---|---|")
    for run, truth in zip(sys.argv[1::2], sys.argv[2::2]):
        errors(Path(run), Path(truth))


if __name__ == "__main__":
    main()
