#!/usr/bin/env python3
"""Make the golden files anew:  tests/golden/make.py TOOLS

Small files of every kind and coding, and golden.json: what is in them. tests/cli/test_golden.py reads them with the tools as they are now. Once a version of a format has been released its
files stay as they are, and are joined by those of the next; they are made anew only for a change that docs/format states as one that older files do not survive."""

import json
import pathlib
import subprocess
import sys

HERE = pathlib.Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent / "cli"))
import contents  # noqa: E402
import support  # noqa: E402

ARM = {"twist": {"axis": "y", "degrees": 50}}


def main():
    tools, work = pathlib.Path(sys.argv[1]).resolve(), HERE / "work"
    work.mkdir(exist_ok=True)

    def run(name, *args):
        subprocess.run([str(tools / name), *map(str, args), "-q", "--no-config"] + ([] if name == "svo-dump" else ["-f"]), check=True, stdout=subprocess.DEVNULL)

    support.cube_glb(work / "cubes.glb", texture=support.write_png(None, 16, 16, lambda x, y: (16 * x, 16 * y, 40 * (x * y % 5))), nodes=[(0, 0, 0), (1.3, 2.1, 0.4)])
    support.sphere_obj(work / "ball.obj", rings=8)
    run("svo-voxelize", work / "cubes.glb", "-o", HERE / "cubes.svo", "-d", 4)
    run("svo-voxelize", work / "cubes.glb", "-o", HERE / "cubes_small.svo", "-d", 4, "--disk", "small")
    run("svo-voxelize", work / "cubes.glb", "-o", HERE / "cubes_zstd.svo", "-d", 4, "--level", 3)
    run("svo-voxelize", work / "ball.obj", "-o", HERE / "ball_solid.svo", "-d", 5, "--fill", "solid")
    run("svo-voxelize", work / "ball.obj", "-o", HERE / "ball_shard.svo", "-d", 8, "--attributes", "none", "--shard", "2/3")
    for geometry in ("svdag", "symmetric", "fast", "best"):
        run("svo-compress", HERE / "cubes.svo", "-o", HERE / ("cubes_%s.svdag" % geometry), "--geometry", geometry)
        run("svo-compress", HERE / "ball_solid.svo", "-o", HERE / ("ball_%s_deg2.svdag" % geometry), "--geometry", geometry, "--normal", "deg=2")
    run("svo-compress", HERE / "cubes.svo", "-o", HERE / "cubes_stored_de1.svdag", "--lod", "stored", "--color", "deltaE=1", "--normal", 12)
    run("svo-compress", HERE / "cubes.svo", "-o", HERE / "cubes_none_8.svdag", "--lod", "none", "--color", 8)
    run("svo-compress", HERE / "cubes.svo", "-o", HERE / "cubes_algorithm1.svdag", "--palettes", "algorithm1", "--color", 10)
    support.cube_glb(work / "two.glb", texture=support.write_png(None, 2, 1, lambda x, y: (255 * x, 80, 20)))
    run("svo-voxelize", work / "two.glb", "-o", work / "two.svo", "-d", 7, "--attributes", "color")
    run("svo-compress", work / "two.svo", "-o", HERE / "two_repeats.svdag")
    (work / "scene.json").write_text(json.dumps({"assets": [{"name": "cubes", "file": "../cubes_fast.svdag"}, {"name": "ball", "file": "ball.svdag"}], "instances": [
        {"asset": "cubes", "name": "one", "translation": [1e6, 2, 3]}, {"asset": "cubes", "pose": ARM, "scale": [1, 2, -1]}, {"asset": "ball", "id": 7}]}))
    (work / "ball.svdag").write_bytes((HERE / "ball_best_deg2.svdag").read_bytes())
    (work / "cubes_fast.svdag").write_bytes((HERE / "cubes_fast.svdag").read_bytes())
    (work / "scene.json").write_text((work / "scene.json").read_text().replace("../", ""))
    run("svo-pack", work / "scene.json", "-o", HERE / "scene.svscene", "--page", 2)
    stretch = lambda line: "v %s %r %s" % (line.split()[1], 6 * float(line.split()[2]), line.split()[3]) if line.startswith("v ") else line
    (work / "tube.obj").write_text("\n".join(map(stretch, (work / "ball.obj").read_text().splitlines())) + "\n")
    run("svo-skeleton", work / "tube.obj", "-o", HERE / "tube.skel", "--omega", 0.05)
    for f in work.iterdir():
        f.unlink()
    work.rmdir()
    files = sorted(f for f in HERE.iterdir() if f.suffix in (".svo", ".svdag", ".svscene", ".skel"))
    (HERE / "golden.json").write_text(json.dumps({f.name: contents.of(tools, f) for f in files}, indent=1, sort_keys=True) + "\n")
    print("%d files, %d bytes" % (len(files), sum(f.stat().st_size for f in files)))


if __name__ == "__main__":
    main()
