#!/usr/bin/env python3
"""Error against time and memory: the trainings of a list of points on scenes, one after the other, as one table.

Usage: scripts/tradeoff.py SCENE... --out RESULTS [--points LIST.toml] [--only NAME,AXIS] [--seeds 3] [--list]

A point is `train --preset PRESET --set KEY=VALUE ...`; scripts/tradeoff/ has the standard list and the ablation of `fast`. A finished
training is kept: the same command goes on where it was stopped. Errors need truth in the scenes. Needs Python 3.11 and nothing else.

RESULTS/tradeoff.csv has a row for each training. The table on standard output has a row for each point: means, half of the 95 %
confidence interval (over scenes, or over trainings of one scene), and a star on the front, where no other point is both quicker and
more accurate.
"""
import argparse
import csv
import json
import statistics
import subprocess
import sys
import tomllib
from pathlib import Path

LISTS = Path(__file__).parent / "tradeoff"
# Student's t for a two-sided 95 % interval, by degrees of freedom.
STUDENT_T = [12.706, 4.303, 3.182, 2.776, 2.571, 2.447, 2.365, 2.306, 2.262, 2.228]
COLUMNS = ["scene", "point", "seed", "seconds", "processor_s", "peak_mib", "gaussians", "steps", "mae_m", "median_m", "psnr_held_out"]


def points(path, only):
    chosen = tomllib.loads(path.read_text())["point"]
    words = {word for point in chosen for word in (point["name"], point["axis"])}
    unknown = [word for word in only if word not in words]
    if unknown:
        sys.exit(f"error: --only {unknown[0]}: no point has that name or axis; there are {', '.join(p['name'] for p in chosen)}")
    kept = [p for p in chosen if not only or p["name"] in only or p["axis"] in only]
    bases = {p.get("base") for p in kept}
    return [p for p in chosen if p in kept or p["name"] in bases]


def arguments(point):
    def value(v):
        return str(v).lower() if isinstance(v, bool) else str(v)

    return ["--preset", point["preset"]] + [a for k, v in point.get("set", {}).items() for a in ("--set", f"{k}={value(v)}")]


def train(program, scene, point, seed, folder):
    """The metrics of the training; those of an earlier one if it was finished by the same command."""
    command = [program, "train", str(scene.resolve()), "--seed", str(seed), *arguments(point)]
    stamp, metrics = folder / "tradeoff.txt", folder / "metrics.json"
    said = "\n".join(command)
    if not (stamp.is_file() and stamp.read_text() == said and metrics.is_file()):
        done = subprocess.run([*command, "--out", folder, "--overwrite"], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
        if done.returncode:
            sys.exit(f"error: {folder}: {done.stderr.strip().splitlines()[-1:]}")
        stamp.write_text(said)
    return json.loads(metrics.read_text())


def row(scene, point, seed, metrics):
    surface = metrics.get("dsm" if metrics["iterations"] else "start") or {}
    processor_s = [stage.get("processor_s") for stage in metrics["timeline"]]
    return {
        "scene": scene, "point": point["name"], "seed": seed, "seconds": metrics["seconds"],
        "processor_s": None if None in processor_s else sum(processor_s),
        "peak_mib": metrics.get("peak_rss_bytes", 0) / 2**20, "gaussians": metrics["gaussians"], "steps": metrics["iterations"],
        "mae_m": surface.get("mae_m"), "median_m": surface.get("median_m"),
        "psnr_held_out": (metrics.get("test") or {}).get("psnr"),
    }  # fmt: skip


def mean(rows, column):
    """Mean, and half of its 95 % interval where there is one."""
    known = [r for r in rows if r[column] is not None]
    if not known:
        return None, None
    scenes = {r["scene"] for r in known}
    values = [r[column] for r in known]
    if len(scenes) > 1:
        values = [statistics.fmean(r[column] for r in known if r["scene"] == scene) for scene in scenes]
    half = None
    if len(values) > 1:
        t = STUDENT_T[len(values) - 2] if len(values) - 2 < len(STUDENT_T) else 2.0
        half = t * statistics.stdev(values) / len(values) ** 0.5
    return statistics.fmean(values), half


def table(chosen, rows):
    quality = "mae_m" if all(r["mae_m"] is not None for r in rows) else "psnr_held_out"
    sign = 1 if quality == "mae_m" else -1
    means = {p["name"]: {c: mean([r for r in rows if r["point"] == p["name"]], c) for c in COLUMNS[3:]} for p in chosen}
    cost = {name: (m["seconds"][0], sign * m[quality][0]) for name, m in means.items() if m[quality][0] is not None}
    front = {a for a, (s, e) in cost.items() if not any(t <= s and f <= e and (t, f) != (s, e) for t, f in cost.values())}

    def shown(value, digits):
        return "-" if value[0] is None else f"{value[0]:.{digits}f}" + (f" ± {value[1]:.{digits}f}" if value[1] is not None else "")

    lines = [f"| point | seconds | processor seconds | MiB | {quality} | against its base |", "|---|---|---|---|---|---|"]
    for p in chosen:
        m, own = means[p["name"]], {(r["scene"], r["seed"]): r for r in rows if r["point"] == p["name"]}
        pairs = [(own[k], r) for r in rows if r["point"] == p.get("base") and (k := (r["scene"], r["seed"])) in own]
        gains = [{"scene": a["scene"], "gain": a[quality] - b[quality]} for a, b in pairs if a[quality] is not None and b[quality] is not None]
        lines.append(
            f"| {p['name']}{' *' if p['name'] in front else ''} | {shown(m['seconds'], 1)} | {shown(m['processor_s'], 1)} "
            f"| {shown(m['peak_mib'], 0)} | {shown(m[quality], 3)} | {shown(mean(gains, 'gain'), 3)} |"
        )
    return "\n".join(lines)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="+", type=Path)
    parser.add_argument("--out", required=True, type=Path)
    parser.add_argument("--points", default=LISTS / "standard.toml", type=Path)
    parser.add_argument("--only", default=[], type=lambda text: text.split(","))
    parser.add_argument("--seeds", default=3, type=int)
    parser.add_argument("--list", action="store_true")
    parser.add_argument("--heliosplat", default="heliosplat", help="the program")
    args = parser.parse_args()
    chosen = points(args.points, args.only)
    if args.list:
        print("\n".join(f"{p['name']:<20} {p['axis']:<16} {p['why']} ({' '.join(arguments(p))})" for p in chosen))
        return
    rows = []
    args.out.mkdir(parents=True, exist_ok=True)
    for number, scene in enumerate(args.scenes, 1):
        name = f"{number}-{scene.name}" if len(args.scenes) > 1 else scene.name
        for point in chosen:
            for seed in range(1, 1 + (args.seeds if point.get("seeds") == "all" else 1)):
                folder = args.out / "runs" / name / f"{point['name']}-{seed}"
                rows.append(row(name, point, seed, train(args.heliosplat, scene, point, seed, folder)))
                print(f"trained {name} {point['name']}, seed {seed}", file=sys.stderr)
    with open(args.out / "tradeoff.csv", "w", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS)
        writer.writeheader()
        writer.writerows(rows)
    print(table(chosen, rows))


if __name__ == "__main__":
    main()
