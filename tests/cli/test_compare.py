"""svo-compare on files that the other tools made, and on images made here."""

import math
import os
import struct
import sys

import support
from support import check, run, tool

sys.path.insert(0, os.path.join(os.path.dirname(os.path.abspath(__file__)), "..", "fuzz"))
import make_seeds


def compare(*args, code=0, **more):
    r = tool("svo-compare", *args, "--json", **more)
    check(r.code == code, "expected %s: %s" % (code, r))
    return r.json


def octree(folder, name, mesh, *options):
    run("svo-voxelize", mesh, "-o", folder / name, *(options or ("--depth", 5)))
    return folder / name


def voxels(folder, path):
    run("svo-dump", path, "--voxels", folder / "v.ply", "--force")
    return support.ply_voxels(folder / "v.ply")


def noise_texture(seed=1):
    return support.write_png(None, 64, 64, lambda x, y: ((x * 37 + y * 91 + seed) % 256, (x * y * 7 + seed) % 256, (x * 3 + 11 * y) % 256))


def test_images(folder):
    a, b = folder / "a.png", folder / "b.png"
    pixel = lambda x, y: ((x * 5) % 256, (y * 7) % 256, (x + y) % 256)
    changed = {(3, 4): (10, 0, 0), (30, 31): (0, 0, 4)}
    support.write_png(a, 40, 36, pixel)
    support.write_png(b, 40, 36, lambda x, y: tuple(p + d for p, d in zip(pixel(x, y), changed.get((x, y), (0, 0, 0)))))
    r = compare(a, b, code=7)
    n = 40 * 36
    check(r["different_pixels"] == 2 and r["pixels"] == n and r["max_difference"] == 10 and not r["identical"] and r["differs"], r)
    check(math.isclose(r["psnr_db"]["r"], 10 * math.log10(255**2 / (100 / n)), rel_tol=1e-12), r)
    check(math.isclose(r["psnr_db"]["all"], 10 * math.log10(255**2 / (116 / n / 3)), rel_tol=1e-12), r)
    check(r["psnr_db"]["g"] is None and "a" not in r["psnr_db"] and 0.99 < r["ssim"] < 1, r)
    r = compare(a, a)
    check(r["identical"] and not r["differs"] and r["psnr_db"]["all"] is None and r["ssim"] == 1, r)
    for tolerance, code in ((["--psnr", 50], 0), (["--psnr", 70], 7), (["--max-diff", 10], 0), (["--max-diff", 9], 7), (["--ssim", 0.9], 0), (["--ssim", 1], 7),
                            (["--psnr", 50, "--max-diff", 9], 7)):
        compare(a, b, *tolerance, code=code)
    support.write_png(b, 36, 40, pixel)
    r = compare(a, b, code=7)
    check("sizes" in r["reasons"][0], r)
    compare(a, b, "--psnr", 0, code=7)
    # an alpha channel counts as soon as one image uses it
    support.write_png(b, 40, 36, lambda x, y: pixel(x, y) + (255,), channels=4)
    check(compare(a, b)["identical"], "opaque alpha is no difference")
    support.write_png(b, 40, 36, lambda x, y: pixel(x, y) + (254,), channels=4)
    check(compare(a, b, code=7)["psnr_db"]["a"] is not None, "alpha")
    # from stdin
    check(compare("-", a, stdin=a.read_bytes())["identical"], "stdin")


def exr(path, *args, **more):
    path.write_bytes(make_seeds.exr(*args, **more))
    return path


