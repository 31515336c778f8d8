"""svo-pack's report of what was left out: each saving beside a second packing in which that thing is not left out."""

import json
import shutil

import support
from support import check, model, tool

ALIGNMENT = 64  # of a chunk in a file
CHUNK = 128  # what a chunk that is there at all takes at most beyond its elements: its header, and that alignment


def pack(scene, out, *args):
    """output of the report, its savings by what they are."""
    report = out.with_suffix(".json")
    r = tool("svo-pack", scene, "-o", out, "-f", "-q", "--report", report, *args)
    check(r.code == 0, r)
    found = json.loads(report.read_text())["output"]
    found["saved"] = {}
    for o in found["left_out"]:
        found["saved"].setdefault(o["what"], []).append(o)
    check(found["bytes"] == sum(found["bytes_by_part"].values()) == out.stat().st_size, found)
    return found


def dumped(path):
    """What svo-dump says was left out: {what: (count, bytes_saved)}."""
    return {o["what"]: (o["count"], o["bytes_saved"]) for o in json.loads(support.run("svo-dump", path, "--json").out)["left_out"]}


def describe(folder, instances, assets=(("a", "a.obj"),), poses=()):
    path = folder / "scene.json"
    scene = {"assets": [{"name": n, "file": f} for n, f in assets], "instances": instances}
    if poses:
        scene["poses"] = list(poses)
    path.write_text(json.dumps(scene))
    return path


def one(found, what):
    """Bytes said to be saved by the one thing whose text begins so."""
    all_of = [o for text, list_of in found["saved"].items() for o in list_of if text.startswith(what)]
    check(len(all_of) == 1, (what, found["saved"]))
    return all_of[0]["bytes"]


def part(with_it, without, *names):
    return sum(with_it["bytes_by_part"][n] - without["bytes_by_part"][n] for n in names)


def near(said, measured, room):
    check(abs(said - measured) <= room, "%s said, %s measured" % (said, measured))


def row(count, **more):
    return [dict({"asset": "a", "translation": [3 * i, 0, 0]}, **more) for i in range(count)]


def test_instances_that_show_nothing(folder):
    """A thousand of each kind: hidden, flat, of an empty asset. With them: a thousand that stand like the others."""
    support.cube_obj(folder / "a.obj")
    (folder / "empty.obj").write_text("v 0 0 0\n")
    assets = [("a", "a.obj"), ("e", "empty.obj")]
    plain, every = pack(describe(folder, row(1000)), folder / "p.svscene", "--depth", 2), pack(describe(folder, row(2000)), folder / "e.svscene", "--depth", 2)
    measured = part(every, plain, "instances")
    for what, instance in (("instances hidden", {"scale": [0, 0, 0]}), ("instances with a singular", {"scale": [1, 0, 1]}), ("instances of assets without voxels", {"asset": "e"})):
        found = pack(describe(folder, row(1000) + row(1000, **instance), assets), folder / "o.svscene", "--depth", 2)
        check(found["bytes_by_part"]["instances"] == plain["bytes_by_part"]["instances"] and found["instances"] == 1000, found)
        near(one(found, what), measured, 3 * ALIGNMENT)


def test_names(folder):
    support.cube_obj(folder / "a.obj")
    without = pack(describe(folder, row(1000)), folder / "o.svscene", "--depth", 2)
    named = pack(describe(folder, row(1000, name="one")), folder / "n.svscene", "--depth", 2)
    near(one(without, "names of instances"), part(named, without, "names"), 2 * ALIGNMENT + len("one") + 1)


def test_assets(folder):
    """Equal ones and one that no instance names, in a scene where they are used, or differ by a turn of their voxels."""
    path = model("A_organic/camel/camel.off")
    for name in ("a", "b", "c"):
        shutil.copyfile(path, folder / (name + ".off"))
    assets = [(n, n + ".off") for n in "abc"]
    found = pack(describe(folder, [{"asset": "a"}, {"asset": "b"}], assets), folder / "o.svscene", "--depth", 6)
    alone = pack(describe(folder, [{"asset": "b"}], assets[1:2]), folder / "b.svscene", "--depth", 6)
    near(one(found, "asset equal"), alone["bytes_by_part"]["assets"], ALIGNMENT)
    check(found["bytes_by_part"]["assets"] == alone["bytes_by_part"]["assets"], (found, alone))
    check(one(found, "asset that no visible") == path.stat().st_size, found)
    # the file itself tells of it
    told = dumped(folder / "o.svscene")
    check(set(told) == set(found["saved"]) and all(told[w][1] == sum(o["bytes"] for o in l) for w, l in found["saved"].items()), (told, found["saved"]))
    check(told["asset that no visible instance names"][0] == told["asset equal to another one"][0] == 1, told)
    check("left out" in support.run("svo-dump", folder / "o.svscene").text)


