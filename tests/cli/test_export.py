"""svo-dump --export: each format is read back by a reader that is not ours (written here from the format's public description, or the format's own tools) and
holds the voxels that --voxels writes."""

import json
import math
import os
import re
import shutil
import struct
import subprocess
import sys

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))
import support
from support import check, run, tool


def colour(x, y):
    return (16 * x, 16 * y, 255 - 8 * x - 8 * y)


def make(folder, depth=5):
    """An asymmetric thing: a textured cube and a ball, off the origin; its voxels {(x, y, z): (r, g, b)} and voxel_to_world."""
    support.cube_glb(folder / "a.glb", texture=support.write_png(None, 16, 16, colour), nodes=[(0, 0, 0), (1.3, 2.1, 0.4), (0.2, 1.5, 3)])
    run("svo-voxelize", folder / "a.glb", "-o", folder / "a.svo", "--depth", depth, "-f")
    run("svo-compress", folder / "a.svo", "-o", folder / "a.svdag", "-f")
    run("svo-dump", folder / "a.svo", "--voxels", folder / "a.ply", "-q", "-f")
    voxels = {at: (v["red"], v["green"], v["blue"]) for at, v in support.ply_voxels(folder / "a.ply").items()}
    return voxels, run("svo-dump", folder / "a.svo", "--json").json["voxel_to_world"]


def export(folder, ending, *more, source="a.svdag"):
    out = folder / ("out" + ending)
    run("svo-dump", folder / source, "--export", out, "-q", "-f", "--report", folder / "r.json", *more)
    return out, support.report(folder / "r.json")["output"]["export"]


def place(m, p):
    return tuple(m[4 * r] * p[0] + m[4 * r + 1] * p[1] + m[4 * r + 2] * p[2] + m[4 * r + 3] for r in range(3))


# --- readers ---


