"""Deformed scenes: pictures beside those of the mesh deformed by formula, extreme poses, budgets, damage."""

import json
import math
import struct

import support
from support import check, run, tool, read_png


def tall_box(path, move=lambda p: p, slices=48):
    """A box 0.5 x 2 x 1 with fine sides, each corner moved by a function."""
    out, quads = [], []
    for i in range(slices + 1):
        y = 2 * i / slices
        ring = [(-0.25 + 0.5 * t / 8, y, -0.5) for t in range(8)] + [(0.25, y, -0.5 + t / 8) for t in range(8)]
        ring += [(0.25 - 0.5 * t / 8, y, 0.5) for t in range(8)] + [(-0.25, y, 0.5 - t / 8) for t in range(8)]
        out += ring
    n = 32
    for i in range(slices):
        for k in range(n):
            a, b = i * n + k, i * n + (k + 1) % n
            quads.append((a, a + n, b + n, b))
    lines = ["v %.9g %.9g %.9g" % move(p) for p in out]
    lines += ["f " + " ".join(str(v + 1) for v in q) for q in quads]
    lines += ["f " + " ".join(str(slices * n + v + 1) for v in reversed(range(n))), "f " + " ".join(str(v + 1) for v in range(n))]
    path.write_text("\n".join(lines) + "\n")
    return path


def octree(folder, mesh, depth=8):
    out = folder / (mesh.stem + ".svdag")
    run("svo-voxelize", mesh, "-o", folder / "t.svo", "-f", "--depth", depth, "-q")
    run("svo-compress", folder / "t.svo", "-o", out, "-f", "-q")
    return out


VIEW = ["--size", "320x240", "--eye", "4,3,5", "--target", "0,1,0", "--fov", 40, "--background", "transparent"]


def mask(folder, file, *options):
    run("svo-render", file, "-o", folder / "m.png", "-f", *VIEW, *options)
    w, h, channels, pixels = read_png(folder / "m.png")
    flat = pixels if isinstance(pixels, (bytes, bytearray)) else b"".join(bytes(r) for r in pixels)
    return [a > 127 for a in flat[3::4]]


def twist(p, degrees=140):
    a = math.radians(degrees) * p[1] / 2
    return (math.sin(a) * p[2] + math.cos(a) * p[0], p[1], math.cos(a) * p[2] - math.sin(a) * p[0])


def bend(p, degrees=80):
    k = math.radians(degrees) / 2
    return (1 / k - (1 / k - p[0]) * math.cos(k * p[1]), (1 / k - p[0]) * math.sin(k * p[1]), p[2])


def shear(p, by=0.7):
    return (p[0] + by * p[1], p[1], p[2])


def test_pictures_are_those_of_the_deformed_mesh(folder):
    plain = octree(folder, tall_box(folder / "box.obj"))
    for name, function, option in (("twist", twist, "twist=y:140"), ("bend", bend, "bend=yx:80"), ("shear", shear, "shear=xy:0.7")):
        real = mask(folder, octree(folder, tall_box(folder / (name + ".obj"), function)))
        check(sum(real) > 3000, sum(real))
        for method in ("direct", "resize", "emit", "mipmap"):
            got = mask(folder, plain, "--deform", option, "--resample", method, *(["--no-shadows"] if method in ("direct", "mipmap") else []))
            both, either = sum(a and b for a, b in zip(real, got)), sum(a or b for a, b in zip(real, got))
            inside = lambda i: all(real[j] for j in (i - 1, i + 1, i - 320, i + 320) if 0 <= j < len(real))
            lost = sum(a and not b and inside(i) for i, (a, b) in enumerate(zip(real, got)))
            check(both / either > (0.9 if method == "mipmap" else 0.94), (name, method, both, either))
            check(lost <= 4, (name, method, lost, "pixels of the mesh are not covered"))


def test_save_svo(folder):
    plain = octree(folder, tall_box(folder / "box.obj"), 6)
    run("svo-render", plain, "-o", folder / "a.png", *VIEW, "--deform", "twist=y:90", "--save-svo", folder / "s.svo", "--footprint", 0, "--no-shadows", "--resample", "emit")
    run("svo-dump", folder / "s.svo", "--validate")
    run("svo-render", folder / "s.svo", "-o", folder / "b.png", *VIEW, "--footprint", 0, "--no-shadows")
    check((folder / "a.png").read_bytes() == (folder / "b.png").read_bytes(), "the saved octree gives another picture")
    r = tool("svo-render", plain, "-o", folder / "c.png", *VIEW, "--deform", "twist=y:90", "--save-svo", folder / "no.svo", "--resample", "direct")
    check(r.code == 1 and not (folder / "no.svo").exists(), r)


