"""How much a skeleton changes with the pose of its model: the limbs of a model are turned by its own skin, and the curve of the posed model is held against the posed curve.

    python3 tests/bench/skeleton_pose.py build/tools MODEL... [omega=0.025] [degrees=20]

Prints model,omega,degrees,limbs,hausdorff,mean,ends,loops: distances in percent of the model's unit (report: input.unit), ends and loops before and after. Limbs are the chains of
joints from an end to the next branch; each is turned about that branch, neighbours in opposite directions, about the axis that is farthest from the limb's own direction. Standard library only."""

import json
import math
import pathlib
import struct
import subprocess
import sys
import tempfile


def glb_arrays(path):
    data = path.read_bytes()
    size, = struct.unpack_from("<I", data, 12)
    gltf, blob = json.loads(data[20:20 + size]), data[28 + size:]

    def read(i):
        a = gltf["accessors"][i]
        n, code = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}[a["type"]], {5123: "H", 5125: "I", 5126: "f"}[a["componentType"]]
        step, at = n * struct.calcsize(code), gltf["bufferViews"][a["bufferView"]]["byteOffset"]
        return [struct.unpack_from("<%d%s" % (n, code), blob, at + k * step) for k in range(a["count"])]

    return gltf, read


def read_curve(path):
    points, bones = [], []
    for line in path.read_text().splitlines():
        w = line.split()
        if w[:1] == ["v"]:
            points.append(tuple(map(float, w[1:4])))
        elif w[:1] == ["l"]:
            bones.append((int(w[1]) - 1, int(w[2]) - 1))
    return points, bones


def limbs(points, bones):
    """(joints from an end up to but without the branch, branch)."""
    near = {}
    for a, b in bones:
        near.setdefault(a, []).append(b)
        near.setdefault(b, []).append(a)
    for end in sorted(j for j in near if len(near[j]) == 1):
        chain, before, at = [], None, end
        while len(near[at]) < 3:
            chain.append(at)
            further = [x for x in near[at] if x != before]
            if not further:
                break
            before, at = at, further[0]
        else:
            yield chain, at


def turned(p, pivot, axis, angle):
    d, c, s = [p[k] - pivot[k] for k in range(3)], math.cos(angle), math.sin(angle)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    d[i], d[j] = c * d[i] - s * d[j], s * d[i] + c * d[j]
    return tuple(pivot[k] + d[k] for k in range(3))


def distances(a, b, step):
    """Mean and largest distance of samples of curve a from curve b."""
    (pa, ba), (pb, bb) = a, b
    total = weight = most = 0
    for i, j in ba:
        length = math.dist(pa[i], pa[j])
        n = int(length / step) + 1
        for k in range(n + 1):
            x = [pa[i][e] + (pa[j][e] - pa[i][e]) * k / n for e in range(3)]
            best = math.inf
            for u, v in bb:
                d = [pb[v][e] - pb[u][e] for e in range(3)]
                l2 = sum(e * e for e in d)
                t = min(1, max(0, sum((x[e] - pb[u][e]) * d[e] for e in range(3)) / l2)) if l2 else 0
                best = min(best, sum((x[e] - pb[u][e] - t * d[e]) ** 2 for e in range(3)))
            best = math.sqrt(best)
            w = length / n * (0.5 if k in (0, n) else 1)
            total, weight, most = total + w * best, weight + w, max(most, best)
    return total / weight, most


def measure(tools, model, omega, degrees):
    def skeleton(mesh, folder, name, *more):
        subprocess.run([tools / "svo-skeleton", mesh, "-o", folder / (name + ".skel"), "-q", "--omega", str(omega), "--obj", folder / (name + ".obj"), "--report", folder / (name + ".json"), *more], check=True)
        return read_curve(folder / (name + ".obj")), json.loads((folder / (name + ".json")).read_text())

    with tempfile.TemporaryDirectory() as scratch:
        folder = pathlib.Path(scratch)
        curve, report = skeleton(model, folder, "a", "--glb", folder / "a.glb")
        gltf, read = glb_arrays(folder / "a.glb")
        middle = gltf["nodes"][0].get("translation", (0, 0, 0))
        turns, limb_count = {}, len(list(limbs(*curve)))  # joint -> pivot, axis, angle
        for n, (chain, branch) in enumerate(limbs(*curve)):
            along = [abs(curve[0][chain[0]][k] - curve[0][branch][k]) for k in range(3)]
            for j in chain:
                turns[j] = (curve[0][branch], along.index(min(along)), math.radians(degrees if n % 2 else -degrees))
        move = lambda p, j: turned(p, *turns[j]) if j in turns else p
        with open(folder / "posed.obj", "w") as f:
            base = 0
            for primitive in (p for mesh in gltf["meshes"] for p in mesh["primitives"]):
                at = primitive["attributes"]
                position = read(at["POSITION"])
                for p, joints, weights in zip(position, read(at["JOINTS_0"]), read(at["WEIGHTS_0"])):
                    p = tuple(p[k] + middle[k] for k in range(3))
                    places = [move(p, j) for j in joints]
                    f.write("v %.9g %.9g %.9g\n" % tuple(sum(w * q[k] for w, q in zip(weights, places)) for k in range(3)))
                index = [i for i, in read(primitive["indices"])]
                for t in range(0, len(index), 3):
                    f.write("f %d %d %d\n" % tuple(base + i + 1 for i in index[t:t + 3]))
                base += len(position)
        expected = ([move(p, j) for j, p in enumerate(curve[0])], curve[1])
        found, after = skeleton(folder / "posed.obj", folder, "b")
        unit, out, again = report["input"]["unit"], report["output"], after["output"]
        one, other = distances(expected, found, 0.01 * unit), distances(found, expected, 0.01 * unit)
        print("%s,%g,%g,%d,%.2f,%.3f,%d %d,%d %d" % (model.stem, omega, degrees, limb_count, 100 * max(one[1], other[1]) / unit, 100 * max(one[0], other[0]) / unit,
                                                     out["ends"], again["ends"], out["loops"], again["loops"]), flush=True)


def main():
    options = dict(a.split("=") for a in sys.argv[2:] if "=" in a and not pathlib.Path(a).exists())
    print("model,omega,degrees,limbs,hausdorff,mean,ends,loops")
    for model in [pathlib.Path(a) for a in sys.argv[2:] if "=" not in a or pathlib.Path(a).exists()]:
        measure(pathlib.Path(sys.argv[1]).resolve(), model, float(options.get("omega", 0.025)), float(options.get("degrees", 20)))


if __name__ == "__main__":
    sys.exit(main())
