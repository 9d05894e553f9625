"""Run folders as arrays."""

from __future__ import annotations

import json
import math
import os
import shutil
import subprocess
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from . import _heliosplat
from .grid import Grid, read_geotiff


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
        """Azimuth of the surface model's upward direction, degrees clockwise from true north: ``grid_north`` of shadows and hours of sun.

        The meridian convergence of UTM at the scene's centre; raises for other coordinate systems.
        """
        epsg = self.surface.epsg
        zone = (epsg or 0) % 100
        if epsg is None or epsg // 100 not in (326, 327) or not 1 <= zone <= 60:
            raise _heliosplat.Error("the surface model is not in UTM: give grid_north yourself")
        lon, lat, _ = self.origin
        from_meridian = math.radians((lon - (6 * zone - 183) + 180) % 360 - 180)
        return math.degrees(math.atan(math.tan(from_meridian) * math.sin(math.radians(lat))))

    def relight(
        self, azimuth: float, elevation: float, program: str | os.PathLike[str] | None = None
    ) -> tuple[Grid, Grid]:
        """The scene from above under another sun, in counts, and the mask of its shadows (1 = in shadow).

        The model is rendered by the program ``heliosplat``, which must be installed: ``program``, else the environment's
        ``HELIOSPLAT``, else the one on the PATH.
        """
        found = shutil.which(program or os.environ.get("HELIOSPLAT") or "heliosplat")
        if found is None:
            raise _heliosplat.Error("relight needs the program heliosplat: put it on the PATH, or say where it is by program=")
        with tempfile.TemporaryDirectory() as folder:
            out = Path(folder) / "relit.tif"
            sun = f"{float(azimuth)!r},{float(elevation)!r}"
            done = subprocess.run(
                [found, "relight", self.folder, "--sun", sun, "--out", out, "--json"], capture_output=True, text=True
            )
            if done.returncode != 0:
                lines = done.stderr.strip().splitlines() or ["heliosplat relight failed"]
                raise _heliosplat.Error(lines[-1].removeprefix("error: "))
            return read_geotiff(out), read_geotiff(out.with_name("relit_shadow.tif"))

    def __repr__(self) -> str:
        lon, lat, _ = self.origin
        return f"Run({str(self.folder)!r}, {len(self.model['images'])} images around {lon:.4f} E, {lat:.4f} N)"


def open_run(folder: str | os.PathLike[str]) -> Run:
    """Opens the folder that ``heliosplat train`` wrote."""
    return Run(folder)
