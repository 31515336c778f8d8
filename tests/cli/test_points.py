"""svo-voxelize of points: PLY without faces and text, against cells in exact arithmetic; out of core; damaged files."""

import math
import os
import random
import struct
import sys
from collections import defaultdict
from fractions import Fraction

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))
import support
from support import check, run, tool

LETTERS = {"char": "b", "uchar": "B", "short": "h", "ushort": "H", "int": "i", "uint": "I", "float": "f", "double": "d"}


def ply(path, columns, rows, form="little", more=""):
    """columns: [(name, type)]"""
    head = "ply\nformat %s 1.0\n%selement vertex %d\n" % ({"little": "binary_little_endian", "big": "binary_big_endian", "ascii": "ascii"}[form], more, len(rows))
    head += "".join("property %s %s\n" % (t, n) for n, t in columns) + "end_header\n"
    if form == "ascii":
        path.write_text(head + "".join(" ".join("%.17g" % v if isinstance(v, float) else str(v) for v in r) + "\n" for r in rows))
    else:
        mark = ("<" if form == "little" else ">") + "".join(LETTERS[t] for _, t in columns)
        path.write_bytes(head.encode() + b"".join(struct.pack(mark, *r) for r in rows))
    return path


def linear(v):
    return v / 12.92 if v <= 0.04045 else ((v + 0.055) / 1.055) ** 2.4


def srgb(v):
    return 255 * (12.92 * v if v <= 0.0031308 else 1.055 * v ** (1 / 2.4) - 0.055)


def cells_of(points, to_world, depth):
    """{cell: indices of its points}, exactly"""
    out = defaultdict(list)
    for i, p in enumerate(points):
        if all(math.isfinite(c) for c in p):
            cell = [(Fraction(p[k]) - Fraction(to_world[4 * k + 3])) / Fraction(to_world[0]) for k in range(3)]
            out[tuple(min(max(math.floor(c), 0), 2 ** depth - 1) for c in cell)].append(i)
    return out


def read(folder, file):
    check(run("svo-dump", "--validate", file).code == 0)
    run("svo-dump", file, "--voxels", folder / "v.ply", "-f", "-q")
    c = support.read_ply(folder / "v.ply")
    return run("svo-dump", file, "--json").json, {at: i for i, at in enumerate(zip(c["vx"], c["vy"], c["vz"]))}, c


def scan(count, seed, spread=1.0, offset=0.0):
    r = random.Random(seed)
    points = [tuple(offset + spread * r.random() ** 2 for _ in range(3)) for _ in range(count)]
    points += [tuple(offset + spread * r.randrange(33) / 32 for _ in range(3)) for _ in range(count)] # many on the boundaries of cells
    return points, [tuple(r.randrange(256) for _ in range(3)) for _ in points], [tuple(r.gauss(0, 1) for _ in range(3)) for _ in points]


def test_exact(folder):
    for number, (spread, offset, more) in enumerate(((1.0, 0.0, ["--depth", 5]), (0.1, 1e3, ["--depth", 7]), (3.7, -1.2, ["--voxel-size", 0.1]), (1e-30, 0.0, ["--depth", 6]), (1e30, 5e29, ["--depth", 6]))):
        points, colors, normals = scan(600, number, spread, offset)
        points[3] = (math.nan, offset, offset)
        points[7] = (offset, math.inf, offset)
        columns = [(n, "double") for n in "xyz"] + [(n, "uchar") for n in ("red", "green", "blue")] + [(n, "float") for n in ("nx", "ny", "nz")] + [("intensity", "ushort")]
        rows = [p + c + n + (i % 1001,) for i, (p, c, n) in enumerate(zip(points, colors, normals))]
        first = None
        for form in ("little", "big", "ascii"):
            run("svo-voxelize", ply(folder / "a.ply", columns, rows, form), "-o", folder / "a.svo", "-f", "--report", folder / "r.json", *more)
            j, at, c = read(folder, folder / "a.svo")
            wanted = cells_of(points, j["voxel_to_world"], j["depth"])
            check(set(at) == set(wanted), (form, spread, len(at), len(wanted)))
            values = sorted((k, c["red"][i], c["green"][i], c["blue"][i], c["nx"][i], c["intensity"][i]) for k, i in at.items())
            check(first is None or form == "ascii" or values == first, "other bytes, another order")
            first = values
            for cell, members in wanted.items():
                i = at[cell]
                for k, name in enumerate(("red", "green", "blue")):
                    mean = srgb(sum(linear(colors[m][k] / 255) for m in members) / len(members))
                    check(abs(c[name][i] - mean) <= 0.52, (name, c[name][i], mean))
                units = [[v / math.hypot(*normals[m]) for v in normals[m]] for m in members]
                n = [sum(u[k] for u in units) for k in range(3)]
                if math.hypot(*n) > 0.02 * len(members):
                    cosine = sum(a * b for a, b in zip(n, (c["nx"][i], c["ny"][i], c["nz"][i]))) / math.hypot(*n)
                    check(cosine > 1 - 1e-6, (n, cosine))
                mean = 255 * sum(rows[m][9] for m in members) / len(members) / 1000
                check(abs(c["intensity"][i] - mean) <= 0.52, (c["intensity"][i], mean))
        r = support.report(folder / "r.json")
        check(r["input"]["points"] == 1200 and r["input"]["points_not_finite"] == 2 and r["output"]["voxels"] == len(wanted), r)
        check(r["output"]["points_per_voxel_max"] == max(len(m) for m in wanted.values()) and any("no number" in w for w in r["warnings"]), r)


