"""svo-build: what is out of date is built and nothing else, damaged inputs among good ones, kill -9 at random moments, budgets, and the emitted scripts."""

import json
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import time

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))
import support
from schedulers import Slurm, in_folder
from support import check, run, tool


def manifest(folder, assets, defaults=None, **more):
    path = folder / "assets.json"
    path.write_text(json.dumps(dict({"output": "out", "defaults": defaults or {"voxelize": {"depth": 4}}, "assets": assets}, **more)))
    return path


def build(path, *more, code=0, **how):
    r = tool("svo-build", path, "-q", *more, **how)
    check(r.code == code, r)
    return [json.loads(line) for line in r.text.split("\n") if line]


def states(lines):
    return {(l["asset"], l["step"]): l["state"] for l in lines}


def some(folder, n=3):
    out = []
    for i in range(n):
        support.cube_obj(folder / ("m%d.obj" % i), size=1 + i, color=(1, i / max(1, n), 0))
        out.append({"name": "a%d" % i, "input": "m%d.obj" % i})
    return out


def test_builds_what_is_out_of_date(folder):
    assets = some(folder)
    assets[1]["voxelize"] = {"depth": 5, "fill": "solid"}
    assets[2]["compress"] = False
    path = manifest(folder, assets)
    check(set(states(build(path, "--dry-run")).values()) == {"stale"} and not (folder / "out").exists())
    first = build(path, "-j", 2)
    check(states(first) == {("a0", "voxelize"): "built", ("a0", "compress"): "built", ("a1", "voxelize"): "built", ("a1", "compress"): "built", ("a2", "voxelize"): "built"}, first)
    check(all(l["bytes"] == os.path.getsize(l["output"]) and len(l["key"]) == 32 for l in first), first)
    check(run("svo-dump", folder / "out/a1.svdag", "--json").json["depth"] == 5 and not (folder / "out/a2.svdag").exists())
    again = build(path)
    check(set(states(again).values()) == {"current"} and {l["key"] for l in again} == {l["key"] for l in first}, again)
    # the same bytes as by hand
    run("svo-voxelize", folder / "m0.obj", "-o", folder / "hand.svo", "--depth", 4)
    check((folder / "hand.svo").read_bytes() == (folder / "out/a0.svo").read_bytes())
    # a time alone is nothing, also the second time
    os.utime(folder / "m0.obj", (1, 1))
    check(set(states(build(path)).values()) == {"current"})
    # a material file is part of the input; so is an option, an output that was changed or lost, a lost state
    (folder / "m0.mtl").write_text("newmtl m\nKd 0 0 1\n")
    changed = states(build(path))
    check({k for k, v in changed.items() if v == "built"} == {("a0", "voxelize"), ("a0", "compress")}, changed)
    assets[1]["compress"] = {"color": "6"}
    path = manifest(folder, assets)
    check({k for k, v in states(build(path)).items() if v == "built"} == {("a1", "compress")})
    (folder / "out/a2.svo").unlink()
    check({k for k, v in states(build(path, "--dry-run")).items() if v == "stale"} == {("a2", "voxelize")})
    check({k for k, v in states(build(path)).items() if v == "built"} == {("a2", "voxelize")})
    data = (folder / "out/a0.svdag").read_bytes()
    (folder / "out/a0.svdag").write_bytes(data[:-1] + bytes([data[-1] ^ 1]))
    check({k for k, v in states(build(path)).items() if v == "built"} == {("a0", "compress")} and (folder / "out/a0.svdag").read_bytes() == data)
    (folder / "out/.svo-build/a1.voxelize.state").write_text("{")
    check(states(build(path))[("a1", "voxelize")] == "built")


