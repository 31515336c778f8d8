"""Skinned and animated glTF in plain Python: made, read and posed. An implementation of its own, to compare the tools with."""

import base64
import json
import math
import pathlib
import struct

# --- 4x4 matrices as lists of rows ---

IDENTITY = [[1.0 if i == j else 0.0 for j in range(4)] for i in range(4)]


def mul(a, b):
    return [[sum(a[i][k] * b[k][j] for k in range(4)) for j in range(4)] for i in range(4)]


def apply(m, p):
    return tuple(m[i][0] * p[0] + m[i][1] * p[1] + m[i][2] * p[2] + m[i][3] for i in range(3))


def trs(t, q, s):
    x, y, z, w = q
    n = math.sqrt(x * x + y * y + z * z + w * w)
    x, y, z, w = x / n, y / n, z / n, w / n
    r = [[1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)], [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
         [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)]]
    return [[r[i][j] * s[j] for j in range(3)] + [t[i]] for i in range(3)] + [[0, 0, 0, 1]]


def turn(axis, degrees):
    half = math.radians(degrees) / 2
    return [a * math.sin(half) for a in axis] + [math.cos(half)]


def columns(values):
    return [[values[4 * c + r] for c in range(4)] for r in range(4)]


# --- reading ---

SIZES = {5120: ("b", 1), 5121: ("B", 1), 5122: ("h", 2), 5123: ("H", 2), 5125: ("I", 4), 5126: ("f", 4)}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}


class File:
    def __init__(self, path):
        path = pathlib.Path(path)
        self.json = json.loads(path.read_text())
        self.buffers = []
        for b in self.json["buffers"]:
            uri = b["uri"]
            self.buffers.append(base64.b64decode(uri.split(",", 1)[1]) if uri.startswith("data:") else (path.parent / uri).read_bytes())

    def view(self, number):
        v = self.json["bufferViews"][number]
        return self.buffers[v["buffer"]][v.get("byteOffset", 0):][:v["byteLength"]], v.get("byteStride", 0)

    def accessor(self, number):
        a = self.json["accessors"][number]
        code, size = SIZES[a["componentType"]]
        width = WIDTHS[a["type"]]
        scale = {5120: 127, 5121: 255, 5122: 32767, 5123: 65535}[a["componentType"]] if a.get("normalized") else 1
        out = [[0.0] * width for _ in range(a["count"])]
        if "bufferView" in a:
            data, stride = self.view(a["bufferView"])
            for i in range(a["count"]):
                values = struct.unpack_from("<%d%s" % (width, code), data, a.get("byteOffset", 0) + i * (stride or width * size))
                out[i] = [max(v / scale, -1.0) for v in values] if scale != 1 else list(values)
        if "sparse" in a:
            s = a["sparse"]
            where, _ = self.view(s["indices"]["bufferView"])
            what, _ = self.view(s["values"]["bufferView"])
            icode, isize = SIZES[s["indices"]["componentType"]]
            for k in range(s["count"]):
                i = struct.unpack_from("<" + icode, where, s["indices"].get("byteOffset", 0) + k * isize)[0]
                out[i] = list(struct.unpack_from("<%d%s" % (width, code), what, s["values"].get("byteOffset", 0) + k * width * size))
        return out

    def sample(self, sampler, rotation, time):
        """A value of an animation (glTF 2.0, appendix C)."""
        times = [t[0] for t in self.accessor(sampler["input"])]
        values = self.accessor(sampler["output"])
        kind = sampler.get("interpolation", "LINEAR")
        value = (lambda k: values[3 * k + 1]) if kind == "CUBICSPLINE" else (lambda k: values[k])
        if time <= times[0]:
            return value(0)
        if time >= times[-1]:
            return value(len(times) - 1)
        k = max(i for i, t in enumerate(times) if t <= time)
        d = times[k + 1] - times[k]
        u, a, b = (time - times[k]) / d, value(k), value(k + 1)
        if kind == "STEP":
            return a
        if kind == "CUBICSPLINE":
            leave, arrive = values[3 * k + 2], values[3 * k + 3]
            return [(2 * u ** 3 - 3 * u ** 2 + 1) * a[i] + d * (u ** 3 - 2 * u ** 2 + u) * leave[i] + (3 * u ** 2 - 2 * u ** 3) * b[i] + d * (u ** 3 - u ** 2) * arrive[i]
                    for i in range(len(a))]
        if not rotation:
            return [(1 - u) * x + u * y for x, y in zip(a, b)]
        cosine = sum(x * y for x, y in zip(a, b))
        if cosine < 0:
            b, cosine = [-y for y in b], -cosine
        angle = math.acos(min(1, cosine))
        if angle < 1e-6:
            return [(1 - u) * x + u * y for x, y in zip(a, b)]
        return [(math.sin((1 - u) * angle) * x + math.sin(u * angle) * y) / math.sin(angle) for x, y in zip(a, b)]

    def world(self, animation=None, time=0.0):
        nodes = self.json["nodes"]
        own = [{k: n[k] for k in ("translation", "rotation", "scale", "matrix") if k in n} for n in nodes]
        if animation is not None:
            a = self.json["animations"][animation]
            for c in a["channels"]:
                path = c["target"]["path"]
                if path != "weights":
                    own[c["target"]["node"]][path] = self.sample(a["samplers"][c["sampler"]], path == "rotation", time)
        local = [columns(n["matrix"]) if "matrix" in n else trs(n.get("translation", [0, 0, 0]), n.get("rotation", [0, 0, 0, 1]), n.get("scale", [1, 1, 1])) for n in own]
        out = [None] * len(nodes)

        def visit(i, m):
            out[i] = mul(m, local[i])
            for c in nodes[i].get("children", []):
                visit(c, out[i])
        children = {c for n in nodes for c in n.get("children", [])}
        for i in range(len(nodes)):
            if i not in children:
                visit(i, IDENTITY)
        return out

    def posed(self, animation=None, time=0.0):
        """All triangles as three points each, in world coordinates."""
        world, out = self.world(animation, time), []
        for i, n in enumerate(self.json["nodes"]):
            if "mesh" not in n:
                continue
            for p in self.json["meshes"][n["mesh"]]["primitives"]:
                points = self.accessor(p["attributes"]["POSITION"])
                if "skin" in n:
                    skin = self.json["skins"][n["skin"]]
                    bind = [columns(m) for m in self.accessor(skin["inverseBindMatrices"])]
                    joint = [mul(world[j], bind[k]) for k, j in enumerate(skin["joints"])]
                    moved = []
                    for q, js, ws in zip(points, self.accessor(p["attributes"]["JOINTS_0"]), self.accessor(p["attributes"]["WEIGHTS_0"])):
                        total = sum(ws)
                        images = [(w / total, apply(joint[int(j)], q)) for j, w in zip(js, ws) if w != 0]
                        moved.append(tuple(sum(w * r[k] for w, r in images) for k in range(3)))
                else:
                    moved = [apply(world[i], q) for q in points]
                index = [int(v[0]) for v in self.accessor(p["indices"])]
                out += [(moved[a], moved[b], moved[c]) for a, b, c in zip(index[0::3], index[1::3], index[2::3])]
        return out


