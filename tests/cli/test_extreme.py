"""Extreme meshes by name, through OBJ and through glTF, each with its expected result (the table in docs/tools/svo-voxelize.md)."""

import base64
import json
import math
import random
import struct
import subprocess

import support
from support import check, run, tool

SIDES = [q for _, q in support.CUBE_SIDES]
CUBE = [tuple(map(float, c)) for c in support.CUBE_CORNERS]
CUBE_TRIANGLES = [t for q in SIDES for t in ((q[0], q[1], q[2]), (q[0], q[2], q[3]))]


def shell(n):
    return n**3 - max(n - 2, 0) ** 3


def obj(path, points, triangles):
    path.write_text("".join("v %s %s %s\n" % tuple(map(repr, p)) for p in points) + "".join("f %d %d %d\n" % tuple(i + 1 for i in t) for t in triangles))
    return path


def gltf(path, points, triangles, nodes=({},), colors=None):
    """Positions as floats, as the format wants them; what needs more goes into the nodes."""
    blob = b"".join(struct.pack("<3f", *p) for p in points)
    views = [(0, len(blob))]
    blob += b"".join(struct.pack("<3I", *t) for t in triangles)
    views.append((views[0][1], len(blob) - views[0][1]))
    finite = [p for p in points if all(map(math.isfinite, p))] or [(0, 0, 0)]
    accessors = [{"bufferView": 0, "componentType": 5126, "count": len(points), "type": "VEC3", "min": [min(p[i] for p in finite) for i in range(3)],
                  "max": [max(p[i] for p in finite) for i in range(3)]},
                 {"bufferView": 1, "componentType": 5125, "count": 3 * len(triangles), "type": "SCALAR"}]
    attributes = {"POSITION": 0}
    if colors is not None:
        views.append((len(blob), 16 * len(colors)))
        blob += b"".join(struct.pack("<4f", *c, 1) for c in colors)
        accessors.append({"bufferView": 2, "componentType": 5126, "count": len(colors), "type": "VEC4"})
        attributes["COLOR_0"] = 2
    data = {"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": list(range(len(nodes)))}], "nodes": [dict(n, mesh=0) for n in nodes],
            "meshes": [{"primitives": [{"attributes": attributes, "indices": 1}]}], "accessors": accessors,
            "bufferViews": [{"buffer": 0, "byteOffset": a, "byteLength": n} for a, n in views],
            "buffers": [{"byteLength": len(blob), "uri": "data:application/octet-stream;base64," + base64.b64encode(blob).decode()}]}
    path.write_text(json.dumps(data))
    return path


class Result:
    pass


def voxels(folder, mesh, depth, *options):
    out, ply, rep = folder / "o.svo", folder / "o.ply", folder / "o.json"
    run_of = run("svo-voxelize", mesh, "-o", out, "--depth", depth, "--force", "--report", rep, *options)
    run("svo-dump", "--validate", out)
    run("svo-dump", out, "--voxels", ply, "--force")
    r = Result()
    r.err, r.report = run_of.err, support.report(rep)
    r.values = support.ply_voxels(ply)
    r.set = set(r.values)
    check(len(r.set) == r.report["output"]["voxels"], r.report["output"])
    return r


def both(folder, points, triangles, depth, *options):
    """The same from both formats; coordinates must be floats."""
    a = voxels(folder, obj(folder / "m.obj", points, triangles), depth, *options)
    b = voxels(folder, gltf(folder / "m.gltf", points, triangles), depth, *options)
    check(a.set == b.set, "OBJ and glTF differ: %d and %d voxels" % (len(a.set), len(b.set)))
    return a


def test_empty_mesh(folder):
    (folder / "e.obj").write_text("# nothing\nv 0 0 0\n")
    (folder / "e.gltf").write_text('{"asset":{"version":"2.0"},"scenes":[{"nodes":[]}],"scene":0}')
    for name in ("e.obj", "e.gltf"):
        r = voxels(folder, folder / name, 5)
        check(r.set == set() and "no triangles" in r.err, r.err)


def test_one_triangle(folder):
    r = both(folder, [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)], [(0, 1, 2)], 4)
    check(r.set == {(x, y, 0) for x in range(16) for y in range(16) if x + y <= 16}, sorted(r.set))


