"""Allocation failure at the n-th allocation, in our code and in every library below: each tool ends with exit code 4 (or 0 where it could do without), a message
on stderr, no crash, and no output that is not whole. The shim is tests/preload/fail_malloc.c.

    test_allocations.py TOOLS SOURCE            some fifty failing allocations a tool
    FAIL_MALLOC_EVERY=1 test_allocations.py ... each one (an hour)
"""

import os
import pathlib
import random
import subprocess

import support
from support import check, run, skip

shim = pathlib.Path(os.environ.get("FAIL_MALLOC", str(support.tools.parent / "tests" / "fail_malloc.so")))
SAMPLE = 50


def sweep(folder, outputs, name, *args):
    """Run the tool with failing allocations 1, 2, 3 ... (a sample of them), once alone and once with all later ones."""
    if not shim.exists():
        skip("no %s: not built under a sanitizer, which has an allocator of its own" % shim.name)
    command = [str(support.tools / name)] + [str(a) for a in args]

    def attempt(env):
        for o in outputs:
            if o.exists():
                o.unlink()
        return subprocess.run(command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, timeout=120,
                              env=dict(os.environ, LD_PRELOAD=str(shim), **env))

    counted = folder / "count"
    r = attempt({"FAIL_MALLOC_COUNT": str(counted)})
    check(r.returncode == 0, r)
    whole = [o.read_bytes() for o in outputs]
    total = int(counted.read_text())
    check(total > 50, "the shim counted %d allocations only" % total)
    every = os.environ.get("FAIL_MALLOC_EVERY")
    chosen = range(1, total + 1) if every else sorted(random.Random(name).sample(range(1, total + 1), min(SAMPLE, total)))
    failed = 0
    for n in chosen:
        for on in "01":
            r = attempt({"FAIL_MALLOC_AT": str(n), "FAIL_MALLOC_ON": on})
            what = "allocation %d of %d%s: %s\n  exit %s, stderr: %s" % (n, total, " and all later ones" if on == "1" else "", " ".join(command), r.returncode,
                                                                         r.stderr.decode("utf-8", "replace")[-400:])
            if r.returncode < 0 and b"Failed to allocate memory." in r.stderr:
                continue  # FLANN 1.9 says this and goes on with the null pointer: known, and not in our hands (docs/trust.md)
            check(r.returncode in (0, 4), what)
            check(r.returncode == 0 or b"memory" in r.stderr, what)
            for o, bytes_ in zip(outputs, whole):  # whole or not there; a report may come before or after
                check(not o.exists() or o.suffix == ".json" or o.read_bytes() == bytes_, "%s\n  %s is not what it should be" % (what, o.name))
            left = [p.name for p in folder.iterdir() if "tmp" in p.name]
            check(not left, "%s\n  left behind: %s" % (what, left))
            failed += r.returncode != 0
    check(failed > len(chosen) // 2, "only %d of %d runs met the failure" % (failed, 2 * len(chosen)))


def textured(folder):
    """A coloured cube, its octree and its packed octree."""
    support.cube_obj(folder / "cube.obj", color=(0.8, 0.3, 0.1))
    run("svo-voxelize", folder / "cube.obj", "-o", folder / "cube.svo", "--depth", 5, "--attributes", "color,normal", "-q")
    run("svo-compress", folder / "cube.svo", "-o", folder / "cube.svdag", "-q")


def test_voxelize_obj(folder):
    support.cube_obj(folder / "cube.obj")
    sweep(folder, [folder / "o.svo"], "svo-voxelize", folder / "cube.obj", "-o", folder / "o.svo", "--depth", 5, "--attributes", "color,normal", "-q")


def test_voxelize_gltf_with_report(folder):
    textured(folder)
    run("svo-skeleton", folder / "cube.obj", "-o", folder / "c.skel", "--omega", 0.3, "--glb", folder / "c.glb", "-q")
    sweep(folder, [folder / "o.svo", folder / "o.json"], "svo-voxelize", folder / "c.glb", "-o", folder / "o.svo", "--depth", 4, "--report", folder / "o.json", "-q")


def test_voxelize_solid(folder):
    support.cube_obj(folder / "cube.obj")
    sweep(folder, [folder / "o.svo"], "svo-voxelize", folder / "cube.obj", "-o", folder / "o.svo", "--depth", 5, "--fill", "solid", "--attributes", "none", "-q")


def test_compress(folder):
    textured(folder)
    sweep(folder, [folder / "o.svdag"], "svo-compress", folder / "cube.svo", "-o", folder / "o.svdag", "--color", "deltaE=1", "--normal", "deg=2", "-q")
    sweep(folder, [folder / "o.svdag"], "svo-compress", folder / "cube.svo", "-o", folder / "o.svdag", "--geometry", "best", "--color", "4", "-q")


def test_pack_render(folder):
    textured(folder)
    (folder / "s.json").write_text('{"assets":[{"name":"a","file":"cube.svdag"}],"instances":[{"asset":"a"},{"asset":"a","translation":[3,0,0]}]}')
    run("svo-pack", folder / "s.json", "-o", folder / "s.svscene", "-q")
    sweep(folder, [folder / "o.svscene"], "svo-pack", folder / "s.json", "-o", folder / "o.svscene", "-q")
    sweep(folder, [folder / "o.png"], "svo-render", folder / "s.svscene", "-o", folder / "o.png", "--size", "32x32", "-q")


def test_dump_compare_merge(folder):
    textured(folder)
    sweep(folder, [], "svo-dump", folder / "cube.svdag", "--json", "--validate")
    sweep(folder, [], "svo-compare", folder / "cube.svo", folder / "cube.svdag")
    sweep(folder, [folder / "o.svo"], "svo-merge", folder / "cube.svo", "-o", folder / "o.svo", "--disk", "small", "-q")


def test_skeleton(folder):
    support.cube_obj(folder / "cube.obj")
    sweep(folder, [folder / "o.skel", folder / "o.glb"], "svo-skeleton", folder / "cube.obj", "-o", folder / "o.skel", "--omega", 0.3, "--glb", folder / "o.glb", "-q")


support.main(globals())
