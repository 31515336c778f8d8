"""svo-voxelize --memory: meshes larger than memory, full disks, inputs that change, runs that are killed."""

import array
import base64
import json
import os
import random
import signal
import struct
import subprocess
import sys
import tempfile
import time
import zlib

import support
from support import check, skip, tool

BENCH = support.tools.parent / "tests" / "bench_mesh"
CONSTANT = 16 << 20  # program, libraries, stacks, buffers of files: what --memory does not count


def sheet(folder, kind, triangles, shuffled=False, shape=None):
    if not BENCH.exists():
        skip("bench_mesh is not built")
    path = folder / ("sheet." + kind)
    subprocess.run([str(BENCH), kind, str(triangles), str(path)] + (["shuffled"] if shuffled else []) + ([shape] if shape else []), check=True)
    return path


def limited(folder, mesh, memory, *more):
    """Run with --memory in a folder of its own, check that no name is left in it; returns the report."""
    temp = folder / "temp"
    temp.mkdir(exist_ok=True)
    r = tool("svo-voxelize", mesh, "-o", folder / "b.svo", "-f", "--memory", memory, "--temp", temp, "--report", folder / "r.json", *more)
    check(r.code == 0, r)
    check(list(temp.iterdir()) == [], "temporary files are left")
    return json.loads((folder / "r.json").read_text())


def compare(folder, mesh, memory, bytes_allowed, *more):
    r = tool("svo-voxelize", mesh, "-o", folder / "a.svo", "-f", *more)
    check(r.code == 0, r)
    report = limited(folder, mesh, memory, *more)
    check((folder / "a.svo").read_bytes() == (folder / "b.svo").read_bytes(), "%s with %s: other bytes" % (mesh, memory))
    if not support.SANITIZED:
        check(report["peak_rss_bytes"] <= bytes_allowed + CONSTANT, "%s: %d bytes resident" % (mesh, report["peak_rss_bytes"]))
    return report


def test_a_million_triangles_in_32_megabytes_and_two_in_64(folder):
    for kind, megabytes in (("ply", 64), ("stl", 32)):
        report = compare(folder, sheet(folder, kind, megabytes * 31250), "%dM" % megabytes, megabytes << 20, "--depth", "9")
        check(report["input"]["spilled_triangles"] == report["input"]["triangles"], report["input"])
        check(report["temporary_files"]["files_at_a_time"] <= 8, report["temporary_files"])
        (folder / ("sheet." + kind)).unlink()


def test_every_format_at_every_kind_of_depth(folder):
    for kind in ("ply", "obj", "off", "stl"):
        mesh = sheet(folder, kind, 200000, shuffled=kind != "stl")
        for depth in ("0", "5", "9"):
            report = compare(folder, mesh, "20M", 20 << 20, "--depth", depth)
        if kind != "ply":
            check(report["temporary_files"]["used"], report)


def test_thin_and_threads(folder):
    mesh = sheet(folder, "obj", 130000)
    for threads in ("1", "3"):
        compare(folder, mesh, "24M", 24 << 20, "--depth", "9", "--surface", "thin", "--threads", threads)


def test_solids_larger_than_memory(folder):
    """Closed, pierced (open) and self-intersecting ones: what tells inside from outside lies in temporary files, and the bytes are those of a run in memory."""
    for shape, triangles, depth in (("torus", 300000, 8), ("pierced", 60000, 6), ("twice", 300000, 8)):
        for kind, shuffled in (("ply", True), ("stl", False)):
            mesh = sheet(folder, kind, triangles, shuffled, shape)
            small = "20M" if triangles > 100000 else "14M"
            for memory, more in ((small, ["--attributes", "none"]), ("40M", ["--threads", "2"])):
                if memory == "40M" and kind == "stl":
                    continue
                report = compare(folder, mesh, memory, int(memory[:-1]) << 20, "--depth", str(depth), "--fill", "solid", "--reference", "0", *more)
                solid = report["solid"]
                check(memory == "40M" or solid["in_temporary_files"], report)
                check(memory == "40M" or shape == "pierced" or (report["input"]["spilled_triangles"] != 0 and report["temporary_files"]["bins"] + report["temporary_files"]["split_units"] > 1), report)
                check((solid["triangles_open"] != 0) == (shape == "pierced"), solid)
                check(report["output"]["voxels"] > report["output"]["values"], report["output"])


