"""svo-voxelize as users run it: exit codes, reports, the same bytes for any number of threads, real models."""

import support
from support import tool, run, check, report, model


def names(folder):
    return sorted(p.name for p in folder.iterdir())


def test_cube_shell_and_report(folder):
    support.cube_obj(folder / "cube.obj", color=(1, 0.5, 0))
    run("svo-voxelize", folder / "cube.obj", "-o", folder / "a.svo", "--depth", 5, "--report", folder / "r.json")
    r = report(folder / "r.json")
    attributes = r["errors"]["attributes"]
    normal = attributes["channels"][0]
    check(normal["name"] == "normal" and normal["unit"] == "degrees" and 0 < normal["voxels"] <= attributes["voxels"] <= 2048, "attributes were compared")
    check(normal["mean"] < 1 and attributes["samples_per_voxel"] == 4096, "normals of a cube: %r" % normal)
    check("reference" in [p["name"] for p in r["phases"]], "the comparison is a phase of its own")
    run("svo-voxelize", folder / "cube.obj", "-o", folder / "a.svo", "--force", "--depth", 5, "--reference", 0, "--report", folder / "n.json")
    check("attributes" not in report(folder / "n.json")["errors"], "--reference 0 compares nothing")
    check(r["tool"] == "svo-voxelize" and r["output"]["voxels"] == 32**3 - 30**3, r["output"])
    check(r["output"]["bytes"] == (folder / "a.svo").stat().st_size, r["output"])
    check(r["output"]["levels"][0] == {"level": 0, "nodes": 1} and r["output"]["levels"][5]["nodes"] == r["output"]["voxels"], r["output"])
    check(r["input"]["triangles"] == 12 and r["input"]["placed_triangles"] == 12, r["input"])
    check({"import", "plan", "voxelize", "write"} <= {p["name"] for p in r["phases"]}, r["phases"])
    e = r["errors"]
    check(0 < e["snap_mean"] <= e["snap_max"] < 0.0136, e)
    check(e["centre_to_surface_samples"] > 0 and 0.4 < e["centre_to_surface_mean"] <= e["centre_to_surface_max"] < 0.88, e)
    d = run("svo-dump", "--json", folder / "a.svo").json
    check(d["voxels"] == 32**3 - 30**3 and d["depth"] == 5, d)
    check({a["name"]: a["constant"] for a in d["attributes"]} == {"color": True, "normal": False}, d["attributes"])
    run("svo-dump", "--validate", folder / "a.svo")
    run("svo-dump", "--voxels", folder / "v.ply", folder / "a.svo")
    for v in support.ply_voxels(folder / "v.ply").values():
        check((v["red"], v["green"], v["blue"]) == (255, 128, 0), v)


def test_same_bytes_for_any_threads(folder):
    path = model("C_textured/spot_cow/spot_triangulated.obj")
    files = []
    for threads in (1, 2, 7):
        out = folder / ("%d.svo" % threads)
        run("svo-voxelize", path, "-o", out, "--depth", 8, "--threads", threads, *(["--memory", "64M"] if threads == 7 else []))
        files.append(out.read_bytes())
    check(files[0] == files[1] == files[2], "threads or memory change the bytes")
    piped = run("svo-voxelize", path, "-o", "-", "--depth", 8)
    check(piped.out == files[0], "a pipe changes the bytes")


def test_several_inputs_lie_in_one_grid(folder):
    a = support.cube_obj(folder / "a.obj", color=(1, 0, 0))
    b = support.cube_obj(folder / "b.obj", offset=(3, 0, 0), color=(0, 0, 1))
    run("svo-voxelize", a, b, "-o", folder / "c.svo", "--depth", 6, "--attributes", "color,material")
    run("svo-dump", "--voxels", folder / "v.ply", folder / "c.svo")
    voxels = support.ply_voxels(folder / "v.ply")
    # a face on a grid plane belongs to the layer above it, but for the last layer of the grid: 17 layers where the far face
    # lies inside the grid, 16 along x for the second cube
    check(len(voxels) == (17**3 - 15**3) + (16 * 17 * 17 - 14 * 15 * 15), len(voxels))
    for (x, _, _), v in voxels.items():
        check((v["red"], v["blue"]) == ((255, 0) if x < 32 else (0, 255)), (x, v))