# --- comparing ---


def samples(triangles, spacing):
    """Points on triangles, at most about `spacing` apart."""
    for a, b, c in triangles:
        n = max(1, math.ceil(max(math.dist(a, b), math.dist(b, c), math.dist(c, a)) / spacing))
        for i in range(n + 1):
            for k in range(n + 1 - i):
                u, v = i / n, k / n
                yield tuple(a[d] + u * (b[d] - a[d]) + v * (c[d] - a[d]) for d in range(3))


class Points:
    """Nearest of many points, up to a distance."""

    def __init__(self, points, reach):
        self.reach, self.cells = reach, {}
        for p in points:
            self.cells.setdefault(tuple(int(math.floor(x / reach)) for x in p), []).append(p)

    def distance(self, p):
        c = [int(math.floor(x / self.reach)) for x in p]
        best = math.inf
        for dx in (-1, 0, 1):
            for dy in (-1, 0, 1):
                for dz in (-1, 0, 1):
                    for q in self.cells.get((c[0] + dx, c[1] + dy, c[2] + dz), ()):
                        best = min(best, (p[0] - q[0]) ** 2 + (p[1] - q[1]) ** 2 + (p[2] - q[2]) ** 2)
        return math.sqrt(best)


# --- making ---


class Maker:
    def __init__(self):
        self.data = bytearray()
        self.json = {"asset": {"version": "2.0"}, "bufferViews": [], "accessors": []}

    def view(self, data):
        while len(self.data) % 4:
            self.data.append(0)
        self.json["bufferViews"].append({"buffer": 0, "byteOffset": len(self.data), "byteLength": len(data)})
        self.data += data
        return len(self.json["bufferViews"]) - 1

    def accessor(self, kind, component, values, normalized=False, sparse=False):
        """values: lists of WIDTHS[kind]. sparse: only those that are not 0 are stored."""
        code, _ = SIZES[component]
        scale = {5120: 127, 5121: 255, 5122: 32767, 5123: 65535}[component] if normalized else 1
        pack = lambda vs: b"".join(struct.pack("<%d%s" % (len(v), code), *[round(x * scale) if code != "f" else x for x in v]) for v in vs)
        a = {"componentType": component, "count": len(values), "type": kind}
        if normalized:
            a["normalized"] = True
        if sparse:
            there = [i for i, v in enumerate(values) if any(v)]
            a["sparse"] = {"count": len(there), "indices": {"bufferView": self.view(struct.pack("<%dH" % len(there), *there)), "componentType": 5123},
                           "values": {"bufferView": self.view(pack([values[i] for i in there]))}}
        else:
            a["bufferView"] = self.view(pack(values))
        if kind == "VEC3":
            a["min"], a["max"] = [min(v[k] for v in values) for k in range(3)], [max(v[k] for v in values) for k in range(3)]
        self.json["accessors"].append(a)
        return len(self.json["accessors"]) - 1

    def write(self, path):
        uri = "data:application/octet-stream;base64," + base64.b64encode(bytes(self.data)).decode()
        path.write_text(json.dumps({**self.json, "buffers": [{"byteLength": len(self.data), "uri": uri}]}))
        return path


