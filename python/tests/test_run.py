"""Run folders and GeoTIFFs as arrays, and what xarray makes of them."""

import importlib.util
import json
import os
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest

import heliosplat


@pytest.fixture(scope="module")
def run():
    """A run with products, made by scripts/test_python.sh where the program is built."""
    folder = os.environ.get("HELIOSPLAT_TEST_RUN")
    if not folder:
        pytest.skip("HELIOSPLAT_TEST_RUN names no run")
    return heliosplat.open_run(folder)


def test_a_geotiff_is_read_as_it_is(tmp_path):
    rasterio = pytest.importorskip("rasterio")
    path = tmp_path / "dsm.tif"
    values = np.array([[[700.0, -9999.0, 702.0], [703.0, 704.0, 705.0]], [[1, 2, 3], [4, 5, 6]]], dtype=np.float32)
    transform = rasterio.transform.from_origin(5e5, 4e6, 0.5, 0.5)
    profile = {"height": 2, "width": 3, "count": 2, "dtype": "float32", "crs": "EPSG:32637", "nodata": -9999.0}
    # Bands in planes of their own are read like any.
    with rasterio.open(path, "w", driver="GTiff", transform=transform, interleave="band", **profile) as file:
        file.write(values)
        file.set_band_description(1, "altitude")
    grid = heliosplat.read_geotiff(path)
    assert grid.bands == ("altitude", "2") and grid.epsg == 32637 and grid.nodata is None
    assert grid.transform == (5e5, 0.5, 0.0, 4e6, 0.0, -0.5) and grid.cell_m == 0.5
    assert np.isnan(grid.values[0, 0, 1]) and np.array_equal(grid.values[1], values[1])


def test_without_rasterio_the_message_says_what_to_install(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "rasterio", None)
    with pytest.raises(ImportError, match=r"pip install 'heliosplat\[raster\]'"):
        heliosplat.read_geotiff(tmp_path / "dsm.tif")
    (tmp_path / "image.tif").write_bytes(b"II*\0rest")
    with pytest.raises(ImportError, match="rasterio"):
        heliosplat.Rpc.open(tmp_path / "image.tif")


def test_a_sun_of_numpy_numbers_reaches_the_program(monkeypatch, tmp_path):
    (tmp_path / "model.json").write_text('{"model": "shadow_gs"}')
    program = tmp_path / "program"
    program.write_text('#!/bin/sh\necho "error: $4" >&2\nexit 2\n')
    program.chmod(0o755)
    with pytest.raises(heliosplat.Error, match=r"^--sun=250\.0,35\.5$"):
        heliosplat.open_run(tmp_path).relight(np.float64(250), np.float32(35.5), program=program)


def test_a_run_opens_as_arrays_on_one_grid(run):
    dsm, albedo = run.dsm, run.albedo
    assert dsm.bands == ("altitude",) and dsm.shape == albedo.shape
    assert dsm.epsg // 100 in (326, 327) and dsm.cell_m > 0.1
    low, high = run.model["altitude_range_m"]
    known = dsm.values[np.isfinite(dsm.values)]
    assert known.size > 0.5 * dsm.values.size and low - 50 < known.min() < known.max() < high + 50
    assert "standard_deviation" in run.surface.bands
    assert set(np.unique(run.raster("hillshade").values)) <= set(range(256))
    # The meridian convergence of UTM, on the sphere to a hundredth of a degree.
    lon, lat, _ = run.origin
    from_meridian = np.radians(lon - (6 * (dsm.epsg % 100) - 183))
    expected = np.degrees(np.arctan(np.tan(from_meridian) * np.sin(np.radians(lat))))
    assert abs(run.grid_north - expected) < 0.01 and str(run.folder) in repr(run)
    with pytest.raises(heliosplat.Error, match="there are .*dsm"):
        run.raster("nothing")


def test_footprints_are_polygons_on_the_raised_ground_of_the_run(run, tmp_path):
    for module in ("rasterio", "scipy", "shapely"):
        pytest.importorskip(module)
    example = importlib.util.spec_from_file_location("footprints", Path(__file__).parents[1] / "examples" / "footprints.py")
    footprints = importlib.util.module_from_spec(example)
    example.loader.exec_module(footprints)
    footprints.main(run.folder, tmp_path / "footprints.geojson")
    found = json.loads((tmp_path / "footprints.geojson").read_text(encoding="utf-8"))["features"]
    lon, lat, _ = run.origin
    assert found
    for building in found:
        west, south = np.min(building["geometry"]["coordinates"][0], axis=0)
        assert abs(west - lon) < 0.01 and abs(south - lat) < 0.01
        assert building["properties"]["height_m"] > 2.5 and building["properties"]["area_m2"] >= 20


def test_a_run_is_relit_by_the_program(run):
    if not shutil.which(os.environ.get("HELIOSPLAT", "heliosplat")):
        pytest.skip("no program heliosplat")
    image, mask = run.relight(200.0, 40.0)
    assert image.values.shape[0] == run.albedo.values.shape[0] and mask.values.max() == 1
    # Shadows that the surface casts and those of the Gaussians are much the same.
    cast = heliosplat.shadows(run.dsm, 200.0, 40.0)
    if cast.shape == mask.shape:
        known = cast.values[0] != 255
        assert (cast.values[0] == mask.values[0])[known].mean() > 0.8
    with pytest.raises(heliosplat.Error, match="-5"):
        run.relight(200.0, -5.0)
    with pytest.raises(heliosplat.Error, match="PATH"):
        run.relight(200.0, 40.0, program="no_such_program")


def test_xarray_has_coordinates_and_a_coordinate_system(run):
    xarray = pytest.importorskip("xarray")
    dsm = run.dsm
    array = dsm.to_xarray()
    assert isinstance(array, xarray.DataArray) and array.dims == ("band", "y", "x")
    assert float(array.x[0]) == pytest.approx(dsm.transform[0] + dsm.cell_m / 2)
    assert float(array.y[0] - array.y[1]) == pytest.approx(dsm.cell_m)
    mask = heliosplat.shadows(array, 200.0, 40.0)
    assert mask.dims == ("y", "x") and mask.spatial_ref.attrs == array.spatial_ref.attrs
    assert np.array_equal(mask.values, heliosplat.shadows(dsm, 200.0, 40.0).values[0])
    with pytest.raises(heliosplat.Error, match="south"):
        heliosplat.shadows(array.sortby("y"), 200.0, 40.0)


def test_what_is_no_run_is_told(tmp_path):
    with pytest.raises(heliosplat.Error, match="not a run"):
        heliosplat.open_run(tmp_path)
    (tmp_path / "model.json").write_text("{")
    with pytest.raises(heliosplat.Error, match="model.json"):
        heliosplat.open_run(tmp_path)
