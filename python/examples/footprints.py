"""Outlines buildings of a run as polygons with heights: raised ground that is no vegetation, as GeoJSON in longitudes and latitudes.

usage: python footprints.py RUN OUT.geojson        (pip install "heliosplat[raster]" scipy shapely)

RUN has its products (`heliosplat products RUN`). A building is at least 2.5 m high, 2 m wide and 20 m² large. Buildings that touch are one
polygon. Without a vegetation index trees cannot be told from buildings: then the script refuses. docs/lab/terrain.md has its errors.
"""

import json
import sys
from pathlib import Path

import numpy as np
import rasterio.features
import rasterio.transform
import rasterio.warp
from scipy import ndimage
from shapely.geometry import mapping, shape

import heliosplat

LEAST_HEIGHT_M, LEAST_WIDTH_M, LEAST_AREA_M2 = 2.5, 2.0, 20.0


def main(run_folder, out):
    run = heliosplat.open_run(run_folder)
    if "vegetation" not in run.products:
        sys.exit(f"{run_folder} has no vegetation.tif: its images have no near infrared, and trees would be buildings")
    ndsm = run.raster("ndsm")
    height = np.asarray(ndsm)
    x0, dx, _, y0, _, dy = ndsm.transform
    # Comparisons with unknown heights are false.
    raised = (height > LEAST_HEIGHT_M) & ~(np.asarray(run.raster("vegetation"), dtype=float) == 1)
    reach = max(1, round(LEAST_WIDTH_M / (2.0 * dx)))
    buildings = ndimage.binary_fill_holes(ndimage.binary_opening(raised, iterations=reach))
    labels, count = ndimage.label(buildings)
    transform = rasterio.transform.Affine(dx, 0.0, x0, 0.0, dy, y0)
    crs, features = f"EPSG:{ndsm.epsg}", []
    for geometry, label in rasterio.features.shapes(labels.astype(np.int32), mask=buildings, transform=transform):
        outline = shape(geometry).simplify(dx)
        if outline.area < LEAST_AREA_M2:
            continue
        of_roof = height[labels == label]
        median, highest = np.nanpercentile(of_roof, [50, 98])
        properties = {"height_m": round(float(median), 1), "highest_m": round(float(highest), 1), "area_m2": round(outline.area, 1)}
        lonlat = rasterio.warp.transform_geom(crs, "EPSG:4326", mapping(outline), precision=7)
        features.append({"type": "Feature", "properties": properties, "geometry": lonlat})
    Path(out).write_text(json.dumps({"type": "FeatureCollection", "features": features}), encoding="utf-8")
    print(f"{out}: {len(features)} buildings of {sum(f['properties']['area_m2'] for f in features):.0f} m²")


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    main(*sys.argv[1:])
