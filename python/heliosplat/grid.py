"""Rasters on a grid. Files are read and written by rasterio, the extra ``raster`` of the package."""

from __future__ import annotations

import importlib
import math
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin
from numpy.typing import NDArray

from . import _heliosplat

if TYPE_CHECKING:
    import xarray

Transform = tuple[float, float, float, float, float, float]
#: Squared eccentricity of the WGS 84 ellipsoid.
_E2 = 0.0066943799901413165


@dataclass(frozen=True, eq=False)
class Grid(NDArrayOperatorsMixin):
    """A raster and where it lies. numpy takes it as its values: ``np.nanmean(dsm)``, ``dsm - dtm``, ``plt.imshow(dsm)``."""

    #: ``[band, row, column]``; floating point with NaN where nothing is known, else as the file has it.
    values: NDArray[Any]
    #: Names of the bands.
    bands: tuple[str, ...]
    #: From pixel corners to map coordinates, in GDAL's order: ``x = t[0] + col*t[1] + row*t[2]``, ``y = t[3] + col*t[4] + row*t[5]``.
    transform: Transform | None
    #: Coordinate system: ``EPSG:32637``, or WKT.
    crs: str | None
    #: What an integer raster has where nothing is known.
    nodata: float | None = None
    #: Unit of the values.
    unit: str = ""

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.values.shape[1:]

    @property
    def epsg(self) -> int | None:
        """Code of the coordinate system, if it has one."""
        code = (self.crs or "").removeprefix("EPSG:")
        return int(code) if code.isdigit() else None

    @property
    def cell_m(self) -> float:
        """Side of a cell, metres. Raises where cells are not square and north-up, or the coordinate system has degrees."""
        if self.transform is None:
            raise _heliosplat.Error("the raster has no georeference: give cell_m")
        _, dx, skew_x, _, skew_y, dy = self.transform
        if skew_x or skew_y or abs(abs(dx) - abs(dy)) > 1e-3 * abs(dx):
            raise _heliosplat.Error("the raster's cells are not square and north-up: resample it first")
        return abs(dx) * metres_per_unit(self.crs)

    @property
    def grid_north(self) -> float:
        """Azimuth of the upward direction of the columns at the middle, degrees clockwise from true north; 0 without a coordinate system."""
        if self.crs is None or self.transform is None:
            return 0.0
        x0, dx, skew_x, y0, skew_y, dy = self.transform
        rows, cols = self.shape
        middle = x0 + dx * cols / 2 + skew_x * rows / 2, y0 + skew_y * cols / 2 + dy * rows / 2
        return grid_north(self.crs, *middle)

    @property
    def lon_lat(self) -> tuple[float, float]:
        """Longitude and latitude of the middle, degrees."""
        if self.crs is None or self.transform is None:
            raise _heliosplat.Error("the raster has no place on the Earth: give lat and lon")
        x0, dx, skew_x, y0, skew_y, dy = self.transform
        rows, cols = self.shape
        x, y = x0 + dx * cols / 2 + skew_x * rows / 2, y0 + skew_y * cols / 2 + dy * rows / 2
        lon, lat = _to_lon_lat(self.crs, [x], [y])
        return lon[0], lat[0]

    def band(self, name: str | int) -> Grid:
        """One band, by name or by number from 0."""
        if isinstance(name, str) and name not in self.bands:
            raise _heliosplat.Error(f"no band {name!r}; there are {', '.join(self.bands)}")
        index = self.bands.index(name) if isinstance(name, str) else name
        return replace(self, values=self.values[index : index + 1], bands=(self.bands[index],))

    def with_values(self, values: NDArray[Any], name: str, nodata: float | None = None, unit: str = "") -> Grid:
        """The same place with other values, ``[row, column]``."""
        return replace(self, values=values[np.newaxis], bands=(name,), nodata=nodata, unit=unit)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        """The values: ``[row, column]`` of one band, else ``[band, row, column]``; unknown is NaN."""
        values = self.values[0] if len(self.bands) == 1 else self.values
        if self.nodata is not None:
            values = np.where(values == self.nodata, np.nan, values)
        return np.array(values, dtype=dtype, copy=True) if copy or dtype is not None else np.asarray(values)

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, **more: Any) -> Any:
        if method != "__call__" or more.get("out"):
            return NotImplemented
        grids = [value for value in inputs if isinstance(value, Grid)]
        for grid in grids[1:]:
            if grid.shape != grids[0].shape or not same_place(grid, grids[0]):
                raise _heliosplat.Error("the grids do not lie on the same cells: resample one first")
        found = ufunc(*(np.asarray(value) if isinstance(value, Grid) else value for value in inputs), **more)
        if not isinstance(found, np.ndarray) or found.shape[-2:] != grids[0].shape:
            return found
        bands = grids[0].bands
        whole = found.reshape(-1, *grids[0].shape)
        names = bands if len(bands) == len(whole) else tuple(map(str, range(1, len(whole) + 1)))
        return replace(grids[0], values=whole, bands=names, nodata=None)

    def plot(self, ax: Any = None, **more: Any) -> Any:
        """Draws the first band with a colour bar, or red, green and blue, in map coordinates; returns the axes. Needs matplotlib."""
        plt = importlib.import_module("matplotlib.pyplot")
        ax = plt.gca() if ax is None else ax
        values = np.asarray(self.values, dtype=float)
        if self.nodata is not None:
            values = np.where(values == self.nodata, np.nan, values)
        if self.transform is not None and not (self.transform[2] or self.transform[4]):
            x0, dx, _, y0, _, dy = self.transform
            rows, cols = self.shape
            more.setdefault("extent", (x0, x0 + dx * cols, y0 + dy * rows, y0))
        colours = [self.bands.index(name) for name in ("red", "green", "blue") if name in self.bands]
        if len(colours) == 3:
            low, high = np.nanpercentile(values[colours], (1, 99))
            shown = np.clip((values[colours] - low) / max(high - low, 1e-12), 0, 1) ** (1 / 2.2)
            ax.imshow(np.nan_to_num(np.moveaxis(shown, 0, -1)), **more)
        else:
            picture = ax.imshow(values[0], **more)
            ax.figure.colorbar(picture, ax=ax, label=f"{self.bands[0]} {f'({self.unit})' if self.unit else ''}".strip())
        ax.ticklabel_format(useOffset=False, style="plain")
        return ax

    def to_geotiff(self, path: str | os.PathLike[str]) -> None:
        """Writes a GeoTIFF with its coordinate system, names of bands, unit and nodata. Needs rasterio."""
        rasterio = _rasterio()
        is_float = np.issubdtype(self.values.dtype, np.floating)
        values = np.where(np.isnan(self.values), -9999, self.values).astype(self.values.dtype) if is_float else self.values
        profile = {
            "driver": "GTiff",
            "count": len(self.bands),
            "height": self.shape[0],
            "width": self.shape[1],
            "dtype": values.dtype.name,
            "crs": self.crs,
            "nodata": -9999 if is_float else self.nodata,
            "compress": "deflate",
            "tiled": True,
            "blockxsize": 256,
            "blockysize": 256,
        }
        if self.transform is not None:
            profile["transform"] = rasterio.Affine.from_gdal(*self.transform)
        with _faults(path), rasterio.open(path, "w", **profile) as file:
            file.write(values)
            file.descriptions = self.bands
            file.units = (self.unit,) * len(self.bands)

    def to_xarray(self) -> xarray.DataArray:
        """A DataArray with the coordinates ``band``, ``y`` and ``x`` (centres of cells), and the coordinate system and nodata as CF has them:
        ``spatial_ref`` and ``_FillValue``, which rioxarray reads. Needs xarray.
        """
        try:
            import xarray
        except ImportError as error:
            raise _heliosplat.Error("xarray is not installed: pip install xarray") from error
        coordinates: dict[str, Any] = {"band": list(self.bands)}
        attributes: dict[str, Any] = {"long_name": self.bands[0] if len(self.bands) == 1 else self.bands}
        if self.unit:
            attributes["units"] = self.unit
        place: dict[str, Any] = {}
        if self.transform is not None:
            x0, dx, skew_x, y0, skew_y, dy = self.transform
            rows, cols = self.shape
            place["GeoTransform"] = " ".join(map(repr, map(float, self.transform)))
            if not skew_x and not skew_y:
                coordinates["x"] = ("x", x0 + dx * (np.arange(cols) + 0.5), {"axis": "X", "standard_name": "projection_x_coordinate"})
                coordinates["y"] = ("y", y0 + dy * (np.arange(rows) + 0.5), {"axis": "Y", "standard_name": "projection_y_coordinate"})
        if self.crs is not None:
            place["crs_wkt"] = place["spatial_ref"] = _wkt(self.crs)
        coordinates["spatial_ref"] = ((), 0, place)
        if self.nodata is not None:
            attributes["_FillValue"] = self.nodata
        name = self.bands[0] if len(self.bands) == 1 else None
        array = xarray.DataArray(self.values, dims=("band", "y", "x"), coords=coordinates, attrs=attributes, name=name)
        array.encoding["grid_mapping"] = "spatial_ref"
        return array

    def __repr__(self) -> str:
        rows, cols = self.shape
        return f"Grid({', '.join(self.bands)}: {rows} x {cols}, {self.values.dtype}, {(self.crs or 'no coordinate system')[:40]})"

    def _repr_html_(self) -> str:
        values = np.asarray(self, dtype=float)
        known = np.isfinite(values)
        span = f"{np.nanmin(values):g} to {np.nanmax(values):g} {self.unit}, {known.mean():.1%} known" if known.any() else "nothing known"
        return f"<p><b>{escape(repr(self))}</b><br>{escape(span)}</p>"