def test_values_of_units_in_parts_are_read_a_few_times(folder):
    """Sums of as many voxels as there is room for at a time: with a fixed number of them all triangles were read a hundred times."""
    mesh = sheet(folder, "ply", 300000, True, "torus")
    files = compare(folder, mesh, "30M", 30 << 20, "--depth", "8", "--fill", "solid", "--reference", "0")["temporary_files"]
    check(files["split_units"] != 0 and files["bytes_read"] < 12 * files["bytes_written"], files)


def test_inside_of_textured_solids_larger_than_memory(folder):
    """Values inside are those of the nearest triangle, which may lie in any bin; shards too."""
    mesh = textured_sheets(folder, 2, 600, 170, True)
    report = compare(folder, mesh, "32M", 32 << 20, "--depth", "8", "--fill", "solid", "--reference", "0", "--attributes", "color,normal,material")
    check(report["solid"]["triangles_open"] != 0 and report["solid"]["in_temporary_files"], report)
    mesh = sheet(folder, "ply", 300000, True, "torus")
    compare(folder, mesh, "24M", 24 << 20, "--depth", "8", "--fill", "solid", "--reference", "0", "--attributes", "none")
    parts = []
    for i in (1, 2, 3):
        parts.append(folder / ("part%d.svo" % i))
        r = tool("svo-voxelize", mesh, "-o", parts[-1], "-f", "--depth", "8", "--fill", "solid", "--attributes", "none", "--shard", "%d/3" % i, "--memory", "24M", "--temp", folder)
        check(r.code == 0, r)
    r = tool("svo-merge", *parts, "-o", folder / "merged.svo")
    check(r.code == 0, r)
    check((folder / "merged.svo").read_bytes() == (folder / "b.svo").read_bytes(), "shards give other bytes")


def messy_obj(path):
    """Materials in turns, polygons, missing and relative references, colours of some vertices, continued lines."""
    rng = random.Random(1)
    lines = ["mtllib none.mtl"]
    for i in range(45000):
        x, y, z = rng.random(), rng.random(), rng.random()
        colour = " %.3f %.3f %.3f" % (rng.random(), rng.random(), rng.random()) if i % 3 == 0 and i < 20000 else ""
        for k in range(4):
            lines.append("v %.9g %.9g %.9g%s" % (x + 0.01 * (k in (1, 2)), y + 0.01 * (k > 1), z + 0.01 * rng.random(), colour))
        lines.append("vt %g %g" % (rng.random(), rng.random()))
        lines.append("vn %g %g %g" % (rng.random() - 0.5, rng.random() - 0.5, 1))
        if i % 7 == 0:
            lines.append("usemtl m%d" % (i % 5))
        lines.append(("f -4/-1/-1 -3/-1/-1 \\\n -2//-1 -1", "f -4 -3 -2", "f -4//-1 -3//-1 -1//-1", "f -4/-1 -3/-1 -2/-1 -1/99999999", "f 1 -3 -2")[i % 4 if i % 1000 else 4])
    path.write_text("\n".join(lines) + "\n")