def read_vox(data):
    """Voxels of a .vox as MagicaVoxel shows them: {(x, y, z): (r, g, b)}, from its file format's text (version 150 and the scene graph's extension)."""
    check(data[:4] == b"VOX " and struct.unpack("<I", data[4:8])[0] in (150, 200), data[:8])
    models, nodes, palette, at = [], {}, None, 20
    check(data[8:12] == b"MAIN" and struct.unpack("<II", data[12:20]) == (0, len(data) - 20), "MAIN")

    def word():
        nonlocal at
        at += 4
        return struct.unpack("<i", data[at - 4:at])[0]

    def text():
        nonlocal at
        n = word()
        at += n
        return data[at - n:at].decode()

    def attributes():
        return {text(): text() for _ in range(word())}

    while at < len(data):
        kind, (size, children) = data[at:at + 4], struct.unpack("<II", data[at + 4:at + 12])
        at += 12
        end = at + size
        check(children == 0 and end <= len(data), "chunk %s" % kind)
        if kind == b"SIZE":
            models.append([(word(), word(), word())])
            check(all(1 <= n <= 256 for n in models[-1][0]), models[-1])
        elif kind == b"XYZI":
            n = word()
            models[-1].append([tuple(data[at + 4 * i:at + 4 * i + 4]) for i in range(n)])
            at += 4 * n
        elif kind == b"RGBA":
            palette = [tuple(data[at + 4 * i:at + 4 * i + 4]) for i in range(256)]
            at += 1024
        elif kind == b"nTRN":
            number, _ = word(), attributes()
            child, reserved, _, frames = word(), word(), word(), word()
            check(reserved == -1 and frames == 1)
            frame = attributes()
            check("_r" not in frame)
            nodes[number] = ("T", child, [int(v) for v in frame.get("_t", "0 0 0").split()])
        elif kind == b"nGRP":
            number, _ = word(), attributes()
            nodes[number] = ("G", [word() for _ in range(word())])
        elif kind == b"nSHP":
            number, _ = word(), attributes()
            check(word() == 1)
            nodes[number] = ("S", word())
            check(attributes() == {})
        check(at == end, "chunk %s: %d bytes left" % (kind, end - at))
    out = {}

    def show(number, t):
        node = nodes[number]
        if node[0] == "T":
            show(node[1], [a + b for a, b in zip(t, node[2])])
        elif node[0] == "G":
            for child in node[1]:
                show(child, t)
        else:
            size, voxels = models[node[1]]
            for x, y, z, c in voxels:
                check(c >= 1 and all(v < n for v, n in zip((x, y, z), size)))
                where = tuple(v + p - n // 2 for v, p, n in zip((x, y, z), t, size)) # a model turns about and is placed by its cell n // 2
                check(where not in out, "voxel twice")
                out[where] = palette[c - 1][:3]
    show(0, [0, 0, 0])
    return out, models


def read_glb(data):
    magic, version, length, n, kind = struct.unpack("<IIIII", data[:20])
    check((magic, version, length, kind) == (0x46546C67, 2, len(data), 0x4E4F534A))
    g = json.loads(data[20:20 + n])
    m, kind = struct.unpack("<II", data[20 + n:28 + n])
    check(kind == 0x004E4942 and 28 + n + m == len(data))
    blob = data[28 + n:]

    def accessor(i):
        a = g["accessors"][i]
        letter, width = {5123: "H", 5125: "I", 5126: "f"}[a["componentType"]], {"SCALAR": 1, "VEC3": 3, "VEC4": 4}[a["type"]]
        begin = g["bufferViews"][a["bufferView"]].get("byteOffset", 0) + a.get("byteOffset", 0)
        return list(struct.iter_unpack("<%d%s" % (width, letter), blob[begin:begin + a["count"] * width * struct.calcsize(letter)]))
    return g, accessor


def unit_faces(voxels):
    """{(axis, up, slice, u, v): colour} of all faces between a voxel and none."""
    out = {}
    for at, c in voxels.items():
        for axis in range(3):
            for up in (0, 1):
                beside = list(at)
                beside[axis] += 1 if up else -1
                if tuple(beside) not in voxels:
                    out[axis, up, at[axis] + up, at[(axis + 1) % 3], at[(axis + 2) % 3]] = c
    return out


def quads_to_faces(quads):
    """Quads of (corner, colour)... with whole corners to the same dictionary; each unit square once."""
    out = {}
    for corners, c in quads:
        axis = [k for k in range(3) if len({p[k] for p in corners}) == 1]
        check(len(axis) == 1, corners)
        axis, u, v = axis[0], (axis[0] + 1) % 3, (axis[0] + 2) % 3
        a, b = [corners[1][k] - corners[0][k] for k in range(3)], [corners[2][k] - corners[1][k] for k in range(3)]
        turn = a[u] * b[v] - a[v] * b[u] # the sign of the winding
        check(turn != 0)
        for i in range(min(p[u] for p in corners), max(p[u] for p in corners)):
            for j in range(min(p[v] for p in corners), max(p[v] for p in corners)):
                key = (axis, int(turn > 0), corners[0][axis], i, j)
                check(key not in out, "face twice")
                out[key] = c
    return out


# --- tests ---


def test_vox(folder):
    voxels, _ = make(folder)
    out, report = export(folder, ".vox")
    shown, models = read_vox(out.read_bytes())
    check(len(shown) == len(voxels) == report["voxels"])
    # +Z up and right-handed: (x, y, z) -> (x, -z, y), moved as a whole
    turned = {(x, -z, y): c for (x, y, z), c in voxels.items()}
    shift = [min(p[k] for p in shown) - min(p[k] for p in turned) for k in range(3)]
    check(set(shown) == {tuple(a + b for a, b in zip(p, shift)) for p in turned}, "the voxels are others")
    check(min(p[2] for p in shown) == 0 and abs(min(p[0] for p in shown) + max(p[0] for p in shown) + 1) <= 1, "not centred over the origin")
    check(report["colors"] == len(set(voxels.values())))
    if report["colors"] <= 255:
        check(report["delta_e_max"] == 0 and all(shown[tuple(a + b for a, b in zip(p, shift))] == c for p, c in turned.items()), "colours changed")
    else:
        worst = max(max(abs(a - b) for a, b in zip(shown[tuple(a + b for a, b in zip(p, shift))], c)) for p, c in turned.items())
        check(0 < report["delta_e_mean"] <= report["delta_e_max"] < 20 and worst < 80, report)


def test_vox_beyond_256(folder):
    support.sphere_obj(folder / "b.obj")
    run("svo-voxelize", folder / "b.obj", "-o", folder / "b.svo", "--depth", 9, "--attributes", "none")
    out, report = export(folder, ".vox", source="b.svo")
    shown, models = read_vox(out.read_bytes())
    check(report["models"] == len(models) > 4 and len(shown) == report["voxels"] == run("svo-dump", folder / "b.svo", "--json").json["voxels"])
    check(max(p[0] for p in shown) - min(p[0] for p in shown) == max(p[2] for p in shown) - min(p[2] for p in shown), "the pieces do not fit")
    few, report = export(folder, ".vox", "--level", 3, source="b.svo")
    check(len(read_vox(few.read_bytes())[0]) == run("svo-dump", folder / "b.svo", "--json").json["levels"][3]["nodes"])


def test_glb(folder):
    voxels, matrix = make(folder)
    out, report = export(folder, ".glb")
    g, accessor = read_glb(out.read_bytes())
    primitive = g["meshes"][0]["primitives"][0]
    position, normal, color = (accessor(primitive["attributes"][n]) for n in ("POSITION", "NORMAL", "COLOR_0"))
    index = [i for i, in accessor(primitive["indices"])]
    check(len(index) == 6 * report["faces"] and report["faces"] <= len(unit_faces(voxels)))
    # read from the triangles, with their winding; the two of a quad share its diagonal
    quads = []
    to_srgb = lambda v: round(255 * (v * 12.92 if v <= 0.0031308 else 1.055 * v ** (1 / 2.4) - 0.055))
    for i in range(0, len(index), 6):
        a, b, c, d, e, f = index[i:i + 6]
        check(a == d and c == e)
        corners = [tuple(int(x) for x in position[k]) for k in (a, b, c, f)]
        check(all(float(int(x)) == x for k in (a, b, c, f) for x in position[k]))
        check(len({normal[k] for k in (a, b, c, f)}) == 1 and len({color[k] for k in (a, b, c, f)}) == 1)
        edges = [[corners[1][k] - corners[0][k] for k in range(3)], [corners[2][k] - corners[1][k] for k in range(3)]]
        cross = [edges[0][1] * edges[1][2] - edges[0][2] * edges[1][1], edges[0][2] * edges[1][0] - edges[0][0] * edges[1][2], edges[0][0] * edges[1][1] - edges[0][1] * edges[1][0]]
        check(sum(x * y for x, y in zip(cross, normal[a])) > 0, "a normal against the winding")
        quads.append((corners, tuple(to_srgb(v / 65535) for v in color[a][:3])))
    check(quads_to_faces(quads) == unit_faces(voxels), "the faces are others")
    m = g["nodes"][0]["matrix"]
    check(all(abs(m[4 * (i % 4) + i // 4] - matrix[i]) < 1e-15 for i in range(12)), "another place")
    low = [min(p[k] for p in position) for k in range(3)]
    check(g["accessors"][primitive["attributes"]["POSITION"]]["min"] == low)


def validator():
    """Khronos' own, where npm package gltf-validator is in the folder SVOKIT_GLTF_VALIDATOR; else None."""
    base = os.environ.get("SVOKIT_GLTF_VALIDATOR", "")
    return base if base and os.path.isdir(os.path.join(base, "node_modules", "gltf-validator")) and shutil.which("node") else None


def issues_of(path):
    code = ("require('gltf-validator').validateBytes(new Uint8Array(require('fs').readFileSync(process.argv[1])))"
            ".then(r => console.log(JSON.stringify(r.issues)))")
    r = subprocess.run(["node", "-e", code, str(path)], cwd=validator(), stdout=subprocess.PIPE, stderr=subprocess.PIPE, timeout=120)
    return json.loads(r.stdout)


def test_glb_passes_the_validator(folder):
    if validator() is None:
        support.skip("NO VALIDATOR: npm install gltf-validator, and name the folder in SVOKIT_GLTF_VALIDATOR")
    make(folder)
    make_scene(folder)
    scene = json.loads((folder / "s.json").read_text())
    scene["instances"][0]["pose"] = {"twist": {"degrees": 200}, "bend": {"axis": "y", "towards": "x", "degrees": 60}}
    (folder / "p.json").write_text(json.dumps(scene))
    run("svo-pack", folder / "p.json", "-o", folder / "p.svscene", "-f")
    for more in ([], ["--draco", 0], ["--level", 3]):
        for source in ("a.svdag", "s.svscene", "p.svscene"):
            issues = issues_of(export(folder, ".glb", *more, source=source)[0])
            check(issues["numErrors"] == 0 and issues["numWarnings"] == 0, (more, source, issues))


def triangles(position, index):
    """Rounded corners, each triangle begun with its smallest."""
    out = []
    for i in range(0, len(index), 3):
        c = [tuple(round(x) for x in position[k]) for k in index[i:i + 3]]
        first = c.index(min(c))
        out.append(tuple(c[first:] + c[:first]))
    return sorted(out)


def test_draco(folder):
    """Read by Draco's own decoder: the same triangles, within the stated error."""
    make(folder)
    plain, accessor = read_glb(export(folder, ".glb")[0].read_bytes())
    p = plain["meshes"][0]["primitives"][0]
    wanted = triangles(accessor(p["attributes"]["POSITION"]), [i for i, in accessor(p["indices"])])
    sizes = []
    for bits in (0, 7, 16):
        out, report = export(folder, ".glb", "--draco", bits)
        sizes.append(len(out.read_bytes()))
        check(report["draco_error_voxels"] <= (0.125 if bits == 0 else 32 / (2 ** bits - 1) / 2 + 1e-5) and report["draco_error_normal_degrees"] < 0.5, report)
        check(bits == 0 or report["draco_bits"] == bits)
        data = out.read_bytes()
        length = struct.unpack("<I", data[12:16])[0]
        g = json.loads(data[20:20 + length])
        check(g["extensionsRequired"] == g["extensionsUsed"] == ["KHR_draco_mesh_compression"])
        p = g["meshes"][0]["primitives"][0]
        packed = p["extensions"]["KHR_draco_mesh_compression"]
        check(set(packed["attributes"]) == set(p["attributes"]) == {"POSITION", "NORMAL", "COLOR_0"} and g["accessors"][p["indices"]]["count"] == 3 * len(wanted))
        view = g["bufferViews"][packed["bufferView"]]
        at = 20 + length + 8 + view["byteOffset"]
        (folder / "m.drc").write_bytes(data[at:at + view["byteLength"]])
        # what other readers of glTF see: ours takes the extension through Draco too
        run("svo-voxelize", out, "-o", folder / "again.svo", "-f", "--depth", 5)
        if shutil.which("draco_decoder") is None:
            continue
        subprocess.run(["draco_decoder", "-i", str(folder / "m.drc"), "-o", str(folder / "m.obj")], check=True, stdout=subprocess.DEVNULL, timeout=60)
        rows = [line.split() for line in (folder / "m.obj").read_text().split("\n")]
        position = [tuple(float(v) for v in r[1:4]) for r in rows if r and r[0] == "v"]
        index = [int(c.split("/")[0]) - 1 for r in rows if r and r[0] == "f" for c in r[1:4]]
        check(triangles(position, index) == wanted, "other triangles")
        worst = max(abs(x - round(x)) for q in position for x in q)
        check(worst <= report["draco_error_voxels"] + 2e-6, (worst, report))
        bounds = g["accessors"][p["attributes"]["POSITION"]]
        check(all(abs(min(q[k] for q in position) - bounds["min"][k]) < 2e-6 and abs(max(q[k] for q in position) - bounds["max"][k]) < 2e-6 for k in range(3)))
    check(max(sizes) < 0.2 * len(export(folder, ".glb")[0].read_bytes()), sizes)
    check(tool("svo-dump", folder / "a.svdag", "--export", folder / "x.glb", "--draco", 3).code == 1 and not (folder / "x.glb").exists())
    check(tool("svo-dump", folder / "a.svdag", "--export", folder / "x.ply", "--draco", 9).code == 1)


def make_scene(folder):
    """Two assets, one of them twice; {asset: its voxels}, {asset: voxel_to_world}, the scene's instances."""
    make(folder, depth=4)
    support.sphere_obj(folder / "b.obj", rings=8)
    run("svo-voxelize", folder / "b.obj", "-o", folder / "b.svo", "-f", "--depth", 3, "--attributes", "none")
    run("svo-compress", folder / "b.svo", "-o", folder / "b.svdag", "-f")
    half = 0.5 ** 0.5
    instances = [{"asset": "cubes", "name": "left one", "id": 7, "translation": [1, 2, 3]},
                 {"asset": "cubes", "name": "turned", "translation": [-5, 0, 1e4], "rotation": [0, half, 0, half], "scale": [2, 2, 2]},
                 {"asset": "ball", "id": 9000000000, "scale": [1, 3, -1]}]
    (folder / "s.json").write_text(json.dumps({"assets": [{"name": "cubes", "file": "a.svdag"}, {"name": "ball", "file": "b.svdag"}], "instances": instances}))
    run("svo-pack", folder / "s.json", "-o", folder / "s.svscene", "-f")
    voxels, matrix = {}, {}
    for name, file in (("cubes", "a.svdag"), ("ball", "b.svdag")):
        run("svo-dump", folder / file, "--voxels", folder / "v.ply", "-q", "-f")
        voxels[name] = {at: (v.get("red", 203), v.get("green", 203), v.get("blue", 203)) for at, v in support.ply_voxels(folder / "v.ply").items()}
        matrix[name] = run("svo-dump", folder / file, "--json").json["voxel_to_world"]
    return voxels, matrix, instances


def instance_place(i, p):
    """Scale, rotation, translation of a scene's instance."""
    p = [a * b for a, b in zip(p, i.get("scale", (1, 1, 1)))]
    x, y, z, w = i.get("rotation", (0, 0, 0, 1))
    t = [2 * (y * p[2] - z * p[1]), 2 * (z * p[0] - x * p[2]), 2 * (x * p[1] - y * p[0])]
    p = [p[0] + w * t[0] + y * t[2] - z * t[1], p[1] + w * t[1] + z * t[0] - x * t[2], p[2] + w * t[2] + x * t[1] - y * t[0]]
    return [a + b for a, b in zip(p, i.get("translation", (0, 0, 0)))]


def test_scene_glb(folder):
    """Each asset's mesh once, each instance a node with its name, number and place."""
    voxels, matrix, instances = make_scene(folder)
    out, report = export(folder, ".glb", source="s.svscene")
    g, accessor = read_glb(out.read_bytes())
    check(len(g["meshes"]) == 2 and {m["name"] for m in g["meshes"]} == {"cubes", "ball"} and report["nodes"] == report["instances"] == len(g["nodes"]) == 3)
    check(sorted(n.get("name", "") for n in g["nodes"]) == ["", "left one", "turned"] and g["scenes"][0]["nodes"] == [0, 1, 2])
    left = list(instances)
    for node in g["nodes"]:
        mesh = g["meshes"][node["mesh"]]
        i = next(i for i in left if i["asset"] == mesh["name"] and i.get("name", "") == node.get("name", ""))
        left.remove(i)
        check("id" not in i or node["extras"]["id"] == i["id"], node)
        p = mesh["primitives"][0]
        position, index = accessor(p["attributes"]["POSITION"]), [k for k, in accessor(p["indices"])]
        quads = [([tuple(int(x) for x in position[k]) for k in (index[t], index[t + 1], index[t + 2], index[t + 5])], 0) for t in range(0, len(index), 6)]
        check(set(quads_to_faces(quads)) == set(unit_faces(voxels[mesh["name"]])))
        m = node["matrix"]
        for at in ((0, 0, 0), (5, 0, 0), (0, 7, 0), (3, 1, 11)):
            ours = [m[r] * at[0] + m[4 + r] * at[1] + m[8 + r] * at[2] + m[12 + r] for r in range(3)]
            wanted = instance_place(i, place(matrix[mesh["name"]], at))
            check(all(abs(a - b) < 2e-6 * max(1, abs(b)) for a, b in zip(ours, wanted)), (node, ours, wanted))
    level, report = export(folder, ".glb", "--level", 2, source="s.svscene")
    counts = [run("svo-dump", folder / f, "--json").json["levels"][2]["nodes"] for f in ("a.svdag", "b.svdag")]
    check(report["voxels"] == sum(counts), report)


def rotate(q, v):
    u, w = q[:3], q[3]
    cross = lambda a, b: [a[(k + 1) % 3] * b[(k + 2) % 3] - a[(k + 2) % 3] * b[(k + 1) % 3] for k in range(3)]
    t = [2 * x for x in cross(u, v)]
    return [v[k] + w * t[k] + cross(u, t)[k] for k in range(3)]


def test_scene_glb_instancing(folder):
    """EXT_mesh_gpu_instancing: the places of all instances of an asset are those of the nodes without it; mirrors have a negative scale, sheared ones stay nodes."""
    make_scene(folder)
    turn = lambda i: [0.5, 0.5, 0.5, 0.5] if i % 3 == 0 else [0, 0.6, 0, -0.8] if i % 3 == 1 else [1, 0, 0, 0]
    scene = {"assets": [{"name": "cubes", "file": "a.svdag"}, {"name": "ball", "file": "b.svdag"}],
             "instances": [{"asset": "cubes", "translation": [3 * i, i % 5, 50], "rotation": turn(i), "scale": [1 + i % 2, -1 if i % 4 == 3 else 1, 0.25], "id": i, "name": "n%d" % i} for i in range(40)]
             + [{"asset": "cubes", "matrix": [1, 0.5, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 1, 2, 3, 1], "name": "sheared"}, {"asset": "ball", "name": "one", "id": 77}]}
    (folder / "s.json").write_text(json.dumps(scene))
    run("svo-pack", folder / "s.json", "-o", folder / "i.svscene")
    plain = export(folder, ".glb", source="i.svscene")[0].rename(folder / "plain.glb")
    apart, _ = read_glb(plain.read_bytes())
    wanted = {}
    for n in apart["nodes"]:
        m = n["matrix"]
        wanted.setdefault(apart["meshes"][n["mesh"]]["name"], []).append([[sum(m[4 * k + r] * at[k] for k in range(3)) + m[12 + r] for r in range(3)] for at in ((0, 0, 0), (7, 0, 0), (0, 7, 0), (0, 0, 7))])
    out, report = export(folder, ".glb", "--instancing", source="i.svscene")
    g, accessor = read_glb(out.read_bytes())
    check(g["extensionsUsed"] == g["extensionsRequired"] == ["EXT_mesh_gpu_instancing"] and report["instanced"] == 40 and report["nodes"] == len(g["nodes"]) < 42, report)
    check({n.get("name") for n in g["nodes"]} == {None, "sheared", "one"} and {n["extras"]["id"] for n in g["nodes"] if n.get("name") == "one"} == {77}, g["nodes"])
    found = {}
    for n in g["nodes"]:
        corners = found.setdefault(g["meshes"][n["mesh"]]["name"], [])
        if "matrix" in n:
            m = n["matrix"]
            corners.append([[sum(m[4 * k + r] * at[k] for k in range(3)) + m[12 + r] for r in range(3)] for at in ((0, 0, 0), (7, 0, 0), (0, 7, 0), (0, 0, 7))])
            continue
        a = n["extensions"]["EXT_mesh_gpu_instancing"]["attributes"]
        for t, q, s in zip(accessor(a["TRANSLATION"]), accessor(a["ROTATION"]), accessor(a["SCALE"])):
            check(abs(sum(x * x for x in q) - 1) < 1e-6, q)
            corners.append([[x + y + z for x, y, z in zip(rotate(q, [s[k] * at[k] for k in range(3)]), t, n["translation"])] for at in ((0, 0, 0), (7, 0, 0), (0, 7, 0), (0, 0, 7))])
    for name in wanted:
        check(len(wanted[name]) == len(found[name]), (name, len(found[name])))
        left = list(found[name])
        for corners in wanted[name]:
            distance = lambda other: max(abs(x - y) for p, q in zip(corners, other) for x, y in zip(p, q))
            best = min(left, key=distance)
            check(distance(best) < 2e-5, (name, corners, best))
            left.remove(best)
    # our own importer takes it: the same voxels as from the nodes
    for which in (plain, out):
        shutil.copy(which, folder / "again.glb")
        run("svo-voxelize", folder / "again.glb", "-o", folder / (which.stem + ".again.svo"), "--depth", 8, "-f")
    counts = [run("svo-dump", folder / (w.stem + ".again.svo"), "--json").json["voxels"] for w in (plain, out)]
    check(abs(counts[0] - counts[1]) <= 0.01 * counts[0], counts)
    if validator() is not None:
        check(issues_of(out)["numErrors"] == 0, issues_of(out))
    check(tool("svo-dump", folder / "i.svscene", "--export", folder / "x.ply", "--instancing").code == 1 and tool("svo-dump", folder / "i.svscene", "--instancing").code == 1)


def twisted(p, pivot, low, high, degrees, axis=1):
    """docs/format/svscene.md, twist."""
    u, v = (axis + 1) % 3, (axis + 2) % 3
    q = [a - b for a, b in zip(p, pivot)]
    t = math.radians(degrees) * min(max((p[axis] - low) / (high - low), 0), 1)
    q[u], q[v] = q[u] * math.cos(t) - q[v] * math.sin(t), q[u] * math.sin(t) + q[v] * math.cos(t)
    return [a + b for a, b in zip(q, pivot)]


def edges_are_shared(quads):
    """Every edge of a closed surface belongs to an even number of faces. Corners are tuples."""
    count = {}
    for q in quads:
        for a, b in zip(q, q[1:] + q[:1]):
            count[min(a, b), max(a, b)] = count.get((min(a, b), max(a, b)), 0) + 1
    return all(n % 2 == 0 for n in count.values())


def test_scene_poses(folder):
    """An asset under a pose is a mesh of its own: every corner of every voxel's side where the formulas of the format put it, the right way round."""
    voxels, matrix, instances = make_scene(folder)
    scene = json.loads((folder / "s.json").read_text())
    pivot, low, high = [0.7, 0.2, 0.9], 0.3, 1.7
    twist = {"axis": "y", "degrees": 70, "from": low, "to": high}
    scene["instances"][0]["pose"] = {"twist": twist, "pivot": pivot}
    scene["instances"][1]["pose"] = {"twist": twist, "pivot": pivot}  # the same: one mesh
    scene["instances"].append({"asset": "cubes", "name": "mirror", "pose": {"matrix": [-1.5, 0, 0, 0, 0, 1, 0, 0, 0, 0.5, 1, 0, 0.25, 0, 0, 1]}})
    scene["instances"].append({"asset": "cubes", "name": "as it is"})
    (folder / "p.json").write_text(json.dumps(scene))
    run("svo-pack", folder / "p.json", "-o", folder / "p.svscene", "-f")
    images = {"left one": lambda p: twisted(p, pivot, low, high, 70), "turned": lambda p: twisted(p, pivot, low, high, 70),
              "mirror": lambda p: [0.25 - 1.5 * p[0], p[1] + 0.5 * p[2], p[2]], "as it is": lambda p: p}
    out, report = export(folder, ".glb", source="p.svscene")
    g, accessor = read_glb(out.read_bytes())
    check(report["posed"] == 3 and report["posed_meshes"] == 2 and report["poses_left_out"] == 0 and len(g["meshes"]) == 4 and report["nodes"] == 5, report)
    nodes = {n.get("name", ""): n for n in g["nodes"]}
    check(nodes["left one"]["mesh"] == nodes["turned"]["mesh"] and len({n["mesh"] for n in g["nodes"]}) == 4)
    close = lambda p: tuple(round(x * 1e4) for x in p)
    for name, image in images.items():
        p = g["meshes"][nodes[name]["mesh"]]["primitives"][0]
        position, normal, index = accessor(p["attributes"]["POSITION"]), accessor(p["attributes"]["NORMAL"]), [k for k, in accessor(p["indices"])]
        i = next(i for i in scene["instances"] if i.get("name") == name)
        m = nodes[name]["matrix"]
        place_of = lambda at: [m[r] * at[0] + m[4 + r] * at[1] + m[8 + r] * at[2] + m[12 + r] for r in range(3)]
        if name == "as it is":  # (merged faces; its place is what is looked at)
            wanted = instance_place(i, place(matrix["cubes"], (3, 5, 1)))
            check(all(abs(a - b) < 1e-5 for a, b in zip(place_of((3, 5, 1)), wanted)))
            continue
        found = []
        for t in range(0, len(index), 6):
            corners = [position[k] for k in (index[t], index[t + 1], index[t + 2], index[t + 5])]
            a, b = [x - y for x, y in zip(corners[2], corners[0])], [x - y for x, y in zip(corners[3], corners[1])]
            n = [a[(k + 1) % 3] * b[(k + 2) % 3] - a[(k + 2) % 3] * b[(k + 1) % 3] for k in range(3)]
            length = sum(x * x for x in n) ** 0.5
            check(sum(x * y for x, y in zip(n, normal[index[t]])) > 0.999 * length, "normals are those of the faces")
            found.append((corners, [x / length for x in n]))
        check(edges_are_shared([[tuple(c) for c in q] for q, _ in found]))
        wanted = {}
        for axis, up, slice_, u, v in unit_faces(voxels["cubes"]):
            c = [[0, 0, 0] for _ in range(4)]
            for k, (du, dv) in enumerate(((0, 0), (1, 0), (1, 1), (0, 1))):
                c[k][axis], c[k][(axis + 1) % 3], c[k][(axis + 2) % 3] = slice_, u + du, v + dv
            beyond = [x + (0.5 if k != axis else (0.5 if up else -0.5)) for k, x in enumerate(c[0])]  # outside of the voxel, beside its face
            middle = [sum(x) / 4 for x in zip(*[image(place(matrix["cubes"], p)) for p in c])]
            away = [a - b for a, b in zip(image(place(matrix["cubes"], beyond)), middle)]
            wanted.setdefault(frozenset(close(image(place(matrix["cubes"], p))) for p in c), []).append(away)
        check(len(found) == len(unit_faces(voxels["cubes"])))
        for corners, n in found:
            # (rounding to 1e-4 may go either way)
            key = frozenset(close(c) for c in corners)
            if key not in wanted:
                key = next((w for w in wanted if all(any(max(abs(x - y) for x, y in zip(close(c), d)) <= 1 for d in w) for c in corners)), None)
            check(key is not None, (name, corners))
            check(max(sum(x * y for x, y in zip(n, away)) for away in wanted[key]) > 0, (name, "inside out", corners))
    # the same places in a .ply
    flat, report = export(folder, ".ply", source="p.svscene")
    head, body = flat.read_bytes().split(b"end_header\n", 1)
    vertices = int(re.findall(rb"element vertex (\d+)", head)[0])
    rows = {close(r[:3]) for r in struct.iter_unpack("<dddBBB", body[:27 * vertices])}
    wanted = []
    for i in scene["instances"]:
        if i.get("name") in images and i.get("name") != "as it is":
            for axis, up, slice_, u, v in list(unit_faces(voxels["cubes"]))[::7]:
                p = [0, 0, 0]
                p[axis], p[(axis + 1) % 3], p[(axis + 2) % 3] = slice_, u, v
                wanted.append((i, instance_place(i, images[i["name"]](place(matrix["cubes"], p)))))
    for i, p in wanted:
        slack = [1 if max(map(abs, p)) < 100 else 30] * 3  # (floats of the instance's place)
        check(close(p) in rows or any(all(abs(a - b) <= s for a, b, s in zip(close(p), r, slack)) for r in rows), (i.get("name"), p))
    # not wanted, or too much
    r = run("svo-dump", folder / "p.svscene", "--export", folder / "rest.glb", "--rest", "--report", folder / "r.json")
    plain = support.report(folder / "r.json")["output"]["export"]
    check("3 instances have a pose" in r.err and plain["poses_left_out"] == 3 and plain["posed"] == plain["posed_meshes"] == 0, plain)
    limit = plain["voxels"] + 1
    check(tool("svo-dump", folder / "p.svscene", "--export", folder / "y.glb", "--limit", limit).code == 6 and not (folder / "y.glb").exists())
    check(tool("svo-dump", folder / "a.svdag", "--export", folder / "y.vox", "--rest").code == 1 and tool("svo-dump", folder / "p.svscene", "--rest").code == 1)
    # instances of one asset in one pose are one node
    _, report = export(folder, ".glb", "--instancing", source="p.svscene")
    check(report["instanced"] == 2 and report["nodes"] == 4, report)


def test_scene_ply(folder):
    voxels, matrix, instances = make_scene(folder)
    out, report = export(folder, ".ply", source="s.svscene")
    head, body = out.read_bytes().split(b"end_header\n", 1)
    vertices, faces = (int(n) for n in re.findall(rb"element (?:vertex|face) (\d+)", head))
    rows = list(struct.iter_unpack("<dddBBB", body[:27 * vertices]))
    check(faces == report["faces"] and len(body) == 27 * vertices + 17 * faces)
    # the areas of all faces, and where they are
    area = lambda a, b, c: 0.5 * sum(x * x for x in cross([q - p for p, q in zip(a, b)], [q - p for p, q in zip(a, c)])) ** 0.5
    cross = lambda u, v: (u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0])
    found = sum(area(*(rows[q + k][:3] for k in (0, 1, 2))) + area(*(rows[q + k][:3] for k in (0, 2, 3))) for q in range(0, vertices, 4))
    wanted, corners = 0, []
    for i in instances:
        to = lambda at: instance_place(i, place(matrix[i["asset"]], at))
        for axis, up, slice_, u, v in unit_faces(voxels[i["asset"]]):
            c = [[0, 0, 0] for _ in range(4)]
            for k, (du, dv) in enumerate(((0, 0), (1, 0), (1, 1), (0, 1))):
                c[k][axis], c[k][(axis + 1) % 3], c[k][(axis + 2) % 3] = slice_, u + du, v + dv
            c = [to(p) for p in c]
            wanted += area(c[0], c[1], c[2]) + area(c[0], c[2], c[3])
            corners += c
    check(abs(found - wanted) < 1e-5 * wanted, (found, wanted))
    for k in range(3):
        check(abs(min(r[k] for r in rows) - min(c[k] for c in corners)) < 1e-2 and abs(max(r[k] for r in rows) - max(c[k] for c in corners)) < 1e-2)
    # refused: what takes one octree
    for code, more in ((5, ["--export", folder / "x.vox"]), (5, ["--export", folder / "x.nrrd"]), (1, ["--export", folder / "x.glb", "--low", "0,0,0"])):
        check(tool("svo-dump", folder / "s.svscene", *more).code == code, more)


def test_ply_mesh(folder):
    voxels, matrix = make(folder)
    out, report = export(folder, ".ply")
    data = out.read_bytes()
    head, body = data.split(b"end_header\n", 1)
    vertices, faces = (int(n) for n in re.findall(rb"element (?:vertex|face) (\d+)", head))
    check(re.findall(rb"property (.*)\n", head) == [b"double x", b"double y", b"double z", b"uchar red", b"uchar green", b"uchar blue", b"list uchar uint vertex_indices"])
    rows = list(struct.iter_unpack("<dddBBB", body[:27 * vertices]))
    lists = list(struct.iter_unpack("<BIIII", body[27 * vertices:]))
    check(len(rows) == 4 * report["faces"] and len(lists) == faces == report["faces"] and {q[0] for q in lists} == {4})
    edge, origin = matrix[0], (matrix[3], matrix[7], matrix[11])
    quads = []
    for _, *q in lists:
        corners = [tuple(round((rows[i][k] - origin[k]) / edge) for k in range(3)) for i in q]
        check(all(abs(place(matrix, c)[k] - rows[i][k]) < 1e-9 for c, i in zip(corners, q) for k in range(3)))
        quads.append((corners, rows[q[0]][3:]))
    check(quads_to_faces(quads) == unit_faces(voxels))
    # other programs take it as a mesh, and so do we: its surface lies on the faces
    run("svo-voxelize", out, "-o", folder / "again.svo", "--depth", 5)


def test_assimp(folder):
    """Open Asset Import Library's tool (package assimp-utils) sees the meshes, their faces and their place."""
    if shutil.which("assimp") is None:
        support.skip("NO READER: assimp (package assimp-utils) is missing")
    make_scene(folder)
    for source in ("a.svdag", "s.svscene"):
        seen = []
        for ending in (".glb", ".ply"):
            out, report = export(folder, ending, source=source)
            text = subprocess.run(["assimp", "info", str(out)], stdout=subprocess.PIPE, check=True, timeout=60).stdout.decode()
            meshes, faces = (int(re.search(n + r":\s+(\d+)", text).group(1)) for n in ("Meshes", "Faces"))
            check(meshes == (2 if source == "s.svscene" and ending == ".glb" else 1) and faces == report["faces"] * 2, (source, ending, meshes, faces, report))
            seen.append([[float(v) for v in p.split()] for p in re.findall(r"(?:Minimum|Maximum) point\s+\(([^)]*)\)", text)])
        check(all(abs(a - b) < 1e-3 * max(1, abs(b)) for p, q in zip(*seen) for a, b in zip(p, q)), seen)


def read_nrrd(data):
    head, body = data.split(b"\n\n", 1)
    lines = head.decode().split("\n")
    check(lines[0] == "NRRD0005")
    fields = dict(line.split(": ", 1) for line in lines[1:] if not line.startswith("#"))
    check(fields["type"] == "uint8" and fields["encoding"] == "raw")
    vectors = [tuple(float(x) for x in v.split(",")) for v in re.findall(r"\(([^)]*)\)", fields["space directions"])]
    return [int(n) for n in fields["sizes"].split()], vectors, tuple(float(x) for x in fields["space origin"].strip("()").split(",")), body, fields


def test_dense(folder):
    voxels, matrix = make(folder)
    low = [min(p[k] for p in voxels) for k in range(3)]
    high = [max(p[k] for p in voxels) for k in range(3)]
    out, report = export(folder, ".nrrd")
    sizes, directions, origin, body, _ = read_nrrd(out.read_bytes())
    check(sizes == [b - a + 1 for a, b in zip(low, high)] == report["size"] and len(body) == sizes[0] * sizes[1] * sizes[2])
    found = {(low[0] + i % sizes[0], low[1] + i // sizes[0] % sizes[1], low[2] + i // (sizes[0] * sizes[1])) for i, b in enumerate(body) if b == 255}
    check(found == set(voxels) and set(body) <= {0, 255})
    at = [2, 3, 4]
    sample = [origin[r] + sum(at[k] * directions[k][r] for k in range(3)) for r in range(3)]
    check(all(abs(a - b) < 1e-12 for a, b in zip(sample, place(matrix, [low[k] + at[k] + 0.5 for k in range(3)]))), "samples are not at cell centres")
    # a box, in colour, without a header
    box = ["--low", "3,4,5", "--high", "20,21,9"]
    out, report = export(folder, ".raw", "--volume", "rgba", *box)
    body = out.read_bytes()
    check(report["size"] == [18, 18, 5] and len(body) == 4 * 18 * 18 * 5)
    for i in range(18 * 18 * 5):
        at = (3 + i % 18, 4 + i // 18 % 18, 5 + i // 324)
        wanted = bytes(voxels[at]) + b"\xff" if at in voxels else bytes(4)
        check(body[4 * i:4 * i + 4] == wanted, (at, body[4 * i:4 * i + 4], wanted))
    sizes, _, _, again, fields = read_nrrd(export(folder, ".nrrd", "--volume", "rgba", *box)[0].read_bytes())
    check(sizes == [4, 18, 18, 5] and again == body and fields["kinds"].startswith("RGBA-color"))


def test_vdb(folder):
    voxels, matrix = make(folder)
    r = tool("svo-dump", folder / "a.svdag", "--export", folder / "out.vdb", "-q")
    if r.code == 5:
        support.skip("this build has no OpenVDB: %s" % r.err.strip())
    check(r.code == 0, r)
    again, _ = export(folder, ".vdb", "--threads", 1)
    data = again.read_bytes()
    check(struct.unpack("<q", data[:8])[0] == 0x56444220, "no VDB")
    first = run("svo-dump", folder / "a.svdag", "--export", folder / "second.vdb", "-q")
    check((folder / "second.vdb").read_bytes() == data, "two runs differ")
    if shutil.which("vdb_print") is None:
        support.skip("NO READER: vdb_print of libopenvdb-tools is missing")
    text = subprocess.run(["vdb_print", "-l", str(again)], stdout=subprocess.PIPE, check=True, timeout=60).stdout.decode()
    for name in ("density", "color"):
        part = text.split("Name: " + name)[1]
        active = int(re.search(r"active voxels:\s+([\d,]+)", part).group(1).replace(",", ""))
        check(active == len(voxels), (name, active, len(voxels)))
        box = [[int(v) for v in p.split(",")] for p in re.search(r"Bounding box of active voxels: \[(.*)\] -> \[(.*)\]", part).groups()]
        check(box == [[min(p[k] for p in voxels) for k in range(3)], [max(p[k] for p in voxels) for k in range(3)]], box)
        rows = [[float(v) for v in r.split(",")] for r in re.findall(r"^     \[(.*)\]", part, re.M)[:4]]
        centre = place(matrix, (0.5, 0.5, 0.5))
        check(all(abs(rows[3][k] - centre[k]) < 2e-3 * max(1, abs(centre[k])) for k in range(3)), (rows, centre))


def test_nvdb(folder):
    voxels, _ = make(folder)
    r = tool("svo-dump", folder / "a.svdag", "--export", folder / "out.nvdb", "-q")
    if r.code == 5:
        support.skip("this build has no NanoVDB: %s" % r.err.strip())
    check(r.code == 0, r)
    data = (folder / "out.nvdb").read_bytes()
    run("svo-dump", folder / "a.svdag", "--export", folder / "second.nvdb", "-q")
    check((folder / "second.nvdb").read_bytes() == data, "two runs differ")
    # file header and the first grid's metadata, as nanovdb/util/IO.h describes them
    check(data[:8] == b"NanoVDB0", data[:8])
    grids, codec = struct.unpack("<HH", data[12:16])
    check((grids, codec) == (1, 0))
    grid_size, file_size, _, voxel_count = struct.unpack("<QQQQ", data[16:48])
    check(voxel_count == len(voxels) and grid_size == file_size, (voxel_count, len(voxels)))
    check(b"density\0" in data[:400])
    if shutil.which("nanovdb_validate"):
        subprocess.run(["nanovdb_validate", str(folder / "out.nvdb")], check=True, stdout=subprocess.DEVNULL, timeout=60)


def test_full_leaves_and_limits(folder):
    support.cube_obj(folder / "solid.obj")
    run("svo-voxelize", folder / "solid.obj", "-o", folder / "s.svo", "--depth", 5, "--fill", "solid")
    count = run("svo-dump", folder / "s.svo", "--json").json["voxels"]
    out, report = export(folder, ".glb", source="s.svo")
    check(report["voxels"] == count and report["faces"] == 6, report)
    sizes, _, _, body, _ = read_nrrd(export(folder, ".nrrd", source="s.svo")[0].read_bytes())
    check(set(body) == {255} and len(body) == count)
    for code, more in ((6, ["--export", folder / "x.glb", "--limit", 100]), (1, ["--export", folder / "x.stl"]), (1, ["--export", folder / "x.glb", "--level", 9]),
                       (1, ["--export", folder / "x.glb", "--low", "0.5,0,0"]), (1, ["--level", 2]), (1, ["--export", folder / "x.glb", "--validate"]),
                       (6, ["--export", folder / "x.nrrd", "--memory", "1K"]), (2, ["--export", folder / "out.glb"])):
        r = tool("svo-dump", folder / "s.svo", *more)
        check(r.code == code or (code == 6 and r.code == 4), r)
        check(not (folder / "x.glb").exists() and not (folder / "x.nrrd").exists())


support.main(globals())