def test_damaged_inputs_among_good_ones(folder):
    assets = some(folder, 3)
    (folder / "bad.ply").write_bytes(b"ply\nformat binary_little_endian 1.0\nelement vertex 9\nproperty float x\nend_header\n12")
    (folder / "webp.glb").write_bytes(b"glTF" + bytes(40))
    assets[1:1] = [{"name": "bad", "input": "bad.ply"}, {"name": "gone", "input": "nothing.obj"}, {"name": "odd", "input": "webp.glb"},
                   {"name": "wrong", "input": "m0.obj", "voxelize": {"depth": 99}}]
    path = manifest(folder, assets)
    lines = build(path, "-j", 2, code=4) # a missing file may come back: bad luck
    s = states(lines)
    check(all(s[("a%d" % i, step)] == "built" for i in range(3) for step in ("voxelize", "compress")), s)
    failed = {l["asset"]: l for l in lines if l["state"] == "failed"}
    check(set(failed) == {"bad", "gone", "odd", "wrong"}, failed)
    check((failed["bad"]["exit_code"], failed["bad"]["because"]) == (3, "bad input") and "bad.ply" in failed["bad"]["message"])
    check((failed["gone"]["exit_code"], failed["gone"]["because"], failed["gone"]["tries"]) == (2, "bad luck", 2))
    check((failed["wrong"]["exit_code"], failed["wrong"]["because"], failed["wrong"]["tries"]) == (1, "bad input", 1))
    check("depth" in open(failed["wrong"]["log"]).read())
    check(all(s[(n, "compress")] == "skipped" for n in failed))
    shutil.copy(folder / "m0.obj", folder / "nothing.obj")
    (folder / "m0.mtl").exists() and shutil.copy(folder / "m0.mtl", folder / "nothing.mtl")
    s = states(build(path, code=3)) # only bad inputs are left
    check(s[("gone", "voxelize")] == "built" and s[("a0", "voxelize")] == "current" and s[("bad", "voxelize")] == "failed", s)


def difference(got, wanted):
    """Which names and bytes are not those wanted, in words; empty: none."""
    out = ["%s is missing" % n for n in sorted(set(wanted) - set(got))] + ["%s is too much (%d bytes)" % (n, len(got[n])) for n in sorted(set(got) - set(wanted))]
    for n in sorted(set(got) & set(wanted)):
        if got[n] != wanted[n]:
            at = next((i for i, (a, b) in enumerate(zip(got[n], wanted[n])) if a != b), min(len(got[n]), len(wanted[n])))
            out.append("%s: %d bytes in place of %d, the first other one is byte %d: %r in place of %r" % (n, len(got[n]), len(wanted[n]), at, got[n][at:at + 40], wanted[n][at:at + 40]))
    return "; ".join(out)


def everything(folder):
    """All that lies under the folder of outputs: what svo-build keeps for itself by name only, for it has times."""
    files = {str(p.relative_to(folder)): p for p in folder.rglob("*") if p.is_file()}
    return {n: b"" if n.startswith(".svo-build") else p.read_bytes() for n, p in files.items()}


