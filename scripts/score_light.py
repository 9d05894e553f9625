"""Scores of light that need more truth than `evaluate` reads. Needs numpy, scipy and rasterio; scenes of `synth satellite`, or laid out as such.

usage: score_light.py level RUN SCENE [ELEVATION_DEG ...]    (default: 5 and 12 degrees; $HELIOSPLAT: the program, default heliosplat)
       score_light.py hours PRODUCTS SCENE                   (PRODUCTS: `heliosplat products RUN --sun-hours DAY`)
       score_light.py albedo PRODUCTS SCENE                  (SCENE of one date)

level: share of level ground and level roofs, in the sun and three cells and more from any shadow, that `relight` calls shadow, under suns at four
  azimuths. Level: the true altitudes of 3 x 3 cells differ by 0.3 m at most. True shadows are cast by the true DSM, continued by that of the run.
hours: share of cells whose hours of sun are within 5 % of the longest day of the truth, and mean difference, by class.
albedo: albedo inside the true shadows of the images' sun over albedo of sunlit ground within 6 m, each over the true albedo; ground and roads, 1.5 m
  and more from the border of a shadow; ratio of means, band by band.
"""
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import rasterio
from scipy.ndimage import binary_dilation, maximum_filter, minimum_filter, uniform_filter

# Classes: LAS codes of `classes.tif`, or those of `class.tif` (0 ground, 1 building, 2 tree, 3 car).
GROUND, ROOFS, TREES = (2, 11), (6,), (5,)
LAS_OF = {0: 2, 1: 6, 2: 5, 3: 1}


def read(path):
    """Bands with NaN where nothing is known, west, north, cell."""
    with rasterio.open(path) as f:
        bands = f.read().astype(float)
        if f.nodata is not None:
            bands[bands == f.nodata] = np.nan
        return bands, f.transform.c, f.transform.f, f.transform.a


def on(truth, other):
    """`other` on the grid of `truth`; both are aligned."""
    _, west, north, cell = truth
    bands, w, n, _ = other
    col, row = round((west - w) / cell), round((n - north) / cell)
    rows, cols = truth[0].shape[1:]
    out = np.full((len(bands), rows, cols), np.nan)
    r0, c0 = max(0, -row), max(0, -col)
    part = bands[:, max(0, row):row + rows, max(0, col):col + cols]
    out[:, r0:r0 + part.shape[1], c0:c0 + part.shape[2]] = part
    return out


def classes_of(scene):
    truth = Path(scene) / "truth"
    if (truth / "classes.tif").exists():
        return read(truth / "classes.tif")[0][0]
    kinds = read(truth / "class.tif")[0][0]
    return np.select([kinds == kind for kind in LAS_OF], list(LAS_OF.values()), np.nan)


def cast(z, cell, azimuth_deg, elevation_deg):
    """Where the altitudes `z` throw shadow: the sun's line from a cell meets a higher one."""
    azimuth, slope = np.radians(azimuth_deg), np.tan(np.radians(elevation_deg))
    east, north = np.sin(azimuth), np.cos(azimuth)
    z = np.where(np.isfinite(z), z, np.nanmin(z))
    shadow = np.zeros(z.shape, bool)
    rows, cols = np.indices(z.shape)
    steps = int(np.ceil((z.max() - z.min()) / slope / cell)) + 1
    for k in range(1, steps):
        r, c = np.round(rows - k * north).astype(int), np.round(cols + k * east).astype(int)
        inside = (r >= 0) & (c >= 0) & (r < z.shape[0]) & (c < z.shape[1])
        if not inside.any():
            break
        higher = z[np.clip(r, 0, z.shape[0] - 1), np.clip(c, 0, z.shape[1] - 1)] - k * cell * slope > z + 0.05
        shadow |= inside & higher
    return shadow


