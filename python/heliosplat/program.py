"""Drives the program ``heliosplat``: its verbs as functions, with progress, its answers as dictionaries, grids and runs."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import sysconfig
import threading
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from . import _heliosplat
from .grid import Grid, read_geotiff

PathLike = str | os.PathLike[str]
#: Called with the name of a stage and percents.
Progress = Callable[[str, float], None]
#: Seconds in which an interrupted program may save its state.
_PATIENCE_S = 60.0


def find_program(program: PathLike | None = None) -> str:
    """The path of the program: ``program``, else the environment's ``HELIOSPLAT``, else the one of this Python, else the one on the PATH."""
    own = Path(sysconfig.get_path("scripts"), "heliosplat")
    named = program or os.environ.get("HELIOSPLAT")
    found = shutil.which(named) if named else shutil.which(own) or shutil.which("heliosplat")
    if found is None:
        raise _heliosplat.Error(
            f"no program {named or 'heliosplat'}: put it on the PATH, name it in the environment's HELIOSPLAT, or give program="
        )
    return found


def call(
    verb: str,
    *arguments: Any,
    progress: bool | Progress = False,
    program: PathLike | None = None,
    **options: Any,
) -> dict[str, Any]:
    """Runs ``heliosplat VERB ARGUMENTS --json`` and returns its answer.

    Options are those of the command line with underscores: ``gsd=0.5``, ``crs="EPSG:32637"``, ``overwrite=True``; a list repeats the option.
    ``progress=True`` prints stages and percents to stderr, a function gets them. An interrupt is passed on, so that a training saves its
    state; ``resume=True`` continues it.
    """
    command = [find_program(program), verb, *map(str, arguments), "--json", *_flags(options)]
    child = subprocess.Popen(
        command,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        encoding="utf-8",
        errors="replace",
        env={**os.environ, "HELIOSPLAT_PROGRESS": "lines"},
        # Else an interrupt of the notebook would reach it twice.
        start_new_session=True,
    )
    log: list[str] = []
    reader = threading.Thread(target=_follow, args=(child.stderr, log, progress), daemon=True)
    reader.start()
    try:
        assert child.stdout is not None
        answer = child.stdout.read()
        child.wait()
    except BaseException:
        child.send_signal(signal.SIGINT)
        try:
            child.wait(_PATIENCE_S)
        except subprocess.TimeoutExpired:
            child.kill()
        raise
    finally:
        reader.join()
    if child.returncode != 0:
        faults = [line for line in log if line.startswith("error: ")] or log[-1:] or [f"heliosplat {verb} failed"]
        raise _heliosplat.Error(faults[-1].removeprefix("error: "))
    found: dict[str, Any] = json.loads(answer)
    return found


def _flags(options: dict[str, Any]) -> list[str]:
    flags: list[str] = []
    for name, value in options.items():
        flag = "--" + name.rstrip("_").replace("_", "-")
        values = value if isinstance(value, list) else [value]
        for one in values:
            if one is True:
                flags.append(flag)
            elif one is not None and one is not False:
                text = ",".join(map(str, one)) if isinstance(one, tuple) else str(one)
                flags.append(f"{flag}={text}")
    return flags


def _follow(lines: Iterable[str] | None, log: list[str], progress: bool | Progress) -> None:
    for line in lines or ():
        line = line.rstrip()
        stage, _, percent = line.removeprefix("progress ").removesuffix(" %").rpartition(" ")
        if not line.startswith("progress ") or not percent.isdigit():
            log.append(line)
            if progress is True:
                print(line, file=sys.stderr)
        elif progress is True:
            print(f"\r{stage} {percent} %", end="\n" if percent == "100" else "", file=sys.stderr)
        elif progress:
            progress(stage, float(percent))


def _paths(scene: PathLike | Iterable[PathLike]) -> list[str]:
    if isinstance(scene, (str, os.PathLike)):
        return [os.fspath(scene)]
    return [os.fspath(path) for path in scene]


def inspect(scene: PathLike | Iterable[PathLike], *, program: PathLike | None = None, **options: Any) -> dict[str, Any]:
    """The contents of a folder of images, or of image files: cameras, times, suns, area, warnings, expected time and memory."""
    return call("inspect", *_paths(scene), program=program, **options)


def dsm(
    scene: PathLike | Iterable[PathLike],
    out: PathLike,
    *,
    progress: bool | Progress = True,
    program: PathLike | None = None,
    **options: Any,
) -> Grid:
    """Writes the surface model of images, without training, or of a run, to the GeoTIFF ``out``, and returns it.

    The source is the plane sweep of images unless ``scene`` is the folder of a run.
    """
    paths = _paths(scene)
    if "from_" not in options and not (len(paths) == 1 and Path(paths[0], "model.json").is_file()):
        options["from_"] = "sweep"
    call("dsm", *paths, out=os.fspath(out), progress=progress, program=program, **options)
    return read_geotiff(out)