def arm(path, rings=48, around=20):
    """A closed tube of three joints whose skin blends over a third of each, with tracks of all kinds: animation 0, `wave`, bends it; animation 1, `still`, moves nothing."""
    g = Maker()
    height, radius, joints = 3.0, 0.3, 3
    points, bound, weights, faces = [], [], [], []
    for i in range(rings + 1):
        y = height * i / rings
        at = min(max(y - 0.5, 0), joints - 1 - 1e-9)  # joints at 0, 1, 2; blends from 0.17 before to 0.17 after the middle between two
        j, u = int(at), at - int(at)
        w = min(max((u - 0.33) / 0.34, 0), 1)
        for k in range(around):
            a = 2 * math.pi * k / around
            points.append([radius * math.cos(a), y, radius * math.sin(a)])
            bound.append([j, min(j + 1, joints - 1), 0, 0])
            weights.append([1 - w, w, 0, 0])
    for i in range(rings):
        for k in range(around):
            a, b = i * around + k, i * around + (k + 1) % around
            faces += [a, a + around, b, b, a + around, b + around]
    for base in (0, rings * around):
        for k in range(1, around - 1):
            faces += [base, base + k, base + k + 1] if base == 0 else [base, base + k + 1, base + k]
    up = lambda d: [[1, 0, 0, 0], [0, 1, 0, -d], [0, 0, 1, 0], [0, 0, 0, 1]]
    flat = lambda m: [m[r][c] for c in range(4) for r in range(4)]
    attributes = {"POSITION": g.accessor("VEC3", 5126, points), "JOINTS_0": g.accessor("VEC4", 5121, bound), "WEIGHTS_0": g.accessor("VEC4", 5123, weights, normalized=True)}
    g.json["meshes"] = [{"primitives": [{"attributes": attributes, "indices": g.accessor("SCALAR", 5123, [[i] for i in faces])}]}]
    g.json["skins"] = [{"joints": [2, 3, 4], "inverseBindMatrices": g.accessor("MAT4", 5126, [flat(up(d)) for d in (0, 1, 2)])}]
    g.json["nodes"] = [{"mesh": 0, "skin": 0, "name": "arm", "translation": [50, 50, 50]},  # (a skinned node's own place means nothing)
                       {"children": [2], "name": "stand", "scale": [2, 2, 2], "rotation": turn([0, 0, 1], 30), "translation": [1, -2, 0.5]},
                       {"children": [3], "name": "upper"}, {"children": [4], "name": "lower", "translation": [0, 1, 0]}, {"name": "hand", "translation": [0, 1, 0]}]
    times = g.accessor("SCALAR", 5126, [[0.0], [0.5], [2.0]])
    spin = [turn([0, 0, 1], 0), turn([1, 0, 0], 70), [-x for x in turn([1, 0, 0.4], 80)]]  # (the last one the long way round)
    cubic = []
    for k, degrees in enumerate((0, 60, 40)):
        cubic += [[0.2 * k, 0, 0, 0], turn([1, 0, 0], degrees), [0.3, 0, 0.1, 0]]
    tracks = [(3, "rotation", "LINEAR", g.accessor("VEC4", 5122, spin, normalized=True)), (4, "rotation", "CUBICSPLINE", g.accessor("VEC4", 5126, cubic)),
              (4, "translation", "STEP", g.accessor("VEC3", 5126, [[0, 1, 0], [0, 1.1, 0], [0, 0.9, 0.1]])),
              (2, "translation", "LINEAR", g.accessor("VEC3", 5126, [[0, 0, 0], [0.2, 0, 0], [0, 0, 0]], sparse=True)),
              (2, "scale", "LINEAR", g.accessor("VEC3", 5126, [[1, 1, 1], [1, 1, 1], [1.2, 0.9, 1]]))]
    g.json["animations"] = [{"name": "wave", "samplers": [{"input": times, "output": o, "interpolation": k} for _, _, k, o in tracks],
                             "channels": [{"sampler": i, "target": {"node": n, "path": p}} for i, (n, p, _, _) in enumerate(tracks)]},
                            {"name": "still", "samplers": [{"input": times, "output": g.accessor("VEC3", 5126, [[0, 1, 0]] * 3)}],
                             "channels": [{"sampler": 0, "target": {"node": 3, "path": "translation"}}]}]
    g.json["scenes"], g.json["scene"] = [{"nodes": [0, 1]}], 0
    return g.write(path)
