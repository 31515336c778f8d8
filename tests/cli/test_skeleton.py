"""svo-skeleton: files, reports, exit codes, equal bytes for any number of threads, real and damaged models."""

import ctypes
import ctypes.util
import json
import math
import struct

import support
import swc_reader
from support import check, run, tool


def tube_obj(path, length=4.0, radius=0.25, n=60, m=16, extra=""):
    lines = []
    for i in range(n + 1):
        for j in range(m):
            a = 2 * math.pi * j / m
            lines.append("v %.17g %.17g %.17g" % (length * i / n, radius * math.cos(a), radius * math.sin(a)))
    lines += ["v 0 0 0", "v %.17g 0 0" % length]
    for i in range(n):
        for j in range(m):
            a, b = i * m + j + 1, i * m + (j + 1) % m + 1
            lines.append("f %d %d %d %d" % (a, b, b + m, a + m))
    for j in range(m):
        lines.append("f %d %d %d" % ((n + 1) * m + 1, (j + 1) % m + 1, j + 1))
        lines.append("f %d %d %d" % ((n + 1) * m + 2, n * m + j + 1, n * m + (j + 1) % m + 1))
    path.write_text("\n".join(lines) + "\n" + extra)
    return path


def curve(path):
    points, bones = [], []
    for line in path.read_text().split("\n"):
        w = line.split()
        if w[:1] == ["v"]:
            points.append(tuple(map(float, w[1:])))
        elif w[:1] == ["l"]:
            bones.append((int(w[1]) - 1, int(w[2]) - 1))
    return points, bones


def topology(points, bones):
    """components, ends, branches, loops: from the exported curve alone."""
    parent = list(range(len(points)))

    def root(i):
        while parent[i] != i:
            i = parent[i]
        return i

    degree = [0] * len(points)
    for a, b in bones:
        degree[a] += 1
        degree[b] += 1
        parent[root(a)] = root(b)
    components = sum(root(i) == i for i in range(len(points)))
    return components, sum(d == 1 for d in degree), sum(d > 2 for d in degree), len(bones) - len(points) + components


def test_tube(folder):
    tube_obj(folder / "tube.obj")
    r = run("svo-skeleton", folder / "tube.obj", "-o", folder / "t.skel", "--omega", 0.03, "--obj", folder / "t.obj", "--glb", folder / "t.glb",
            "--report", folder / "r.json")
    check(r.out == b"", r)
    report = support.report(folder / "r.json")
    out = report["output"]
    points, bones = curve(folder / "t.obj")
    check((out["components"], out["ends"], out["branches"], out["loops"]) == topology(points, bones) == (1, 2, 0, 0), out)
    check(out["joints"] == len(points) and out["bones"] == len(bones), out)
    check(out["converged"] is True and out["iterations"] > 0 and out["final_movement_max"] <= 1e-3 * 0.03, out)
    check(out["bytes"] == (folder / "t.skel").stat().st_size, out)
    check(0 <= report["errors"]["thinness_percent"] < 1, report["errors"])
    check(report["input"]["mapped"] == report["input"]["elements"] == 61 * 16 + 2, report["input"])
    check(all(math.hypot(p[1], p[2]) < 0.02 for p in points), points)
    check({"clean", "tessellate", "contract"} <= {p["name"] for p in report["phases"]}, report["phases"])


class Glb:
    """A reader of its own: what glTF 2.0 says, nothing of ours."""

    def __init__(self, path):
        data = path.read_bytes()
        magic, version, size, json_size, kind = struct.unpack("<4sIII4s", data[:20])
        check(magic == b"glTF" and version == 2 and size == len(data) and kind == b"JSON", data[:20])
        self.json = json.loads(data[20:20 + json_size])
        bin_size, kind = struct.unpack("<I4s", data[20 + json_size:28 + json_size])
        check(kind == b"BIN\0" and 28 + json_size + bin_size == size, kind)
        self.bytes = data[28 + json_size:]

    def read(self, accessor):
        a = self.json["accessors"][accessor]
        view = self.json["bufferViews"][a["bufferView"]]
        n = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}[a["type"]]
        code = {5123: "H", 5125: "I", 5126: "f"}[a["componentType"]]
        size = n * struct.calcsize(code)
        check(view["byteLength"] == a["count"] * size, (a, view))
        at = view["byteOffset"]
        return [struct.unpack_from("<%d%s" % (n, code), self.bytes, at + i * size) for i in range(a["count"])]


def world_translations(gltf):
    """Of every node; nodes have translations alone."""
    nodes, found = gltf["nodes"], {}

    def walk(i, above):
        here = [a + b for a, b in zip(above, nodes[i].get("translation", (0, 0, 0)))]
        check(i not in found, "node %d has two parents" % i)
        found[i] = here
        for child in nodes[i].get("children", ()):
            walk(child, here)

    for root in gltf["scenes"][0]["nodes"]:
        walk(root, (0, 0, 0))
    return found


def test_skinned_glb_and_swc(folder):
    path = tube_obj(folder / "tube.obj")
    # far away: 32-bit floats must not blur it
    lines = ["v %.17g %s %s" % (float(w[1]) + 1e6, w[2], w[3]) if (w := line.split())[:1] == ["v"] else line for line in path.read_text().splitlines()]
    path.write_text("\n".join(lines) + "\n")
    for influences, sets in ((4, 1), (8, 2)):
        run("svo-skeleton", path, "-o", folder / "t.skel", "--omega", 0.03, "--obj", folder / "t.obj", "--glb", folder / "t.glb", "--swc", folder / "t.swc", "-f",
            "--influences", influences, "--report", folder / "r.json")
        points, bones = curve(folder / "t.obj")
        g = Glb(folder / "t.glb")
        nodes, skin = g.json["nodes"], g.json["skins"][0]
        world = world_translations(g.json)
        check(len(world) == len(nodes) and len(skin["joints"]) == len(points), nodes)
        for joint, node in enumerate(skin["joints"]):
            check(math.dist(world[node], points[joint]) < 1e-6, (joint, world[node], points[joint]))
        middle = nodes[0]["translation"]
        parents = {c: i for i, n in enumerate(nodes) for c in n.get("children", ())}
        number = {node: joint for joint, node in enumerate(skin["joints"])}
        tree = {frozenset((number[c], number[p])) for c, p in parents.items() if p in number}
        check(tree == {frozenset(b) for b in bones}, "the tree of a tube is all its bones")
        bind = g.read(skin["inverseBindMatrices"])
        primitive = g.json["meshes"][0]["primitives"][0]
        attributes = primitive["attributes"]
        check(len(g.read(primitive["indices"])) == 3 * (2 * 60 * 16 + 2 * 16), "triangles")
        joint_sets = [g.read(attributes["JOINTS_%d" % s]) for s in range(sets)]
        weight_sets = [g.read(attributes["WEIGHTS_%d" % s]) for s in range(sets)]
        check("JOINTS_%d" % sets not in attributes, attributes)
        obj = [tuple(float(x) - m for x, m in zip(w[1:], middle)) for w in map(str.split, path.read_text().splitlines()) if w[:1] == ["v"]]
        most = 0
        for v, p in enumerate(g.read(attributes["POSITION"])):
            joints = sum((s[v] for s in joint_sets), ())
            weights = sum((s[v] for s in weight_sets), ())
            check(abs(sum(weights) - 1) <= 1e-6 and min(weights) >= 0, weights)
            most = max(most, sum(w > 0 for w in weights))
            # in the bind pose, the skinned position is the source's: sum of w * (world of joint) * (inverse bind) * p, here below the armature
            q = [sum(w * (world[skin["joints"][j]][k] - middle[k] + bind[j][12 + k] + p[k]) for w, j in zip(weights, joints)) for k in range(3)]
            check(min(math.dist(q, o) for o in obj) < 2e-6, (v, q))  # importers may number vertices as they like
        check(support.report(folder / "r.json")["output"]["skin_influences"] == most <= influences, most)
        swc_reader.check_pair(swc_reader.Swc(folder / "t.swc"), swc_reader.Curve(folder / "t.obj"), 1)


