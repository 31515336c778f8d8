"""svo-dump on many files and on damaged ones: the schema of its JSON, every violation by its rule, what is left of a file, the table."""

import copy
import json
import os
import struct
import sys

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))
import schema
import support
from support import check, run, tool

SCHEMA = json.loads((support.source / "docs/format/svo-dump.schema.json").read_text())


def files(folder):
    """One of each kind, all small."""
    support.cube_glb(folder / "a.glb", texture=support.write_png(None, 8, 8, lambda x, y: (32 * x, 32 * y, 80)), nodes=[(0, 0, 0), (1.5, 0.3, 2)])
    run("svo-voxelize", folder / "a.glb", "-o", folder / "a.svo", "--depth", 9)
    run("svo-voxelize", folder / "a.glb", "-o", folder / "s.svo", "--depth", 5, "--fill", "solid", "--attributes", "none")
    run("svo-voxelize", folder / "a.glb", "-o", folder / "part.svo", "--depth", 8, "--shard", "1/2")
    run("svo-compress", folder / "a.svo", "-o", folder / "a.svdag")
    run("svo-compress", folder / "s.svo", "-o", folder / "s.svdag", "--geometry", "best")
    (folder / "x.json").write_text(json.dumps({"assets": [{"name": "a", "file": "a.svdag"}, {"name": "s", "file": "s.svdag"}],
                                               "instances": [{"asset": "a", "name": "one"}, {"asset": "s", "translation": [3, 0, 0]}, {"asset": "a", "translation": [0, 4, 0]}]}))
    run("svo-pack", folder / "x.json", "-o", folder / "x.svscene")
    support.sphere_obj(folder / "ball.obj", rings=10)
    run("svo-skeleton", folder / "ball.obj", "-o", folder / "ball.skel", "--omega", "0.2")
    return [folder / n for n in ("a.svo", "s.svo", "part.svo", "a.svdag", "s.svdag", "x.svscene", "ball.skel")]


def chunks(data):
    """(offset of the header, type, id, payload size) of all chunks, from docs/format/container.md."""
    at, out = 64, []
    while True:
        kind, _, _, size = struct.unpack("<4sHHQ", data[at:at + 16])
        out.append((at, kind.decode(), struct.unpack("<Q", data[at + 40:at + 48])[0], size))
        if kind == b"TABL":
            return out
        at += 64 + size + -size % 64


def test_schema(folder):
    for f in files(folder):
        for more in ([], ["--quick"]):
            problems = schema.check(run("svo-dump", f, "--json", *more).json, SCHEMA)
            check(problems == [], (f.name, problems[:5]))
    both = run("svo-dump", folder / "a.svo", folder / "a.svdag", "--json").json
    check(isinstance(both, list) and all(schema.check(v, SCHEMA) == [] for v in both))
    # the validator and the schema refuse what they should
    good = both[0]
    for change in ({"depth": "9"}, {"depth": 22}, {"format": "obj"}, {"voxel_to_world": [1, 2]}, {"content_hash": "x"}, {"nodes": -1}, {"attributes": [{"name": "A"}]},
                   {"levels": [{"level": 0}]}, {"sections": [{"type": "HEAD", "bytes": 1, "odd": 2}]}):
        check(schema.check({**copy.deepcopy(good), **change}, SCHEMA) != [], change)
    for key in ("file", "bytes", "depth", "voxels", "provenance", "values"):
        check(schema.check({k: v for k, v in good.items() if k != key}, SCHEMA) != [], key)


