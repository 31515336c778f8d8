#!/usr/bin/env python3
"""Many models through all codings, and back: are the voxels, the values and the pictures the same?

    tests/round_trip.py TOOLS [--models FOLDER...] [--count N] [--depth D] [--seed N]

Models are drawn from the folders (default: SVOKIT_MODELS and Debian's assimp-testmodels). Each is voxelized at a random depth up to --depth, thin or conservative, as surface or
solid, in the fast or the small form, and packed in all four geometries with random reductions of colours and normals and random levels of detail. Then:
  - svo-compare of the octree and each packed one: the same voxels, values within the bounds that were asked for (equal, where none was);
  - svo-dump --validate --source: the bounds that the file promises hold for every node;
  - svo-render: without reductions the picture is that of the octree, pixel for pixel; all geometries of one reduction give the same picture;
  - svo-merge --disk: the other form and back gives the same bytes.
Exit codes of refused models are counted. Prints figures, and the exit status is 1 where something of this does not hold. Python 3 standard library only."""

import argparse
import collections
import os
import pathlib
import random
import subprocess
import sys
import tempfile
import time

ENDINGS = {".obj", ".ply", ".stl", ".off", ".glb", ".gltf", ".drc", ".vox", ".binvox", ".nrrd"}
GEOMETRIES = ("svdag", "fast", "symmetric", "best")


class Trip:
    def __init__(self, tools, folder):
        self.tools, self.folder, self.faults, self.done = tools, folder, [], collections.Counter()

    def run(self, name, *args):
        r = subprocess.run([str(self.tools / name), *map(str, args)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, timeout=900)
        self.done[name] += 1
        if r.returncode < 0:
            self.fault("%s died by signal %d: %s" % (name, -r.returncode, " ".join(map(str, args))))
        return r

    def fault(self, text):
        self.faults.append(text)
        print("FAULT:", text, flush=True)

    def demand(self, what, name, *args):
        r = self.run(name, *args)
        if r.returncode != 0:
            self.fault("%s: %s %s: exit %d: %s" % (what, name, " ".join(map(str, args)), r.returncode, (r.stderr or r.stdout).decode(errors="replace").strip()[:300]))
        return r.returncode == 0

    def picture(self, what, file, out):
        return self.demand(what, "svo-render", file, "-o", out, "-f", "-q", "--size", "160x120") and out.read_bytes()


def reductions(rng):
    """Options of svo-compress, and of svo-compare that allow for them."""
    color = rng.choice(([], [], ["--color", "deltaE=%g" % rng.choice((0.3, 1, 3))], ["--color", rng.choice((4, 9, 12))]))
    normal = rng.choice(([], [], ["--normal", "deg=%g" % rng.choice((0.5, 2, 10))], ["--normal", rng.choice((8, 12, 16))]))
    loose = lambda option, flag: [] if not option else [flag, str(option[1]).split("=")[-1] if "=" in str(option[1]) else {"--deltaE": 200, "--deg": 180}[flag]]
    return color + normal, loose(color, "--deltaE") + loose(normal, "--deg")


def trip(t, model, rng, depth):
    svo, what = t.folder / "a.svo", str(model)
    options = ["-d", rng.randint(2, depth), "--fill", rng.choice(("surface", "surface", "solid")), "--surface", rng.choice(("conservative", "conservative", "thin")),
               "--attributes", rng.choice(("auto", "auto", "none", "color,normal,emissive,metallic,roughness,material,coverage")), "--disk", rng.choice(("fast", "small"))]
    r = t.run("svo-voxelize", model, "-o", svo, "-f", "-q", "--memory", "2G", *options)
    if r.returncode == 1:  # voxels and points take fewer options
        options = ["--disk", options[-1]] if model.suffix.lower() in (".vox", ".binvox", ".nrrd") else options[:2]
        r = t.run("svo-voxelize", model, "-o", svo, "-f", "-q", "--memory", "2G", *options)
    t.done["exit %d" % r.returncode] += 1
    if r.returncode != 0:
        return
    what += " " + " ".join(map(str, options))
    if not t.demand(what, "svo-dump", svo, "--validate"):
        return
    form, other = ("small", "fast") if "small" in options else ("fast", "small")  # (points may have lost the option: fast)
    if t.demand(what, "svo-merge", svo, "-o", t.folder / "b.svo", "--disk", other, "-f", "-q") and \
       t.demand(what, "svo-merge", t.folder / "b.svo", "-o", t.folder / "c.svo", "--disk", form, "-f", "-q"):
        t.demand(what, "svo-compare", svo, t.folder / "c.svo", "-q")
        if (t.folder / "c.svo").stat().st_size != svo.stat().st_size:
            t.fault("%s: the %s form and back has another size" % (what, other))
    plain = t.picture(what, svo, t.folder / "a.png")
    more, allowed = reductions(rng)
    lod = rng.choice(("all", "all", "stored", "none"))
    pictures = {}
    for geometry in GEOMETRIES:
        packed = t.folder / (geometry + ".svdag")
        if not t.demand(what, "svo-compress", svo, "-o", packed, "-f", "-q", "--geometry", geometry, "--lod", lod, *more):
            continue
        t.demand(what, "svo-compare", svo, packed, "-q", *allowed)
        t.demand(what, "svo-dump", packed, "--validate", "--source", svo)
        pictures[geometry] = t.picture(what, packed, t.folder / "p.png")
        t.done["packed"] += 1
    if len(set(pictures.values())) > 1:
        t.fault("%s, %s lod %s: pictures differ between geometries" % (what, more, lod))
    if not more and lod != "none" and pictures and plain not in pictures.values():
        t.fault("%s, lod %s: the picture without loss is not that of the octree" % (what, lod))


def main():
    p = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    p.add_argument("tools", type=pathlib.Path)
    p.add_argument("--models", type=pathlib.Path, nargs="*")
    p.add_argument("--count", type=int, default=100)
    p.add_argument("--depth", type=int, default=8)
    p.add_argument("--seed", type=int, default=1)
    a = p.parse_args()
    folders = a.models or [pathlib.Path(f) for f in (os.environ.get("SVOKIT_MODELS", ""), "/usr/share/assimp/models") if f and pathlib.Path(f).is_dir()]
    files = sorted(f for folder in folders for f in folder.rglob("*") if f.suffix.lower() in ENDINGS and f.is_file())
    if not files:
        sys.exit("no models: name folders with --models, set SVOKIT_MODELS, or install assimp-testmodels")
    rng = random.Random(a.seed)
    rng.shuffle(files)
    files = [f for f in files if f.stat().st_size < 60 << 20][:a.count]
    began = time.time()
    with tempfile.TemporaryDirectory(prefix="svokit-trip-") as folder:
        t = Trip(a.tools.resolve(), pathlib.Path(folder))
        for f in files:
            trip(t, f, rng, a.depth)
    codes = ", ".join("%s: %d" % (k, n) for k, n in sorted(t.done.items()))
    print("%d models, %.0f s; %s; %d faults" % (len(files), time.time() - began, codes, len(t.faults)))
    sys.exit(1 if t.faults else 0)


if __name__ == "__main__":
    main()
