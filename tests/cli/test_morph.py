"""Morph targets of glTF files: the octree of a morphed mesh is, voxel for voxel, that of the mesh with the displacements added beforehand."""

import base64
import json
import math
import struct

import rig
import support
from support import check, read_ply, run, tool

SIDE = 12


def bumps(x, y):
    """Multiples of 1/64 throughout: sums are exact in floats, whoever adds."""
    return ((x * 7 + y * 5) % 9) / 64.0


class Maker:
    """A sheet of SIDE x SIDE vertices, more attributes on demand, and accessors of everything in one buffer."""

    def __init__(self):
        self.data = b""
        self.json = {"asset": {"version": "2.0"}, "bufferViews": [], "accessors": [], "nodes": [], "meshes": [], "scenes": [{"nodes": []}], "scene": 0}

    def view(self, raw):
        self.data += b"\0" * (-len(self.data) % 4)
        self.json["bufferViews"].append({"buffer": 0, "byteOffset": len(self.data), "byteLength": len(raw)})
        self.data += raw
        return len(self.json["bufferViews"]) - 1

    def add(self, kind, values, component=5126, **more):
        code = {5120: "b", 5121: "B", 5122: "h", 5123: "H", 5125: "I", 5126: "f"}[component]
        flat = [v for row in values for v in (row if isinstance(row, (tuple, list)) else (row,))]
        accessor = {"bufferView": self.view(struct.pack("<%d%s" % (len(flat), code), *flat)), "componentType": component, "count": len(values), "type": kind, **more}
        if kind == "VEC3" and component == 5126:
            accessor["min"], accessor["max"] = ([f(v[k] for v in values) for k in range(3)] for f in (min, max))
        self.json["accessors"].append(accessor)
        return len(self.json["accessors"]) - 1

    def sparse(self, values):
        """The same as add, told as what differs from zero."""
        where = [i for i, v in enumerate(values) if any(v)]
        accessor = {"componentType": 5126, "count": len(values), "type": "VEC3", "min": [min(v[k] for v in values) for k in range(3)],
                    "max": [max(v[k] for v in values) for k in range(3)],
                    "sparse": {"count": len(where), "indices": {"bufferView": self.view(struct.pack("<%dH" % len(where), *where)), "componentType": 5123},
                               "values": {"bufferView": self.view(struct.pack("<%df" % (3 * len(where)), *[c for i in where for c in values[i]]))}}}
        self.json["accessors"].append(accessor)
        return len(self.json["accessors"]) - 1

    def node(self, **what):
        self.json["nodes"].append(what)
        self.json["scenes"][0]["nodes"].append(len(self.json["nodes"]) - 1)

    def write(self, path):
        self.json["buffers"] = [{"byteLength": len(self.data), "uri": "data:application/octet-stream;base64," + base64.b64encode(self.data).decode()}]
        path.parent.mkdir(exist_ok=True)
        path.write_text(json.dumps(self.json))
        return path


GRID = [(x, y) for y in range(SIDE) for x in range(SIDE)]
INDICES = [i for y in range(SIDE - 1) for x in range(SIDE - 1) for a in [y * SIDE + x] for i in (a, a + 1, a + SIDE, a + 1, a + SIDE + 1, a + SIDE)]
BASE = [(x / 8.0, y / 8.0, bumps(x, y)) for x, y in GRID]
UP = [(0.0, 0.0, 0.5 if x > 6 else 0.0) for x, y in GRID]           # mostly nothing: sparse
SIDEWAYS = [(bumps(y, x), -bumps(x, x), bumps(x, y) / 2) for x, y in GRID]
COLORS = [((x % 4) / 8.0, (y % 4) / 8.0, 0.25) for x, y in GRID]
REDDER = [(0.5, 0.0, -0.125) for _ in GRID]
NORMALS = [(0.0, 0.0, 1.0) for _ in GRID]
LEANING = [(0.75, 0.0, -0.25) for _ in GRID]  # halved: (.375, 0, .875), to be made a unit vector


