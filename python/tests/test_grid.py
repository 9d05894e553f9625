"""Grids among numpy, matplotlib, rasterio and rioxarray, and the faults that would pass in silence."""

import numpy as np
import pytest

import heliosplat

rasterio = pytest.importorskip("rasterio")

#: A conic projection that has no code.
CONIC = "+proj=lcc +lat_1=40 +lat_2=50 +lat_0=45 +lon_0=10 +x_0=0 +y_0=0 +datum=WGS84 +units=m +no_defs"


def grid(crs="EPSG:32637", x=320_000.0, y=4_160_000.0, cell=0.5):
    """60 x 60 cells of a box of 10 m on level ground; its corner is unknown."""
    heights = np.full((60, 60), 700.0, dtype=np.float32)
    heights[20:40, 30:36] = 710.0
    heights[0, 0] = np.nan
    return heliosplat.Grid(heights[np.newaxis], ("altitude",), (x, cell, 0.0, y, 0.0, -cell), crs, None, "metre")


def test_numpy_takes_a_grid_as_its_values_and_gives_grids_back():
    dsm = grid()
    assert np.nanmax(dsm) == 710.0 and np.asarray(dsm).shape == (60, 60)
    above = dsm - 700.0
    assert isinstance(above, heliosplat.Grid) and above.transform == dsm.transform and np.nanmax(above) == 10.0
    assert np.nanmax(above - above) == 0.0 and np.asarray(above > 5.0).sum() == 120
    mask = heliosplat.shadows(dsm, 90, 50)
    assert np.isnan(np.asarray(mask, dtype=float)[0, 0]), "the mask's 255 is unknown too"
    with pytest.raises(heliosplat.Error, match="same cells"):
        dsm - grid(x=320_000.5)
    assert "700 to 710 metre" in dsm._repr_html_() and "EPSG:32637" in dsm._repr_html_()


def test_matplotlib_draws_a_grid_in_map_coordinates():
    matplotlib = pytest.importorskip("matplotlib")
    matplotlib.use("Agg")
    from matplotlib import pyplot

    axes = grid().plot()
    assert axes.images[0].get_extent() == [320_000.0, 320_030.0, 4_159_970.0, 4_160_000.0]
    pyplot.figure()
    assert pyplot.imshow(grid()).get_array().shape == (60, 60)
    pyplot.close("all")


@pytest.mark.parametrize("crs", ["EPSG:32637", "EPSG:2263", CONIC])
def test_a_geotiff_comes_back_as_it_was_written(tmp_path, crs):
    written = grid(crs, x=4e5 if crs != CONIC else -3e5, y=2e5)
    path = tmp_path / "dsm.tif"
    written.to_geotiff(path)
    read = heliosplat.read_geotiff(path)
    assert np.array_equal(read.values, written.values, equal_nan=True)
    assert (read.bands, read.transform, read.unit, read.nodata) == (("altitude",), written.transform, "metre", None)
    assert rasterio.crs.CRS.from_user_input(read.crs) == rasterio.crs.CRS.from_user_input(crs)
    assert read.epsg == (None if crs == CONIC else int(crs[5:]))
    mask = heliosplat.shadows(read, 90, 50)
    mask.to_geotiff(path)
    with rasterio.open(path) as file:
        assert file.nodata == 255 and file.dtypes == ("uint8",) and file.read(1)[0, 0] == 255


def test_cells_in_feet_are_shorter():
    assert grid("EPSG:2263").cell_m == pytest.approx(0.5 * 1200 / 3937)


def test_grid_north_is_the_convergence_of_the_projection():
    # UTM: Snyder, Map Projections, eq. 8-1 ff., on the sphere; conic: (lon - lon_0) sin(lat) between the parallels, n = 0.7069.
    lon, lat = grid().lon_lat
    expected = np.degrees(np.arctan(np.tan(np.radians(lon - 39)) * np.sin(np.radians(lat))))
    assert abs(expected) > 1 and grid().grid_north == pytest.approx(expected, abs=0.01)
    conic = grid(CONIC, x=-300_000.0, y=0.0)
    assert conic.grid_north == pytest.approx((conic.lon_lat[0] - 10) * 0.7069, abs=0.02)


def test_the_sun_of_a_grid_counts_from_true_north():
    dsm = grid()
    heights = np.asarray(dsm)
    turned = heliosplat.shadows(heights, 40, 30, cell_m=0.5, grid_north=dsm.grid_north)
    assert np.array_equal(heliosplat.shadows(dsm, 40, 30).values[0], turned)
    assert not np.array_equal(heliosplat.shadows(heights, 40, 30, cell_m=0.5), turned)