def test_wrong_deformations_are_usage_errors(folder):
    plain = octree(folder, tall_box(folder / "box.obj"), 4)
    for text in ("", "twist", "twist=y", "twist=w:3", "bend=yy:3", "shear=xy:nan", "scale=1:2", "twist=y:1,twist=x:1", "scale=1e39", "twist=y:1;"):
        r = tool("svo-render", plain, "-o", folder / "o.png", "--deform", text)
        check(r.code == 1 and not (folder / "o.png").exists(), (text, r))


def scene(folder, instances, assets=None, **more):
    (folder / "s.json").write_text(json.dumps({"assets": assets or [{"name": "a", "file": "box.svdag"}], **more, "instances": instances}))
    return folder / "s.json"


def draw(folder, *options, code=0, name="o"):
    r = tool("svo-render", folder / "s.svscene", "-o", folder / (name + ".png"), "-f", "--size", "160x120", "--report", folder / (name + ".json"), *options)
    check(r.code == code, r)
    return json.loads((folder / (name + ".json")).read_text())


def test_extreme_poses(folder):
    octree(folder, tall_box(folder / "box.obj"), 5)
    column = lambda *rows: [rows[r][c] if r < 3 else (1 if c == 3 else 0) for c in range(4) for r in range(4)]
    poses = {"singular": {"scale": [1, 0, 1]}, "a_point": {"scale": [0, 0, 0]}, "reflecting": {"scale": [-1, 1, 1]},
             "near_singular": {"matrix": column((1, 0, 0, 0), (0, 1, 1, 0), (0, 1, 1 + 1e-7, 0))}, "shear_1e6": {"shear": {"xy": 1e6}},
             "fifty_turns": {"twist": {"degrees": 18000}}, "folded": {"bend": {"axis": "y", "towards": "x", "degrees": 720}},
             "rest": {"twist": {"degrees": 0}}, "all_at_once": {"twist": {"degrees": 300}, "bend": {"axis": "y", "towards": "z", "degrees": 90}, "shear": {"xz": 2}, "scale": [1, 2, 0.1]}}
    for name, pose in poses.items():
        run("svo-pack", scene(folder, [{"asset": "a", "pose": pose}, {"asset": "a", "translation": [5, 0, 0]}]), "-o", folder / "s.svscene", "-f", "-q")
        for options in ((), ("--no-shadows",), ("--resample", "resize"), ("--no-shadows", "--resample", "emit"), ("--no-shadows", "--resample", "mipmap")):
            report = draw(folder, *options)
            if name != "rest":
                check(report["deformation"]["overflowed"] == 0 and report["deformation"]["instances"] >= 1, (name, report["deformation"]))
                check(report["deformation"]["selected"] > 0 or name in ("shear_1e6",) or "--no-shadows" in options, (name, report["deformation"]))


def test_voxels_leave_the_root_cube(folder):
    """A pose that takes the shape forty times its size away, half of it out of its grid, or all of it onto the other side: the picture is that of an instance put there."""
    octree(folder, tall_box(folder / "box.obj"), 6)
    for x, y, z in ((40, 0, 0), (0.3, 1, 0), (-81, -3, 17)):
        shown = []
        for instance in ({"asset": "a", "pose": {"matrix": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, x, y, z, 1]}}, {"asset": "a", "translation": [x, y, z]}):
            run("svo-pack", scene(folder, [instance]), "-o", folder / "s.svscene", "-f", "-q")
            run("svo-dump", folder / "s.svscene", "--validate")
            run("svo-render", folder / "s.svscene", "-o", folder / "m.png", "-f", "--size", "160x120", "--background", "transparent", "--no-shadows", "--resample", "direct",
                "--eye", "%g,%g,%g" % (4 + x, 3 + y, 5 + z), "--target", "%g,%g,%g" % (x, 1 + y, z))
            w, h, channels, pixels = read_png(folder / "m.png")
            flat = pixels if isinstance(pixels, (bytes, bytearray)) else b"".join(bytes(r) for r in pixels)
            shown.append([a > 127 for a in flat[3::4]])
        both, either = sum(a and b for a, b in zip(*shown)), sum(a or b for a, b in zip(*shown))
        check(both > 800 and both / either > 0.97, ((x, y, z), both, either))