def level(run, scene, elevations):
    truth, ours = read(Path(scene) / "truth" / "dsm.tif"), read(Path(run) / "dsm.tif")
    z, cell, kinds = truth[0][0], truth[3], classes_of(scene)
    flat = maximum_filter(z, 3) - minimum_filter(z, 3) < 0.3
    around = ours[0][0] + np.nanmedian(z - on(truth, ours)[0])
    row, col = round((ours[2] - truth[2]) / cell), round((truth[1] - ours[1]) / cell)
    around[row:row + z.shape[0], col:col + z.shape[1]] = z
    for elevation in elevations:
        counts = {"ground": [0, 0], "roofs": [0, 0]}
        for azimuth in (110, 150, 190, 230):
            with tempfile.TemporaryDirectory() as folder:
                out = Path(folder) / "relit.tif"
                command = [os.environ.get("HELIOSPLAT", "heliosplat"), "relight", run, "--out", out, "--sun", f"{azimuth},{elevation}"]
                subprocess.run([str(part) for part in command], check=True, capture_output=True)
                mask = on(truth, read(next(path for path in Path(folder).glob("*shadow*.tif"))))[0]
            shadow = cast(around, cell, azimuth, elevation)[row:row + z.shape[0], col:col + z.shape[1]]
            lit = flat & ~binary_dilation(shadow, iterations=3) & np.isfinite(mask)
            for name, which in (("ground", GROUND), ("roofs", ROOFS)):
                chosen = lit & np.isin(kinds, which)
                counts[name][0] += int((mask[chosen] > 0.5).sum())
                counts[name][1] += int(chosen.sum())
        said = ", ".join(f"{name} {100 * wrong / max(1, all_):.1f} % of {all_}" for name, (wrong, all_) in counts.items())
        print(f"sun at {elevation:g} degrees, lit and called shadow: {said}")


def hours(products, scene):
    truth = read(Path(scene) / "truth" / "sun_hours.tif")
    ours, kinds = on(truth, read(Path(products) / "sun_hours.tif"))[0], classes_of(scene)
    day = np.nanmax(truth[0][0])
    for name, which in (("ground and roads", GROUND), ("roofs", ROOFS), ("trees", TREES), ("all", (2, 5, 6, 9, 11))):
        d = (ours - truth[0][0])[np.isin(kinds, which)]
        d = d[np.isfinite(d)]
        print(f"{name}: {100 * (abs(d) < 0.05 * day).mean():.1f} % within {0.05 * day:.2f} h, mean {d.mean():+.2f} h, mean absolute {abs(d).mean():.2f} h")


def albedo(products, scene):
    truth = read(Path(scene) / "truth" / "albedo.tif")
    ours, kinds = on(truth, read(Path(products) / "albedo.tif")), classes_of(scene)
    z, cell = read(Path(scene) / "truth" / "dsm.tif")[0][0], truth[3]
    images = json.loads((Path(scene) / "truth" / "summary.json").read_text())["images"]
    suns = np.array([[image["sun_azimuth_deg"], image["sun_elevation_deg"]] for image in images])
    masks = [cast(z, cell, *sun) for sun in suns]
    # What stands beyond the truth may shade these.
    reach = (np.nanmax(z) - np.nanmin(z)) / np.tan(np.radians(suns[:, 1].min())) / cell
    azimuth = np.angle(np.exp(1j * np.radians(suns[:, 0])).mean())
    rows, cols = np.indices(z.shape)
    r, c = rows - reach * np.cos(azimuth), cols + reach * np.sin(azimuth)
    known = (r >= 0) & (c >= 0) & (r < z.shape[0]) & (c < z.shape[1])
    inside, outside = known & np.all(masks, axis=0), known & ~np.any(masks, axis=0)
    border = round(1.5 / cell)
    floor = known & np.isin(kinds, GROUND) & np.isfinite(ours).all(axis=0)
    shaded = floor & ~binary_dilation(~inside, iterations=border)
    sunlit = floor & ~binary_dilation(~outside, iterations=border)
    width = 2 * round(6 / cell) + 1
    near = uniform_filter(sunlit.astype(float), width)
    compared = shaded & (near > 1e-6)
    ratios = []
    for band, true in zip(ours, truth[0]):
        relative = np.where(np.isfinite(band), band, 0) / np.maximum(true, 1e-3)
        beside = uniform_filter(np.where(sunlit, relative, 0.0), width) / np.maximum(near, 1e-9)
        ratios.append(relative[compared].mean() / beside[compared].mean())
    print(f"albedo inside over beside: {', '.join(f'{ratio:.2f}' for ratio in ratios)} ({int(compared.sum())} cells)")


if __name__ == "__main__":
    what, *rest = sys.argv[1:] or [""]
    if what == "level" and len(rest) >= 2:
        level(rest[0], rest[1], [float(v) for v in rest[2:]] or [5.0, 12.0])
    elif what == "hours" and len(rest) == 2:
        hours(*rest)
    elif what == "albedo" and len(rest) == 2:
        albedo(*rest)
    else:
        sys.exit(__doc__)
