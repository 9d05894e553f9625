"""The program as functions: arguments, progress, answers and faults, with a program that only says what it was asked."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

import heliosplat

ECHO = """#!{python}
import json, sys, time
sys.stderr.write("INFO begun\\nprogress sweep 50 %\\nprogress sweep 100 %\\n")
sys.stderr.flush()
if "fail" in sys.argv[2:]:
    sys.exit("error: fail: no such file")
if "wait" in sys.argv[2:]:
    try:
        open(sys.argv[3], "w").close()
        time.sleep(60)
    except KeyboardInterrupt:
        open(sys.argv[3] + ".saved", "w").close()
        sys.exit(130)
print(json.dumps({{"arguments": sys.argv[1:]}}))
"""


@pytest.fixture
def program(tmp_path):
    path = tmp_path / "program"
    path.write_text(ECHO.format(python=sys.executable))
    path.chmod(0o755)
    return path


def test_options_are_those_of_the_command_line(program):
    said = heliosplat.call("dsm", "a.tif", Path("b.tif"), program=program, gsd=0.5, from_="sweep", area=(1, 2), set=["a=1", "b=2"], fill=True, crs=None, overwrite=False)
    assert said["arguments"] == ["dsm", "a.tif", "b.tif", "--json", "--gsd=0.5", "--from=sweep", "--area=1,2", "--set=a=1", "--set=b=2", "--fill"]


def test_progress_reaches_a_function_and_the_terminal(program, capsys):
    told = []
    heliosplat.inspect("scene", program=program, progress=lambda stage, percent: told.append((stage, percent)))
    assert told == [("sweep", 50.0), ("sweep", 100.0)]
    heliosplat.inspect("scene", program=program, progress=True)
    assert "sweep 100 %" in capsys.readouterr().err


def test_a_fault_is_the_program_s_own_line(program):
    with pytest.raises(heliosplat.Error, match="^fail: no such file$"):
        heliosplat.inspect("fail", program=program)
    with pytest.raises(heliosplat.Error, match="no program nowhere"):
        heliosplat.inspect("scene", program="nowhere")


def test_an_interrupt_lets_the_program_save(program, tmp_path):
    mark = tmp_path / "mark"
    code = f"import heliosplat; heliosplat.call('train', 'wait', {str(mark)!r}, program={str(program)!r})"
    child = subprocess.Popen([sys.executable, "-c", code], stderr=subprocess.PIPE)
    for _ in range(200):
        if mark.exists():
            break
        time.sleep(0.05)
    os.kill(child.pid, signal.SIGINT)
    assert b"KeyboardInterrupt" in child.communicate(timeout=60)[1]
    assert (tmp_path / "mark.saved").exists()


def test_images_become_a_surface(tmp_path):
    if not os.environ.get("HELIOSPLAT"):
        pytest.skip("HELIOSPLAT names no program")
    scene = tmp_path / "scene"
    heliosplat.call("synth", "satellite", site="tiny", views=4, seed=1, out=scene)
    assert heliosplat.inspect(scene)["images"]
    dsm = heliosplat.dsm(sorted(scene.glob("*.tif")), tmp_path / "dsm.tif", progress=False)
    assert dsm.bands == ("altitude",) and dsm.unit == "metre" and dsm.epsg // 100 in (326, 327)
    run = heliosplat.train(scene, tmp_path / "run", preset="preview", progress=False)
    assert {"albedo", "dsm"} <= set(run.write_products(progress=False)) and run.dsm.epsg == dsm.epsg
