"""The sun, and what it does to a surface of heights.

Azimuths over a surface count from the grid's north, the upward direction of its columns. On a map grid this is off true north by the
meridian convergence, up to 3 degrees in UTM; ``grid_north`` says by how much where it matters.
"""

from __future__ import annotations

import datetime
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _heliosplat
from ._arrays import floats
from .grid import Grid

if TYPE_CHECKING:
    import xarray

    Surface = ArrayLike | Grid | xarray.DataArray

#: The sun's disc is half a degree wide: below this its light comes from beyond the horizon.
_LOWEST_DEG = 0.25


def sun_position(time: Any, lat: ArrayLike, lon: ArrayLike, height: ArrayLike = 0.0) -> tuple[Any, Any]:
    """Azimuth and elevation of the sun, degrees: geometric (no refraction), good to 0.001 degree from 1972 to 2100.

    ``time`` is a datetime with a time zone, a text such as ``2026-06-21T09:00Z``, or an array of ``datetime64`` (UTC). Times and places
    are broadcast.
    """
    arrays = np.broadcast_arrays(_microseconds(time), *(floats(value) for value in (lat, lon, height)))
    shape = arrays[0].shape
    times, *place = (np.ascontiguousarray(array).reshape(-1) for array in arrays)
    azimuth, elevation = _heliosplat.sun_positions(times, *place)
    if shape == ():
        return float(azimuth[0]), float(elevation[0])
    return azimuth.reshape(shape), elevation.reshape(shape)


def shadows(surface: Surface, azimuth: float, elevation: float, cell_m: float | None = None, grid_north: float = 0.0) -> Any:
    """The shadows that a surface casts on itself: 1 in shadow, 0 in the sun, 255 where its height is unknown.

    ``surface`` is an array ``[row, column]`` of metres, first row in the north, with ``cell_m`` metres a cell; or a :class:`Grid` or
    DataArray, which bring their own and give one of their kind back. Rays are walked from row to row with heights linear in between.
    """
    heights, cell_m, wrap = _taken(surface, cell_m)
    return wrap(_heliosplat.shadows(heights, cell_m, azimuth - grid_north, elevation), "shadow", 255)


def horizon(surface: Surface, azimuth: float, cell_m: float | None = None, lowest: float = 0.01, grid_north: float = 0.0) -> Any:
    """Elevation of the horizon in one direction, degrees, at least ``lowest``: a sun above it shines on the cell."""
    heights, cell_m, wrap = _taken(surface, cell_m)
    return wrap(_heliosplat.horizons(heights, cell_m, azimuth - grid_north, lowest), "horizon", None)


def sun_hours(
    surface: Surface,
    start: Any,
    end: Any = None,
    *,
    lat: float,
    lon: float,
    step_minutes: float = 15.0,
    cell_m: float | None = None,
    grid_north: float = 0.0,
) -> Any:
    """Hours of direct sun from ``start`` to ``end`` (24 hours later by default), under a sky without clouds.

    The sun is taken at the middle of each step. Can be interrupted.
    """
    heights, cell_m, wrap = _taken(surface, cell_m)
    begin = int(_microseconds(start))
    step_us = step_minutes * 60e6
    length_us = 86_400e6 if end is None else int(_microseconds(end)) - begin
    if not (step_us > 0.0 and length_us > 0.0):
        raise _heliosplat.Error("the time must end after its start, and steps be longer than nothing")
    count = max(1, round(length_us / step_us))
    times = begin + ((np.arange(count) + 0.5) * (length_us / count)).astype(np.int64)
    azimuth, elevation = sun_position(times.astype("datetime64[us]"), lat, lon)
    hours = length_us / count / 3600e6
    found = _heliosplat.sun_hours(heights, cell_m, azimuth - grid_north, elevation, hours, _LOWEST_DEG)
    return wrap(found, "sun_hours", None)


def _microseconds(time: Any) -> NDArray[np.int64]:
    if isinstance(time, str):
        text = time[:-1] + "+00:00" if time.endswith(("Z", "z")) else time
        try:
            time = datetime.datetime.fromisoformat(text)
        except ValueError as error:
            raise _heliosplat.Error(f"{time!r} is no time such as 2026-06-21T09:00Z") from error
        if time.tzinfo is None:
            time = time.replace(tzinfo=datetime.timezone.utc)
    if isinstance(time, datetime.datetime):
        if time.tzinfo is None:
            raise _heliosplat.Error("the time has no time zone: use datetime.timezone.utc")
        time = np.datetime64(time.astimezone(datetime.timezone.utc).replace(tzinfo=None))
    elif isinstance(time, datetime.date):
        time = np.datetime64(time)
    times = np.ma.filled(time, np.datetime64("NaT")) if isinstance(time, np.ma.MaskedArray) else np.asarray(time)
    if not np.issubdtype(times.dtype, np.datetime64):
        raise _heliosplat.Error("a time is a datetime, a text or an array of datetime64")
    if np.isnat(times).any():
        raise _heliosplat.Error("a time is missing (NaT)")
    return times.astype("datetime64[us]").astype(np.int64)


def _taken(surface: Any, cell_m: float | None) -> tuple[NDArray[np.float32], float, Any]:
    """Heights as the engine takes them, the side of a cell, and what turns a result into one of the surface's kind."""
    if isinstance(surface, Grid):
        first = surface.values[0]
        return _heights(first), cell_m or surface.cell_m, surface.with_values
    if hasattr(surface, "dims") and hasattr(surface, "coords"):
        return _taken_from_xarray(surface, cell_m)
    if cell_m is None:
        raise _heliosplat.Error("an array does not say how large its cells are: give cell_m")
    return _heights(surface), cell_m, lambda values, name, nodata: values


def _taken_from_xarray(surface: Any, cell_m: float | None) -> tuple[NDArray[np.float32], float, Any]:
    plane = surface.isel(band=0) if "band" in surface.dims else surface
    if plane.ndim != 2:
        raise _heliosplat.Error(f"a surface has rows and columns; this one has {', '.join(map(str, plane.dims)) or 'neither'}")
    if cell_m is None:
        down, across = (np.diff(plane.coords[name].values) if name in plane.coords else np.zeros(0) for name in plane.dims)
        if not (across.size and down.size):
            raise _heliosplat.Error("the DataArray has no coordinates: give cell_m")
        if down[0] > 0.0:
            raise _heliosplat.Error("the DataArray's first row is in the south: use sortby('y', ascending=False)")
        cell_m = float(across.mean())
        if abs(down.mean() + cell_m) > 1e-3 * cell_m:
            raise _heliosplat.Error("the DataArray's cells are not square: resample it first, or give cell_m")
        crs = str(surface.attrs.get("crs", ""))
        if crs in ("EPSG:4326", "EPSG:4979"):
            raise _heliosplat.Error("the DataArray's cells are in degrees: reproject it to a system in metres, such as UTM")

    def wrap(values: NDArray[Any], name: str, nodata: float | None) -> Any:
        out = plane.copy(data=values).rename(name).drop_vars("band", errors="ignore")
        out.attrs = {key: value for key, value in surface.attrs.items() if key in ("crs", "transform", "grid_mapping")}
        if nodata is not None:
            out.attrs["_FillValue"] = nodata
        return out

    return _heights(plane.values), cell_m, wrap


def _heights(values: Any) -> NDArray[np.float32]:
    heights = np.ascontiguousarray(floats(values, np.float32))
    if heights.ndim != 2:
        raise _heliosplat.Error(f"a surface has rows and columns; this array has {heights.ndim} dimensions")
    return heights