def test_curves_are_read_back(folder):
    """A ring and a tube apart from it: two trees, one bone outside of them; by a strict reader of SWC and of lines in OBJ."""
    tube_obj(folder / "tube.obj", n=30)
    lines, n, m = (folder / "tube.obj").read_text().splitlines(), 60, 12
    base = sum(line.startswith("v") for line in lines)
    for i in range(n):
        for j in range(m):
            u, v = 2 * math.pi * i / n, 2 * math.pi * j / m
            r = 1.5 + 0.25 * math.cos(v)
            lines.append("v %.17g %.17g %.17g" % (r * math.cos(u), 5 + r * math.sin(u), 0.25 * math.sin(v)))
            a, b = base + i * m, base + (i + 1) % n * m
            lines.append("f %d %d %d %d" % (a + j + 1, b + j + 1, b + (j + 1) % m + 1, a + (j + 1) % m + 1))
    (folder / "both.obj").write_text("\n".join(lines) + "\n")
    run("svo-skeleton", folder / "both.obj", "-o", folder / "t.skel", "--omega", 0.03, "--obj", folder / "c.obj", "--swc", folder / "c.swc", "--report", folder / "r.json")
    out = support.report(folder / "r.json")["output"]
    swc = swc_reader.Swc(folder / "c.swc")
    check((out["components"], out["loops"], out["roots"], out["bones_outside_trees"]) == (2, 1, 2, 1), out)
    swc_reader.check_pair(swc, swc_reader.Curve(folder / "c.obj"), 2)
    check(all(0.15 < r < 0.35 for _, _, _, r in swc.points.values()), swc.points)
    # the root is the joint nearest to the middle of a longest path: of the tube, the middle
    (root,) = [n for n in swc.roots if abs(swc.points[n][1]) < 0.5]
    check(abs(swc.points[root][0] - 2) < 0.5, swc.points[root])
    for what, by in (("1 0 ", "0 0 "), ("-1", "9999"), ("\n2 ", "\n3 "), (" 0 ", " x ")):  # the reader does find what is wrong
        (folder / "bad.swc").write_text((folder / "c.swc").read_text().replace(what, by, 1))
        try:
            swc_reader.Swc(folder / "bad.swc")
            check(False, "the reader took " + by)
        except swc_reader.SwcError:
            pass


def test_posed(folder):
    """The tube bent in its middle: what follows joints beyond the bend alone moves as they do, weights change little along an edge, and no edge is torn."""
    tube_obj(folder / "tube.obj")
    steepest = {}
    for smoothing in (0, 8):
        run("svo-skeleton", folder / "tube.obj", "-o", folder / "t.skel", "-f", "--omega", 0.03, "--glb", folder / "t.glb", "--smoothing", smoothing)
        g = Glb(folder / "t.glb")
        primitive = g.json["meshes"][0]["primitives"][0]
        at, world = primitive["attributes"], world_translations(g.json)
        position, joints, weights = (g.read(at[k]) for k in ("POSITION", "JOINTS_0", "WEIGHTS_0"))
        index = [i for i, in g.read(primitive["indices"])]
        middle = g.json["nodes"][0]["translation"]
        place = [[world[node][k] - middle[k] for k in range(3)] for node in g.json["skins"][0]["joints"]]
        bend = min(range(len(place)), key=lambda j: abs(place[j][0]))
        x0 = place[bend][0]
        moved = [p[0] > x0 + 1e-9 for p in place]  # along the tube, joints beyond the bend are its descendants on one side
        c, s = math.cos(math.radians(60)), math.sin(math.radians(60))

        def turned(p):
            x, y = p[0] - x0, p[1] - place[bend][1]
            return [x0 + c * x - s * y, place[bend][1] + s * x + c * y, p[2]]

        posed = []
        for p, j, w in zip(position, joints, weights):
            q = turned(p)
            share = sum(wk for jk, wk in zip(j, w) if moved[jk])
            check(abs(sum(w) - 1) <= 1e-6 and min(w) >= 0, w)
            posed.append([(1 - share) * a + share * b for a, b in zip(p, q)])
        full = [dict() for _ in position]
        for v, (j, w) in enumerate(zip(joints, weights)):
            for jk, wk in zip(j, w):
                full[v][jk] = full[v].get(jk, 0) + wk
        step, stretch = 0, 0
        for t in range(0, len(index), 3):
            for a, b in ((index[t], index[t + 1]), (index[t + 1], index[t + 2]), (index[t + 2], index[t])):
                step = max(step, max(abs(full[a].get(k, 0) - full[b].get(k, 0)) for k in set(full[a]) | set(full[b])))
                stretch = max(stretch, math.dist(posed[a], posed[b]) / math.dist(position[a], position[b]))
        steepest[smoothing] = step
        rigid = [v for v in range(len(position)) if position[v][0] > x0 + 1.5]
        check(len(rigid) > 50 and all(math.dist(posed[v], turned(position[v])) < 1e-6 for v in rigid), "the far end does not move as a whole")
        check(all(math.dist(posed[v], position[v]) < 1e-6 for v in range(len(position)) if position[v][0] < x0 - 1.5), "the near end moves")
        check(stretch < 3, stretch)
    check(steepest[8] <= steepest[0] + 1e-6 and steepest[8] < 0.35, steepest)


def textured_tube(folder):
    """A tube with texture coordinates and a 4x2 picture, as OBJ and MTL; returns the picture's rows."""
    rows = [[(40 * x, 100 * y, 255 - 30 * x) for x in range(4)] for y in range(2)]
    support.write_png(folder / "t.png", 4, 2, lambda x, y: rows[y][x])
    (folder / "tube.mtl").write_text("newmtl skin\nKd 1 0.5 1\nmap_Kd t.png\n")
    n, m, lines = 40, 12, ["mtllib tube.mtl"]
    for i in range(n + 1):
        for j in range(m + 1):
            a = 2 * math.pi * (j % m) / m
            lines.append("v %.17g %.17g %.17g" % (4 * i / n, 0.25 * math.cos(a), 0.25 * math.sin(a)))
            lines.append("vt %.17g %.17g" % (i / n, j / m))
    lines.append("usemtl skin")
    for i in range(n):
        for j in range(m):
            a = i * (m + 1) + j + 1
            lines.append("f " + " ".join("%d/%d" % (k, k) for k in (a, a + 1, a + m + 2, a + m + 1)))
    (folder / "tube.obj").write_text("\n".join(lines) + "\n")
    return rows