def test_kill_and_resume(folder):
    assets = some(folder, 8)
    path = manifest(folder, assets, {"voxelize": {"depth": 8}})
    start = time.monotonic()
    run("svo-build", path, "-q", "-j", 2)
    whole = time.monotonic() - start
    wanted = everything(folder / "out")
    shutil.rmtree(folder / "out")
    rng = random.Random(int(os.environ.get("SVOKIT_TEST_SEED", "7")))
    kills, log = 0, []
    for attempt in range(8): # by the measured length of a run, so that a slow machine is interrupted as often as a fast one
        p = subprocess.Popen([str(support.tools / "svo-build"), str(path), "-q", "-j", "2"], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
        pause = rng.uniform(0.02, 0.5 * whole)
        time.sleep(pause)
        p.send_signal(signal.SIGKILL)
        err = p.communicate(timeout=120)[1]
        log.append((round(pause, 3), p.returncode))
        check(p.returncode in (0, -signal.SIGKILL), (p.returncode, err))
        kills += p.returncode != 0
        for f in (folder / "out").glob("*"): # whatever is there under its name is whole
            if f.suffix in (".svo", ".svdag"):
                check(f.read_bytes() == wanted[f.name], "%s is not whole after a kill" % f.name)
        if p.returncode == 0:
            break
    lines = build(path)
    if kills == 0:
        support.skip("the machine was never slow enough to be interrupted")
    what = difference(everything(folder / "out"), wanted)
    check(what == "", "%s\n  kills %s\n  the last run: %s" % (what, log, lines))
    check(set(states(build(path)).values()) == {"current"}, lines)


def test_killed_while_replacing(folder):
    """kill -9 between the two calls by which one file takes the place of another: what lies there then goes with the next run."""
    shim = support.tools.parent / "tests" / "kill_rename.so"
    if not shim.exists():
        support.skip("no %s: not built under a sanitizer" % shim.name)
    assets = some(folder, 2)
    path = manifest(folder, assets)
    build(path)
    wanted = everything(folder / "out")
    killed = lambda word: dict(os.environ, LD_PRELOAD=str(shim), KILL_RENAME_OF=word)
    for word in ("a0.svo.svokit-part", "a1.svdag.svokit-part"):
        for state in (folder / "out/.svo-build").glob("*.state"):
            state.unlink()
        lines = [json.loads(l) for l in tool("svo-build", path, "-q", "--retries", 0, env=killed(word)).text.split("\n") if l]
        check("failed" in states(lines).values(), (word, lines))
        check(len([n for n in everything(folder / "out") if ".svokit-part-" in n]) >= 1, (word, everything(folder / "out").keys()))
        build(path)
        check(difference(everything(folder / "out"), wanted) == "", difference(everything(folder / "out"), wanted))
    # svo-build itself, at a state file; and what is current is tidied as well
    support.cube_obj(folder / "m0.obj", size=7)
    p = subprocess.run([str(support.tools / "svo-build"), str(path), "-q"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env=killed("a0.voxelize.state"), timeout=120)
    check(p.returncode == -signal.SIGKILL, p.returncode)
    (folder / "out/a1.svo.svokit-part-2").write_bytes(b"left")
    for _ in range(100): # steps of the killed run may take a moment to die
        r = tool("svo-build", path, "-q")
        if r.code != 2:
            break
        time.sleep(0.05)
    check(r.code == 0, r)
    check(set(everything(folder / "out")) == set(wanted), set(everything(folder / "out")) ^ set(wanted))


def test_children_die_with_it(folder):
    support.sphere_obj(folder / "s.obj", rings=200)
    path = manifest(folder, [{"name": "s", "input": "s.obj"}], {"voxelize": {"depth": 11}})
    p = subprocess.Popen([str(support.tools / "svo-build"), str(path), "-q"], stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    children = []
    end = time.monotonic() + 20
    while not children and p.poll() is None and time.monotonic() < end:
        try:
            children = open("/proc/%d/task/%d/children" % (p.pid, p.pid)).read().split()
        except OSError:
            support.skip("no /proc/PID/task/TID/children here")
    p.send_signal(signal.SIGKILL)
    p.communicate(timeout=60)
    check(children, "no step ran")
    for _ in range(100):
        if not any(os.path.exists("/proc/" + c) and open("/proc/%s/stat" % c).read().rsplit(")", 1)[1].split()[0] != "Z" for c in children):
            return
        time.sleep(0.05)
    check(False, "a step lives on")


def test_budget_and_lock(folder):
    assets = some(folder, 4)
    assets[0]["memory"] = "900M"
    path = manifest(folder, assets)
    build(path, "-j", 4, "--memory", "1G", "--report", folder / "r.json")
    check(support.report(folder / "r.json")["output"]["built"] == 8)
    options = {n: json.loads((folder / "out/.svo-build" / (n + ".voxelize.report.json")).read_text())["options"]["memory"] for n in ("a0", "a1")}
    check(options == {"a0": 900 << 20, "a1": (1 << 30) // 4}, options)
    import fcntl
    with open(folder / "out/.svo-build/lock", "r+") as f:
        fcntl.flock(f, fcntl.LOCK_EX)
        check("another svo-build" in tool("svo-build", path).err)
        build(path, code=2)


def test_measured_memory(folder):
    """Each line says what a step could take and what it took; one whose share was too little gets all of the budget, with nothing beside it."""
    assets = some(folder, 3)
    support.sphere_obj(folder / "big.obj", rings=300)
    assets.append({"name": "big", "input": "big.obj", "voxelize": {"depth": 9, "temp-size": "1K"}, "compress": False}) # cannot spill
    path = manifest(folder, assets)
    lines = {(l["asset"], l["step"]): l for l in build(path, "-j", 8, "--memory", "320M", "--report", folder / "r.json")}
    check(all(l["memory"] == (40 << 20) for k, l in lines.items() if k[0] != "big"), lines)
    check(all((1 << 20) < l["peak_rss_bytes"] <= l["memory"] for l in lines.values()), lines)
    big = lines["big", "voxelize"]
    check((big["state"], big["tries"], big["memory"]) == ("built", 2, 320 << 20), big)
    check(support.report(folder / "r.json")["output"]["step_peak_rss_bytes"] == max(l["peak_rss_bytes"] for l in lines.values()))
    none = build(path, "--retries", 0, code=0)
    check(set(states(none).values()) == {"current"}, none)


def test_progress(folder):
    """Done of total, the share by measured seconds, and the time that is left: a line a second with --progress, in place at a terminal, nothing otherwise."""
    assets = some(folder, 6)
    path = manifest(folder, assets, {"voxelize": {"depth": 7}})
    check("building" not in tool("svo-build", path).err)
    shutil.rmtree(folder / "out")
    for again in range(2): # the second run knows what the steps took
        lines = [l for l in tool("svo-build", path, "--progress", "-j", 1).err.split("\n") if "building" in l]
        seen = [re.fullmatch(r"svo-build: building (\d+) of 12(?: +(\d+)%)?(?:, \d+:\d\d so far)?(?:, about \d+:\d\d left)?", l) for l in lines]
        check(seen and all(seen), lines)
        done = [int(m.group(1)) for m in seen]
        check(done == sorted(done) and done[-1] == 12 and seen[-1].group(2) in ("100", None), lines)
        for f in (folder / "out/.svo-build").glob("*.state"):
            f.unlink()
    check("building" not in tool("svo-build", path, "--progress", "-q").err and "building" not in tool("svo-build", path, "--progress", "--no-progress").err)


def test_progress_at_a_terminal(folder):
    path = manifest(folder, some(folder, 6), {"voxelize": {"depth": 7}})
    try:
        primary, secondary = os.openpty()
    except OSError as e: # a chroot without /dev/pts
        support.skip("no terminal can be opened here: %s" % e)
    p = subprocess.Popen([str(support.tools / "svo-build"), str(path)], stdout=subprocess.DEVNULL, stderr=secondary)
    os.close(secondary)
    shown = b""
    while True:
        try:
            more = os.read(primary, 65536)
        except OSError: # the last writer has gone
            break
        if not more:
            break
        shown += more
    os.close(primary)
    check(p.wait(60) == 0 and b"\r\x1b[Ksvo-build: building 0 of 12" in shown and b"building 12 of 12 100%" in shown, shown)


def test_progress_of_tools(folder):
    support.sphere_obj(folder / "s.obj", rings=60)
    for name, args in (("svo-voxelize", (folder / "s.obj", "-o", folder / "s.svo", "--depth", 8)), ("svo-compress", (folder / "s.svo", "-o", folder / "s.svdag")),
                       ("svo-render", (folder / "s.svdag", "-o", folder / "s.png", "--size", "64x64"))):
        r = tool(name, *args, "-f", "--progress")
        check(r.code == 0 and re.search(r"^%s: \w+ +\d+%%" % name, r.err, re.M), r)
        plain = tool(name, *args, "-f")
        check(plain.code == 0 and not re.search(r"\d%", plain.err), plain)
    (folder / "scene.json").write_text(json.dumps({"assets": [{"name": "a", "file": "s.svdag"}, {"name": "b", "file": "s.obj"}, {"name": "c", "file": "s.svo"}],
                                                   "instances": [{"asset": n} for n in "abc"]}))
    for source, lines in (("scene.json", ("reading assets 3 of 3 100%", "building assets 3 of 3 100%")), ("s.obj", ("building assets 1 of 1 100%",))):
        r = run("svo-pack", folder / source, "-o", folder / "s.svscene", "-f", "--depth", 5, "--progress")
        check(all("svo-pack: " + l in r.err for l in lines), r)
    r = run("svo-merge", folder / "s.svo", "-o", folder / "m.svo", "--disk", "small", "--progress")
    check(re.search(r"^svo-merge: \w+ +\d+%", r.err, re.M), r)


def test_scenes(folder):
    assets = some(folder, 2)
    (folder / "scene.json").write_text(json.dumps({"assets": [{"name": "a", "file": "out/a0.svdag"}, {"name": "b", "file": "out/a1.svdag"}],
                                                   "instances": [{"asset": "a"}, {"asset": "b", "translation": [4, 0, 0]}]}))
    path = manifest(folder, assets, scenes=[{"name": "all", "file": "scene.json"}])
    s = states(build(path, "-j", 3))
    check(s[("all", "pack")] == "built" and run("svo-dump", folder / "out/all.svscene", "--json").json["instance_count"] == 2, s)
    check(set(states(build(path)).values()) == {"current"})
    support.cube_obj(folder / "m1.obj", size=3)
    s = states(build(path))
    check(s[("a0", "compress")] == "current" and s[("a1", "compress")] == "built" and s[("all", "pack")] == "built", s)
    # a byte order mark before the manifest is no part of it
    path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes())
    check(set(states(build(path)).values()) == {"current"})
    # a scene that names a mesh, and by it a material
    support.cube_obj(folder / "m0.obj", color=(1, 0, 0))
    build(path)
    (folder / "scene.json").write_text(json.dumps({"assets": [{"name": "a", "file": "m0.obj"}], "instances": [{"asset": "a"}]}))
    path = manifest(folder, assets, scenes=[{"name": "all", "file": "scene.json", "pack": {"depth": 4}}])
    check(states(build(path))[("all", "pack")] == "built" and states(build(path))[("all", "pack")] == "current")
    red = (folder / "out/all.svscene").read_bytes()
    (folder / "m0.mtl").write_text("newmtl m\nKd 0 1 0\n")
    check(states(build(path))[("all", "pack")] == "built" and (folder / "out/all.svscene").read_bytes() != red, "a material has changed")
    check(states(build(path))[("all", "pack")] == "current")


def emit_folder(folder, name):
    """A folder with a manifest, and what is built of it by hand."""
    work = folder / name
    work.mkdir()
    support.cube_obj(work / "x y.obj", color=(1, 0, 0))
    path = manifest(work, some(work, 2) + [{"name": "na me", "input": "x y.obj"}])
    build(path)
    wanted = outputs(work)
    check(len(wanted) == 6)
    shutil.rmtree(work / "out")
    return work, path, wanted


def outputs(work):
    return {p.name: p.read_bytes() for p in (work / "out").glob("[!.]*.sv*")}


def test_emit_sh_and_slurm(folder):
    work, path, wanted = emit_folder(folder, "it's a $test")
    (work / "run.sh").write_bytes(run("svo-build", path, "--emit", "sh").out)
    check(subprocess.run(["sh", str(work / "run.sh")], timeout=120).returncode == 0)
    check(outputs(work) == wanted, "sh makes other files")
    shutil.rmtree(work / "out")
    (work / "job.sh").write_bytes(run("svo-build", path, "--emit", "slurm").out)
    for task in range(3):
        check(subprocess.run(["sh", str(work / "job.sh")], env=dict(os.environ, SLURM_ARRAY_TASK_ID=str(task)), timeout=120).returncode == 0)
    check(subprocess.run(["sh", str(work / "job.sh")], env=dict(os.environ, SLURM_ARRAY_TASK_ID="3"), stderr=subprocess.DEVNULL, timeout=120).returncode == 1)
    check(outputs(work) == wanted, "slurm makes other files")
    (work / "m0.obj").write_text("v 1 2 x\n")
    (work / "x y.obj").unlink()
    shutil.rmtree(work / "out")
    r = subprocess.run(["sh", str(work / "run.sh")], stderr=subprocess.PIPE, timeout=120)
    check(r.returncode == 2 and r.stderr.count(b"error:") == 2, "not a failure an asset: %r" % r.stderr)
    check(outputs(work) == {n: wanted[n] for n in wanted if n.startswith("a1.")}, "other assets than the sound ones")


def test_emit_ninja(folder):
    if shutil.which("ninja") is None:
        support.skip("no ninja")
    work, path, wanted = emit_folder(folder, "its a $test") # Ninja's reader of depfiles knows no apostrophes
    run("svo-build", path, "--emit", "ninja", "-o", work / "build.ninja")
    ninja = lambda: subprocess.run(["ninja", "-f", str(work / "build.ninja")], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, cwd=folder, timeout=120)
    r = ninja()
    check(r.returncode == 0 and outputs(work) == wanted, r.stdout)
    check(b"no work to do" in ninja().stdout)
    (work / "x y.mtl").write_text("newmtl m\nKd 0 1 0\n")
    check(b"[2/2]" in ninja().stdout and outputs(work) != wanted, "a changed material is not seen through the depfile")
    (work / "x y.mtl").write_text("newmtl m\nKd 1 0 0\n")
    ninja()
    check(outputs(work) == wanted)
    # a missing input and a damaged one: the other asset is built all the same
    (work / "m0.obj").write_text("v 1 2 x\n")
    (work / "x y.obj").unlink()
    shutil.rmtree(work / "out")
    (work / ".ninja_log").unlink(missing_ok=True)
    r = subprocess.run(["ninja", "-k", "0", "-f", str(work / "build.ninja")], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, cwd=folder, timeout=120)
    check(r.returncode == 1 and r.stdout.count(b"FAILED") == 2 and outputs(work) == {n: wanted[n] for n in wanted if n.startswith("a1.")}, r.stdout)
    check(b"x y.obj" in r.stdout and b"m0.obj" in r.stdout, r.stdout)


def test_emitted_job_array_in_slurm(folder):
    """A damaged model among others: its task alone fails, and the scene follows when the array has ended."""
    work, path, wanted = emit_folder(folder, "work")
    (work / "bad.obj").write_text("v 1 2 x\n")
    (work / "scene.json").write_text(json.dumps({"assets": [{"name": "a", "file": "out/a0.svdag"}], "instances": [{"asset": "a"}]}))
    assets = json.loads(path.read_text())["assets"]
    path = manifest(work, assets[:1] + [{"name": "bad", "input": "bad.obj"}] + assets[1:], scenes=[{"name": "scene", "file": "scene.json"}])
    (work / "job.sh").write_bytes(run("svo-build", path, "--emit", "slurm").out)
    slurm = Slurm(folder / "slurm")
    try:
        slurm.skip_unless_idle()
        job = in_folder(["sbatch", "--parsable", "job.sh"], work, env=slurm.env).strip()
        in_folder(["sbatch", "--array=0", "--dependency=afterany:" + job, "job.sh", "scenes"], work, env=slurm.env)
        slurm.wait_for_jobs(60)
    finally:
        slurm.close()
    talk = "".join(p.read_text(errors="replace") for p in sorted(work.glob("svo-build-*.log")))
    made = outputs(work)
    check(made.pop("scene.svscene", b"")[:4] != b"" and made == wanted, (sorted(made), talk))
    check("bad.obj" in talk and not list((work / "out").glob("bad*")), talk)
    run("svo-dump", "--validate", work / "out/scene.svscene")


def test_bad_manifests(folder):
    for text, word in ((b"", "the file is empty"), (b"{", "line 1"), (b"[]", "object"), (b'{"assets": 1}', "list"), (b'{"assets": [], "x": 1}', "unknown key"), (b'{"assets": [{"name": "a"}]}', "input"),
                       (b'{"assets": [{"name": "../a", "input": "x"}]}', "no name"), (b'{"assets": [{"name": "a", "input": "x", "voxelize": {"output": "y"}}]}', "itself"),
                       (b'{"assets": [{"name": "a", "input": "x"}, {"name": "a", "input": "y"}]}', "differ"), (b'{"assets": [{"name": "a", "input": []}]}', "no input"),
                       (b'{"assets": [{"name": "a", "input": "x", "memory": "lots"}]}', "memory"), (b'{"assets": [{"name": "a", "input": "x", "compress": true}]}', "object of options"),
                       (b"[" * 100000, ""), (b'{"assets": [{"name": "a", "input": "x\\u0000y"}]}', "")):
        (folder / "m.json").write_bytes(text)
        r = tool("svo-build", folder / "m.json")
        check(r.code == 3 and word in r.err, (text[:80], str(r)))
    check(tool("svo-build", folder / "none.json").code == 2)
    (folder / "m.json").write_text('{"assets": []}')
    check(tool("svo-build", folder / "m.json").code == 0)
    check(tool("svo-build", folder / "m.json", "-o", "x").code == 1)


support.main(globals())