def test_openexr(folder):
    a, b = folder / "a.exr", folder / "b.exr"
    rows = lambda f, w=7, h=5: [[f(x, y) for x in range(w)] for y in range(h)]
    inf, nan = float("inf"), float("nan")
    planes = {"R": (1, rows(lambda x, y: x / 8 + y)), "Z": (2, rows(lambda x, y: inf if x == 0 else nan if x == 1 else 0.1 * x * y)), "id": (0, rows(lambda x, y: 4294967295 - x * y))}
    exr(a, 7, 5, planes)
    r = tool("svo-compare", a, a, "--json")
    if r.code == 5 and "OpenEXR" in r.err:
        support.skip("built without OpenEXR")
    check(r.code == 0 and r.json["identical"] and r.json["kind"] == "OpenEXR picture" and [p["name"] for p in r.json["planes"]] == ["R", "Z", "id"], r)
    exr(b, 7, 5, planes, compression=2, origin=(-3, 11))
    check(compare(a, b)["identical"], "the same pixels, compressed, elsewhere")
    check(compare("-", a, stdin=b.read_bytes())["identical"], "stdin")
    other = {n: (t, [list(row) for row in rows]) for n, (t, rows) in planes.items()}
    other["Z"][1][3][2] += 0.25
    other["Z"][1][4][6] -= 0.5
    exr(b, 7, 5, other)
    r = compare(a, b, code=7)
    z = next(p for p in r["planes"] if p["name"] == "Z")
    check(z["different"] == 2 and abs(z["max"] - 0.5) < 1e-6 and z["worst"] == [6, 4] and abs(z["rmse"] - math.sqrt((0.0625 + 0.25) / 25)) < 1e-6 and not r["identical"], r)
    compare(a, b, "--float-diff", 0.51)
    compare(a, b, "--float-diff", 0.49, code=7)
    other["Z"][1][0][0] = 5.0
    exr(b, 7, 5, other)
    check("number in one" in compare(a, b, "--float-diff", 100, code=7)["reasons"][0])
    exr(b, 7, 5, dict(planes, id=(0, rows(lambda x, y: 4294967295 - x * y - (x == 3 and y == 2)))))
    check("1 labels" in compare(a, b, "--float-diff", 100, code=7)["reasons"][0])
    exr(b, 7, 5, dict(planes, id=(2, planes["R"][1])))
    check("integers" in compare(a, b, code=7)["reasons"][0])
    exr(b, 7, 5, {"R": planes["R"], "Z": planes["Z"], "B": planes["R"]})
    r = compare(a, b, code=7)
    check([p["name"] for p in r["planes"]] == ["B", "R", "Z", "id"] and len(r["reasons"]) == 2 and not r["identical"], r)
    exr(b, 5, 7, {"R": (1, rows(lambda x, y: 0, 5, 7))})
    check("sizes" in compare(a, b, code=7)["reasons"][0])
    # damaged, other kinds, nothing known
    whole = a.read_bytes()
    for length in range(4, len(whole), 37):
        b.write_bytes(whole[:length])
        check(tool("svo-compare", a, b).code == 3, length)
    b.write_bytes(whole.replace(struct.pack("<4i", 0, 0, 6, 4), struct.pack("<4i", 0, 0, 0x7ffffff0, 0x7ffffff0)))
    check(tool("svo-compare", a, b, "--memory", "200M").code in (3, 6), "enormous")
    # an attribute that says it is larger than the file: OpenEXR itself would take the memory first
    b.write_bytes(whole.replace(b"screenWindowWidth\0float\0\4\0\0\0", b"screenWindowWidth\0float\0\0\0\0\x64"))
    r = tool("svo-compare", a, b)
    check(r.code == 3 and "longer than the file" in r.err, r)
    support.write_png(folder / "a.png", 7, 5, lambda x, y: (x, y, 0))
    check(tool("svo-compare", a, folder / "a.png").code == 5)
    (folder / "t.txt").write_text("hello\n")
    (folder / "e.txt").write_text("")
    for odd, word in (("t.txt", "neither"), ("e.txt", "empty")):
        for pair in ((folder / odd, folder / "a.png"), (a, folder / odd), (folder / odd, folder / odd)):
            r = tool("svo-compare", *pair)
            check(r.code == 3 and odd in r.err and word in r.err, r)


def test_pictures_of_svo_render(folder):
    """Another light changes colours, and neither depth nor labels; a camera elsewhere all of them."""
    octree(folder, "c.svo", support.cube_glb(folder / "c.glb", texture=noise_texture()))
    shot = lambda name, *more: run("svo-render", folder / "c.svo", "-o", folder / name, "--size", "60x50", *more)
    shot("a.exr"), shot("b.exr", "--light", "1,0.2,0.3"), shot("c.exr", "--eye", "2,2,3")
    r = tool("svo-compare", folder / "a.exr", folder / "b.exr", "--json")
    if r.code == 5 and "OpenEXR" in r.err:
        support.skip("built without OpenEXR")
    changed = lambda r: {p["name"] for p in r["planes"] if p["different"]}
    check(r.code == 7 and changed(r.json) <= {"R", "G", "B"} and changed(r.json), r)
    check(len(changed(compare(folder / "a.exr", folder / "c.exr", code=7))) > 4)
    compare(folder / "a.exr", folder / "b.exr", "--float-diff", 4)


