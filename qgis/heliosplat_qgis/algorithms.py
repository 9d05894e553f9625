"""The algorithms: each is a verb of the program with its arguments as parameters."""

import json
from pathlib import Path

from qgis.core import (
    QgsCoordinateReferenceSystem,
    QgsProcessingAlgorithm,
    QgsProcessingException,
    QgsProcessingOutputFile,
    QgsProcessingOutputNumber,
    QgsProcessingOutputRasterLayer,
    QgsProcessingParameterBoolean,
    QgsProcessingParameterEnum,
    QgsProcessingParameterExtent,
    QgsProcessingParameterFile,
    QgsProcessingParameterFileDestination,
    QgsProcessingParameterFolderDestination,
    QgsProcessingParameterNumber,
    QgsProcessingParameterRasterDestination,
    QgsProcessingParameterString,
)
from qgis.PyQt.QtGui import QIcon

from . import child, settings

PRESETS = ["preview", "fast", "balanced", "accurate", "best"]
GEOGRAPHIC = "EPSG:4326"
FOLDER = QgsProcessingParameterFile.Folder


class Verb(QgsProcessingAlgorithm):
    """What all algorithms share: they run the program and follow it."""

    NAME = TITLE = GROUP = HELP = ""

    def name(self):
        return self.NAME

    def displayName(self):  # noqa: N802
        return self.TITLE

    def group(self):
        return self.GROUP

    def groupId(self):  # noqa: N802
        return self.GROUP.lower().replace(" ", "_")

    def shortHelpString(self):  # noqa: N802
        return self.HELP

    def icon(self):
        return QIcon(str(Path(__file__).with_name("icon.svg")))

    def createInstance(self):  # noqa: N802
        return type(self)()

    def run_program(self, arguments, feedback):
        """The program's answer; its progress and log go to ``feedback``."""
        program = settings.program()
        if program is None:
            raise QgsProcessingException(
                "The program heliosplat was not found: say where it is in Settings > Options > Processing > Providers > heliosplat"
            )
        command = [program, *(str(argument) for argument in arguments), "--json"]
        feedback.pushCommandInfo(" ".join(command))

        def progress(label, percent):
            feedback.setProgressText(label)
            feedback.setProgress(percent)

        try:
            return child.run(command, feedback.pushInfo, progress, feedback.isCanceled)
        except child.ChildError as error:
            raise QgsProcessingException(str(error)) from error
        except OSError as error:
            raise QgsProcessingException(f"{program}: {error.strerror}") from error

    # Parameters that several algorithms have.

    def add_scene(self):
        self.addParameter(QgsProcessingParameterFile("SCENE", "Folder of the images, or of a scene.toml", FOLDER))

    def add_ground(self):
        self.addParameter(QgsProcessingParameterExtent("EXTENT", "Only this piece of ground", optional=True))
        label = "Lowest and highest altitude above the ellipsoid, metres, as in 400,900 (empty: found from the images)"
        self.addParameter(QgsProcessingParameterString("ALTITUDE", label, optional=True))

    def add_run(self):
        self.addParameter(QgsProcessingParameterFile("RUN", "Folder of a run", FOLDER))

    def add_number(self, name, label, default=None, low=None, high=None):
        number = QgsProcessingParameterNumber.Double
        limits = {key: value for key, value in (("minValue", low), ("maxValue", high)) if value is not None}
        optional = default is None
        self.addParameter(QgsProcessingParameterNumber(name, label, number, default, optional, **limits))

    def ground(self, parameters, context):
        """The arguments of what :meth:`add_ground` asked for."""
        arguments = []
        if parameters.get("EXTENT"):
            lon_lat = QgsCoordinateReferenceSystem(GEOGRAPHIC)
            box = self.parameterAsExtent(parameters, "EXTENT", context, lon_lat)
            if not box.isEmpty():
                numbers = (box.xMinimum(), box.yMinimum(), box.xMaximum(), box.yMaximum())
                arguments += ["--area", ",".join(f"{number:.9f}" for number in numbers)]
        altitude = self.parameterAsString(parameters, "ALTITUDE", context).replace(" ", "")
        return arguments + (["--altitude", altitude] if altitude else [])

    def number(self, parameters, name, context):
        """The number of an optional parameter, or ``None``."""
        return None if parameters.get(name) is None else self.parameterAsDouble(parameters, name, context)


