"""Each option of each tool's --help is used once, and does something: the list here and --help must name the same options.

An entry is (arguments, expectation[, base[, base with the option]]): "other": the output differs from that of the base command; "same": it does not, the option
changes only how it is made; "text": the printed text differs; "accepts": the base command ends with 7, with the option it ends with 0;
"damage": of a damaged file, more is printed than without it; a file's name: it is written (the output may be the same). Arguments in
braces are files of the folder. Options of the base that the arguments give, or that go without one another (INSTEAD), are left out of it. The shared options have a test of their own (test_options.py)."""

import json
import shutil
import struct

import rig
import support
from support import SHARED, check, options, run, tool, tools_by_name

RAW = ["{v.raw}", "--raw", "6x5x4:u8"]
VOXELIZE = {
    "depth": (["--depth", 5], "other"), "voxel-size": (["--voxel-size", 0.11], "other"), "up": (["--up", "z"], "other"), "unit": (["--unit", "cm"], "other"),
    "fill": (["--fill", "solid"], "other"), "surface": (["--surface", "thin"], "other"), "attributes": (["--attributes", "none"], "other"), "level": (["--level", 3], "other"),
    "reference": (["--reference", 100, "--report", "{ref.json}"], "ref.json"), "disk": (["--disk", "small"], "other"),
    "threshold": (["--threshold", 9], "other", RAW), "raw": (["--raw", "5x6x4:u8"], "other", RAW),
    "columns": (["--columns", "y,x,z"], "other", ["{p.xyz}", "--depth", 3]), "min-points": (["--min-points", 2], "other", ["{p.xyz}", "--depth", 3]),
    "shard": (["--shard", "1/2"], "other", ["{s.obj}", "--depth", 8]), "temp": (["--temp", "{temp}", "--memory", "64M"], "same"), "temp-size": (["--temp-size", "1G", "--memory", "64M"], "same"),
    "dry-run": (["--dry-run"], "text"), "ignore-free-space": (["--ignore-free-space"], "same"), "depfile": (["--depfile", "{d.d}"], "d.d"),
    "depfile-beside": (["-MD"], "o.svo.d"), "key": (["--key"], "text")}
COMPRESS = {"geometry": (["--geometry", "best"], "other"), "color": (["--color", 2], "other"), "normal": (["--normal", "deg=8"], "other"), "palettes": (["--palettes", "algorithm1"], "other"),
            "lod": (["--lod", "none"], "other"), "temp": (["--temp", "{temp}", "--memory", "64M"], "same")}
SKELETON = {
    "omega": (["--omega", 0.4], "other"), "place": (["--place", "contracted"], "other"), "refine": (["--refine", "ends@0.1"], "other"), "up": (["--up", "x"], "other"), "unit": (["--unit", "mm"], "other"),
    "repair": (["--repair", "cgal", "--report", "{rep.json}"], "rep.json"), "tessellate": (["--tessellate", "openmesh"], "other"), "normalize": (["--normalize", "box"], "other"),
    "max-vertices": (["--max-vertices", 100000], "same"), "method": (["--method", "literal"], "other"), "search": (["--search", "grid"], "same"), "delta": (["--delta", 5], "other"),
    "max-iterations": (["--max-iterations", 3], "other"), "obj": (["--obj", "{k.obj}"], "k.obj"), "swc": (["--swc", "{k.swc}"], "k.swc"), "segments": (["--segments", "{k.ply}"], "k.ply"),
    "glb": (["--glb", "{k.glb}"], "k.glb"), "influences": (["--influences", 1, "--glb", "{k1.glb}"], "k1.glb"), "smoothing": (["--smoothing", 0, "--glb", "{k2.glb}"], "k2.glb"),
    "draco": (["--draco", 12, "--glb", "{k3.glb}"], "k3.glb"), "bind": (["--bind", "{s.svo}", "--bound", "{bound.svo}"], "bound.svo"), "bound": (["--bind", "{s.svo}", "--bound", "{bound2.svo}"], "bound2.svo"),
    "solid": (["--solid", "{solid.svo}"], "solid.svo"), "reconstruct": (["--reconstruct", "{closed.ply}"], "closed.ply"), "solid-divide": (["--solid-divide", 1, "--solid", "{solid1.svo}"], "solid1.svo")}
