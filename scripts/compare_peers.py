#!/usr/bin/env python3
"""Time, memory and errors of heliosplat beside other programs on the same images and the same cores, as one table.

Usage: scripts/compare_peers.py FOLDER --out RESULTS [--truth DSM.tif --classes CLASSES.tif] [--presets fast,balanced] [--cores N]

FOLDER holds satellite images with rational cameras (GeoTIFF), which s2p and CARS take, or a capture with transforms.json or
transforms_train.json, which OpenSplat and brush take. What is not installed is named and left out; no peer is needed. Peers run with
their defaults, so the table says what a user gets who sets nothing. Two exceptions, without which they stop: s2p gets one band of images
that have several (the second, by gdal_translate), and CARS searches images smaller than 2000 pixels at full resolution alone. Needs Python
3.10 or newer and nothing else.

Memory is the largest sum over the processes of a program, looked at five times a second (Linux; elsewhere that of its largest process).
RESULTS/peers.md is the table, RESULTS/peers.json the same for machines, RESULTS/NAME.log what a program said.
"""
import argparse
import json
import os
import resource
import shutil
import subprocess
import sys
import time
from pathlib import Path

INSTALL = {
    "s2p": "pip install s2p (github.com/centreborelli/s2p)",
    "cars": "pip install cars (github.com/CNES/cars)",
    "opensplat": "github.com/pierotofy/OpenSplat",
    "brush_app": "github.com/ArthurBrussee/brush",
}
STEPS = 2000
# CARS begins at a sixteenth of the resolution; smaller images have nothing to match there (version 1.3.0).
SMALL_IMAGE_PX = 2000
POLL_S = 0.2


class Peer:
    """A program: what it is called with, and where its surface model will be (None: it makes none)."""

    def __init__(self, name, program, command, dsm=None):
        self.name, self.program, self.command, self.dsm = name, program, command, dsm


def write_json(path, value):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(value, indent=1) + "\n")
    return path


def s2p(images, out, cores, gsd_m):
    """The first image against every other, as s2p pairs them."""
    config = {
        "out_dir": str(out),
        "images": [{"img": str(image)} for image in images],
        "full_img": True,
        "dsm_resolution": gsd_m,
        "max_processes": cores,
    }
    path = write_json(out.with_suffix(".config.json"), config)
    return Peer("s2p", "s2p", ["s2p", str(path)], out / "dsm.tif")


def one_band(images, folder):
    """Copies of one band, with their rational cameras: s2p 1.0b25 stops at images of several."""
    if not shutil.which("gdal_translate"):
        print("s2p: gdal_translate is not on PATH, so it gets images of several bands", file=sys.stderr)
        return images
    folder.mkdir(parents=True, exist_ok=True)
    copies = [folder / image.name for image in images]
    for image, copy in zip(images, copies):
        done = subprocess.run(["gdal_translate", "-q", "-b", "2", str(image), str(copy)], capture_output=True, text=True)
        if done.returncode:
            print(f"s2p: {image}: gdal_translate: {done.stderr.strip()}; it gets images of several bands", file=sys.stderr)
            return images
    return copies


def cars(images, out, cores, gsd_m, small):
    """The first image against every other, as in s2p."""
    names = [image.stem for image in images]
    config = {
        "input": {
            "sensors": {name: {"image": str(image)} for name, image in zip(names, images)},
            "pairing": [[names[0], name] for name in names[1:]],
        },
        # Ellipsoidal heights, as the images have them.
        "output": {"directory": str(out), "resolution": gsd_m, "geoid": False},
        "orchestrator": {"mode": "multiprocessing", "nb_workers": cores},
    }
    if small:
        config["subsampling"] = {"advanced": {"resolutions": [1]}}
    path = write_json(out.with_suffix(".config.json"), config)
    return Peer("CARS", "cars", ["cars", str(path)], out / "dsm" / "dsm.tif")


def opensplat(folder, out, steps):
    command = ["opensplat", str(folder), "-n", str(steps), "-o", str(out / "splat.ply")]
    return Peer("OpenSplat", "opensplat", command)


def brush(folder, out, steps):
    command = ["brush_app", str(folder), "--total-steps", str(steps), "--export-path", str(out)]
    return Peer("brush", "brush_app", command)


def resident_bytes(session):
    """Memory of all processes of a session; zero where there is no /proc."""
    total = 0
    for status in Path("/proc").glob("[0-9]*/stat"):
        try:
            # The name of the program, in brackets, may hold anything; the session is the fourth field after it, the pages the 22nd.
            fields = status.read_text().rpartition(")")[2].split()
        except OSError:
            continue
        if int(fields[3]) == session:
            total += int(fields[21]) * resource.getpagesize()
    return total


def measured(command, log, cores):
    """Runs a command on these cores; its exit code, wall and processor seconds, and peak bytes."""
    environment = dict(os.environ, OMP_NUM_THREADS=str(len(cores)), NUMBA_NUM_THREADS=str(len(cores)))

    def keep_to_cores():
        if hasattr(os, "sched_setaffinity"):
            os.sched_setaffinity(0, cores)

    begun, peak = time.monotonic(), 0
    with open(log, "wb") as said:
        process = subprocess.Popen(
            command, stdout=said, stderr=subprocess.STDOUT, env=environment, start_new_session=True, preexec_fn=keep_to_cores
        )
        while True:
            pid, status, usage = os.wait4(process.pid, os.WNOHANG)
            if pid:
                break
            peak = max(peak, resident_bytes(process.pid))
            time.sleep(POLL_S)
    process.returncode = os.waitstatus_to_exitcode(status)
    return {
        "exit": process.returncode,
        "wall_s": time.monotonic() - begun,
        "processor_s": usage.ru_utime + usage.ru_stime,
        "peak_bytes": max(peak, usage.ru_maxrss * (1 if sys.platform == "darwin" else 1024)),
    }