def test_textures_and_draco(folder):
    rows = textured_tube(folder)
    for name, more in (("plain", ()), ("draco", ("--draco", 14)), ("eight", ("--draco", 12, "--influences", 8))):
        glb = folder / (name + ".glb")
        run("svo-skeleton", folder / "tube.obj", "-o", folder / "t.skel", "-f", "--omega", 0.05, "--glb", glb, "--report", folder / "r.json", *more)
        g = Glb(glb)
        material = g.json["materials"][0]
        texture = g.json["textures"][material["pbrMetallicRoughness"]["baseColorTexture"]["index"]]
        view = g.json["bufferViews"][g.json["images"][texture["source"]]["bufferView"]]
        (folder / "again.png").write_bytes(g.bytes[view["byteOffset"] : view["byteOffset"] + view["byteLength"]])
        width, height, channels, lines = support.read_png(folder / "again.png")
        found = [[tuple(line[channels * x :][:3]) for x in range(width)] for line in lines]
        check(found == rows, found)
        primitive = g.json["meshes"][0]["primitives"][0]
        check(primitive["material"] == 0 and "TEXCOORD_0" in primitive["attributes"], primitive)
        if name == "plain":
            for (x, _, _), (u, v) in zip(g.read(primitive["attributes"]["POSITION"]), g.read(primitive["attributes"]["TEXCOORD_0"])):
                check(abs((x + g.json["nodes"][0]["translation"][0]) / 4 - u) < 1e-5 and 0 <= v <= 1, (x, u, v))
            size = glb.stat().st_size
            check("extensionsRequired" not in g.json and "draco" not in support.report(folder / "r.json")["output"], g.json)
            continue
        draco = support.report(folder / "r.json")["output"]["draco"]
        check(glb.stat().st_size < size and draco["bytes"] < draco["bytes_plain"] / 3, (glb.stat().st_size, size, draco))
        check(0 < draco["position_error_max"] < 4 / 2 ** (draco["bits"] - 1) and 0 < draco["uv_error_max"] < 2e-3 and 0 < draco["weight_error_max"] <= 1 / 255, draco)
        check(g.json["extensionsRequired"] == ["KHR_draco_mesh_compression"], g.json)
        extension = primitive["extensions"]["KHR_draco_mesh_compression"]
        check(extension["attributes"].keys() == primitive["attributes"].keys() >= {"POSITION", "TEXCOORD_0", "JOINTS_0", "WEIGHTS_0"}, extension)
        check(("JOINTS_1" in extension["attributes"]) == (name == "eight"), extension)
        check("bufferView" not in g.json["accessors"][primitive["attributes"]["POSITION"]], primitive)
        for other in ("plain", name):  # our importer reads both; the voxels are the same but for those that the surface only just meets
            run("svo-voxelize", folder / (other + ".glb"), "-o", folder / (other + ".svo"), "-f", "--depth", 5, "--attributes", "none")
        counts = [json.loads(run("svo-dump", folder / (other + ".svo"), "--json").out)["voxels"] for other in ("plain", name)]
        check(abs(counts[0] - counts[1]) <= 0.05 * counts[0], counts)
    r = tool("svo-skeleton", folder / "tube.obj", "-o", folder / "u.skel", "--omega", 0.05, "--draco", 14)
    check(r.code == 1 and "--glb" in r.err, r)
    r = tool("svo-skeleton", folder / "tube.obj", "-o", folder / "u.skel", "--omega", 0.05, "--glb", folder / "u.glb", "--draco", 7)
    check(r.code == 1 and "8 to 24" in r.err, r)


def test_bind(folder):
    """Along a tube, the bone of a voxel is the one beside it, or the next where bones meet."""
    tube_obj(folder / "tube.obj")
    for name, options in (("surface", ()), ("colors", ("--attributes", "normal"))):
        svo, bound = folder / (name + ".svo"), folder / (name + "_bound.svo")
        run("svo-voxelize", folder / "tube.obj", "-o", svo, "--depth", 7, *(options or ("--attributes", "none")))
        run("svo-skeleton", folder / "tube.obj", "-o", folder / "t.skel", "-f", "--omega", 0.03, "--obj", folder / "t.obj", "--bind", svo, "--bound", bound,
            "--report", folder / "r.json")
        points, bones = curve(folder / "t.obj")
        run("svo-dump", bound, "--validate")
        run("svo-dump", bound, "--voxels", folder / "b.ply", "-f")
        ply = support.read_ply(folder / "b.ply")
        check(("nx" in ply) == bool(options), ply.keys())
        for x, bone in zip(ply["x"], ply["bone"]):
            low, high = sorted(points[j][0] for j in bones[bone])
            x = min(max(x, min(p[0] for p in points)), max(p[0] for p in points))
            check(low - 0.12 <= x <= high + 0.12, (x, low, high))
        out = support.report(folder / "r.json")["output"]["bound"]
        check(out["values"] == len(ply["x"]) and out["unbound"] == 0 and out["bones_used"] == len(set(ply["bone"])) == len(bones), out)
        check(out["bytes"] == bound.stat().st_size and 0 < out["sample_distance_mean_voxels"] < out["sample_distance_max_voxels"] < 6, out)


def test_bound_voxels_are_posed(folder):
    """From a mesh to voxels that bend: bones bound, bones beyond the middle turned by svo-pack, drawn by svo-render; every voxel is where its bone takes it."""
    tube_obj(folder / "tube.obj")
    run("svo-voxelize", folder / "tube.obj", "-o", folder / "v.svo", "--depth", 6, "--attributes", "none")
    run("svo-skeleton", folder / "tube.obj", "-o", folder / "t.skel", "--omega", 0.05, "--obj", folder / "t.obj", "--bind", folder / "v.svo", "--bound", folder / "b.svo")
    points, bones = curve(folder / "t.obj")
    bend = min(range(len(points)), key=lambda j: abs(points[j][0] - 2))
    pivot, c, s = points[bend], math.cos(math.radians(40)), math.sin(math.radians(40))
    beyond = [i for i, b in enumerate(bones) if min(points[j][0] for j in b) >= pivot[0] - 1e-9]
    check(0 < len(beyond) < len(bones), bones)
    turn = {"rotation": [0, 0, math.sin(math.radians(20)), math.cos(math.radians(20))], "pivot": list(pivot)}
    scene = {"assets": [{"name": "t", "file": "b.svo"}], "instances": [{"asset": "t", "pose": {"bones": [{"bone": i, **turn} for i in beyond]}}]}
    (folder / "s.json").write_text(json.dumps(scene))
    run("svo-pack", folder / "s.json", "-o", folder / "s.svscene")
    run("svo-render", folder / "s.svscene", "-o", folder / "s.png", "--size", "200x160", "--delta", 0.001, "--resample", "emit", "--save-svo", folder / "posed.svo")
    run("svo-dump", folder / "b.svo", "--voxels", folder / "b.ply")
    run("svo-dump", folder / "posed.svo", "--voxels", folder / "p.ply")
    bound, posed = support.read_ply(folder / "b.ply"), support.read_ply(folder / "p.ply")
    size = json.loads(run("svo-dump", folder / "b.svo", "--json").out)["voxel_to_world"][0]
    cells, wanted = {}, []
    for p in zip(posed["x"], posed["y"], posed["z"]):
        cells.setdefault(tuple(math.floor(x / (2 * size)) for x in p), []).append(p)
    for x, y, z, bone in zip(bound["x"], bound["y"], bound["z"], bound["bone"]):
        u, v = x - pivot[0], y - pivot[1]
        wanted.append((pivot[0] + c * u - s * v, pivot[1] + s * u + c * v, z) if bone in beyond else (x, y, z))
    moved = [w for w, b in zip(wanted, bound["bone"]) if b in beyond]
    check(len(moved) > 100 and max(w[1] for w in moved) > 1, len(moved))
    for w in wanted[::3]:  # half a diagonal of a voxel and of a cell
        key = [math.floor(x / (2 * size)) for x in w]
        near = [p for i in (-1, 0, 1) for j in (-1, 0, 1) for k in (-1, 0, 1) for p in cells.get((key[0] + i, key[1] + j, key[2] + k), ())]
        check(near and min(math.dist(w, p) for p in near) < 1.8 * size, w)


