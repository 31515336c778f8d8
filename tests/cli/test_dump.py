"""svo-dump: its JSON, its point clouds, its verdicts and its exit codes."""

import json
import os
import struct
import subprocess
import sys

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))
import support
from support import check, run, tool


def make(folder, depth=5, name="cube", color=(1, 0.5, 0)):
    if not support.have("svo-voxelize"):
        support.skip("svo-voxelize is not built")
    support.cube_obj(folder / (name + ".obj"), color=color)
    run("svo-voxelize", folder / (name + ".obj"), "-o", folder / (name + ".svo"), "--depth", depth)
    return folder / (name + ".svo")


def compress(svo):
    if not support.have("svo-compress"):
        support.skip("svo-compress is not built")
    out = svo.with_suffix(".svdag")
    run("svo-compress", svo, "-o", out)
    return out


def check_json(d, path):
    size = path.stat().st_size
    check(d["bytes"] == size and sum(s["bytes"] for s in d["sections"]) == size, d["sections"])
    check(len(d["levels"]) == d["depth"] + 1 and [l["level"] for l in d["levels"]] == list(range(d["depth"] + 1)), d["levels"])
    check(sum(l["nodes"] for l in d["levels"]) == d["nodes"] and d["levels"][-1]["nodes"] == d["voxels"], d["levels"])
    check(abs(d["bytes_per_voxel"] - size / d["voxels"]) < 1e-9 * size, d)
    check(len(d["voxel_to_world"]) == 16 and d["voxel_to_world"][12:] == [0, 0, 0, 1], d["voxel_to_world"])
    check(len(d["content_hash"]) == 32 and isinstance(d["provenance"], dict), d["provenance"])


def levels_of(voxels, depth):
    """Node counts from the voxels alone."""
    return [len({(x >> depth - l, y >> depth - l, z >> depth - l) for x, y, z in voxels}) for l in range(depth + 1)]


def check_cloud(path, d, ply):
    v = support.ply_voxels(ply)
    check(len(v) == d["voxels"], len(v))
    check(levels_of(v, d["depth"]) == [l["nodes"] for l in d["levels"]], d["levels"])
    low = [min(k[i] for k in v) for i in range(3)]
    high = [max(k[i] for k in v) for i in range(3)]
    check(d["voxel_bounds"] == {"low": low, "high": high}, d["voxel_bounds"])
    m = d["voxel_to_world"]
    for k, p in list(v.items())[::97]:
        for i, axis in enumerate("xyz"):
            centre = sum(m[4 * i + c] * (k[c] + 0.5) for c in range(3)) + m[4 * i + 3]
            check(abs(p[axis] - centre) < 1e-12, (k, p, centre))
    return v


def test_svo_and_svdag_say_the_same(folder):
    svo = make(folder)
    d = run("svo-dump", svo, "--json").json
    check_json(d, svo)
    check(d["format"] == "svo", d["format"])
    run("svo-dump", svo, "--voxels", folder / "a.ply")
    a = check_cloud(svo, d, folder / "a.ply")
    dag = compress(svo)
    e = run("svo-dump", dag, "--json").json
    check_json(e, dag)
    check(e["format"] == "svdag" and e["levels"][0]["stored"] == 1, e["levels"])
    for key in ("depth", "voxel_to_world", "nodes", "voxels", "bounds", "voxel_bounds"):
        check(d[key] == e[key], key)
    run("svo-dump", dag, "--voxels", folder / "b.ply")
    check(check_cloud(dag, e, folder / "b.ply") == a, "the voxels differ")


def test_several_files_and_text(folder):
    a, b = make(folder, 3, "a"), make(folder, 4, "b")
    both = run("svo-dump", "--json", a, b).json
    check([d["depth"] for d in both] == [3, 4], both)
    text = run("svo-dump", a, b).text
    check(str(a) in text and str(b) in text and "voxels" in text, text)
    check(run("svo-dump", "--validate", a, b).text.count("valid") == 2)
    check("bounds" not in run("svo-dump", "--quick", "--json", a).json.keys() - {"grid_bounds"})


def test_pipes(folder):
    svo = make(folder)
    data = svo.read_bytes()
    d = run("svo-dump", "-", "--json", stdin=data).json
    e = run("svo-dump", svo, "--json").json
    check(d.pop("file") == "stdin" and e.pop("file") == str(svo) and d == e, d)
    run("svo-dump", svo, "--voxels", folder / "a.ply")
    check(run("svo-dump", "-", "--voxels", "-", stdin=data).out == (folder / "a.ply").read_bytes())


def test_threads_do_not_matter(folder):
    svo = make(folder, 8)
    one = run("svo-dump", svo, "--voxels", "-", "--threads", 1).out
    check(run("svo-dump", svo, "--voxels", "-", "--threads", 5).out == one)