def test_all_vertices_equal(folder):
    r = both(folder, [(0.25, 0.5, 2.0)] * 3, [(0, 1, 2)] * 5, 6)
    check(r.set == {(0, 0, 0)} and r.report["errors"]["triangles_degenerate"] == 5, r.set)


def test_zero_area_triangle(folder):
    r = both(folder, [(0.0, 0.0, 0.0), (0.5, 0.0, 0.0), (1.0, 0.0, 0.0)], [(0, 1, 2)], 5)
    check(r.set == {(x, 0, 0) for x in range(32)} and r.report["errors"]["triangles_degenerate"] == 1, r.set)


def test_needle(folder):
    # an aspect of 1e12: a segment after the snap
    points = [(0.0, 0.0, 0.0), (1.0, 1.0, 1.0), (1.0, 1.0, 1.0 - 1e-12)]
    r = voxels(folder, obj(folder / "n.obj", points, [(0, 1, 2)]), 5)
    check({(i, i, i) for i in range(32)} <= r.set and all(max(v) - min(v) <= 1 for v in r.set), len(r.set))


def test_not_finite(folder):
    points = CUBE + [(math.nan, 0.0, 0.0), (math.inf, 1.0, 1.0), (-math.inf, 0.5, 0.5)]
    triangles = CUBE_TRIANGLES + [(0, 1, 8), (9, 2, 3), (4, 10, 5)]
    r = both(folder, points, triangles, 4)
    check(len(r.set) == shell(16) and r.report["errors"]["triangles_not_finite"] == 3 and "3 triangles with a NaN" in r.err, r.err)
    r = both(folder, points, triangles[-3:], 4)
    check(r.set == set() and "no triangle has finite corners" in r.err, r.err)


def test_denormals(folder):
    # in a cube of edge 1 they are 0; alone they are a cube of their own
    points = CUBE + [(1e-310, 5e-324, 0.0), (1e-40, 0.0, 1e-40), (0.0, 1e-320, 0.0)]
    r = voxels(folder, obj(folder / "d.obj", points, CUBE_TRIANGLES + [(8, 9, 10)]), 4)
    check(len(r.set) == shell(16), len(r.set))
    small = 2.0**-140  # a denormal float
    r = both(folder, [tuple(small * x for x in c) for c in CUBE], CUBE_TRIANGLES, 4)
    check(len(r.set) == shell(16), len(r.set))


def test_extents(folder):
    for scale in (1e-30, 1e30):
        r = both(folder, [tuple(scale * x for x in c) for c in CUBE], CUBE_TRIANGLES, 5)
        check(len(r.set) == shell(32), (scale, len(r.set)))
        check(abs(r.report["output"]["voxel_size"] / scale * 32 - 1) < 1e-6, r.report["output"])
    big = [(0.0, 0.0, 0.0), (1e200, 0.0, 0.0), (0.0, 1e200, 0.0)]
    check(tool("svo-voxelize", obj(folder / "b.obj", big, [(0, 1, 2)]), "-o", folder / "b.svo", "--depth", 4).code == 6, "beyond the range that is kept exact")


def test_offset_1e9_with_detail_1e_3(folder):
    # doubles hold 1e9 to 1e-7; glTF's floats do not, its nodes do
    points = [tuple(1e9 + 1e-3 * x for x in c) for c in CUBE]
    a = voxels(folder, obj(folder / "o.obj", points, CUBE_TRIANGLES), 5)
    b = voxels(folder, gltf(folder / "o.gltf", CUBE, CUBE_TRIANGLES, [{"translation": [1e9] * 3, "scale": [1e-3] * 3}]), 5)
    check(len(a.set) == len(b.set) == shell(32), (len(a.set), len(b.set)))


def test_depths_0_1_21(folder):
    check(both(folder, CUBE, CUBE_TRIANGLES, 0).set == {(0, 0, 0)}, "depth 0 is one voxel")
    check(len(both(folder, CUBE, CUBE_TRIANGLES, 1).set) == 8, "depth 1")
    # far apart and small: some voxels at the ends of a grid of 2^21
    unit = 2.0**-21
    points = [(0.0, 0.0, 0.0), (4 * unit, 0.0, 0.0), (0.0, 4 * unit, 0.0)] + [(1.0 - k * unit, 1.0 - k * unit, 1.0) for k in range(3)]
    r = both(folder, points, [(0, 1, 2), (3, 4, 5)], 21)
    last = 2**21 - 1
    check({(0, 0, 0), (last, last, last), (last - 1, last - 1, last)} <= r.set and len(r.set) < 40, sorted(r.set))
    check(tool("svo-voxelize", folder / "m.obj", "-o", folder / "x.svo", "--depth", 22).code == 1)