def test_glb_of_voxels_is_the_curve(folder):
    tube_obj(folder / "tube.obj")
    run("svo-voxelize", folder / "tube.obj", "-o", folder / "t.svo", "--depth", 6, "--attributes", "none")
    run("svo-skeleton", folder / "t.svo", "-o", folder / "t.skel", "--omega", 0.05, "--glb", folder / "t.glb", "--obj", folder / "t.obj")
    points, bones = curve(folder / "t.obj")
    gltf = Glb(folder / "t.glb").json
    lines = gltf["meshes"][0]["primitives"][0]
    check(lines["mode"] == 1 and gltf["accessors"][lines["indices"]]["count"] == 2 * len(bones), gltf)


def test_threads_and_search_give_the_same_bytes(folder):
    tube_obj(folder / "tube.obj", n=120, m=48)
    files = []
    for threads in (1, 2, 7):
        for search in ("flann", "grid"):
            path = folder / ("%d%s.skel" % (threads, search))
            run("svo-skeleton", folder / "tube.obj", "-o", path, "--omega", 0.04, "--threads", threads, "--search", search)
            files.append(path.read_bytes())
    check(all(f == files[0] for f in files), "files differ")


def test_not_converged(folder):
    tube_obj(folder / "tube.obj")
    r = run("svo-skeleton", folder / "tube.obj", "-o", folder / "t.skel", "--omega", 0.03, "--max-iterations", 3, "--report", folder / "r.json")
    report = support.report(folder / "r.json")
    check(report["output"]["converged"] is False and report["output"]["iterations"] == 3, report)
    check(any("did not converge" in str(w) for w in report["warnings"]) and "did not converge" in r.err, r)


def test_voxels(folder):
    tube_obj(folder / "tube.obj")
    run("svo-voxelize", folder / "tube.obj", "-o", folder / "t.svo", "--depth", 7, "--attributes", "none")
    run("svo-skeleton", folder / "t.svo", "-o", folder / "t.skel", "--omega", 0.04, "--obj", folder / "t.obj", "--report", folder / "r.json")
    report = support.report(folder / "r.json")
    points, bones = curve(folder / "t.obj")
    check(topology(points, bones) == (1, 2, 0, 0), report["output"])
    check(all(math.hypot(p[1], p[2]) < 0.1 for p in points), points)
    check(min(p[0] for p in points) < 0.8 and max(p[0] for p in points) > 3.2, points)
    check(report["input"]["kind"] == "voxels" and report["input"]["mapped"] == report["input"]["voxels"] > 0, report["input"])
    data = (folder / "t.svo").read_bytes()
    run("svo-skeleton", "-", "-o", folder / "u.skel", "--omega", 0.04, stdin=data)
    check((folder / "t.skel").read_bytes().split(b"META")[0] == (folder / "u.skel").read_bytes().split(b"META")[0], "stdin differs")


def test_solid_and_reconstruction(folder):
    tube_obj(folder / "tube.obj")
    lines = (folder / "tube.obj").read_text().split("\n")
    faces = [i for i, x in enumerate(lines) if x.startswith("f")]
    for row in range(20, 35):  # a hole
        for i in faces[16 * row : 16 * row + 6]:
            lines[i] = ""
    (folder / "open.obj").write_text("\n".join(lines))
    run("svo-skeleton", folder / "open.obj", "-o", folder / "t.skel", "--omega", 0.04, "--solid", folder / "t.svo", "--reconstruct", folder / "t.ply", "--report", folder / "r.json")
    r = json.loads((folder / "r.json").read_text())
    solid, closed = r["output"]["solid"], r["output"]["reconstruction"]
    run("svo-dump", "--validate", folder / "t.svo")
    dump = json.loads(run("svo-dump", "--json", folder / "t.svo").out)
    check(dump["voxels"] == solid["voxels"] and dump["depth"] == solid["depth"], (dump["voxels"], solid))
    volume, exact = solid["voxels"] * solid["voxel_size"] ** 3, 4 * math.pi * 0.25**2
    check(exact < volume < 2 * exact, (volume, exact))  # with all voxels that the surface touches
    check(closed["vertices_invented"] > 0, closed)
    # what was written is closed, and importers read it
    data = (folder / "t.ply").read_bytes()
    head, _, body = data.partition(b"end_header\n")
    vertices = int(head.split(b"element vertex ")[1].split()[0])
    triangles = int(head.split(b"element face ")[1].split()[0])
    check(vertices == closed["vertices"] and triangles == closed["triangles"] and len(body) == 25 * vertices + 13 * triangles, head)
    edges = set()
    for t in range(triangles):
        n, a, b, c = struct.unpack_from("<B3I", body, 25 * vertices + 13 * t)
        check(n == 3, n)
        for e in ((a, b), (b, c), (c, a)):
            check(e not in edges, e)
            edges.add(e)
    check(all((b, a) in edges for a, b in edges), "an edge has one side")
    # the error that is reported, by brute force: vertices of the model to the triangles that were written
    at = [struct.unpack_from("<3d", body, 25 * i) for i in range(vertices)]
    faces = [tuple(at[i] for i in struct.unpack_from("<3I", body, 25 * vertices + 13 * t + 1)) for t in range(triangles)]
    corners = {int(i) - 1 for line in lines if line.startswith("f") for i in line.split()[1:]}
    given = [tuple(map(float, line.split()[1:])) for i, line in enumerate(x for x in lines if x.startswith("v")) if i in corners]
    farthest = closed["model_distance_max"]
    check(0 < closed["model_distance_mean"] < 0.3 * solid["voxel_size"] and farthest < 1.5 * solid["voxel_size"], closed)
    for p in given[::37]:
        near = [f for f in faces if all(min(c[k] for c in f) - farthest <= p[k] <= max(c[k] for c in f) + farthest for k in range(3))]
        check(min(triangle_distance(p, *f) for f in near) <= farthest * (1 + 1e-5) + 1e-6, p)
    run("svo-voxelize", folder / "t.ply", "-o", folder / "v.svo", "--depth", 5)
    run("svo-voxelize", folder / "tube.obj", "-o", folder / "m.svo", "--depth", 5)
    r = tool("svo-skeleton", folder / "m.svo", "-o", folder / "m.skel", "--omega", 0.1, "--reconstruct", folder / "m.ply")
    check(r.code == 5 and "--reconstruct" in r.err and not (folder / "m.ply").exists() and not (folder / "m.skel").exists(), r)


