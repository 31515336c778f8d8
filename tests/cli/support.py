"""Helpers for the tests that drive the built tools. Python 3 standard library only.

A test script looks like this:

    import support
    from support import tool, check

    def test_something(folder):          # folder: a fresh pathlib.Path, removed afterwards
        support.cube_obj(folder / "cube.obj")
        r = tool("svo-voxelize", folder / "cube.obj", "-o", folder / "cube.svo", "--depth", 4)
        check(r.code == 0, r)

    support.main(globals())

Arguments of a script: folder of the tools, source folder, then optional words that select tests by name. The exit status
is 0 when all tests passed, 1 when one failed, 77 when all were skipped. A test skips itself with support.skip("why").
"""

import json
import math
import os
import pathlib
import re
import shutil
import struct
import subprocess
import sys
import tempfile
import time
import traceback
import zlib

tools = pathlib.Path(sys.argv[1] if len(sys.argv) > 1 else "build/tools").resolve()
SANITIZED = "asan" in str(tools) or "tsan" in str(tools)  # memory is then a multiple of what the tool takes
source = pathlib.Path(sys.argv[2] if len(sys.argv) > 2 else ".").resolve()


# Settings of whoever runs the tests are not theirs.
os.environ["SVOKIT_CONFIG"] = ""


class Skip(Exception):
    pass


class Failure(Exception):
    pass


def skip(why):
    raise Skip(why)


def check(condition, what=""):
    if not condition:
        raise Failure(str(what))


# --- running tools ---


class Result:
    def __init__(self, command, code, out, err, seconds):
        self.command, self.code, self.out, self.err, self.seconds = command, code, out, err, seconds

    @property
    def text(self):
        return self.out.decode("utf-8", "replace")

    @property
    def json(self):
        return json.loads(self.out)

    def __str__(self):
        return "%s\n  exit %s\n  stdout: %r\n  stderr: %s" % (
            " ".join(self.command), self.code, self.out[:600], self.err.strip()[:2000])


def tool(name, *args, stdin=b"", timeout=300, cwd=None, env=None):
    """Run a tool and wait. A tool that crashes or hangs fails the test."""
    command = [str(tools / name)] + [str(a) for a in args]
    start = time.monotonic()
    try:
        p = subprocess.run(command, input=stdin, stdout=subprocess.PIPE, stderr=subprocess.PIPE, timeout=timeout, cwd=cwd, env=env)
    except subprocess.TimeoutExpired:
        raise Failure("no answer in %s s: %s" % (timeout, " ".join(command)))
    r = Result(command, p.returncode, p.stdout, p.stderr.decode("utf-8", "replace"), time.monotonic() - start)
    check(p.returncode >= 0, "killed by signal %s: %s" % (-p.returncode, r))
    check("Sanitizer" not in r.err and "runtime error:" not in r.err, r)
    return r


def run(name, *args, **more):
    """The same, and the exit code must be 0."""
    r = tool(name, *args, **more)
    check(r.code == 0, r)
    return r


def have(name):
    return os.access(tools / name, os.X_OK)


# options that every tool has; "output" where it writes something
SHARED = {"output", "force", "threads", "memory", "report", "quiet", "verbose", "progress", "no-progress", "config", "no-config", "help", "version"}


def tools_by_name():
    return sorted(p.stem.replace("_", "-") for p in (source / "tools").glob("svo_*.c"))


def options(name):
    """(long name, letter or None) of each option in a tool's --help."""
    return [(long, letter or None) for letter, long in re.findall(r"^  (?:-(\w), |    )--([A-Za-z0-9-]+)", run(name, "--help").text, re.M)]


def report(path):
    """A tool's --report, with the keys that every report has."""
    data = json.loads(pathlib.Path(path).read_text())
    for key in ("tool", "version", "options", "input", "output", "phases", "wall_seconds", "peak_rss_bytes", "errors", "warnings", "exit_code"):
        check(key in data, "%s has no %s" % (path, key))
    check(data["tool"].startswith("svo-") and data["peak_rss_bytes"] > 0 and data["wall_seconds"] >= 0, data)
    check(all(set(p) == {"name", "seconds"} for p in data["phases"]), data["phases"])
    return data


