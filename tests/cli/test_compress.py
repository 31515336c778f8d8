"""svo-compress: the files as an independent reader sees them, error bounds, reports, exit codes, same bytes."""

import json
import math
import pathlib
import struct
import sys

import support
from support import check, run, tool

sys.path.insert(0, str(pathlib.Path(__file__).parent))
from svdag_reader import Svdag, decode_normal


def octree(folder, depth=5, texture=True):
    """A .svo with colours (a texture of many) and normals, and its voxels."""
    png = support.write_png(None, 64, 64, lambda x, y: (x * 4, y * 4, (x * y) % 256)) if texture else None
    support.cube_glb(folder / "cube.glb", texture=png)
    svo = folder / "cube.svo"
    run("svo-voxelize", folder / "cube.glb", "-o", svo, "--depth", depth, "-f")
    return svo, voxels(folder, svo)


def voxels(folder, path):
    run("svo-dump", path, "--voxels", folder / "v.ply", "-f")
    return support.ply_voxels(folder / "v.ply")


def compress(svo, *args):
    out = svo.with_suffix(".svdag")
    run("svo-compress", svo, "-o", out, "-f", "--report", out.with_suffix(".json"), *args)
    return out, support.report(out.with_suffix(".json"))


def srgb_to_linear(v):
    c = v / 255
    return c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4


def lab(rgb):
    r, g, b = (srgb_to_linear(v) for v in rgb)
    x = (0.4124564 * r + 0.3575761 * g + 0.1804375 * b) / 0.9504700
    y = 0.2126729 * r + 0.7151522 * g + 0.0721750 * b
    z = (0.0193339 * r + 0.1191920 * g + 0.9503041 * b) / 1.0888300
    f = lambda t: t ** (1 / 3) if t > 216 / 24389 else (24389 / 27 * t + 16) / 116
    return 116 * f(y) - 16, 500 * (f(x) - f(y)), 200 * (f(y) - f(z))


def delta_e94(one, two):
    l1, a1, b1 = lab(one)
    l2, a2, b2 = lab(two)
    c1, c2 = math.hypot(a1, b1), math.hypot(a2, b2)
    dc = c1 - c2
    dh2 = max(0, (a1 - a2) ** 2 + (b1 - b2) ** 2 - dc * dc)
    return math.sqrt((l1 - l2) ** 2 + (dc / (1 + 0.045 * c1)) ** 2 + dh2 / (1 + 0.015 * c1) ** 2)


def degrees(a, b):
    chord = math.sqrt(sum((x - y) ** 2 for x, y in zip(a, b)))
    return math.degrees(2 * math.asin(min(1, chord / 2)))


def channel(f, name):
    return [c.name for c in f.channels].index(name)


def compare(f, want, color_bound=0.0, normal_bound=0.0):
    """Geometry exactly, attributes within the bounds; (mean, max) of the colours' error."""
    found, last, errors = 0, -1, []
    names = {c.name: i for i, c in enumerate(f.channels)}
    for level, x, y, z, index in f.nodes():
        if level < f.T:
            continue
        v = want.get((x, y, z))
        check(v is not None, "voxel %s is not in the .svo" % ((x, y, z),))
        check(last < index < f.A and f.voxel(x, y, z) == index, (last, index, f.A))
        last, found = index, found + 1
        if "color" in names:
            a, b = (v["red"], v["green"], v["blue"]), tuple(f.value(names["color"], index))
            errors.append(0 if a == b else delta_e94(a, b))
            check(errors[-1] <= color_bound + 1e-3, (a, b, errors[-1]))
        if "normal" in names:
            n = decode_normal(f.value(names["normal"], index))
            e = degrees((v["nx"], v["ny"], v["nz"]), n)
            check(e <= normal_bound + 1e-3, (v, n, e))
    check(found == len(want), (found, len(want)))
    return (sum(errors) / len(errors), max(errors)) if errors else (0, 0)