def test_closed_surfaces_of_damaged_models(folder):
    """Every edge has one triangle on each side, also where parts of the solid touch along an edge."""
    for model in ("B_damaged/many_small_holes/many_small_holes.ply", "B_damaged/non_manif_hole/non_manif_hole.ply"):
        run("svo-skeleton", support.model(model), "-o", folder / "m.skel", "-f", "--omega", 0.03, "--solid-divide", 3, "--reconstruct", folder / "m.ply", "--report", folder / "r.json")
        head, _, body = (folder / "m.ply").read_bytes().partition(b"end_header\n")
        vertices, triangles = (int(head.split(b"element %s " % k)[1].split()[0]) for k in (b"vertex", b"face"))
        closed = support.report(folder / "r.json")["output"]["reconstruction"]
        check((vertices, triangles) == (closed["vertices"], closed["triangles"]), closed)
        corners = [c for _, *c in struct.iter_unpack("<B3I", body[25 * vertices:])]
        edges = {(c[k], c[(k + 1) % 3]) for c in corners for k in range(3)}
        check(len(edges) == 3 * triangles, "an edge has two triangles on one side")
        check(all((b, a) in edges for a, b in edges), "an edge has one side")
        check(closed["vertices_invented"] == sum(body[25 * v + 24] for v in range(vertices)) > 0, closed)


def test_quality_in_the_report(folder):
    tube_obj(folder / "tube.obj")
    run("svo-skeleton", folder / "tube.obj", "-o", folder / "t.skel", "--omega", 0.04, "--obj", folder / "t.obj", "--report", folder / "r.json")
    r = json.loads((folder / "r.json").read_text())
    points, bones = curve(folder / "t.obj")
    e = r["errors"]
    check(r["input"]["genus"] == 0 and r["output"]["loops"] == 0, r["input"])
    check(e["joints_inside_percent"] == 100 and e["length_inside_percent"] == 100 and e["outside_max"] == 0, e)
    off = max(math.hypot(p[1], p[2]) / 0.25 for p in points)
    check(e["off_centre_median"] <= off * 1.1 + 0.02, (e, off))
    # the surface of the tube against balls of the tube's radius around the curve, which ends before the caps
    low, high, diagonal = min(p[0] for p in points), max(p[0] for p in points), math.sqrt(16 + 0.25 + 0.25)
    corner = max(math.hypot(max(x, 0.25), 0.25) - 0.25 for x in (low, 4 - high))  # the ball that is nearest to the rim
    check(abs(e["inscribed_balls_max"] - 100 * corner / diagonal) < 1, (e["inscribed_balls_max"], 100 * corner / diagonal))


def test_refinement(folder):
    """Half of a tube at another omega: the other half's joints are the same numbers, the file says how it was made, and everything else follows."""
    tube_obj(folder / "tube.obj")
    run("svo-voxelize", folder / "tube.obj", "-o", folder / "t.svo", "--depth", 6, "--attributes", "none")
    for name, source in (("m", folder / "tube.obj"), ("v", folder / "t.svo")):
        args = ["svo-skeleton", source, "--omega", 0.1]
        run(*args, "-o", folder / (name + "0.skel"), "--obj", folder / "0.obj", "-f")
        more = ("--glb", folder / "t.glb", "--bind", folder / "t.svo", "--bound", folder / "b.svo") if name == "m" else ()
        text = "box:2,-9,-9,9,9,9@0.03"
        r = run(*args, "-o", folder / (name + "1.skel"), "--obj", folder / "1.obj", "--report", folder / "r.json", "-f", "--refine", text, *more)
        report = support.report(folder / "r.json")
        out = report["output"]
        points0, bones0 = curve(folder / "0.obj")
        points1, bones1 = curve(folder / "1.obj")
        check(topology(points1, bones1) == (1, 2, 0, 0) == (out["components"], out["ends"], out["branches"], out["loops"]), out)
        check({p for p in points0 if p[0] < 1.2} == {p for p in points1 if p[0] < 1.2}, (points0, points1))
        check(len(points1) - len(points0) == out["refined"][0]["joints_added"] - out["refined"][0]["joints_removed"] > 0, out["refined"])
        check(out["refined"][0]["omega"] == 0.03 and out["refined"][0]["bones_selected"] > 0, out["refined"])
        dump = json.loads(run("svo-dump", folder / (name + "1.skel"), "--json").out)
        check(dump["provenance"]["options"]["refine"] == text, dump["provenance"])
        run("svo-dump", folder / (name + "1.skel"), "--validate")
        if more:
            run("svo-dump", folder / "b.svo", "--validate")
            check(out["bound"]["bones_used"] == len(bones1), out["bound"])
            check(len(Glb(folder / "t.glb").json["skins"][0]["joints"]) == len(points1), "joints")
    r = run("svo-skeleton", folder / "tube.obj", "-o", folder / "n.skel", "--omega", 0.1, "--refine", "ball:99,99,99,1@0.02")
    check("selects no bone" in r.err, r)


def read_segments(path):
    """Vertices (place, colour, segment) and faces (corners, colour, segment, bone) of --segments."""
    head, _, body = path.read_bytes().partition(b"end_header\n")
    vertices, faces = (int(head.split(b"element %s " % k)[1].split()[0]) for k in (b"vertex", b"face"))
    check(len(body) == 31 * vertices + 24 * faces, head)
    v = [(r[:3], r[3:6], r[6]) for r in struct.iter_unpack("<dddBBBi", body[: 31 * vertices])]
    f = [(r[1:4], r[4:7], r[7], r[8]) for r in struct.iter_unpack("<B3IBBBii", body[31 * vertices :])]
    return v, f


def check_segments(path, report, obj, whole=True):
    """What holds for every segmentation; returns the pieces of each segment, found from the file alone."""
    vertices, faces = read_segments(path)
    points, bones = curve(obj)
    listed = report["output"]["segmentation"]["list"]
    degree = [sum(j in b for b in bones) for j in range(len(points))]
    area, count, parent = [0.0] * len(listed), [0] * len(listed), list(range(len(faces)))

    def root(i):
        while parent[i] != i:
            parent[i] = parent[parent[i]]
            i = parent[i]
        return i

    sides, colors = {}, {}
    for i, (corners, color, segment, bone) in enumerate(faces):
        p = [vertices[c][0] for c in corners]
        check(all(vertices[c][1] == color and vertices[c][2] == segment for c in corners), (i, segment))
        check("#%02x%02x%02x" % color == listed[segment]["color"] and -1 <= bone < len(bones), (color, bone))
        u, w = ([p[k][e] - p[0][e] for e in range(3)] for k in (1, 2))
        area[segment] += 0.5 * math.hypot(u[1] * w[2] - u[2] * w[1], u[2] * w[0] - u[0] * w[2], u[0] * w[1] - u[1] * w[0])
        count[segment] += 1
        for k in range(3):
            if p[k] != p[(k + 1) % 3]:
                sides.setdefault(frozenset((p[k], p[(k + 1) % 3])), []).append(i)
    for side in sides.values():
        for i in side:
            for k in side:
                if faces[i][2] == faces[k][2]:
                    parent[root(i)] = root(k)
                else:
                    check(faces[i][1] != faces[k][1], "segments %d and %d meet and look alike" % (faces[i][2], faces[k][2]))
    pieces = [len({root(i) for i in range(len(faces)) if faces[i][2] == g}) for g in range(len(listed))]
    check(pieces == [g["pieces"] for g in listed] and count == [g["triangles"] for g in listed], (pieces, listed))
    check(all(abs(a - g["area"]) <= 1e-6 * sum(area) for a, g in zip(area, listed)), (area, listed))
    check(all(g["bones"] == 0 or (g["first_joint"] == g["last_joint"]) or (degree[g["first_joint"]] != 2 and degree[g["last_joint"]] != 2) for g in listed), listed)
    check(sum(g["bones"] for g in listed) == len(bones), listed)
    return pieces, area


