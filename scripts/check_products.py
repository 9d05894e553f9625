#!/usr/bin/env python3
"""Opens what `heliosplat products` wrote with public tools, and says what each found.

    python3 scripts/check_products.py FOLDER [--schemas FOLDER]

Uses what there is of: gdalinfo, GDAL's own COG validator (python3-gdal), PROJ by pyproj or osr, laspy with lazrs, PDAL, pystac; and of
programs that read surface models: rasterio, xdem, rioxarray, whitebox_workflows, demcompare, umep, which have to find the same numbers.
The schemas of STAC's core come with pystac; those of extensions are read from --schemas (one JSON file each, by their `$id`), else
fetched by pystac, which needs the network. Exit code 1 when a check fails.
"""

import argparse
import json
import pathlib
import shutil
import subprocess
import sys

failures = []


def say(name, good, detail=""):
    print(f"{'ok  ' if good else 'FAIL'} {name} {detail}")
    if not good:
        failures.append(name)


def check_rasters(folder):
    try:
        from osgeo import gdal, osr
        from osgeo_utils.samples.validate_cloud_optimized_geotiff import validate
    except ImportError:
        print("skip rasters: no python3-gdal")
        return
    gdal.UseExceptions()
    for path in sorted(folder.rglob("*.tif")):
        warnings, errors, _ = validate(str(path), full_check=True)
        say(f"COG {path.name}", not errors and not warnings, "; ".join(errors + warnings))
        info = gdal.Info(str(path), format="json", computeChecksum=True)
        sums = [band["checksum"] for band in info["bands"]]
        say(f"checksum {path.name}", all(isinstance(s, int) and s >= 0 for s in sums), str(sums))
        dataset = gdal.Open(str(path))
        target = dataset.GetSpatialRef()
        geographic = osr.SpatialReference()
        geographic.ImportFromEPSG(4326)
        for reference in (target, geographic):
            reference.SetAxisMappingStrategy(osr.OAMS_TRADITIONAL_GIS_ORDER)
        six = dataset.GetGeoTransform()
        there = osr.CoordinateTransformation(target, geographic)
        back = osr.CoordinateTransformation(geographic, target)
        lon, lat, _ = there.TransformPoint(six[0], six[3])
        x, y, _ = back.TransformPoint(lon, lat)
        off = max(abs(x - six[0]), abs(y - six[3]))
        say(f"PROJ there and back {path.name}", off < 1e-3, f"{off:.1e} m")


def of_whitebox(path):
    import whitebox_workflows

    return whitebox_workflows.WbEnvironment().read_raster(path).to_numpy()


def of_rasterio(path):
    import rasterio

    with rasterio.open(path) as file:
        return file.read(1)


def of_xdem(path):
    import xdem

    return xdem.DEM(path).data.filled(-9999)


def of_rioxarray(path):
    import rioxarray

    return rioxarray.open_rasterio(path)[0]


def of_demcompare(path):
    from demcompare.dem_tools import load_dem

    return load_dem(path).image


def of_umep(path):
    from umep.common import load_raster

    return load_raster(path, None)[0]


def of_gdal(path):
    from osgeo import gdal

    return gdal.Open(path).ReadAsArray()


def check_readers(folder):
    """Altitudes of the surface model by each reader: number of known cells, mean, least and largest."""
    path = next((str(path) for path in (folder / "dsm.tif", folder.parent / "dsm.tif") if path.is_file()), None)
    found = {}
    for reader in (of_gdal, of_rasterio, of_xdem, of_rioxarray, of_whitebox, of_demcompare, of_umep) if path else ():
        name = reader.__name__.removeprefix("of_")
        try:
            import numpy

            values = numpy.asarray(reader(path), dtype=float)
        except ImportError:
            print(f"skip {name}: not installed")
            continue
        known = values[numpy.isfinite(values) & (values != -9999)]
        found[name] = [known.size, *(round(float(f(known)), 4) for f in (numpy.mean, numpy.min, numpy.max))]
    for name, numbers in found.items():
        say(f"{name} reads dsm.tif", numbers == next(iter(found.values())), str(numbers))


def check_points(folder):
    for path in sorted(folder.rglob("*.laz")):
        try:
            import laspy

            cloud = laspy.read(path)
            detail = f"{len(cloud.points)} points, LAS {cloud.header.version}, format {cloud.header.point_format.id}"
            say(f"laspy {path.name}", len(cloud.points) == cloud.header.point_count > 0, detail)
        except ImportError:
            print("skip laspy: not installed")
        if shutil.which("pdal"):
            done = subprocess.run(["pdal", "info", "--summary", path], capture_output=True, text=True)
            say(f"pdal {path.name}", done.returncode == 0, done.stderr.strip())
        else:
            print("skip pdal: not installed")


def check_stac(folder, schemas):
    try:
        import pystac
        from jsonschema import Draft7Validator
    except ImportError:
        print("skip STAC: no pystac[validation]")
        return
    known = {}
    for path in sorted(schemas.glob("*.json")) if schemas else []:
        schema = json.loads(path.read_text())
        known[schema["$id"].rstrip("#")] = schema
    for path in sorted([*folder.rglob("item.json"), *folder.rglob("collection.json")]):
        value = json.loads(path.read_text())
        thing = pystac.read_file(str(path))
        if not schemas:
            say(f"STAC {path}", True, str(thing.validate()))
            continue
        kind = thing.STAC_OBJECT_TYPE
        try:
            pystac.validation.validate_dict({**value, "stac_extensions": []}, kind, value["stac_version"], [])
            say(f"STAC core {path.name}", True, value["stac_version"])
        except pystac.errors.STACValidationError as error:
            say(f"STAC core {path.name}", False, str(error))
        for extension in value.get("stac_extensions", []):
            if extension not in known:
                print(f"skip {extension}: not in {schemas}")
                continue
            errors = [error.message[:300] for error in Draft7Validator(known[extension]).iter_errors(value)]
            say(f"{extension}", not errors, "; ".join(errors))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=pathlib.Path)
    parser.add_argument("--schemas", type=pathlib.Path)
    given = parser.parse_args()
    check_rasters(given.folder)
    check_readers(given.folder)
    check_points(given.folder)
    check_stac(given.folder, given.schemas)
    sys.exit(1 if failures else 0)


if __name__ == "__main__":
    main()
