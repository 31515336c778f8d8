#!/usr/bin/env python3
"""Small good files for every fuzz target:  make_seeds.py TOOLS OUT

TOOLS is the folder of the built tools. OUT/TARGET/ok-* are written; all are made here from a few triangles."""
import base64
import bz2
import gzip
import json
import os
import shutil
import struct
import subprocess
import sys
import tempfile
import zlib

POINTS = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)]
FACES = [(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)]
COLORS = [(255, 0, 0), (0, 255, 0), (0, 0, 255), (90, 90, 90)]


def png_chunk(kind, data):
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def png(color_type, bits, interlace=0, extra=b""):
    """4 x 3 pixels (interlaced: 1 x 1)."""
    w, h = (1, 1) if interlace else (4, 3)
    samples = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}[color_type]
    row = (w * samples * bits + 7) // 8
    raw = b"".join(bytes([y % 5]) + bytes((37 * i + 11 * y) % (4 if color_type == 3 else 256) for i in range(row)) for y in range(h))
    if color_type == 3 and bits < 8:
        raw = b"".join(b"\0" + bytes(row) for _ in range(h))
    palette = png_chunk(b"PLTE", bytes(range(12))) + png_chunk(b"tRNS", b"\0\x80") if color_type == 3 else b""
    return (b"\x89PNG\r\n\x1a\n" + png_chunk(b"IHDR", struct.pack(">IIBBBBB", w, h, bits, color_type, 0, 0, interlace)) + palette + extra
            + png_chunk(b"IDAT", zlib.compress(raw, 9)) + png_chunk(b"IEND", b""))


def jpeg(components):
    """8 x 8 pixels of one colour: baseline, one Huffman code in each table."""
    def segment(marker, data):
        return b"\xff" + bytes([marker]) + struct.pack(">H", len(data) + 2) + data
    ids = range(1, components + 1)
    table = b"\1" + bytes(15) + b"\0"
    bits = 2 * components  # a zero difference and an end of block each
    return (b"\xff\xd8" + segment(0xDB, b"\0" + b"\1" * 64)
            + segment(0xC0, struct.pack(">BHHB", 8, 8, 8, components) + b"".join(bytes([i, 0x11, 0]) for i in ids))
            + segment(0xC4, b"\0" + table) + segment(0xC4, b"\x10" + table)
            + segment(0xDA, bytes([components]) + b"".join(bytes([i, 0]) for i in ids) + b"\0\x3f\0")
            + bytes([0xFF >> bits]) + b"\xff\xd9")


