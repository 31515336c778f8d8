"""Exit codes of every tool: 0 ok, 1 usage, 2 input/output, 3 invalid input, 4 runtime, 5 unsupported, 6 limit, 7 differs.

Whatever fails must say why in one line that begins with the tool's name, leave existing files as they were and no new ones.
"""

import json
import os
import struct
import subprocess

import support
from support import check, run, tool, tools

TOOLS = ["svo-voxelize", "svo-compress", "svo-pack", "svo-render", "svo-dump", "svo-compare", "svo-skeleton", "svo-merge", "svo-bench"]
READS_OURS = ["svo-compress", "svo-render", "svo-dump", "svo-compare", "svo-skeleton", "svo-merge"]
WRITES = {"svo-voxelize": "o.svo", "svo-compress": "o.svdag", "svo-pack": "o.svscene", "svo-render": "o.png", "svo-skeleton": "o.skel",
          "svo-merge": "m.svo"}

SCENE = {"assets": [{"name": "a", "file": "cube.svdag"}], "instances": [{"asset": "a"}, {"asset": "a", "translation": [3, 0, 0]}]}


class Inputs:
    """A small good file of every kind, made once a folder."""

    def __init__(self, folder):
        self.obj = support.cube_obj(folder / "cube.obj", color=(1, 0.5, 0))
        self.svo, self.svdag, self.scene, self.json = folder / "cube.svo", folder / "cube.svdag", folder / "cube.svscene", folder / "scene.json"
        run("svo-voxelize", self.obj, "-o", self.svo, "--depth", 4)
        self.shard = folder / "shard.svo"
        run("svo-voxelize", self.obj, "-o", self.shard, "--depth", 4, "--shard", "1/1")
        run("svo-compress", self.svo, "-o", self.svdag)
        self.json.write_text(json.dumps(SCENE))
        run("svo-pack", self.json, "-o", self.scene)

    def good(self, name, out=None):
        """Arguments of a run that works; out: name of the output."""
        args = {
            "svo-voxelize": [self.obj, "--depth", 4],
            "svo-compress": [self.svo],
            "svo-pack": [self.json],
            "svo-render": [self.svdag, "--size", "16x12"],
            "svo-dump": [self.svo],
            "svo-compare": [self.svo, self.svdag],
            "svo-skeleton": [self.obj, "--omega", "0.3"],
            "svo-bench": [self.obj, "--sweep", "depth", "--values", "2,3", "--repeat", 1],
            "svo-merge": [self.shard],
        }[name]
        return args + (["-o", out] if out is not None else [])

    def replaced(self, name, path, out=None):
        """The same with another input in place of the first."""
        return [path] + self.good(name, out)[1:]


def listing(folder):
    return {p: (p.read_bytes() if p.is_file() else None) for p in sorted(folder.rglob("*"))}


def fails(name, args, code, folder=None, **more):
    """Run, expect the code, one line of reason, and (if a folder is given) nothing changed in it."""
    before = listing(folder) if folder else None
    r = tool(name, *args, **more)
    check(r.code == code, "expected exit %s: %s" % (code, r))
    lines = [line for line in r.err.splitlines() if ": warning: " not in line]
    errors = [line for line in lines if line.startswith(name + ": error: ")]
    check(len(errors) == 1, "one line of reason: %s" % r)
    check(len(errors[0]) > len(name) + 15, r)
    if folder:
        check(listing(folder) == before, "files have changed: %s" % r)
    return r


def new_output(folder, name):
    return folder / ("new-" + WRITES[name]) if name in WRITES else None


def each_tool():
    return TOOLS


def test_help_and_version(folder):
    for name in each_tool():
        r = run(name, "--help")
        check(r.err == "" and ("Usage: " + name) in r.text and "Exit status:" in r.text and "--threads" in r.text, r)
        check(name in WRITES or "-o, --output" not in r.text, r)
        r = run(name, "--version")
        check(r.err == "" and r.text.startswith(name + " ") and r.text.count("\n") == 1, r)