def test_a_budget_holds_with_many_names(folder):
    """The provenance of 300 assets takes more than all of them do: it counts."""
    assets = []
    for i in range(300):
        support.cube_obj(folder / ("a cube with a long name, number %d.obj" % i), size=1 + i)
        assets.append(("n%d" % i, "a cube with a long name, number %d.obj" % i))
    scene = describe(folder, [{"asset": n} for n, _ in assets], assets)
    fitted = 0
    for budget in (10000, 500000, 1000000, 3000000):
        r = tool("svo-pack", scene, "-o", folder / "b.svscene", "-f", "-q", "--budget", budget, "--report", folder / "r.json")
        if r.code == 6:
            continue
        found = json.loads((folder / "r.json").read_text())["output"]
        tried = {t["depth"]: t["bytes"] for t in found["budget_tried"]}
        fits = [d for d in tried if tried[d] <= budget]
        check(r.code == 0 and found["bytes"] == (folder / "b.svscene").stat().st_size == tried[max(fits)] <= budget, (budget, str(r), tried))
        check(all(tried[d] > budget for d in tried if d > max(fits)), (budget, tried))
        fitted += 1
    check(fitted >= 2, "no budget was enough")


def test_poses(folder):
    """Of a hundred instances: poses that rest, and poses that are the same, beside as many that all differ."""
    support.cube_obj(folder / "a.obj")

    def twisted(of):
        return [dict(i, pose={"twist": {"degrees": of(n)}}) for n, i in enumerate(row(100))]

    every = pack(describe(folder, twisted(lambda n: n + 1)), folder / "e.svscene", "--depth", 2)
    same = pack(describe(folder, twisted(lambda n: 9)), folder / "s.svscene", "--depth", 2)
    check((every["poses"], same["poses"]) == (100, 1), (every, same))
    near(one(same, "poses equal"), part(every, same, "poses"), ALIGNMENT)
    rest = pack(describe(folder, twisted(lambda n: 9 if n == 0 else 0)), folder / "r.svscene", "--depth", 2)
    near(one(rest, "poses that move nothing"), part(every, rest, "poses"), 2 * ALIGNMENT)


def test_matrices(folder):
    """Poses of one matrix that differ in their twist, beside as many with matrices of their own; affine maps first, then bones, of which the last rest."""
    support.cube_obj(folder / "a.obj")

    def poses(of):
        return [dict(i, pose=dict({"twist": {"degrees": n + 1}}, **of(n))) for n, i in enumerate(row(100))]

    every = pack(describe(folder, poses(lambda n: {"scale": [1, 2 + n, 1]})), folder / "e.svscene", "--depth", 2)
    same = pack(describe(folder, poses(lambda n: {"scale": [1, 2, 1]})), folder / "s.svscene", "--depth", 2)
    check((every["pose_matrices"], same["pose_matrices"]) == (100, 1), (every, same))
    near(one(same, "matrices of poses equal"), part(every, same, "poses"), ALIGNMENT)


def test_bones(folder):
    """A skinned model under its animation: bones at the end of a list that rest, and a channel of bones that nothing moves."""
    path = model("A_organic/camel/camel.off")
    for args in (("svo-voxelize", path, "-o", folder / "a.svo", "--depth", 7, "-q"),
                 ("svo-skeleton", path, "-o", folder / "a.skel", "--omega", 0.05, "--bind", folder / "a.svo", "--bound", folder / "b.svo", "-q")):
        if not (support.tools / args[0]).exists():
            support.skip(args[0] + " is not built")
        r = tool(*args)
        check(r.code == 0, r)
    assets = [("a", "b.svo")]

    def moved(last):
        bones = [{"bone": 1, "translation": [0.1, 0, 0]}, {"bone": 19, "translation": [0, 0.1 if last else 0, 0]}]
        return describe(folder, [{"asset": "a", "pose": {"bones": bones}}], assets)

    all_of, few = pack(moved(True), folder / "l.svscene"), pack(moved(False), folder / "f.svscene")
    near(one(few, "bones that no pose moves, at the end"), part(all_of, few, "poses"), 2 * ALIGNMENT)
    rest = pack(describe(folder, [{"asset": "a"}], assets), folder / "r.svscene")
    near(one(rest, "channels bone of assets"), part(all_of, rest, "assets"), 5 * CHUNK)  # values, blocks, palettes, ... of a channel