def test_lossless_at_all_depths(folder):
    for depth in (0, 1, 2, 3, 5):
        svo, want = octree(folder, depth)
        for lod, geometry in (("all", "fast"), ("none", "fast"), ("all", "svdag"), ("none", "symmetric"), ("all", "best"), ("none", "best"), ("stored", "fast"), ("stored", "best")):
            out, report = compress(svo, "--lod", lod, "--geometry", geometry)
            f = Svdag(out)
            check(f.depth == depth and f.lod == (lod != "none") and f.averaged == (lod == "all"))
            compare(f, want)
            check(not any(e["max"] for e in report["errors"].values()), report["errors"])
            check(voxels(folder, out) == want, "svo-dump sees other voxels")


def test_pictures_before_and_after_are_the_same_bit_for_bit(folder):
    """Without loss: from the octree as it was voxelized and from every layout, near by and so far away that inner nodes are drawn."""
    if not support.have("svo-render"):
        support.skip("svo-render is not built")
    svo, _ = octree(folder, 6)
    for view in (["--size", "120x90"], ["--size", "16x12", "--samples", 2], ["--size", "90x60", "--eye", "3,2,1", "--target", "0.4,0.5,0.6", "--fov", 20]):
        before = run("svo-render", svo, "-o", "-", *view).out
        for geometry in ("svdag", "fast", "symmetric", "best"):
            for lod in ("all", "stored"):
                dag = compress(svo, "--geometry", geometry, "--lod", lod)[0]
                check(run("svo-render", dag, "-o", "-", *view).out == before, (view, geometry, lod))
        check(run("svo-render", compress(svo, "--color", 2)[0], "-o", "-", *view).out != before, "four colours show")
    near = ["--size", "64x48", "--footprint", 0]
    before = run("svo-render", svo, "-o", "-", *near).out
    for geometry in ("svdag", "fast", "best"):
        check(run("svo-render", compress(svo, "--geometry", geometry, "--lod", "none")[0], "-o", "-", *near).out == before, geometry)


def test_every_index_is_its_place_in_the_order(folder):
    svo, _ = octree(folder, 4)
    for lod, geometry in (("all", "fast"), ("none", "fast"), ("all", "best"), ("none", "best"), ("all", "symmetric"), ("stored", "fast"), ("stored", "best")):
        f = Svdag(compress(svo, "--lod", lod, "--geometry", geometry)[0])
        indices = [index for _, _, _, _, index in f.nodes() if isinstance(index, int) and (lod != "all" or index < f.A)]
        if lod == "all":  # a brick of one voxel has its index
            indices = sorted(set(indices))
        check(indices == list(range(f.A)), indices[:20])
        counts = [0] * 22
        for level, _, _, _, _ in f.nodes():
            counts[level] += 1
        check(tuple(counts) == f.level_nodes, (counts, f.level_nodes))


def test_averages_are_those_that_would_be_stored(folder):
    svo, _ = octree(folder, 5)

    def inner(f):
        return {node[:4]: node[4] for node in f.nodes() if node[0] < f.T}

    for geometry in ("fast", "best", "svdag"):
        a, s = (Svdag(compress(svo, "--lod", lod, "--geometry", geometry)[0]) for lod in ("all", "stored"))
        check(a.A < s.A and not any(c.corrections for c in a.channels))
        x, y = inner(a), inner(s)
        check(x.keys() == y.keys() and any(isinstance(i, tuple) for i in x.values()))
        for at in x:
            for c in range(len(a.channels)):
                p, q, kind = a.value(c, x[at]), s.value(c, y[at]), a.channels[c].kind
                if kind == 1:
                    check(max(abs(i - j) for i, j in zip(p, q)) <= 1, (at, p, q))
                elif kind == 2:
                    check(degrees(decode_normal(p), decode_normal(q)) < 0.01, (at, p, q))
                else:
                    check(p == q, (at, p, q))
    # within bounds: corrections where they are needed, every inner node within its bound of what would be stored
    exact = Svdag(compress(svo, "--lod", "stored")[0])
    found, want, corrected = None, inner(exact), 0
    for bounds in ((0.3, 0.5), (4, 6), (16, 25)):
        out, report = compress(svo, "--color", "deltaE=%g" % bounds[0], "--normal", "deg=%g" % bounds[1])
        f = Svdag(out)
        found = inner(f)
        corrected += sum(c.corrections for c in f.channels)
        check(found.keys() == want.keys())
        for at in found:
            for c in range(len(f.channels)):
                p, q, kind = f.value(c, found[at]), exact.value(c, want[at]), f.channels[c].kind
                if kind == 1 and p != q:  # one step of this reader's own rounding may be added
                    check(delta_e94(tuple(q), tuple(p)) <= bounds[0] + (1 if isinstance(found[at], tuple) else 1e-3), (at, p, q))
                elif kind == 2:
                    check(degrees(decode_normal(q), decode_normal(p)) <= bounds[1] + 0.01, (at, p, q))
        for name, e in report["errors"].items():
            check(e["max"] <= {"color": bounds[0], "normal": bounds[1]}.get(name, 0), (name, e))
    check(corrected > 0, "no average was corrected, so that this is no test")


