"""What a file holds, as text that does not depend on how it is coded: its voxels with their values, an octree's levels, a scene's instances, a skeleton's joints."""

import hashlib
import json
import pathlib
import subprocess
import tempfile

import support


def digest(lines):
    return hashlib.sha256("\n".join(lines).encode()).hexdigest()[:32]


def dump(tools, *args):
    r = subprocess.run([str(tools / "svo-dump"), *map(str, args), "--no-config"], stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    if r.returncode != 0:
        raise support.Failure("svo-dump %s: exit %d: %s" % (" ".join(map(str, args)), r.returncode, r.stderr.decode(errors="replace")))
    return r.stdout


def number(x):
    return "%.9g" % (x + 0.0)


def voxels(tools, path):
    """A line a voxel: its cell and all values."""
    with tempfile.TemporaryDirectory() as folder:
        out = pathlib.Path(folder) / "v.ply"
        dump(tools, path, "--voxels", out, "-q")
        return sorted("%d %d %d " % at + " ".join("%s=%s" % (k, number(v)) for k, v in sorted(row.items())) for at, row in support.ply_voxels(out).items())


def inner(tools, path, info):
    """A line a node above the finest level, with the values that it has: they come from --tree."""
    if info["format"] == "svo" or info.get("levels") is None or len(info["levels"]) < 3:
        return []
    tree = json.loads(dump(tools, path, "--json", "--tree", len(info["levels"]) - 2))["tree"]
    return sorted(json.dumps({k: v for k, v in n.items() if k not in ("attribute", "slot")}, sort_keys=True) for n in tree)  # (those are places in the file)


def of(tools, path):
    info = json.loads(dump(tools, path, "--json"))
    dump(tools, path, "--validate")
    out = {"format": info["format"], "version": info["version"]}
    if info["format"] in ("svo", "svdag"):
        found = voxels(tools, path)
        out.update(depth=info["depth"], voxels=len(found), first=found[0], voxels_digest=digest(found), voxel_to_world=[number(x) for x in info["voxel_to_world"]],
                   levels=[level["nodes"] for level in info["levels"]], inner_digest=digest(inner(tools, path, info)))
    elif info["format"] == "svscene":
        with tempfile.TemporaryDirectory() as folder:
            ply = pathlib.Path(folder) / "s.ply"
            dump(tools, path, "--export", ply, "--rest", "-q")
            corners = sorted(" ".join(number(round(v, 6)) for v in row) for row in zip(*(support.read_ply(ply)[k] for k in ("x", "y", "z"))))
        names = [[i.get("name"), i["id"], i["asset"]] for i in info["instances"]]
        out.update(instances=sorted(names, key=str), pages=len(info["pages"]), corners=len(corners), corners_digest=digest(corners))
    else:
        out.update({k: info[k] for k in ("joint_count", "bone_count", "loops", "components", "ends", "branches", "omega")})
        out["digest"] = digest([json.dumps(info[k], sort_keys=True) for k in ("joints", "bones")])
    return out