def test_on_boundaries(folder):
    """Sizes that are no binary fractions, points that are the nearest doubles to multiples of them and their neighbours."""
    size, points = 0.1, []
    for k in range(200):
        for v in (k * size, math.nextafter(k * size, -1), math.nextafter(k * size, 99), k / 10):
            points.append((max(v, 0.0), 0.05, 0.05))
    run("svo-voxelize", ply(folder / "a.ply", [(n, "double") for n in "xyz"], points), "-o", folder / "a.svo", "--voxel-size", size, "--attributes", "none")
    j, at, _ = read(folder, folder / "a.svo")
    check(set(at) == set(cells_of(points, j["voxel_to_world"], j["depth"])))


def test_text(folder):
    points, colors, normals = scan(50, 3)
    units = [tuple(v / math.hypot(*n) for v in n) for n in normals]
    number = lambda row: " ".join("%.17g" % v for v in row)
    forms = {
        "a.xyz": ("x,y,z,r,g,b", "# a comment\n" + "".join(number(p + c) + "\n" for p, c in zip(points, colors))),
        "b.xyz": ("x,y,z,nx,ny,nz", "".join(number(p + n) + "\r\n" for p, n in zip(points, units))),
        "c.pts": ("x,y,z,i,r,g,b", "%d\n" % len(points) + "".join(number(p + (-500 + i,) + c) + "\n" for i, (p, c) in enumerate(zip(points, colors)))),
        "d.asc": ("x,y,z,i", "X Y Z intensity\n\n" + "".join(number(p + (i / 200,)) + "\n" for i, p in enumerate(points))),
        "e.xyz": ("x,y,z", "// c\n" + ";".join("%.17g" % v for v in points[0]) + "\n" + "".join(", ".join("%.17g" % v for v in p) + "\n" for p in points[1:-1]) + number(points[-1])),
        "f.xyzrgb": ("x,y,z,r,g,b", "".join(number(p + tuple(v / 255 for v in c)) + "\n" for p, c in zip(points, colors))),
        "g.pts": ("x,y,z,i,r,g,b,nx,ny,nz", "".join(number(p + (7,) + c + n) + "\n" for p, c, n in zip(points, colors, units))),
    }
    for name, (columns, text) in forms.items():
        (folder / name).write_bytes(text.encode())
        r = run("svo-voxelize", folder / name, "-o", folder / "t.svo", "-f", "-v", "--depth", 4)
        check("columns are %s\n" % columns in r.err, r)
        j, at, c = read(folder, folder / "t.svo")
        wanted = cells_of(points, j["voxel_to_world"], 4)
        check(set(at) == set(wanted), name)
        check([a["name"] for a in j["attributes"]] == [n for n, key in (("color", "r"), ("normal", "nx"), ("intensity", "i")) if key in columns.split(",")], j["attributes"])
        for cell, members in wanted.items():
            if "r" in columns.split(",") and len(members) == 1:
                check((c["red"][at[cell]], c["green"][at[cell]], c["blue"][at[cell]]) == colors[members[0]], name)
    run("svo-voxelize", folder / "c.pts", "-o", folder / "t.svo", "-f", "--depth", 4, "--columns", "z,-,x,-,y,-,-")
    j, at, _ = read(folder, folder / "t.svo")
    check(j["attributes"] == [] and len(at) > 0)
    check(set(at) == set(cells_of([(p[2], c[0], p[0]) for p, c in zip(points, colors)], j["voxel_to_world"], 4)))


