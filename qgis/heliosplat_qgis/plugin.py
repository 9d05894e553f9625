"""The plugin: it adds the provider to Processing, with and without a window."""

from qgis.core import QgsApplication

from .provider import HeliosplatProvider


class HeliosplatPlugin:
    def __init__(self):
        self.provider = None

    def initProcessing(self):  # noqa: N802
        self.provider = HeliosplatProvider()
        QgsApplication.processingRegistry().addProvider(self.provider)

    def initGui(self):  # noqa: N802
        self.initProcessing()

    def unload(self):
        if self.provider is not None:
            QgsApplication.processingRegistry().removeProvider(self.provider)
            self.provider = None
