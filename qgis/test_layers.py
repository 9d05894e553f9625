#!/usr/bin/env python3
"""Opens products in QGIS: each raster takes its style, and the layer file opens all of them, in their place.

Usage: test_layers.py PRODUCTS [PICTURE.png]     (with the Python that QGIS has)
"""

import os
import sys
from pathlib import Path

from qgis.core import QgsApplication, QgsLayerDefinition, QgsMapRendererParallelJob, QgsMapSettings, QgsProject, QgsRasterLayer
from qgis.PyQt.QtCore import QSize

RENDERERS = {"dsm": "singlebandpseudocolor", "sun_hours": "singlebandpseudocolor", "hillshade": "singlebandgray"}

application = QgsApplication([], False)
application.initQgis()
folder = Path(sys.argv[1]).resolve()
for path in sorted(folder.glob("*.tif")):
    layer = QgsRasterLayer(str(path), path.stem)
    renderer = layer.renderer().type()
    assert layer.isValid() and layer.crs().isValid(), path
    wanted = RENDERERS.get(path.stem)
    wanted = wanted or ("paletted" if "shadow" in path.stem or path.stem == "vegetation" else None)
    assert wanted is None or renderer == wanted, f"{path.name}: {renderer}, not {wanted}"
    print(f"{path.name}: {renderer}")

project = QgsProject.instance()
good, message = QgsLayerDefinition.loadLayerDefinition(str(folder / "layers.qlr"), project, project.layerTreeRoot())
assert good, message
layers = list(project.mapLayers().values())
bad = [(layer.name(), layer.isValid(), layer.crs().isValid(), layer.source()) for layer in layers if not (layer.isValid() and layer.crs().isValid())]
assert layers and not bad, f"{bad} of {len(layers)} layers have no place"
print(f"{len(layers)} layers in group {project.layerTreeRoot().children()[0].name()!r}")
if len(sys.argv) > 2:
    shown = project.layerTreeRoot().checkedLayers()
    settings = QgsMapSettings()
    settings.setLayers(shown)
    settings.setDestinationCrs(shown[0].crs())
    settings.setExtent(shown[0].extent())
    settings.setOutputSize(QSize(600, 600))
    job = QgsMapRendererParallelJob(settings)
    job.start()
    job.waitForFinished()
    job.renderedImage().save(sys.argv[2])
# Not exitQgis(): layers that Python still holds crash QGIS when it is taken down.
sys.stdout.flush()
os._exit(0)
