"""svo-skeleton --repair cgal and --tessellate openmesh: meshes with known faults, counts of what was found, and the curve beside that of the own path."""

import math

import support
from support import check, run, tool


def tube(n=24, m=10, length=3.0, radius=0.3):
    """Points and triangles of a closed tube along x."""
    points = [(length * i / n, radius * math.cos(2 * math.pi * j / m), radius * math.sin(2 * math.pi * j / m)) for i in range(n + 1) for j in range(m)]
    points += [(0.0, 0.0, 0.0), (length, 0.0, 0.0)]
    faces = []
    for i in range(n):
        for j in range(m):
            a, b = i * m + j, i * m + (j + 1) % m
            faces += [(a, b, b + m), (a, b + m, a + m)]
    for j in range(m):
        faces += [(len(points) - 2, (j + 1) % m, j), (len(points) - 1, n * m + j, n * m + (j + 1) % m)]
    return points, faces


def write(path, points, faces):
    lines = ["v %.17g %.17g %.17g" % p for p in points] + ["f %d %d %d" % tuple(i + 1 for i in f) for f in faces]
    path.write_text("\n".join(lines) + "\n")
    return path


def skeleton(folder, name, mesh, *options):
    run("svo-skeleton", mesh, "-o", folder / (name + ".skel"), "-f", "-q", "--omega", 0.05, "--report", folder / "r.json", *options)
    return support.report(folder / "r.json")


def has(folder, *options):
    """Whether the tool was built with what the option needs; it says so if not."""
    points, faces = tube(6, 6)
    r = tool("svo-skeleton", write(folder / "probe.obj", points, faces), "-o", folder / "probe.skel", "-f", "--omega", 0.1, *options)
    if r.code == 5 and "built without" in r.err:
        check(not (folder / "probe.skel").exists(), r)
        support.skip(r.err.strip())
    check(r.code == 0, r)


def same_content(folder, a, b):
    r = tool("svo-compare", folder / (a + ".skel"), folder / (b + ".skel"), "--report", folder / "c.json", "-f")
    return r.code == 0, support.report(folder / "c.json")["comparison"]["skeleton"]


def test_repair_finds_what_is_wrong(folder):
    has(folder, "--repair", "cgal")
    points, faces = tube()
    fins = [(12, 13, 22), (57, 58, 67)]  # edges of three triangles
    apex = len(points)
    cases = {
        "sound": (points, faces, {}),
        "unshared": ([points[i] for f in faces for i in f], [(3 * k, 3 * k + 1, 3 * k + 2) for k in range(len(faces))], {"points_merged": 3 * len(faces) - len(points)}),
        "turned": (points, [f if k % 3 else f[::-1] for k, f in enumerate(faces)], {"triangles_turned": None}),
        "twice": (points, faces + [f[::-1] for f in faces[:7]], {"triangles_duplicate": 7}),
        "lines": (points, faces + [(3, 3, 4), (5, 9, 9)], {"triangles_degenerate": 2}),
        "fins": (points + [(0.4, 0.5, 0.5), (1.6, 0.5, 0.5)], faces + [(a, b, apex + k) for k, (a, b, _) in enumerate(fins)], {"edges_nonmanifold": 2, "points_added": None}),
    }
    for name, (p, f, wanted) in cases.items():
        mesh = write(folder / (name + ".obj"), p, f)
        before = mesh.read_bytes()
        own = skeleton(folder, "own", mesh)
        check("repair" not in own["input"], own["input"])
        report = skeleton(folder, "cgal", mesh, "--repair", "cgal")
        found = report["input"]["repair"]
        check(mesh.read_bytes() == before, "the input was changed")
        check(found["manifold"] is True, (name, found))
        for key in ("points_merged", "triangles_turned", "triangles_duplicate", "triangles_degenerate", "edges_nonmanifold", "points_added"):
            value = wanted.get(key, 0)
            if name != "fins" or key in wanted:  # neighbours of a fin may be cut apart and turned in more ways than one
                check(found[key] == value if value is not None else found[key] > 0, (name, key, found))
        check(report["input"]["elements"] == len(p) and report["input"]["mapped"] == own["input"]["mapped"], (name, report["input"], own["input"]))
        same, distance = same_content(folder, "own", "cgal")
        if name == "fins":  # which sides of a fin belong together decides what is inside
            check(distance["curve_distance_mean_omegas"] < 1, distance)
        else:  # the contraction welds on its lattice what CGAL merges, turns and cuts apart
            check(same or name == "lines" and distance["curve_distance_mean_omegas"] < 0.5, (name, distance))


def test_both_sides_of_a_sheet(folder):
    """A model whose triangles are all there twice, in opposite directions, has an inside all the same: the skeleton of the model without them."""
    points, faces = tube()
    skeleton(folder, "once", write(folder / "once.obj", points, faces))
    report = skeleton(folder, "both", write(folder / "both.obj", points, faces + [f[::-1] for f in faces]))
    check(same_content(folder, "once", "both")[0], "the doubled model has another skeleton")
    check(report["errors"]["length_inside_percent"] == 100, report["errors"])


