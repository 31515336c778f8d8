"""svo-render: pictures from files, cameras, threads, reports and every exit code."""

import json
import math
import shutil
import struct
import subprocess
import zlib

import support
from support import check, run, tool


def read_png(data):
    """(width, height, channels, rows) of an 8-bit RGB or RGBA PNG, filters undone."""
    check(data[:8] == b"\x89PNG\r\n\x1a\n", data[:16])
    at, idat, header = 8, b"", None
    while at < len(data):
        size, kind = struct.unpack(">I4s", data[at:at + 8])
        body = data[at + 8:at + 8 + size]
        check(zlib.crc32(kind + body) == struct.unpack(">I", data[at + 8 + size:at + 12 + size])[0], kind)
        if kind == b"IHDR":
            header = struct.unpack(">IIBBBBB", body)
        if kind == b"IDAT":
            idat += body
        at += 12 + size
    width, height, depth, color = header[:4]
    check(depth == 8 and color in (2, 6), header)
    channels = 3 if color == 2 else 4
    raw, stride, rows, above = zlib.decompress(idat), width * channels, [], bytes(width * channels)
    for y in range(height):
        kind, line = raw[y * (stride + 1)], bytearray(raw[y * (stride + 1) + 1:(y + 1) * (stride + 1)])
        for i in range(stride):
            left = line[i - channels] if i >= channels else 0
            corner = above[i - channels] if i >= channels else 0
            up = above[i]
            if kind == 1:
                line[i] = (line[i] + left) & 255
            elif kind == 2:
                line[i] = (line[i] + up) & 255
            elif kind == 3:
                line[i] = (line[i] + (left + up) // 2) & 255
            elif kind == 4:
                p = left + up - corner
                pa, pb, pc = abs(p - left), abs(p - up), abs(p - corner)
                line[i] = (line[i] + (left if pa <= pb and pa <= pc else up if pb <= pc else corner)) & 255
        rows.append(bytes(line))
        above = rows[-1]
    return width, height, channels, rows


def cube(folder, depth=5, color=(1.0, 0.2, 0.1)):
    """A coloured unit cube as .svo; skipped where the voxelizer has not been built."""
    if not support.have("svo-voxelize"):
        support.skip("svo-voxelize is not built")
    support.cube_obj(folder / "cube.obj", color=color)
    run("svo-voxelize", folder / "cube.obj", "-o", folder / "cube.svo", "--depth", depth)
    return folder / "cube.svo"


def packed(folder, **more):
    if not support.have("svo-compress"):
        support.skip("svo-compress is not built")
    svo = cube(folder, **more)
    run("svo-compress", svo, "-o", folder / "cube.svdag")
    return folder / "cube.svdag"


def test_picture_of_a_cube(folder):
    svo = cube(folder)
    r = run("svo-render", svo, "-o", folder / "a.png", "--size", "96x64", "--eye", "0.5,0.5,4", "--target", "0.5,0.5,0",
            "--fov", 40, "--light", "0,0,1", "--ambient", 0, "--report", folder / "r.json")
    width, height, channels, rows = read_png((folder / "a.png").read_bytes())
    check((width, height, channels) == (96, 64, 3), (width, height, channels))
    # the middle of the picture shows the cube's front in its own colour: sRGB of the linear factors that MTL holds
    pixel = rows[32][48 * 3:48 * 3 + 3]
    check(pixel[0] > 250 and pixel[1] < 140 and pixel[2] < 120 and pixel[0] > pixel[1] > pixel[2], tuple(pixel))
    # and it is where the projection says: the front face (z = 1, 3 away) has half height 0.5 / 3 / tan 20 of the half picture
    half = 0.5 / 3 / 0.36397 * 32
    red = [y for y in range(64) if rows[y][48 * 3] > 1.5 * rows[y][48 * 3 + 2]]
    check(abs(len(red) - 2 * half) <= 2.5, (len(red), 2 * half))
    report = support.report(folder / "r.json")
    check(report["errors"]["stop_rule_holds"] is True, report["errors"])
    check(report["rays"]["primary"]["rays"] == 96 * 64, report["rays"])
    check(report["output"]["bytes"] == (folder / "a.png").stat().st_size, report["output"])
    check(report["camera"]["from"] == "given", report["camera"])
    check({"open", "hierarchy", "render", "write"} <= {p["name"] for p in report["phases"]}, report["phases"])
    check(sum(report["levels"]["hits"]) == report["rays"]["primary"]["hits"], report["levels"])


def test_svo_svdag_and_pipe_give_one_picture(folder):
    dag = packed(folder)
    for name, source, stdin in (("a", folder / "cube.svo", b""), ("b", dag, b""), ("c", "-", dag.read_bytes()), ("d", "-", (folder / "cube.svo").read_bytes())):
        run("svo-render", source, "-o", folder / (name + ".png"), "--size", "80x60", stdin=stdin)
    first = (folder / "a.png").read_bytes()
    for name in "bcd":
        check((folder / (name + ".png")).read_bytes() == first, name)
    r = run("svo-render", dag, "-o", "-", "--size", "80x60")
    check(r.out == first, r)


def test_threads_do_not_matter(folder):
    dag = packed(folder)
    pictures = {run("svo-render", dag, "-o", "-", "--size", "160x90", "--samples", 2, "--threads", n).out for n in (1, 2, 7)}
    check(len(pictures) == 1, len(pictures))


def test_background(folder):
    dag = packed(folder)
    r = run("svo-render", dag, "-o", "-", "--size", "40x30", "--background", "transparent")
    width, height, channels, rows = read_png(r.out)
    check(channels == 4 and rows[0][3] == 0 and rows[15][20 * 4 + 3] == 255, rows[15])
    r = run("svo-render", dag, "-o", "-", "--size", "40x30", "--background", "10,200,30")
    check(read_png(r.out)[3][0][:3] == bytes((10, 200, 30)), "background")


def test_extreme_cameras(folder):
    dag = packed(folder)
    for options in (("--fov", "0.001"), ("--fov", "179"), ("--size", "1x1"), ("--size", "1x200"),
                    ("--eye", "0.5,0.5,0.5", "--target", "0,0,0"), ("--eye", "1,1,1", "--target", "0,1,1"),
                    ("--eye", "0.5,9,0.5", "--target", "0.5,0,0.5"), ("--eye", "1e9,0,0"), ("--footprint", "0"), ("--target", "0,0,0"),
                    ("--samples", "16", "--size", "4x4"), ("--no-shadows",), ("--up", "0,0,1")):
        args = options if "--size" in options else options + ("--size", "32x32")
        r = run("svo-render", dag, "-o", "-", *args)
        read_png(r.out)


def test_scene(folder):
    if not support.have("svo-pack"):
        support.skip("svo-pack is not built")
    packed(folder)
    (folder / "s.json").write_text(json.dumps({
        "assets": [{"name": "a", "file": "cube.svdag"}],
        "instances": [{"asset": "a"}, {"asset": "a", "translation": [2, 0, 0]}, {"asset": "a", "translation": [0, 0, -3], "scale": [-1, 2, 1]}]}))
    run("svo-pack", folder / "s.json", "-o", folder / "s.svscene")
    run("svo-render", folder / "s.svscene", "-o", folder / "s.png", "--size", "120x80", "--report", folder / "r.json")
    report = support.report(folder / "r.json")
    check(report["input"]["kind"] == "svscene" and report["input"]["instances"] == 3 and report["input"]["instances_placed"] == 3, report["input"])
    check(report["rays"]["primary"]["hits"] > 500 and report["camera"]["from"] == "framed", report)
    # a scene in a pipe
    r = run("svo-render", "-", "-o", "-", "--size", "120x80", stdin=(folder / "s.svscene").read_bytes())
    check(r.out == (folder / "s.png").read_bytes(), "pipe")


def test_nothing_to_draw(folder):
    if not (support.have("svo-pack") and support.have("svo-voxelize")):
        support.skip("svo-pack or svo-voxelize is not built")
    (folder / "s.json").write_text('{"assets": [], "instances": []}')
    run("svo-pack", folder / "s.json", "-o", folder / "s.svscene")
    r = run("svo-render", folder / "s.svscene", "-o", folder / "s.png", "--size", "10x10")
    check("nothing to draw" in r.err, r)
    check(len(set(read_png((folder / "s.png").read_bytes())[3][0][i:i + 3] for i in range(0, 30, 3))) == 1, "a background row of one colour")


def test_exit_codes(folder):
    garbage = folder / "garbage.svdag"
    garbage.write_bytes(b"this is no octree" * 20)
    out = folder / "out.png"
    cases = [
        (1, [garbage, "-o", out, "--size", "0x4"]), (1, [garbage, "-o", out, "--size", "12"]), (1, [garbage, "-o", out, "--size", "1x2x3"]),
        (1, [garbage, "-o", out, "--light", "0,0,0"]), (1, [garbage, "-o", out, "--background", "1,2"]), (1, [garbage, "-o", out, "--background", "1,2,256"]),
        (1, [garbage, "-o", out, "--fov", "180"]), (1, [garbage, "-o", out, "--samples", "17"]), (1, [garbage]), (1, ["-o", out]), (1, [garbage, "-o", out, "--nonsense"]),
        (2, [folder / "missing.svdag", "-o", out]), (2, [garbage, "-o", folder / "no" / "such" / "folder.png"]),
        (3, [garbage, "-o", out]), (5, [garbage, "-o", folder / "out.jpg"]),
        (0, ["--help"]), (0, ["--version"])]
    for code, args in cases:
        r = tool("svo-render", *args)
        check(r.code == code, "expected %d: %s" % (code, r))
        check(code == 0 or r.err.startswith("svo-render: "), r)
        check(not out.exists(), "a failed run left a file")
    out.write_bytes(b"precious")
    r = tool("svo-render", garbage, "-o", out)
    check(r.code == 2 and out.read_bytes() == b"precious", r)
    out.unlink()
    dag = packed(folder)
    check(tool("svo-render", dag, "-o", out, "--size", "65536x65536").code == 6, "too large a picture")
    check(tool("svo-render", dag, "-o", out, "--size", "4000x4000", "--memory", "1M").code == 6, "too little memory")
    check(tool("svo-render", dag, "-o", out, "--eye", "1,1,1", "--target", "1,1,1").code == 1, "no direction")
    check(not out.exists(), "a failed run left a file")


def test_damaged_files(folder):
    dag = packed(folder)
    good = dag.read_bytes()
    for at in list(range(0, len(good), max(1, len(good) // 40))) + [len(good) - 1]:
        bad = bytearray(good)
        bad[at] ^= 0x41
        (folder / "bad.svdag").write_bytes(bad)
        r = tool("svo-render", folder / "bad.svdag", "-o", folder / "bad.png", "--size", "8x8")
        check(r.code in (3, 5), "byte %d: %s" % (at, r))
        (folder / "bad.svdag").write_bytes(good[:at])
        r = tool("svo-render", folder / "bad.svdag", "-o", folder / "bad.png", "--size", "8x8")
        check(r.code == 3, "cut at %d: %s" % (at, r))
        check(not (folder / "bad.png").exists(), "a failed run left a file")


def read_exr(data):
    """{channel: rows} of an uncompressed scan-line OpenEXR file, by the published layout."""
    check(struct.unpack_from("<II", data) == (20000630, 2), data[:8])
    at, channels, window = 8, [], None

    def text(i):
        end = data.index(b"\0", i)
        return data[i:end].decode(), end + 1
    while data[at] != 0:
        name, at = text(at)
        kind, at = text(at)
        size = struct.unpack_from("<I", data, at)[0]
        at += 4
        body = data[at:at + size]
        if name == "channels":
            i = at
            while data[i] != 0:
                channel, i = text(i)
                channels.append((channel, "f" if struct.unpack_from("<I", data, i)[0] == 2 else "I"))
                i += 16
        if name == "dataWindow":
            window = struct.unpack("<4i", body)
        if name == "compression":
            check(body == b"\0", body)
        at += size
    width, height = window[2] + 1, window[3] + 1
    check(channels == sorted(channels), channels)
    planes = {name: [] for name, _ in channels}
    for y, place in enumerate(struct.unpack_from("<%dQ" % height, data, at + 1)):
        check(struct.unpack_from("<iI", data, place) == (y, 4 * width * len(channels)), y)
        for i, (name, code) in enumerate(channels):
            planes[name].append(struct.unpack_from("<%d%s" % (width, code), data, place + 8 + 4 * width * i))
    check(len(data) == place + 8 + 4 * width * len(channels), len(data))
    return planes


def test_planes_of_numbers(folder):
    svo = cube(folder)
    run("svo-render", svo, "-o", folder / "a.exr", "--size", "96x64", "--eye", "0.5,0.5,4", "--target", "0.5,0.5,0", "--fov", 40)
    planes = read_exr((folder / "a.exr").read_bytes())
    check(sorted(planes) == sorted(["R", "G", "B", "A", "Z", "N.X", "N.Y", "N.Z", "level", "instance", "bone"]), sorted(planes))
    hit, miss = (32, 48), (2, 2)
    value = {name: rows[hit[0]][hit[1]] for name, rows in planes.items()}
    nothing = {name: rows[miss[0]][miss[1]] for name, rows in planes.items()}
    check(abs(value["Z"] - 3) < 0.07, value)  # the front, to a voxel
    check(value["N.Z"] > 0.99 and abs(value["N.X"]) < 0.1, value)
    check(value["level"] == 5 and value["instance"] == 0 and value["bone"] == 0xffffffff and value["A"] == 1, value)
    check(value["R"] > value["G"] > value["B"] > 0, value)
    check(nothing["A"] == 0 and math.isinf(nothing["Z"]) and nothing["level"] == nothing["instance"] == 0xffffffff, nothing)
    if shutil.which("exrmaketiled"):  # the reference implementation takes it, pixels and all
        r = subprocess.run(["exrmaketiled", str(folder / "a.exr"), str(folder / "tiled.exr")], capture_output=True)
        check(r.returncode == 0, r.stderr)


def test_turntable_and_path(folder):
    dag = packed(folder)
    run("svo-render", dag, "-o", folder / "t.png", "--size", "64x64", "--turntable", 4, "--background", "transparent", "--no-shadows", "--light", "0,1,0")
    frames = [read_png((folder / ("t_%04d.png" % i)).read_bytes()) for i in range(4)]
    check(not (folder / "t.png").exists() and not (folder / "t_0004.png").exists(), "one file a frame")
    # a cube looks the same after a quarter of a turn, but for cells at the rim
    for f in frames:
        check(f[:3] == (64, 64, 4), f[:3])
        alpha = [[row[4 * x + 3] for x in range(64)] for row in f[3]]
        check(not any(alpha[0]) and not any(alpha[63]) and not any(row[0] or row[63] for row in alpha), "the cube is cut off")
        covered = sum(map(bool, sum(alpha, [])))
        check(abs(covered - sum(1 for row in frames[0][3] for x in range(64) if row[4 * x + 3])) < 60, covered)
    (folder / "path.txt").write_text("# a comment\n0.5 0.5 4 0.5 0.5 0\n\n0.5 0.5 4  0.5 0.5 0  20 # closer\n")
    run("svo-render", dag, "-o", folder / "p.png", "--size", "48x32", "--path", folder / "path.txt", "--fov", 40)
    run("svo-render", dag, "-o", folder / "q.png", "--size", "48x32", "--eye", "0.5,0.5,4", "--target", "0.5,0.5,0", "--fov", 40)
    check((folder / "p_0000.png").read_bytes() == (folder / "q.png").read_bytes(), "the first line's camera")
    check((folder / "p_0001.png").read_bytes() != (folder / "q.png").read_bytes(), "the second line's field of view")
    for code, content in ((3, "1 2 3\n"), (3, "1 2 3 4 5 6 7 8\n"), (3, "nan 0 0 1 1 1\n"), (3, "1 1 1 1 1 1\n"), (3, ""), (3, "0 0 0 1 1 1 180\n")):
        (folder / "bad.txt").write_text(content)
        r = tool("svo-render", dag, "-o", folder / "bad.png", "--path", folder / "bad.txt")
        check(r.code == code and not list(folder.glob("bad*.png")), (content, r))
    check(tool("svo-render", dag, "-o", folder / "bad.png", "--path", folder / "missing.txt").code == 2, "no such path")
    check(tool("svo-render", dag, "-o", folder / "bad.png", "--path", folder / "path.txt", "--turntable", 2).code == 1, "both")


def test_light_by_way_of_surfaces(folder):
    dag = packed(folder, depth=6)
    common = [dag, "--size", "64x48", "--ambient", 1, "--no-shadows"]
    # a convex body sees nothing but the sky: rays give what the formula for even light gives, but for noise
    run("svo-render", *common, "-o", folder / "even.exr")
    run("svo-render", *common, "-o", folder / "rays.exr", "--bounce", 8)
    even, rays = (read_exr((folder / name).read_bytes()) for name in ("even.exr", "rays.exr"))
    ratios = [b / a for row_a, row_b in zip(even["R"], rays["R"]) for a, b in zip(row_a, row_b) if a > 0]
    mean = sum(ratios) / len(ratios)
    check(len(ratios) > 200 and abs(mean - 1) < 0.02, (len(ratios), mean))
    spread = math.sqrt(sum((x - mean) ** 2 for x in ratios) / len(ratios))
    run("svo-render", *common, "-o", folder / "few.exr", "--bounce", 2)
    few = read_exr((folder / "few.exr").read_bytes())
    coarse = [b / a for row_a, row_b in zip(even["R"], few["R"]) for a, b in zip(row_a, row_b) if a > 0]
    mean = sum(coarse) / len(coarse)
    check(math.sqrt(sum((x - mean) ** 2 for x in coarse) / len(coarse)) > 2 * spread, "more rays, less noise")
    # reflectance mixes in what the mirror shows, and threads change nothing
    for threads in (1, 2):
        run("svo-render", dag, "-o", folder / ("m%d.png" % threads), "--size", "64x48", "--bounce", 2, "--reflectance", 0.5, "--threads", threads)
    check((folder / "m1.png").read_bytes() == (folder / "m2.png").read_bytes(), "threads")
    run("svo-render", dag, "-o", folder / "plain.png", "--size", "64x48", "--bounce", 2)
    check((folder / "m1.png").read_bytes() != (folder / "plain.png").read_bytes(), "nothing is mirrored")


support.main(globals())
