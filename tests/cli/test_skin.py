"""Skins and animations of glTF files as poses: posed voxels beside the mesh posed by tests/cli/rig.py."""

import json
import re
import struct

import rig
import support
from support import check, run, tool


def pack(folder, file, *options, code=0):
    r = tool("svo-pack", file, "-o", folder / "s.svscene", "-f", "-q", "--report", folder / "p.json", *options)
    check(r.code == code, r)
    if code == 0:
        run("svo-dump", folder / "s.svscene", "--validate")
    return json.loads((folder / "p.json").read_text()) if code == 0 else r


def posed_voxels(folder):
    """World centres of the cells of the posed octree, and how wide they are."""
    run("svo-render", folder / "s.svscene", "-o", folder / "s.png", "-f", "--size", "200x200", "--delta", 0.001, "--resample", "emit", "--save-svo", folder / "posed.svo", "-q")
    run("svo-dump", folder / "posed.svo", "--voxels", folder / "posed.ply", "-f", "-q")
    info = json.loads(run("svo-dump", folder / "posed.svo", "--json").out)
    ply = support.read_ply(folder / "posed.ply")
    return list(zip(ply["x"], ply["y"], ply["z"])), abs(info["voxel_to_world"][0])


def compare(folder, triangles, voxel, what):
    """Cells of the posed octree are where the posed mesh is, and everywhere it is."""
    cells, width = posed_voxels(folder)
    mesh = list(rig.samples(triangles, 0.8 * voxel))
    near_mesh, near_cells = rig.Points(mesh, 5 * voxel), rig.Points(cells, 2 * voxel)
    off = [near_mesh.distance(c) for c in cells[::79]]
    lost = [near_cells.distance(p) for p in mesh[::29]]
    mean = sum(off) / len(off) / voxel
    # A turned voxel's box reaches 1.5 voxels from its centre, and a cell that it meets can be twice as wide as the box.
    check(mean < 1.3 and max(off) < 5 * voxel, (what, "cells off the mesh, in voxels", mean, max(off) / voxel))
    check(max(lost) < 1.1 * voxel, (what, "the mesh without cells, in voxels", max(lost) / voxel, width / voxel))


def test_a_skin_follows_its_joints(folder):
    file = rig.arm(folder / "arm.gltf")
    mesh = rig.File(file)
    for time in (0.1, 0.5, 1.4, 7.0):
        report = pack(folder, file, "--voxel-size", 0.08, "--animation", "wave", "--time", time)
        out = report["output"]
        check(out["posed_instances"] == 1 and out["poses"] == 1 and out["asset_list"][0]["bones"] == 3, out)
        compare(folder, mesh.posed(0, time), 0.08, "at %g s" % time)


def test_an_exported_skin_is_where_the_mesh_is(folder):
    """svo-dump --export of a posed character: the sides of its voxels, without a gap, where the posed mesh is."""
    file = rig.arm(folder / "arm.gltf")
    for time in (0.5, 1.4):
        pack(folder, file, "--voxel-size", 0.1, "--animation", "wave", "--time", time)
        run("svo-dump", folder / "s.svscene", "--export", folder / "s.ply", "-f", "-q")
        head, body = (folder / "s.ply").read_bytes().split(b"end_header\n", 1)
        count = int(re.findall(rb"element vertex (\d+)", head)[0])
        rows = list(struct.iter_unpack("<ddd", body[:24 * count]))
        edges = {}
        for q in range(0, count, 4):
            for k in range(4):
                a, b = sorted((rows[q + k], rows[q + (k + 1) % 4]))
                edges[a, b] = edges.get((a, b), 0) + 1
        check(all(n % 2 == 0 for n in edges.values()), "a gap between two sides of voxels")
        mesh = list(rig.samples(rig.File(file).posed(0, time), 0.08))
        near_mesh, near_rows = rig.Points(mesh, 0.2), rig.Points(sorted(set(rows)), 0.2)
        off = [near_mesh.distance(p) for p in rows[::37]]
        check(max(off) < 0.2 and max(near_rows.distance(p) for p in mesh[::29]) < 0.15, (time, max(off)))


def test_what_stands_as_it_was_bound_has_no_pose(folder):
    """Nothing moves: no bones, no pose; the octree is that of the mesh as it stands."""
    file = rig.arm(folder / "arm.gltf")
    for options in ((), ("--animation", "still", "--time", 1), ("--animation", 1)):
        out = pack(folder, file, "--depth", 6, *options)["output"]
        check(out["poses"] == 0 and out["pose_matrices"] == 0 and out["posed_instances"] == 0 and out["asset_list"][0]["bones_kept"] == 0, out)
        left = {e["what"]: e["bytes"] for e in out["left_out"]}
        check(left["bones that no pose moves or no vertex follows"] == 3 * 48 and left["poses that move nothing"] == 64, left)
        dump = json.loads(run("svo-dump", folder / "s.svscene", "--json").out)
        check("bone" not in json.dumps(dump["attributes"] if "attributes" in dump else dump["assets"]), dump)