def test_openmesh_cuts_edges(folder):
    has(folder, "--tessellate", "openmesh")
    points, faces = tube(6, 6)
    fin = (points + [(0.4, 0.5, 0.5)], faces + [(12, 13, len(points))])
    shuffled = (points, [f if k % 2 else f[::-1] for k, f in enumerate(faces)])
    unshared = ([points[i] for f in faces for i in f], [(3 * k, 3 * k + 1, 3 * k + 2) for k in range(len(faces))])
    for name, (p, f), apart in (("sound", (points, faces), False), ("fin", fin, True), ("turned", shuffled, True), ("unshared", unshared, False)):
        mesh = write(folder / (name + ".obj"), p, f)
        own = skeleton(folder, "own", mesh)
        report = skeleton(folder, "om", mesh, "--tessellate", "openmesh")
        cut = report["input"]["tessellation"]
        check(cut["splits"] > 100 and (cut["triangles_apart"] > 0) == apart, (name, cut))
        out, a, b = report["output"], report["input"], own["input"]
        # the same points on every edge of the mesh, whatever diagonals; so about as many, and nothing falls apart
        check(abs(a["vertices_tessellated"] - b["vertices_tessellated"]) <= 0.25 * b["vertices_tessellated"], (name, a, b))
        check((out["components"], out["loops"]) == (1, 0) and out["ends"] <= 3, (name, out))
        check(a["mapped"] == a["elements"] == len(p), (name, a))
        _, distance = same_content(folder, "own", "om")
        check(distance["curve_distance_mean_omegas"] < 1.5, (name, distance))
    files = []
    for threads in (1, 3):
        skeleton(folder, "t%d" % threads, folder / "fin.obj", "--tessellate", "openmesh", "--threads", threads)
        files.append((folder / ("t%d.skel" % threads)).read_bytes())
    check(files[0] == files[1], "bytes depend on threads")


def test_everything_follows_the_map(folder):
    """Weights, segments and bones of voxels go by the map, which stays that of the mesh that was given."""
    has(folder, "--repair", "cgal", "--tessellate", "openmesh")
    points, faces = tube()
    mesh = write(folder / "soup.obj", [points[i] for f in faces for i in f], [(3 * k, 3 * k + 1, 3 * k + 2) for k in range(len(faces))])
    run("svo-voxelize", mesh, "-o", folder / "v.svo", "--depth", 5, "--attributes", "none")
    report = skeleton(folder, "all", mesh, "--repair", "cgal", "--tessellate", "openmesh", "--glb", folder / "a.glb", "--segments", folder / "s.ply", "--reconstruct", folder / "c.ply",
                      "--bind", folder / "v.svo", "--bound", folder / "b.svo")
    check(report["output"]["bound"]["unbound"] == 0 and report["output"]["segmentation"]["segments"] == 1, report["output"])
    run("svo-dump", "--validate", folder / "all.skel", folder / "b.svo")
    for name in ("a.glb", "c.ply", "s.ply"):
        run("svo-voxelize", folder / name, "-o", folder / "x.svo", "-f", "--depth", 4, "--attributes", "none")


def test_limits(folder):
    has(folder, "--repair", "cgal", "--tessellate", "openmesh")
    mesh = write(folder / "tube.obj", *tube(60, 30))
    for options, word in ((("--repair", "cgal", "--memory", "1500K"), "--repair own"), (("--tessellate", "openmesh", "--memory", "1200K"), "larger omega"),
                          (("--tessellate", "openmesh", "--max-vertices", 2500, "--omega", 0.004), "larger omega")):
        r = tool("svo-skeleton", mesh, "-o", folder / "x.skel", *options)
        check(r.code == 6 and word in r.err and not (folder / "x.skel").exists(), r)
    run("svo-voxelize", mesh, "-o", folder / "v.svo", "--depth", 4)
    for options in (("--repair", "cgal"), ("--tessellate", "openmesh")):
        r = tool("svo-skeleton", folder / "v.svo", "-o", folder / "x.skel", "--omega", 0.1, *options)
        check(r.code == 5 and options[0] in r.err, r)
    flat = write(folder / "lines.obj", [(0, 0, 0), (1, 0, 0)], [(0, 1, 1), (1, 0, 0)])
    r = tool("svo-skeleton", flat, "-o", folder / "x.skel", "--omega", 0.1, "--repair", "cgal")
    check(r.code == 3 and "--repair own" in r.err, r)


def test_damaged_models(folder):
    has(folder, "--repair", "cgal", "--tessellate", "openmesh")
    for model in ("B_damaged/non_manif_hole/non_manif_hole.ply", "B_damaged/teapot/teapot.obj", "B_damaged/busted/busted.STL"):
        mesh = support.model(model)
        for options in (("--tessellate", "openmesh"), ("--repair", "cgal", "--tessellate", "openmesh")):
            report = skeleton(folder, "m", mesh, *options)
            run("svo-dump", "--validate", folder / "m.skel")
            check(report["output"]["joints"] > 0, (model, report["output"]))
            check("repair" not in report["input"] or report["input"]["repair"]["manifold"], (model, report["input"]))


support.main(globals())