def test_bones_of_a_gltf_character(folder):
    """A walking man beside one who stands as he was bound: his pose and its 19 matrices; walkers in step beside walkers that are not."""
    source = model("D_gltf/features/skin_cesium_man/CesiumMan.gltf").parent
    for f in source.iterdir():
        shutil.copyfile(f, folder / f.name)
    man = folder / "CesiumMan.gltf"
    stands, walks = pack(man, folder / "s.svscene", "--depth", 6), pack(man, folder / "w.svscene", "--depth", 6, "--time", 0.3)
    # A chunk of numbers of poses, one of poses, one of matrices.
    near(one(stands, "poses that move nothing") + one(stands, "bones that no pose moves or no vertex"), part(walks, stands, "poses"), 3 * CHUNK)
    assets = [("a", man.name)]

    def crowd(times):
        return describe(folder, [dict(i, pose={"animation": 0, "time": times(n)}) for n, i in enumerate(row(40))], assets)

    apart, in_step = pack(crowd(lambda n: 0.1 + 0.03 * n), folder / "a.svscene", "--depth", 6), pack(crowd(lambda n: 0.3), folder / "i.svscene", "--depth", 6)
    check((apart["poses"], in_step["poses"]) == (40, 1), (apart, in_step))
    near(one(in_step, "poses equal") + one(in_step, "matrices of poses equal"), part(apart, in_step, "poses"), 2 * ALIGNMENT)


def levels(found, every, names):
    """Bytes said to be saved by levels that small meshes do not have, over those of the packing where they have them."""
    size = [{a["name"]: a["bytes"] for a in f["asset_list"]} for f in (found, every)]
    return one(found, "levels of meshes") / sum(size[1][n] - size[0][n] for n in names)


def test_levels_of_instanced_teapots(folder):
    """EXT_mesh_gpu_instancing: teapots on a wide ground, beside the same in which the nodes of their instances make them as large as it. An estimate: within 2.5."""
    source = model("D_gltf/features/gpu_instancing_teapots/TeapotsGalore.gltf")
    for f in source.parent.iterdir():
        shutil.copyfile(f, folder / f.name)
    g = json.loads(source.read_text())
    for n in g["nodes"]:
        if "EXT_mesh_gpu_instancing" in n.get("extensions", {}):
            n["matrix"] = [60 * x if i < 12 else x for i, x in enumerate(n["matrix"])]
    (folder / "large.gltf").write_text(json.dumps(g))
    for depth in (7, 9, 11):
        found, every = (pack(folder / f, folder / "o.svscene", "--depth", depth) for f in ("TeapotsGalore.gltf", "large.gltf"))
        at = [{a["name"]: a["depth"] for a in f["asset_list"]} for f in (found, every)]
        check(at[0]["teapot"] == depth - 4 and at[1]["teapot"] == depth, at)
        ratio = levels(found, every, ["teapot"])
        check(0.4 < ratio < 2.5, (depth, ratio))


def test_levels_of_a_description(folder):
    """Things a hundredth to a third as large as a bunny, beside a scene of the same where they are as large as it."""
    names = {"bunny": "A_organic/bunny_closed/bunny_hr.obj", "teapot": "B_damaged/teapot/teapot.obj", "camel": "A_organic/camel/camel.off"}
    for n, path in names.items():
        shutil.copyfile(model(path), folder / (n + ".off" if n == "camel" else n + ".obj"))
    assets = [(n, n + (".off" if n == "camel" else ".obj")) for n in names]
    edge = {"bunny": 1.55, "teapot": 6.434, "camel": 1.0}

    def scene(camel, teapot):
        return describe(folder, [{"asset": n, "scale": [s / edge[n]] * 3} for n, s in (("bunny", 1), ("camel", camel), ("teapot", teapot))], assets)

    for camel, teapot, depth in ((0.24, 0.12, 8), (0.49, 0.12, 9), (0.06, 0.24, 9)):
        found = pack(scene(camel, teapot), folder / "o.svscene", "--depth", depth)
        every = pack(scene(0.999, 0.999), folder / "e.svscene", "--depth", depth)
        check(all(a["depth"] == depth for a in every["asset_list"]), every["asset_list"])
        ratio = levels(found, every, ["camel", "teapot"])
        check(0.4 < ratio < 2.5, (camel, teapot, depth, ratio))


support.main(globals())
