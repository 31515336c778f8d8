"""Pictures of a city of deformed buildings with and without culling: what is left out is not seen. unit.culling does the same for random boxes."""

import json
import random
import shutil

import support
from support import check, model, read_png, run, tool

BUILDINGS = ["building-small-a", "building-small-b", "building-small-c", "building-small-d", "building-garage", "grass-trees", "grass-trees-tall", "pavement-fountain"]
CAMERAS = {"in a street": ("4,0.3,0.5", "6,0.4,-9"), "from above": ("5,6,3", "5,0,-5"), "in a house": ("5.05,0.4,-3.1", "1,0.6,-7"), "from afar": ("25,8,20", "5,0,-5")}
SIZE = ["--size", "240x180", "--fov", 50, "--no-shadows", "--background", "transparent"]


def city(folder, side=8, every=False):
    """Houses and trees in rows between roads; three of four are twisted, bent or sheared; with `every` all of them, roads too."""
    source = model("F_big/kenney_city/building-garage.glb").parent
    shutil.copytree(source, folder / "city", copy_function=shutil.copyfile)
    rng = random.Random(3)
    instances = []
    for x, z in ((x, z) for z in range(side) for x in range(side)):
        one = {"asset": rng.choice(BUILDINGS) if x % 4 and z % 4 else "road-straight", "translation": [x, 0, -z], "rotation": [0, 0.70710678, 0, 0.70710678] if rng.random() < 0.5 else [0, 0, 0, 1]}
        poses = ({"twist": {"degrees": rng.uniform(-60, 60)}}, {"bend": {"axis": "y", "towards": "x", "degrees": rng.uniform(-40, 40)}},
                 {"shear": {"xy": rng.uniform(-0.4, 0.4)}, "scale": [1, rng.uniform(0.7, 2), 1]}, None)
        pose = poses[rng.randrange(3 if every else 4)]
        if pose and (every or one["asset"] != "road-straight"):
            one["pose"] = pose
        instances.append(one)
    assets = [{"name": n, "file": "city/%s.glb" % n} for n in BUILDINGS + ["road-straight"]]
    (folder / "city.json").write_text(json.dumps({"assets": assets, "instances": instances}))
    run("svo-pack", folder / "city.json", "-o", folder / "city.svscene", "-q", "--depth", 6, "--page", 16)
    return folder / "city.svscene"


def draw(folder, scene, camera, *options):
    """(pixels as RGBA of a row each, deformation of the report)"""
    eye, target = CAMERAS[camera]
    run("svo-render", scene, "-o", folder / "o.png", "-f", "-q", *SIZE, "--eye", eye, "--target", target, "--report", folder / "r.json", *options)
    width, height, channels, rows = read_png(folder / "o.png")
    check((width, height, channels) == (240, 180, 4), (width, height, channels))
    return b"".join(bytes(r) for r in rows), json.loads((folder / "r.json").read_text())["deformation"]


def test_boxes_of_a_city_bit_for_bit(folder):
    scene, hidden = city(folder), 0
    for camera in CAMERAS:
        for method in ("direct", "mipmap"):
            (with_it, report), (without, every) = (draw(folder, scene, camera, "--resample", method, *o) for o in ((), ("--no-culling",)))
            check(sum(a != 0 for a in without[3::4]) > 200, (camera, method))
            check(every["nodes_hidden"] == every["nodes_outside"] == 0 and every["selected"] >= report["selected"], (report, every))
            hidden += report["nodes_hidden"]
            differ = [i for i in range(240 * 180) if with_it[4 * i:4 * i + 4] != without[4 * i:4 * i + 4]]
            check(not differ, "%s, %s: %d pixels differ, the first at %d, %d" % (camera, method, len(differ), differ[0] % 240 if differ else 0, differ[0] // 240 if differ else 0))
    check(hidden > 30000, hidden)


def test_cells_of_a_city(folder):
    """The same pixels are covered. The colour of one or two may differ: a cell that is seen has the average of all boxes that meet it, and one that a ray only grazes may meet a box that is
    hidden everywhere else."""
    scene, hidden = city(folder), 0
    for camera in CAMERAS:
        for method in ("resize", "emit"):
            (with_it, report), (without, every) = (draw(folder, scene, camera, "--resample", method, *o) for o in ((), ("--no-culling",)))
            check(every["nodes_hidden"] == every["nodes_outside"] == 0 and every["selected"] >= report["selected"], (report, every))
            hidden += report["nodes_hidden"]
            check(with_it[3::4] == without[3::4], "%s, %s: %d pixels are covered in one of them" % (camera, method, sum(a != b for a, b in zip(with_it[3::4], without[3::4]))))
            differ = sum(with_it[4 * i:4 * i + 4] != without[4 * i:4 * i + 4] for i in range(240 * 180))
            check(differ <= 10, (camera, method, differ))
    check(hidden > 10000, hidden)


def test_shadows_of_what_is_not_seen(folder):
    """What the eye does not see may throw a shadow; what can't is left out."""
    scene = city(folder, 8, True)
    for camera, (eye, target) in {**CAMERAS, "at a corner": ("2,0.15,-1", "6,0.5,-6")}.items():
        pictures, selected = [], []
        for i, options in enumerate(((), ("--no-culling",))):
            run("svo-render", scene, "-o", folder / "o.png", "-f", "-q", "--size", "240x180", "--fov", 50, "--background", "transparent", "--eye", eye, "--target", target, "--report",
                folder / "r.json", *options)
            pictures.append(b"".join(bytes(r) for r in read_png(folder / "o.png")[3]))
            report = json.loads((folder / "r.json").read_text())["deformation"]
            check(i == 0 or report["nodes_hidden"] + report["nodes_outside"] == 0, report)
            selected.append(report["selected"])
        a, b = pictures
        check(a[3::4] == b[3::4], camera)
        differ = sum(a[4 * i:4 * i + 4] != b[4 * i:4 * i + 4] for i in range(240 * 180))
        check(differ <= 10, (camera, differ))
        check(selected[0] <= selected[1] * (0.3 if camera == "at a corner" else 1), (camera, selected))
    for more in (("--bounce", 1), ("--reflections",)):
        run("svo-render", scene, "-o", folder / "o.png", "-f", "-q", "--size", "24x18", "--report", folder / "r.json", "--no-shadows", *more)
        report = json.loads((folder / "r.json").read_text())["deformation"]
        check(report["nodes_hidden"] + report["nodes_outside"] == 0, (more, report))


def test_with_things_at_rest_nothing_is_left_out(folder):
    """What is seen of them is not known when the others are selected: --no-culling changes nothing there."""
    scene = city(folder, 5)
    eye, target = CAMERAS["from above"]
    for options in ((), ("--no-culling",)):
        run("svo-render", scene, "-o", folder / ("s%d.png" % len(options)), "-q", "--size", "120x90", "--eye", eye, "--target", target, *options)
    check((folder / "s0.png").read_bytes() == (folder / "s1.png").read_bytes(), "another picture")
    r = tool("svo-render", scene, "-o", folder / "s2.png", "-q", "--size", "120x90", "--no-culling", "--resample", "direct")
    check(r.code == 0, r)


support.main(globals())
