#!/usr/bin/env python3
"""Unpack models of the demo and describe a scene of them: demo_scene.py CATALOGUE.sh3f OUT

The catalogue is a zip archive; the models in it are CC0 (its LICENSE.TXT is unpacked too). Their unit is the centimetre,
the scene's the metre."""

import json
import math
import pathlib
import sys
import zipfile

FOLDER = "blendswap-cc-0/"
MODELS = ["chairWithCushion", "barrel", "lantern", "flowerBox", "rock1", "fence", "plant", "bench", "bread"]
# Where each model's own floor point is, in its units: (x, lowest y, z).
BASE = {"chairWithCushion": (0.28, 3.15, -37.2), "barrel": (0, 0.4, 0), "lantern": (0, 3.4, 0), "flowerBox": (-30.2, 44.2, 1.5), "rock1": (0, 3, 0),
        "fence": (-0.8, -3.4, 0.3), "plant": (1.7, 0, -2.6), "bench": (0, 0, 0), "bread": (0, 0, 0)}


def unpack(catalogue, out):
    with zipfile.ZipFile(catalogue) as z:
        names = [n for n in z.namelist() if n.startswith(tuple(FOLDER + m + "/" for m in MODELS)) and not n.endswith("/")]
        for name in names + ["LICENSE.TXT"]:
            target = out / "models" / (name[len(FOLDER):] if name.startswith(FOLDER) else name)
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_bytes(z.read(name))


def place(model, x, y, z, turn=0.0, size=1.0):
    """Column-major matrix: the model's floor point goes to x, y, z; turn in degrees about the vertical."""
    c, s, k = math.cos(math.radians(turn)), math.sin(math.radians(turn)), 0.01 * size
    bx, by, bz = BASE[model]
    return [k * c, 0, -k * s, 0, 0, k, 0, 0, k * s, 0, k * c, 0,
            x - k * (c * bx + s * bz), y - k * by, z - k * (c * bz - s * bx), 1]


def scene():
    items = [("barrel", 0, 0, 0), ("bread", 0.05, 0.897, 0.05, 30)]
    items += [("chairWithCushion", 0.95 * math.sin(math.radians(a)), 0, 0.95 * math.cos(math.radians(a)), a + 180) for a in (20, 110, 200, 290)]
    items += [("fence", -2.7 + 1.8 * i, 0, -2.2) for i in range(4)]
    items += [("flowerBox", -2.7 + 0.9 * i, 0.85, -2.05) for i in range(7)]
    items += [("plant", -2.2, 0, -1.1, 0, 1.1), ("plant", 2.3, 0, -1.3, 70), ("lantern", -2.0, 0, 1.0), ("lantern", 1.75, 0, 0.9, 40)]
    items += [("bench", -2.3, 0, -0.1, 90), ("barrel", 1.7, 0, -1.6, 60, 0.8), ("barrel", 2.9, 0, -1.5, 200, 0.9)]
    items += [("rock1", -1.9 + 0.33 * (i % 3), 0, 1.45 + 0.3 * (i // 3), 47 * i, 0.35 + 0.1 * (i % 4)) for i in range(6)]
    instances = [{"asset": m, "name": "%s %d" % (m, i), "matrix": place(m, *where)} for i, (m, *where) in enumerate(items)]
    tiles = [(i, j) for j in range(-4, 9) for i in range(-9, 9)]
    instances += [{"asset": ("tile", "tile dark")[(i + j) % 2], "translation": [0.6 * i, 0, 0.6 * j]} for i, j in tiles]
    assets = [{"name": m, "file": "models/%s/%s.obj" % (m, m)} for m in MODELS if m != "chairWithCushion"]
    assets += [{"name": "chairWithCushion", "file": "chair.svdag"}, {"name": "tile", "file": "models/tile.obj"},
               {"name": "tile dark", "file": "models/tile_dark.obj"}]
    return {"assets": assets, "instances": instances, "camera": {"eye": [2.5, 1.9, 4.0], "target": [0.05, 0.5, -0.4], "fov": 36}}


def main():
    catalogue, out = pathlib.Path(sys.argv[1]), pathlib.Path(sys.argv[2])
    unpack(catalogue, out)
    for name, colour in (("tile", "0.46 0.38 0.31"), ("tile_dark", "0.36 0.3 0.25")):
        (out / "models" / (name + ".mtl")).write_text("newmtl stone\nKd %s\n" % colour)
        (out / "models" / (name + ".obj")).write_text(
            "mtllib %s.mtl\nusemtl stone\nv 0 0 0\nv 0.6 0 0\nv 0.6 0 0.6\nv 0 0 0.6\nf 1 4 3 2\n" % name)
    (out / "scene.json").write_text(json.dumps(scene(), indent=1) + "\n")


main()
