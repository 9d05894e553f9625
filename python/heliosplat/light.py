"""The sun, and what it does to a surface of heights.

Azimuths count from true north. The columns of a map grid are off true north by the meridian convergence, up to 3 degrees in UTM. A Grid or
DataArray with a coordinate system brings its own; for an array ``grid_north`` is that angle, and without it azimuths count from its columns.
"""

from __future__ import annotations

import datetime
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _heliosplat
from ._arrays import floats
from .grid import Grid, epsg_or_text

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
    if (np.abs(arrays[1]) > 90.0).any():
        raise _heliosplat.Error("a latitude lies beyond 90 degrees: lat comes first, then lon")
    shape = arrays[0].shape
    times, *place = (np.ascontiguousarray(array).reshape(-1) for array in arrays)
    azimuth, elevation = _heliosplat.sun_positions(times, *place)
    if shape == ():
        return float(azimuth[0]), float(elevation[0])
    return azimuth.reshape(shape), elevation.reshape(shape)


def shadows(surface: Surface, azimuth: float, elevation: float, cell_m: float | None = None, grid_north: float | None = None) -> Any:
    """The shadows that a surface casts on itself: 1 in shadow, 0 in the sun, 255 where its height is unknown.

    ``surface`` is an array ``[row, column]`` of metres, first row in the north, with ``cell_m`` metres a cell; or a :class:`Grid` or
    DataArray, which bring their own and give one of their kind back. Rays are walked from row to row with heights linear in between.
    """
    taken = _taken(surface, cell_m, grid_north)
    return taken.wrap(_heliosplat.shadows(taken.heights, taken.cell_m, float(azimuth) - taken.grid_north, float(elevation)), "shadow", 255)


def horizon(
    surface: Surface, azimuth: float, cell_m: float | None = None, lowest: float = 0.01, grid_north: float | None = None
) -> Any:
    """Elevation of the horizon in one direction, degrees, at least ``lowest``: a sun above it shines on the cell."""
    taken = _taken(surface, cell_m, grid_north)
    found = _heliosplat.horizons(taken.heights, taken.cell_m, float(azimuth) - taken.grid_north, float(lowest))
    return taken.wrap(found, "horizon", None, "degree")


def shadow_series(
    surface: Surface,
    times: Any,
    *,
    lat: float | None = None,
    lon: float | None = None,
    cell_m: float | None = None,
    grid_north: float | None = None,
) -> Any:
    """The shadows at each of some times, as :func:`shadows` has them; night is all shadow.

    An array gives ``[time, row, column]``, a :class:`Grid` a band for each time, a DataArray one with the dimension ``time``. Place and
    north come from a Grid or DataArray with a coordinate system, else from ``lat`` and ``lon``.
    """
    taken = _taken(surface, cell_m, grid_north)
    stamps = np.atleast_1d(_microseconds(times)).astype("datetime64[us]")
    azimuth, elevation = sun_position(stamps, *taken.place(lat, lon))
    night = np.where(np.isfinite(taken.heights), 1, 255).astype(np.uint8)
    masks = np.stack([
        night if high <= _LOWEST_DEG else _heliosplat.shadows(taken.heights, taken.cell_m, toward - taken.grid_north, high)
        for toward, high in zip(azimuth.tolist(), elevation.tolist())
    ])
    return taken.series(masks, stamps)


def sun_hours(
    surface: Surface,
    start: Any,
    end: Any = None,
    *,
    lat: float | None = None,
    lon: float | None = None,
    step_minutes: float = 15.0,
    cell_m: float | None = None,
    grid_north: float | None = None,
) -> Any:
    """Hours of direct sun from ``start`` to ``end`` (24 hours later by default), under a sky without clouds.

    The sun is taken at the middle of each step. Can be interrupted. The place is taken as in :func:`shadow_series`.
    """
    taken = _taken(surface, cell_m, grid_north)
    begin = int(_microseconds(start))
    step_us = step_minutes * 60e6
    length_us = 86_400e6 if end is None else int(_microseconds(end)) - begin
    if not (step_us > 0.0 and length_us > 0.0):
        raise _heliosplat.Error("the time must end after its start, and steps be longer than nothing")
    count = max(1, round(length_us / step_us))
    times = begin + ((np.arange(count) + 0.5) * (length_us / count)).astype(np.int64)
    azimuth, elevation = sun_position(times.astype("datetime64[us]"), *taken.place(lat, lon))
    hours = length_us / count / 3600e6
    found = _heliosplat.sun_hours(taken.heights, taken.cell_m, azimuth - taken.grid_north, elevation, hours, _LOWEST_DEG)
    return taken.wrap(found, "sun_hours", None, "h")


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