def test_tree_and_histograms(folder):
    """Against the voxels themselves: masks of every node, children counted, values counted."""
    made = files(folder)
    run("svo-voxelize", folder / "a.glb", "-o", folder / "t.svo", "--depth", 1)
    run("svo-voxelize", folder / "a.glb", "-o", folder / "d.svo", "--depth", 5)
    run("svo-compress", folder / "d.svo", "-o", folder / "d.svdag")
    run("svo-compress", folder / "d.svo", "-o", folder / "plain.svdag", "--geometry", "svdag", "--lod", "none")
    for f in ("t.svo", "d.svo", "d.svdag", "plain.svdag", "s.svo", "s.svdag"):
        run("svo-dump", folder / f, "--voxels", folder / "v.ply", "-f", "-q")
        c = support.read_ply(folder / "v.ply")
        voxels = list(zip(c["vx"], c["vy"], c["vz"]))
        j = run("svo-dump", folder / f, "--json", "--tree", 21, "--histogram").json
        check(schema.check(j, SCHEMA) == [], (f, schema.check(j, SCHEMA)[:3]))
        depth, cells = j["depth"], {}
        for level in range(j["depth"] + 1):
            for v in voxels:
                cells.setdefault((level,) + tuple(x >> depth - level for x in v), set()).add(tuple(x >> depth - level - 1 & 1 for x in v) if level < depth else ())
        mask = lambda octants: sum(1 << (o[0] + 2 * o[1] + 4 * o[2]) for o in octants if o)
        listed = {(n["level"],) + tuple(n["cell"]): n for n in j["tree"]}
        full = [n for n in j["tree"] if n["kind"] == "full"]
        inside = lambda key: any(n["level"] < key[0] and all(key[1 + k] >> key[0] - n["level"] == n["cell"][k] for k in range(3)) for n in full)
        check(j["tree_listed_in_full"] == (len(j["tree"]) < 10000))
        if j["tree_listed_in_full"]:
            check(set(listed) == {k for k in cells if not full or not inside(k)}, f)
        for key, n in listed.items():
            check(n["kind"] == "full" or (n["mask"] == mask(cells[key]) and n["children"] == len([o for o in cells[key] if o])), n)
        levels = j["histograms"]["levels"]
        for level in range(depth):
            if full:
                break
            counts = [0] * 8
            for key, octants in cells.items():
                if key[0] == level:
                    counts[len(octants) - 1] += 1
            check(levels[level]["nodes_with_1_to_8_children"] == counts and levels[level]["full_leaves"] == 0 and levels[level]["inner"] == j["levels"][level]["nodes"], (f, level))
        check(sum(l["full_leaves"] for l in levels) >= len(full))
        for channel in j["histograms"]["channels"]:
            bins = {b["value"]: b["voxels"] for b in channel["bins"]}
            check(sum(bins.values()) == j["voxels"], (f, channel))
            if channel["name"] == "normal":
                wanted = {}
                for n in zip(c["nx"], c["ny"], c["nz"]):
                    k = max(range(3), key=lambda i: abs(n[i]))
                    if sorted(map(abs, n))[2] - sorted(map(abs, n))[1] > 1e-4:
                        wanted["-+"[n[k] > 0] + "xyz"[k]] = wanted.get("-+"[n[k] > 0] + "xyz"[k], 0) + 1
                check(all(bins[k] >= v for k, v in wanted.items()), (bins, wanted))
    text = run("svo-dump", folder / "x.svscene", "--tree", 1, "--histogram").text
    check("asset 1" in text and "voxels by normal" in text and text.split("\n")[1].startswith("  = scene of 3 instances of 2 assets"), text[:400])
    check(schema.check(run("svo-dump", folder / "x.svscene", "--json", "--tree", 2, "--histogram").json, SCHEMA) == [])
    for f, start in (("d.svo", "  = octree of depth 5, "), ("d.svdag", "  = octree of depth 5, "), ("ball.skel", "  = skeleton of ")):
        check(run("svo-dump", folder / f).text.split("\n")[1].startswith(start), run("svo-dump", folder / f).text[:200])
    for code, more in ((5, [folder / "ball.skel", "--tree", 1]), (6, [folder / "d.svo", "--histogram", "--limit", 10]), (1, [folder / "d.svo", "--tree", 22]), (1, [folder / "d.svo", "--tree", 1, "--validate"])):
        check(tool("svo-dump", *more).code == code, more)