def test_options(folder):
    points, colors, _ = scan(400, 9)
    a = ply(folder / "a.ply", [(n, "float") for n in "xyz"], points[:500])
    b = ply(folder / "b.ply", [(n, "float") for n in "xyz"] + [(n, "uchar") for n in ("red", "green", "blue")], [p + c for p, c in zip(points, colors)][500:])
    run("svo-voxelize", a, b, "-o", folder / "ab.svo", "--depth", 4)
    j, at, c = read(folder, folder / "ab.svo")
    single = [struct.unpack("3f", struct.pack("3f", *p)) for p in points]
    wanted = cells_of(single, j["voxel_to_world"], 4)
    check(set(at) == set(wanted))
    for cell, members in wanted.items(): # those of a file without colours do not count
        members = [m for m in members if m >= 500]
        mean = srgb(sum(linear(colors[m][0] / 255) for m in members) / len(members)) if members else 255
        check(abs(c["red"][at[cell]] - mean) <= 0.52)
    run("svo-voxelize", a, b, "-o", folder / "m.svo", "--depth", 4, "--min-points", 3, "--attributes", "none", "--report", folder / "r.json")
    j, at, c = read(folder, folder / "m.svo")
    check(set(at) == {k for k, m in wanted.items() if len(m) >= 3} and "red" not in c)
    check(support.report(folder / "r.json")["output"]["voxels_below_min_points"] == len(wanted) - len(at))
    # one colour is stored once, order does not matter, nor threads or the order of files
    run("svo-voxelize", ply(folder / "o.ply", [(n, "double") for n in "xyz"] + [(n, "uchar") for n in "rgb"], [p + (10, 20, 30) for p in points]), "-o", folder / "o.svo", "--depth", 4)
    j, _, _ = read(folder, folder / "o.svo")
    check(j["attributes"][0]["constant"] and j["attributes"][0]["value"] == [10, 20, 30], j["attributes"])
    digest = lambda *args: run("svo-dump", "--json", args[-1]).json["content_hash"] if run("svo-voxelize", *args[:-1], "-o", args[-1], "-f", "--depth", 4) else None
    check(digest(b, "--threads", 1, folder / "x.svo") == digest(b, "--threads", 4, folder / "x.svo"))
    check(digest(a, b, folder / "x.svo") == digest(b, a, folder / "x.svo"))
    check(run("svo-voxelize", a, "--key", "--depth", 4).text != run("svo-voxelize", a, "--key", "--depth", 4, "--min-points", 2).text)
    run("svo-voxelize", a, b, "-o", folder / "d.svo", "-MD", "--depth", 4)
    check((folder / "d.svo.d").read_text().count(".ply") == 2)
    # normals of both signs keep their axis
    run("svo-voxelize", ply(folder / "n.ply", [(n, "float") for n in ("x", "y", "z", "nx", "ny", "nz")], [(0, 0, 0, 1, 1, 1), (0, 0, 0, -1, -1, -1), (1, 1, 1, 0, 0, 2)]), "-o", folder / "n.svo", "--depth", 1)
    _, at, c = read(folder, folder / "n.svo")
    check(all(abs(c[n][at[0, 0, 0]] - 3 ** -0.5) < 1e-4 for n in ("nx", "ny", "nz")))
    for more in (["--fill", "solid"], ["--surface", "thin"], ["--shard", "1/2"], ["--dry-run"], ["--attributes", "emissive"], ["--attributes", "color"], ["--columns", "x,y,z"], ["--voxel-size", 1]):
        check(tool("svo-voxelize", a, "-o", folder / "x.svo", "-f", "--depth", 3, *more).code == 1, more)
    mesh = support.cube_obj(folder / "c.obj")
    check(tool("svo-voxelize", a, mesh, "-o", folder / "y.svo", "--depth", 3).code == 1)
    check(tool("svo-voxelize", mesh, "-o", folder / "y.svo", "--depth", 3, "--min-points", 2).code == 1)