PACK = {
    "depth": (["--depth", 5], "other"), "voxel-size": (["--voxel-size", 0.2], "other"), "view-distance": (["--view-distance", 90], "other"), "budget": (["--budget", "9K"], "other"),
    "attributes": (["--attributes", "none"], "other"), "surface": (["--surface", "thin"], "other"), "fill": (["--fill", "solid"], "other"), "color": (["--color", "deltaE=20"], "other"),
    "normal": (["--normal", 6], "other", ["{s.obj}", "--depth", 4]), "lod": (["--lod", "none"], "other"), "animation": (["--animation", 0], "other", ["{arm.gltf}", "--depth", 4]),
    "time": (["--time", 0.5], "other", ["{arm.gltf}", "--depth", 4]), "skins": (["--skins", "bake"], "other", ["{arm.gltf}", "--depth", 4]), "page": (["--page", 1], "other"),
    "depfile": (["--depfile", "{d.d}"], "d.d"), "depfile-beside": (["-MD"], "o.svscene.d")}
RENDER = {
    "size": (["--size", "20x16"], "other", ["{c.svscene}"]), "samples": (["--samples", 2], "other"), "background": (["--background", "1,2,3"], "other"), "footprint": (["--footprint", 40], "other"), "eye": (["--eye", "3,1,2"], "other"),
    "target": (["--eye", "3,1,2", "--target", "0,0,0"], "other"), "up": (["--up", "1,0,0", "--eye", "3,1,2"], "other"), "fov": (["--fov", 70, "--eye", "3,1,2"], "other"), "turntable": (["--turntable", 2], "o_0001.png"),
    "path": (["--path", "{path.txt}"], "o_0000.png"), "light": (["--light", "1,0,0"], "other"), "ambient": (["--ambient", 0.9], "other"), "bounce": (["--bounce", 2], "other"), "reflections": (["--reflections", "--reflectance", 0.5], "other"),
    "reflectance": (["--reflectance", 1], "other"), "no-shadows": (["--no-shadows"], "other", ["{two.svscene}", "--size", "64x64"]), "deform": (["--deform", "twist=y:60"], "other"), "resample": (["--resample", "emit", "--deform", "twist=y:60"], "other"),
    "delta": (["--delta", 20, "--deform", "twist=y:60"], "other"), "no-culling": (["--no-culling"], "same", ["{two.svscene}", "--size", "48x32", "--no-shadows", "--deform", "twist=y:60"]), "save-svo": (["--save-svo", "{deformed.svo}", "--deform", "twist=y:60", "--resample", "resize"], "deformed.svo")}
DUMP = {
    "json": (["--json"], "text"), "validate": (["--validate"], "text"), "partial": (["--partial"], "damage", ["{damaged.svdag}"]), "table": (["--table"], "text"), "tree": (["--tree", 2], "text"), "histogram": (["--histogram"], "text"),
    "source": (["--validate", "--source", "{c.svo}"], "text"), "voxels": (["--voxels", "{v.ply}"], "v.ply"), "limit": (["--limit", 100000, "--voxels", "{v2.ply}"], "v2.ply"), "html": (["--html", "{page.html}"], "page.html"),
    "html-size": (["--html-size", "300K", "--html", "{page2.html}"], "page2.html"), "quick": (["--quick", "--validate"], "text"), "export": (["--export", "{e.vox}"], "e.vox"), "level": (["--level", 2, "--export", "{e2.ply}"], "e2.ply"),
    "low": (["--low", "1,1,1", "--export", "{e3.nrrd}"], "e3.nrrd"), "high": (["--high", "2,2,2", "--export", "{e4.nrrd}"], "e4.nrrd"), "volume": (["--volume", "rgba", "--export", "{e5.nrrd}"], "e5.nrrd"),
    "draco": (["--draco", 0, "--export", "{e6.glb}"], "e6.glb"), "instancing": (["--instancing", "--export", "{e7.glb}"], "e7.glb", ["{two.svscene}"]), "rest": (["--rest", "--export", "{e8.glb}"], "e8.glb", ["{two.svscene}"])}