def test_texture_lands_where_it_should(folder):
    # four differently coloured quarters: an image that no mirroring leaves as it is
    colors = [(255, 0, 0), (0, 255, 0), (0, 0, 255), (255, 255, 0)]
    png = support.write_png(None, 8, 8, lambda x, y: colors[(x >= 4) + 2 * (y >= 4)])
    support.cube_glb(folder / "t.glb", texture=png)
    run("svo-voxelize", folder / "t.glb", "-o", folder / "t.svo", "--depth", 5)
    run("svo-dump", "--voxels", folder / "v.ply", folder / "t.svo")
    voxels = support.ply_voxels(folder / "v.ply")
    normal, side = support.CUBE_SIDES[5]  # +z: corners 4 5 7 6 with UV (0,1) (1,1) (1,0) (0,0)
    for (x, y, z), v in voxels.items():
        if z == 31 and 1 < x < 30 and 1 < y < 30 and x not in (15, 16) and y not in (15, 16):
            u, w = x / 31, 1 - y / 31  # image coordinates
            check((v["red"], v["green"], v["blue"]) == colors[(u >= 0.5) + 2 * (w >= 0.5)], ((x, y, z), v))
            check(v["nz"] > 0.999, v)


def test_voxel_size(folder):
    support.cube_obj(folder / "cube.obj", size=0.9, offset=(0.05, 0.05, 0.05))
    run("svo-voxelize", folder / "cube.obj", "-o", folder / "a.svo", "--voxel-size", 0.25, "--attributes", "none")
    d = run("svo-dump", "--json", folder / "a.svo").json
    check(d["depth"] == 2 and d["voxels"] == 4**3 - 2**3 and d["voxel_to_world"][0] == 0.25 and d["voxel_to_world"][3] == 0, d)


def turned(up, p):
    """A right turn that takes the axis `up` to +Y."""
    x, y, z = p
    return {"y": (x, y, z), "-y": (x, -y, -z), "x": (-y, x, z), "-x": (y, -x, z), "z": (x, z, -y), "-z": (x, -z, y)}[up]


def test_axes_and_units(folder):
    """--up and --unit give the bytes of the same shape written down turned and in metres; normals turn too."""
    points = [(0.25, 0.5, 1), (3, 0.5, 1.25), (0.5, 2, 4), (1, 1, 1.5)]
    faces = "f 1 2 3\nf 1 4 2\nf 2 4 3\nf 3 4 1\n"
    plain = lambda path, scale, up: path.write_text("".join("v %r %r %r\n" % tuple(scale * c for c in turned(up, p)) for p in points) + faces)
    strip = lambda path: {k: v for k, v in run("svo-dump", path, "--json").json.items() if k in ("voxel_to_world", "voxels", "attributes", "levels")}
    same = lambda a, b: run("svo-compare", a, b, "-q").code == 0 and strip(a) == strip(b)
    plain(folder / "as.obj", 1, "y")
    for up in ("y", "-y", "x", "-x", "z", "-z"):
        for unit, scale in ((None, 1), ("0.5", 0.5), ("km", 1000)):
            plain(folder / "to.obj", scale, up)
            run("svo-voxelize", folder / "to.obj", "-o", folder / "to.svo", "-d", 6, "-f", "-q")
            more = ["--up", up] + (["--unit", unit] if unit else [])
            run("svo-voxelize", folder / "as.obj", "-o", folder / "as.svo", "-d", 6, "-f", "-q", *more)
            check(same(folder / "as.svo", folder / "to.svo"), more)
    run("svo-voxelize", folder / "as.obj", "-o", folder / "mm.svo", "--unit", "mm", "--up", "z", "--voxel-size", 0.0001, "-q")
    info = run("svo-dump", folder / "mm.svo", "--json").json
    check(abs(info["voxel_size"][0] - 0.0001) < 1e-12 and abs(info["bounds"]["high"][0] - 0.003) < 2e-4, info["bounds"])
    check(info["provenance"]["options"]["up"] == "z" and info["provenance"]["options"]["unit"] == 0.001, info["provenance"])
    # the key knows them
    key = lambda *more: run("svo-voxelize", folder / "as.obj", "--key", "-d", 6, *more).out
    check(len({key(), key("--up", "z"), key("--unit", "mm"), key("--unit", "0.01")}) == 4 and key("--unit", "cm") == key("--unit", "0.01"))
    # points
    (folder / "as.xyz").write_text("".join("%r %r %r\n" % p for p in points))
    (folder / "to.xyz").write_text("".join("%r %r %r\n" % tuple(0.5 * c for c in turned("-x", p)) for p in points))
    run("svo-voxelize", folder / "as.xyz", "-o", folder / "as.svo", "-d", 5, "-f", "-q", "--up", "-x", "--unit", 0.5)
    run("svo-voxelize", folder / "to.xyz", "-o", folder / "to.svo", "-d", 5, "-f", "-q")
    check(same(folder / "as.svo", folder / "to.svo"))
    # a skeleton lies in the same coordinates
    support.sphere_obj(folder / "ball.obj", rings=12)
    run("svo-skeleton", folder / "ball.obj", "-o", folder / "ball.skel", "--unit", "cm", "--up", "z", "--omega", 0.2, "--obj", folder / "curve.obj", "-q")
    curve = [tuple(map(float, l.split()[1:4])) for l in (folder / "curve.obj").read_text().splitlines() if l.startswith("v ")]
    check(curve and all(abs(x) < 0.02 for p in curve for x in p), curve)
    # refused
    for more in (["--unit", "yard"], ["--unit", "0"], ["--unit", "-1"], ["--unit", "nan"], ["--unit", "1m"], ["--up", "w"]):
        check(tool("svo-voxelize", folder / "as.obj", "-o", folder / "x.svo", "-d", 4, *more).code == 1 and not (folder / "x.svo").exists(), more)
    check(tool("svo-skeleton", folder / "as.svo", "-o", folder / "x.skel", "--up", "z").code == 5 and not (folder / "x.skel").exists())