def test_full_block_of_depth_12(folder):
    """4096^3 voxels, all there: every geometry holds them in next to nothing, and a file that says more of itself than it holds is refused."""
    write_obj = both(folder, CUBE, CUBE_TRIANGLES, 0)  # leaves m.obj behind
    check(len(write_obj.set) == 1)
    check(tool("svo-voxelize", folder / "m.obj", "-o", folder / "x.svo", "-f", "--depth", 12, "--fill", "solid", "--attributes", "none").code == 0)
    for geometry in ("svdag", "symmetric", "fast", "best"):
        check(tool("svo-compress", folder / "x.svo", "-o", folder / "x.svdag", "-f", "--geometry", geometry).code == 0, geometry)
        d = json.loads(tool("svo-dump", folder / "x.svdag", "--json").out)
        check(d["voxels"] == 4096**3 and d["bytes"] < 10000, (geometry, d["voxels"], d["bytes"]))
        check(tool("svo-dump", folder / "x.svdag", "--validate").code == 0, geometry)


def test_faces_on_grid_planes(folder):
    # a plane belongs to the layer above it, the last one to the last layer
    points = CUBE + [(0.0, 0.0, 0.5), (1.0, 0.0, 0.5), (1.0, 1.0, 0.5), (0.0, 1.0, 0.5)]
    r = both(folder, points, CUBE_TRIANGLES + [(8, 9, 10), (8, 10, 11)], 4)
    check({z for x, y, z in r.set if x == y == 7} == {0, 8, 15}, "one layer each")


def test_100k_coincident_vertices(folder):
    points = [(0.5, 0.5, 0.5)] * 100000 + [(0.0, 0.0, 0.0), (1.0, 1.0, 1.0)]
    triangles = [(i, i + 1, i + 2) for i in range(0, 99998, 3)] + [(100000, 100000, 100001)]
    r = both(folder, points, triangles, 4)
    check((8, 8, 8) in r.set and (0, 0, 0) in r.set and (15, 15, 15) in r.set, "the point, and the segment")
    check(all(max(v) - min(v) <= 1 for v in r.set), len(r.set))


def test_fan_of_100k_triangles(folder):
    n = 100000
    single = lambda x: struct.unpack("<f", struct.pack("<f", x))[0]
    points = [(0.0, 0.0, 0.0)] + [(single(math.cos(2 * math.pi * i / n)), single(math.sin(2 * math.pi * i / n)), 0.0) for i in range(n)]
    r = both(folder, points, [(0, 1 + i, 1 + (i + 1) % n) for i in range(n)], 6)
    check(0.7853 * 64 * 64 < len(r.set) < 0.7854 * 67 * 67, len(r.set))
    check(all(v["nz"] > 0.9999 for v in r.values.values()), "all normals look up")


def test_flipped_and_mirrored(folder):
    points = [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.5, 0.25), (0.0, 0.0, 1.0)]
    faces = [(0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)]
    r = both(folder, points, faces, 5)
    flipped = both(folder, points, [f[::-1] for f in faces], 5)
    check(flipped.set == r.set, "the winding decides no voxel")
    mirrored = voxels(folder, gltf(folder / "s.gltf", points, faces, [{"scale": [-1, 1, 1]}]), 5)
    by_hand = voxels(folder, obj(folder / "s.obj", [(-x, y, z) for x, y, z in points], [f[::-1] for f in faces]), 5)
    check(mirrored.set == by_hand.set, "negative scale")
    for v in r.set & by_hand.set:
        check(all(abs(mirrored.values[v][k] - by_hand.values[v][k]) < 2e-3 for k in ("nx", "ny", "nz")), "normals of a mirrored node keep looking out")
    zero = voxels(folder, gltf(folder / "z.gltf", CUBE, CUBE_TRIANGLES, [{"scale": [1, 1, 0]}]), 4)
    check(zero.set == {(x, y, 0) for x in range(16) for y in range(16)}, "a scale of 0 flattens")