def added(base, *moves):
    return [tuple(b + sum(w * m[i][k] for w, m in moves) for k, b in enumerate(row)) for i, row in enumerate(base)]


def sheet(path, weights=None, node_weights=None, baked=None, mutate=None, nodes=None, **more):
    """Morphed by weights, or (baked) with these weights added to its arrays here."""
    m = Maker()
    a, b = baked or (0, 0)
    length = lambda n: tuple(c / sum(v * v for v in n) ** 0.5 for c in n)
    primitive = {"attributes": {"POSITION": m.add("VEC3", added(BASE, (a, UP), (b, SIDEWAYS))), "COLOR_0": m.add("VEC3", added(COLORS, (a, REDDER))),
                                "NORMAL": m.add("VEC3", [length(n) for n in added(NORMALS, (b, LEANING))])}, "indices": m.add("SCALAR", INDICES, 5123)}
    if baked is None:
        primitive["targets"] = [{"POSITION": m.sparse(UP), "COLOR_0": m.add("VEC3", REDDER)}, {"POSITION": m.add("VEC3", SIDEWAYS), "NORMAL": m.add("VEC3", LEANING)}]
    mesh = {"primitives": [primitive], **({"weights": weights} if weights is not None else {}), **more}
    m.json["meshes"].append(mesh)
    for node in nodes or [{}]:
        m.node(mesh=0, **({"weights": node_weights} if node_weights is not None else {}), **node)
    if mutate:
        mutate(m)
    return m.write(path)


def octree(folder, file, *options):
    out = folder / (file.parent.name + ".svo")
    run("svo-voxelize", file, "-o", out, "-f", "-q", "--depth", 7, "--reference", 0, *options)
    return out


def same(a, b, *options):
    return tool("svo-compare", a, b, *options).code == 0


def test_weights_of_meshes_and_nodes(folder):
    weights = ((0, 0), (1, 0), (0, 0.5), (0.5, -1.5))
    last = None
    for w in weights:
        want = octree(folder, sheet(folder / "baked" / "m.gltf", baked=w))
        check(same(want, octree(folder, sheet(folder / "mesh" / "m.gltf", weights=w))), ("weights of the mesh", w))
        check(same(want, octree(folder, sheet(folder / "node" / "m.gltf", weights=[0.25, 3], node_weights=w))), ("weights of the node", w))
        if last is not None:
            check(not same(last, want), ("the targets do nothing", w))
        last = want.rename(folder / "last.svo")
    check(same(octree(folder, sheet(folder / "none" / "m.gltf")), octree(folder, sheet(folder / "baked" / "m.gltf", baked=(0, 0)))), "without weights")


def test_targets_of_integers(folder):
    """KHR_mesh_quantization: displacements of normalised 16-bit integers are what they say divided by 32767."""
    def integers(m):
        steps = [tuple(round(c * 32767 / 2) for c in row) for row in SIDEWAYS]
        m.json["meshes"][0]["primitives"][0]["targets"][1] = {"POSITION": m.add("VEC3", [row + (0,) for row in steps], 5122, normalized=True)}
        m.json["accessors"][-1]["type"] = "VEC3"
        m.json["bufferViews"][-1]["byteStride"] = 8
        m.json["extensionsUsed"] = m.json["extensionsRequired"] = ["KHR_mesh_quantization"]
    clouds = []
    for name, file in (("a", sheet(folder / "a.gltf", weights=[0, 2], mutate=integers)), ("b", sheet(folder / "b.gltf", baked=(0, 1)))):
        run("svo-voxelize", file, "-o", folder / "x.svo", "-f", "--depth", 6, "--attributes", "none")
        run("svo-dump", folder / "x.svo", "--voxels", folder / "x.ply", "-f")
        ply = read_ply(folder / "x.ply")
        clouds.append(list(zip(ply["x"], ply["y"], ply["z"])))
    far = max(min(math.dist(p, q) for q in clouds[1]) for p in clouds[0][::7])
    check(len(clouds[0]) > 1000 and far < 0.05, ("a voxel is 0.02 to 0.03 wide", len(clouds[0]), far))