def test_segments(folder):
    """Three tubes that meet: three segments of a third each, each in one piece."""
    lines, base = [], 0
    tube_obj(folder / "t.obj", n=40)
    for arm in range(3):
        c, d = math.cos(2 * math.pi * arm / 3), math.sin(2 * math.pi * arm / 3)
        rows = [line.split() for line in (folder / "t.obj").read_text().splitlines()]
        for w in rows:
            if w[0] == "v":
                x, y = float(w[1]), float(w[2])
                lines.append("v %.17g %.17g %s" % (c * x - d * y, d * x + c * y, w[3]))
            else:
                lines.append("f " + " ".join(str(int(i) + base) for i in w[1:]))
        base += sum(w[0] == "v" for w in rows)
    (folder / "s.obj").write_text("\n".join(lines) + "\n")
    run("svo-skeleton", folder / "s.obj", "-o", folder / "s.skel", "--omega", 0.08, "--obj", folder / "c.obj", "--segments", folder / "s.ply", "--report", folder / "r.json")
    report = support.report(folder / "r.json")
    pieces, area = check_segments(folder / "s.ply", report, folder / "c.obj")
    check(len(pieces) == 3 and max(area) < 1.2 * min(area), area)
    check(len({g["color"] for g in report["output"]["segmentation"]["list"]}) == 3, report)
    run("svo-voxelize", folder / "s.ply", "-o", folder / "s.svo", "--depth", 5)  # importers take it
    run("svo-voxelize", folder / "s.obj", "-o", folder / "v.svo", "--depth", 5)
    r = tool("svo-skeleton", folder / "v.svo", "-o", folder / "v.skel", "--omega", 0.1, "--segments", folder / "v.ply")
    check(r.code == 5 and "--bind" in r.err and not (folder / "v.ply").exists(), r)


def test_segments_of_real_models(folder):
    for model, closed in (("A_organic/hand_closed/hand_closed.obj", True), ("A_organic/fertility/fertility.off", True), ("B_damaged/teapot/teapot.obj", False), ("B_damaged/busted/busted.STL", False)):
        path = support.model(model)
        run("svo-skeleton", path, "-o", folder / "m.skel", "-f", "--omega", 0.03, "--obj", folder / "c.obj", "--segments", folder / "m.ply", "--report", folder / "r.json")
        pieces, _ = check_segments(folder / "m.ply", support.report(folder / "r.json"), folder / "c.obj")
        check(not closed or pieces == [1] * len(pieces), (model, pieces))


def unzstd(data, size):
    """By the system's libzstd, None without it."""
    name = ctypes.util.find_library("zstd")
    if name is None:
        return None
    lib, out = ctypes.CDLL(name), ctypes.create_string_buffer(size)
    lib.ZSTD_decompress.restype = ctypes.c_size_t
    lib.ZSTD_decompress.argtypes = [ctypes.c_char_p, ctypes.c_size_t, ctypes.c_char_p, ctypes.c_size_t]
    check(lib.ZSTD_decompress(out, size, data, len(data)) == size, "zstd")
    return out.raw


class Skel:
    """A .skel as docs/format/skel.md describes it, read without the library."""

    def __init__(self, path):
        data = path.read_bytes()
        check(data[:8] == b"\x89SVX\r\n\x1a\n", "signature")
        table, count, size = struct.unpack_from("<QQQ", data, len(data) - 64)
        check(size == len(data), (size, len(data)))
        self.chunk = {}
        for i in range(count):
            at, kind, _, codec, stored, decoded = struct.unpack_from("<Q4sHHQQ", data, table + 64 + 64 * i)
            payload = data[at + 64:at + 64 + stored]
            check(codec == 1 or stored == decoded, kind)
            self.chunk[kind.decode()] = unzstd(payload, decoded) if codec == 1 else payload
        head = self.chunk["HEAD"]
        self.omega, = struct.unpack_from("<d", head, 8)
        self.centre, (self.unit,) = struct.unpack_from("<3d", head, 24), struct.unpack_from("<d", head, 48)
        self.counts = struct.unpack_from("<5I", head, 144)
        self.measures = struct.unpack_from("<5d", head, 80)  # thinness; surface distance, reconstruction: mean, max
        self.map = [j for j, in struct.iter_unpack("<I", self.chunk["VMAP"])] if self.chunk["VMAP"] is not None else None
        self.joints = [struct.unpack_from("<4dI", self.chunk["JOIN"], i) for i in range(0, len(self.chunk["JOIN"]), 40)]
        self.bones = [struct.unpack_from("<2I", self.chunk["BONE"], i) for i in range(0, len(self.chunk["BONE"]), 8)]


def solid_angle(a, b, c, p):
    a, b, c = ([x[k] - p[k] for k in range(3)] for x in (a, b, c))
    la, lb, lc = (math.hypot(*x) for x in (a, b, c))
    det = sum(a[k] * (b[k - 2] * c[k - 1] - b[k - 1] * c[k - 2]) for k in range(3))
    dot = lambda x, y: x[0] * y[0] + x[1] * y[1] + x[2] * y[2]
    return 2 * math.atan2(det, la * lb * lc + dot(a, b) * lc + dot(b, c) * la + dot(c, a) * lb)


def triangle_distance(p, a, b, c):
    """By the definition: the foot of the perpendicular where it is inside, else the nearest point of a side."""
    sub = lambda x, y: [x[k] - y[k] for k in range(3)]
    dot = lambda x, y: x[0] * y[0] + x[1] * y[1] + x[2] * y[2]
    u, v, w = sub(b, a), sub(c, a), sub(p, a)
    uu, uv, vv, wu, wv = dot(u, u), dot(u, v), dot(v, v), dot(w, u), dot(w, v)
    det = uu * vv - uv * uv
    if det > 0:
        s, t = (wu * vv - wv * uv) / det, (wv * uu - wu * uv) / det
        if s >= 0 and t >= 0 and s + t <= 1:
            return math.hypot(*(w[k] - s * u[k] - t * v[k] for k in range(3)))
    best = math.inf
    for x, y in ((a, b), (b, c), (c, a)):
        d = sub(y, x)
        n = dot(d, d)
        t = min(1, max(0, dot(sub(p, x), d) / n)) if n > 0 else 0
        best = min(best, math.dist(p, [x[k] + t * d[k] for k in range(3)]))
    return best


def segment_foot(p, a, b):
    """Distance of p from a segment, and how far along it the foot is."""
    d = [b[k] - a[k] for k in range(3)]
    n = sum(x * x for x in d)
    t = min(1, max(0, sum((p[k] - a[k]) * d[k] for k in range(3)) / n)) if n > 0 else 0
    return math.dist(p, [a[k] + t * d[k] for k in range(3)]), t


def ray_length(p, d, triangles, reach):
    """To the first triangle (Moeller and Trumbore); only those in the slab of x that the ray can get to are looked at."""
    best, low, high = reach, p[0] - abs(d[0]) * reach - 1e-9, p[0] + abs(d[0]) * reach + 1e-9
    dot = lambda x, y: x[0] * y[0] + x[1] * y[1] + x[2] * y[2]
    cross = lambda x, y: (x[1] * y[2] - x[2] * y[1], x[2] * y[0] - x[0] * y[2], x[0] * y[1] - x[1] * y[0])
    for a, b, c in triangles:
        if max(a[0], b[0], c[0]) < low or min(a[0], b[0], c[0]) > high:
            continue
        u, v, w = ([x[k] - y[k] for k in range(3)] for x, y in ((b, a), (c, a), (p, a)))
        q = cross(d, v)
        det = dot(u, q)
        if det == 0:
            continue
        r = cross(w, u)
        f, g, t = dot(w, q) / det, dot(d, r) / det, dot(v, r) / det
        if f >= -1e-12 and g >= -1e-12 and f + g <= 1 + 1e-12 and 0 <= t < best:
            best = t
    return best


