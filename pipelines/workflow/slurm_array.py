#!/usr/bin/env python3
"""Write the units of a batch as Slurm arrays, or as plain lines, for clusters without a workflow engine.

    heliosplat batch city.toml --out city --plan --json | slurm_array.py city.toml city JOBS [--program PROGRAM]

JOBS gets a file for each level of the graph of units, `level-0.txt` and so on. A line is the command of an unfinished unit, and
waits for lines of earlier levels only. `submit.sh` submits each level as an array with the memory and time of its largest unit. A
level starts when the one before has ended; units whose inputs are missing then fail with a message. After a failure, plan and
submit again: finished units are left out.

Without Slurm: for level in JOBS/level-*.txt; do xargs -P 4 -I{} sh -c {} < $level; done
"""
import argparse
import json
import shlex
import sys
from pathlib import Path

# As in the Snakefile: a fifth more memory than expected, three times the time.
MEMORY_FACTOR, MEMORY_MB = 1.2, 64
TIME_FACTOR, TIME_MIN = 3, 2
# Slurm refuses larger arrays unless it is configured for them (MaxArraySize).
MOST_TASKS = 1000


def levels(units):
    """Names of the unfinished units by level: those of a level wait for units of lower levels, or finished ones, alone."""
    level = {}

    def of(name):
        if name not in level:
            waits = [of(before) + 1 for before in units[name]["after"] if before in units]
            level[name] = max(waits, default=0)
        return level[name]

    sys.setrecursionlimit(10_000)
    sorted_names = [[] for _ in range(max(map(of, units), default=-1) + 1)]
    for name in units:
        sorted_names[level[name]].append(name)
    return sorted_names


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("manifest")
    parser.add_argument("out")
    parser.add_argument("jobs", type=Path)
    parser.add_argument("--program", default="heliosplat")
    parser.add_argument("--threads", type=int, default=1)
    args = parser.parse_args()

    planned = json.load(sys.stdin)["units"]
    for unit in planned:
        if unit["work"]["kind"] == "refused":
            print(f"{unit['id']}: left out: {unit['work']['reason']}", file=sys.stderr)
    units = {unit["id"]: unit for unit in planned if unit["work"]["kind"] != "refused" and not unit["done"]}
    by_level = levels(units)

    args.jobs.mkdir(parents=True, exist_ok=True)
    for old in args.jobs.glob("level-*.txt"):
        old.unlink()
    manifest, out, jobs = (Path(path).resolve() for path in (args.manifest, args.out, args.jobs))
    batch = [args.program, "batch", str(manifest), "--out", str(out)]
    script = ["#!/bin/sh", "# Submits the levels one after another; options of sbatch may be given.", "set -e", "before="]
    for number, names in enumerate(by_level):
        lines = jobs / f"level-{number}.txt"
        threads = ["--threads", str(args.threads)]
        commands = [shlex.join([*batch, "--only", name, *threads]) for name in names]
        lines.write_text("".join(command + "\n" for command in commands))
        memory = max(units[name]["mem_mb"] for name in names)
        seconds = max(units[name]["runtime_s"] for name in names)
        tasks = min(len(names), MOST_TASKS)
        task = f'awk "NR % {tasks} == $SLURM_ARRAY_TASK_ID % {tasks}" {shlex.quote(str(lines))} | sh'
        seconds *= -(-len(names) // tasks)
        options = [
            f"--array=1-{tasks}",
            f"--cpus-per-task={args.threads}",
            f"--mem={int(MEMORY_FACTOR * memory) + MEMORY_MB}M",
            f"--time={TIME_MIN + TIME_FACTOR * seconds // 60 + 1}",
            f"--job-name=level-{number}",
            f"--output={jobs}/log-{number}-%a.txt",
        ]
        script.append(f'before=$(sbatch --parsable ${{before:+--dependency=afterany:$before}} "$@" \\')
        script.append(f"    {shlex.join(options)} --wrap={shlex.quote(task)})")
    script.append(f"sbatch --dependency=afterany:$before \"$@\" --output={shlex.quote(f'{jobs}/log-summary.txt')} \\")
    script.append(f"    --wrap={shlex.quote(shlex.join([*batch, '--summary']))}")
    if by_level:
        (jobs / "submit.sh").write_text("\n".join(script) + "\n")
        (jobs / "submit.sh").chmod(0o755)
    print(f"{len(units)} units in {len(by_level)} levels: {jobs}/submit.sh" if units else "all units are finished")


if __name__ == "__main__":
    main()
