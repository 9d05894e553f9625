#!/usr/bin/env python3
"""Run the commands of README and guides on tiny scenes: each has to exit with 0.

usage: run_commands.py PROGRAM [PAGE...]

Blocks of code in README.md and docs/guide/*.md are read line by line; lines that start with `heliosplat` are run, page by page,
in the order of the page, in a folder that has the inputs the pages name (`my_images`, `run`, `lidar.tif` …). Presets and sizes are
replaced by small ones. Commands that take minutes by design are skipped with a reason. Some three minutes of processor time.
A comment that is the name of a file, such as `# run/products/ndsm.tif`, states that the command makes it. Standard library only.
"""

import re
import shlex
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent

# Commands that are not run, and why.
SKIPPED = {
    r"^bench\b": "a minute by design",
    r"^demo\b": "minutes by design",
    r"\broot_dir/": "needs published data",
    r"--geoid egm2008": "needs a grid of PROJ that is not always there",
    r"/vsi|s3://|https?://": "needs a network",
    r"\bundistorted\b": "needs COLMAP",
    r"--device gpu": "needs a build with the feature gpu",
}

# Replacements that keep a command small, in order; the first column limits them to commands that match it.
SMALL = [
    (r"^synth satellite", r"--site \w+", "--site tiny"),
    (r"^synth satellite(?!.*--site)", r"$", " --site tiny"),
    (r"^synth satellite", r"$", " --views 6"),
    (r"^synth satellite", r"--relight \d+", "--relight 1"),
    (r"^synth (object|olat|reflective)", r"$", " --size 48 --views 12 --paths 4"),
    (r"^train toy", r"$", " --preset fast --set train.iterations=30 --set model.pilot_steps=0 --overwrite"),
    (r"^train (?!toy)", r"--preset \w+", ""),
    (r"^train (?!toy)", r"train\.iterations=\d+", "train.iterations=5"),
    (r"^train (?!toy)", r"$", " --preset preview --overwrite"),
    (r"^(relight|export) .*--(light|toward|surroundings|asset|cells)", r"\brun\b", "lit_run"),
    (r"^render .*--components", r"\brun\b", "lit_run"),
    (r"^relight", r"--samples \d+", "--samples 4"),
    (r"^export", r"--cells \d+", "--cells 24"),
    (r"", r"\bNAME\b", "tiny_001_00"),
    # The synthetic sites are in America.
    (r"", r"T(\$hour|09):00", "T17:00"),
    (r"", r"\$hour\b", "09"),
]


def run(program, arguments, folder):
    """Runs the program; the end of what it printed if it failed, else None."""
    done = subprocess.run([program, *arguments], cwd=folder, capture_output=True, text=True, check=False)
    return None if done.returncode == 0 else f"exit code {done.returncode}: {(done.stderr or done.stdout).strip()[-400:]}"


def commands(page):
    """The numbered commands of a page, without the name of the program, each with the file that it states to make, or None."""
    fenced = False
    for number, line in enumerate(page.read_text(encoding="utf-8").splitlines(), 1):
        if line.startswith("```"):
            fenced = not fenced
        match = re.match(r"\s*(?:target/release/)?heliosplat ([a-z-].*)", line) if fenced else None
        if match:
            stated = re.search(r" # (\S+\.\w+)$", line)
            yield number, stated and stated.group(1), shlex.join(shlex.split(match.group(1), comments=True)).replace("'$hour.tif'", "$hour.tif").replace("'", "")


def small(command):
    """The command with small presets and sizes."""
    for where, pattern, replacement in SMALL:
        if re.search(where, command):
            command = re.sub(pattern, replacement, command, count=1) if pattern == "$" else re.sub(pattern, replacement, command)
    return command


def inputs(program, folder):
    """Makes the inputs that pages name."""
    steps = [
        "synth satellite --site tiny --views 6 --relight 1 --out my_images",
        "train my_images --preset preview --out run",
        "synth object --size 48 --views 12 --paths 4 --out toy",
        "synth olat --size 48 --views 16 --paths 4 --out lamps",
        "train lamps --preset fast --set train.iterations=30 --set model.pilot_steps=0 --out lit_run",
        "products run --out products",
        "batch city.toml --out city",
    ]
    (folder / "city.toml").write_text(
        '[[areas]]\nname = "all"\n[[images]]\nname = "first"\nscene = "my_images"\n[[presets]]\nname = "quick"\npreset = "preview"\n',
        encoding="utf-8",
    )
    for step in steps:
        fault = run(program, step.split(), folder)
        if fault:
            sys.exit(f"cannot prepare: heliosplat {step}: {fault}")
    truth = folder / "my_images" / "truth"
    for source, name in [
        (folder / "run" / "dsm.tif", "dsm.tif"),
        (truth / "dsm.tif", "lidar.tif"),
        (truth / "classes.tif", "classes.tif"),
        (folder / "products" / "albedo.tif", "ortho.tif"),
        (next((folder / "lamps").rglob("*.exr")), "hall.exr"),
    ]:
        shutil.copy(source, folder / name)
    for name in ["other", "north", "south", "demo/run", "object_run"]:
        shutil.copytree(folder / ("lit_run" if name == "object_run" else "run"), folder / name)
    shutil.copytree(truth, folder / "elsewhere" / "truth")
    shutil.copytree(ROOT / "examples" / "kahramanmaras", folder / "examples" / "kahramanmaras")
    (folder / "masks").mkdir()
    for mask in truth.glob("shadow_*.tif"):
        shutil.copy(mask, folder / "masks" / mask.name.removeprefix("shadow_"))


def main():
    if len(sys.argv) < 2:
        sys.exit(__doc__)
    program = str(Path(sys.argv[1]).resolve())
    pages = [Path(name) for name in sys.argv[2:]] or [ROOT / "README.md", *sorted((ROOT / "docs" / "guide").glob("*.md"))]
    failed = ran = skipped = 0
    with tempfile.TemporaryDirectory() as temporary:
        world = Path(temporary) / "inputs"
        world.mkdir()
        inputs(program, world)
        done = set()
        for page in pages:
            folder = Path(temporary) / page.stem
            shutil.copytree(world, folder)
            for number, stated, command in commands(page):
                reason = next((why for pattern, why in SKIPPED.items() if re.search(pattern, command)), None)
                if reason:
                    skipped += 1
                    print(f"{page.name}:{number}: skipped, {reason}: {command}", flush=True)
                    continue
                words = small(command)
                # What an earlier page has made already is among the inputs.
                if words in done and words.startswith("train my_images --out run"):
                    continue
                done.add(words)
                ran += 1
                if words.startswith("view ") and "--out" not in words:
                    words += " --out sun.html"
                if stated and (folder / stated).is_file():
                    (folder / stated).unlink()
                fault = run(program, words.split(), folder)
                if not fault and stated and not (folder / stated).is_file():
                    fault = f"makes no {stated}"
                if fault:
                    failed += 1
                    print(f"{page.name}:{number}: heliosplat {words}: {fault}", flush=True)
            shutil.rmtree(folder)
    print(f"{ran} commands run, {skipped} skipped, {failed} failed")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
