#!/usr/bin/env python3
"""Puts the naive form in the place of each robust one, runs the tests, and says which of them fail; then puts all back.

Forms that do not meet share a build, so that their failures can be told apart by name. Run in a clean checkout:
scripts/naive_forms.py [BATCH...]
"""

import re
import subprocess
import sys

FAST = "src/fast.rs"
SHADOW_GS = "src/model/shadow_gs.rs"
PROJECT_FORWARD = "src/splat/project/forward.rs"
# (name, file, [(robust, naive)])
BATCHES = {
    "numbers": [
        ("softplus", SHADOW_GS, [("    x.max(0.0) + (-x.abs()).exp().ln_1p()\n", "    (1.0 + x.exp()).ln()\n")]),
        ("softplus inverse", SHADOW_GS, [("    y + (-(-y).exp_m1()).ln()\n", "    (y.exp() - 1.0).ln()\n")]),
        ("sigmoid", "src/gaussians.rs", [("    if x >= 0.0 {\n        1.0 / (1.0 + (-x).exp())", "    if x.is_nan() {\n        x")]),
        ("learning rate", "src/optim/schedule.rs", [("    if from == 0.0 {\n        return 0.0;\n    }\n", "")]),
        ("quaternion", "src/gaussians.rs", [("    if norm < 1e-12 || !norm.is_finite() {\n        return Quat::IDENTITY;\n    }\n", "")]),
        ("entropy", "src/loss/shadow.rs", [("const CLAMP: f32 = 0.02;", "const CLAMP: f32 = 0.0;")]),
        ("point light", "src/light.rs", [("if distance > 1e-12 {", "if distance >= 0.0 {")]),
        ("exp saturates", FAST, [("    let x = if x > 88.0 { 88.0 } else { x };\n    let x = if x < -87.0 { -87.0 } else { x };\n", "")]),
        ("Adam's squares", "src/train/fault.rs", [("let sound = |value: f32| value.abs() < GRADIENT_MAX;", "let sound = f32::is_finite;")]),
    ],
    "space": [
        ("footprint determinant", PROJECT_FORWARD, [
            ("area_square: area.dot(area),", "area_square: most(a.dot(a) * b.dot(b) - a.dot(b) * a.dot(b)),"),
            ("    let det = det + filter * (m[0] + yy);\n", "    let det = xx * yy - m[1] * m[1] + 0.0 * det;\n"),
            ("#[inline(always)]\npub(super) fn finite(", "#[inline(always)]\nfn most(x: f32) -> f32 {\n    if x > 0.0 { x } else { 0.0 }\n}\n\n#[inline(always)]\npub(super) fn finite("),
        ]),
        ("variance in a window", "src/loss/photometric.rs", [
            ("let (vx, vy) = (most(xx[i] - a * a, 0.0), most(yy[i] - b * b, 0.0));", "let (vx, vy) = (most(xx[i] - a * a, f32::MIN), yy[i] - b * b);"),
            ("            let bound = (vx * vy).sqrt();\n            let cov = -most(-most(xy[i] - a * b, -bound), -bound);\n", "            let cov = xy[i] - a * b;\n"),
        ]),
        ("exponent, hierarchy", "src/trace/hierarchy/bundle.rs", [("let square = n[0] * n[0] + n[1] * n[1] + n[2] * n[2];", "let e = whitened(offset);\n            let along_it = e[0] * d[0] + e[1] * d[1] + e[2] * d[2];\n            let square = e[0] * e[0] + e[1] * e[1] + e[2] * e[2] - along_it * along_it / dd;")]),
        ("exponent, sun's plane", "src/trace/sun_plane/ellipse.rs", [("let det = a.cross(b).length_squared();", "let det = xx * yy - xy * xy;"), ("let (along, area) = (xx.sqrt(), det.sqrt());\n        let whiten = [1.0 / along, -xy / (along * area), along / area];", "let whiten = [1.0 / xx.sqrt(), -xy / (det * xx).sqrt(), xx.sqrt() / det.sqrt()];")]),
        ("own sheet", "src/trace/light_ray.rs", [("const LIFT: f32 = 3.717;", "const LIFT: f32 = 0.0;"), ("bias: extent,", "bias: 0.0 * extent,")]),
        ("alpha at most 0.99", "src/trace/occlusion.rs", [("let alpha = if alpha < ALPHA_MAX { alpha } else { ALPHA_MAX };\n", ""), ("let weight = if alpha < ALPHA_MAX { alpha / (1.0 - alpha) } else { 0.0 };", "let weight = alpha / (1.0 - alpha);")]),
        ("best held-out loss", "src/train/holdout.rs", [("loss.filter(|loss| loss.is_finite())", "loss")]),
    ],
    "surfaces": [
        ("GGX", "src/shade/ggx.rs", [("    let sum = x * x + y * y + h.z * h.z;\n", "    let sum = h.z * h.z * (1.0 - 1.0 / (alpha[0] * alpha[1])) + 1.0 / (alpha[0] * alpha[1]) + 0.0 * (x + y);\n")]),
        ("masking and cosines in one", "src/shade/ggx.rs", [("    density(half, alpha) * visible * to_light.z\n", "    let _ = visible;\n    density(half, alpha) * masking(to_light, alpha) * masking(to_eye, alpha) / (4.0 * to_light.z * to_eye.z) * to_light.z\n")]),
        ("lobe near its axis", "src/shade/asg.rs", [("    if v.z > 0.0 && square < NEAR_AXIS * NEAR_AXIS {", "    if square < 0.0 {"), ("let sine = square.sqrt().max(LEAST_SINE);", "let sine = square.sqrt();"), ("let angle = sine.atan2(v.z);", "let angle = v.z.acos();")]),
        ("dipole by the square of its transport", "src/shade/dipole.rs", [("to_transport_square * 3.0 * extinction,", "to_transport_square * 2.0 * transport * (1.5 * extinction / transport),")]),
        ("dipole: coefficients and depths bounded", "src/shade/dipole.rs", [("if x < MOST { x } else { MOST }", "x"), ("    if s * d > FAR {", "    if s * d < 0.0 {")]),
        ("lamp of a size", "src/shade/falloff.rs", [("(radius / distance).max(LEAST_RADIUS)", "radius / distance")]),
        ("foot in the scene", "src/trace/hierarchy/bundle.rs", [("let (e, d) = (whitened(beside), whitened(along));", "let foot = 0.0 * foot;\n            let (e, d) = (whitened(offset), whitened(along));")]),
        ("display's line", "src/shade/display.rs", [("    if light <= LINEAR_END {\n        return (12.92 * light, 12.92);\n    }\n", "")]),
    ],
}
COMMANDS = [
    ["cargo", "test", "-p", "heliosplat", "--lib", "--no-fail-fast"],
    ["cargo", "test", "-p", "heliosplat-tests", "--test", "account", "--test", "properties", "--no-fail-fast"],
]


def run(batch):
    originals = {}
    try:
        for name, path, changes in BATCHES[batch]:
            text = open(path).read()
            originals.setdefault(path, text)
            for robust, naive in changes:
                assert text.count(robust) == 1, f"{name}: {robust!r} is {text.count(robust)} times in {path}"
                text = text.replace(robust, naive)
            open(path, "w").write(text)
        for command in COMMANDS:
            done = subprocess.run(command, capture_output=True, text=True)
            out = done.stdout + done.stderr
            failed = re.findall(r"^test (\S+) \.\.\. FAILED", out, re.M)
            faults = re.findall(r"^[^\n|]*: (?:value|gradient) (?:\*\*not|[0-9])[^\n]*", out, re.M)
            print(f"== {batch}: {' '.join(command)}: {len(failed)} failed")
            for line in failed + faults:
                print("  ", line)
            if not failed:
                print(out[-3000:])
    finally:
        for path, text in originals.items():
            open(path, "w").write(text)


for batch in sys.argv[1:] or BATCHES:
    run(batch)