def model(relative):
    """Path of a real model, or the test is skipped."""
    base = os.environ.get("SVOKIT_MODELS") or os.environ.get("SVOKIT_MODELS_DEFAULT")
    if not base or not os.path.isdir(base):
        skip("no folder of real models (SVOKIT_MODELS)")
    path = pathlib.Path(base) / relative
    if not path.exists():
        skip("the model %s is missing" % relative)
    return path


# --- making input ---

CUBE_CORNERS = [(x, y, z) for z in (0, 1) for y in (0, 1) for x in (0, 1)]
# two triangles a side, counter-clockwise from outside; corner index = x + 2y + 4z
CUBE_SIDES = [((-1, 0, 0), (0, 4, 6, 2)), ((1, 0, 0), (1, 3, 7, 5)), ((0, -1, 0), (0, 1, 5, 4)),
              ((0, 1, 0), (2, 6, 7, 3)), ((0, 0, -1), (0, 2, 3, 1)), ((0, 0, 1), (4, 5, 7, 6))]
SIDE_UV = [(0, 1), (1, 1), (1, 0), (0, 0)]


def cube_obj(path, size=1.0, offset=(0, 0, 0), color=None):
    """A closed cube; color (0..1 floats, sRGB as MTL files hold them) writes a .mtl beside it."""
    path = pathlib.Path(path)
    lines = []
    if color is not None:
        path.with_suffix(".mtl").write_text("newmtl m\nKd %g %g %g\n" % tuple(color))
        lines += ["mtllib " + path.with_suffix(".mtl").name, "usemtl m"]
    for c in CUBE_CORNERS:
        lines.append("v %.17g %.17g %.17g" % tuple(size * c[i] + offset[i] for i in range(3)))
    for _, q in CUBE_SIDES:
        lines.append("f " + " ".join(str(i + 1) for i in q))
    path.write_text("\n".join(lines) + "\n")
    return path


def quad_obj(path, size=1.0):
    path = pathlib.Path(path)
    path.write_text("v 0 0 0\nv %g 0 0\nv %g %g 0\nv 0 %g 0\nf 1 2 3 4\n" % (size, size, size, size))
    return path


def sphere_obj(path, rings=24, radius=1.0):
    """A closed UV sphere."""
    lines = ["v 0 %.17g 0" % radius]
    around = 2 * rings
    for r in range(1, rings):
        t = math.pi * r / rings
        for a in range(around):
            p = 2 * math.pi * a / around
            lines.append("v %.17g %.17g %.17g" % (radius * math.sin(t) * math.cos(p), radius * math.cos(t), radius * math.sin(t) * math.sin(p)))
    lines.append("v 0 %.17g 0" % -radius)
    at = lambda r, a: 2 + (r - 1) * around + a % around
    last = 2 + (rings - 1) * around
    for a in range(around):
        lines.append("f 1 %d %d" % (at(1, a + 1), at(1, a)))
        for r in range(1, rings - 1):
            lines.append("f %d %d %d %d" % (at(r, a), at(r, a + 1), at(r + 1, a + 1), at(r + 1, a)))
        lines.append("f %d %d %d" % (at(rings - 1, a), at(rings - 1, a + 1), last))
    path = pathlib.Path(path)
    path.write_text("\n".join(lines) + "\n")
    return path