def test_extreme_cameras(folder):
    """Eyes in a voxel, on a face of one, on an edge of the grid and where rays run along axes, with a needle's eye and nearly half of everything."""
    octree(folder, tall_box(folder / "box.obj"), 5)
    run("svo-pack", scene(folder, [{"asset": "a", "pose": {"twist": {"degrees": 180, "from": 1, "to": 2}}}, {"asset": "a", "translation": [0, 0, -3], "pose": {"bend": {"axis": "y", "towards": "x", "degrees": 60}}}]),
        "-o", folder / "s.svscene", "-f", "-q")
    eyes = {"in_a_voxel": ("0.24,0.53,0.1", "5,0.5,0"), "on_a_face": ("0.25,0.5,0", "0,0.5,0"), "on_an_edge": ("0.25,0.5,0.5", "0.25,0.5,-9"), "along_an_axis": ("0,0.5,9", "0,0.5,0"),
            "from_above": ("0,9,0", "0,0,0"), "far_away": ("0,1,1e6", "0,1,0")}
    for name, (eye, target) in eyes.items():
        up = ["--up", "0,0,-1"] if name == "from_above" else []
        for fov in (0.001, 40, 179):
            for method in ("direct", "resize", "emit", "mipmap"):
                draw(folder, "--eye", eye, "--target", target, "--fov", fov, "--resample", method, "--no-shadows", *up)
    # an eye that looks along an axis at the first one sees it in the middle of the picture
    report = draw(folder, "--eye", "0,0.5,9", "--target", "0,0.5,0", "--no-shadows")
    check(report["rays"]["primary"]["hits"] > 100, report["rays"])


def test_scales_of_1e_6_and_1e6_in_one_scene(folder):
    octree(folder, tall_box(folder / "box.obj"), 5)
    pose = {"twist": {"degrees": 90}}
    run("svo-pack", scene(folder, [{"asset": "a", "scale": [1e-6] * 3, "pose": pose}, {"asset": "a", "scale": [1e6] * 3, "translation": [0, 0, -3e6], "pose": pose}]), "-o", folder / "s.svscene", "-q")
    for options in ((), ("--no-shadows",)):
        check(draw(folder, *options, "--eye", "0,1e-6,5e-6", "--target", "0,1e-6,0")["deformation"]["instances_seen"] == 2, "one of them is not seen")
        check(draw(folder, *options, "--eye", "2e6,2e6,3e6", "--target", "0,1e6,-3e6")["rays"]["primary"]["hits"] > 1000, "the large one is not seen")


def test_zero_instances_empty_assets_and_a_crowd_in_one_place(folder):
    octree(folder, tall_box(folder / "box.obj"), 5)
    run("svo-pack", scene(folder, []), "-o", folder / "s.svscene", "-f", "-q")
    draw(folder)
    (folder / "empty.obj").write_text("v 0 0 0\n")
    run("svo-pack", scene(folder, [{"asset": "e", "pose": {"twist": {"degrees": 9}}}], [{"name": "e", "file": "empty.obj"}]), "-o", folder / "s.svscene", "-f", "-q")
    draw(folder)
    crowd = [{"asset": "a", "pose": "p"}] * 20000 + [{"asset": "a", "pose": {"twist": {"degrees": i % 7}}} for i in range(700)]
    r = folder / "pack.json"
    run("svo-pack", scene(folder, crowd, poses=[{"name": "p", "twist": {"degrees": 90}}]), "-o", folder / "s.svscene", "-f", "-q", "--report", r)
    out = json.loads(r.read_text())["output"]
    check(out["poses"] == 7, out)  # one shared, six of their own; no turn is no pose
    report = draw(folder, "--no-shadows")
    check(report["rays"]["primary"]["hits"] > 100, report["rays"])


def test_a_damaged_page_leaves_the_rest(folder):
    octree(folder, tall_box(folder / "box.obj"), 5)
    row = [{"asset": "a", "translation": [2 * i, 0, 0], "pose": {"twist": {"degrees": 10 * i}}} for i in range(12)]
    run("svo-pack", scene(folder, row), "-o", folder / "s.svscene", "--page", 4, "-q")
    whole = draw(folder, name="whole")
    data = bytearray((folder / "s.svscene").read_bytes())
    at = data.find(b"IXFM")
    data[at + 64 + 48 * 5:at + 64 + 48 * 6] = bytes(48)  # an instance of the second page is missing
    (folder / "s.svscene").write_bytes(bytes(data))
    part = draw(folder, code=3, name="part")
    check((folder / "part.png").exists() and part["input"]["pages_damaged"] == 1 and part["input"]["instances_damaged"] == 4, part["input"])
    check(0 < part["rays"]["primary"]["hits"] < whole["rays"]["primary"]["hits"], "the rest is not drawn")