def test_shadows_of_a_day_come_one_for_each_time():
    xarray = pytest.importorskip("xarray")
    dsm, times = grid(), np.arange("2026-06-21T00:00", "2026-06-21T13:00", 240, dtype="datetime64[m]")
    masks = heliosplat.shadow_series(dsm, times)
    assert masks.bands == ("2026-06-21T00:00Z", "2026-06-21T04:00Z", "2026-06-21T08:00Z", "2026-06-21T12:00Z")
    assert (masks.values[0] != 0).all(), "night"
    lon, lat = dsm.lon_lat
    azimuth, elevation = heliosplat.sun_position(times[2], lat, lon)
    assert np.array_equal(masks.values[2], heliosplat.shadows(dsm, azimuth, elevation).values[0])
    # Four hours after sunrise the shadows are longer than before noon.
    assert (masks.values[1] == 1).sum() > (masks.values[2] == 1).sum() > 0
    array = heliosplat.shadow_series(dsm.to_xarray(), times)
    assert isinstance(array, xarray.DataArray) and array.dims == ("time", "y", "x")
    assert np.array_equal(array.values, masks.values) and array.time.values[3] == times[3]
    plain = heliosplat.shadow_series(np.asarray(dsm), times, lat=lat, lon=lon, cell_m=0.5, grid_north=dsm.grid_north)
    assert np.array_equal(plain, masks.values)
    with pytest.raises(heliosplat.Error, match="lat and lon"):
        heliosplat.shadow_series(np.asarray(dsm), times, cell_m=0.5)


def test_hours_of_sun_need_no_place_where_the_grid_has_one():
    dsm = grid()
    lon, lat = dsm.lon_lat
    hours = heliosplat.sun_hours(dsm, "2026-06-21T00:00Z", step_minutes=60)
    given = heliosplat.sun_hours(dsm, "2026-06-21T00:00Z", step_minutes=60, lat=lat, lon=lon)
    assert np.array_equal(hours.values, given.values, equal_nan=True) and hours.unit == "h"


def test_rioxarray_reads_the_system_and_nodata_of_a_grid(tmp_path):
    pytest.importorskip("rioxarray")
    dsm = grid()
    array = dsm.to_xarray()
    assert array.rio.crs.to_epsg() == 32637 and array.name == "altitude" and array.attrs["units"] == "metre"
    assert array.rio.transform().to_gdal() == pytest.approx(dsm.transform)
    mask = heliosplat.shadows(dsm, 90, 50).to_xarray()
    assert mask.rio.nodata == 255
    mask.rio.to_raster(tmp_path / "mask.tif")
    again = heliosplat.read_geotiff(tmp_path / "mask.tif")
    assert again.epsg == 32637 and again.nodata == 255 and np.array_equal(again.values, mask.values)


@pytest.mark.parametrize("masked", [True, False])
def test_nodata_of_rioxarray_is_unknown_and_no_pit(tmp_path, masked):
    rioxarray = pytest.importorskip("rioxarray")
    dsm = grid()
    dsm.values[0, 45:50, 10:20] = np.nan
    dsm.to_geotiff(tmp_path / "dsm.tif")
    array = rioxarray.open_rasterio(tmp_path / "dsm.tif", masked=masked)
    mask = heliosplat.shadows(array, 90, 50)
    assert (mask.values == 255).sum() == 51 and mask.rio.nodata == 255 and mask.rio.crs.to_epsg() == 32637
    assert np.array_equal(mask.values, heliosplat.shadows(dsm, 90, 50).values[0])


def test_degrees_are_refused_wherever_they_stand(tmp_path):
    rioxarray = pytest.importorskip("rioxarray")
    degrees = grid("EPSG:4326", x=36.9, y=37.58, cell=5e-6)
    degrees.to_geotiff(tmp_path / "degrees.tif")
    # CRS84 has other axes and no code that is looked up.
    for crs in ("EPSG:4326", "OGC:CRS84", "EPSG:4258"):
        with pytest.raises(heliosplat.Error, match="degrees"):
            heliosplat.shadows(grid(crs, x=36.9, y=37.58, cell=5e-6), 90, 50)
    array = rioxarray.open_rasterio(tmp_path / "degrees.tif")
    with pytest.raises(heliosplat.Error, match="degrees"):
        heliosplat.shadows(array, 90, 50)
    without = array.drop_vars("spatial_ref")
    without.encoding.clear()
    without.x.attrs["units"] = "degrees_east"
    with pytest.raises(heliosplat.Error, match="degrees"):
        heliosplat.shadows(without, 90, 50)


def test_latitude_and_longitude_are_not_taken_for_each_other():
    with pytest.raises(heliosplat.Error, match="lat comes first"):
        heliosplat.sun_position("2026-06-21T09:00Z", 136.91, 37.58)