def test_damage(folder):
    svo = make(folder, 6)
    data = bytearray(svo.read_bytes())
    bad = folder / "bad.svo"
    out = folder / "out.ply"
    for where in range(0, len(data), max(1, len(data) // 40)):
        changed = bytearray(data)
        changed[where] ^= 0x10
        bad.write_bytes(changed)
        r = tool("svo-dump", bad, "--voxels", out)
        check(r.code == 3 and r.out == b"" and "bad.svo" in r.err and not out.exists(), (where, r))
    for size in (0, 1, 63, 64, 1000, len(data) - 64, len(data) - 1):
        bad.write_bytes(data[:size])
        for options in ([], ["--json"], ["--validate"], ["--quick"], ["--voxels", out]):
            r = tool("svo-dump", bad, *options)
            check(r.code == 3 and r.out == b"" and not out.exists(), (size, r))
    check(sorted(p.name for p in folder.iterdir() if p.suffix == ".ply" or ".part" in p.name) == [], list(folder.iterdir()))
    changed = bytearray(data)
    changed[len(data) // 2] ^= 1
    bad.write_bytes(changed)
    r = tool("svo-dump", "--validate", "--json", svo, bad)
    check(r.code == 3 and [v["valid"] for v in r.json] == [True, False], r)
    m = r.json[1]["messages"][0]
    check(m["id"].startswith(("CON-", "SVO-")) and m["id"] in m["message"] and m["offset"] > 0, m)
    r = tool("svo-dump", bad, svo)
    check(r.code == 3 and str(svo) in r.text, r)


def test_exit_codes(folder):
    svo = make(folder, 4)
    ply = folder / "x.ply"
    check(tool("svo-dump").code == 1)
    check(tool("svo-dump", svo, "--nonsense").code == 1)
    check(tool("svo-dump", svo, svo, "--voxels", ply).code == 1)
    check(tool("svo-dump", svo, "--voxels", ply, "--validate").code == 1)
    check(tool("svo-dump", folder / "none.svo").code == 2)
    check(tool("svo-dump", folder).code == 2)
    check(tool("svo-dump", svo, "--voxels", folder / "none" / "x.ply").code == 2)
    ply.write_bytes(b"old")
    check(tool("svo-dump", svo, "--voxels", ply).code == 2 and ply.read_bytes() == b"old")
    check(tool("svo-dump", svo, "--voxels", ply, "--force").code == 0 and ply.read_bytes() != b"old")
    check(tool("svo-dump", folder / "cube.obj").code == 3)
    check(tool("svo-dump", svo, "--memory", "1K").code in (1, 4))
    r = tool("svo-dump", svo, "--voxels", ply, "--force", "--limit", 10)
    check(r.code == 6 and "--limit" in r.err and len(ply.read_bytes()) > 100, r)
    if os.path.exists("/dev/full"):
        check(tool("svo-dump", svo, "--voxels", "/dev/full").code == 2)
        with open("/dev/full", "wb") as full:
            p = subprocess.run([str(support.tools / "svo-dump"), str(svo), "--json"], stdout=full, stderr=subprocess.PIPE)
        check(p.returncode == 2, p)


def test_scene(folder):
    if not support.have("svo-pack"):
        support.skip("svo-pack is not built")
    dag = compress(make(folder, 4))
    scene = {"assets": [{"name": "a", "file": dag.name}],
             "instances": [{"asset": "a", "translation": [5, 0, 0]}, {"asset": "a", "scale": [2, 2, 2], "name": "large"}]}
    (folder / "s.json").write_text(json.dumps(scene))
    out = folder / "s.svscene"
    run("svo-pack", folder / "s.json", "-o", out)
    d = run("svo-dump", out, "--json").json
    a = run("svo-dump", dag, "--json").json
    check(sum(s["bytes"] for s in d["sections"]) == d["bytes"] == out.stat().st_size, d["sections"])
    check(d["format"] == "svscene" and d["voxels"] == a["voxels"] and d["instanced_voxels"] == 2 * a["voxels"], d)
    check(len(d["instances"]) == 2 and d["assets"][0]["instances"] == 2, d["assets"])
    run("svo-dump", out, "--voxels", folder / "s.ply")
    v = support.read_ply(folder / "s.ply")
    check(len(v["x"]) == 2 * a["voxels"] and set(v["instance"]) == {0, 1}, len(v["x"]))
    low, high = a["bounds"]["low"], a["bounds"]["high"]
    check(min(v["x"]) > min(low[0] + 5, 2 * low[0]) and max(v["x"]) < max(high[0] + 5, 2 * high[0]), (min(v["x"]), max(v["x"])))
    check(tool("svo-dump", out).code == 0 and tool("svo-dump", "--validate", out).code == 0)


def noisy_glb(path):
    """A cube whose texture has many colours."""
    texture = support.write_png(None, 32, 32, lambda x, y: (x * 37 % 256, y * 59 % 256, (x * y) % 256))
    return support.cube_glb(path, texture=texture)


def test_blocks_sharing_and_costs(folder):
    glb, svo, dag = noisy_glb(folder / "n.glb"), folder / "n.svo", folder / "n.svdag"
    run("svo-voxelize", glb, "-o", svo, "--depth", 6)
    for options in ((), ("--color", "deltaE=3"), ("--lod", "none", "--geometry", "svdag")):
        run("svo-compress", svo, "-o", dag, "-f", *options)
        d = run("svo-dump", dag, "--json").json
        count = d["attribute_count"]
        coded = {a["name"] for a in d["attributes"] if a["encoding"] == "blocks"}
        check("color" in coded and {b["channel"] for b in d["blocks"]} == coded, d["blocks"])
        for name in coded:  # the last superblock is filled up
            values = sum(b["values"] for b in d["blocks"] if b["channel"] == name)
            check(count <= values < count + 1024, (values, count))
            bits = sum(b["values"] * b["bits_per_value"] for b in d["blocks"] if b["channel"] == name)
            check(bits / 8 <= next(a["bytes"] for a in d["attributes"] if a["name"] == name), bits)
        check(len({(b["channel"], b["mode"]) for b in d["blocks"]}) == len(d["blocks"]), "a mode is listed twice")
        costs = [c["bytes"] for c in d["largest_costs"]]
        check(costs == sorted(costs, reverse=True) and sum(costs) < d["bytes"] and all(abs(c["share"] - c["bytes"] / d["bytes"]) < 1e-12 for c in d["largest_costs"]), d["largest_costs"])
        for level in d["levels"]:
            if "stored" in level and level["stored"]:
                check(abs(level["sharing"] - level["nodes"] / level["stored"]) < 1e-9 and level["sharing"] >= 1, level)
        tree = [level for level in d["levels"] if "tree_bits" in level]
        check((len(tree) != 0) == ("svdag" not in options), options)
        if tree:  # all of TREE but its padding of 8 bytes, and bits between the nodes of pools
            bits, whole = sum(sum(level["tree_bits"].values()) for level in tree), next(s["payload_bytes"] for s in d["sections"] if s["type"] == "TREE")
            check(all(level["bytes"] == (sum(level["tree_bits"].values()) + 7) // 8 for level in tree), tree)
            check(whole * 0.9 < bits / 8 + 8 <= whole, (bits, whole))
        text = run("svo-dump", dag).out.decode()
        check("largest costs" in text and "blocks" in text, text)


def test_held_against_its_source(folder):
    glb, svo, dag = noisy_glb(folder / "n.glb"), folder / "n.svo", folder / "n.svdag"
    run("svo-voxelize", glb, "-o", svo, "--depth", 6)
    for color, normal, lod in (("lossless", "lossless", "all"), ("deltaE=2", "deg=3", "all"), ("deltaE=0.5", "lossless", "none"), ("6", "12", "all")):
        run("svo-compress", svo, "-o", dag, "-f", "--color", color, "--normal", normal, "--lod", lod)
        v = run("svo-dump", dag, "--validate", "--json", "--source", svo).json
        check(v["valid"] and v["source"]["same_voxels"], v)
        for c in v["source"]["channels"]:
            bound = {"color": color, "normal": normal}[c["name"]]
            bound = 0 if bound == "lossless" else float(bound.split("=")[1]) if "=" in bound else None
            check(c["bound"] == bound and c["holds"] and (bound is None or c["max"] <= bound * 1.000001 + 1e-6), c)
            check(color == "lossless" or c["name"] != "color" or c["max"] > 0, c)

    def refused(what, *args):
        r = tool("svo-dump", dag, "--validate", "--source", *args)
        check(r.code == 3 and what in r.err, r)

    glb2 = support.cube_glb(folder / "m.glb", texture=support.write_png(None, 32, 32, lambda x, y: (x * 37 % 256, y * 59 % 256, 255 - (x * y) % 256)))
    run("svo-voxelize", glb2, "-o", folder / "m.svo", "--depth", 6)
    run("svo-compress", svo, "-o", dag, "-f", "--color", "deltaE=2")
    refused("more than the 2", folder / "m.svo")  # other colours
    run("svo-voxelize", glb, "-o", folder / "d.svo", "--depth", 5)
    refused("depth", folder / "d.svo")
    run("svo-voxelize", glb, "-o", folder / "t.svo", "--depth", 6, "--surface", "thin", "--attributes", "color,normal,roughness")
    r = tool("svo-dump", dag, "--validate", "--source", folder / "t.svo")
    check(r.code == 3, r)
    run("svo-voxelize", glb, "-o", folder / "g.svo", "--depth", 6, "--attributes", "normal")
    r = tool("svo-dump", dag, "--validate", "--source", folder / "g.svo")
    check(r.code == 3, r)
    check(tool("svo-dump", svo, "--validate", "--source", svo).code == 5)
    check(tool("svo-dump", dag, "--source", svo).code == 1)
    check(tool("svo-dump", dag, dag, "--validate", "--source", svo).code == 1)
    check(tool("svo-dump", dag, "--validate", "--source", folder / "none.svo").code == 2)


support.main(globals())
