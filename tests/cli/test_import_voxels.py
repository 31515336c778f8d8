"""svo-voxelize of .vox, binvox and NRRD files: written here from the formats' descriptions, damaged, and there and back through svo-dump --export."""

import os
import random
import struct
import sys

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))
import support
from support import check, run, tool


def voxels(folder, file, *more):
    """{(x, y, z) of cell centres in the world: colour or None} of what svo-voxelize makes of a file."""
    run("svo-voxelize", file, "-o", folder / "v.svo", "-f", *more)
    check(run("svo-dump", "--validate", folder / "v.svo").code == 0)
    run("svo-dump", folder / "v.svo", "--voxels", folder / "v.ply", "-f", "-q")
    c = support.read_ply(folder / "v.ply")
    colors = list(zip(c["red"], c["green"], c["blue"])) if "red" in c else [None] * len(c["x"])
    return dict(zip(zip(c["x"], c["y"], c["z"]), colors))


def chunk(kind, content, children=b""):
    return kind + struct.pack("<II", len(content), len(children)) + content + children


def vox_file(models, nodes=b"", palette=None):
    body = b""
    for size, rows in models:
        body += chunk(b"SIZE", struct.pack("<III", *size)) + chunk(b"XYZI", struct.pack("<I", len(rows)) + b"".join(bytes(r) for r in rows))
    body += nodes
    if palette:
        body += chunk(b"RGBA", b"".join(bytes(palette.get(i + 1, (0, 0, 0))) + b"\xff" for i in range(256)))
    return b"VOX " + struct.pack("<I", 150) + chunk(b"MAIN", b"", body)


def text(s):
    return struct.pack("<I", len(s)) + s.encode()


def attributes(**pairs):
    return struct.pack("<I", len(pairs)) + b"".join(text(k) + text(v) for k, v in pairs.items())


def transform(number, child, hidden=False, **frame):
    return chunk(b"nTRN", struct.pack("<I", number) + (attributes(_hidden="1") if hidden else attributes()) + struct.pack("<iiii", child, -1, -1, 1) + attributes(**frame))


def group(number, *children):
    return chunk(b"nGRP", struct.pack("<I", number) + attributes() + struct.pack("<I", len(children)) + b"".join(struct.pack("<I", c) for c in children))


def shape(number, model):
    return chunk(b"nSHP", struct.pack("<I", number) + attributes() + struct.pack("<II", 1, model) + attributes())


PALETTE = {1: (255, 0, 0), 2: (0, 255, 0), 7: (10, 20, 30)}


def test_vox(folder):
    rows = [(0, 0, 0, 1), (3, 1, 0, 2), (3, 1, 4, 7)]
    model = ((4, 2, 5), rows)
    (folder / "a.vox").write_bytes(vox_file([model], palette=PALETTE))
    # a model turns about its cell size // 2; +Z up becomes +Y up: (x, y, z) -> (x, z, -y)
    placed = lambda x, y, z, t=(0, 0, 0): (x - 2 + t[0], y - 1 + t[1], z - 2 + t[2])
    ours = lambda p: (p[0] + 0.5, p[2] + 0.5, -p[1] + 0.5)
    check(voxels(folder, folder / "a.vox") == {ours(placed(*r[:3])): PALETTE[r[3]] for r in rows})
    # two of one model by a scene graph, the second turned by (x, y) -> (-y, x), a third hidden
    nodes = (transform(0, 1) + group(1, 2, 4, 6) + transform(2, 3, _t="10 -3 2") + shape(3, 0) + transform(4, 5, _t="-20 0 1", _r=str(1 | 0 << 2 | 1 << 4)) + shape(5, 0)
             + transform(6, 3, hidden=True, _t="90 0 0"))
    (folder / "b.vox").write_bytes(vox_file([model], nodes, PALETTE))
    wanted = {ours(placed(*r[:3], t=(10, -3, 2))): PALETTE[r[3]] for r in rows}
    for x, y, z, c in rows:
        centre = (x + 0.5 - 2, y + 0.5 - 1, z + 0.5 - 2)
        turned = (-centre[1] - 20, centre[0], centre[2] + 1)
        wanted[(turned[0], turned[2], -turned[1] + 1)] = PALETTE[c]
    check(voxels(folder, folder / "b.vox") == wanted, (voxels(folder, folder / "b.vox"), wanted))
    check(set(voxels(folder, folder / "b.vox", "--attributes", "none").values()) == {None})


