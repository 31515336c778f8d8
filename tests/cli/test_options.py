"""The options that all tools share are used with every tool; some seldom used ones more closely than in test_each_option.py."""

import json

import support
from support import SHARED, check, options, run, tool, tools_by_name

def commands(folder):
    """A small run of each tool."""
    cube = support.cube_obj(folder / "c.obj", color=(1, 0.5, 0))
    sphere = support.sphere_obj(folder / "s.obj")
    (folder / "scene.json").write_text(json.dumps({"assets": [{"name": "a", "file": "c.svdag"}], "instances": [{"asset": "a"}]}))
    (folder / "build.json").write_text(json.dumps({"output": "out", "defaults": {"voxelize": {"depth": 3}}, "assets": [{"name": "a", "input": "c.obj"}]}))
    yield "svo-voxelize", [cube, "--depth", 4], "c.svo"
    yield "svo-compress", [folder / "c.svo"], "c.svdag"
    yield "svo-merge", [folder / "c.svo", "--disk", "small"], "m.svo"
    yield "svo-pack", [folder / "scene.json"], "c.svscene"
    yield "svo-render", [folder / "c.svscene", "--size", "16x16"], "c.png"
    yield "svo-skeleton", [sphere, "--omega", 0.3], "s.skel"
    yield "svo-dump", [folder / "c.svdag", "--voxels", folder / "v.ply"], None
    yield "svo-compare", [folder / "c.svdag", folder / "c.svo"], None
    yield "svo-bench", [cube, "--sweep", "depth", "--values", "3..4", "--repeat", 1, "--csv", folder / "b.csv"], None
    yield "svo-build", [folder / "build.json"], None


def test_shared_options(folder):
    """-o, -f, --threads, --memory, --report, -q, -v, --progress, --no-progress, --help, --version of each tool do what docs/tools/common.md says."""
    done = set()
    for name, args, out in commands(folder):
        have = {o for o, _ in options(name)}
        check(SHARED - {"output"} <= have and ("output" in have) == (out is not None or name == "svo-build"), (name, have))
        where = ["-o", folder / out] if out else []
        report = folder / (name + ".json")
        r = run(name, *args, *where, "--threads", 2, "--memory", "1G", "--report", report, "-v", "-v", "--progress")
        data = support.report(report)
        check(data["tool"] == name and data["options"]["threads"] == 2 and data["options"]["memory"] == 1 << 30, data["options"])
        bytes_ = (folder / out).read_bytes() if out else None
        if out:
            again = tool(name, *args, *where)
            check(again.code == 2 and "--force" in again.err and (folder / out).read_bytes() == bytes_, again)
        quiet = run(name, *args, *where, "-f", "-q", "--no-progress")
        check(quiet.err == "", quiet)
        check(out is None or (folder / out).read_bytes() == bytes_, "%s: other bytes with other threads" % name)
        check(run(name, "--version").text.startswith(name + " "), name)
        check(name in run(name, "-h").text and run(name, "--help=man").text.startswith(".TH") and name in run(name, "--help=bash").text)
        wrong = tool(name, "--no-such-option")
        check(wrong.code == 1 and "--help" in wrong.err, wrong)
        done.add(name)
    check(done == set(tools_by_name()), "a tool without a run: %s" % (set(tools_by_name()) - done))


def test_seldom_used(folder):
    """What options that hardly any other test needs do."""
    made = {name: out for name, args, out in commands(folder) if run(name, *args, *(["-o", folder / out] if out else []))}
    check(len(made) == len(tools_by_name()), made)
    sphere = folder / "s.obj"
    joints = {}
    for extra in ([], ["--delta", 0.05], ["--method", "literal"], ["--normalize", "box"], ["--place", "centroid"], ["--place", "contracted"]):
        run("svo-skeleton", sphere, "-f", "-o", folder / "x.skel", "--omega", 0.3, *extra)
        joints[" ".join(map(str, extra))] = run("svo-dump", folder / "x.skel", "--json").json
        check(run("svo-dump", "--validate", folder / "x.skel").code == 0, extra)
    check(joints["--place centroid"] != joints[""] and joints["--normalize box"] != joints[""], "options without effect")
    run("svo-skeleton", sphere, "-f", "-o", folder / "x.skel", "--omega", 0.3, "--glb", folder / "x.glb", "--smoothing", 0)
    rough = (folder / "x.glb").read_bytes()
    run("svo-skeleton", sphere, "-f", "-o", folder / "x.skel", "--omega", 0.3, "--glb", folder / "x.glb", "--smoothing", 3)
    check((folder / "x.glb").read_bytes()[:4] == rough[:4] == b"glTF")
    run("svo-voxelize", sphere, "-f", "-o", folder / "d.svo", "--depth", 3, "-MD")
    check((folder / "d.svo.d").read_text().startswith(str(folder / "d.svo")) and "s.obj" in (folder / "d.svo.d").read_text())
    # metal in every voxel: a mirror differs from the same without reflections
    run("svo-render", folder / "c.svdag", "-o", folder / "matt.png", "--size", "32x32")
    run("svo-render", folder / "c.svdag", "-o", folder / "mirror.png", "--size", "32x32", "--reflections", "--reflectance", 1)
    check((folder / "matt.png").read_bytes() != (folder / "mirror.png").read_bytes(), "reflections without effect")
    check(tool("svo-compare", folder / "c.svdag", folder / "c.svdag", "--value", 0).code == 0)
    # the tools of another folder: one that is not there is bad luck, that of the build does
    r = tool("svo-build", folder / "build.json", "-q", "--tools", folder)
    check(r.code == 0 or "could not be started" in r.text, r)
    (folder / "c.obj").write_text((folder / "c.obj").read_text() + "\n# changed\n")
    check(tool("svo-build", folder / "build.json", "-q", "--tools", folder).code == 4)
    check(tool("svo-build", folder / "build.json", "-q", "--tools", support.tools).code == 0)


support.main(globals())