def test_files_with_everything(folder):
    messy_obj(folder / "messy.obj")
    report = compare(folder, folder / "messy.obj", "24M", 24 << 20, "--depth", "9", "--attributes", "color,normal,material")
    check(report["input"]["spilled_triangles"] != 0, report["input"])
    rng = random.Random(2)
    for name, floats in (("bytes", False), ("floats", True)):
        n = 80000
        rows = ["ply", "format ascii 1.0", "element vertex %d" % n, "property double x", "property double y", "property double z", "property float nx",
                "property float ny", "property float nz"] + ["property %s %s" % ("float" if floats else "uchar", c) for c in ("red", "green", "blue", "alpha")]
        rows += ["element face %d" % (n // 2), "property list uchar int vertex_indices", "end_header"]
        for i in range(n):
            centre = random.Random(i // 8)
            rows.append(" ".join(["%.9g" % (centre.random() + 0.01 * rng.random()) for _ in range(3)] + ["%.9g" % rng.random() for _ in range(3)]) + " " + " ".join(("%.3f" % (rng.random() * 200) if floats else str(rng.randrange(256))) for _ in range(4)))
        for i in range(n // 2):
            c = rng.randrange(n // 8) * 8
            rows.append(" ".join(map(str, [3 + i % 3] + [c + k for k in range(3 + i % 3)])))
        mesh = folder / (name + ".ply")
        mesh.write_text("\n".join(rows) + "\n")
        report = compare(folder, mesh, "20M", 20 << 20, "--depth", "7")
        check(report["input"]["spilled_triangles"] != 0, report["input"])


def test_damaged_files_give_the_same_errors(folder):
    good = sheet(folder, "obj", 130000).read_text()
    for name, text in (("vertex", good.replace("v 0.5", "v zero", 1)), ("face", good + "f 1 2 99999999\n"), ("face2", good + "f 1/1 2/x 3\n")):
        path = folder / (name + ".obj")
        path.write_text(text)
        a = tool("svo-voxelize", path, "-o", folder / "a.svo", "--depth", "8")
        b = tool("svo-voxelize", path, "-o", folder / "b.svo", "--depth", "8", "--memory", "20M")
        check(a.code == 3 and b.code == 3, str(a) + str(b))
        check(a.err == b.err, a.err + b.err)
        check(not (folder / "b.svo").exists())
    ply = sheet(folder, "ply", 600000).read_bytes()
    (folder / "cut.ply").write_bytes(ply[:-1000])
    r = tool("svo-voxelize", folder / "cut.ply", "-o", folder / "b.svo", "--depth", "8", "--memory", "20M")
    check(r.code == 3, r)


def test_shards_of_a_mesh_larger_than_memory(folder):
    """The plan is that of the mesh in memory, and so are the bytes when they are joined."""
    mesh = sheet(folder, "ply", 400000, shuffled=True)
    whole = compare(folder, mesh, "24M", 24 << 20, "--depth", "9", "--reference", "0")
    check(whole["temporary_files"]["used"], whole)
    parts = []
    for i in (1, 2, 3):
        parts.append(folder / ("part%d.svo" % i))
        plans = []
        for memory in ([], ["--memory", "24M", "--temp", folder]):
            r = tool("svo-voxelize", mesh, "-o", parts[-1], "-f", "--depth", "9", "--shard", "%d/3" % i, "--report", folder / "s.json", *memory)
            check(r.code == 0, r)
            report = json.loads((folder / "s.json").read_text())
            plans.append(report["shard"])
        check(report["input"]["spilled_triangles"] != 0, report["input"])
        check(plans[0] == plans[1], plans)
    r = tool("svo-merge", *parts, "-o", folder / "merged.svo")
    check(r.code == 0, r)
    check((folder / "merged.svo").read_bytes() == (folder / "b.svo").read_bytes(), "shards give other bytes")


def test_too_little_memory_says_what_would_do(folder):
    mesh = sheet(folder, "stl", 20000)
    for memory in ("1", "100K", "1M", "4M"):
        r = tool("svo-voxelize", mesh, "-o", folder / "a.svo", "--depth", "9", "--memory", memory)
        check(r.code == 6 and "memory" in r.err.lower(), r)
        check(sorted(p.name for p in folder.iterdir()) == ["sheet.stl"], list(folder.iterdir()))


def test_limit_of_temporary_files(folder):
    mesh = sheet(folder, "stl", 300000)
    r = tool("svo-voxelize", mesh, "-o", folder / "a.svo", "--depth", "9", "--memory", "20M", "--temp-size", "5M")
    check(r.code == 6 and "5242880" in r.err, r)
    r = tool("svo-voxelize", mesh, "-o", folder / "a.svo", "--depth", "9", "--memory", "20M", "--temp", folder / "nowhere")
    check(r.code == 2 and "nowhere" in r.err, r)
    (folder / "p.xyz").write_text("0 0 0\n1 1 1\n")
    for name in (mesh, folder / "p.xyz"):  # also where nothing would be put there
        r = tool("svo-voxelize", name, "-o", folder / "a.svo", "--depth", "3", "--temp", folder / "nowhere")
        check(r.code == 2 and "nowhere" in r.err, r)
        check(tool("svo-voxelize", name, "-o", folder / "a.svo", "-f", "--depth", "3", "--temp", folder).code == 0)


def small_disk(folder, megabytes):
    """A mounted file system of a few megabytes; skips where that cannot be had."""
    place = folder / "disk"
    place.mkdir()
    if os.geteuid() != 0 or subprocess.run(["mount", "-t", "tmpfs", "-o", "size=%dm" % megabytes, "none", str(place)], stderr=subprocess.DEVNULL).returncode != 0:
        skip("a small file system cannot be mounted here")
    return place


def test_disk_full(folder):
    mesh = sheet(folder, "stl", 400000)
    disk = small_disk(folder, 3)
    try:
        # told before: the run is not begun
        r = tool("svo-voxelize", mesh, "-o", disk / "a.svo", "--depth", "11")
        check(r.code == 6 and "free" in r.err and str(disk) in r.err, r)
        check(list(disk.iterdir()) == [])
        r = tool("svo-voxelize", mesh, "-o", disk / "a.svo", "--depth", "11", "--force")
        check(r.code == 6, r)
        # begun all the same: the output does not fit
        r = tool("svo-voxelize", mesh, "-o", disk / "a.svo", "--depth", "11", "--ignore-free-space")
        check(r.code == 2 and "space" in r.err.lower(), r)
        check(list(disk.iterdir()) == [])
        # temporary files do not fit
        r = tool("svo-voxelize", mesh, "-o", folder / "a.svo", "--depth", "9", "--memory", "20M", "--temp", disk)
        check(r.code == 2 and str(disk) in r.err and "--temp" in r.err, r)
        check(list(disk.iterdir()) == [] and not (folder / "a.svo").exists())
    finally:
        subprocess.run(["umount", str(disk)])


def test_temporary_files_of_a_solid_are_counted_before(folder):
    """What tells inside from outside: the disk holds the triangles, but not that as well."""
    mesh = sheet(folder, "ply", 300000, True, "torus")
    disk = small_disk(folder, 30)
    command = ["svo-voxelize", mesh, "-o", folder / "a.svo", "--depth", "8", "--attributes", "none", "--memory", "20M", "--temp", disk, "--fill", "solid"]
    try:
        r = tool(*command)
        check(r.code == 6 and "solid" in r.err and "--temp" in r.err, r)
        check(list(disk.iterdir()) == [] and not (folder / "a.svo").exists())
        subprocess.run(["mount", "-o", "remount,size=200m", str(disk)], check=True)
        r = tool(*command)
        check(r.code == 0, r)
        check(list(disk.iterdir()) == [])
    finally:
        subprocess.run(["umount", str(disk)])


def test_killed_runs_leave_nothing(folder):
    mesh = sheet(folder, "obj", 300000)
    temp = folder / "temp"
    temp.mkdir()
    rng = random.Random(3)
    command = [str(support.tools / "svo-voxelize"), str(mesh), "-o", str(folder / "a.svo"), "--depth", "10", "--memory", "24M", "--temp", str(temp)]
    for number in (signal.SIGKILL, signal.SIGINT, signal.SIGTERM, signal.SIGKILL, signal.SIGINT, signal.SIGKILL):
        p = subprocess.Popen(command, stderr=subprocess.DEVNULL)
        time.sleep(rng.random() * 1.5)
        p.send_signal(number)
        p.wait(60)
        check(p.returncode in (-number, 0), p.returncode)
        check(list(temp.iterdir()) == [], list(temp.iterdir()))
        left = sorted(f.name for f in folder.iterdir() if f.name not in ("sheet.obj", "temp"))
        check(left == ([] if p.returncode != 0 else ["a.svo"]), left)
        if left:
            (folder / "a.svo").unlink()


def test_input_that_changes(folder):
    """Longer, shorter or other bytes while it is read: an I/O error, never a signal, and no output."""
    seen = set()
    for change in ("append", "truncate", "rewrite"):
        for attempt in range(4):
            mesh = sheet(folder, "obj", 300000)
            command = [str(support.tools / "svo-voxelize"), str(mesh), "-o", str(folder / "a.svo"), "--depth", "7", "-f", "--memory", "24M"]
            p = subprocess.Popen(command, stderr=subprocess.PIPE)
            time.sleep(0.05 + 0.1 * attempt)
            with open(mesh, "r+b") as f:
                if change == "append":
                    f.seek(0, 2)
                    f.write(b"v 0 0 0\n")
                elif change == "truncate":
                    f.truncate(100000)
                else:
                    f.seek(1000)
                    f.write(b"v 0.5 0.5 0.5\n")
            err = p.communicate(timeout=120)[1].decode()
            check(p.returncode in (0, 2), "%s: %s %s" % (change, p.returncode, err))
            if p.returncode == 2:
                check("changed" in err or "shortened" in err, err)
                check(not (folder / "a.svo").exists())
                seen.add(change)
            else:
                (folder / "a.svo").unlink()
    check(len(seen) >= 2, "hardly any change was seen: %s" % seen)


def png(path, side, colour=(200, 100, 50), noise=None):
    """A square RGB image: of one colour, or of bytes of `noise`."""
    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
    pack = zlib.compressobj(1)
    data = b""
    for y in range(side):
        data += pack.compress(b"\0" + (noise.randbytes(3 * side) if noise else bytes(colour) * side))
    data += pack.flush()
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", struct.pack(">IIBBBBB", side, side, 8, 2, 0, 0, 0)) + chunk(b"IDAT", data) + chunk(b"IEND", b""))


def test_files_beside_the_model_that_change(folder):
    """A pipe in the place of the last texture holds the import until all other files have been read."""
    positions = struct.pack("<9f", 0, 0, 0, 1, 0, 0, 0, 1, 0)
    textures = [{"baseColorTexture": {"index": 0}}, {"baseColorTexture": {"index": 1}}]
    gltf = {"asset": {"version": "2.0"}, "buffers": [{"uri": "a.bin", "byteLength": 60}],
            "bufferViews": [{"buffer": 0, "byteLength": 36}, {"buffer": 0, "byteOffset": 36, "byteLength": 24}],
            "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3", "min": [0, 0, 0], "max": [1, 1, 0]},
                          {"bufferView": 1, "componentType": 5126, "count": 3, "type": "VEC2"}],
            "images": [{"uri": "one.png"}, {"uri": "two.png"}], "textures": [{"source": 0}, {"source": 1}],
            "materials": [{"pbrMetallicRoughness": t} for t in textures],
            "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "TEXCOORD_0": 1}, "material": i} for i in range(2)]}],
            "nodes": [{"mesh": 0}], "scenes": [{"nodes": [0]}], "scene": 0}
    png(folder / "picture", 4)
    picture = (folder / "picture").read_bytes()
    for changed in ("a.bin", "one.png", "m.gltf", None):
        (folder / "m.gltf").write_text(json.dumps(gltf))
        (folder / "a.bin").write_bytes(positions + struct.pack("<6f", 0, 0, 1, 0, 0, 1))
        (folder / "one.png").write_bytes(picture)
        os.mkfifo(folder / "two.png")
        p = subprocess.Popen([str(support.tools / "svo-voxelize"), str(folder / "m.gltf"), "-o", str(folder / "a.svo"), "-f", "--depth", "4"], stderr=subprocess.PIPE)
        with open(folder / "two.png", "wb") as pipe:  # waits for the reader
            time.sleep(0.02)  # another time of change
            if changed:
                with open(folder / changed, "r+b") as f:
                    f.write(f.read(1))
                os.utime(folder / changed)
            pipe.write(picture)
        err = p.communicate(timeout=60)[1].decode()
        check(p.returncode == (2 if changed else 0), "%s: %d %s" % (changed, p.returncode, err))
        if changed:
            check(changed in err and "changed" in err, err)
            check(not (folder / "a.svo").exists())
        (folder / "two.png").unlink()


def textured_sheets(folder, images, side, cells, glb=False):
    """As many wavy sheets as textures, each with triangles of its own; returns the path."""
    rng = random.Random(4)
    for i in range(images):
        png(folder / ("t%d.png" % i), side, noise=rng)
    points, uvs, indices = array.array("f"), array.array("f"), array.array("I")
    for y in range(cells + 1):
        for x in range(cells + 1):
            points.extend((x / cells, 0.4 / cells * ((x * 7 + y * 13) % 5), y / cells))
            uvs.extend((x / cells, y / cells))
    for y in range(cells):
        for x in range(cells):
            a = y * (cells + 1) + x
            indices.extend((a, a + cells + 1, a + 1, a + 1, a + cells + 1, a + cells + 2))
    pieces, views, accessors = [points.tobytes(), uvs.tobytes(), indices.tobytes()], [], []
    for i, (kind, component, count) in enumerate((("VEC3", 5126, len(points) // 3), ("VEC2", 5126, len(uvs) // 2), ("SCALAR", 5125, len(indices)))):
        views.append({"buffer": 0, "byteOffset": sum(map(len, pieces[:i])), "byteLength": len(pieces[i])})
        accessors.append({"bufferView": i, "componentType": component, "count": count, "type": kind})
    accessors[0].update(min=[0, 0, 0], max=[1, 1.6 / cells, 1])
    pictures = [{"uri": "t%d.png" % i} for i in range(images)]
    if glb:
        pictures = []
        for i in range(images):
            data = (folder / ("t%d.png" % i)).read_bytes()
            pictures.append({"bufferView": len(views), "mimeType": "image/png"})
            views.append({"buffer": 0, "byteOffset": sum(map(len, pieces)), "byteLength": len(data)})
            pieces.append(data + b"\0" * (-len(data) % 4))
    binary = b"".join(pieces)
    gltf = {"asset": {"version": "2.0"}, "buffers": [{"byteLength": len(binary)}], "bufferViews": views, "accessors": accessors, "images": pictures,
            "textures": [{"source": i} for i in range(images)], "materials": [{"pbrMetallicRoughness": {"baseColorTexture": {"index": i}}} for i in range(images)],
            "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "TEXCOORD_0": 1}, "indices": 2, "material": i}]} for i in range(images)],
            "nodes": [{"mesh": i, "translation": [1.05 * (i % 2), 0.1 * i, 0]} for i in range(images)], "scenes": [{"nodes": list(range(images))}], "scene": 0}
    if not glb:
        gltf["buffers"][0]["uri"] = "m.bin"
        (folder / "m.bin").write_bytes(binary)
        (folder / "m.gltf").write_text(json.dumps(gltf))
        return folder / "m.gltf"
    text = json.dumps(gltf).encode()
    text += b" " * (-len(text) % 4)
    (folder / "m.glb").write_bytes(struct.pack("<4sII", b"glTF", 2, 28 + len(text) + len(binary)) + struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(binary), b"BIN\0") + binary)
    return folder / "m.glb"


def test_textures_larger_than_memory(folder):
    for glb in (False, True):
        mesh = textured_sheets(folder, 4, 1500, 40, glb)
        for memory, depth in ((24, 6), (48, 9)) if glb else ((24, 9),):
            report = compare(folder, mesh, "%dM" % memory, memory << 20, "--depth", str(depth), "--reference", "300")
            check(report["input"]["paged_images"] >= 3 and report["input"]["paged_bytes"] >= 3 * 4 * 1500**2, report["input"])
            check(report["temporary_files"]["files_at_a_time"] <= 4, report["temporary_files"])  # textures, triangles, bins of two rounds
    compare(folder, mesh, "32M", 32 << 20, "--depth", "8", "--threads", "3", "--attributes", "color,normal,coverage", "--reference", "0")
    for mesh in (folder / "m.gltf", mesh):
        r = tool("svo-voxelize", mesh, "-o", folder / "a.svo", "-f", "--depth", "8", "--memory", "24M", "--temp-size", "20M")
        check(r.code == 6 and "texture" in r.err and "20971520" in r.err, r)


def test_gltf_larger_than_memory(folder):
    mesh = textured_sheets(folder, 1, 64, 400, True)
    report = compare(folder, mesh, "20M", 20 << 20, "--depth", "8", "--reference", "0")
    check(report["input"]["spilled_triangles"] == 320000, report["input"])


def strip_gltf(path, rows, columns, skinned):
    """One strip to and fro, without indices: quantised positions with normals and colours of bytes, or skinned ones."""
    points, normals, colours, joints, weights = array.array("h"), array.array("b"), array.array("B"), array.array("B"), array.array("B")
    for y in range(rows):
        for x in range(columns):
            for k in range(2):
                points.extend((int(32767 * x / columns), (x * 31 + y * 17) % 400, int(32767 * (y + k) / rows), 0))
                normals.extend((x % 50, 120, y % 70, 0))
                colours.extend((x % 256, y % 256, (x * y) % 256, 255))
                joints.extend((0, 1, 0, 0))
                weights.extend((255 - x % 256, x % 256, 0, 0))
    count = 2 * rows * columns
    lists = [("POSITION", points, 5122, "VEC3", True), ("NORMAL", normals, 5120, "VEC3", True), ("COLOR_0", colours, 5121, "VEC4", True)]
    if skinned:
        lists[2:] = [("JOINTS_0", joints, 5121, "VEC4", False), ("WEIGHTS_0", weights, 5121, "VEC4", True)]
    binary, views, accessors = b"", [], []
    for i, (_, values, component, kind, normalized) in enumerate(lists):
        data = values.tobytes()
        views.append({"buffer": 0, "byteOffset": len(binary), "byteLength": len(data), "byteStride": len(data) // count})
        accessors.append({"bufferView": i, "componentType": component, "count": count, "type": kind, "normalized": normalized})
        binary += data
    accessors[0].update(min=[0, 0, 0], max=[32767, 400, 32767])
    gltf = {"asset": {"version": "2.0"}, "extensionsUsed": ["KHR_mesh_quantization"], "extensionsRequired": ["KHR_mesh_quantization"],
            "buffers": [{"uri": "strip.bin", "byteLength": len(binary)}], "bufferViews": views, "accessors": accessors,
            "meshes": [{"primitives": [{"mode": 5, "attributes": {l[0]: i for i, l in enumerate(lists)}}]}],
            "nodes": [dict({"mesh": 0}, **({"skin": 0} if skinned else {})), {"translation": [0, 0.5, 0]}, {"rotation": [0, 0.6, 0, 0.8]}],
            "scenes": [{"nodes": [0, 1, 2]}], "scene": 0}
    if skinned:
        gltf["skins"] = [{"joints": [1, 2]}]
    (path.parent / "strip.bin").write_bytes(binary)
    path.write_text(json.dumps(gltf))


def test_kinds_of_gltf_larger_than_memory(folder):
    for skinned in (False, True):
        strip_gltf(folder / "strip.gltf", 260, 600, skinned)
        report = compare(folder, folder / "strip.gltf", "18M", 18 << 20, "--depth", "8", "--reference", "0")
        check(report["input"]["spilled_triangles"] == 2 * 260 * 600 - 2, report["input"])
    with open(folder / "strip.gltf") as f:
        gltf = json.load(f)
    gltf["accessors"][0]["count"] -= 1
    (folder / "strip.gltf").write_text(json.dumps(gltf))
    a = tool("svo-voxelize", folder / "strip.gltf", "-o", folder / "x.svo", "--depth", "8")
    b = tool("svo-voxelize", folder / "strip.gltf", "-o", folder / "x.svo", "--depth", "8", "--memory", "18M")
    check(a.code == 3 and b.code == 3 and a.err == b.err, str(a) + str(b))


def test_json_larger_than_memory(folder):
    """What cannot be kept outside of memory is refused by name, and does not take more than is allowed where it is not."""
    nodes = [{"mesh": 0, "name": "node %d" % i, "translation": [i % 100, i // 100, 0], "scale": [0.5, 0.5, 0.5]} for i in range(40000)]
    points = struct.pack("<9f", 0, 0, 0, 1, 0, 0, 0, 1, 0)
    gltf = {"asset": {"version": "2.0"}, "buffers": [{"uri": "data:application/octet-stream;base64," + base64.b64encode(points).decode(), "byteLength": 36}],
            "bufferViews": [{"buffer": 0, "byteLength": 36}], "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3", "min": [0, 0, 0], "max": [1, 1, 0]}],
            "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}], "nodes": nodes, "scenes": [{"nodes": list(range(40000))}], "scene": 0}
    (folder / "m.gltf").write_text(json.dumps(gltf))
    r = tool("svo-voxelize", folder / "m.gltf", "-o", folder / "a.svo", "--depth", "7", "--memory", "40M")
    check(r.code == 6 and "JSON" in r.err, r)
    compare(folder, folder / "m.gltf", "128M", 128 << 20, "--depth", "7")


def test_materials_that_change(folder):
    png(folder / "large.png", 6000)
    (folder / "m.obj").write_text("mtllib m.mtl\nusemtl a\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nf 1/1 2/1 3/1\n")
    seen = False
    for attempt in range(8):
        (folder / "m.mtl").write_text("newmtl a\nmap_Kd large.png\n")
        p = subprocess.Popen([str(support.tools / "svo-voxelize"), str(folder / "m.obj"), "-o", str(folder / "a.svo"), "-f", "--depth", "4"], stderr=subprocess.PIPE)
        time.sleep(0.04 * (attempt + 1))  # the texture takes longer than that
        (folder / "m.mtl").write_text("newmtl b\nmap_Kd large.png\n")
        err = p.communicate(timeout=60)[1].decode()
        check(p.returncode in (0, 2), "%d %s" % (p.returncode, err))
        if p.returncode == 2:
            check("m.mtl" in err and "changed" in err, err)
            seen = True
            break
        (folder / "a.svo").unlink()
    check(seen, "no change was seen")


def test_a_reader_that_goes(folder):
    mesh = sheet(folder, "ply", 300000)
    p = subprocess.Popen([str(support.tools / "svo-voxelize"), str(mesh), "-o", "-", "--depth", "11", "--memory", "40M"], stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    p.stdout.read(100)
    p.stdout.close()
    err = p.stderr.read().decode()
    check(p.wait(120) == 2 and "pipe" in err, "%s %s" % (p.returncode, err))


def test_dry_run(folder):
    mesh = sheet(folder, "ply", 100000)
    for more in ([], ["--memory", "20M"], ["--voxel-size", "0.002"]):
        args = more + ([] if "--voxel-size" in more else ["--depth", "10"])
        r = tool("svo-voxelize", mesh, "--dry-run", "-o", folder / "a.svo", "--report", folder / "e.json", *args)
        check(r.code == 0 and "basis" in r.text, r)
        check(not (folder / "a.svo").exists())
        e = json.loads((folder / "e.json").read_text())["estimate"]
        r = tool("svo-voxelize", mesh, "-o", folder / "a.svo", "-f", "--report", folder / "r.json", *args)
        check(r.code == 0, r)
        o = json.loads((folder / "r.json").read_text())["output"]
        check(abs(e["voxels"] / o["voxels"] - 1) < 0.15, (e, o["voxels"]))
        check(abs(e["voxels_by_area"] / o["voxels"] - 1) < 0.15, (e, o["voxels"]))
        check(abs(e["bytes"] / o["bytes"] - 1) < 0.5, (e, o["bytes"]))
        check(e["seconds"] > 0 and e["memory_bytes"] > 0, e)
        (folder / "a.svo").unlink()


def test_twenty_million_triangles_in_512_megabytes(folder):
    """Minutes and gigabytes of disk, so only where SVOKIT_LARGE is set: surfaces in two formats, in order and with poor locality, and a solid."""
    if not os.environ.get("SVOKIT_LARGE"):
        skip("set SVOKIT_LARGE=1 (takes minutes and 6 GB of disk)")
    for kind, shuffled, shape in (("ply", True, "torus"), ("ply", False, None), ("ply", True, None), ("obj", False, None), ("obj", True, None)):
        mesh = sheet(folder, kind, 20000000, shuffled, shape)
        start = time.monotonic()
        report = limited(folder, mesh, "512M", "--depth", "12", "--attributes", "none", *(["--fill", "solid"] if shape else []))
        print(kind, shape or "sheet", "shuffled" if shuffled else "in order", "%.0f s" % (time.monotonic() - start), "%.0f MB resident" % (report["peak_rss_bytes"] / 1e6),
              report["temporary_files"], flush=True)
        check(report["peak_rss_bytes"] <= (512 << 20) + CONSTANT, report)
        mesh.unlink()


support.main(globals())