def test_usage_errors(folder):
    inputs = Inputs(folder)
    for name in each_tool():
        out = new_output(folder, name)
        for extra in (["--no-such-option"], ["-Z"], ["--threads", "many"], ["--threads", "-1"], ["--memory", "1KB"], ["--threads"]):
            r = fails(name, inputs.good(name, out) + extra, 1, folder)
            check("--help" in r.err and r.out == b"", r)
        r = fails(name, [], 1, folder)
        check("--help" in r.err, r)
        if out:
            fails(name, inputs.good(name), 1, folder)  # no -o
    for value in ("22", "-1", "x", "1.5", "", "4294967296"):
        fails("svo-voxelize", [inputs.obj, "-o", folder / "n.svo", "--depth", value], 1, folder)
    fails("svo-voxelize", [inputs.obj, "-o", folder / "n.svo"], 1, folder)  # neither --depth nor --voxel-size
    fails("svo-compress", [inputs.svo, "-o", folder / "n.svdag", "--color", "deltaE=no"], 1, folder)


def test_an_output_never_is_an_input(folder):
    inputs = Inputs(folder)
    for name in WRITES:
        first = inputs.good(name)[0]
        fails(name, inputs.good(name, first) + ["--force"], 1, folder)
        link = folder / ("link-" + name)
        os.symlink(first, link)
        fails(name, inputs.good(name, link) + ["--force"], 1, folder)
    for name in each_tool():
        out = new_output(folder, name)
        fails(name, inputs.good(name, out) + ["--report", inputs.good(name)[0], "--force"], 1, folder)


def test_missing_input(folder):
    inputs = Inputs(folder)
    for name in each_tool():
        out = new_output(folder, name)
        missing = folder / ("missing" + inputs.good(name)[0].suffix)
        r = fails(name, inputs.replaced(name, missing, out), 2, folder)
        check(missing.name in r.err, r)
        sub = folder / ("folder" + inputs.good(name)[0].suffix)
        sub.mkdir(exist_ok=True)
        fails(name, inputs.replaced(name, sub, out), 2, folder)


def test_garbage_input(folder):
    inputs = Inputs(folder)
    for name in each_tool():
        out = new_output(folder, name)
        suffix = inputs.good(name)[0].suffix
        for i, data in enumerate((b"\0" * 500, bytes(range(256)) * 9, b"\x89SVX\r\n\x1a\n" + b"\xff" * 300)):
            bad = folder / ("garbage%d%s" % (i, suffix))
            bad.write_bytes(data)
            # OBJ is text without a signature: lines that are no statements make an empty mesh or an error
            r = tool(name, *inputs.replaced(name, bad, out))
            check(r.code in ((3, 5) if suffix != ".obj" else (0, 3, 5)), r)
            if r.code != 0:
                check(not out or not out.exists(), r)
            elif out:
                out.unlink()


def test_empty_input(folder):
    inputs = Inputs(folder)
    for name in READS_OURS + ["svo-pack"]:
        out = new_output(folder, name)
        empty = folder / ("empty" + inputs.good(name)[0].suffix)
        empty.write_bytes(b"")
        r = fails(name, inputs.replaced(name, empty, out), 3, folder)
        check(empty.name in r.err, r)
    for name, suffix, data in (("svo-pack", ".svo", b""), ("svo-pack", ".svdag", b"\x89SVX"), ("svo-pack", ".svo", b"\x89SVX\r\n\x1a\n" + b"\0" * 9),
                               ("svo-pack", ".json", b"\xff"), ("svo-pack", ".json", b"[]"), ("svo-skeleton", ".svo", b""), ("svo-skeleton", ".svo", b"\x89SVX")):
        short = folder / ("short" + suffix)
        short.write_bytes(data)
        r = fails(name, inputs.replaced(name, short, new_output(folder, name)), 3, folder)
        check(short.name in r.err, r)