def test_there_and_back(folder):
    support.cube_glb(folder / "m.glb", texture=support.write_png(None, 8, 8, lambda x, y: (36 * x, 36 * (y // 2), 99)), nodes=[(0, 0, 0), (1.5, 0.7, 2)])
    run("svo-voxelize", folder / "m.glb", "-o", folder / "m.svo", "--depth", 8)
    run("svo-dump", folder / "m.svo", "--voxels", folder / "m.ply", "-q")
    c = support.read_ply(folder / "m.ply")
    cells = dict(zip(zip(c["vx"], c["vy"], c["vz"]), zip(c["red"], c["green"], c["blue"])))
    low = [min(p[k] for p in cells) for k in range(3)]
    world = dict(zip(zip(c["x"], c["y"], c["z"]), zip(c["red"], c["green"], c["blue"])))
    run("svo-dump", folder / "m.svo", "--export", folder / "m.nrrd", "--volume", "rgba", "-q")
    back = voxels(folder, folder / "m.nrrd")
    near = lambda p: tuple(round(v, 9) for v in p)
    check({near(p): q for p, q in back.items()} == {near(p): q for p, q in world.items()}, "through NRRD: other voxels, places or colours")
    run("svo-dump", folder / "m.svo", "--export", folder / "m.vox", "-q", "--report", folder / "r.json")
    back = voxels(folder, folder / "m.vox")
    first = [min(p[k] for p in back) for k in range(3)]
    moved = {tuple(int(p[k] - first[k]) for k in range(3)): q for p, q in back.items()}
    check(set(moved) == {tuple(p[k] - low[k] for k in range(3)) for p in cells}, "through .vox: other voxels")
    if support.report(folder / "r.json")["output"]["export"]["colors"] <= 255:
        check(moved == {tuple(p[k] - low[k] for k in range(3)): q for p, q in cells.items()}, "through .vox: other colours")


def test_binvox(folder):
    dim, inside = (5, 4, 3), {(0, 0, 0), (4, 3, 2), (2, 1, 0), (2, 2, 0), (2, 3, 0), (1, 0, 2)}
    flat = [int((x, y, z) in inside) for x in range(5) for z in range(3) for y in range(4)] # y fastest, then z, then x
    runs, at = b"", 0
    while at < len(flat):
        n = 1
        while at + n < len(flat) and flat[at + n] == flat[at] and n < 255:
            n += 1
        runs += bytes((flat[at], n))
        at += n
    # the header's order is depth, height, width: x, z, y sizes of the index x*w*h + z*w + y
    data = b"#binvox 1\ndim 5 3 4\ntranslate 1 -2 0.5\nscale 10\ndata\n" + runs
    (folder / "a.binvox").write_bytes(data)
    check(set(voxels(folder, folder / "a.binvox")) == {(1 + 2 * (x + 0.5), -2 + 2 * (y + 0.5), 0.5 + 2 * (z + 0.5)) for x, y, z in inside})
    for bad in (data[:-2], data.replace(b"dim 5", b"dim 0"), data.replace(b"dim 5 3 4", b"dim 5 3"), data.replace(b"data\n", b"dat\n"), data[:-1] + b"\x00", data.replace(b"scale 10", b"scale nan")):
        (folder / "b.binvox").write_bytes(bad)
        check(tool("svo-voxelize", folder / "b.binvox", "-o", folder / "x.svo").code == 3 and not (folder / "x.svo").exists(), bad[:60])


def test_nrrd(folder):
    size, values = (4, 3, 2), [((7 * i) % 24) - 6 for i in range(24)]
    place = lambda i: (i % 4, i // 4 % 3, i // 12)
    for name, letter in (("short", "h"), ("float", "f"), ("double", "d"), ("int32", "i"), ("signed char", "b")):
        for endian, mark in (("little", "<"), ("big", ">")):
            head = "NRRD0004\n# c\ntype: %s\ndimension: 3\nsizes: 4 3 2\nspacings: 2 1 0.5\nendian: %s\nencoding: raw\n\n" % (name, endian)
            (folder / "a.nrrd").write_bytes(head.encode() + struct.pack(mark + "24" + letter, *values))
            for more, keep in (([], lambda v: v > 0), (["--threshold", "5"], lambda v: v >= 5), (["--threshold=-100"], lambda v: True)):
                wanted = {tuple(a * s for a, s in zip(place(i), (2, 1, 0.5))) for i, v in enumerate(values) if keep(v)}
                check(set(voxels(folder, folder / "a.nrrd", *more)) == wanted, (name, endian, more))
    check(run("svo-dump", folder / "v.svo", "--json").json["depth"] == 2)
    run("svo-voxelize", folder / "a.nrrd", "-o", folder / "w.svo", "--depth", 5)
    check(run("svo-dump", folder / "w.svo", "--json").json["depth"] == 5)
    check(tool("svo-voxelize", folder / "a.nrrd", "-o", folder / "x.svo", "--depth", 1).code == 1)
    good = (folder / "a.nrrd").read_bytes()
    for code, change in ((3, (b"sizes: 4 3 2", b"sizes: 4 3 3")), (3, (b"type: signed char", b"type: block")), (3, (b"encoding: raw", b"encoding: gzip")), (3, (b"encoding: raw", b"encoding: bzip2")), (5, (b"encoding: raw", b"encoding: zstd")), (3, (b"dimension: 3", b"dimension: 2")),
                         (3, (b"sizes: 4 3 2", b"sizes: 4000000 3 2")), (2, (b"spacings: 2 1 0.5", b"data file: x.raw")), (3, (b"spacings: 2 1 0.5", b"spacings: 2 0 0.5"))):
        (folder / "b.nrrd").write_bytes(good.replace(*change))
        check(tool("svo-voxelize", folder / "b.nrrd", "-o", folder / "x.svo").code == code, change)
    for more in (["--voxel-size", "1"], ["--fill", "solid"], ["--shard", "1/2"]):
        check(tool("svo-voxelize", folder / "a.nrrd", "-o", folder / "x.svo", *more).code == 1)
    check(tool("svo-voxelize", support.cube_obj(folder / "c.obj"), "-o", folder / "x.svo", "--depth", 3, "--threshold", 1).code == 1)
    a, b = run("svo-voxelize", folder / "a.nrrd", "--key").text, run("svo-voxelize", folder / "a.nrrd", "--key", "--threshold", 5).text
    check(len(a.strip()) == 32 and a != b and run("svo-voxelize", folder / "a.nrrd", "--key").text == a)


def test_hostile(folder):
    random.seed(11)
    nodes = transform(0, 1) + group(1, 2, 2, 2) + transform(2, 3, _t="1 2 3") + shape(3, 0)
    seeds = [vox_file([((4, 2, 5), [(0, 0, 0, 1), (3, 1, 4, 2)])], nodes, PALETTE), b"#binvox 1\ndim 4 4 4\ntranslate 0 0 0\nscale 1\ndata\n\x01\x40",
             b"NRRD0004\ntype: uchar\ndimension: 3\nsizes: 2 2 2\nencoding: raw\n\n" + bytes(range(8))]
    loop = vox_file([((1, 1, 1), [(0, 0, 0, 1)])], transform(0, 1) + group(1, 0, 0), PALETTE)
    wide = vox_file([((1, 1, 1), [(0, 0, 0, 1)])], b"".join(transform(2 * i, 2 * i + 1) + group(2 * i + 1, *([2 * i + 2] * 30)) for i in range(20)) + transform(40, 41) + shape(41, 0), PALETTE)
    for bad in (loop, wide):
        (folder / "l.vox").write_bytes(bad)
        r = tool("svo-voxelize", folder / "l.vox", "-o", folder / "x.svo", timeout=60)
        check(r.code in (3, 6) and not (folder / "x.svo").exists(), r)
    for seed in seeds:
        for i in range(60):
            data = bytearray(seed)
            for _ in range(random.choice((1, 2, 8))):
                data[random.randrange(4, len(data))] = random.choice((0, 1, 127, 255, random.randrange(256)))
            (folder / "f").write_bytes(data[:random.choice((len(data), random.randrange(8, len(data))))])
            r = tool("svo-voxelize", folder / "f", "-o", folder / "x.svo", "-f", "--depth", 21, "--memory", "256M", timeout=60)
            check(r.code in (0, 1, 2, 3, 5, 6), r)
            if r.code == 0:
                check(run("svo-dump", "--validate", folder / "x.svo").code == 0)


support.main(globals())