class Inspect(Verb):
    NAME, TITLE, GROUP = "inspect", "Inspect a scene", "Scenes"
    HELP = "Lists cameras, suns, bands, overlap and altitudes of a folder of satellite images, and how it will be treated."

    def initAlgorithm(self, configuration=None):  # noqa: N802, ARG002
        self.add_scene()
        self.add_ground()
        self.addParameter(QgsProcessingParameterFileDestination("OUTPUT", "Report", "JSON (*.json)", optional=True))
        self.addOutput(QgsProcessingOutputNumber("IMAGES", "Number of images"))

    def processAlgorithm(self, parameters, context, feedback):  # noqa: N802
        scene = self.parameterAsString(parameters, "SCENE", context)
        found = self.run_program(["inspect", scene, *self.ground(parameters, context)], feedback)
        text = json.dumps(found, indent=2)
        results = {"IMAGES": len(found.get("images", []))}
        path = self.parameterAsFileOutput(parameters, "OUTPUT", context)
        if path:
            Path(path).write_text(text, encoding="utf-8")
            results["OUTPUT"] = path
        feedback.pushInfo(text)
        return results


class DsmFromSweep(Verb):
    NAME, TITLE, GROUP = "dsm_from_sweep", "Surface model from a sweep", "Surface models"
    HELP = (
        "Makes a surface model of satellite images with RPC cameras by a plane sweep, without training: minutes instead of hours. "
        "The file is the altitude above the ellipsoid; files beside it are its standard deviation, coverage, and how many images see it."
    )

    def initAlgorithm(self, configuration=None):  # noqa: N802, ARG002
        self.add_scene()
        self.add_ground()
        self.add_number("GSD", "Side of a cell, metres (empty: as the images)", low=0.01)
        self.addParameter(QgsProcessingParameterBoolean("FILL", "Close holes", False))
        self.addParameter(QgsProcessingParameterRasterDestination("OUTPUT", "Surface model"))

    def processAlgorithm(self, parameters, context, feedback):  # noqa: N802
        out = self.parameterAsOutputLayer(parameters, "OUTPUT", context)
        scene = self.parameterAsString(parameters, "SCENE", context)
        arguments = ["dsm", scene, "--from", "sweep", "--out", out, *self.ground(parameters, context)]
        gsd = self.number(parameters, "GSD", context)
        if gsd is not None:
            arguments += ["--gsd", gsd]
        if self.parameterAsBool(parameters, "FILL", context):
            arguments.append("--fill")
        self.run_program(arguments, feedback)
        return {"OUTPUT": out}


class Train(Verb):
    NAME, TITLE, GROUP = "train", "Train and write products", "Surface models"
    HELP = (
        "Fits a model of the ground to satellite images of several dates, and writes surface model, albedo, shadow masks, point cloud "
        "and a layer file that opens all of them. Cancelling saves what there is; running it again with the same folder goes on."
    )

    def initAlgorithm(self, configuration=None):  # noqa: N802, ARG002
        self.add_scene()
        self.add_ground()
        self.addParameter(QgsProcessingParameterEnum("PRESET", "Preset", PRESETS, defaultValue=PRESETS.index("fast")))
        self.addParameter(QgsProcessingParameterBoolean("OVERWRITE", "Replace what is in the folder", False))
        self.addParameter(QgsProcessingParameterFolderDestination("RUN", "Folder of the run"))
        self.addOutput(QgsProcessingOutputRasterLayer("DSM", "Surface model"))
        self.addOutput(QgsProcessingOutputFile("LAYERS", "Layer file"))

    def processAlgorithm(self, parameters, context, feedback):  # noqa: N802
        run = Path(self.parameterAsString(parameters, "RUN", context))
        scene = self.parameterAsString(parameters, "SCENE", context)
        preset = PRESETS[self.parameterAsEnum(parameters, "PRESET", context)]
        arguments = ["train", scene, "--out", run, "--preset", preset, *self.ground(parameters, context)]
        arguments.append("--overwrite" if self.parameterAsBool(parameters, "OVERWRITE", context) else "--resume")
        self.run_program(arguments, feedback)
        products = run / "products"
        self.run_program(["products", run, "--out", products], feedback)
        return {"RUN": str(run), "DSM": str(run / "dsm.tif"), "LAYERS": str(products / "layers.qlr")}


