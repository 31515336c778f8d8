"""svo-pack: descriptions, glTF scenes, what is left out, exit codes, same bytes."""

import json
import os
import pathlib
import struct

import support
from support import check, skip, tool


def write(path, text):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    return path


TRIANGLE = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"


def tetrahedron(size=1.0):
    return "v 0 0 0\nv %g 0 0\nv 0 %g 0\nv 0 0 %g\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n" % (size, size, size)


def pack(scene, out, *args):
    """Pack with a report; (Result, report)."""
    report = pathlib.Path(str(out) + ".json")
    r = tool("svo-pack", scene, "-o", out, "--report", report, "-f", *args)
    return r, json.loads(report.read_text()) if report.exists() else None


def description(folder, assets, instances, **more):
    scene = {"assets": [{"name": n, "file": f} for n, f in assets], "instances": instances}
    scene.update(more)
    return write(folder / "scene.json", json.dumps(scene))


def test_a_description_packs_what_is_used(folder):
    write(folder / "models/a.obj", tetrahedron())
    write(folder / "b.obj", tetrahedron())
    write(folder / "c.obj", tetrahedron(2))
    write(folder / "empty.obj", "v 0 0 0\n")
    s = description(folder, [("a", "models/a.obj"), ("b", "b.obj"), ("unused", "missing.obj"), ("c", "c.obj"), ("empty", "empty.obj")], [
        {"asset": "a", "name": "first"}, {"asset": "b", "translation": [3, 0, 0]}, {"asset": "c", "translation": [6, 0, 0]},
        {"asset": "empty"}, {"asset": "a", "scale": [0, 0, 0]}, {"asset": "a", "scale": [1, 0, 1]}])
    r, report = pack(s, folder / "o.svscene", "--depth", 5)
    check(r.code == 0, r)
    out = report["output"]
    check(out["bytes"] == (folder / "o.svscene").stat().st_size)
    check(sum(out["bytes_by_part"].values()) == out["bytes"], out)
    check((out["assets"], out["instances"], out["pages"]) == (2, 3, 1), out)
    fates = {a["name"]: a["fate"] for a in out["asset_list"]}
    check(fates == {"a": "kept", "b": "equal", "unused": "unused", "c": "kept", "empty": "empty"}, fates)
    # The largest mesh gets the stated depth, one of half its size a level less.
    depths = {a["name"]: a.get("depth") for a in out["asset_list"]}
    check((depths["c"], depths["a"], depths["b"]) == (5, 4, 4), depths)
    what = {o["what"]: o for o in out["left_out"]}
    check(what["asset equal to another one"]["bytes"] > 0, what)
    check(what["instances hidden by a scale of 0"]["instances"] == 1, what)
    check(what["instances with a singular transform"]["instances"] == 1, what)
    check(what["instances of assets without voxels"]["instances"] == 1, what)
    small = what["levels of meshes that are small in the scene, below what the largest shows"]
    # An estimate of what the smaller one would take at the depth of the other, which has the same shape: four planes, which grow by less than most things do.
    # cli.left_out has more usual ones.
    size = {a["name"]: a.get("bytes") for a in out["asset_list"]}
    check(small["levels"] == 1 and 0.2 < small["bytes"] / (size["c"] - size["a"]) < 5, (small, size))
    check(len(report["warnings"]) >= 2, report["warnings"])
    check({p["name"] for p in report["phases"]} >= {"read", "voxelize", "pack", "write"}, report["phases"])


def test_channels_without_variation_are_stored_once(folder):
    """A cube of one colour: its colour takes one value in the file, and the report says what a value a node would have taken."""
    support.cube_obj(folder / "cube.obj", color=(1, 0, 0))
    s = description(folder, [("a", "cube.obj")], [{"asset": "a"}])
    r, report = pack(s, folder / "o.svscene", "--depth", 4, "--attributes", "color", "--lod", "none")
    check(r.code == 0, r)
    what = {o["what"]: o for o in report["output"]["left_out"]}
    one = what["channels without variation: one value is stored"]
    check(one["channels"] == 1 and one["bytes"] == 3 * report["output"]["asset_list"][0]["voxels"], one)
    r, varied = pack(s, folder / "p.svscene", "--depth", 4, "--attributes", "normal", "--lod", "none")
    check("channels without variation: one value is stored" not in {o["what"] for o in varied["output"]["left_out"]}, varied["output"]["left_out"])
    check(report["output"]["bytes"] < varied["output"]["bytes"], "the one value takes as much as many")