def bmp(bits):
    w, h = 3, 2
    colors = min(4, 1 << bits) if bits <= 8 else 0
    palette = bytes(4 * colors)
    row = ((w * bits + 31) // 32) * 4
    pixels = bytes(row * h) if bits <= 8 else bytes((5 * i) % 256 for i in range(row * h))
    at = 14 + 40 + len(palette)
    return (b"BM" + struct.pack("<IHHI", at + len(pixels), 0, 0, at)
            + struct.pack("<IiiHHIIiiII", 40, w, h, 1, bits, 0, len(pixels), 0, 0, colors, 0) + palette + pixels)


def tga(kind, bits):
    w, h = 3, 2
    step = bits // 8
    head = struct.pack("<BBBHHBHHHHBB", 0, 1 if kind in (1, 9) else 0, kind, 0, 2 if kind in (1, 9) else 0, 24 if kind in (1, 9) else 0,
                       0, 0, w, h, bits, 0x20 | (8 if bits == 32 else 0))
    palette = bytes(range(6)) if kind in (1, 9) else b""
    if kind < 8:
        return head + palette + (bytes(w * h) if palette else bytes(range(w * h * step)))
    return head + palette + bytes([0x80 | 3]) + bytes(step) + bytes([1]) + (bytes(2 * step) if palette else bytes(range(2 * step)))


def exr(width, height, planes, compression=0, origin=(0, 0)):
    """An OpenEXR file of its own: planes {name: (type, rows)}, type 0 integers, 1 halves, 2 floats; compression 0 none, 2 each row by zlib."""
    attribute = lambda name, kind, data: name.encode() + b"\0" + kind.encode() + b"\0" + struct.pack("<I", len(data)) + data
    names = sorted(planes)
    x, y = origin
    box = struct.pack("<4i", x, y, x + width - 1, y + height - 1)
    channels = b"".join(n.encode() + b"\0" + struct.pack("<IB3xII", planes[n][0], 0, 1, 1) for n in names) + b"\0"
    head = struct.pack("<II", 20000630, 2) + attribute("channels", "chlist", channels) + attribute("compression", "compression", bytes([compression])) + \
        attribute("dataWindow", "box2i", box) + attribute("displayWindow", "box2i", box) + attribute("lineOrder", "lineOrder", b"\0") + \
        attribute("pixelAspectRatio", "float", struct.pack("<f", 1)) + attribute("screenWindowCenter", "v2f", struct.pack("<ff", 0, 0)) + \
        attribute("screenWindowWidth", "float", struct.pack("<f", 1)) + b"\0"
    rows, offsets = b"", b""
    for r in range(height):
        data = b"".join(struct.pack("<%d%s" % (width, "Ief"[planes[n][0]]), *planes[n][1][r]) for n in names)
        if compression:  # bytes of even places, then odd ones, as differences
            split = data[0::2] + data[1::2]
            packed = zlib.compress(bytes([split[0]] + [(split[i] - split[i - 1] + 128) & 255 for i in range(1, len(split))]))
            data = packed if len(packed) < len(data) else data
        offsets += struct.pack("<Q", len(head) + 8 * height + len(rows))
        rows += struct.pack("<iI", y + r, len(data)) + data
    return head + offsets + rows


def obj():
    text = "mtllib m.mtl\no a\n" + "".join("v %g %g %g %g %g %g\n" % (p + tuple(c / 255 for c in q)) for p, q in zip(POINTS, COLORS))
    text += "vt 0 0\nvt 1 0\nvt 0 1\nvn 0 0 1\nvn 0 1 0\ng one\nusemtl red\ns 1\n"
    text += "".join("f %d/1/1 %d/2/1 %d/3/2\n" % tuple(i + 1 for i in f) for f in FACES[:2])
    text += "usemtl blue\nf -4//-1 -3//-1 \\\n-2//-2\nf 1 2 3 4\nl 1 2\n"
    mtl = ("\n#mtl\nnewmtl red\nKd 1 0 0\nKe 0 0 0.5\nd 0.5\nPr 0.3\nPm 1\nNs 10\nillum 2\nnewmtl blue\nKd 0 0 1\nTr 0.1\n"
           "map_Kd -s 2 2 1 -o 0.5 0 0 -clamp on missing.png\nmap_d -mm 0 1 none.png\nKs spectral x.rfl\nmap_Ke e.png\n")
    return text, mtl


def ply(mode):
    head = ("ply\nformat %s 1.0\ncomment tiny\nelement vertex 4\nproperty float x\nproperty double y\nproperty float z\nproperty uchar red\n"
            "property uchar green\nproperty uchar blue\nproperty float nx\nproperty float ny\nproperty float nz\nelement face 4\n"
            "property list uchar int vertex_indices\nend_header\n" % mode).encode()
    if mode == "ascii":
        body = "".join("%g %g %g %d %d %d 0 0 1\n" % (p + c) for p, c in zip(POINTS, COLORS)) + "".join("3 %d %d %d\n" % f for f in FACES)
        return head + body.encode()
    e = "<" if "little" in mode else ">"
    return (head + b"".join(struct.pack(e + "fdfBBBfff", *p, *c, 0, 0, 1) for p, c in zip(POINTS, COLORS))
            + b"".join(struct.pack(e + "Biii", 3, *f) for f in FACES))


def stl_text():
    return "solid a\n" + "".join("facet normal 0 0 1\nouter loop\n" + "".join("vertex %g %g %g\n" % POINTS[i] for i in f)
                                 + "endloop\nendfacet\n" for f in FACES) + "endsolid a\n"


def stl_binary():
    return (b"binary, color=".ljust(80, b" ") + struct.pack("<I", len(FACES))
            + b"".join(struct.pack("<12fH", 0, 0, 1, *POINTS[f[0]], *POINTS[f[1]], *POINTS[f[2]], 0x8000 | 31) for f in FACES))


def drc_plain():
    """Sequential, uncompressed: what Draco's format allows without its entropy coder."""
    return (b"DRACO" + bytes([2, 2, 1, 0, 0, 0]) + bytes([len(FACES), len(POINTS), 1]) + bytes(i for f in FACES for i in f)
            + bytes([1, 1, 0, 9, 3, 0, 0, 0]) + b"".join(struct.pack("<3f", *p) for p in POINTS))


def gltf(uri, image_uri=None):
    data = b"".join(struct.pack("<3f", *p) for p in POINTS) + bytes(i for f in FACES for i in f) + b"".join(bytes(c) + b"\xff" for c in COLORS)
    root = {
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "children": [1], "scale": [1, 2, 1]}, {"mesh": 0, "name": "b", "matrix": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 2, 0, 0, 1]}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "COLOR_0": 2}, "indices": 1, "material": 0, "mode": 4},
                                   {"attributes": {"POSITION": 3}, "mode": 6}]}],
        "materials": [{"pbrMetallicRoughness": {"baseColorFactor": [1, 0.5, 0.25, 1], "metallicFactor": 0.5}, "emissiveFactor": [0, 1, 0],
                       "alphaMode": "MASK", "alphaCutoff": 0.25, "extensions": {"KHR_materials_emissive_strength": {"emissiveStrength": 2}}}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3"}, {"bufferView": 1, "componentType": 5121, "count": 12, "type": "SCALAR"},
                      {"bufferView": 2, "componentType": 5121, "normalized": True, "count": 4, "type": "VEC4"},
                      {"componentType": 5126, "count": 4, "type": "VEC3", "sparse": {"count": 3, "indices": {"bufferView": 3, "componentType": 5121}, "values": {"bufferView": 0}}}],
        "bufferViews": [{"buffer": 0, "byteLength": 48}, {"buffer": 0, "byteOffset": 48, "byteLength": 12}, {"buffer": 0, "byteOffset": 60, "byteLength": 16},
                        {"buffer": 0, "byteOffset": 49, "byteLength": 3}],
        "buffers": [{"byteLength": len(data)}]}
    root["accessors"][3]["sparse"]["indices"]["byteOffset"] = 0
    data = data + bytes([0, 1, 3, 0])
    root["bufferViews"][3]["byteOffset"] = 76
    root["buffers"][0]["byteLength"] = len(data)
    if image_uri:
        root["images"] = [{"uri": image_uri}]
        root["textures"] = [{"source": 0, "sampler": 0}]
        root["samplers"] = [{"wrapS": 33071, "magFilter": 9728}]
        root["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"] = {"index": 0, "extensions": {"KHR_texture_transform": {"scale": [2, 2]}}}
    if uri:
        root["buffers"][0]["uri"] = "data:application/octet-stream;base64," + base64.b64encode(data).decode()
        return json.dumps(root, separators=(",", ":")).encode()
    text = json.dumps(root, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    body = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(data), b"BIN\0") + data
    return b"glTF" + struct.pack("<II", 2, 12 + len(body)) + body


