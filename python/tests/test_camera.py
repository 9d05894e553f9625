"""Cameras: the numbers of rpcm, the readers, and how shapes and faults are treated."""

import json
import time

import numpy as np
import pytest

import heliosplat


def numerator(l, p, h):
    return [2.1e-3, l, p, h, 4.0e-4, -2.5e-4, 1.1e-4, 3.0e-4, -2.0e-4, 1.5e-5] + [1.3e-6] * 10


DENOMINATOR = [1.0, 6.0e-4, -4.0e-4, 3.0e-4] + [4.0e-7] * 16
#: The camera of `Rpc::example()`.
EXAMPLE = {
    "row_offset": 8000.0, "col_offset": 8000.0, "lat_offset": 37.58, "lon_offset": 36.91, "alt_offset": 700.0,
    "row_scale": 8000.0, "col_scale": 8000.0, "lat_scale": 0.036, "lon_scale": 0.045, "alt_scale": 500.0,
    "row_num": numerator(0.02, -1.0, 0.03), "row_den": DENOMINATOR,
    "col_num": numerator(1.0, 0.02, -0.04), "col_den": DENOMINATOR,
}  # fmt: skip

#: Our names of the axes and GDAL's.
AXES = (("row", "line"), ("col", "samp"), ("lat", "lat"), ("lon", "long"), ("alt", "height"))


def points(rpc, count):
    """Points all over the ground and the heights of a camera, always the same."""
    values = rpc.to_dict()
    random = np.random.default_rng(3)
    return [
        values[f"{name}_offset"] + abs(values[f"{name}_scale"]) * random.uniform(-0.9, 0.9, count)
        for name in ("lon", "lat", "alt")
    ]


def golden(shared):
    for path in sorted((shared / "golden/rpc").glob("*.json")):
        values = json.loads(path.read_text())
        if "rpc" in values:
            yield path.stem, values["rpc"]


def test_points_are_where_rpcm_says_to_a_hundred_millionth_of_a_pixel(shared):
    rpcm = pytest.importorskip("rpcm")
    compared = 0
    for name, values in golden(shared):
        rpc = heliosplat.Rpc.from_dict(values)
        theirs = rpcm.RPCModel(rpc.to_dict(), dict_format="rpcm")
        lon, lat, height = points(rpc, 500)
        col, row = rpc.project(lon, lat, height)
        their_col, their_row = theirs.projection(lon, lat, height)
        assert np.abs(col - their_col).max() < 1e-8, name
        assert np.abs(row - their_row).max() < 1e-8, name
        compared += 1
    assert compared > 40


def test_localised_points_project_back_to_where_they_were(shared):
    for name, values in golden(shared):
        rpc = heliosplat.Rpc.from_dict(values)
        lon, lat, height = points(rpc, 200)
        col, row = rpc.project(lon, lat, height)
        found = rpc.localise(col, row, height)
        known = np.isfinite(found[0])
        again = rpc.project(found[0][known], found[1][known], height[known])
        off = np.hypot(again[0] - col[known], again[1] - row[known])
        # A camera of the collection contradicts itself and is refused everywhere.
        assert known.all() or not known.any(), name
        assert not known.any() or off.max() < 1e-5, name
        assert not known.any() or np.abs(found[0] - lon).max() < 1e-8, name


@pytest.mark.speed
def test_a_million_points_take_a_tenth_of_rpcm_s_time():
    rpcm = pytest.importorskip("rpcm")
    rpc = heliosplat.Rpc.from_dict(EXAMPLE)
    theirs = rpcm.RPCModel(EXAMPLE, dict_format="rpcm")
    lon, lat, height = points(rpc, 1_000_000)
    col, row = rpc.project(lon, lat, height)

    def seconds(work):
        best = float("inf")
        for _ in range(3):
            start = time.perf_counter()
            work()
            best = min(best, time.perf_counter() - start)
        return best

    for ours, other in (
        (lambda: rpc.project(lon, lat, height), lambda: theirs.projection(lon, lat, height)),
        (lambda: rpc.localise(col, row, height), lambda: theirs.localization(col, row, height)),
    ):
        mine, its = seconds(ours), seconds(other)
        print(f"\n{1e6 / mine:.3g} points/s, rpcm {1e6 / its:.3g}: {its / mine:.1f} times as fast")
        assert its > 10.0 * mine