def test_damaged_files_of_ours(folder):
    inputs = Inputs(folder)
    damaged = folder / "damaged"
    for good, readers in ((inputs.svo, READS_OURS), (inputs.shard, READS_OURS), (inputs.svdag, ["svo-render", "svo-dump", "svo-compare"]), (inputs.scene, ["svo-render", "svo-dump", "svo-compare"])):
        data = good.read_bytes()
        for name in readers:
            for change in ("cut", "flip"):
                for at in (9, 70, len(data) // 2, len(data) - 70, len(data) - 1):
                    bad = bytearray(data)
                    if change == "cut":
                        bad = bad[:at]
                    else:
                        bad[at] ^= 0x41
                    damaged.write_bytes(bad)
                    out = new_output(folder, name)
                    args = [damaged, good] if name == "svo-compare" else inputs.replaced(name, damaged, out)
                    if name == "svo-dump":
                        args += ["--validate"]
                    r = tool(name, *args)
                    check(r.code in (3, 5), "%s %s at %d of %s: %s" % (change, at, len(data), good.name, r))
                    check("damaged: " in r.err or str(damaged) in r.err, "the message names the file: %s" % r)
                    check(not out or not out.exists(), r)


def test_existing_output_needs_force(folder):
    inputs = Inputs(folder)
    for name, new in WRITES.items():
        out = folder / ("existing-" + new)
        out.write_bytes(b"precious")
        r = fails(name, inputs.good(name, out), 2, folder)
        check("--force" in r.err, r)
        run(name, *inputs.good(name, out), "--force")
        check(out.read_bytes() != b"precious", name)


def test_unwritable_output(folder):
    inputs = Inputs(folder)
    locked = folder / "locked"
    locked.mkdir()
    locked.chmod(0o500)
    for name, new in WRITES.items():
        fails(name, inputs.good(name, folder / "nowhere" / new), 2, folder)
        if os.geteuid() != 0:  # the superuser may write everywhere
            fails(name, inputs.good(name, locked / new), 2)
        if os.path.exists("/dev/full"):
            full = folder / ("full-" + new)
            os.symlink("/dev/full", full)
            r = tool(name, *inputs.good(name, full))
            check(r.code == 2, r)


def test_output_is_whole_or_not_there(folder):
    """A run that fails leaves an existing output as it was, even with --force."""
    inputs = Inputs(folder)
    for name, new in WRITES.items():
        if name in ("svo-voxelize", "svo-skeleton"):
            bad = folder / "bad.ply"
            bad.write_bytes(b"ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\n")
        else:
            bad = folder / ("bad" + inputs.good(name)[0].suffix)
            bad.write_bytes(inputs.good(name)[0].read_bytes()[:-20])
        out = folder / ("kept-" + new)
        out.write_bytes(b"old")
        fails(name, inputs.replaced(name, bad, out) + ["--force"], 3, folder)


def test_report_is_written_on_failure(folder):
    inputs = Inputs(folder)
    for name in each_tool():
        out = folder / ("ok-" + WRITES[name]) if name in WRITES else None
        path = folder / (name + ".json")
        r = tool(name, *inputs.good(name, out), "--report", path)
        check(r.code == 0, r)
        good = support.report(path)
        check(good["exit_code"] == 0 and good["tool"] == name and "error" not in good, good)
        check(isinstance(good["phases"], list) and len(good["phases"]) > 0, name + " reports no phases")
        missing = folder / ("missing" + inputs.good(name)[0].suffix)
        out2 = folder / ("no-" + WRITES[name]) if name in WRITES else None
        r = fails(name, inputs.replaced(name, missing, out2) + ["--report", path], 2)
        bad = support.report(path)
        check(bad["exit_code"] == 2 and bad["error"] and bad["error_code"] == "IO", bad)
        check(bad["options"].keys() == good["options"].keys(), "options")


def test_unsupported(folder):
    inputs = Inputs(folder)
    # a kind or a version of our container that is not known; rightly hashed headers are tested in C
    gltf = folder / "needs.gltf"
    gltf.write_text(json.dumps({"asset": {"version": "2.0"}, "extensionsUsed": ["EXT_not_there"], "extensionsRequired": ["EXT_not_there"]}))
    for name in [n for n in TOOLS if n in ("svo-voxelize", "svo-skeleton", "svo-bench")]:
        r = fails(name, inputs.replaced(name, gltf, new_output(folder, name)), 5, folder)
        check("EXT_not_there" in r.err, r)
    image = folder / "a.webp"
    image.write_bytes(b"RIFF\x10\0\0\0WEBPVP8 ....")
    r = fails("svo-compare", [image, image], 5, folder)
    check("WebP" in r.err, r)
    png = folder / "a.png"
    support.write_png(png, 4, 4, lambda x, y: (1, 2, 3))
    fails("svo-compare", [png, inputs.svo], 5, folder)
    fails("svo-compare", [inputs.scene, inputs.svo], 5, folder)
    if "svo-skeleton" in TOOLS:
        skeleton = folder / "cube.skel"
        run("svo-skeleton", *inputs.good("svo-skeleton", skeleton))
        fails("svo-render", [skeleton, "-o", folder / "new.png"], 5, folder)


def test_limits(folder):
    inputs = Inputs(folder)
    bomb = folder / "bomb.png"
    data = bytearray(support.write_png(None, 4, 4, lambda x, y: (1, 2, 3)))
    data[16:24] = struct.pack(">II", 1 << 30, 1 << 30)
    data[29:33] = struct.pack(">I", support.zlib.crc32(data[12:29]))
    bomb.write_bytes(data)
    r = fails("svo-compare", [bomb, bomb], 6, folder)
    check("268435456" in r.err, r)
    fails("svo-compare", [inputs.svo, inputs.svdag, "--max-voxels", "10"], 6, folder)
    fails("svo-compare", [inputs.svdag, inputs.svdag, "--max-voxels", "10"], 6, folder)


def test_differs(folder):
    inputs = Inputs(folder)
    other = folder / "other.svo"
    run("svo-voxelize", support.cube_obj(folder / "other.obj", offset=(0.3, 0, 0)), "-o", other, "--depth", 4)
    check(tool("svo-compare", inputs.svo, other).code == 7)
    check(tool("svo-compare", inputs.svo, inputs.svdag).code == 0)


def test_pipes_and_closed_streams(folder):
    inputs = Inputs(folder)
    # our formats through pipes give the same bytes
    svo = run("svo-voxelize", inputs.obj, "--depth", 4, "-o", "-").out
    check(svo == inputs.svo.read_bytes(), "svo-voxelize -o -")
    piped = run("svo-compress", "-", "-o", "-", stdin=svo).out  # the name of the input is in META, all else is the same
    r = tool("svo-compare", "-", inputs.svdag, "--json", stdin=piped)
    check(r.code == 0 and r.json["identical"], r)
    run("svo-dump", "-", stdin=svo)
    check(tool("svo-compare", "-", inputs.svdag, stdin=svo).code == 0)
    # a reader that goes away is an I/O error, not a signal
    for name in ("svo-dump", "svo-compare", "svo-bench"):
        read, write = os.pipe()
        os.close(read)
        p = subprocess.run([str(tools / name)] + [str(a) for a in inputs.good(name)], stdout=write, stderr=subprocess.PIPE)
        os.close(write)
        check(p.returncode == 2, "%s: %s %s" % (name, p.returncode, p.stderr))
    # standard streams that are closed
    for name in each_tool():
        out = folder / ("closed-" + WRITES[name]) if name in WRITES else None
        words = " ".join("'%s'" % a for a in [tools / name] + inputs.good(name, out))
        code = subprocess.run(["sh", "-c", words + " <&- 2>&-"], stdout=subprocess.DEVNULL).returncode
        check(code == 0, "%s with stdin and stderr closed: %s" % (name, code))


support.main(globals())