class Relight(Verb):
    NAME, TITLE, GROUP = "relight", "Relight", "Light"
    HELP = "Writes the ground of a run under another sun, seen from above, and the mask of its shadows."

    def initAlgorithm(self, configuration=None):  # noqa: N802, ARG002
        self.add_run()
        self.add_number("AZIMUTH", "Azimuth of the sun, degrees clockwise from north", 135.0, 0.0, 360.0)
        self.add_number("ELEVATION", "Elevation of the sun, degrees", 35.0, 1.0, 89.9)
        label = "Or the sun of this moment, as in 2026-06-21T09:00:00Z"
        self.addParameter(QgsProcessingParameterString("TIME", label, optional=True))
        self.addParameter(QgsProcessingParameterRasterDestination("OUTPUT", "Relit image"))
        self.addOutput(QgsProcessingOutputRasterLayer("SHADOW", "Shadow mask"))

    def processAlgorithm(self, parameters, context, feedback):  # noqa: N802
        out = self.parameterAsOutputLayer(parameters, "OUTPUT", context)
        time = self.parameterAsString(parameters, "TIME", context).strip()
        azimuth = self.parameterAsDouble(parameters, "AZIMUTH", context)
        elevation = self.parameterAsDouble(parameters, "ELEVATION", context)
        sun = ["--time", time] if time else ["--sun", f"{azimuth},{elevation}"]
        run = self.parameterAsString(parameters, "RUN", context)
        self.run_program(["relight", run, *sun, "--out", out], feedback)
        path = Path(out)
        return {"OUTPUT": out, "SHADOW": str(path.with_name(f"{path.stem}_shadow.tif"))}


class SunHours(Verb):
    NAME, TITLE, GROUP = "sun_hours", "Hours of sun", "Light"
    HELP = "Writes the products of a run with the hours of direct sun that each cell gets on a day, or between two days."

    def initAlgorithm(self, configuration=None):  # noqa: N802, ARG002
        self.add_run()
        self.addParameter(QgsProcessingParameterString("FROM", "Day, as in 2026-06-21", "2026-06-21"))
        self.addParameter(QgsProcessingParameterString("TO", "Last day", optional=True))
        self.addParameter(QgsProcessingParameterFolderDestination("FOLDER", "Folder of the products"))
        self.addOutput(QgsProcessingOutputRasterLayer("SUN_HOURS", "Hours of sun"))

    def processAlgorithm(self, parameters, context, feedback):  # noqa: N802
        folder = Path(self.parameterAsString(parameters, "FOLDER", context))
        first = self.parameterAsString(parameters, "FROM", context).strip()
        last = self.parameterAsString(parameters, "TO", context).strip()
        days = f"{first}/{last}" if last else first
        run = self.parameterAsString(parameters, "RUN", context)
        self.run_program(["products", run, "--out", folder, "--sun-hours", days], feedback)
        return {"FOLDER": str(folder), "SUN_HOURS": str(folder / "sun_hours.tif")}


ALGORITHMS = [Inspect, DsmFromSweep, Train, Relight, SunHours]