def errors(heliosplat, dsm, truth, classes):
    """What `heliosplat evaluate` says of a surface model, in the protocol `raw`."""
    command = [heliosplat, "evaluate", "--dsm", str(dsm), "--truth", str(truth), "--json"]
    if classes:
        command += ["--classes", str(classes)]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode:
        return {"fault": done.stderr.strip().splitlines()[-1:]}
    found = json.loads(done.stdout)["dsm"]
    by_class = {name: numbers.get("mae_m") for name, numbers in found.get("by_class", {}).items()}
    return {"mae_m": found["mae_m"], "completeness": found["completeness"], "by_class": by_class}


def table(rows):
    """Markdown."""
    names = sorted({name for row in rows for name in row.get("errors", {}).get("by_class", {})})
    lines = [
        "| program | wall s | processor s | memory MiB | MAE m | known % |" + "".join(f" {name} m |" for name in names),
        "|---|---|---|---|---|---|" + "---|" * len(names),
    ]

    def number(value, digits):
        return "" if value is None else f"{value:.{digits}f}"

    for row in rows:
        found = row.get("errors", {})
        known = found.get("completeness")
        cells = [
            row["name"] if row["exit"] == 0 else f"{row['name']} (failed, exit {row['exit']})",
            number(row["wall_s"], 1),
            number(row["processor_s"], 1),
            number(row["peak_bytes"] / 2**20, 0),
            number(found.get("mae_m"), 3),
            number(known and 100 * known, 1),
        ]
        cells += [number(found.get("by_class", {}).get(name), 3) for name in names]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def arguments():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--out", type=Path, required=True, help="folder for results, made if absent")
    parser.add_argument("--truth", type=Path, help="true surface model; without it there are no errors in the table")
    parser.add_argument("--classes", type=Path, help="LAS classes on the truth's grid")
    parser.add_argument("--presets", default="fast", help="presets of heliosplat, with commas between [fast]")
    parser.add_argument("--cores", type=int, default=0, help="cores for each program [all that this one may use]")
    parser.add_argument("--steps", type=int, default=STEPS, help=f"steps of OpenSplat and brush [{STEPS}]")
    parser.add_argument("--heliosplat", default="heliosplat", help="the program [heliosplat on PATH]")
    return parser.parse_args()


def main():
    args = arguments()
    heliosplat = shutil.which(args.heliosplat)
    if not heliosplat:
        sys.exit(f"{args.heliosplat}: not found; build it (make build) and give --heliosplat target/release/heliosplat")
    folder, out = args.folder.resolve(), args.out.resolve()
    capture = any((folder / name).is_file() for name in ("transforms.json", "transforms_train.json"))
    images = sorted(folder.glob("*.tif")) + sorted(folder.glob("*.TIF"))
    if not capture and len(images) < 2:
        sys.exit(f"{folder}: neither two GeoTIFFs nor a transforms.json or transforms_train.json")
    out.mkdir(parents=True, exist_ok=True)
    usable = sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else list(range(os.cpu_count() or 1))
    cores = usable[: args.cores] if args.cores else usable

    ours = []
    for preset in args.presets.split(","):
        run = out / f"heliosplat_{preset}"
        command = [heliosplat, "train", str(folder), "--out", str(run), "--overwrite", "--preset", preset, "--threads", str(len(cores))]
        ours.append(Peer(f"heliosplat {preset}", heliosplat, command, None if capture else run / "dsm.tif"))
    if capture:
        peers = [opensplat(folder, out, args.steps), brush(folder, out, args.steps)]
    else:
        inspected = subprocess.run([heliosplat, "inspect", str(folder), "--json"], capture_output=True, text=True)
        if inspected.returncode:
            sys.exit(inspected.stderr.strip())
        scene = json.loads(inspected.stdout)
        gsd_m, small = scene["gsd_m"], min(min(image["width"], image["height"]) for image in scene["images"]) < SMALL_IMAGE_PX
        flat = one_band(images, out / "one_band") if len(scene["bands"]) > 1 and shutil.which("s2p") else images
        peers = [s2p(flat, out / "s2p", len(cores), gsd_m), cars(images, out / "cars", len(cores), gsd_m, small)]
    missing = [peer for peer in peers if not shutil.which(peer.program)]
    for peer in missing:
        print(f"{peer.name}: '{peer.program}' is not on PATH, left out; {INSTALL[peer.program]}", file=sys.stderr)

    rows = []
    for peer in ours + [peer for peer in peers if peer not in missing]:
        print(f"{peer.name}: {' '.join(peer.command)}", file=sys.stderr)
        log = out / (peer.name.replace(" ", "_") + ".log")
        row = {"name": peer.name, **measured(peer.command, log, cores)}
        if row["exit"]:
            print(f"{peer.name}: exit {row['exit']}, see {log}", file=sys.stderr)
        elif args.truth and peer.dsm:
            row["errors"] = errors(heliosplat, peer.dsm, args.truth, args.classes)
        rows.append(row)
    write_json(out / "peers.json", {"cores": len(cores), "missing": [peer.name for peer in missing], "programs": rows})
    text = table(rows)
    if missing:
        text += "\nNot installed: " + ", ".join(peer.name for peer in missing) + ".\n"
    (out / "peers.md").write_text(text)
    print(text, end="")


if __name__ == "__main__":
    main()