def gltf_instances():
    data = b"".join(struct.pack("<3f", *p) for p in POINTS)
    uri = "data:application/octet-stream;base64," + base64.b64encode(data).decode()
    return json.dumps({
        "asset": {"version": "2.0"}, "scenes": [{"nodes": [0]}], "extensionsUsed": ["EXT_mesh_gpu_instancing"],
        "nodes": [{"mesh": 0, "extensions": {"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": 0, "SCALE": 0}}}}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "mode": 5}]}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3"}],
        "bufferViews": [{"buffer": 0, "byteLength": 48}], "buffers": [{"byteLength": 48, "uri": uri}]}, separators=(",", ":")).encode()


def gltf_rig(kinds):
    """A skin of two joints, two morph targets, and an animation with a channel of each kind of interpolation."""
    data, views, accessors = b"", [], []
    def put(values, code, width, kind, component):
        nonlocal data
        body = b"".join(struct.pack("<%d%s" % (width, code), *(v if width > 1 else (v,))) for v in values)
        views.append({"buffer": 0, "byteOffset": len(data), "byteLength": len(body)})
        accessors.append({"bufferView": len(views) - 1, "componentType": component, "count": len(values), "type": kind})
        data += body + bytes(-len(body) % 4)
        return len(accessors) - 1
    identity = (1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1)
    attributes = {"POSITION": put(POINTS, "f", 3, "VEC3", 5126), "JOINTS_0": put([(0, 1, 0, 0)] * 4, "B", 4, "VEC4", 5121),
                  "WEIGHTS_0": put([(0.75, 0.25, 0, 0)] * 4, "f", 4, "VEC4", 5126)}
    inverse = put([identity, identity[:12] + (0, -1, 0, 1)], "f", 16, "MAT4", 5126)
    times = put((0, 0.5, 2), "f", 1, "SCALAR", 5126)
    moves, turns = put(POINTS[:3], "f", 3, "VEC3", 5126), put([(0, 0, 0, 1), (0, 0.6, 0, 0.8), (1, 0, 0, 0)], "f", 4, "VEC4", 5126)
    cubic = put([(i % 3, 1, 0.5) for i in range(9)], "f", 3, "VEC3", 5126)
    cycle = put([0, 0.5, 1, 0.25, -1, 2], "f", 1, "SCALAR", 5126)  # two targets, three times
    samplers = [{"input": times, "output": {"STEP": moves, "LINEAR": turns, "CUBICSPLINE": cubic}[k], "interpolation": k} for k in kinds]
    channels = [{"sampler": i, "target": {"node": 1 + i % 2, "path": {"STEP": "translation", "LINEAR": "rotation", "CUBICSPLINE": "scale"}[k]}} for i, k in enumerate(kinds)]
    samplers.append({"input": times, "output": cycle})
    channels.append({"sampler": len(kinds), "target": {"node": 0, "path": "weights"}})
    position = attributes["POSITION"]
    uri = "data:application/octet-stream;base64," + base64.b64encode(data).decode()
    return json.dumps({"asset": {"version": "2.0"}, "scenes": [{"nodes": [0, 1]}], "skins": [{"joints": [1, 2], "inverseBindMatrices": inverse}],
                       "nodes": [{"mesh": 0, "skin": 0}, {"children": [2]}, {"translation": [0, 1, 0]}],
                       "meshes": [{"weights": [0.5, 1], "primitives": [{"attributes": attributes, "mode": 5, "targets": [{"POSITION": position}, {}]}]}], "animations": [{"name": "a", "samplers": samplers, "channels": channels}],
                       "accessors": accessors, "bufferViews": views, "buffers": [{"byteLength": len(data), "uri": uri}]}, separators=(",", ":")).encode()