def test_one_mesh_has_the_stated_depth_and_voxel_size_rules(folder):
    write(folder / "a.obj", tetrahedron())
    for scale, depth in ((1, 6), (8, 6)):
        s = description(folder, [("a", "a.obj")], [{"asset": "a", "scale": [scale] * 3}])
        r, report = pack(s, folder / "o.svscene", "--depth", 6)
        check(r.code == 0 and report["output"]["asset_list"][0]["depth"] == depth, r)
    for scale, depth in ((1, 4), (8, 7), (0.25, 2)):
        s = description(folder, [("a", "a.obj")], [{"asset": "a", "scale": [scale] * 3}, {"asset": "a", "scale": [scale / 2] * 3}])
        r, report = pack(s, folder / "o.svscene", "--voxel-size", 0.0625)
        check(r.code == 0 and report["output"]["asset_list"][0]["depth"] == depth, (r, report["output"]["asset_list"]))
    r, report = pack(s, folder / "p.svscene", "--voxel-size", 1e-9)
    check(r.code == 6 and not (folder / "p.svscene").exists(), r)


def test_svdag_and_svo_assets_keep_their_depth(folder):
    write(folder / "a.obj", tetrahedron())
    for name in ("svo-voxelize", "svo-compress"):
        if not (support.tools / name).exists():
            skip(name + " is not built")
    check(tool("svo-voxelize", folder / "a.obj", "-o", folder / "a.svo", "--depth", 5).code == 0)
    check(tool("svo-compress", folder / "a.svo", "-o", folder / "a.svdag").code == 0)
    s = description(folder, [("a", "a.svo"), ("b", "a.svdag"), ("c", "a.obj")], [{"asset": x} for x in "abc"])
    r, report = pack(s, folder / "o.svscene", "--depth", 5)
    check(r.code == 0, r)
    # All three roads lead to the same octree, which is stored once.
    check(report["output"]["assets"] == 1 and [a["depth"] for a in report["output"]["asset_list"]] == [5, 5, 5], report["output"])
    r, report = pack(folder / "a.svdag", folder / "p.svscene")
    check(r.code == 0 and report["output"]["instances"] == 1, r)
    r, report = pack(folder / "a.svo", folder / "q.svscene")
    check(r.code == 0 and report["output"]["instances"] == 1, r)


def gltf(folder, nodes, meshes=1, extra=None):
    """A glTF whose meshes are tetrahedra of size 1, 2, ..., in one buffer."""
    data, views, accessors, mesh_list = b"", [], [], []
    for m in range(meshes):
        size = float(m + 1)
        points = struct.pack("<12f", 0, 0, 0, size, 0, 0, 0, size, 0, 0, 0, size)
        indices = struct.pack("<12H", 0, 2, 1, 0, 1, 3, 0, 3, 2, 1, 2, 3)
        views += [{"buffer": 0, "byteOffset": len(data), "byteLength": 48}, {"buffer": 0, "byteOffset": len(data) + 48, "byteLength": 24}]
        accessors += [{"bufferView": 2 * m, "componentType": 5126, "count": 4, "type": "VEC3", "min": [0, 0, 0], "max": [size] * 3},
                      {"bufferView": 2 * m + 1, "componentType": 5123, "count": 12, "type": "SCALAR"}]
        mesh_list.append({"name": "mesh %d" % m, "primitives": [{"attributes": {"POSITION": 2 * m}, "indices": 2 * m + 1}]})
        data += points + indices
    (folder / "data.bin").write_bytes(data)
    g = {"asset": {"version": "2.0"}, "buffers": [{"uri": "data.bin", "byteLength": len(data)}], "bufferViews": views, "accessors": accessors,
         "meshes": mesh_list, "nodes": nodes, "scenes": [{"nodes": list(range(len(nodes)))}], "scene": 0}
    g.update(extra or {})
    return write(folder / "scene.gltf", json.dumps(g))


def test_a_gltf_scene(folder):
    camera = {"cameras": [{"type": "perspective", "perspective": {"yfov": 0.6, "znear": 0.1}}]}
    g = gltf(folder, [{"mesh": 0, "name": "one", "scale": [2, 2, 2]}, {"mesh": 1, "translation": [5, 0, 0]}, {"mesh": 0, "translation": [0, 9, 0]},
                      {"camera": 0, "translation": [0, 0, 20]}], meshes=3, extra=camera)
    r, report = pack(g, folder / "o.svscene", "--depth", 6)
    check(r.code == 0, r)
    out = report["output"]
    check((out["assets"], out["instances"]) == (2, 3), out)
    # The third mesh is in no node, so it is not even imported.
    check([a["fate"] for a in out["asset_list"]] == ["kept", "kept"], out["asset_list"])
    # Mesh 0 at scale 2 is as large as mesh 1.
    check([a.get("depth") for a in out["asset_list"]] == [6, 6], out["asset_list"])
    for k, expected in enumerate((0, 0, 0, 7, 10, 2)):
        check(abs(out["bounds"][k] - expected) < 0.15, out["bounds"])
    if (support.tools / "svo-dump").exists():
        d = tool("svo-dump", "--json", folder / "o.svscene")
        check(d.code == 0, d)
        check(tool("svo-dump", "--validate", folder / "o.svscene").code == 0)


