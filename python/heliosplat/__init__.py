"""RPC cameras, the sun, cast shadows and run folders of heliosplat as numpy arrays.

Conventions: pixel centres are at whole numbers, the upper left one is (0, 0). Heights are metres above the WGS 84 ellipsoid. Angles are
degrees, azimuths clockwise from north. Unknown is NaN, in masks 255.
"""

from ._heliosplat import Error
from .camera import Rpc
from .grid import Grid, read_geotiff
from .light import horizon, shadows, sun_hours, sun_position
from .run import Run, open_run

__all__ = [
    "Error",
    "Grid",
    "Rpc",
    "Run",
    "horizon",
    "open_run",
    "read_geotiff",
    "shadows",
    "sun_hours",
    "sun_position",
]
