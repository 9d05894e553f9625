"""Processing provider of heliosplat: the program's verbs as algorithms of QGIS."""


def classFactory(iface):  # noqa: N802, the name that QGIS calls
    from .plugin import HeliosplatPlugin

    return HeliosplatPlugin()