def test_same_bytes_for_any_thread_count(folder):
    write(folder / "a.obj", tetrahedron())
    write(folder / "b.obj", tetrahedron(3))
    instances = [{"asset": "ab"[i % 2], "translation": [i * 7919 % 1000, i * 104729 % 1000, 0.1 * i], "name": "n%d" % (i % 9)} for i in range(5000)]
    s = description(folder, [("a", "a.obj"), ("b", "b.obj")], instances)
    for threads in (1, 2, 7):
        check(pack(s, folder / ("%d.svscene" % threads), "--depth", 5, "--threads", threads, "--page", 100)[0].code == 0)
    first = (folder / "1.svscene").read_bytes()
    check(first == (folder / "2.svscene").read_bytes() == (folder / "7.svscene").read_bytes())
    # Nor on where the files are.
    other = folder / "other"
    other.mkdir()
    for name in ("a.obj", "b.obj", "scene.json"):
        (other / name).write_bytes((folder / name).read_bytes())
    check(pack(other / "scene.json", other / "o.svscene", "--depth", 5, "--page", 100)[0].code == 0)
    check(first == (other / "o.svscene").read_bytes())
    r = tool("svo-pack", "-", "-o", "-", "--depth", 5, "--page", 100, stdin=(folder / "scene.json").read_bytes(), cwd=folder)
    check(r.code == 0 and len(r.out) > 5000 * 60, r)


