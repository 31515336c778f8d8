"""The two forms of .svo: same octree, same bytes whichever way they were made; sizes and times."""

import json
import os

import support
from support import check, run, tool


def meshes(folder):
    support.sphere_obj(folder / "s.obj", rings=24)
    support.cube_obj(folder / "c.obj", color=(0.2, 0.5, 1))
    return ("s", 8, ()), ("s", 9, ("--attributes", "none")), ("c", 8, ()), ("s", 0, ())


def test_every_way_gives_the_same_bytes(folder):
    for mesh, depth, more in meshes(folder):
        def make(name, *options):
            run("svo-voxelize", folder / (mesh + ".obj"), "-o", folder / name, "--depth", depth, "--force", *more, *options)
            return (folder / name).read_bytes()

        fast, small = make("fast.svo"), make("small.svo", "--disk", "small")
        check(fast != small, mesh)
        for threads in (1, 3):
            check(make("t.svo", "--disk", "small", "--threads", threads) == small, (mesh, threads))
            run("svo-merge", folder / "fast.svo", "-o", folder / "m.svo", "--disk", "small", "--threads", threads, "--force")
            check((folder / "m.svo").read_bytes() == small, "fast to small")
            run("svo-merge", folder / "small.svo", "-o", folder / "m.svo", "--disk", "fast", "--threads", threads, "--force")
            check((folder / "m.svo").read_bytes() == fast, "small to fast")
        for n in (3,):
            shards = []
            for i in range(1, n + 1):
                make("p%d.svo" % i, "--disk", "small", "--shard", "%d/%d" % (i, n))
                shards.append(folder / ("p%d.svo" % i))
            run("svo-merge", *reversed(shards), "-o", folder / "m.svo", "--force")
            check((folder / "m.svo").read_bytes() == small, (mesh, n, "merged"))
            make("q.svo", "--shard", "1/%d" % n)
            run("svo-merge", folder / "q.svo", "-o", folder / "m.svo", "--disk", "small", "--force")
            run("svo-dump", folder / "m.svo", "--validate")
        r = tool("svo-compare", folder / "fast.svo", folder / "small.svo")
        check(r.code == 0, r)
        run("svo-dump", folder / "small.svo", "--validate")
        keys = {tool("svo-voxelize", folder / (mesh + ".obj"), "--key", "--depth", depth, *more, "--disk", d).out for d in ("fast", "small")}
        check(len(keys) == 2, keys)


def test_a_shard_stays_one(folder):
    support.sphere_obj(folder / "s.obj", rings=24)
    parts = []
    for i in (1, 2, 3):
        run("svo-voxelize", folder / "s.obj", "-o", folder / "p.svo", "--depth", 9, "--shard", "%d/3" % i, "--force")
        parts.append(folder / ("p%d.svo" % i))
        run("svo-merge", folder / "p.svo", "-o", parts[-1], "--disk", "small")
    run("svo-merge", *parts, "-o", folder / "m.svo")
    run("svo-voxelize", folder / "s.obj", "-o", folder / "whole.svo", "--depth", 9, "--disk", "small")
    a, b = (run("svo-dump", folder / n, "--json").json for n in ("m.svo", "whole.svo"))
    check([s for s in a["sections"] if s["type"] == "GRUP"] == [s for s in b["sections"] if s["type"] == "GRUP"], "groups")
    r = tool("svo-compare", folder / "m.svo", folder / "whole.svo")
    check(r.code == 0, r)