def test_self_intersection_is_a_union(folder):
    random.seed(3)
    points = [tuple(random.randrange(17) / 16 for _ in range(3)) for _ in range(36)] + [(0.0, 0.0, 0.0), (1.0, 1.0, 1.0)]
    triangles, frame = [(3 * i, 3 * i + 1, 3 * i + 2) for i in range(12)], (36, 36, 37)
    whole = both(folder, points, triangles + [frame], 5).set
    parts = set().union(*(voxels(folder, obj(folder / "p.obj", points, [t, frame]), 5, "--attributes", "none").set for t in triangles))
    check(whole == parts, "%d and %d voxels" % (len(whole), len(parts)))


def test_holes_stay_holes(folder):
    whole = both(folder, CUBE, CUBE_TRIANGLES, 5).set
    open_cube = both(folder, CUBE, CUBE_TRIANGLES[:-2], 5).set
    check(open_cube < whole and whole - open_cube == {(x, y, 31) for x in range(1, 31) for y in range(1, 31)}, "the inside of one side is missing")


def test_moebius_strip(folder):
    n, points, triangles = 64, [], []
    for i in range(n):
        a = 2 * math.pi * i / n
        for s in (-1, 1):
            r = 1 + s * 0.3 * math.cos(a / 2)
            points.append(tuple(struct.unpack("<f", struct.pack("<f", x))[0] for x in (r * math.cos(a), r * math.sin(a), s * 0.3 * math.sin(a / 2))))
    for i in range(n):
        a, b = 2 * i, 2 * i + 1
        c, d = (2 * i + 2, 2 * i + 3) if i + 1 < n else (1, 0)
        triangles += [(a, b, d), (a, d, c)]
    r = both(folder, points, triangles, 6)
    check(len(r.set) > 1500, len(r.set))
    check(all(abs(math.hypot(v["nx"], v["ny"], v["nz"]) - 1) < 1e-3 for v in r.values.values()), "normals of length one, also where sides meet")


def test_one_colour_and_very_many(folder):
    one = voxels(folder, gltf(folder / "one.gltf", CUBE, CUBE_TRIANGLES, colors=[(0.5, 0.25, 1.0)] * 8), 5, "--attributes", "color")
    check(len({(v["red"], v["green"], v["blue"]) for v in one.values.values()}) == 1, "one colour")
    grid = 160  # 25,600 vertices, each with a colour of its own
    points = [(x / 64, y / 64, 0.0) for y in range(grid) for x in range(grid)]
    triangles = [t for y in range(grid - 1) for x in range(grid - 1) for i in [y * grid + x] for t in ((i, i + 1, i + grid), (i + 1, i + grid + 1, i + grid))]
    colors = [((0.2 + 0.7 * (x / grid)) ** 2.2, (0.2 + 0.7 * (y / grid)) ** 2.2, (0.2 + 0.7 * ((x * 7 + y * 3) % grid / grid)) ** 2.2) for y in range(grid) for x in range(grid)]
    r = voxels(folder, gltf(folder / "many.gltf", points, triangles, colors=colors), 7, "--attributes", "color")
    distinct = {(v["red"], v["green"], v["blue"]) for v in r.values.values()}
    check(len(r.set) == 128 * 128 and len(distinct) > 0.8 * len(r.set), "%d colours in %d voxels" % (len(distinct), len(r.set)))
    run("svo-compress", folder / "o.svo", "-o", folder / "many.svdag", "--color", "lossless")
    run("svo-compare", folder / "o.svo", folder / "many.svdag")