def test_every_damaged_chunk_is_named(folder):
    for f in files(folder):
        data = bytearray(f.read_bytes())
        check(run("svo-dump", "--validate", "--json", f).json == {"file": str(f), "valid": True, "messages": []})
        payloads = [c for c in chunks(data) if c[3] > 0 and c[1] != "TABL"]
        hit = payloads[::max(1, len(payloads) // 4)][:6]
        for at, kind, _, size in hit:
            data[at + 64 + size // 2] ^= 0x10
        bad = folder / ("bad" + f.suffix)
        bad.write_bytes(data)
        r = tool("svo-dump", "--validate", "--json", bad)
        check(r.code == 3 and not r.json["valid"])
        found = {(m["chunk"], m["offset"]) for m in r.json["messages"] if m["id"] == "CON-07"}
        check(found == {(kind, at) for at, kind, _, _ in hit}, (f.name, found, hit))
        lines = tool("svo-dump", "--validate", bad)
        check(lines.code == 3 and lines.out == b"" and lines.err.count("(CON-07)") == len(hit), (str(lines), hit))


def test_partial(folder):
    for f in files(folder):
        data = bytearray(f.read_bytes())
        all_chunks = chunks(data)
        at, kind, _, size = all_chunks[len(all_chunks) // 2]
        data[at + 8] ^= 1 # a chunk header
        cut = len(data) - 70 # and the end is missing
        bad = folder / ("bad" + f.suffix)
        bad.write_bytes(data[:cut])
        r = tool("svo-dump", "--partial", "--json", bad)
        check(r.code == 3 and schema.check(r.json, SCHEMA) == [], (f.name, schema.check(r.json, SCHEMA)[:4]))
        v = r.json
        places = {(m["id"], m["offset"]) for m in v["damage"]}
        check(("CON-06", at) in places and ("CON-04", cut) in places, (f.name, places, at))
        found = {(c["type"], c["id"], c["offset"]) for c in v["chunks"] if c["intact"]}
        wanted = {(k, i, o) for o, k, i, s in all_chunks if o != at and o + 64 + s <= cut}
        check(found == wanted, (f.name, found ^ wanted))
        check(v["format"] == f.suffix[1:])
        if f.name == "a.svo":
            check(v["depth"] == 9 and [a["name"] for a in v["attributes"]][0] in ("normal", "color"))
        text = tool("svo-dump", "--partial", bad)
        check(text.code == 3 and "CON-06" in text.text and "damage" in text.text)
        check(tool("svo-dump", "--json", bad).out == b"", "without --partial nothing is printed")
    for size in (0, 1, 63, 64, 127, 128, 200):
        bad.write_bytes(data[:size])
        r = tool("svo-dump", "--partial", "--json", bad)
        check(r.code == 3 and schema.check(r.json, SCHEMA) == [] and r.json["damage"], (size, str(r)))
    check(run("svo-dump", "--partial", "--json", folder / "a.svo").json == run("svo-dump", "--json", folder / "a.svo").json)


def test_random_damage(folder):
    """Whatever is damaged is found, named with a rule, and nothing crashes."""
    import random
    random.seed(3)
    for f in files(folder):
        good = f.read_bytes()
        for _ in range(5):
            data = bytearray(good)
            for _ in range(random.choice((1, 3, 20))):
                data[random.randrange(len(data))] ^= 1 << random.randrange(8)
            data = data[:random.choice((len(data), len(data), random.randrange(len(data))))]
            bad = folder / "r.bin"
            bad.write_bytes(data)
            r = tool("svo-dump", "--validate", "--json", bad)
            if bytes(data) == good:
                continue
            check(r.code in (3, 5) and r.json["messages"], r)
            check(all("-" in m["id"] or m["id"] in ("INVALID_DATA", "UNSUPPORTED") for m in r.json["messages"]), r.json["messages"])
            check(tool("svo-dump", "--partial", "--json", bad).code == r.code)


def test_table(folder):
    all_files = files(folder)
    broken = folder / "broken.svo"
    broken.write_bytes(all_files[0].read_bytes()[:-64])
    lines = run("svo-dump", "--table", *all_files).text.rstrip("\n").split("\n")
    check(len(lines) == 1 + len(all_files) and lines[0].split()[:3] == ["format", "depth", "voxels"])
    for line, f in zip(lines[1:], all_files):
        check(line.split()[0] == f.suffix[1:] and line.endswith(str(f)), line)
    voxels = run("svo-dump", "--json", all_files[0]).json["voxels"]
    check(int(lines[1].split()[2]) == voxels)
    r = tool("svo-dump", "--table", "--partial", all_files[0], broken, all_files[3])
    check(r.code == 3 and len(r.text.rstrip("\n").split("\n")) == 4 and "damaged" in r.text, r)
    check(tool("svo-dump", "--table", "--json", broken).code == 1)


support.main(globals())