def same_place(a: Grid, b: Grid) -> bool:
    """True if two grids of one shape lie on the same cells, as far as both say."""
    if a.transform is None or b.transform is None:
        return True
    return a.crs == b.crs and bool(np.allclose(a.transform, b.transform, rtol=0, atol=1e-6 * abs(a.transform[1])))


def _rasterio() -> Any:
    try:
        importlib.import_module("rasterio.warp")
        return importlib.import_module("rasterio")
    except ImportError as error:
        raise ImportError("GeoTIFFs and coordinate systems need rasterio: pip install 'heliosplat[raster]'") from error


@contextmanager
def _faults(path: str | os.PathLike[str]) -> Iterator[None]:
    """Faults of rasterio as faults of the package."""
    errors = importlib.import_module("rasterio.errors")
    try:
        yield
    except errors.RasterioError as error:
        reason = " ".join(str(error).split())
        raise _heliosplat.Error(reason if str(path) in reason else f"{path}: {reason}") from error


@contextmanager
def opened(path: str | os.PathLike[str]) -> Iterator[Any]:
    """A file as rasterio opens it; faults are of the package."""
    rasterio = _rasterio()
    with _faults(path), rasterio.open(path) as file:
        yield file


def _system(crs: str) -> Any:
    rasterio = _rasterio()
    try:
        return rasterio.crs.CRS.from_user_input(crs)
    except rasterio.errors.CRSError as error:
        raise _heliosplat.Error(f"coordinate system {crs[:60]}: {error}") from error