def test_threads_do_not_matter(folder):
    octree(folder, tall_box(folder / "box.obj"), 6)
    row = [{"asset": "a", "translation": [0.7 * (i % 9), 0, 2 * (i // 9)], "pose": {"twist": {"degrees": 10 * i}}} for i in range(60)]
    run("svo-pack", scene(folder, row), "-o", folder / "s.svscene", "-q")
    for options in ((), ("--no-shadows",), ("--no-shadows", "--resample", "resize")):
        pictures = []
        for threads in (1, 3):
            draw(folder, *options, "--threads", threads)
            pictures.append((folder / "o.png").read_bytes())
        check(pictures[0] == pictures[1], options)


def test_turntable_and_path_of_what_is_deformed(folder):
    octree(folder, tall_box(folder / "box.obj"), 6)
    row = [{"asset": "a", "translation": [1.5 * i, 0, 0], "pose": {"twist": {"degrees": 60 * i}}} for i in range(3)] + [{"asset": "a", "translation": [-2, 0, 1]}]
    run("svo-pack", scene(folder, row), "-o", folder / "s.svscene", "-q")
    cameras = [("4,3,5", "0,1,0"), ("-6,2,1", "1,0,0")]
    (folder / "path.txt").write_text("".join("%s %s\n" % (e.replace(",", " "), t.replace(",", " ")) for e, t in cameras))
    for end, options in (("png", ()), ("png", ("--no-shadows",)), ("png", ("--resample", "mipmap", "--no-shadows")), ("exr", ())):
        run("svo-render", folder / "s.svscene", "-o", folder / ("f." + end), "-f", "-q", "--size", "96x64", "--path", folder / "path.txt", "--fov", 40, *options)
        for i, (eye, target) in enumerate(cameras):  # each as it is alone
            run("svo-render", folder / "s.svscene", "-o", folder / ("one." + end), "-f", "-q", "--size", "96x64", "--eye", eye, "--target", target, "--fov", 40, *options)
            check((folder / ("f_%04d.%s" % (i, end))).read_bytes() == (folder / ("one." + end)).read_bytes(), (end, options, i))
    run("svo-render", folder / "box.svdag", "-o", folder / "t.png", "-q", "--size", "96x64", "--deform", "twist=y:90", "--turntable", 3)
    pictures = {(folder / ("t_%04d.png" % i)).read_bytes() for i in range(3)}
    check(len(pictures) == 3 and not (folder / "t.png").exists(), "three different pictures")
    r = tool("svo-render", folder / "s.svscene", "-o", folder / "n.png", "--turntable", 2, "--save-svo", folder / "n.svo")
    check(r.code == 1 and not list(folder.glob("n*.png")), r)


def test_budget_and_view_distance(folder):
    support.sphere_obj(folder / "ball.obj", 48)
    (folder / "s.json").write_text(json.dumps({"assets": [{"name": "a", "file": "ball.obj"}], "instances": [{"asset": "a"}]}))
    depth = {}
    for size in (10000, 100000, 1000000):
        run("svo-pack", folder / "s.json", "-o", folder / "b.svscene", "-f", "-q", "--budget", size, "--report", folder / "r.json")
        out = json.loads((folder / "r.json").read_text())["output"]
        check((folder / "b.svscene").stat().st_size <= size, (size, out["bytes"]))
        depth[size] = out["asset_list"][0]["depth"]
        tried = {t["depth"]: t["bytes"] for t in out["budget_tried"]}
        check(depth[size] + 1 not in tried or tried[depth[size] + 1] > size, (size, out["budget_tried"]))
    check(depth[10000] < depth[100000] < depth[1000000], depth)
    r = tool("svo-pack", folder / "s.json", "-o", folder / "c.svscene", "--budget", 300)
    check(r.code == 6 and not (folder / "c.svscene").exists(), r)
    found = []
    for distance in (200, 50):  # a quarter of the distance: two levels more
        run("svo-pack", folder / "s.json", "-o", folder / "v.svscene", "-f", "-q", "--view-distance", distance, "--report", folder / "r.json")
        found.append(json.loads((folder / "r.json").read_text())["output"]["asset_list"][0]["depth"])
    check(found[1] == found[0] + 2, found)
    check(tool("svo-pack", folder / "s.json", "-o", folder / "v.svscene", "-f", "--view-distance", 1, "--depth", 3).code == 1, "both were taken")


support.main(globals())