def test_out_of_core(folder):
    """More points than fit: the same bytes, within the memory."""
    count, r = 1500000, random.Random(5)
    data = r.randbytes(9 * count)
    head = "ply\nformat binary_little_endian 1.0\nelement vertex %d\n" % count
    head += "".join("property ushort %s\n" % n for n in "xyz") + "".join("property uchar %s\n" % n for n in ("red", "green", "blue")) + "end_header\n"
    (folder / "a.ply").write_bytes(head.encode() + data)
    small = ["--depth", 7]
    run("svo-voxelize", folder / "a.ply", "-o", folder / "a.svo", *small)
    run("svo-voxelize", folder / "a.ply", "-o", folder / "b.svo", "--memory", "140M", "--report", folder / "r.json", *small)
    report = support.report(folder / "r.json")
    check(report["temporary_files"]["runs"] >= 2 and report["peak_rss_bytes"] < (140 + 24) << 20, report)
    check((folder / "a.svo").read_bytes() == (folder / "b.svo").read_bytes())
    cells = set()
    j = run("svo-dump", "--json", folder / "a.svo").json
    for x, y, z in struct.iter_unpack("<HHH3x", data[:9 * 200000]):
        cells.add((x, y, z))
    check(j["voxels"] <= 8 ** 7 and j["voxels"] > len(cells))
    check(tool("svo-voxelize", folder / "a.ply", "-o", folder / "c.svo", "--memory", "16M", *small).code == 6 and not (folder / "c.svo").exists())


def test_hostile(folder):
    points, colors, _ = scan(4, 1)
    columns = [(n, "float") for n in "xyz"] + [(n, "uchar") for n in ("red", "green", "blue")]
    rows = [p + c for p, c in zip(points, colors)]
    good = ply(folder / "a.ply", columns, rows).read_bytes()
    text = ply(folder / "t.ply", columns, rows, "ascii").read_bytes()
    for bad, code in ((good[:-1], 3), (good.replace(b"vertex 8", b"vertex 99999999999"), 3), (good.replace(b"float z", b"float w"), 3), (good.replace(b"vertex 8", b"vertex 18446744073709551615"), 3),
                      (text[:-20], 3), (text.replace(b"vertex 8", b"vertex 9"), 3), (text.replace(b"end_header\n", b"end_header\nx"), 3), (good.replace(b"property uchar red", b"property list uchar uchar red"), 5)):
        (folder / "b.ply").write_bytes(bad)
        r = tool("svo-voxelize", folder / "b.ply", "-o", folder / "x.svo", "--depth", 4)
        check(r.code == code and not (folder / "x.svo").exists(), r)
    for bad, code in ((b"", 3), (b"1 2\n", 3), (b"1 2 3\n1 2\n", 3), (b"1 2 3\n1 2 x\n", 3), (b"hello\n", 3), (b"\x00" * 99, 3), (b"1e999 0 0\n", 0), (b"nan nan nan\n", 0), (b"1 2 3", 0), (b"1e300 0 0\n-1e300 0 0\n", 6)):
        (folder / "b.xyz").write_bytes(bad)
        r = tool("svo-voxelize", folder / "b.xyz", "-o", folder / "x.svo", "--depth", 4, "-f")
        check(r.code == code, (bad, r))
    r = random.Random(7)
    for seed, name in ((good, "f.ply"), (text, "f.ply"), (b"3\n1 2 3 4 5 6\n7,8,9,1,2,3\n# c\n0 0 0 0 0 1\n", "f.xyz")):
        for _ in range(60):
            data = bytearray(seed)
            for _ in range(r.choice((1, 2, 8))):
                data[r.randrange(len(data))] = r.choice((0, 10, 32, 45, 57, 255, r.randrange(256)))
            (folder / name).write_bytes(data[:r.choice((len(data), r.randrange(len(data))))])
            result = tool("svo-voxelize", folder / name, "-o", folder / "x.svo", "-f", "--depth", 21, "--memory", "256M", timeout=60)
            check(result.code in (0, 1, 3, 5, 6), result)
            if result.code == 0:
                check(run("svo-dump", "--validate", folder / "x.svo").code == 0)


support.main(globals())