def test_meshes_that_share_weights_are_one_asset(folder):
    file = sheet(folder / "m.gltf", nodes=[{}, {"weights": [1, 0], "translation": [3, 0, 0]}, {"weights": [1], "translation": [6, 0, 0]}, {"weights": [0, 0], "translation": [9, 0, 0]}])
    r = tool("svo-pack", file, "-o", folder / "s.svscene", "--depth", 6, "--report", folder / "p.json")
    check(r.code == 0 and "2 morph targets, but 1 weights" in r.err, r)
    out = json.loads((folder / "p.json").read_text())["output"]
    check(out["assets"] == 2 and out["instances"] == 4, out)


def test_animated_weights(folder):
    """Steps, lines and cubics at times on, between and beside keys, against rig.py's sampler."""
    for kind in ("STEP", "LINEAR", "CUBICSPLINE"):
        def animate(m, kind=kind):
            values = [0, 0, 0.5, 0.25, 1, -1]
            if kind == "CUBICSPLINE":
                values = [v for k in range(3) for v in (0.5, -0.25, *values[2 * k:2 * k + 2], 0.25, 0.75)]
            times, output = m.add("SCALAR", [0.5, 1, 2], min=[0.5], max=[2]), m.add("SCALAR", values)
            m.json["animations"] = [{"name": "breathe", "samplers": [{"input": times, "output": output, "interpolation": kind}],
                                     "channels": [{"sampler": 0, "target": {"node": 0, "path": "weights"}}]}]
        file = sheet(folder / "m.gltf", weights=[1, 1], mutate=animate)
        source = rig.File(file)
        keys = source.accessor(source.json["animations"][0]["samplers"][0]["output"])
        for time in (0, 0.5, 0.75, 1, 1.5, 2, 9):
            w = []
            for target in range(2):  # a sampler of its own for each target
                mine = [keys[i] for i in range(target, len(keys), 2)]
                reader = rig.File(file)
                reader.accessor = lambda n, real=reader.accessor, mine=mine: mine if n == source.json["animations"][0]["samplers"][0]["output"] else real(n)
                w.append(reader.sample(source.json["animations"][0]["samplers"][0], False, time)[0])
            run("svo-pack", file, "-o", folder / "a.svscene", "-f", "--depth", 6, "--animation", "breathe", "--time", time)
            run("svo-pack", sheet(folder / "b.gltf", baked=tuple(w)), "-o", folder / "b.svscene", "-f", "--depth", 6)
            run("svo-compare", folder / "a.svscene", folder / "b.svscene")


