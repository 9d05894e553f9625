"""Rasters on a grid. Files are read by rasterio, the extra ``raster`` of the package."""

from __future__ import annotations

import importlib
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from . import _heliosplat

if TYPE_CHECKING:
    import xarray


@dataclass(frozen=True)
class Grid:
    """A raster and where it lies."""

    #: ``[band, row, column]``; floating point with NaN where nothing is known, else as the file has it.
    values: NDArray[Any]
    #: Names of the bands.
    bands: tuple[str, ...]
    #: From pixel corners to map coordinates, in GDAL's order: ``x = t[0] + col*t[1] + row*t[2]``, ``y = t[3] + col*t[4] + row*t[5]``.
    transform: tuple[float, float, float, float, float, float] | None
    #: Code of the coordinate system, if it has one.
    epsg: int | None
    #: What an integer raster has where nothing is known.
    nodata: float | None = None

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.values.shape[1:]

    @property
    def cell_m(self) -> float:
        """Side of a cell, metres. Raises where cells are not square, or the coordinate system is not in metres as far as is known."""
        if self.transform is None:
            raise _heliosplat.Error("the raster has no georeference: give cell_m")
        _, dx, skew_x, _, skew_y, dy = self.transform
        if skew_x or skew_y or abs(abs(dx) - abs(dy)) > 1e-3 * abs(dx):
            raise _heliosplat.Error("the raster's cells are not square and north-up: resample it first")
        if self.epsg is not None and 4000 <= self.epsg < 5000:
            raise _heliosplat.Error("the raster's cells are in degrees: reproject it to a system in metres, such as UTM")
        return abs(dx)

    def band(self, name: str | int) -> Grid:
        """One band, by name or by number from 0."""
        if isinstance(name, str) and name not in self.bands:
            raise _heliosplat.Error(f"no band {name!r}; there are {', '.join(self.bands)}")
        index = self.bands.index(name) if isinstance(name, str) else name
        return replace(self, values=self.values[index : index + 1], bands=(self.bands[index],))

    def with_values(self, values: NDArray[Any], name: str, nodata: float | None = None) -> Grid:
        """The same place with other values, ``[row, column]``."""
        return replace(self, values=values[np.newaxis], bands=(name,), nodata=nodata)

    def to_xarray(self) -> xarray.DataArray:
        """A DataArray with the coordinates ``band``, ``y`` and ``x`` (centres of cells) and the attributes ``crs`` and ``transform`` that
        rioxarray and rasterio use. Needs xarray.
        """
        try:
            import xarray
        except ImportError as error:
            raise _heliosplat.Error("xarray is not installed: pip install xarray") from error
        coordinates: dict[str, Any] = {"band": list(self.bands)}
        attributes: dict[str, Any] = {}
        if self.transform is not None:
            x0, dx, skew_x, y0, skew_y, dy = self.transform
            rows, cols = self.shape
            attributes["transform"] = (dx, skew_x, x0, skew_y, dy, y0)
            if not skew_x and not skew_y:
                coordinates["x"] = x0 + dx * (np.arange(cols) + 0.5)
                coordinates["y"] = y0 + dy * (np.arange(rows) + 0.5)
        if self.epsg is not None:
            attributes["crs"] = f"EPSG:{self.epsg}"
        if self.nodata is not None:
            attributes["_FillValue"] = self.nodata
        return xarray.DataArray(self.values, dims=("band", "y", "x"), coords=coordinates, attrs=attributes)


@contextmanager
def opened(path: str | os.PathLike[str]) -> Iterator[Any]:
    """A file as rasterio opens it; faults are of the package."""
    try:
        rasterio = importlib.import_module("rasterio")
    except ImportError as error:
        raise ImportError("reading GeoTIFFs needs rasterio: pip install 'heliosplat[raster]'") from error
    try:
        with rasterio.open(path) as file:
            yield file
    except rasterio.errors.RasterioError as error:
        reason = " ".join(str(error).split())
        raise _heliosplat.Error(reason if str(path) in reason else f"{path}: {reason}") from error


def read_geotiff(path: str | os.PathLike[str]) -> Grid:
    """A GeoTIFF, or another raster that rasterio reads, as arrays. Needs rasterio."""
    with opened(Path(path)) as file:
        values = file.read()
        nodata = file.nodata
        located = file.crs is not None or not file.transform.is_identity
        transform = file.transform.to_gdal() if located else None
        epsg = file.crs.to_epsg() if file.crs else None
        bands = tuple(name or str(number) for number, name in zip(file.indexes, file.descriptions))
    if nodata is not None and np.issubdtype(values.dtype, np.floating):
        values[values == np.asarray(nodata, dtype=values.dtype)] = np.nan
        nodata = None
    return Grid(values, bands, transform, epsg, nodata)