class _Taken:
    """A surface as the engine takes it, and results as ones of the surface's kind."""

    def __init__(self, heights: Any, cell_m: float, north: float | None) -> None:
        self.heights = np.ascontiguousarray(floats(heights, np.float32))
        if self.heights.ndim != 2:
            raise _heliosplat.Error(f"a surface has rows and columns; this array has {self.heights.ndim} dimensions")
        self.cell_m = float(cell_m)
        self.grid_north = 0.0 if north is None else float(north)

    def lon_lat(self) -> tuple[float, float]:
        raise _heliosplat.Error("an array has no place on the Earth: give lat and lon")

    def place(self, lat: float | None, lon: float | None) -> tuple[float, float]:
        """Latitude and longitude: those that are given, or those of the surface's middle."""
        if lat is not None and lon is not None:
            return float(lat), float(lon)
        lon, lat = self.lon_lat()
        return lat, lon

    def wrap(self, values: NDArray[Any], name: str, nodata: float | None, unit: str = "") -> Any:
        return values

    def series(self, masks: NDArray[np.uint8], times: NDArray[np.datetime64]) -> Any:
        return masks


class _TakenGrid(_Taken):
    def __init__(self, grid: Grid, cell_m: float | None, north: float | None) -> None:
        self.grid = grid.band(0)
        super().__init__(np.asarray(self.grid), cell_m or grid.cell_m, grid.grid_north if north is None else north)

    def lon_lat(self) -> tuple[float, float]:
        return self.grid.lon_lat

    def wrap(self, values: NDArray[Any], name: str, nodata: float | None, unit: str = "") -> Any:
        return self.grid.with_values(values, name, nodata, unit)

    def series(self, masks: NDArray[np.uint8], times: NDArray[np.datetime64]) -> Any:
        names = tuple(f"{time}Z" for time in times.astype("datetime64[m]"))
        return replace(self.grid, values=masks, bands=names, nodata=255, unit="")


class _TakenArray(_TakenGrid):
    """A DataArray of xarray."""

    def __init__(self, array: Any, cell_m: float | None, north: float | None) -> None:
        plane = array.isel(band=0) if "band" in array.dims else array
        if plane.ndim != 2:
            raise _heliosplat.Error(f"a surface has rows and columns; this one has {', '.join(map(str, plane.dims)) or 'neither'}")
        self.plane = plane.drop_vars("band", errors="ignore")
        heights = floats(plane.values, np.float32)
        for key in ("_FillValue", "missing_value", "nodata"):
            if key in array.attrs:
                heights = np.where(heights == np.float32(array.attrs[key]), np.float32(np.nan), heights)
        crs, transform = _system_of(array), None
        down, across = (plane.coords[name].values if name in plane.coords else np.zeros(0) for name in plane.dims)
        if any(str(plane.coords[name].attrs.get("units", "")).startswith("degree") for name in plane.dims if name in plane.coords):
            crs = crs or "EPSG:4326"
        if across.size > 1 and down.size > 1:
            dx, dy = (float(np.diff(axis).mean()) for axis in (across, down))
            if dy > 0.0:
                raise _heliosplat.Error("the DataArray's first row is in the south: use sortby('y', ascending=False)")
            if dx < 0.0:
                raise _heliosplat.Error("the DataArray's first column is in the east: use sortby('x')")
            transform = (float(across[0]) - dx / 2, dx, 0.0, float(down[0]) - dy / 2, 0.0, dy)
        elif cell_m is None:
            raise _heliosplat.Error("the DataArray has no coordinates: give cell_m")
        super().__init__(Grid(heights[np.newaxis], ("height",), transform, crs), cell_m, north)

    def wrap(self, values: NDArray[Any], name: str, nodata: float | None, unit: str = "") -> Any:
        out = self.plane.copy(data=values).rename(name)
        out.attrs = {key: value for key, value in self.plane.attrs.items() if key in ("crs", "transform", "grid_mapping")}
        out.attrs["long_name"] = name.replace("_", " ")
        if unit:
            out.attrs["units"] = unit
        # How the heights were stored says nothing of these values.
        out.encoding = {key: value for key, value in self.plane.encoding.items() if key == "grid_mapping"}
        if nodata is not None:
            out.attrs["_FillValue"] = nodata
        return out

    def series(self, masks: NDArray[np.uint8], times: NDArray[np.datetime64]) -> Any:
        first = self.wrap(masks[0], "shadow", 255)
        out = first.expand_dims(time=times.astype("datetime64[ns]")).copy(data=masks)
        out.encoding = first.encoding
        return out


def _system_of(array: Any) -> str | None:
    """The coordinate system of a DataArray: that of its grid mapping (CF, as rioxarray has it), or its attribute ``crs``."""
    for name in (array.encoding.get("grid_mapping"), array.attrs.get("grid_mapping"), "spatial_ref"):
        mapping = array.coords[name].attrs if name in array.coords else {}
        text = mapping.get("crs_wkt") or mapping.get("spatial_ref")
        if text:
            return epsg_or_text(str(text))
    crs = array.attrs.get("crs")
    return epsg_or_text(str(crs)) if crs else None


def _taken(surface: Any, cell_m: float | None, north: float | None) -> _Taken:
    if isinstance(surface, Grid):
        return _TakenGrid(surface, cell_m, north)
    if hasattr(surface, "dims") and hasattr(surface, "coords"):
        return _TakenArray(surface, cell_m, north)
    if cell_m is None:
        raise _heliosplat.Error("an array does not say how large its cells are: give cell_m")
    return _Taken(surface, cell_m, north)