def check_graph(r, s):
    """Counts of the graph: from bones alone, in the file and in the report."""
    out, degree, parent = r["output"], [0] * len(s.joints), list(range(len(s.joints)))

    def root(i):
        while parent[i] != i:
            i = parent[i]
        return i

    for a, b in s.bones:
        degree[a] += 1
        degree[b] += 1
        parent[root(a)] = root(b)
    parts = len({root(i) for i in range(len(parent))})
    graph = (parts, degree.count(1), sum(d > 2 for d in degree), len(s.bones) - len(s.joints) + parts, degree.count(0))
    check(graph == s.counts and graph[:4] == (out["components"], out["ends"], out["branches"], out["loops"]), (graph, s.counts, out))
    check(len(s.joints) == out["joints"] and len(s.bones) == out["bones"] and abs(s.omega - r["options"]["omega"]) < 1e-12, out)


def check_surface(r, s, points, faces, ring, diagonal):
    """Surface to the bones of its joint, radii, reconstruction error: from the map, whose vertices are those of the mesh where no edge is as long as omega."""
    near = [[j] for j in range(len(s.joints))]
    for a, b in s.bones:
        near[a].append(b)
        near[b].append(a)
    found, weight, radius = [], [0.0] * len(s.joints), [0.0] * len(s.joints)
    for p, j, w in zip(points, s.map, ring):
        d, t, other = min((*segment_foot(p, s.joints[j][:3], s.joints[k][:3]), k) for k in near[j])
        found.append((d, t if other != j else 0, j, other))
        weight[j] += w
        radius[j] += w * d
    for j in range(len(s.joints)):
        if weight[j] > 0:
            check(math.isclose(radius[j] / weight[j], s.joints[j][3], rel_tol=1e-4), ("radius", j, radius[j] / weight[j], s.joints[j]))
    total, e = sum(ring), r["errors"]
    errors = [100 * abs(d - s.joints[j][3] * (1 - t) - s.joints[k][3] * t) / diagonal for d, t, j, k in found]
    figures = (sum(w * 100 * f[0] / diagonal for w, f in zip(ring, found)) / total, 100 * max(found)[0] / diagonal, sum(w * x for w, x in zip(ring, errors)) / total, max(errors))
    for mine, key, stored in zip(figures, ("surface_distance_mean", "surface_distance_max", "reconstruction_mean", "reconstruction_max"), s.measures[1:]):
        check(math.isclose(mine, e[key], rel_tol=2e-3) and math.isclose(stored, e[key], rel_tol=1e-9), (key, mine, e[key], stored))
    check(math.isclose(s.measures[0], e["thinness_percent"], rel_tol=1e-9, abs_tol=1e-12), "thinness")


