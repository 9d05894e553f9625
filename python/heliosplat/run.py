"""Run folders as arrays."""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Iterable
from dataclasses import replace
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from . import _heliosplat
from .grid import Grid, read_geotiff
from .program import PathLike, Progress, _paths, call


class Run:
    """The folder of a trained satellite scene, and of its products."""

    def __init__(self, folder: str | os.PathLike[str]) -> None:
        self.folder = Path(folder)
        try:
            self.model: dict[str, Any] = json.loads((self.folder / "model.json").read_text())
        except FileNotFoundError as error:
            raise _heliosplat.Error(f"{self.folder}: not a run, it has no model.json") from error
        except (OSError, ValueError) as error:
            raise _heliosplat.Error(f"{self.folder / 'model.json'}: {error}") from error
        if self.model.get("model") != "shadow_gs":
            raise _heliosplat.Error(f"{self.folder}: a run of an object, not of a satellite scene")

    @property
    def origin(self) -> tuple[float, float, float]:
        """Longitude, latitude (degrees) and ellipsoidal height (metres) of the scene's centre."""
        origin = self.model["origin"]
        return origin["lon_deg"], origin["lat_deg"], origin["height_m"]

    @property
    def metrics(self) -> dict[str, Any]:
        """What ``metrics.json`` holds; empty where there is none."""
        path = self.folder / "metrics.json"
        return json.loads(path.read_text()) if path.is_file() else {}

    @property
    def products(self) -> list[str]:
        """Names of the rasters that there are, for :meth:`raster`."""
        files = [*self.folder.glob("*.tif"), *self.folder.glob("products/*.tif")]
        return sorted({file.stem for file in files})

    def raster(self, name: str) -> Grid:
        """A raster of the run or of its ``products`` folder by its name without the ending."""
        for path in (self.folder / "products" / f"{name}.tif", self.folder / f"{name}.tif"):
            if path.is_file():
                return read_geotiff(path)
        known = ", ".join(self.products) or "none"
        raise _heliosplat.Error(f"{self.folder}: no {name}.tif, there are {known}; `heliosplat products {self.folder}` writes them")

    @property
    def surface(self) -> Grid:
        """The surface model with all its bands: ``altitude``, and of the files beside it those that there are."""
        dsm = self.raster("dsm")
        others = [self.raster(name) for name in ("dsm_stddev", "dsm_coverage", "dsm_views") if name in self.products]
        bands = [band for grid in (dsm, *others) for band in grid.bands]
        values = np.concatenate([grid.values for grid in (dsm, *others)])
        return replace(dsm, values=values, bands=tuple(bands))

    @property
    def dsm(self) -> Grid:
        """The altitudes of the surface model."""
        return self.raster("dsm").band(0)

    @property
    def albedo(self) -> Grid:
        """The true-ortho albedo, a band for each of the images'."""
        return self.raster("albedo")

    @property
    def grid_north(self) -> float:
        """Azimuth of the surface model's upward direction, degrees clockwise from true north. Its grids bring it themselves."""
        return self.dsm.grid_north

    def write_products(self, *, progress: bool | Progress = True, program: PathLike | None = None, **options: Any) -> list[str]:
        """Writes the products into the folder ``products``, as ``heliosplat products`` does: ``sun="250,35"``, ``geoid="egm96"``; returns
        their names for :meth:`raster`.
        """
        call("products", os.fspath(self.folder), progress=progress, program=program, **options)
        return self.products

    def _repr_html_(self) -> str:
        return f"<p><b>{escape(repr(self))}</b><br>{escape(', '.join(self.products))}</p>"

    def relight(
        self, azimuth: float, elevation: float, program: PathLike | None = None
    ) -> tuple[Grid, Grid]:
        """The scene from above under another sun, in counts, and the mask of its shadows (1 = in shadow).

        The model is rendered by the program ``heliosplat``: ``program``, else as :func:`find_program` finds it.
        """
        with tempfile.TemporaryDirectory() as folder:
            out = Path(folder) / "relit.tif"
            call("relight", os.fspath(self.folder), program=program, sun=(float(azimuth), float(elevation)), out=out)
            return read_geotiff(out), read_geotiff(out.with_name("relit_shadow.tif"))

    def __repr__(self) -> str:
        lon, lat, _ = self.origin
        return f"Run({str(self.folder)!r}, {len(self.model['images'])} images around {lon:.4f} E, {lat:.4f} N)"


def train(
    scene: PathLike | Iterable[PathLike],
    out: PathLike,
    *,
    preset: str = "balanced",
    progress: bool | Progress = True,
    program: PathLike | None = None,
    **options: Any,
) -> Run:
    """Trains a model of images into the folder ``out``, and opens it."""
    call("train", *_paths(scene), out=os.fspath(out), preset=preset, progress=progress, program=program, **options)
    return Run(out)


def open_run(folder: str | os.PathLike[str]) -> Run:
    """Opens the folder that ``heliosplat train`` wrote."""
    return Run(folder)