SCENE = {"assets": [{"name": "a", "file": "a.svdag"}, {"name": "b", "file": "dir/b.svdag"}],
         "instances": [{"asset": "a", "translation": [1, 2, 3], "rotation": [0, 0.6, 0, 0.8], "scale": [1, -1, 2], "id": 7, "name": "n"},
                       {"asset": "b", "matrix": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 4, 5, 6, 1], "pose": None}, {"asset": "a", "name": "n"}],
         "camera": {"eye": [5, 5, 5], "target": [0, 0, 0], "up": [0, 1, 0], "fov": 40}}


class Seeds:
    def __init__(self, tools, out, work):
        self.tools, self.out, self.work = tools, out, work

    def put(self, target, name, data, verdict="ok-"):
        folder = os.path.join(self.out, target)
        os.makedirs(folder, exist_ok=True)
        with open(os.path.join(folder, verdict + name), "wb") as f:
            f.write(data if isinstance(data, bytes) else data.encode())

    def path(self, name, data=None):
        path = os.path.join(self.work, name)
        if data is not None:
            os.makedirs(os.path.dirname(path), exist_ok=True)
            with open(path, "wb") as f:
                f.write(data if isinstance(data, bytes) else data.encode())
        return path

    def run(self, tool, *args):
        subprocess.run([os.path.join(self.tools, tool), *args, "-q", "--force", "--threads", "1"], check=True)

    def keep(self, target, name, also=("container",)):
        with open(self.path(name), "rb") as f:
            data = f.read()
        for t in (target, *also):
            self.put(t, name, data)

    def exr(self):
        rows = lambda f: [[f(x, y) for x in range(5)] for y in range(3)]
        planes = {"B": (1, rows(lambda x, y: x / 4)), "R": (1, rows(lambda x, y: y)), "Z": (2, rows(lambda x, y: float("inf") if x == y else x + 0.1)), "bone": (0, rows(lambda x, y: 4294967295 - x))}
        self.put("exr", "plain.exr", exr(5, 3, planes))
        self.put("exr", "zips.exr", exr(5, 3, planes, compression=2, origin=(-7, 20)))
        self.put("exr", "one.exr", exr(5, 3, {"Y": planes["Z"]}))

    def images(self):
        for color, bits in ((0, 1), (0, 16), (2, 8), (3, 2), (3, 8), (4, 8), (6, 8), (6, 16)):
            self.put("image", "%d_%d.png" % (color, bits), png(color, bits))
        self.put("image", "interlaced.png", png(2, 8, 1, png_chunk(b"gAMA", struct.pack(">I", 45455))))
        for n in (1, 3):
            self.put("image", "%d.jpg" % n, jpeg(n))
        for bits in (1, 4, 8, 24, 32):
            self.put("image", "%d.bmp" % bits, bmp(bits))
        for kind, bits in ((1, 8), (2, 24), (2, 32), (3, 8), (9, 8), (10, 24), (10, 32), (11, 8)):
            self.put("image", "%d_%d.tga" % (kind, bits), tga(kind, bits))

    def meshes(self):
        text, mtl = obj()
        self.put("obj", "plain.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
        self.put("obj", "materials.obj", text + mtl)
        for mode in ("ascii", "binary_little_endian", "binary_big_endian"):
            self.put("ply", mode + ".ply", ply(mode))
        self.put("stl", "text.stl", stl_text())
        self.put("stl", "binary.stl", stl_binary())
        self.put("off", "plain.off", "OFF\n4 4 6\n" + "".join("%d %d %d\n" % p for p in POINTS) + "".join("3 %d %d %d\n" % f for f in FACES))
        self.put("off", "color.off", "CNOFF\n# tiny\n4 2 0\n" + "".join("%d %d %d 0 0 1 %d %d %d 255\n" % (p + c) for p, c in zip(POINTS, COLORS))
                 + "4 0 1 2 3 0.5 0.5 0.5\n3 0 1 2\n")
        self.put("gltf", "data.gltf", gltf(True))
        self.put("gltf", "texture.gltf", gltf(True, "data:image/png;base64," + base64.b64encode(png(2, 8)).decode()))
        self.put("gltf", "binary.glb", gltf(False))
        self.put("gltf", "instances.gltf", gltf_instances())
        for kinds in (("STEP", "LINEAR", "CUBICSPLINE"), ("LINEAR",)):
            self.put("gltf", "rig%d.gltf" % len(kinds), gltf_rig(kinds))
        self.put("drc", "plain.drc", drc_plain())
        encoder = shutil.which("draco_encoder")  # of the package draco; without it Draco's compressed forms have no seed
        if encoder:
            source = self.path("t.obj", "".join("v %g %g %g\n" % q for q in POINTS) + "vt 0 0\nvt 1 0\nvt 0 1\nvn 0 0 1\n"
                               + "".join("f %d/1/1 %d/2/1 %d/3/1\n" % tuple(i + 1 for i in f) for f in FACES))
            for level in (0, 5, 10):
                subprocess.run([encoder, "-i", source, "-o", self.path("t.drc"), "-cl", str(level)], check=True, stdout=subprocess.DEVNULL)
                with open(self.path("t.drc"), "rb") as f:
                    self.put("drc", "level%d.drc" % level, f.read())

    def voxels(self):
        """Colours and a rotated node in .vox, runs in binvox, types and spacings in NRRD."""
        def chunk(kind, body, children=b""):
            return kind + struct.pack("<II", len(body), len(children)) + body + children
        def text(t):
            return struct.pack("<I", len(t)) + t.encode()
        def words(*pairs):
            return struct.pack("<I", len(pairs)) + b"".join(text(k) + text(v) for k, v in pairs)
        model = chunk(b"SIZE", struct.pack("<3I", 2, 3, 4)) + chunk(b"XYZI", struct.pack("<I", 2) + bytes([0, 0, 0, 1, 1, 2, 3, 79]))
        self.put("voxels", "plain.vox", b"VOX " + struct.pack("<I", 150) + chunk(b"MAIN", b"", model + chunk(b"RGBA", bytes(1024))))
        graph = (chunk(b"nTRN", struct.pack("<I", 0) + words() + struct.pack("<IiII", 1, -1, 0, 1) + words())
                 + chunk(b"nGRP", struct.pack("<I", 1) + words() + struct.pack("<II", 1, 2))
                 + chunk(b"nTRN", struct.pack("<I", 2) + words(("_name", "a")) + struct.pack("<IiII", 3, -1, 0, 1) + words(("_r", "40"), ("_t", "-3 0 7")))
                 + chunk(b"nSHP", struct.pack("<I", 3) + words() + struct.pack("<II", 1, 0) + words()))
        self.put("voxels", "graph.vox", b"VOX " + struct.pack("<I", 150) + chunk(b"MAIN", b"", model + graph))
        self.put("voxels", "runs.binvox", b"#binvox 1\ndim 4 4 4\ntranslate -1 0 2\nscale 2.5\ndata\n" + bytes([0, 20, 1, 30, 0, 14]))
        for kind, data in (("uint8", bytes(range(24))), ("short", bytes(range(48))), ("float", struct.pack("<24f", *range(24)))):
            self.put("volume", kind + ".nrrd", ("NRRD0004\n# tiny\ntype: %s\ndimension: 3\nsizes: 2 3 4\nspace directions: (1,0,0) (0,2,0) (0,0,1)\nspace origin: (0,1,2)\n"
                                                "endian: little\nencoding: raw\n\n" % kind).encode() + data)
        head = "NRRD0005\ntype: %s\ndimension: %s\nencoding: %s\n"
        self.put("volume", "packed.nrrd", (head % ("ushort", "3\nsizes: 3 4 5\nendian: big\nbyte skip: 2", "gzip")).encode() + b"\n" + gzip.compress(bytes(range(122)), mtime=0))
        self.put("volume", "packed2.nrrd", (head % ("uchar", "3\nsizes: 3 4 5\nbyte skip: 1", "bzip2")).encode() + b"\n" + bz2.compress(bytes(range(61))))
        self.put("volume", "hex.nrrd", (head % ("ushort", "3\nsizes: 2 2 2\nendian: big", "hex")).encode() + b"\n0001 00fF\n0 0 0 0 8000 1234 ffff0000 0003\n")
        self.put("volume", "text.nrrd", (head % ("int", "3\nsizes: 2 2 2\nspacings: 1 2 3", "ascii")).encode() + b"\n1 0 -2\n3 4,5 6 0\n")
        self.put("volume", "colors.nrrd", (head % ("uchar", "4\nsizes: 4 2 2 2", "raw")).encode() + b"\n" + bytes(range(32)))
        self.put("volume", "beside.nhdr", (head % ("float", "3\nsizes: 2 2 2\nline skip: 1\ndata file: x.raw", "raw")).encode(), "io-")
        rows = [p + c for p, c in zip(POINTS, COLORS)]
        cloud = ("ply\nformat %s 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty double z\nproperty uchar red\nproperty uchar green\nproperty uchar blue\n"
                 "property ushort intensity\nend_header\n")
        for mode, e in (("binary_little_endian", "<"), ("binary_big_endian", ">")):
            self.put("points", mode + ".ply", (cloud % mode).encode() + b"".join(struct.pack(e + "ffdBBBH", *r, 7) for r in rows))
        self.put("points", "ascii.ply", cloud % "ascii" + "".join(" ".join(str(v) for v in r) + " 9\n" for r in rows))
        self.put("points", "a.xyz", "# c\n" + "".join(" ".join(str(v) for v in r) + "\n" for r in rows))
        self.put("points", "b.pts", "4\n" + "".join("%g,%g;%g -3 %d %d %d\r\n" % r for r in rows))
        self.put("points", "n.xyz", "x y z nx ny nz\n" + "".join("%g %g %g 0 -1 1e-3\n" % r[:3] for r in rows))

    def ours(self):
        mesh = self.path("t.ply", ply("binary_little_endian"))
        svos = []
        for name, options in (("one", ["--depth", "0", "--attributes", "none"]), ("small", ["--depth", "3"]),
                              ("deep", ["--depth", "5", "--attributes", "color,normal,material"]), ("thin", ["--depth", "4", "--surface", "thin", "--attributes", "normal"])):
            self.run("svo-voxelize", mesh, "-o", self.path(name + ".svo"), *options)
            self.keep("svo", name + ".svo")
            svos.append(name)
        line = self.path("line.obj", "v 0 0 0\nv 1 0 0\nv 1 0.0001 0\nf 1 2 3\n")
        self.run("svo-voxelize", line, "-o", self.path("chunks.svo"), "--depth", "9", "--attributes", "none")
        self.keep("svo", "chunks.svo")
        for name in svos:
            for tag, options in (("lossless", []), ("lod", ["--lod", "all", "--color", "4", "--normal", "6"]), ("leaf", ["--lod", "none", "--color", "deltaE=5"]), ("stored", ["--lod", "stored", "--color", "4"]), ("corrected", ["--color", "deltaE=16", "--normal", "deg=25"]),
                                 ("best", ["--geometry", "best", "--color", "4"]), ("plain", ["--geometry", "svdag", "--normal", "6"]), ("mirrors", ["--geometry", "symmetric", "--lod", "none"]),
                                 ("long", ["--palettes", "algorithm1", "--color", "6"])):
                self.run("svo-compress", self.path(name + ".svo"), "-o", self.path("%s-%s.svdag" % (name, tag)), *options)
                self.keep("svdag", "%s-%s.svdag" % (name, tag))
        # Deep trees in few bytes: what a reader may spend on each path from the root shows here, not in small ones.
        specks = self.path("specks.obj", "v 0 0 0\nv 1e-7 0 0\nv 0 1e-7 0\nv 1 1 1\nv 1 1 0.9999999\nv 0.9999999 1 1\nf 1 2 3\nf 4 5 6\n")
        edge = self.path("edge.obj", "v 0 0 0\nv 1 0 0\nv 1 0.00001 0\nv 1 1 1\nf 1 2 3\n")
        box = self.path("box.off", "OFF\n8 6 12\n" + "".join("%d %d %d\n" % (i & 1, i >> 1 & 1, i >> 2) for i in range(8))
                        + "4 0 2 3 1\n4 4 5 7 6\n4 0 1 5 4\n4 2 6 7 3\n4 0 4 6 2\n4 1 3 7 5\n")
        for name, source, options in (("specks21", specks, ["--depth", "21"]), ("edge14", edge, ["--depth", "14", "--attributes", "normal"]),
                                      ("block8", box, ["--depth", "8", "--fill", "solid", "--attributes", "none"])):
            self.run("svo-voxelize", source, "-o", self.path(name + ".svo"), *options)
            self.keep("svo", name + ".svo")
            for geometry in ("fast", "best", "symmetric", "svdag"):
                self.run("svo-compress", self.path(name + ".svo"), "-o", self.path("%s-%s.svdag" % (name, geometry)), "--geometry", geometry, "--normal", "6")
                self.keep("svdag", "%s-%s.svdag" % (name, geometry))
        self.run("svo-skeleton", mesh, "-o", self.path("a.skel"), "--omega", "0.5")
        self.keep("skel", "a.skel")
        self.run("svo-skeleton", self.path("t.off", "OFF\n6 2 0\n0 0 0\n1 0 0\n0 1 0\n5 5 5\n6 5 5\n5 6 5\n3 0 1 2\n3 3 4 5\n"), "-o", self.path("two.skel"), "--omega", "0.3")
        self.keep("skel", "two.skel")
        self.path("dir/b.svdag")
        os.makedirs(self.path("dir"), exist_ok=True)
        shutil.copy(self.path("small-lod.svdag"), self.path("a.svdag"))
        shutil.copy(self.path("one-leaf.svdag"), self.path("dir/b.svdag"))
        self.run("svo-pack", self.path("scene.json", json.dumps(SCENE)), "-o", self.path("two.svscene"))
        self.keep("svscene", "two.svscene")
        self.run("svo-pack", self.path("one-leaf.svdag"), "-o", self.path("one.svscene"))
        self.keep("svscene", "one.svscene")
        self.run("svo-pack", self.path("specks21-fast.svdag"), "-o", self.path("specks21.svscene"))
        self.keep("svscene", "specks21.svscene")
        self.put("scene_json", "full.json", json.dumps(SCENE))
        self.put("scene_json", "short.json", '{"assets":[],"instances":[]}')
        self.put("scene_json", "camera.json", '{"assets":[],"instances":[],"camera":{"translation":[0,1,2],"rotation":[0,0,0,1],"yfov":1}}')


def main():
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    shutil.rmtree(sys.argv[2], ignore_errors=True)
    with tempfile.TemporaryDirectory() as work:
        seeds = Seeds(sys.argv[1], sys.argv[2], work)
        seeds.images()
        seeds.exr()
        seeds.meshes()
        seeds.voxels()
        seeds.ours()


if __name__ == "__main__":
    main()