def test_extremes_as_solids(folder):
    """What has an inside is full, what has none is its surface, whatever stands beside it."""
    solid = ("--fill", "solid")
    full = lambda n: {(x, y, z) for x in range(n) for y in range(n) for z in range(n)}
    check(voxels(folder, obj(folder / "e.obj", [(0.0, 0.0, 0.0)], []), 4, *solid).set == set(), "nothing")
    for points, triangles in (([(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)], [(0, 1, 2)]), ([(0.25, 0.5, 2.0)] * 3, [(0, 1, 2)] * 5),
                              ([(0.0, 0.0, 0.0), (0.5, 0.0, 0.0), (1.0, 0.0, 0.0)], [(0, 1, 2)])):
        check(both(folder, points, triangles, 4, *solid).set == both(folder, points, triangles, 4).set, "a triangle, a point and a segment have no inside")
    for triangles in (CUBE_TRIANGLES, [t[::-1] for t in CUBE_TRIANGLES], CUBE_TRIANGLES + CUBE_TRIANGLES, CUBE_TRIANGLES[:5] + [t[::-1] for t in CUBE_TRIANGLES[5:]]):
        check(both(folder, CUBE, triangles, 4, *solid).set == full(16), "outwards, inside out, twice, and with faces the wrong way")
    for depth, n in ((0, 1), (1, 2), (3, 8)):
        check(both(folder, CUBE, CUBE_TRIANGLES, depth, *solid).set == full(n), depth)
    odd = CUBE + [(math.nan, 0.0, 0.0), (math.inf, 1.0, 1.0), (-math.inf, 0.5, 0.5)]
    check(both(folder, odd, CUBE_TRIANGLES + [(0, 1, 8), (9, 2, 3), (4, 10, 5)], 4, *solid).set == full(16), "triangles that are not finite open nothing")
    for scale in (1e-30, 1e30):
        check(both(folder, [tuple(scale * x for x in c) for c in CUBE], CUBE_TRIANGLES, 4, *solid).set == full(16), scale)
    far = [tuple(1e9 + 1e-3 * x for x in c) for c in CUBE]
    check(voxels(folder, obj(folder / "o.obj", far, CUBE_TRIANGLES), 4, *solid).set == full(16), "far away")
    many = CUBE + [(0.5, 0.5, 0.5)] * 9000
    check(both(folder, many, CUBE_TRIANGLES + [(i, i + 1, i + 2) for i in range(8, 9000, 3)], 4, *solid).set == full(16), "points inside")
    points = [(x / 2, y / 2, z / 2) for x, y, z in CUBE] + [(x / 2 + 0.25, y / 2 + 0.25, z / 2 + 0.25) for x, y, z in CUBE] + [(1.0, 1.0, 1.0)]
    two = CUBE_TRIANGLES + [tuple(i + 8 for i in t) for t in CUBE_TRIANGLES] + [(16, 16, 16)]
    inside = both(folder, points, two, 5, *solid).set
    check({(x, y, z) for x, y, z in full(16)} <= inside and {(x + 8, y + 8, z + 8) for x, y, z in full(16)} <= inside and len(inside) <= 2 * 17**3, "two cubes that cross are a union")
    nodes = [{"scale": [-1, 1, 1]}, {"translation": [0.0, 0.0, 0.0]}]
    r = voxels(folder, gltf(folder / "m.gltf", CUBE, CUBE_TRIANGLES, nodes), 4, *solid)
    check(r.set == {(x, y, z) for x in range(16) for y in range(9) for z in range(9)}, "a mirrored cube beside another, whose upper faces lie on planes of the grid")
    r = both(folder, CUBE, CUBE_TRIANGLES[:-2], 5, *solid)
    check(r.set == full(32), "of a cube without a side all is inside: from there the hole is less than half of the sky")


def test_instances(folder):
    nodes = [{"translation": [3.0 * i, 0, 0], "scale": [s] * 3} for i, s in enumerate((1e-6, 1, 1e6))]
    r = voxels(folder, gltf(folder / "i.gltf", CUBE, CUBE_TRIANGLES, nodes), 5)
    check(len(r.set) >= shell(32), "the large one, and the small ones inside of it")


def test_pipe_that_closes(folder):
    mesh = support.sphere_obj(folder / "ball.obj", rings=100)
    command = [str(support.tools / "svo-voxelize"), str(mesh), "-o", "-", "--depth", "10"]
    p = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    p.stdout.read(100)
    p.stdout.close()
    err = p.stderr.read().decode()
    check(p.wait(timeout=120) == 2 and "stdout" in err, (p.returncode, err))
    check(sorted(x.name for x in folder.iterdir()) == ["ball.obj"], "nothing is left behind")


support.main(globals())