def test_morphed_before_skinned(folder):
    """A skin takes what the targets have moved: both skinned and posed, beside the arrays with the displacements added."""
    def skin(m):
        half = [(1, 0, 0, 0) if y < SIDE // 2 else (0, 1, 0, 0) for x, y in GRID]
        a = m.json["meshes"][0]["primitives"][0]["attributes"]
        a["JOINTS_0"], a["WEIGHTS_0"] = m.add("VEC4", [(0, 1, 0, 0)] * len(GRID), 5121), m.add("VEC4", half)
        m.json["nodes"][0]["skin"] = 0
        m.node(translation=[1, 0, 0])
        m.node(translation=[0, 0.5, 0.25])
        m.json["skins"] = [{"joints": [1, 2]}]
    for tool_options in (("svo-voxelize", "svo", ()), ("svo-pack", "svscene", ()), ("svo-pack", "svscene", ("--skins", "bake"))):
        name, kind, more = tool_options
        for weights, which in (([0.5, 0.5], "a"), (None, "b")):
            file = sheet(folder / which / "m.gltf", weights=weights, baked=None if weights else (0.5, 0.5), mutate=skin)
            run(name, file, "-o", folder / (which + "." + kind), "-f", "--depth", 6, *more)
        run("svo-compare", folder / ("a." + kind), folder / ("b." + kind))


def test_out_of_memory_s_reach(folder):
    """Triangles that go to the disk are morphed on the way."""
    side, m = 500, Maker()
    grid = [(x, y) for y in range(side) for x in range(side)]
    base, move = [(x / 64.0, y / 64.0, bumps(x, y)) for x, y in grid], [(0.0, 0.0, bumps(y, x)) for x, y in grid]
    indices = [i for y in range(side - 1) for x in range(side - 1) for a in [y * side + x] for i in (a, a + 1, a + side, a + 1, a + side + 1, a + side)]
    m.json["meshes"].append({"weights": [0.5], "primitives": [{"attributes": {"POSITION": m.add("VEC3", base)}, "indices": m.add("SCALAR", indices, 5125), "targets": [{"POSITION": m.add("VEC3", move)}]}]})
    m.node(mesh=0)
    m.json["buffers"] = [{"byteLength": len(m.data), "uri": "m.bin"}]
    (folder / "m.bin").write_bytes(m.data)
    (folder / "m.gltf").write_text(json.dumps(m.json))
    plain = octree(folder, folder / "m.gltf")
    m.json["meshes"][0]["primitives"][0].pop("targets")
    plain = plain.rename(folder / "plain.svo")
    spilled = octree(folder, folder / "m.gltf", "--memory", "24M", "--temp", folder, "--report", folder / "r.json")
    check(json.loads((folder / "r.json").read_text())["input"]["spilled_triangles"] == 2 * (side - 1) ** 2, "nothing was spilled")
    check(plain.read_bytes() == spilled.read_bytes(), "other bytes from the disk")
    (folder / "m.gltf").write_text(json.dumps(m.json))
    check(not same(plain, octree(folder, folder / "m.gltf")), "the target does nothing")


def test_what_is_wrong_with_targets(folder):
    def case(weights, change, code, words):
        def mutate(m):
            change(m, m.json["meshes"][0]["primitives"][0])
        r = tool("svo-voxelize", sheet(folder / "m.gltf", weights=weights, mutate=mutate), "-o", folder / "x.svo", "-f", "--depth", 5)
        check(r.code == code and words in r.err, "%s: exit %d: %s" % (words, r.code, r.err))
    nothing = lambda m, p: None
    case([1], nothing, 0, "2 morph targets, but 1 weights")
    case([1, 0, 0], nothing, 0, "2 morph targets, but 3 weights")
    case([1e300, 1e300], nothing, 6, "units long")
    for weights in ([0, 0], [1, 1]):  # also where it is not used
        case(weights, lambda m, p: p["targets"][1].update(POSITION=p["indices"]), 3, "another number of vertices")
        case(weights, lambda m, p: p["targets"][1].update(POSITION=99), 3, "does not exist")
    case([1, 1], lambda m, p: p["targets"][1].update(POSITION=m.add("VEC2", [(0, 0)] * len(GRID))), 3, "wrong type")
    case([1, 1], lambda m, p: p["targets"][1].update(POSITION=m.add("VEC3", [(0, 0, 0)] * len(GRID), 5125)), 3, "32-bit integers")
    case([1, 1], lambda m, p: p["attributes"].pop("NORMAL"), 0, "")  # there is nothing to add to: the faces' own normals
    # One array in very many targets is not read very many times.
    case([1] * 160000, lambda m, p: p.update(targets=[{"POSITION": p["targets"][1]["POSITION"]}] * 160000), 6, "name the same data so often")
    huge = json.loads(sheet(folder / "m.gltf", weights=[1, 1]).read_text())
    (folder / "m.gltf").write_text(json.dumps(huge).replace('"weights": [1, 1]', '"weights": [1e999, 1]'))
    r = tool("svo-voxelize", folder / "m.gltf", "-o", folder / "x.svo", "-f", "--depth", 5)
    check(r.code == 3, r)



support.main(globals())