def test_a_hundred_thousand_instances(folder):
    write(folder / "a.obj", tetrahedron())
    lines = ['{"asset":"a","translation":[%d,%d,%.3f],"name":"n%d"}' % (i % 317, i // 317, i * 0.001, i) for i in range(100000)]
    s = write(folder / "scene.json", '{"assets":[{"name":"a","file":"a.obj"}],"instances":[' + ",\n".join(lines) + "]}")
    r, report = pack(s, folder / "o.svscene", "--depth", 4)
    check(r.code == 0, r)
    check(report["output"]["instances"] == 100000 and report["output"]["pages"] == 98, report["output"])
    check(report["peak_rss_bytes"] < (600 << 20), report["peak_rss_bytes"])


def test_depfile(folder):
    """The rule names every file that was read and none besides, escaped; the packed bytes are the same."""
    odd = folder / "a b#c$d"
    odd.mkdir()
    support.cube_glb(odd / "t.glb", texture=support.write_png(None, 4, 4, lambda x, y: (9, 9, 9)))
    support.cube_obj(odd / "m.obj", color=(1, 0, 0))
    support.cube_obj(odd / "plain.obj", size=2)
    support.run("svo-voxelize", odd / "plain.obj", "-o", odd / "p.svo", "--depth", 3)
    support.run("svo-compress", odd / "p.svo", "-o", odd / "p.svdag")
    names = ["t.glb", "m.obj", "p.svo", "p.svdag", "unused.obj"]
    s = description(odd, [(n, n) for n in names], [{"asset": n, "translation": [3 * i, 0, 0]} for i, n in enumerate(names[:4])])
    plain, out, dep = odd / "plain.svscene", odd / "o.svscene", folder / "o.d"
    support.run("svo-pack", s, "-o", plain, "--depth", 4)
    support.run("svo-pack", s, "-o", out, "--depth", 4, "--depfile", dep)
    check(out.read_bytes() == plain.read_bytes(), "the option changes the scene")
    escape = lambda p: str(p).replace("$", "$$").replace("#", "\\#").replace(" ", "\\ ")
    read = sorted([s, odd / "m.mtl", *(odd / n for n in names[:4])])
    check(dep.read_text() == escape(out) + ":" + "".join(" \\\n  " + escape(p) for p in read) + "\n", dep.read_text())
    support.run("svo-pack", s, "-o", out, "--depth", 4, "-MD", "--budget", "1M", "-f")
    check((odd / "o.svscene.d").read_bytes() == dep.read_bytes(), "-MD writes the same rule beside the output")
    before = (odd / "m.mtl").read_bytes()
    none = folder / "q.svscene"
    check(tool("svo-pack", s, "-o", none, "--depfile", odd / "m.mtl", "-f").code == 1 and (odd / "m.mtl").read_bytes() == before and not none.exists(), "a scene is left by a run that failed")
    check(tool("svo-pack", s, "-o", none, "--depfile", dep).code == 2 and dep.exists() and not none.exists())
    check(tool("svo-pack", s, "-o", none, "--depfile", folder / "no/x.d").code == 2 and not none.exists())
    for wrong in (["-o", "-", "-MD"], ["-o", out, "-f", "-MD", "--depfile", dep], ["-o", out, "-f", "--depfile", out]):
        check(tool("svo-pack", s, *wrong).code == 1, wrong)
    # a glTF scene and the files beside it
    support.run("svo-pack", odd / "t.glb", "-o", out, "--depth", 4, "-MD", "-f")
    check((odd / "o.svscene.d").read_text() == escape(out) + ": \\\n  " + escape(odd / "t.glb") + "\n")


def test_a_million_instances(folder):
    write(folder / "a.obj", tetrahedron())
    peak, size = {}, {}
    for count in (100000, 1000000):
        rows = ",\n".join('{"asset":"a","translation":[%d,%d,%d]}' % (i % 100, i // 100 % 100, i // 10000) for i in range(count))
        s = write(folder / "scene.json", '{"assets":[{"name":"a","file":"a.obj"}],"instances":[' + rows + "]}")
        r, report = pack(s, folder / "o.svscene", "--depth", 4)
        check(r.code == 0 and report["output"]["instances"] == count, r)
        peak[count], size[count] = report["peak_rss_bytes"], report["output"]["bytes"]
    # 57 bytes of description (mapped), 112 of it as read, 48 to 60 in the file, and what is sorted
    check(support.SANITIZED or (peak[1000000] - peak[100000]) / 900000 < 500, peak)
    check((size[1000000] - size[100000]) / 900000 < 62, size)


def test_exit_codes(folder):
    write(folder / "a.obj", tetrahedron())
    out = folder / "o.svscene"

    def expect(code, message, *args, scene=None):
        r = tool("svo-pack", *(args if args else (scene, "-o", out)))
        check(r.code == code and message in r.err, r)
        check(not out.exists(), r)

    good = description(folder, [("a", "a.obj")], [{"asset": "a"}])
    expect(1, "--help", good)
    expect(1, "--help", good, "-o", out, "--depth", 22)
    expect(1, "exclude", good, "-o", out, "--depth", 3, "--voxel-size", 1)
    expect(1, "--color", good, "-o", out, "--color", 17)
    expect(1, "--normal", good, "-o", out, "--normal", 5)
    expect(1, "--attributes", good, "-o", out, "--attributes", "color,beauty")
    expect(2, "nothing.json", scene=folder / "nothing.json")
    expect(2, "b.obj", scene=description(folder, [("a", "b.obj")], [{"asset": "a"}]))
    expect(3, "instances[0].asset", scene=description(folder, [("a", "a.obj")], [{"asset": "b"}]))
    expect(3, "lights", scene=description(folder, [], [], lights=[]))
    expect(3, "leaves", scene=description(folder, [("a", "../a.obj")], [{"asset": "a"}]))
    expect(3, "line 2: assets[0]", scene=write(folder / "bad.json", '{"assets":[\n{nonsense'))
    expect(3, "pose", scene=description(folder, [("a", "a.obj")], [{"asset": "a", "pose": [1]}]))
    s = description(folder, [("a", "a.obj")], [{"asset": "a", "translation": [1e300, 0, 0]}])
    expect(3, "instance 0", scene=s)
    good = description(folder, [("a", "a.obj")], [{"asset": "a"}])
    check(tool("svo-pack", good, "-o", out, "--depth", 4).code == 0)
    before = out.read_bytes()
    r = tool("svo-pack", good, "-o", out, "--depth", 5)
    check(r.code == 2 and out.read_bytes() == before, r)
    check(tool("svo-pack", good, "-o", out, "--depth", 4, "--force").code == 0 and out.read_bytes() == before)
    # A damaged asset: nothing is written.
    (folder / "a.svdag").write_bytes(before)
    r = tool("svo-pack", description(folder, [("a", "a.svdag")], [{"asset": "a"}]), "-o", folder / "p.svscene")
    check(r.code == 5 and not (folder / "p.svscene").exists(), r)
    check(not [f for f in os.listdir(folder) if "tmp" in f], os.listdir(folder))


def test_real_scenes(folder):
    models = os.environ.get("SVOKIT_MODELS") or os.environ.get("SVOKIT_MODELS_DEFAULT")
    if not models or not pathlib.Path(models).is_dir():
        skip("the folder of real models is missing (SVOKIT_MODELS)")
    features = pathlib.Path(models) / "D_gltf/features"
    r, report = pack(features / "gpu_instancing_teapots/TeapotsGalore.gltf", folder / "t.svscene", "--depth", 8)
    check(r.code == 0 and report["output"]["instances"] == 1900 and report["output"]["pages"] == 2, r)
    r, report = pack(features / "many_cubes/many-cubes.gltf", folder / "c.svscene", "--depth", 7)
    check(r.code == 0 and report["output"]["instances"] == 501 and report["output"]["assets"] < 20, r)


support.main(globals())