def test_wrong_uses(folder):
    support.cube_obj(folder / "c.obj")
    run("svo-voxelize", folder / "c.obj", "-o", folder / "a.svo", "--depth", 4)
    run("svo-voxelize", folder / "c.obj", "-o", folder / "b.svo", "--depth", 5)
    check(tool("svo-merge", folder / "a.svo", folder / "b.svo", "-o", folder / "m.svo", "--disk", "small").code == 1, "two inputs")
    check(tool("svo-merge", folder / "a.svo", "-o", folder / "m.svo", "--disk", "tiny").code == 1, "an unknown form")
    damaged = bytearray((folder / "a.svo").read_bytes())
    damaged[len(damaged) // 2] ^= 4
    (folder / "d.svo").write_bytes(damaged)
    check(tool("svo-merge", folder / "d.svo", "-o", folder / "m.svo", "--disk", "small").code == 3, "damaged")
    check(not (folder / "m.svo").exists(), "nothing is left behind")


def test_size_of_smooth_surfaces(folder):
    """A ball of depth 9 without attributes: whole files, headers included."""
    support.sphere_obj(folder / "s.obj", rings=96)
    sizes = {}
    for disk in ("fast", "small"):
        run("svo-voxelize", folder / "s.obj", "-o", folder / "s.svo", "--depth", 9, "--attributes", "none", "--disk", disk, "--force")
        sizes[disk] = os.path.getsize(folder / "s.svo")
    voxels = run("svo-dump", folder / "s.svo", "--json").json["voxels"]
    check(sizes["small"] < 0.35 * sizes["fast"], sizes)
    check(8 * sizes["small"] / voxels < 0.45, (sizes, voxels))


def test_shards_are_shown(folder):
    support.sphere_obj(folder / "s.obj", rings=12)
    run("svo-voxelize", folder / "s.obj", "-o", folder / "p.svo", "--depth", 8, "--shard", "2/3")
    shard = run("svo-dump", folder / "p.svo", "--json").json["shard"]
    check((shard["index"], shard["count"]) == (2, 3) and 0 < shard["first_code"] < shard["end_code"] < 8 and len(shard["job"]) == 32, shard)
    run("svo-compress", folder / "p.svo", "-o", folder / "p.svdag", "--report", folder / "r.json")
    warnings = json.loads((folder / "r.json").read_text())["warnings"]
    check(any("shard 2 of 3" in str(w) for w in warnings), warnings)
    run("svo-voxelize", folder / "s.obj", "-o", folder / "w.svo", "--depth", 8)
    check("shard" not in run("svo-dump", folder / "w.svo", "--json").json, "a whole octree")


def test_compress_in_bounded_memory(folder):
    """Values go to temporary files; the bytes are the same, resident memory is at most 1.5 times the output and --memory."""
    support.sphere_obj(folder / "s.obj", rings=64)
    run("svo-voxelize", folder / "s.obj", "-o", folder / "s.svo", "--depth", 10)
    base, first, spilled = None, None, 0
    run("svo-voxelize", folder / "s.obj", "-o", folder / "tiny.svo", "--depth", 2)
    run("svo-compress", folder / "tiny.svo", "-o", folder / "o.svdag", "--threads", 2, "--report", folder / "r.json")
    base = json.loads((folder / "r.json").read_text())["peak_rss_bytes"]  # of a program that does nothing
    for memory in ("1G", "64M", "40M", "28M"):
        run("svo-compress", folder / "s.svo", "-o", folder / "o.svdag", "--force", "--normal", "deg=2", "--threads", 2, "--memory", memory, "--temp", folder,
            "--report", folder / "r.json", "--force")
        out = (folder / "o.svdag").read_bytes()
        report = json.loads((folder / "r.json").read_text())
        first = first or out
        check(out == first, memory)
        limit = int(memory[:-1]) << (30 if memory[-1] == "G" else 20)
        check(report["peak_rss_bytes"] <= 1.5 * len(out) + limit + base, (memory, report["peak_rss_bytes"], len(out), base))
        spilled = max(spilled, report["memory"]["temporary_bytes"])
        check(not [f for f in os.listdir(folder) if f.startswith("svokit")], "temporary files are left")
    check(spilled > 1 << 20, spilled)  # compressed: some 12 MB of values are held in 2.7
    for memory in (None, "48M", "24M"):  # without loss, what values become adds to what is held
        run("svo-compress", folder / "s.svo", "-o", folder / ("%s.svdag" % memory), "--threads", 2, "--temp", folder, "--report", folder / "r.json", *(["--memory", memory] if memory else []))
        size = (folder / ("%s.svdag" % memory)).stat().st_size
        check((folder / ("%s.svdag" % memory)).read_bytes() == (folder / "None.svdag").read_bytes(), "%s: other bytes" % memory)
        if memory:
            peak = json.loads((folder / "r.json").read_text())["peak_rss_bytes"]
            check(peak <= 1.5 * size + (int(memory[:-1]) << 20) + base, (memory, peak, size, base))
    check(size > 2 << 20, size)
    r = tool("svo-compress", folder / "s.svo", "-o", folder / "no.svdag", "--memory", "2M")
    check(r.code == 6 and not (folder / "no.svdag").exists(), r)


support.main(globals())