def test_numbers_give_numbers_and_arrays_are_broadcast():
    rpc = heliosplat.Rpc.from_dict(EXAMPLE)
    col, row = rpc.project(36.91, 37.58, 700.0)
    assert isinstance(col, float) and abs(col - 8016.8) < 1.0
    cols, rows = rpc.project(np.array([[36.91], [36.92]]), [37.58, 37.57, 37.59], 700)
    assert cols.shape == rows.shape == (2, 3)
    assert cols[0, 0] == col and rows[0, 0] == row
    lon, lat = rpc.localise(cols, rows, 700.0)
    assert np.abs(lon - [[36.91], [36.92]]).max() < 1e-9
    # Views that are not contiguous, and what is no number.
    assert np.array_equal(rpc.project(np.array([36.91, 0, 36.92])[::2], 37.58, 700.0)[0], cols[:, 0])
    assert np.isnan(rpc.localise(np.nan, 0.0, 700.0)).all()
    assert rpc.project(np.zeros(0), 37.58, 700.0)[0].shape == (0,)


def test_swapped_coordinates_are_refused_and_points_outside_are_not():
    rpc = heliosplat.Rpc.from_dict(EXAMPLE)
    with pytest.raises(heliosplat.Error, match="lon comes first"):
        rpc.project([37.58, 37.57], 36.91, 700.0)
    assert np.isfinite(rpc.project(36.99, 37.58, 700.0)).all(), "beside the image"


def test_a_camera_survives_its_texts():
    rpc = heliosplat.Rpc.from_dict(EXAMPLE)
    same = heliosplat.Rpc.from_text(rpc.to_rpc_txt())
    lon, lat, height = points(rpc, 50)
    assert np.abs(np.subtract(rpc.project(lon, lat, height), same.project(lon, lat, height))).max() < 1e-6
    assert heliosplat.Rpc.from_dict(rpc.to_dict()).to_dict() == rpc.to_dict()
    assert "36.91" in repr(rpc)


def test_the_camera_of_a_geotiff_is_that_of_its_tag(tmp_path):
    rasterio = pytest.importorskip("rasterio")
    rpc = heliosplat.Rpc.from_dict(EXAMPLE)
    text = tmp_path / "camera_RPC.TXT"
    text.write_text(rpc.to_rpc_txt())
    image = tmp_path / "image.tif"
    rpcs = rasterio.rpc.RPC(
        **{name: EXAMPLE[f"{ours}_{kind}"] for ours, theirs in AXES for kind, name in (("offset", f"{theirs}_off"), ("scale", f"{theirs}_scale"))},
        line_num_coeff=EXAMPLE["row_num"], line_den_coeff=DENOMINATOR, samp_num_coeff=EXAMPLE["col_num"], samp_den_coeff=DENOMINATOR,
    )  # fmt: skip
    with rasterio.open(image, "w", driver="GTiff", width=2, height=2, count=1, dtype="uint8") as file:
        file.rpcs = rpcs
    lon, lat, height = points(rpc, 50)
    for found in (heliosplat.Rpc.open(image), heliosplat.Rpc.open(text)):
        assert np.abs(np.subtract(found.project(lon, lat, height), rpc.project(lon, lat, height))).max() < 1e-6


def test_the_tag_of_a_geotiff_and_the_text_beside_it_are_read(shared):
    image = shared / "data/kahramanmaras/kahramanmaras_01.tif"
    tag = heliosplat.Rpc.open(image)
    beside = heliosplat.Rpc.open(image.with_suffix(".json"))
    lon, lat, _ = (tag.to_dict()[f"{name}_offset"] for name in ("lon", "lat", "alt"))
    # The JSON is the same camera after adjustment.
    assert np.hypot(*np.subtract(tag.project(lon, lat, 700.0), beside.project(lon, lat, 700.0))) < 100.0


def test_faults_are_one_line_that_names_the_file(tmp_path):
    text = tmp_path / "no_camera.txt"
    text.write_text("hello")
    broken = tmp_path / "broken.tif"
    broken.write_bytes(b"II*\0rest")
    for path in (text, broken, tmp_path / "missing.RPB"):
        with pytest.raises(heliosplat.Error) as raised:
            heliosplat.Rpc.open(path)
        message = str(raised.value)
        assert path.name in message and "\n" not in message
    with pytest.raises(ValueError, match="row_offset"):
        heliosplat.Rpc.from_dict({key: value for key, value in EXAMPLE.items() if key != "row_offset"})
    with pytest.raises(ValueError):
        heliosplat.Rpc.from_dict(EXAMPLE).project([1.0, 2.0], [1.0, 2.0, 3.0], 0.0)
