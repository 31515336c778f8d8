"""svo-dump --html: the page in a headless Chromium against svo-render's picture of the same camera; dragging, wheel, slider; its size."""

import json
import os
import re
import sys

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))
import browser
import rig
import support
from support import check, run, tool

WIDTH, HEIGHT = 320, 240


def texture(x, y):
    return (255, 40, 40) if (x // 4 + y // 4) % 2 else (30, 90, 250)


def cube(folder, depth=6, name="cube", more=()):
    support.cube_glb(folder / (name + ".glb"), texture=support.write_png(None, 16, 16, texture))
    run("svo-voxelize", folder / (name + ".glb"), "-o", folder / (name + ".svo"), "--depth", depth, *more)
    return folder / (name + ".svo")


def sphere(folder, depth=6):
    support.sphere_obj(folder / "ball.obj")
    run("svo-voxelize", folder / "ball.obj", "-o", folder / "ball.svo", "--depth", depth)
    run("svo-compress", folder / "ball.svo", "-o", folder / "ball.svdag")
    return folder / "ball.svdag"


def scene(folder):
    sphere(folder)
    run("svo-compress", cube(folder), "-o", folder / "cube.svdag")
    (folder / "scene.json").write_text(json.dumps({
        "assets": [{"name": "ball", "file": "ball.svdag"}, {"name": "cube", "file": "cube.svdag"}],
        "instances": [{"asset": "ball", "translation": [-1.4, 0, 0], "name": "left"},
                      {"asset": "ball", "translation": [1.6, 0.2, -1], "rotation": [0.3, 0.2, 0.1, 0.9], "scale": [0.5, 1.2, 0.8]},
                      {"asset": "cube", "translation": [-1.2, -2.2, -1], "rotation": [0, 0.1, 0, 0.99498744], "name": "box"},
                      {"asset": "cube", "translation": [0.5, 0.8, -2], "scale": [-1, 1, 1]}]}))
    run("svo-pack", folder / "scene.json", "-o", folder / "scene.svscene")
    return folder / "scene.svscene"


def page(folder, file, *more):
    out = folder / (file.name + ".html")
    run("svo-dump", file, "--html", out, "-q", *more)
    return out


def pixels(path):
    width, height, channels, rows = support.read_png(path)
    return [[tuple(row[channels * x:channels * x + 3]) for x in range(width)] for row in rows]


def show(p, folder, name):
    """The canvas alone, sharp, as pixels."""
    p.evaluate("document.getElementById('panel').hidden = true; svokit.state.steady = true; svokit.draw(1); new Promise(f => requestAnimationFrame(() => requestAnimationFrame(f)))")
    p.screenshot(folder / name)
    return pixels(folder / name)


def camera(p, eye, target, fov):
    p.evaluate("svokit.setCamera(%s, %s, %g)" % (json.dumps(eye), json.dumps(target), fov))


def share_that_differs(a, b, by=12):
    n = sum(max(abs(u - v) for u, v in zip(p, q)) > by for r, s in zip(a, b) for p, q in zip(r, s))
    return n / (len(a) * len(a[0]))


def compare(folder, file, views, more=(), most=0.01):
    with browser.open_page(page(folder, file, *more), WIDTH, HEIGHT) as p:
        for i, (eye, target, fov) in enumerate(views):
            picture = folder / ("render%d.png" % i)
            vec = lambda v: ",".join("%.9g" % x for x in v)
            run("svo-render", file, "-o", picture, "-f", "--size", "%dx%d" % (WIDTH, HEIGHT), "--eye", vec(eye), "--target", vec(target), "--fov", fov)
            camera(p, eye, target, fov)
            shown, wanted = show(p, folder, "page%d.png" % i), pixels(picture)
            background = wanted[0][0]
            covered = sum(q != wanted[y][0] for y, row in enumerate(wanted) for q in row) / (WIDTH * HEIGHT)
            check(covered > 0.03, "view %d of %s shows nothing, background %s" % (i, file.name, background))
            differs = share_that_differs(shown, wanted)
            check(differs < most, "view %d of %s: %.2f %% of the pixels differ from svo-render's" % (i, file.name, 100 * differs))
        check(p.problems == [], p.problems)


def test_picture_is_svo_renders(folder):
    browser.find()
    compare(folder, scene(folder), [([1.5, 1.2, 5.4], [0, 0, 0], 40), ([-4, 3, -4], [0, 0, -0.5], 50), ([0.2, 6, 0.1], [0, 0, -0.3], 35)])
    compare(folder, cube(folder, 7, "deep"), [([2.2, 1.9, 2.7], [0.5, 0.5, 0.5], 30)])
    compare(folder, folder / "ball.svdag", [([0, 0, 3], [0, 0, 0], 45), ([0.9, 1.1, 1.3], [0, 0.7, 0], 60)])


def test_solid_with_full_leaves(folder):
    browser.find()
    support.cube_obj(folder / "solid.obj", color=(0.2, 0.8, 0.4))
    run("svo-voxelize", folder / "solid.obj", "-o", folder / "solid.svo", "--depth", 7, "--fill", "solid")
    compare(folder, folder / "solid.svo", [([2.2, 1.9, 2.7], [0.5, 0.5, 0.5], 30)])


def test_without_attributes_and_coarse(folder):
    browser.find()
    compare(folder, cube(folder, 5, "bare", ("--attributes", "none")), [([2.2, 1.9, 2.7], [0.5, 0.5, 0.5], 30)])
    compare(folder, cube(folder, 1, "tiny", ("--attributes", "color")), [([2.2, 1.9, 2.7], [0.5, 0.5, 0.5], 30)])


def test_panes_let_light_pass(folder):
    """Two panes that cover half of what is behind them, one behind the other, in front of a wall and above a floor with their shadows."""
    browser.find()
    quads = [("wall", (0.2, 0.5, 0.9), 1, [(-1, -1, -1), (1, -1, -1), (1, 1, -1), (-1, 1, -1)]), ("floor", (0.8, 0.7, 0.5), 1, [(-1, -1, -1), (-1, -1, 1), (1, -1, 1), (1, -1, -1)]),
             ("red", (1, 0.1, 0.1), 0.5, [(-0.9, -0.6, 0.2), (0.3, -0.6, 0.2), (0.3, 0.7, 0.2), (-0.9, 0.7, 0.2)]),
             ("green", (0.1, 0.9, 0.2), 0.4, [(-0.3, -0.8, 0.7), (0.8, -0.8, 0.5), (0.8, 0.4, 0.5), (-0.3, 0.4, 0.7)])]
    text, materials = ["mtllib panes.mtl"], []
    for i, (name, color, cover, corners) in enumerate(quads):
        materials.append("newmtl %s\nKd %g %g %g\nd %g" % (name, *color, cover))
        text += ["usemtl " + name] + ["v %g %g %g" % c for c in corners] + ["f %d %d %d %d" % tuple(4 * i + k for k in (1, 2, 3, 4))]
    (folder / "panes.obj").write_text("\n".join(text) + "\n")
    (folder / "panes.mtl").write_text("\n".join(materials) + "\n")
    run("svo-voxelize", folder / "panes.obj", "-o", folder / "panes.svo", "--depth", 6)
    check("coverage" in [c["name"] for c in json.loads(run("svo-dump", folder / "panes.svo", "--json").out)["attributes"]], "panes without coverage")
    compare(folder, folder / "panes.svo", [([0.2, 0.3, 4.2], [0, 0, 0], 40), ([2.6, 1.2, 3], [0, -0.1, 0], 40)])
    with browser.open_page(page(folder, folder / "panes.svo", "-f"), WIDTH, HEIGHT) as p:
        camera(p, [0.2, 0.3, 4.2], [0, 0, 0], 40)
        shown = show(p, folder, "through.png")
        red, both = shown[HEIGHT // 2 - 20][WIDTH // 2 - 40], shown[HEIGHT // 2][WIDTH // 2]
        check(red[2] > 60, "nothing of the wall is seen through the pane: %s" % (red,))
        check(both[1] > red[1] and both[0] < red[0], "the second pane does not tint: %s behind it %s" % (both, red))


def test_controls(folder):
    browser.find()
    file = scene(folder)
    run("svo-dump", file, "--voxels", folder / "all.ply", "-q")
    with browser.open_page(page(folder, file), WIDTH, HEIGHT) as p:
        camera(p, [1.5, 1.2, 5.4], [0, 0, 0], 40)
        plain = show(p, folder, "plain.png")
        seen = {"plain": plain}
        for name, change in (("normal", "mode = 1"), ("level", "mode = 2"), ("instance", "mode = 3"), ("flat", "mode = 5"), ("coarse", "level = 3"),
                             ("slice", "axis = 0"), ("other side", "flip = true"), ("no shadow", "shadows = false")):
            if name == "slice":
                p.evaluate("svokit.state.level = 6; svokit.state.mode = 0")
            if name == "no shadow":
                p.evaluate("svokit.state.axis = -1")
            p.evaluate("svokit.state." + change + "; svokit.redraw()")
            seen[name] = show(p, folder, "shot.png")
        for name, shot in seen.items():
            check(name == "plain" or share_that_differs(shot, plain, 3) > (0.0005 if name == "no shadow" else 0.005), "%s changes nothing" % name)
        check(share_that_differs(seen["slice"], seen["other side"], 3) > 0.02)
        flat = {q for row in seen["instance"] for q in row}
        check(len(flat) > 4)
        # real events
        p.evaluate("Object.assign(svokit.state, {mode: 0, level: 6, axis: -1, flip: false, shadows: true}); document.getElementById('panel').hidden = true")
        before = p.evaluate("svokit.view()")
        p.drag((150, 100), (180, 115))
        turned = p.evaluate("svokit.view()")
        distance = lambda v: sum((a - b) ** 2 for a, b in zip(v["eye"], v["target"])) ** 0.5
        check(turned["target"] == before["target"] and turned["eye"] != before["eye"] and abs(distance(turned) - distance(before)) < 1e-6, (before, turned))
        p.drag((150, 100), (170, 100), button="right")
        moved = p.evaluate("svokit.view()")
        step = lambda a, b: [y - x for x, y in zip(a, b)]
        check(max(abs(a - b) for a, b in zip(step(turned["eye"], moved["eye"]), step(turned["target"], moved["target"]))) < 1e-9 and moved["eye"] != turned["eye"])
        p.drag((150, 100), (170, 100), modifiers=8)
        check(p.evaluate("svokit.view()")["eye"] != moved["eye"], "shift and drag does not move")
        camera(p, [1.5, 1.2, 5.4], [0, 0, 0], 40)
        under = p.evaluate("svokit.pick(95, 122)")
        check(under is not None and under["instance"] in range(4), under)
        p.wheel(95, 122, -400)
        p.wait("svokit.view().eye[2] < 5.3")
        after = p.evaluate("svokit.pick(95, 122)")
        gap = max(abs(a - b) for a, b in zip(under["position"], after["position"]))
        check(after["t"] < 0.7 * under["t"] and gap < 0.03, "the wheel does not zoom to the pointer: %s %s" % (under, after))
        slider = "const e = document.getElementById('level'); e.value = 2; e.dispatchEvent(new Event('input')); svokit.state.level"
        check(p.evaluate(slider) == 2 and p.evaluate("svokit.pick(95, 122).level") <= 2)
        p.evaluate("Object.assign(svokit.state, {level: 6, detail: false}); svokit.redraw()")
        camera(p, [1.5, 1.2, 5.4], [0, 0, 0], 40)
        # what is picked is a voxel of that instance
        columns = support.read_ply(folder / "all.ply")
        voxels = set(zip(columns["instance"], columns["vx"], columns["vy"], columns["vz"]))
        hits = [h for h in (p.evaluate("svokit.pick(%d, %d)" % (x, y)) for x in range(30, 320, 45) for y in range(30, 240, 35)) if h]
        check(len(hits) > 8, len(hits))
        on_edge = sum((h["instance"], *h["cell"]) not in voxels for h in hits)
        check(on_edge <= len(hits) // 10, "%d of %d picked cells are no voxels" % (on_edge, len(hits)))
        check(p.problems == [], p.problems)


def covered_columns(shot, until):
    """First and last column left of `until` that shows something else than the background of its row."""
    columns = [x for x in range(until) if any(max(abs(u - v) for u, v in zip(row[x], row[0])) > 12 for row in shot)]
    check(columns, "nothing is seen")
    return columns[0], columns[-1]


def test_panel_leaves_the_middle(folder):
    """What is framed stands in the middle of what the panel leaves free; the wheel keeps what is under the pointer there too."""
    browser.find()
    html = page(folder, sphere(folder))
    for width, height, folded in ((900, 500, False), (660, 500, False), (360, 560, True)):
        with browser.open_page(html, width, height) as p:
            check(p.evaluate("document.getElementById('panel').classList.contains('folded')") is folded, "%d wide: panel folded is not %s" % (width, folded))
            free = width if folded else p.evaluate("document.getElementById('panel').offsetLeft")
            check(folded or width - free > 300, free)
            p.evaluate("document.getElementById('fold').style.visibility = 'hidden'")
            if folded:
                p.evaluate("document.getElementById('panel').style.opacity = 0")
            p.evaluate("Object.assign(svokit.state, {steady: true, shadows: false}); svokit.draw(1)")
            p.screenshot(folder / "wide.png")
            first, last = covered_columns(pixels(folder / "wide.png"), free - 12) # left of the panel's shadow
            check(0 < first and last < free - 13 and abs(first + last + 1 - free) <= 3, "%d wide: columns %d to %d of %d free ones" % (width, first, last, free))
            check(last - first > 0.3 * free, "framed too small: columns %d to %d of %d" % (first, last, free))
            x, y = (first + free // 2) // 2, height // 2
            under = p.evaluate("svokit.pick(%d, %d)" % (x, y))
            p.wheel(x, y, -300)
            p.wait("svokit.pick(%d, %d).t < 0.9 * %g" % (x, y, under["t"]))
            after = p.evaluate("svokit.pick(%d, %d)" % (x, y))
            check(max(abs(a - b) for a, b in zip(under["position"], after["position"])) < 0.05, "the wheel does not zoom to the pointer: %s %s" % (under, after))
            p.evaluate("svokit.frame(); document.getElementById('fold').click(); document.getElementById('panel').style.opacity = 0")
            if not folded: # without the panel: the middle of the window
                p.evaluate("svokit.draw(1)")
                p.screenshot(folder / "folded.png")
                first, last = covered_columns(pixels(folder / "folded.png"), width)
                check(abs(first + last + 1 - width) <= 3, "columns %d to %d of %d" % (first, last, width))
            check(p.problems == [], p.problems)


def test_labels(folder):
    browser.find()
    file = cube(folder, 5, "label", ("--attributes", "color,material"))
    with browser.open_page(page(folder, file), WIDTH, HEIGHT) as p:
        check(p.evaluate("[...document.getElementById('mode').options].some(o => o.text === 'material')"), "no choice of labels")
        camera(p, [2.2, 1.9, 2.7], [0.5, 0.5, 0.5], 30)
        a = show(p, folder, "a.png")
        p.evaluate("svokit.state.mode = 4; svokit.redraw()")
        check(share_that_differs(a, show(p, folder, "b.png")) > 0.05)
        check(p.problems == [], p.problems)


def test_size(folder):
    file = sphere(folder, 9)
    full = page(folder, file)
    small = folder / "small.html"
    r = run("svo-dump", file, "--html", small, "--html-size", "300K", "--report", folder / "r.json")
    check("--html-size" in r.err, r)
    check(small.stat().st_size <= 300 * 1024 < full.stat().st_size, (small.stat().st_size, full.stat().st_size))
    out = support.report(folder / "r.json")["output"]["html"]
    check(out["bytes"] == small.stat().st_size and out["levels_left_out"] == 9 - out["level"] > 0, out)
    meta = json.loads(re.search(r'<script id="meta"[^>]*>(.*?)</script>', small.read_text(), re.S).group(1))
    check(meta["dropped_levels"] == out["levels_left_out"] and meta["assets"][0]["depth"] == out["level"])
    levels = {l["level"]: l["nodes"] for l in meta["summary"]["levels"]}
    check(meta["assets"][0]["leaves"] == levels[out["level"]], "the cut has not all nodes of its level")
    with browser.open_page(small, WIDTH, HEIGHT) as p:
        camera(p, [0, 0, 3], [0, 0, 0], 45)
        shot = show(p, folder, "small.png")
        check(0.2 < share_that_differs(shot, [[row[0]] * WIDTH for row in shot]) < 0.6)
        check(p.problems == [], p.problems)


def test_poses_are_drawn(folder):
    """Bones, twists and bends on the page are those of svo-render's picture, and the bones are there to be looked at; --rest draws assets as they are."""
    browser.find()
    rig.arm(folder / "arm.gltf")
    run("svo-pack", folder / "arm.gltf", "-o", folder / "arm.svscene", "--depth", 8, "--time", 0.5)
    low, high = (json.loads(run("svo-dump", folder / "arm.svscene", "--json").out)["bounds"][k] for k in ("low", "high"))
    middle, size = [(a + b) / 2 for a, b in zip(low, high)], max(b - a for a, b in zip(low, high))
    views = [([middle[0] + size * x, middle[1] + size * y, middle[2] + size * z], middle, 40) for x, y, z in ((0.4, 0.5, 1.4), (-1.2, 0.2, -0.9))]
    compare(folder, folder / "arm.svscene", views, most=0.03)
    r = run("svo-dump", folder / "arm.svscene", "--html", folder / "arm.html", "--report", folder / "r.json")
    out = support.report(folder / "r.json")["output"]["html"]
    check("pose" not in r.err and (out["posed_instances"], out["poses_left_out"], out["coarser_poses"]) == (1, 0, 0), (r, out))
    rest = run("svo-dump", folder / "arm.svscene", "--html", folder / "rest.html", "--rest", "--report", folder / "r.json")
    out = support.report(folder / "r.json")["output"]["html"]
    check(tool("svo-dump", sphere(folder, 3), "--html", folder / "x.html", "--rest").code == 1 and not (folder / "x.html").exists())
    check("without their pose: 1" in rest.err and (out["posed_instances"], out["poses_left_out"]) == (0, 1), (rest, out))
    shots = []
    for name in ("arm.html", "rest.html"):
        with browser.open_page(folder / name, WIDTH, HEIGHT) as p:
            camera(p, *views[0])
            shots.append(show(p, folder, "shot.png"))
            check(("1 instance is shown without pose" in p.evaluate("document.getElementById('facts').textContent")) == (name == "rest.html"), name)
            p.evaluate("svokit.state.mode = 4; svokit.redraw()")
            colors = {q for row in show(p, folder, "bones.png") for q in row}
            check(p.evaluate("[...document.getElementById('mode').options].some(o => o.text === 'bone')") and len(colors) > 3, "%s: no bones" % name)
            check(p.problems == [], p.problems)
    check(share_that_differs(*shots) > 0.02, "the pose changes nothing")


def bent_scene(folder, count):
    """Instances in a row, each with a twist of its own but the last three: one bent, one at rest, one as the first."""
    if not (folder / "cube.svdag").exists():
        sphere(folder)
        run("svo-compress", cube(folder, 7, "cube", ("--attributes", "normal")), "-o", folder / "cube.svdag")
    instances = [{"asset": "cube", "translation": [1.5 * i, 0, 0], "pose": {"twist": {"axis": "y", "degrees": 10 + 80 * i / count}}} for i in range(count)]
    instances += [{"asset": "ball", "translation": [0, 0, -3], "pose": {"bend": {"axis": "y", "towards": "x", "degrees": 70}}}, {"asset": "cube", "translation": [-2, 0, 0], "scale": [0.5, 0.5, 0.5]},
                  dict(instances[0], translation=[0, 1.5, 0])]
    (folder / "bent.json").write_text(json.dumps({"assets": [{"name": "ball", "file": "ball.svdag"}, {"name": "cube", "file": "cube.svdag"}], "instances": instances}))
    run("svo-pack", folder / "bent.json", "-o", folder / "bent.svscene", "-f")
    return folder / "bent.svscene"


def test_twisted_and_bent(folder):
    browser.find()
    file = bent_scene(folder, 3)
    compare(folder, file, [([1.5, 1.2, 5.4], [1, 0, 0], 50), ([-4, 3, -4], [1, 0.3, -1], 50)], most=0.03)
    meta = json.loads(re.search(r'<script id="meta"[^>]*>(.*?)</script>', page(folder, file, "-f").read_text(), re.S).group(1))
    names = [a["name"] for a in meta["assets"]]
    check(len(names) == 5 and sorted(n.split(" ")[0] for n in names) == ["ball"] + 4 * ["cube"] and sum("(pose " in n for n in names) == 4, names) # equal poses are one
    a = page(folder, file, "-f", "--threads", 1).read_bytes()
    check(a == page(folder, file, "-f", "--threads", 3).read_bytes(), "the page depends on threads")


def test_a_crowd_of_poses(folder):
    """Many poses share the nodes that a page has room for: they are made of coarser ones, and it says so; more poses than a page takes stand as they are."""
    file = bent_scene(folder, 3000)
    r = run("svo-dump", file, "--html", folder / "crowd.html", "--report", folder / "r.json")
    out = support.report(folder / "r.json")["output"]["html"]
    check("coarser nodes, for their number: 3" in r.err and out["coarser_poses"] > 3000 and out["posed_instances"] == 3002 and out["poses_left_out"] == 0, (r, out))
    r = tool("svo-dump", file, "--html", folder / "small.html", "--html-size", "300K")
    check(r.code == 6 and "--rest" in r.err and not (folder / "small.html").exists(), r)
    run("svo-dump", file, "--html", folder / "small.html", "--html-size", "300K", "--rest")
    file = bent_scene(folder, 10000)
    r = run("svo-dump", file, "--html", folder / "crowd.html", "-f", "--report", folder / "r.json")
    out = support.report(folder / "r.json")["output"]["html"]
    check("without their pose: 10002" in r.err and out["poses_left_out"] == 10002, (r, out))


def test_more_nodes_than_can_be_drawn(folder):
    """A page draws 2^24 nodes of an octree: the level above is shown, and the message does not blame --html-size."""
    support.sphere_obj(folder / "s.obj", 64)
    run("svo-voxelize", folder / "s.obj", "-o", folder / "s.svo", "--depth", 11, "--attributes", "none")
    r = run("svo-dump", folder / "s.svo", "--html", folder / "s.html", "--html-size", "1G", "--report", folder / "r.json")
    check("level 10 of 11" in r.err and "nodes" in r.err and "--html-size" not in r.err, r)
    check(support.report(folder / "r.json")["output"]["html"]["levels_left_out"] == 1)


def test_same_bytes_and_refusals(folder):
    file = cube(folder, 4)
    a = page(folder, file).read_bytes()
    check(run("svo-dump", file, "--html", "-", "--threads", 1).out == a, "stdout differs from the file")
    check(b"http:" not in a.replace(b"http://www.w3.org", b"") and b"https:" not in a, "the page names the network")
    check(tool("svo-dump", file, "--html", folder / (file.name + ".html")).code == 2, "overwrites without --force")
    check(tool("svo-dump", file, file, "--html", folder / "x.html").code == 1)
    check(tool("svo-dump", file, "--html", "-", "--json").code == 1)
    check(tool("svo-dump", file, "--html", folder / "x.html", "--html-size", "1K").code == 1)
    (folder / "bad.svo").write_bytes(file.read_bytes()[:-40])
    check(tool("svo-dump", folder / "bad.svo", "--html", folder / "x.html").code == 3)
    check(not (folder / "x.html").exists())
    odd = folder / "a<b>&</script>.svo".replace("/", "_")
    odd.write_bytes(file.read_bytes())
    text = page(folder, odd).read_text()
    check("<title>a&lt;b>&amp;&lt;_script>.svo</title>" in text, text[:900])
    check(json.loads(re.search(r'<script id="meta"[^>]*>(.*?)</script>', text, re.S).group(1))["summary"]["file"] == odd.name)


def test_nothing_to_draw(folder):
    browser.find()
    (folder / "none.obj").write_text("v 0 0 0\n")
    run("svo-voxelize", folder / "none.obj", "-o", folder / "none.svo", "--depth", 4)
    with browser.open_page(page(folder, folder / "none.svo"), WIDTH, HEIGHT) as p:
        check(p.evaluate("svokit.pick(10, 10)") is None)
        shot = show(p, folder, "none.png")
        check(all(len(set(row)) == 1 for row in shot), "something is drawn")
        check(p.problems == [], p.problems)


support.main(globals())
