"""The provider, and the one setting there is: where the program is."""

from pathlib import Path

from processing.core.ProcessingConfig import ProcessingConfig, Setting
from qgis.core import QgsProcessingProvider
from qgis.PyQt.QtGui import QIcon

from .algorithms import ALGORITHMS
from .settings import PROGRAM_SETTING

ICON = str(Path(__file__).with_name("icon.svg"))


class HeliosplatProvider(QgsProcessingProvider):
    def id(self):
        return "heliosplat"

    def name(self):
        return "heliosplat"

    def icon(self):
        return QIcon(ICON)

    def load(self):
        ProcessingConfig.settingIcons[self.name()] = self.icon()
        label = "Program heliosplat (empty: the one on the PATH)"
        ProcessingConfig.addSetting(Setting(self.name(), PROGRAM_SETTING, label, "", valuetype=Setting.FILE))
        ProcessingConfig.readSettings()
        self.refreshAlgorithms()
        return True

    def unload(self):
        ProcessingConfig.removeSetting(PROGRAM_SETTING)

    def loadAlgorithms(self):  # noqa: N802
        for algorithm in ALGORITHMS:
            self.addAlgorithm(algorithm())
