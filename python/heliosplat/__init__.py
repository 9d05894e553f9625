"""RPC cameras, the sun, cast shadows and run folders of heliosplat as numpy arrays, and its program as functions.

Conventions: pixel centres are at whole numbers, the upper left one is (0, 0). Heights are metres above the WGS 84 ellipsoid. Angles are
degrees, azimuths clockwise from north. Unknown is NaN, in masks 255.
"""

from importlib.metadata import version

from ._heliosplat import Error
from .camera import Rpc
from .grid import Grid, read_geotiff
from .light import horizon, shadow_series, shadows, sun_hours, sun_position
from .program import call, dsm, find_program, inspect
from .run import Run, open_run, train

__version__ = version("heliosplat")
__all__ = [
    "Error",
    "Grid",
    "Rpc",
    "Run",
    "call",
    "dsm",
    "find_program",
    "horizon",
    "inspect",
    "open_run",
    "read_geotiff",
    "shadow_series",
    "shadows",
    "sun_hours",
    "sun_position",
    "train",
]
