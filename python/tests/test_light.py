"""The sun, shadows and hours of sun, against numbers known beforehand."""

import datetime
import json
import threading
import time

import numpy as np
import pytest

import heliosplat


def box():
    """60 x 60 cells of 0.5 m: a box of 10 m on level ground, 6 cells from west to east and 20 from north to south."""
    heights = np.full((60, 60), 700.0, dtype=np.float32)
    heights[20:40, 30:36] = 710.0
    return heights


def test_the_sun_is_where_pvlib_says(shared):
    cases = json.loads((shared / "golden/sun.json").read_text())["rows"]
    assert len(cases) > 100
    times = np.array([case["utc"].rstrip("Z").replace("+00:00", "") for case in cases], dtype="datetime64[us]")
    place = [np.array([case[name] for case in cases], dtype=float) for name in ("lat", "lon", "alt_m")]
    azimuth, elevation = heliosplat.sun_position(times, *place)
    expected = np.array([[case["azimuth_deg"], case["elevation_deg"]] for case in cases])
    off_azimuth = (azimuth - expected[:, 0] + 180) % 360 - 180
    across = np.abs(off_azimuth) * np.cos(np.radians(expected[:, 1]))
    assert max(across.max(), np.abs(elevation - expected[:, 1]).max()) < 0.002


def test_times_are_taken_as_texts_datetimes_and_arrays():
    text = heliosplat.sun_position("2016-04-23T08:34:00Z", 37.58, 36.91)
    moment = datetime.datetime(2016, 4, 23, 10, 34, tzinfo=datetime.timezone(datetime.timedelta(hours=2)))
    array = heliosplat.sun_position(np.array(["2016-04-23T08:34"], dtype="datetime64[m]"), 37.58, 36.91)
    assert text == heliosplat.sun_position(moment, 37.58, 36.91) == (array[0][0], array[1][0])
    for wrong in (moment.replace(tzinfo=None), "yesterday", 3.5, np.datetime64("NaT")):
        with pytest.raises(heliosplat.Error):
            heliosplat.sun_position(wrong, 37.58, 36.91)


@pytest.mark.parametrize(("azimuth", "elevation"), [(90, 50), (270, 55), (180, 60), (0, 55)])
def test_a_shadow_is_as_long_as_height_and_sun_say(azimuth, elevation):
    mask = heliosplat.shadows(box(), azimuth, elevation, cell_m=0.5)
    line = {90: mask[30, :30], 270: mask[30, 36:], 180: mask[:20, 33], 0: mask[40:, 33]}[azimuth]
    expected = 10.0 / np.tan(np.radians(elevation))
    assert abs(0.5 * line.sum() - expected) <= 0.5
    assert mask[30, 33] == 0 and mask.dtype == np.uint8


def test_the_horizon_beside_a_wall_is_its_height_over_its_distance():
    found = heliosplat.horizon(box(), 90, cell_m=0.5)
    for cells in (1, 4, 20):
        assert abs(found[30, 30 - cells] - np.degrees(np.arctan(10.0 / (0.5 * cells)))) < 1e-3
    assert found[30, 50] == pytest.approx(0.01)


def test_unknown_heights_are_unknown_and_throw_nothing():
    heights = box()
    heights[25:35, 20:25] = np.nan
    mask = heliosplat.shadows(heights, 90, 50, cell_m=0.5)
    assert (mask[25:35, 20:25] == 255).all() and (mask != 255).sum() == 3600 - 50
    hours = heliosplat.sun_hours(heights, "2026-06-21T00:00Z", lat=48.0, lon=11.0, cell_m=0.5, step_minutes=60)
    assert np.isnan(hours[30, 22]) and np.isfinite(hours).sum() == 3550


def test_masked_heights_are_unknown_and_not_pits():
    heights = np.ma.masked_equal(np.where(box() > 705.0, -9999.0, box()), -9999.0)
    mask = heliosplat.shadows(heights, 90, 50, cell_m=0.5)
    assert (mask[20:40, 30:36] == 255).all() and (mask != 255).sum() == 3600 - 120
    assert (mask[mask != 255] == 0).all()
    assert np.isnan(heliosplat.horizon(heights, 90, cell_m=0.5)[30, 33])
    azimuth, _ = heliosplat.sun_position("2026-06-21T09:00Z", np.ma.masked_array([37.0, 38.0], [False, True]), 36.9)
    assert np.isfinite(azimuth[0]) and np.isnan(azimuth[1])


def test_hours_of_sun_are_the_day_s_length_on_level_ground_and_fewer_beside_a_wall():
    place = {"lat": 48.0, "lon": 11.0, "cell_m": 0.5}
    hours = heliosplat.sun_hours(box(), "2026-06-21T00:00Z", step_minutes=10, **place)
    # Centre of the disc above 0.25 degree: 15 h 50 min at midsummer in Munich.
    assert 15.6 < hours[2, 2] < 16.1
    # North of the box the sun of noon is hidden.
    assert hours[17, 33] < hours[45, 33] < hours[2, 2] + 1e-3
    short = heliosplat.sun_hours(box(), "2026-06-21T10:00Z", "2026-06-21T12:00Z", **place)
    assert short[2, 2] == pytest.approx(2.0)
    with pytest.raises(heliosplat.Error):
        heliosplat.sun_hours(box(), "2026-06-21T10:00Z", "2026-06-21T09:00Z", **place)


def test_a_turned_grid_sees_the_sun_turned_the_other_way():
    assert np.array_equal(
        heliosplat.shadows(box(), 95, 50, cell_m=0.5, grid_north=5), heliosplat.shadows(box(), 90, 50, cell_m=0.5)
    )


def test_what_cannot_be_meant_is_refused():
    for wrong in ((90, 0), (90, 90), (np.nan, 45)):
        with pytest.raises(heliosplat.Error):
            heliosplat.shadows(box(), *wrong, cell_m=0.5)
    with pytest.raises(heliosplat.Error, match="cell_m"):
        heliosplat.shadows(box(), 90, 45)
    with pytest.raises(heliosplat.Error):
        heliosplat.shadows(box(), 90, 45, cell_m=-1.0)
    with pytest.raises(heliosplat.Error, match="dimensions"):
        heliosplat.shadows(np.zeros(5), 90, 45, cell_m=0.5)


def test_other_threads_run_while_shadows_are_cast():
    heights = np.random.default_rng(1).uniform(0, 30, (1500, 1500)).astype(np.float32)
    ticks, done = [], threading.Event()

    def tick():
        while not done.is_set():
            ticks.append(time.perf_counter())
            time.sleep(0.001)

    thread = threading.Thread(target=tick)
    thread.start()
    begin = time.perf_counter()
    heliosplat.shadows(heights, 33, 1.0, cell_m=0.5)
    end = time.perf_counter()
    done.set()
    thread.join()
    assert sum(begin < at < end for at in ticks) >= 2
