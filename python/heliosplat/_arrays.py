"""What callers give as arrays."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray


def floats(values: Any, dtype: type[np.floating[Any]] = np.float64) -> NDArray[Any]:
    """Numbers as floating point; masked ones are NaN."""
    if isinstance(values, np.ma.MaskedArray):
        filled: NDArray[Any] = np.ma.filled(values.astype(dtype), np.nan)  # type: ignore[no-untyped-call,unused-ignore]
        return filled
    return np.asarray(values, dtype=dtype)