PICTURES, OCTREES = ["{a.png}", "{b.png}"], ["{c.svo}", "{lossy.svdag}"]
COMPARE = {
    "json": (["--json"], "text"), "psnr": (["--psnr", 5], "accepts", PICTURES), "ssim": (["--ssim", 0.1], "accepts", PICTURES), "max-diff": (["--max-diff", 255], "accepts", PICTURES),
    "deltaE": (["--deltaE", 99], "accepts", OCTREES), "deg": (["--deg", 90], "accepts", ["{s.svo}", "{lossy_normals.svdag}"]), "value": (["--value", 0.2], "accepts", ["{rough.svo}", "{smooth.svo}"]),
    "geometry-only": (["--geometry-only"], "accepts", OCTREES), "max-voxels": (["--max-voxels", 100000], "same"), "float-diff": (["--float-diff", 5], "accepts", ["{a.exr}", "{b.exr}"])}
BENCH = {
    "sweep": (["--sweep", "omega", "--values", "0.3", "--repeat", 1], "text", ["{s.obj}", "--sweep", "depth", "--values", "3", "--repeat", 1]), "values": (["--values", "3,4"], "text"), "depth": (["--depth", 3, "--sweep", "color", "--values", "4"], "text"),
    "attributes": (["--attributes", "none"], "text"), "repeat": (["--repeat", 2], "text"), "clock": (["--clock", "cpu"], "text"), "list": (["--list", "{list.txt}"], "text"), "csv": (["--csv", "{b.csv}"], "b.csv"),
    "json": (["--json", "{b.json}"], "b.json"), "svg": (["--svg", "{b.svg}"], "b.svg"), "html": (["--html", "{b.html}"], "b.html")}
MERGE = {"list": (["--list", "{shards.txt}"], "same", ["{part1.svo}", "{part2.svo}"], ["{part1.svo}"]), "disk": (["--disk", "small"], "other"), "level": (["--disk", "fast", "--level", 5], "other")}
BUILD = {"jobs": (["-j", 2], "same"), "retries": (["--retries", 0], "same"), "dry-run": (["--dry-run"], "text"), "emit": (["--emit", "sh"], "text"), "tools": (["--tools", "{TOOLS}"], "same")}

# arguments that every run of a tool has, and where its output goes
BASES = {"svo-voxelize": (["{c.glb}", "--depth", 4], "o.svo"), "svo-compress": (["{c.svo}"], "o.svdag"), "svo-skeleton": (["{s.obj}", "--omega", 0.3], "o.skel"), "svo-pack": (["{two.gltf}", "--depth", 4], "o.svscene"),
         "svo-render": (["{c.svscene}", "--size", "48x32"], "o.png"), "svo-dump": (["{c.svdag}"], None), "svo-compare": (["{c.svdag}", "{c.svo}"], None),
         "svo-bench": (["{c.glb}", "--sweep", "depth", "--values", "3", "--repeat", 1], None), "svo-merge": (["{c.svo}", "--disk", "fast"], "o.svo"), "svo-build": (["{build.json}"], None)}
TABLES = {"svo-voxelize": VOXELIZE, "svo-compress": COMPRESS, "svo-skeleton": SKELETON, "svo-pack": PACK, "svo-render": RENDER, "svo-dump": DUMP, "svo-compare": COMPARE, "svo-bench": BENCH, "svo-merge": MERGE, "svo-build": BUILD}