def test_solids_with_full_leaves(folder):
    octree(folder, 1)
    svo = folder / "solid.svo"
    run("svo-voxelize", folder / "cube.glb", "-o", svo, "--depth", 5, "--fill", "solid")
    want = {k: (v.get("red"), v.get("green"), v.get("blue")) for k, v in voxels(folder, svo).items()}
    for geometry in ("svdag", "symmetric", "best"):
        for lod in ("all", "stored", "none"):
            f = Svdag(compress(svo, "--lod", lod, "--geometry", geometry)[0])
            found = {(x, y, z): index for level, x, y, z, index in f.nodes() if level == f.depth}
            check(found.keys() == want.keys() and f.A < len(want), (geometry, lod, len(found), len(want), f.A))
            check(all(f.voxel(*at) == found[at] for at in list(found)[::97]))
            check(set(found.values()) <= set(range(f.A)))
            counts = [0] * 22
            for level, _, _, _, _ in f.nodes():
                counts[level] += 1
            check(tuple(counts) == f.level_nodes, (counts, f.level_nodes))
            color = [c for c in range(len(f.channels)) if f.channels[c].name == "color"]
            for at in list(found)[::53] if color else []:
                check(tuple(f.value(color[0], found[at])) == want[at], (at, geometry))


def test_inner_nodes_are_averages_in_linear_light(folder):
    svo, _ = octree(folder, 4)
    f = Svdag(compress(svo)[0])
    color, path, below = channel(f, "color"), [], {}
    for level, x, y, z, index in f.nodes():
        del path[level:]
        path.append(index)
        if level == f.T:
            rgb = f.value(color, index)
            for i in path[:-1]:
                below.setdefault(i, []).append(rgb)
    check(len(below) > 50)
    for index, colors in below.items():
        got = f.value(color, index)
        for k in range(3):
            mean = sum(srgb_to_linear(c[k]) for c in colors) / len(colors)
            c = 12.92 * mean if mean <= 0.0031308 else 1.055 * mean ** (1 / 2.4) - 0.055
            check(abs(got[k] - 255 * c) <= 0.5 + 1e-3, (index, k, got[k], 255 * c))


def test_color_bits(folder):
    svo, want = octree(folder)
    last = 1e9
    for bits in (2, 6, 12):
        out, report = compress(svo, "--color", bits, "--normal", "lossless")
        f = Svdag(out)
        values = {f.value(channel(f, "color"), i) for i in range(f.A)}
        check(len(values) <= 2 ** bits, len(values))
        mean, most = compare(f, want, color_bound=1e9)
        e = report["errors"]["color"]
        check(most <= e["max"] + 1e-3 and e["mean"] <= last, (mean, most, e))
        last = e["mean"]