def cube_glb(path, base_color=(1, 1, 1, 1), texture=None, nodes=None):
    """A textured unit cube as GLB. texture: PNG bytes shown on every side; nodes: list of translations (one instance each)."""
    positions, normals, uvs, indices = [], [], [], []
    for normal, q in CUBE_SIDES:
        first = len(positions)
        for corner, uv in zip(q, SIDE_UV):
            positions.append(CUBE_CORNERS[corner])
            normals.append(normal)
            uvs.append(uv)
        indices += [first, first + 1, first + 2, first, first + 2, first + 3]
    blob, views = b"", []

    def add(data):
        nonlocal blob
        views.append({"buffer": 0, "byteOffset": len(blob), "byteLength": len(data)})
        blob += data + b"\0" * (-len(data) % 4)
        return len(views) - 1

    pack = lambda rows: b"".join(struct.pack("<%df" % len(r), *r) for r in rows)
    n = len(positions)
    add(pack(positions)), add(pack(normals)), add(pack(uvs)), add(struct.pack("<%dH" % len(indices), *indices))
    material = {"pbrMetallicRoughness": {"baseColorFactor": list(base_color), "metallicFactor": 0}}
    gltf = {
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": list(range(len(nodes or [0])))}],
        "nodes": [{"mesh": 0, "translation": list(t)} for t in nodes] if nodes else [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "NORMAL": 1, "TEXCOORD_0": 2}, "indices": 3, "material": 0}]}],
        "materials": [material],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": n, "type": "VEC3", "min": [0, 0, 0], "max": [1, 1, 1]},
            {"bufferView": 1, "componentType": 5126, "count": n, "type": "VEC3"},
            {"bufferView": 2, "componentType": 5126, "count": n, "type": "VEC2"},
            {"bufferView": 3, "componentType": 5123, "count": len(indices), "type": "SCALAR"}]}
    if texture is not None:
        gltf["images"] = [{"bufferView": add(texture), "mimeType": "image/png"}]
        gltf["samplers"] = [{"magFilter": 9728, "minFilter": 9728}]
        gltf["textures"] = [{"source": 0, "sampler": 0}]
        material["pbrMetallicRoughness"]["baseColorTexture"] = {"index": 0}
    gltf["bufferViews"] = views
    gltf["buffers"] = [{"byteLength": len(blob)}]
    text = json.dumps(gltf, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    body = struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", len(blob), 0x004E4942) + blob
    path = pathlib.Path(path)
    path.write_bytes(struct.pack("<III", 0x46546C67, 2, 12 + len(body)) + body)
    return path


def write_png(path, width, height, pixel, channels=3):
    """pixel(x, y) gives a tuple of `channels` bytes. Returns the bytes; path may be None."""
    raw = b"".join(b"\0" + b"".join(bytes(pixel(x, y)) for x in range(width)) for y in range(height))

    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    data = b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, {1: 0, 3: 2, 4: 6}[channels], 0, 0, 0))
    data += chunk(b"IDAT", zlib.compress(raw)) + chunk(b"IEND", b"")
    if path is not None:
        pathlib.Path(path).write_bytes(data)
    return data


# --- reading results ---


def read_png(path):
    """(width, height, channels, rows of bytes) of an 8-bit grey, RGB or RGBA PNG without interlacing."""
    data = pathlib.Path(path).read_bytes()
    check(data[:8] == b"\x89PNG\r\n\x1a\n", "%s is no PNG" % path)
    at, packed, head = 8, b"", None
    while at < len(data):
        size, kind = struct.unpack(">I4s", data[at:at + 8])
        body = data[at + 8:at + 8 + size]
        check(struct.unpack(">I", data[at + 8 + size:at + 12 + size])[0] == zlib.crc32(kind + body), "%s: checksum" % path)
        if kind == b"IHDR":
            head = struct.unpack(">IIBBBBB", body)
        elif kind == b"IDAT":
            packed += body
        at += 12 + size
    width, height, depth, color, _, _, interlace = head
    check(depth == 8 and interlace == 0 and color in (0, 2, 6), head)
    channels = {0: 1, 2: 3, 6: 4}[color]
    raw, stride, rows = zlib.decompress(packed), width * channels, []
    before = bytes(stride)
    for y in range(height):
        kind, line = raw[y * (stride + 1)], bytearray(raw[y * (stride + 1) + 1:(y + 1) * (stride + 1)])
        for i in range(stride):
            left, up = line[i - channels] if i >= channels else 0, before[i]
            corner = before[i - channels] if i >= channels else 0
            if kind == 1:
                line[i] = line[i] + left & 255
            elif kind == 2:
                line[i] = line[i] + up & 255
            elif kind == 3:
                line[i] = line[i] + (left + up) // 2 & 255
            elif kind == 4:
                p = left + up - corner
                a, b, c = abs(p - left), abs(p - up), abs(p - corner)
                line[i] = line[i] + (left if a <= b and a <= c else up if b <= c else corner) & 255
        before = bytes(line)
        rows.append(before)
    return width, height, channels, rows


