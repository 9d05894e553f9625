"""Where tests find data that is not part of the repository."""

import os
from pathlib import Path

import pytest


def _shared():
    said = os.environ.get("HELIOSPLAT_SHARED")
    folder = Path(said) if said else Path(__file__).parents[2].parent / "shared"
    return folder if folder.is_dir() else None


@pytest.fixture
def shared():
    """The folder of shared data; skips without it, unless HELIOSPLAT_REQUIRE_SHARED says that it must be there."""
    folder = _shared()
    if folder is None:
        if os.environ.get("HELIOSPLAT_REQUIRE_SHARED"):
            pytest.fail("no shared data, and HELIOSPLAT_REQUIRE_SHARED is set")
        pytest.skip("no shared data")
    return folder