def test_palettes_of_algorithm1(folder):
    svo, want = octree(folder)
    blocks = folder / "blocks.svdag"
    run("svo-compress", svo, "-o", blocks, "--color", "6", "--normal", "8")
    for options in (["--color", "6", "--normal", "8"], [], ["--lod", "none", "--geometry", "best"]):
        out, report = compress(svo, "--palettes", "algorithm1", *options)
        f = Svdag(out)
        check(f.channels[channel(f, "color")].encoding == 3, [c.encoding for c in f.channels])
        check(any(c["encoding"] == "long blocks" for c in report["output"]["channels"]), report["output"]["channels"])
        run("svo-dump", out, "--validate")
        if options[:1] == ["--color"]:
            run("svo-compare", out, blocks)  # the same values as in blocks
        else:
            compare(f, want)
            check(voxels(folder, out) == want, "svo-dump sees other voxels")
    one = compress(svo, "--palettes", "algorithm1", "--threads", 1)[0].read_bytes()
    check(compress(svo, "--palettes", "algorithm1", "--threads", 3)[0].read_bytes() == one, "threads change the bytes")


def test_color_bound_holds(folder):
    svo, want = octree(folder)
    sizes = []
    for bound in (0.5, 2, 8):
        out, report = compress(svo, "--color", "deltaE=%g" % bound)
        compare(Svdag(out), want, color_bound=bound)
        largest = report["errors"]["color"]["max"]
        check(largest <= bound, report["errors"])
        sizes.append(out.stat().st_size)
    check(largest > 0, report["errors"])
    check(sizes == sorted(sizes, reverse=True), sizes)


def test_color_mean_and_psnr(folder):
    svo, want = octree(folder)
    for value, bound in (("mean=0.5", 6), ("mean=2", 16), ("psnr=40", 8), ("mean=1,deltaE=3", 3), ("deltaE=2,psnr=30", 2)):
        out, report = compress(svo, "--color", value)
        compare(Svdag(out), want, color_bound=bound)
        e = report["errors"]["color"]
        check(e["max"] <= bound, (value, e))
        if "mean=" in value:
            check(e["mean"] <= float(value.split("mean=")[1].split(",")[0]) * 1.02, (value, e))
    for value in ("mean=", "mean=0", "mean=1,psnr=30", "deltaE=1,deltaE=2", "psnr=40,", "mean=nan", "deltaE=1;mean=1", "mean=1x"):
        check(tool("svo-compress", svo, "-o", folder / "x.svdag", "--color", value).code == 1, value)


def test_normal_bits_and_bound(folder):
    support.sphere_obj(folder / "s.obj")
    svo = folder / "s.svo"
    run("svo-voxelize", folder / "s.obj", "-o", svo, "--depth", 5)
    want = voxels(folder, svo)
    for value, bound in (("8", 12), ("16", 1), ("32", 0), ("deg=5", 5), ("deg=0.3", 0.3), ("deg=0.001", 0.001)):
        out, report = compress(svo, "--normal", value)
        compare(Svdag(out), want, normal_bound=bound)
        check(report["errors"]["normal"]["max"] <= bound, (value, report["errors"]))


def test_constant_channels_are_left_out(folder):
    svo, want = octree(folder, 4, texture=False)
    out, report = compress(svo)
    f = Svdag(out)
    compare(f, want)
    left = {o["channel"]: o for o in report["output"]["left_out"] if "same everywhere" in o["what"]}
    for c in f.channels:
        check((c.encoding == 0) == (c.name in left), (c.name, c.encoding, left))
        if c.name in left:
            check(left[c.name]["bytes_saved"] == f.A * c.stride)


def test_same_bytes_for_any_threads_and_through_pipes(folder):
    svo, _ = octree(folder, 6)
    for args in ((), ("--color", "5", "--normal", "deg=2"), ("--color", "deltaE=3", "--lod", "none")):
        files = []
        for threads in (1, 2, 7):
            out, _ = compress(svo, "--threads", threads, *args)
            files.append(out.read_bytes())
        check(files[0] == files[1] == files[2])
    # stdin has no name, so the provenance differs, and nothing else
    piped = tool("svo-compress", "-", "-o", "-", "--color", "5", stdin=svo.read_bytes())
    check(piped.code == 0, piped)
    (folder / "p.svdag").write_bytes(piped.out)
    f, g = Svdag(folder / "p.svdag"), Svdag(compress(svo, "--color", "5")[0])
    check((f.A, f.levels, f.bricks) == (g.A, g.levels, g.bricks))
    check([f.value(0, i) for i in range(f.A)] == [g.value(0, i) for i in range(g.A)])