def test_octree_against_itself_in_both_forms(folder):
    mesh = support.cube_glb(folder / "c.glb", texture=noise_texture())
    svo = octree(folder, "c.svo", mesh, "--depth", 6)
    run("svo-compress", svo, "-o", folder / "c.svdag")
    for a in (svo, folder / "c.svdag"):
        for b in (svo, folder / "c.svdag"):
            r = compare(a, b)
            check(r["identical"] and r["geometry"]["equal"] and r["geometry"]["both"] == r["a"]["voxels"] == r["b"]["voxels"], r)
    check(compare("-", folder / "c.svdag", stdin=svo.read_bytes())["identical"], "stdin")
    check(compare(svo, "-", stdin=(folder / "c.svdag").read_bytes())["identical"], "stdin")


def test_geometry_against_the_dump(folder):
    a = octree(folder, "a.svo", support.sphere_obj(folder / "a.obj", 12), "--depth", 5, "--attributes", "none")
    b = octree(folder, "b.svo", support.sphere_obj(folder / "b.obj", 7), "--depth", 5, "--attributes", "none")
    run("svo-compress", b, "-o", folder / "b.svdag")
    va, vb = set(voxels(folder, a)), set(voxels(folder, b))
    check(va - vb and vb - va, "the two must differ")
    morton = lambda v: sum((v[k] >> i & 1) << (3 * i + k) for i in range(21) for k in range(3))
    first = min(va ^ vb, key=morton)
    for other in (b, folder / "b.svdag"):
        r = compare(a, other, code=7)
        g = r["geometry"]
        check((g["only_a"], g["only_b"], g["both"]) == (len(va - vb), len(vb - va), len(va & vb)), r)
        check(tuple(g["first"]) == first and g["first_in"] == ("a" if first in va else "b"), r)


def lab(rgb):
    linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in (v / 255 for v in rgb)]
    rows = ((0.4124, 0.3576, 0.1805), (0.2126, 0.7152, 0.0722), (0.0193, 0.1192, 0.9505))
    x, y, z = (sum(m * c for m, c in zip(row, linear)) / sum(row) for row in rows)
    f = lambda t: t ** (1 / 3) if t > 216 / 24389 else (24389 / 27 * t + 16) / 116
    return 116 * f(y) - 16, 500 * (f(x) - f(y)), 200 * (f(y) - f(z))


def delta_e94(reference, other):
    (l1, a1, b1), (l2, a2, b2) = lab(reference), lab(other)
    c1, c2 = math.hypot(a1, b1), math.hypot(a2, b2)
    h2 = max(0, (a1 - a2) ** 2 + (b1 - b2) ** 2 - (c1 - c2) ** 2)
    return math.sqrt((l1 - l2) ** 2 + ((c1 - c2) / (1 + 0.045 * c1)) ** 2 + h2 / (1 + 0.015 * c1) ** 2)


def test_attributes_against_the_dump(folder):
    svo = octree(folder, "c.svo", support.cube_glb(folder / "c.glb", texture=noise_texture()), "--depth", 5)
    run("svo-compress", svo, "-o", folder / "c.svdag", "--color", 4, "--normal", 8)
    before, after = voxels(folder, svo), voxels(folder, folder / "c.svdag")
    color = lambda v: (v["red"], v["green"], v["blue"])
    normal = lambda v: (v["nx"], v["ny"], v["nz"])
    errors = [delta_e94(color(before[p]), color(after[p])) for p in before]

    def degrees(u, v):
        chord = math.dist(u, v)
        return math.degrees(2 * math.asin(min(1, chord / 2)))

    angles = [degrees(normal(before[p]), normal(after[p])) for p in before]
    r = compare(svo, folder / "c.svdag", code=7)
    channels = {c["name"]: c for c in r["channels"]}
    c, n = channels["color"], channels["normal"]
    check(r["geometry"]["equal"] and max(errors) > 1, r)
    check(math.isclose(c["max"], max(errors), rel_tol=1e-3) and math.isclose(c["mean"], sum(errors) / len(errors), rel_tol=1e-3), (c, max(errors)))
    check(c["different"] == sum(e > 0 for e in errors) and c["unit"] == "deltaE94", c)
    check(abs(n["max"] - max(angles)) < 0.01 and abs(n["mean"] - sum(angles) / len(angles)) < 0.01, (n, max(angles)))
    worst = tuple(c["worst"])
    check(math.isclose(delta_e94(color(before[worst]), color(after[worst])), max(errors), rel_tol=1e-3), worst)
    # tolerances decide, each for its kind
    above_c, above_n = c["max"] * 1.001, n["max"] * 1.001 + 1e-9
    compare(svo, folder / "c.svdag", "--deltaE", above_c, "--deg", above_n)
    compare(svo, folder / "c.svdag", "--deltaE", c["max"] * 0.999, "--deg", above_n, code=7)
    if n["max"] > 0.01:
        compare(svo, folder / "c.svdag", "--deltaE", above_c, "--deg", n["max"] * 0.999, code=7)
    compare(svo, folder / "c.svdag", "--geometry-only")


