#!/usr/bin/env python3
"""Cancelling sends one signal, upon which the program saves and ends; progress and faults come through. Needs no QGIS.

Usage: test_child.py PROGRAM SCENE
"""

import importlib.util
import sys
import tempfile
import time
from pathlib import Path

spec = importlib.util.spec_from_file_location("child", Path(__file__).with_name("heliosplat_qgis") / "child.py")
child = importlib.util.module_from_spec(spec)
spec.loader.exec_module(child)

program, scene = sys.argv[1:]
with tempfile.TemporaryDirectory() as folder:
    command = [program, "train", scene, "--preset", "balanced", "--out", f"{folder}/run", "--json"]
    heard = []

    def cancelled():
        """As a user who sees that training has begun."""
        return any(percent >= 1 for _, percent in heard)

    begin = time.monotonic()
    try:
        child.run(command, lambda line: None, lambda label, percent: heard.append((label, percent)), cancelled)
    except child.ChildError as error:
        print(f"stopped after {time.monotonic() - begin:.1f} s at {heard[-1]}: {error}")
        assert "stopped" in str(error), error
    else:
        sys.exit("the run was not stopped")

try:
    child.run([program, "inspect", "/no/such/scene", "--json"], lambda line: None, lambda *_: None, lambda: False)
except child.ChildError as error:
    assert "/no/such/scene" in str(error), error
    print(f"fault: {error}")
else:
    sys.exit("a missing scene was inspected")