def test_report_adds_up(folder):
    svo, want = octree(folder)
    out, report = compress(svo)
    o = report["output"]
    check(o["bytes"] == out.stat().st_size and o["attributes"] == Svdag(out).A)
    check(sum(s["bytes"] for s in o["sections"]) == o["geometry_bytes"] + o["attribute_bytes"], o)
    check(o["geometry_bytes"] + o["attribute_bytes"] <= o["bytes"])
    check(report["input"]["voxels"] == len(want) and report["input"]["bytes"] == svo.stat().st_size, report["input"])
    check(abs(o["bytes_per_voxel"] - o["bytes"] / len(want)) < 1e-9)
    check({p["name"] for p in report["phases"]} >= {"read", "geometry", "attributes", "write"}, report["phases"])
    for l in o["levels"]:
        check(0 < l.get("unique", 1) <= l["nodes"], l)


def test_empty_octree(folder):
    (folder / "e.obj").write_text("v 0 0 0\n")
    run("svo-voxelize", folder / "e.obj", "-o", folder / "e.svo", "--depth", 6)
    out, report = compress(folder / "e.svo")
    f = Svdag(out)
    check(f.empty and f.A == 0 and list(f.nodes()) == [] and report["input"]["voxels"] == 0)


def test_exit_codes(folder):
    svo, _ = octree(folder, 4)
    out = folder / "x.svdag"
    for code, args in (
            (1, (svo,)), (1, (svo, "-o", out, "--color", "17")), (1, (svo, "-o", out, "--color", "deltaE=0")),
            (1, (svo, "-o", out, "--color", "deltaE=nan")), (1, (svo, "-o", out, "--color", "8x")), (1, (svo, "-o", out, "--normal", "7")),
            (1, (svo, "-o", out, "--normal", "deg=")), (1, (svo, "-o", out, "--lod", "some")), (1, (svo, "-o", out, "--geometry", "x")),
            (1, (svo, "-o", out, "--palettes", "x")), (1, (svo, "-o", out, "--palettes", "algorithm1", "--color", "deltaE=2")),
            (1, (svo, "-o", svo)), (2, (folder / "none.svo", "-o", out)), (2, (svo, "-o", folder / "no/x.svdag")),
            (3, (folder / "cube.glb", "-o", out)),
            (6, (svo, "-o", out, "--memory", "20K"))):
        r = tool("svo-compress", *args)
        check(r.code == code, r)
        check(r.err.startswith("svo-compress: "), r)
        check(not out.exists(), "left behind: %s" % (args,))
    run("svo-compress", svo, "-o", out)
    check(tool("svo-compress", svo, "-o", out).code == 2, "an existing file was replaced without --force")
    # damage: nothing is written
    data = bytearray(svo.read_bytes())
    for at in (3, len(data) // 2, len(data) - 20):
        bad = bytearray(data)
        bad[at] ^= 1
        (folder / "bad.svo").write_bytes(bad)
        r = tool("svo-compress", folder / "bad.svo", "-o", folder / "bad.svdag")
        check(r.code == 3 and not (folder / "bad.svdag").exists(), r)
    (folder / "cut.svo").write_bytes(data[:len(data) // 2])
    check(tool("svo-compress", folder / "cut.svo", "-o", folder / "bad.svdag").code == 3)


def test_a_real_model(folder):
    model = support.model("C_textured/spot_cow/spot_triangulated.obj")
    svo = folder / "cow.svo"
    run("svo-voxelize", model, "-o", svo, "--depth", 6)
    want = voxels(folder, svo)
    compare(Svdag(compress(svo)[0]), want)
    compare(Svdag(compress(svo, "--color", "deltaE=2", "--normal", "deg=3")[0]), want, 2, 3)


support.main(globals())
