"""A skeleton of everything in a folder, or a clear error: what test_skeleton_corpus.py does with damaged and broken files, and a command of its own for more:

    python3 tests/cli/skeleton_corpus.py build/tools . FOLDER... [omega=0.05]

prints a line for each model and ends with 1 when one broke a rule."""

import json
import pathlib
import sys
import tempfile
import time

import support
import swc_reader
from support import check, tool

MESHES = {".obj", ".ply", ".stl", ".off", ".gltf", ".glb", ".drc"}
OUTPUTS = {"-o": "m.skel", "--obj": "m.obj", "--swc": "m.swc", "--glb": "m.glb", "--segments": "segments.ply", "--solid": "solid.svo", "--reconstruct": "closed.ply"}


def models(folder):
    return [p for p in sorted(pathlib.Path(folder).rglob("*")) if p.suffix.lower() in MESHES and p.is_file()]


def try_model(path, folder, omega=0.05):
    """One model: a skeleton with everything that can be made of it, each read again, or an error that says what is wrong and leaves nothing. Returns (exit code, text)."""
    outputs = [x for option, name in OUTPUTS.items() for x in (option, folder / name)]
    octree, bind = folder / "bind.svo", []
    if tool("svo-voxelize", path, "-o", octree, "-f", "--depth", 5, "--attributes", "none").code == 0:
        bind = ["--bind", octree, "--bound", folder / "bound.svo"]
    r = tool("svo-skeleton", path, *outputs, *bind, "--omega", omega, "-f", "--max-vertices", 2000000, "--report", folder / "r.json", timeout=600)
    check(r.code in (0, 3, 5, 6), r)
    if r.code != 0:
        check(r.err.startswith("svo-skeleton: error: ") and len(r.err.strip()) > 40, r)
        check(not any((folder / name).exists() for name in OUTPUTS.values()), "files are left: %s" % r.err)
        return r.code, r.err.strip().split("\n")[-1]
    report = support.report(folder / "r.json")
    out = report["output"]
    check(out["joints"] > 0 and out["components"] > 0 and all(-1e300 < x < 1e300 for x in report["errors"].values() if isinstance(x, float)), report)
    swc_reader.check_pair(swc_reader.Swc(folder / "m.swc"), swc_reader.Curve(folder / "m.obj"), out["components"])
    for name in ["m.skel", "solid.svo"] + ["bound.svo"] * bool(bind):
        check(tool("svo-dump", "--validate", folder / name).code == 0, name)
    check((folder / "closed.ply").stat().st_size > 200 and (folder / "segments.ply").stat().st_size > 200, "nothing in the PLY files")
    for name in list(OUTPUTS.values()) + ["bound.svo"]:
        (folder / name).unlink(missing_ok=True)
    return 0, "%d joints, %d components, %d loops, %.3g %% inside, converged %s" % (
        out["joints"], out["components"], out["loops"], report["errors"]["length_inside_percent"], out["converged"])


def main():
    omega = [float(a[6:]) for a in sys.argv[3:] if a.startswith("omega=")] or [0.05]
    bad = 0
    for folder in [a for a in sys.argv[3:] if not a.startswith("omega=")]:
        for path in models(folder):
            with tempfile.TemporaryDirectory() as scratch:
                since = time.monotonic()
                try:
                    code, text = try_model(path, pathlib.Path(scratch), omega[0])
                except Exception as e:
                    code, text, bad = "BAD", repr(e)[:300], bad + 1
            print("%6.1f s  %-3s  %s: %s" % (time.monotonic() - since, code, path.relative_to(folder), text), flush=True)
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