def epsg_or_text(crs: str) -> str:
    """The short name of a coordinate system, ``EPSG:32637``, where it has one; without rasterio the text as it is."""
    try:
        return str(_system(crs).to_string())
    except ImportError:
        return crs


def _wkt(crs: str) -> str:
    try:
        return str(_system(crs).to_wkt())
    except ImportError:
        return crs


def _zone(crs: str) -> int | None:
    """The UTM zone on WGS 84."""
    code = crs.removeprefix("EPSG:")
    zone = int(code) % 100 if code.isdigit() and code[:-2] in ("326", "327") else 0
    return zone if 1 <= zone <= 60 else None


def metres_per_unit(crs: str | None) -> float:
    """Metres per unit of a coordinate system's axes; 1 of none. Raises for degrees."""
    if crs is None or _zone(crs):
        return 1.0
    system = _system(crs)
    if system.is_geographic:
        raise _heliosplat.Error("the cells are in degrees: reproject the surface to a system in metres, such as UTM")
    return float(system.linear_units_factor[1])


def _to_lon_lat(crs: str, xs: list[float], ys: list[float]) -> tuple[list[float], list[float]]:
    found = _rasterio().warp.transform(_system(crs), _system("EPSG:4326"), xs, ys)
    if not np.isfinite(found).all():
        raise _heliosplat.Error("the raster lies outside of its coordinate system")
    return found[0], found[1]


def grid_north(crs: str, x: float, y: float) -> float:
    """Azimuth of the direction of rising ``y`` at a point, degrees clockwise from true north."""
    step = 50.0 / (1.0 if _zone(crs) else _units(crs))
    (west, east), (south, north) = _to_lon_lat(crs, [x, x], [y - step, y + step])
    lat = math.radians((south + north) / 2)
    # Metres of a radian of longitude over those of one of latitude, beside the cosine.
    ratio = (1 - _E2 * math.sin(lat) ** 2) / (1 - _E2)
    across = ((east - west + 180) % 360 - 180) * math.cos(lat) * ratio
    return math.degrees(math.atan2(across, north - south))


def _units(crs: str) -> float:
    system = _system(crs)
    return 111_320.0 if system.is_geographic else float(system.linear_units_factor[1])


def read_geotiff(path: str | os.PathLike[str]) -> Grid:
    """A GeoTIFF, or another raster that rasterio reads, as arrays. Needs rasterio."""
    with opened(Path(path)) as file:
        values = file.read()
        nodata = file.nodata
        located = file.crs is not None or not file.transform.is_identity
        transform = file.transform.to_gdal() if located else None
        crs = file.crs.to_string() if file.crs else None
        bands = tuple(name or str(number) for number, name in zip(file.indexes, file.descriptions))
        unit = file.units[0] or ""
    if nodata is not None and np.issubdtype(values.dtype, np.floating):
        values[values == np.asarray(nodata, dtype=values.dtype)] = np.nan
        nodata = None
    return Grid(values, bands, transform, crs, nodata, unit)