def test_instances_at_times_of_their_own(folder):
    """A description: one asset, bound once, with poses at several times; equal ones are stored once; others of its pose apply after them."""
    rig.arm(folder / "arm.gltf")
    mesh = rig.File(folder / "arm.gltf")
    places = [("wave", 0.3, 0), ("wave", 1.4, 8), (0, 0.3, 16), (None, 0, 24)]
    instances = [{"asset": "arm", "translation": [x, 0, 0], **({"pose": {"animation": a, "time": t}} if a is not None else {})} for a, t, x in places]
    (folder / "s.json").write_text(json.dumps({"assets": [{"name": "arm", "file": "arm.gltf"}], "instances": instances}))
    out = pack(folder, folder / "s.json", "--voxel-size", 0.08)["output"]
    # the third pose is the first one again, and the last one is that in which everything stands as it was bound
    check(out["posed_instances"] == 3 and out["poses"] == 2 and out["assets"] == 1, out)
    triangles = []
    for a, t, x in places[:3]:
        triangles += [tuple((p[0] + x, p[1], p[2]) for p in tri) for tri in mesh.posed(0, t)]
    compare(folder, triangles, 0.08, "three poses")
    instances[0]["pose"]["scale"] = [1, 2, 1]
    (folder / "s.json").write_text(json.dumps({"assets": [{"name": "arm", "file": "arm.gltf"}], "instances": instances[:1]}))
    pack(folder, folder / "s.json", "--voxel-size", 0.08)
    compare(folder, [tuple((p[0], 2 * p[1], p[2]) for p in tri) for tri in mesh.posed(0, 0.3)], 0.08, "scaled after its bones")


def test_nodes_move_without_a_skin(folder):
    """An animated node of a flattened mesh is a bone; in a glTF scene it moves the instance."""
    g = rig.Maker()
    square = g.accessor("VEC3", 5126, [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    g.json["meshes"] = [{"primitives": [{"attributes": {"POSITION": square}, "indices": g.accessor("SCALAR", 5121, [[i] for i in (0, 1, 2, 0, 2, 3)])}]}]
    g.json["nodes"] = [{"mesh": 0}, {"mesh": 0, "translation": [3, 0, 0], "children": [2]}, {"mesh": 0, "translation": [0, 2, 0], "scale": [0.5, 0.5, 0.5]}]
    times = g.accessor("SCALAR", 5126, [[0.0], [1.0]])
    g.json["animations"] = [{"samplers": [{"input": times, "output": g.accessor("VEC4", 5126, [rig.turn([0, 0, 1], 0), rig.turn([0, 1, 0], 90)])}],
                             "channels": [{"sampler": 0, "target": {"node": 1, "path": "rotation"}}]}]
    g.json["scenes"], g.json["scene"] = [{"nodes": [0, 1]}], 0
    file = g.write(folder / "signs.gltf")
    mesh = rig.File(file)
    out = pack(folder, file, "--voxel-size", 0.05, "--time", 0.5)["output"]
    check(out["posed_instances"] == 0 and out["instances"] == 3, out)
    (folder / "s.json").write_text(json.dumps({"assets": [{"name": "signs", "file": "signs.gltf"}], "instances": [{"asset": "signs", "pose": {"time": 0.5}}]}))
    out = pack(folder, folder / "s.json", "--voxel-size", 0.05)["output"]
    check(out["posed_instances"] == 1 and out["pose_matrices"] == 2, out)  # the first node rests
    compare(folder, mesh.posed(0, 0.5), 0.05, "signs")


def test_wrong_animations_are_refused(folder):
    file = rig.arm(folder / "arm.gltf")
    for name in ("run", 2, 99):
        r = pack(folder, file, "--animation", name, code=3)
        check("animation" in r.err, r.err)
    check(pack(folder, file, "--time", 1, "--skins", "bake", code=1), "")
    support.cube_obj(folder / "cube.obj")
    for asset, pose, word in (("arm.gltf", {"animation": "run"}, "run"), ("cube.obj", {"time": 1}, "animation"), ("arm.gltf", {"animation": ""}, "animation"),
                              ("arm.gltf", {"time": 1, "bones": [{"bone": 1, "translation": [1, 0, 0]}]}, "bones"), ("arm.gltf", {"bones": [{"bone": 7, "translation": [1, 0, 0]}]}, "bone")):
        (folder / "s.json").write_text(json.dumps({"assets": [{"name": "a", "file": asset}], "instances": [{"asset": "a", "pose": pose}]}))
        r = pack(folder, folder / "s.json", "--depth", 4, code=3)
        check(word in r.err, (pose, r.err))
    good = json.loads(file.read_text())
    for change in (lambda j: j["animations"][0]["channels"][0].update(sampler=77), lambda j: j["animations"][0]["samplers"][0].update(output=0),
                   lambda j: j["animations"][0]["samplers"][0].update(interpolation="QUADRATIC"), lambda j: j["animations"][0]["channels"][0]["target"].update(path="colour"),
                   lambda j: j["nodes"][3].update(matrix=[1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]) or j["nodes"][3].pop("translation")):
        bad = json.loads(json.dumps(good))
        change(bad)
        (folder / "bad.gltf").write_text(json.dumps(bad))
        r = pack(folder, folder / "bad.gltf", "--time", 1, code=3)
        check("animation" in r.err, r.err)


def test_threads_do_not_matter(folder):
    file = rig.arm(folder / "arm.gltf")
    files = []
    for threads in (1, 3):
        pack(folder, file, "--depth", 7, "--time", 0.7, "--threads", threads)
        run("svo-render", folder / "s.svscene", "-o", folder / ("%d.png" % threads), "--size", "160x120", "--threads", threads)
        files.append(((folder / "s.svscene").read_bytes(), (folder / ("%d.png" % threads)).read_bytes()))
    check(files[0] == files[1], "bytes depend on threads")


def test_a_real_character(folder):
    file = support.model("D_gltf/features/skin_cesium_man/CesiumMan.gltf")
    mesh = rig.File(file)
    for time in (0.25, 0.8):
        out = pack(folder, file, "--voxel-size", 0.025, "--time", time)["output"]
        check(out["posed_instances"] == 1 and out["asset_list"][0]["bones"] == 19, out)
        compare(folder, mesh.posed(0, time), 0.025, "at %g s" % time)


support.main(globals())