def two_cubes(path, glb):
    """A scene of two cubes, one above the other, as .gltf of the mesh of a GLB."""
    data = glb.read_bytes()
    length = struct.unpack("<I", data[12:16])[0]
    document = json.loads(data[20:20 + length])
    (path.parent / "two.bin").write_bytes(data[20 + length + 8:])
    document["buffers"][0]["uri"] = "two.bin"
    document["nodes"] = [{"mesh": 0}, {"mesh": 0, "translation": [0.3, 1.5, 0.2], "scale": [0.5, 0.5, 0.5]}]
    document["scenes"] = [{"nodes": [0, 1]}]
    path.write_text(json.dumps(document))


def inputs(folder):
    support.write_png(folder / "t.png", 8, 8, lambda x, y: (30 * x, 30 * y, 90))
    support.cube_glb(folder / "c.glb", base_color=(1, 0.9, 0.8, 1), texture=(folder / "t.png").read_bytes())
    two_cubes(folder / "two.gltf", folder / "c.glb")
    support.sphere_obj(folder / "s.obj")
    rig.arm(folder / "arm.gltf")
    (folder / "v.raw").write_bytes(bytes((7 * i) % 23 for i in range(120)))
    (folder / "p.xyz").write_text("".join("%g %g %g\n" % (i % 5, i % 7, i % 3) for i in range(60)))
    (folder / "path.txt").write_text("3 2 1 0 0 0\n")
    (folder / "list.txt").write_text("s.obj\n")
    (folder / "temp").mkdir()
    for part in (1, 2):
        run("svo-voxelize", folder / "s.obj", "-o", folder / ("part%d.svo" % part), "--depth", 8, "--shard", "%d/2" % part)
    (folder / "shards.txt").write_text(str(folder / "part2.svo") + "\n")
    run("svo-voxelize", folder / "c.glb", "-o", folder / "c.svo", "--depth", 4)
    run("svo-voxelize", folder / "s.obj", "-o", folder / "s.svo", "--depth", 5)
    run("svo-compress", folder / "c.svo", "-o", folder / "c.svdag")
    run("svo-pack", folder / "c.glb", "-o", folder / "c.svscene", "--depth", 4)
    run("svo-pack", folder / "two.gltf", "-o", folder / "two.svscene", "--depth", 4)
    run("svo-render", folder / "c.svscene", "-o", folder / "a.png", "--size", "16x16")
    run("svo-render", folder / "c.svscene", "-o", folder / "b.png", "--size", "16x16", "--light", "1,0,0")
    run("svo-render", folder / "c.svscene", "-o", folder / "a.exr", "--size", "16x16")
    run("svo-render", folder / "c.svscene", "-o", folder / "b.exr", "--size", "16x16", "--light", "1,0,0")
    run("svo-compress", folder / "c.svo", "-o", folder / "lossy.svdag", "--color", 1)
    run("svo-compress", folder / "s.svo", "-o", folder / "lossy_normals.svdag", "--normal", 6)
    for name, roughness in (("rough", 0.9), ("smooth", 0.8)):
        document = json.loads((folder / "two.gltf").read_text())
        document["materials"][0]["pbrMetallicRoughness"]["roughnessFactor"] = roughness
        (folder / (name + ".gltf")).write_text(json.dumps(document))
        run("svo-voxelize", folder / (name + ".gltf"), "-o", folder / (name + ".svo"), "--depth", 4, "--attributes", "roughness")
    damaged = bytearray((folder / "c.svdag").read_bytes())
    damaged[len(damaged) // 2] ^= 1
    (folder / "damaged.svdag").write_bytes(damaged)
    (folder / "build.json").write_text(json.dumps({"output": "built", "defaults": {"voxelize": {"depth": 3}}, "assets": [{"name": "a", "input": "c.glb"}]}))


INSTEAD = {"--voxel-size": "--depth", "--view-distance": "--depth", "--budget": "--depth"}


def resolved(folder, args):
    return [str(support.tools) if a == "{TOOLS}" else str(folder / a[1:-1]) if isinstance(a, str) and a.startswith("{") else a for a in args]


def base_of(tool_name, entry):
    return entry[2] if len(entry) > 2 else BASES[tool_name][0]


def with_option(tool_name, entry):
    """The base and the entry's arguments."""
    base, kept = entry[3] if len(entry) > 3 else base_of(tool_name, entry), []
    given = {a for a in entry[0] if str(a).startswith("--")}
    given |= {INSTEAD[a] for a in given if a in INSTEAD}
    words = iter(base)
    for word in words:
        if word in given:
            next(words)  # its value
        else:
            kept.append(word)
    return kept + entry[0]


def output_of(folder, tool_name, args, code=0):
    """Bytes of the output (of tools without one: what they print) and the printed text."""
    out = BASES[tool_name][1]
    if tool_name == "svo-build":
        shutil.rmtree(folder / "built", ignore_errors=True)
    r = tool(tool_name, *resolved(folder, args), *(["-f", "-o", folder / out] if out else []))
    check(r.code == code, r)
    if tool_name == "svo-build":
        return b"".join(p.read_bytes() for p in sorted(folder.glob("built/*.svdag"))), r.text
    return r.out if not out else (folder / out).read_bytes() if (folder / out).exists() else b"", r.text


def check_one(folder, tool_name, long, entry, bases):
    expected = entry[1]
    codes = {"accepts": (7, 0), "damage": (3, 3)}.get(expected, (0, 0))
    key = json.dumps(base_of(tool_name, entry))
    if expected in ("other", "same", "text", "accepts", "damage") and key not in bases:
        bases[key] = output_of(folder, tool_name, base_of(tool_name, entry), codes[0])
    for name in (expected, BASES[tool_name][1]):
        if name and "." in name and (folder / name).exists():
            (folder / name).unlink()
    got = output_of(folder, tool_name, with_option(tool_name, entry), codes[1])
    what = "%s --%s" % (tool_name, long)
    if expected == "other":
        check(got[0] != b"" and got[0] != bases[key][0], what + " changes nothing")
    elif expected == "same":
        check(got[0] != b"" and got[0] == bases[key][0], what + " changes the output")
    elif expected == "accepts":
        check(got[1].strip() != "", what)
    elif expected == "damage":
        check(len(got[1]) > len(bases[key][1]) + 50, what)
    elif expected == "text":
        check(got[1].strip() != "" and got[1] != bases[key][1], what + " prints what is printed without it")
    else:
        check((folder / expected).stat().st_size > 0, what + " does not write " + expected)
    out = BASES[tool_name][1]
    for name in (out, expected):
        if name and (folder / name).exists() and name.rsplit(".", 1)[-1] in ("svo", "svdag", "svscene", "skel"):
            run("svo-dump", "--validate", folder / name)


def check_tool(folder, tool_name):
    have = {long for long, _ in options(tool_name)} - SHARED
    check(have == set(TABLES[tool_name]), "%s: in --help or here alone: %s" % (tool_name, sorted(have ^ set(TABLES[tool_name]))))
    inputs(folder)
    bases = {}
    if tool_name == "svo-compare" and tool("svo-compare", folder / "a.exr", folder / "a.exr").code == 5: # built without OpenEXR
        TABLES[tool_name]["float-diff"] = (["--float-diff", 5], "same")
    for long, entry in TABLES[tool_name].items():
        used = [str(a) for a in entry[0]]
        letters = {letter for name, letter in options(tool_name) if name == long and letter}
        check("--" + long in used or any(u.startswith("-" + letter) and not u.startswith("--") for letter in letters for u in used), "%s --%s is not used by its entry" % (tool_name, long))
        check_one(folder, tool_name, long, entry, bases)


def test_all_tools_are_here(folder):
    check(sorted(TABLES) == tools_by_name() == sorted(BASES), tools_by_name())


for each in TABLES:
    def one(folder, name=each):
        check_tool(folder, name)
    one.__doc__ = "Each option of %s." % each
    globals()["test_" + each.replace("-", "_")] = one


support.main(globals())
