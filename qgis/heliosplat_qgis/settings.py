"""Where the program is."""

import os
import shutil

from processing.core.ProcessingConfig import ProcessingConfig

PROGRAM_SETTING = "HELIOSPLAT_PROGRAM"


def program():
    """The program of the settings, else of the environment (``HELIOSPLAT``), else on the PATH; ``None`` where there is none."""
    said = ProcessingConfig.getSetting(PROGRAM_SETTING) or os.environ.get("HELIOSPLAT") or "heliosplat"
    return shutil.which(said)