PLY_TYPES = {"char": "b", "uchar": "B", "short": "h", "ushort": "H", "int": "i", "uint": "I", "float": "f", "double": "d",
             "int8": "b", "uint8": "B", "int16": "h", "uint16": "H", "int32": "i", "uint32": "I", "float32": "f", "float64": "d"}


def read_ply(path):
    """Vertices of a PLY point cloud (ascii or binary, either byte order): {property: list of numbers}, in file order."""
    data = pathlib.Path(path).read_bytes() if not isinstance(path, bytes) else path
    end = data.index(b"end_header\n") + len(b"end_header\n")
    lines = data[:end].decode("ascii").split("\n")
    check(lines[0] == "ply", "no PLY")
    kind, count, names, types, inside = None, 0, [], "", False
    for line in lines[1:]:
        words = line.split()
        if words[:1] == ["format"]:
            kind = words[1]
        elif words[:1] == ["element"]:
            inside = words[1] == "vertex"
            if inside:
                count = int(words[2])
        elif words[:1] == ["property"] and inside:
            check(words[1] != "list", "a list in a point cloud")
            types += PLY_TYPES[words[1]]
            names.append(words[2])
    if kind == "ascii":
        rows = [[float(v) if t in "fd" else int(v) for v, t in zip(line.split(), types)] for line in data[end:].decode("ascii").split("\n")[:count]]
    else:
        shape = struct.Struct(("<" if kind == "binary_little_endian" else ">") + types)
        check(len(data) >= end + count * shape.size, "the PLY ends early")
        rows = list(shape.iter_unpack(data[end:end + count * shape.size]))
    return {name: [row[i] for row in rows] for i, name in enumerate(names)}


def ply_voxels(path):
    """{(vx, vy, vz): {property: value}} of svo-dump --voxels."""
    columns = read_ply(path)
    names = [n for n in columns if n not in ("vx", "vy", "vz")]
    voxels = {}
    for i, place in enumerate(zip(columns["vx"], columns["vy"], columns["vz"])):
        check(place not in voxels, "voxel %s twice" % (place,))
        voxels[place] = {n: columns[n][i] for n in names}
    return voxels


# --- the runner ---


def main(names):
    chosen = sys.argv[3:]
    ran = failed = skipped = 0
    for name, fn in list(names.items()):
        if not name.startswith("test_") or not callable(fn) or (chosen and not any(c in name for c in chosen)):
            continue
        folder = pathlib.Path(tempfile.mkdtemp(prefix="svokit-test-"))
        start, state, why = time.monotonic(), "ok", ""
        try:
            fn(folder)
        except Skip as e:
            state, why = "skipped", str(e)
            skipped += 1
        except Exception as e:
            state, why = "FAILED", str(e) if isinstance(e, Failure) else ""
            failed += 1
            traceback.print_exc(file=sys.stdout)
        finally:
            for base, _, _ in os.walk(folder):
                os.chmod(base, 0o700)
            shutil.rmtree(folder, ignore_errors=True)
        ran += 1
        print("%-8s %-56s %7.3f s %s" % (state, name[5:], time.monotonic() - start, why if state == "skipped" else ""), flush=True)
    print("%d tests, %d failed, %d skipped" % (ran, failed, skipped))
    sys.exit(1 if failed or ran == 0 else 77 if skipped == ran else 0)