def test_other_grids(folder):
    mesh = support.cube_obj(folder / "c.obj")
    a = octree(folder, "a.svo", mesh, "--depth", 4)
    deeper = octree(folder, "d.svo", mesh, "--depth", 5)
    r = compare(a, deeper, code=7)
    check("depths" in r["reasons"][0] and r["a"]["voxels"] > 0 and r["b"]["voxels"] > r["a"]["voxels"], r)
    moved = octree(folder, "m.svo", support.cube_obj(folder / "m.obj", offset=(100, 0, 0)), "--depth", 4)
    r = compare(a, moved, code=7)
    check(not r["same_transform"] and abs(r["transform_distance"] - 100) < 1e-6, r)
    plain = octree(folder, "p.svo", mesh, "--depth", 4, "--attributes", "none")
    r = compare(a, plain, code=7)
    check(any("only A" in reason for reason in r["reasons"]) and r["geometry"]["equal"], r)
    compare(a, plain, "--geometry-only")


def test_scenes(folder):
    import json
    octree(folder, "a.svo", support.cube_obj(folder / "a.obj"), "--depth", 4)
    run("svo-compress", folder / "a.svo", "-o", folder / "a.svdag")
    for name, x in (("one", 3), ("two", 3), ("three", 4)):
        scene = {"assets": [{"name": "a", "file": "a.svdag"}], "instances": [{"asset": "a"}, {"asset": "a", "translation": [x, 0, 0]}]}
        (folder / (name + ".json")).write_text(json.dumps(scene))
        run("svo-pack", folder / (name + ".json"), "-o", folder / (name + ".svscene"))
    check(compare(folder / "one.svscene", folder / "two.svscene")["identical"], "same scene")
    r = compare(folder / "one.svscene", folder / "three.svscene", code=7)
    check(r["different_chunks"] >= 1 and not r["identical"], r)


def test_skeletons(folder):
    mesh = support.sphere_obj(folder / "s.obj", 10)
    for name, omega in (("a", 0.2), ("b", 0.2), ("c", 0.05)):
        run("svo-skeleton", mesh, "-o", folder / (name + ".skel"), "--omega", omega)
    r = compare(folder / "a.skel", folder / "b.skel")
    check(r["identical"] and r["skeleton"]["joint_distance_max"] == 0 and r["skeleton"]["hausdorff"] < 1e-12 and r["skeleton"]["same_bones"], r)
    r = compare(folder / "a.skel", folder / "c.skel", code=7)
    check(r["kind"] == "skeleton" and r["different_chunks"] >= 1 and not r["identical"], r)
    d = r["skeleton"]
    check(0 < d["curve_distance_mean"] <= d["hausdorff"] and d["curve_distance_mean"] == max(d["curve_distance_mean_a_to_b"], d["curve_distance_mean_b_to_a"]), d)
    damaged = folder / "d.skel"
    data = bytearray((folder / "a.skel").read_bytes())
    data[len(data) // 2] ^= 1
    damaged.write_bytes(data)
    check(tool("svo-compare", folder / "a.skel", damaged).code == 3, "damaged skeleton")


def test_real_models(folder):
    path = support.model("C_textured/spot_cow/spot_triangulated.obj")
    a = octree(folder, "a.svo", path, "--depth", 7)
    run("svo-compress", a, "-o", folder / "a.svdag")
    check(compare(a, folder / "a.svdag")["identical"], "lossless")
    text = run("svo-compare", a, folder / "a.svdag").text
    check("identical" in text and "voxels" in text, text)


support.main(globals())