def test_empty_mesh_warns(folder):
    (folder / "e.obj").write_text("v 0 0 0\n")
    r = run("svo-voxelize", folder / "e.obj", "-o", folder / "e.svo", "--depth", 4)
    check("warning" in r.err, r)
    check(run("svo-dump", "--json", folder / "e.svo").json["voxels"] == 0)


def test_exit_codes(folder):
    cube = support.cube_obj(folder / "cube.obj")
    out = folder / "o.svo"
    (folder / "bad.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n")
    (folder / "bad.glb").write_bytes(b"glTF\x02\0\0\0\xff\xff\0\0 nonsense")
    cases = [
        (1, [cube, "-o", out]),
        (1, [cube, "-o", out, "--depth", 4, "--voxel-size", 1]),
        (1, [cube, "-o", out, "--depth", 22]),
        (1, [cube, "-o", out, "--depth", 4, "--attributes", "colour"]),
        (1, [cube, "-o", out, "--depth", 4, "--attributes", "color,"]),
        (1, [cube, "-o", out, "--depth", 4, "--surface", "thick"]),
        (1, ["-", "-o", out, "--depth", 4]),
        (1, [cube, "--depth", 4]),
        (1, ["-o", out, "--depth", 4]),
        (2, [folder / "missing.obj", "-o", out, "--depth", 4]),
        (2, [cube, "-o", folder / "no" / "o.svo", "--depth", 4]),
        (3, [folder / "bad.glb", "-o", out, "--depth", 4]),
        (6, [cube, "-o", out, "--voxel-size", 1e-8]),
        (6, [cube, "-o", out, "--depth", 8, "--memory", "300K"]),
    ]
    before = names(folder)
    for code, args in cases:
        r = tool("svo-voxelize", *args)
        check(r.code == code, "expected %d: %s" % (code, r))
        check(r.err.strip() and not r.out, r)
        check(names(folder) == before, "something was left behind: %s" % r)
    run("svo-voxelize", cube, "-o", out, "--depth", 3)
    old = out.read_bytes()
    check(tool("svo-voxelize", cube, "-o", out, "--depth", 4).code == 2, "overwritten without --force")
    check(out.read_bytes() == old, "changed without --force")
    run("svo-voxelize", cube, "-o", out, "--depth", 4, "--force")
    check(out.read_bytes() != old)


def test_leaves_survive_as_parts_of_voxels(folder):
    path = model("C_textured/japanese_maple/japaneseMaple.obj")
    counts = {}
    for depth in (6, 8):
        run("svo-voxelize", path, "-o", folder / ("%d.svo" % depth), "--depth", depth, "--report", folder / "r.json")
        counts[depth] = report(folder / "r.json")["output"]
        (folder / "r.json").unlink()
    # a crown of thin leaves: more than a surface (4^2), less than a volume (8^2)
    growth = counts[8]["voxels"] / counts[6]["voxels"]
    check(8 < growth < 64, counts)


support.main(globals())
