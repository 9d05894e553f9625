#!/usr/bin/env python3
"""Rates of heliosplat's cameras against the Python package rpcm (numpy), on the camera and the million points of `heliosplat bench`.

Usage: pip install rpcm; scripts/compare_rpcm.py target/release/heliosplat
rpcm runs before and after the binary, and its quickest run counts.
"""
import json
import subprocess
import sys
import time

import numpy as np
import rpcm

POINTS = 1_000_000


def camera():
    """Rpc::example()."""

    def numerator(l, p, h):
        return [2.1e-3, l, p, h, 4.0e-4, -2.5e-4, 1.1e-4, 3.0e-4, -2.0e-4, 1.5e-5] + [1.3e-6] * 10

    denominator = [1.0, 6.0e-4, -4.0e-4, 3.0e-4] + [4.0e-7] * 16
    return rpcm.RPCModel(
        {
            "row_offset": 8000.0, "col_offset": 8000.0, "lat_offset": 37.58, "lon_offset": 36.91, "alt_offset": 700.0,
            "row_scale": 8000.0, "col_scale": 8000.0, "lat_scale": 0.036, "lon_scale": 0.045, "alt_scale": 500.0,
            "row_num": numerator(0.02, -1.0, 0.03), "row_den": denominator,
            "col_num": numerator(1.0, 0.02, -0.04), "col_den": denominator,
        },
        dict_format="rpcm",
    )


def seconds(work, runs=3):
    """The quickest of some runs."""
    best = float("inf")
    for _ in range(runs):
        start = time.perf_counter()
        work()
        best = min(best, time.perf_counter() - start)
    return best


def main():
    i = np.arange(POINTS)
    fraction = [(i * step) % 1.0 for step in (0.6180339887, 0.7548776662, 0.5698402909)]
    lon, lat, alt = 36.88 + 0.06 * fraction[0], 37.56 + 0.04 * fraction[1], 500.0 + 400.0 * fraction[2]
    col, row = 16000.0 * fraction[0], 16000.0 * fraction[1]
    model = camera()
    level = np.full(POINTS, 700.0)

    def measure():
        return (
            POINTS / seconds(lambda: model.projection(lon, lat, alt)),
            POINTS / seconds(lambda: model.localization(col, row, level)),
        )

    before = measure()
    ours = json.loads(subprocess.run([sys.argv[1], "bench", "--json"], check=True, capture_output=True).stdout)
    theirs = np.maximum(before, measure())
    names = ("rpc_project_points_per_s", "rpc_localise_points_per_s")
    for name, rpcm_rate in zip(names, theirs):
        rate = ours[name]
        print(f"{name}: heliosplat {rate:.3g}, rpcm {rpcm_rate:.3g}, ratio {rate / rpcm_rate:.1f}")


if __name__ == "__main__":
    main()
