"""RPC cameras."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import ArrayLike

from . import _heliosplat
from ._arrays import floats
from .grid import opened

#: First bytes of TIFF and BigTIFF, little and big endian.
_TIFF = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
#: No text of a camera is larger.
_TEXT_MAX = 64 << 20


class Rpc:
    """A rational polynomial camera: where in the image is a point of the ground, and the other way round."""

    def __init__(self, camera: _heliosplat.Camera) -> None:
        self._camera = camera
        self._range: list[tuple[float, float]] | None = None

    @classmethod
    def open(cls, path: str | os.PathLike[str]) -> Rpc:
        """The camera of a file: of a GeoTIFF (its RPC tag, or a camera file beside it; needs rasterio), or of a text file: RPB, _RPC.TXT,
        DIMAP RPC_*.XML, Maxar XML, JSON of Sat-NeRF, rpcm or VisSat. The content decides the format.
        """
        path = Path(path)
        with _opened(path) as file:
            start = file.read(4)
        if start in _TIFF:
            with opened(path) as image:
                found = image.rpcs.to_dict() if image.rpcs else None
            if found:
                values = {key.upper(): value for key, value in found.items() if value is not None}
                return cls(_heliosplat.Camera.from_text(str(path), json.dumps(values)))
            beside = _beside(path)
            if beside is None:
                raise _heliosplat.Error(f"{path}: no RPC tag, and no RPB, _RPC.TXT or RPC_*.XML beside it")
            path = beside
        return cls(_heliosplat.Camera.from_text(path.name, _text(path)))

    @classmethod
    def from_text(cls, text: str, name: str = "text") -> Rpc:
        """The camera in a text of any known format; ``name`` is for messages."""
        return cls(_heliosplat.Camera.from_text(name, text))

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> Rpc:
        """The camera of a dictionary with the keys of rpcm (``row_offset`` ...), VisSat or GDAL (``LINE_OFF`` ...)."""
        return cls(_heliosplat.Camera.from_text("dictionary", json.dumps(values)))

    def to_dict(self) -> dict[str, Any]:
        """Its numbers under the keys of rpcm: ``rpcm.RPCModel(rpc.to_dict(), dict_format="rpcm")`` is the same camera."""
        values: dict[str, Any] = json.loads(self._camera.json())
        return values

    def to_rpc_txt(self) -> str:
        """The text of an ``_RPC.TXT`` file."""
        return self._camera.rpc_txt()

    def project(self, lon: ArrayLike, lat: ArrayLike, height: ArrayLike) -> tuple[Any, Any]:
        """Columns and rows of ground points: degrees, and metres above the ellipsoid. Arrays are broadcast; numbers give numbers."""
        lons, lats = floats(lon), floats(lat)
        if lons.size and lats.size and not self._covers(lons, lats) and self._covers(lats, lons):
            raise _heliosplat.Error("no point lies in the camera's area, but all would with lon and lat swapped: lon comes first")
        return _elementwise(self._camera.project, lon, lat, height)

    def _covers(self, lons: Any, lats: Any) -> bool:
        """True if every point that is known lies within the range of the camera's polynomials."""
        if self._range is None:
            values = self.to_dict()
            self._range = [(values[f"{name}_offset"], abs(values[f"{name}_scale"])) for name in ("lon", "lat")]
        (lon, wide), (lat, high) = self._range
        return bool((np.abs(lons - lon) <= wide).all() and (np.abs(lats - lat) <= high).all())

    def localise(self, col: ArrayLike, row: ArrayLike, height: ArrayLike) -> tuple[Any, Any]:
        """Longitudes and latitudes of image points at heights above the ellipsoid; NaN where there is no such point of the ground."""
        return _elementwise(self._camera.localise, col, row, height)

    def __repr__(self) -> str:
        values = self.to_dict()
        return (
            f"Rpc({values['lon_offset']:.4f} E, {values['lat_offset']:.4f} N, {values['alt_offset']:g} m, "
            f"{2 * values['col_scale']:g} x {2 * values['row_scale']:g} pixels)"
        )


def _elementwise(function: Any, *arrays: ArrayLike) -> tuple[Any, Any]:
    whole = np.broadcast_arrays(*(floats(array) for array in arrays))
    shape = whole[0].shape
    flat = [np.ascontiguousarray(array).reshape(-1) for array in whole]
    first, second = function(*flat)
    if shape == ():
        return float(first[0]), float(second[0])
    return first.reshape(shape), second.reshape(shape)


def _opened(path: Path) -> BinaryIO:
    try:
        return path.open("rb")
    except OSError as error:
        raise _heliosplat.Error(f"{path}: {error.strerror}") from error


def _text(path: Path) -> str:
    with _opened(path) as file:
        data = file.read(_TEXT_MAX + 1)
    if len(data) > _TEXT_MAX:
        raise _heliosplat.Error(f"{path}: too large for a camera file")
    return data.decode("utf-8", errors="replace")


def _beside(image: Path) -> Path | None:
    """The camera file of an image: as Maxar, or as Airbus name them."""
    names = [image.stem + end for end in (".RPB", ".rpb", "_RPC.TXT", "_RPC.txt", "_rpc.txt", ".RPC", "_RPC.XML")]
    if image.stem.startswith("IMG_"):
        names += ["RPC_" + image.stem[4:] + end for end in (".XML", ".xml")]
    found = (image.with_name(name) for name in names)
    return next((path for path in found if path.is_file()), None)