def check_curve(r, s, points, faces, ring, diagonal):
    """Inside, off centre, inscribed balls: every sample of the curve against every triangle."""
    triangles, e, samples = [tuple(points[v] for v in f) for f in faces], r["errors"], []
    inside = lambda x: abs(sum(solid_angle(*t, x) for t in triangles)) > 2 * math.pi
    for a, b in s.bones:
        p, q = s.joints[a][:3], s.joints[b][:3]
        length = math.dist(p, q)
        n = int(length / (0.004 * s.unit)) + 1
        along = [(q[k] - p[k]) / length for k in range(3)]
        samples += [([p[k] + (q[k] - p[k]) * (i + 0.5) / n for k in range(3)], along, length / n) for i in range(n)]
    check(abs(len(samples) - e["curve_samples"]) <= 1, (len(samples), e))
    total, within, outside, balls, off = 0, 0, 0, [], []
    for x, along, length in samples:
        gap = min(triangle_distance(x, *t) for t in triangles)
        total += length
        if not inside(x):
            outside = max(outside, gap)
            balls.append((x, 0))
            continue
        within += length
        balls.append((x, gap))
        side = min(range(3), key=lambda k: abs(along[k]))
        u = [-along[side] * along[k] + (k == side) for k in range(3)]
        n = math.hypot(*u)
        u = [c / n for c in u]
        v = [along[k - 2] * u[k - 1] - along[k - 1] * u[k - 2] for k in range(3)]
        pull, lengths = [0, 0, 0], 0
        for i in range(24):
            d = [math.cos(math.pi * i / 12) * u[k] + math.sin(math.pi * i / 12) * v[k] for k in range(3)]
            reach = ray_length(x, d, triangles, 2 * s.unit)
            pull = [pull[k] + reach * d[k] for k in range(3)]
            lengths += reach
        off.append(2 * math.hypot(*pull) / lengths)
    off.sort()
    check(abs(100 * within / total - e["length_inside_percent"]) < 0.3, (within / total, e))
    check(abs(100 * outside / diagonal - e["outside_max"]) < 1e-3, (outside, e))
    check(100 * sum(inside(j[:3]) for j in s.joints) / len(s.joints) == e["joints_inside_percent"], e)
    # rays begin at another angle here
    check(abs(off[len(off) // 2] - e["off_centre_median"]) < 0.03 and abs(off[len(off) * 95 // 100] - e["off_centre_p95"]) < 0.05, (off[len(off) // 2], e))
    gaps = [max(0, min(math.dist(p, x) - radius for x, radius in balls)) for p in points]
    mean = 100 * sum(w * g for w, g in zip(ring, gaps)) / sum(ring) / diagonal
    check(math.isclose(mean, e["inscribed_balls_mean"], rel_tol=2e-3, abs_tol=1e-3) and math.isclose(100 * max(gaps) / diagonal, e["inscribed_balls_max"], rel_tol=2e-3, abs_tol=1e-3),
          (mean, max(gaps), e))


def test_figures_of_the_report_by_another_way(folder):
    """All figures but the area that was left when the contraction ended (which no file has): from the .skel and the .obj alone, by brute force."""
    tube_obj(folder / "tube.obj", length=3.0, radius=0.3, n=30, m=12)
    run("svo-skeleton", folder / "tube.obj", "-o", folder / "s.skel", "-f", "--omega", 0.15, "--report", folder / "r.json")
    r, s = support.report(folder / "r.json"), Skel(folder / "s.skel")
    points, faces = [], []
    for line in (folder / "tube.obj").read_text().splitlines():
        w = line.split()
        if w and w[0] == "v":
            points.append(tuple(map(float, w[1:4])))
        elif w and w[0] == "f":
            corners = [int(x.split("/")[0]) - 1 for x in w[1:]]
            faces += [(corners[0], corners[i], corners[i + 1]) for i in range(1, len(corners) - 1)]
    check(r["input"]["vertices_tessellated"] == len(points), "edges of this tube are shorter than omega")
    ring = [0.0] * len(points)
    for a, b, c in faces:
        u, v = ([points[x][k] - points[a][k] for k in range(3)] for x in (b, c))
        for x in (a, b, c):
            ring[x] += math.hypot(*(u[k - 2] * v[k - 1] - u[k - 1] * v[k - 2] for k in range(3))) / 2
    diagonal = math.dist([min(p[k] for p in points) for k in range(3)], [max(p[k] for p in points) for k in range(3)])
    edges = {frozenset((f[k], f[k - 1])) for f in faces for k in range(3)}
    check(r["input"]["genus"] == (2 - (len(points) - len(edges) + len(faces))) // 2 and (r["input"]["surface_components"], r["input"]["surface_closed_components"]) == (1, 1), r["input"])
    check_graph(r, s)
    check_curve(r, s, points, faces, ring, diagonal)
    if s.map is None:
        support.skip("no libzstd to read the map with")
    check(sum(j != 0xFFFFFFFF for j in s.map) == r["input"]["mapped"] == len(points), r["input"])
    check_surface(r, s, points, faces, ring, diagonal)


def test_voxels_of_real_models_give_the_curve_of_the_mesh(folder):
    """Fingers and legs that nearly touch included: same limbs and loops, curves within one voxel and omega / 5 of each other in the mean."""
    for model, depth in (("A_organic/hand_closed/hand_closed.obj", 8), ("A_organic/horse/horse.ply", 8), ("A_organic/fertility/fertility.off", 8)):
        path = support.model(model)
        run("svo-voxelize", path, "-o", folder / "v.svo", "-f", "--depth", depth, "--attributes", "none")
        run("svo-skeleton", path, "-o", folder / "m.skel", "-f", "--omega", 0.025, "--search", "grid", "--report", folder / "m.json")
        run("svo-skeleton", folder / "v.svo", "-o", folder / "v.skel", "-f", "--omega", 0.025, "--search", "grid", "--report", folder / "v.json")
        c = tool("svo-compare", folder / "m.skel", folder / "v.skel", "--report", folder / "c.json", "-f")
        check(c.code == 7, c)
        d, m, v = support.report(folder / "c.json")["comparison"]["skeleton"], support.report(folder / "m.json"), support.report(folder / "v.json")
        for key in ("components", "loops") if "fertility" in model else ("components", "ends", "loops"):  # its heads stick out by about what makes a branch
            check(m["output"][key] == v["output"][key], (model, key, m["output"], v["output"]))
        unit = m["input"]["unit"]
        voxel = 1.2 * unit / 2**depth  # the grid is the longest side of the box, which is at most the unit times 1.15
        check(d["curve_distance_mean"] <= voxel + 0.2 * 0.025 * unit, (model, d, unit))


def test_exit_codes(folder):
    tube_obj(folder / "tube.obj")
    out = folder / "x.skel"

    def expect(code, *args, **more):
        r = tool("svo-skeleton", *args, **more)
        check(r.code == code and (code == 0 or r.err.strip()), r)
        check(code == 0 or not out.exists(), r)
        return r

    expect(1, folder / "tube.obj", "--omega", 0.03)
    expect(1, folder / "tube.obj", "-o", out, "--omega", 0)
    expect(1, folder / "tube.obj", "-o", out, "--omega", "nan")
    expect(1, folder / "tube.obj", folder / "tube.obj", "-o", out, "--omega", 0.03)
    expect(1, folder / "tube.obj", "-o", out, "--omega", 0.03, "--glb", out)
    expect(1, folder / "tube.obj", "-o", out, "--omega", 0.03, "--bind", folder / "tube.obj")
    expect(1, folder / "tube.obj", "-o", out, "--omega", 0.03, "--bound", folder / "b.svo")
    expect(1, folder / "tube.obj", "-o", out, "--omega", 0.03, "--influences", 9)
    expect(3, folder / "tube.obj", "-o", out, "--omega", 0.03, "--bind", folder / "tube.obj", "--bound", folder / "b.svo")
    check(not (folder / "b.svo").exists() and not out.exists(), "a refused octree leaves files behind")
    expect(2, folder / "missing.obj", "-o", out, "--omega", 0.03)
    expect(2, folder / "tube.obj", "-o", folder / "no" / "x.skel", "--omega", 0.03)
    (folder / "empty.obj").write_text("v 0 0 0\n")
    expect(3, folder / "empty.obj", "-o", out, "--omega", 0.03)
    (folder / "bad.svo").write_bytes(b"\x89SVX\r\n\x1a\n" + bytes(300))
    expect(3, folder / "bad.svo", "-o", out, "--omega", 0.03)
    for text, says in (("tips@0.01", "selects nothing"), ("ends", "@"), ("ends@9", "0.0001 to 4"), ("0-999@0.01", "no bone 999")):
        r = expect(1, folder / "tube.obj", "-o", out, "--omega", 0.03, "--refine", text)
        check(says in r.err, r)
    expect(1, folder / "tube.obj", "-o", out, "--omega", 0.03, "--solid", out)
    expect(6, folder / "tube.obj", "-o", out, "--omega", 0.001, "--max-vertices", 4000000, "--solid", folder / "y", "--solid-divide", 64)
    r = expect(6, folder / "tube.obj", "-o", out, "--omega", 0.0002, "--max-vertices", 10000)
    check("larger omega" in r.err, r)
    expect(6, folder / "tube.obj", "-o", out, "--omega", 0.01, "--memory", "100K")
    expect(0, folder / "tube.obj", "-o", out, "--omega", 0.03)
    before = out.read_bytes()
    r = tool("svo-skeleton", folder / "tube.obj", "-o", out, "--omega", 0.05)
    check(r.code == 2 and out.read_bytes() == before, r)
    run("svo-skeleton", folder / "tube.obj", "-o", out, "--omega", 0.05, "-f")
    check(out.read_bytes() != before, "not replaced")


def real(folder, model, omega, expected):
    path = support.model(model)
    run("svo-skeleton", path, "-o", folder / "m.skel", "--omega", omega, "--obj", folder / "m.obj", "--report", folder / "r.json")
    report = support.report(folder / "r.json")
    out = report["output"]
    check(out["converged"], out)
    found = topology(*curve(folder / "m.obj"))
    check(found == (out["components"], out["ends"], out["branches"], out["loops"]), out)
    components, least_ends, most_ends, loops = expected
    check(found[0] == components and least_ends <= found[1] <= most_ends and (loops is None or found[3] == loops), found)


def test_hand_has_five_fingers_and_a_wrist(folder):
    real(folder, "A_organic/hand_closed/hand_closed.obj", 0.025, (1, 6, 7, 0))


def test_fertility_has_four_loops(folder):
    real(folder, "A_organic/fertility/fertility.off", 0.025, (1, 0, 4, 4))


def test_human_has_five_ends(folder):
    real(folder, "A_organic/human_neutral/human_neutral.obj", 0.025, (1, 5, 5, 0))


def test_damaged_models_end(folder):
    for model in ("B_damaged/beetle_car/beetle-alt.obj", "B_damaged/boeing/boeing.off", "B_damaged/non_manif_hole/non_manif_hole.ply",
                  "B_damaged/teapot/teapot.obj", "B_damaged/busted/busted.STL", "B_damaged/wheelchair/wheelchair.obj", "B_damaged/many_small_holes/many_small_holes.ply"):
        path = support.model(model)
        r = tool("svo-skeleton", path, "-o", folder / "m.skel", "--omega", 0.03, "-f", "--report", folder / "r.json", timeout=240)
        check(r.code == 0, r)
        out = support.report(folder / "r.json")["output"]
        check(out["joints"] > 0 and out["components"] > 0, out)


support.main(globals())
