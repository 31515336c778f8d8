"""Shards: svo-voxelize --shard and svo-merge, content keys and depfiles, and the schedulers that run them."""

import os
import random
import re
import shlex
import shutil
import struct
import subprocess
import time

import support
from schedulers import Slurm, in_folder, program, with_tools
from support import check, model, report, run, source, tool, tools


def bumpy(path, rings=40, size=3.0):
    """A closed surface whose triangles are very unevenly spread: a sphere with a small, finely meshed one on it, and a floor."""
    big, small = support.sphere_obj(path.with_suffix(".big"), 12, size), support.sphere_obj(path.with_suffix(".small"), rings, 0.3)
    lines, count = [], 0
    for name, shift in ((big, (0, 0, 0)), (small, (size, 0, 0))):
        here = 0
        for line in name.read_text().splitlines():
            words = line.split()
            if words[0] == "v":
                lines.append("v " + " ".join(repr(float(w) + s) for w, s in zip(words[1:], shift)))
                here += 1
            else:
                lines.append("f " + " ".join(str(int(w) + count) for w in words[1:]))
        count += here
        name.unlink()
    lines += ["v -9 -3 -9", "v 9 -3 -9", "v 9 -3 9", "v -9 -3 9", "f %d %d %d %d" % tuple(count + i for i in (4, 3, 2, 1))]
    path.write_text("\n".join(lines) + "\n")
    return path


def shards(folder, mesh, count, *options, prefix="s"):
    paths = []
    for i in range(1, count + 1):
        paths.append(folder / ("%s%d-%d.svo" % (prefix, count, i)))
        run("svo-voxelize", mesh, "-o", paths[-1], "--shard", "%d/%d" % (i, count), *options)
    return paths


def merged(folder, paths, name="merged.svo"):
    run("svo-merge", *paths, "-o", folder / name, "--force")
    return (folder / name).read_bytes()


def same_as_one_run(folder, mesh, *options, counts=(1, 2, 3, 7)):
    order = random.Random(5)
    run("svo-voxelize", mesh, "-o", folder / "one.svo", "--force", *options)
    one = (folder / "one.svo").read_bytes()
    for count in counts:
        paths = shards(folder, mesh, count, *options, "--force")
        order.shuffle(paths)
        check(merged(folder, paths) == one, "%d shards of %s" % (count, mesh))
    return one


def test_merged_shards_are_one_run(folder):
    mesh = bumpy(folder / "bumpy.obj")
    for options in (["--depth", 9], ["--depth", 10, "--surface", "thin", "--attributes", "none"], ["--voxel-size", 0.05, "--level", 1]):
        same_as_one_run(folder, mesh, *options)


def test_shards_with_textures_and_instances(folder):
    png = support.write_png(None, 16, 16, lambda x, y: (x * 16, y * 16, 90))
    glb = support.cube_glb(folder / "t.glb", texture=png, nodes=[(i * 1.5, i % 2, i % 3) for i in range(9)])
    same_as_one_run(folder, glb, "--depth", 9, counts=(2, 5))


def test_more_shards_than_chunks(folder):
    cube = support.cube_obj(folder / "c.obj")
    same_as_one_run(folder, cube, "--depth", 8, counts=(7, 20))  # at most 8 chunks
    same_as_one_run(folder, cube, "--depth", 3, counts=(3,))  # one chunk
    same_as_one_run(folder, cube, "--depth", 0, counts=(2,))
    (folder / "e.obj").write_text("v 0 0 0\n")
    same_as_one_run(folder, folder / "e.obj", "--depth", 9, counts=(2,))


def test_threads_and_memory_do_not_change_a_shard(folder):
    mesh = bumpy(folder / "bumpy.obj")
    for i in (1, 2, 3):
        args = [mesh, "--depth", 9, "--shard", "%d/3" % i]
        a = run("svo-voxelize", *args, "-o", "-", "--threads", 1).out
        check(a == run("svo-voxelize", *args, "-o", "-", "--threads", 2, "--memory", "64M").out, i)


def test_model_shards_and_balance(folder):
    mesh = model("C_textured/japanese_maple/japaneseMaple.obj")
    same_as_one_run(folder, mesh, "--depth", 8, counts=(3,))
    for count in (4, 8):
        voxels, seconds = [], []
        for i in range(1, count + 1):
            run("svo-voxelize", mesh, "-o", folder / "b.svo", "--force", "--depth", 10, "--shard", "%d/%d" % (i, count), "--report", folder / "r.json")
            r = report(folder / "r.json")
            check(r["shard"]["index"] == i and r["shard"]["count"] == count, r["shard"])
            voxels.append(r["output"]["voxels"])
            seconds.append(sum(p["seconds"] for p in r["phases"] if p["name"] == "voxelize"))
        ratio = lambda v: max(v) * len(v) / sum(v)
        print("         %d shards: most/mean of voxels %.2f, of seconds %.2f" % (count, ratio(voxels), ratio(seconds)))
        # 8^3 chunks of which a crown fills some hundred: no shard takes half of the work
        check(ratio(voxels) < 2, voxels)


def chunk_list(data):
    """(type, id, offset of the header, size) of all chunks but the table."""
    at, out = 64, []
    while data[at:at + 4] != b"TABL":
        size, ident = struct.unpack_from("<Q", data, at + 8)[0], struct.unpack_from("<Q", data, at + 40)[0]
        out.append((data[at:at + 4], ident, at, size))
        at += 64 + (size + 63) // 64 * 64
    return out


def test_a_shard_is_an_octree(folder):
    mesh = bumpy(folder / "bumpy.obj")
    run("svo-voxelize", mesh, "-o", folder / "one.svo", "--depth", 10)
    whole = {c[1] for c in chunk_list((folder / "one.svo").read_bytes()) if c[0] == b"TREE"}
    seen, at, jobs = set(), 0, set()
    for i, path in enumerate(shards(folder, mesh, 3, "--depth", 10)):
        run("svo-dump", "--validate", path)
        check(run("svo-dump", "--json", path).json["depth"] == 10)
        data = path.read_bytes()
        chunks = chunk_list(data)
        check([c[0] for c in chunks[:2]] == [b"HEAD", b"SHRD"], chunks[:2])
        index, count, first, end, job = struct.unpack_from("<IIQQ16s", data, chunks[1][2] + 64)
        check((index, count, first) == (i + 1, 3, at), (index, count, first, at))
        check(struct.unpack_from("<H", data, chunks[1][2] + 4)[0] == 0, "SHRD must be optional")
        codes = {c[1] for c in chunks if c[0] == b"TREE"}
        check(codes and all(first <= c < end for c in codes) and not codes & seen, "codes")
        seen |= codes
        at = end
        jobs.add(job)
    check(at == 8**3 and seen == whole and len(jobs) == 1, (at, len(jobs)))


def refused(paths, folder, *words):
    r = tool("svo-merge", *paths, "-o", folder / "no.svo")
    check(r.code == 3 and not (folder / "no.svo").exists(), r)
    for word in words:
        check(str(word) in r.err, "%s is not named: %s" % (word, r))


def test_incomplete_and_foreign_sets_are_refused(folder):
    mesh = bumpy(folder / "bumpy.obj")
    other = bumpy(folder / "other.obj", rings=41)
    a = shards(folder, mesh, 3, "--depth", 8)
    run("svo-voxelize", mesh, "-o", folder / "one.svo", "--depth", 8)
    refused([a[0], a[2]], folder, "1 of 3", "missing: 2")
    refused([a[1]], folder, "2 of 3", "1, 3")
    refused([a[0], a[1], a[2], a[1]], folder, "shard 2", a[1].name)
    copy = folder / "copy.svo"
    shutil.copy(a[0], copy)
    refused([a[0], copy, a[2]], folder, "shard 1", a[0].name, copy.name)
    refused([a[0], a[1], folder / "one.svo"], folder, "one.svo")
    refused([mesh], folder, mesh.name)
    # of the same mesh with other options, of another mesh, of another number of shards
    for options, what in ((["--depth", 8, "--attributes", "none"], mesh), (["--depth", 9], mesh), (["--depth", 8, "--level", 4], mesh), (["--depth", 8], other)):
        foreign = shards(folder, what, 3, *options, prefix="f")
        refused([a[0], a[1], foreign[2]], folder, foreign[2].name, "another job")
        for f in foreign:
            f.unlink()
    refused([a[0]] + shards(folder, mesh, 4, "--depth", 8), folder, "3")
    # damage anywhere in a shard
    data = bytearray(a[1].read_bytes())
    for kind, _, at, size in chunk_list(bytes(data)):
        for place in (at + 20, at + 64 + size // 2):
            bad = bytearray(data)
            bad[place] ^= 0x10
            (folder / "bad.svo").write_bytes(bad)
            refused([a[0], folder / "bad.svo", a[2]], folder, "bad.svo")
    check(tool("svo-merge", "-", "-o", folder / "no.svo").code == 1)
    check(tool("svo-merge", a[0], folder / "nothing.svo", "-o", folder / "no.svo").code == 2)


def test_merge_of_a_list_in_little_memory(folder):
    mesh = support.cube_obj(folder / "c.obj")
    count = 300
    paths = shards(folder, mesh, count, "--depth", 9, "--attributes", "none")
    run("svo-voxelize", mesh, "-o", folder / "one.svo", "--depth", 9, "--attributes", "none")
    names = "".join("%s\n" % p for p in reversed(paths)).encode()
    (folder / "list").write_bytes(names)
    command = "ulimit -n 16; exec %s --list %s -o %s --memory 4M --report %s" % tuple(
        shlex.quote(str(p)) for p in (tools / "svo-merge", folder / "list", folder / "m.svo", folder / "r.json"))
    r = subprocess.run(["sh", "-c", command], stderr=subprocess.PIPE)
    check(r.returncode == 0, r.stderr)
    check((folder / "m.svo").read_bytes() == (folder / "one.svo").read_bytes(), "300 shards")
    check(report(folder / "r.json")["input"]["shards"] == count)
    check(run("svo-merge", "--list", "-", "-o", "-", stdin=names).out == (folder / "one.svo").read_bytes(), "list on stdin")


def test_shard_arguments(folder):
    cube = support.cube_obj(folder / "c.obj")
    base = [cube, "--depth", 4, "-o", folder / "o.svo", "--shard"]
    clean = {k: v for k, v in os.environ.items() if not k.startswith("SLURM_")}
    for bad in ("0/3", "4/3", "1/0", "1", "/", "1/", "/2", "x/2", "-1/2", "1/2/3", "1/100001", "99999999999/2", "auto", ""):
        r = tool("svo-voxelize", *base, bad, env=clean)
        check(r.code == 1 and not (folder / "o.svo").exists(), r)
    array = lambda id, low, high, count, step=1: dict(
        clean, SLURM_ARRAY_TASK_ID=str(id), SLURM_ARRAY_TASK_MIN=str(low), SLURM_ARRAY_TASK_MAX=str(high), SLURM_ARRAY_TASK_COUNT=str(count),
        SLURM_ARRAY_TASK_STEP=str(step))
    big = bumpy(folder / "b.obj")
    for env, want in ((array(0, 0, 2, 3), "1/3"), (array(2, 0, 2, 3), "3/3"), (array(7, 3, 9, 4, 2), "3/4")):
        got = run("svo-voxelize", big, "--depth", 8, "-o", "-", "--shard", "auto", env=env).out
        check(got == run("svo-voxelize", big, "--depth", 8, "-o", "-", "--shard", want, env=clean).out, want)
    # an array with a hole (some tasks again) would mean other shards
    for env in (array(5, 2, 9, 3), array(1, 2, 3, 2), array(4, 3, 9, 4, 2), dict(array(1, 1, 2, 2), SLURM_ARRAY_TASK_ID="x")):
        check(tool("svo-voxelize", *base, "auto", env=env).code == 1)


def textured(folder):
    """An OBJ with a material and a texture."""
    support.write_png(folder / "look.png", 4, 4, lambda x, y: (x * 60, y * 60, 200))
    (folder / "m.mtl").write_text("newmtl m\nKd 1 1 1\nmap_Kd look.png\n")
    (folder / "m.obj").write_text("mtllib m.mtl\nusemtl m\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nf 1/1 2/2 3/3 4/4\n")
    return folder / "m.obj"


def test_key(folder):
    mesh = textured(folder)
    key = lambda *args: run("svo-voxelize", mesh, "--key", *args).text
    first = key("--depth", 6)
    check(re.fullmatch("[0-9a-f]{32}\n", first), first)
    check(sorted(p.name for p in folder.iterdir()) == ["look.png", "m.mtl", "m.obj"], "--key makes nothing")
    for same in (["--threads", 1], ["-o", folder / "x.svo"], ["--memory", "1G"], ["--report", folder / "r.json"], ["-v"]):
        check(key("--depth", 6, *same) == first, same)
    moved = folder / "elsewhere"
    moved.mkdir()
    for name in ("m.obj", "m.mtl", "look.png"):
        shutil.copy(folder / name, moved)
    check(run("svo-voxelize", "m.obj", "--key", "--depth", 6, cwd=moved).text == first, "folders are no part of it")
    seen = {first}
    for other in (["--depth", 7], ["--voxel-size", 0.1], ["--depth", 6, "--surface", "thin"], ["--depth", 6, "--attributes", "none"], ["--depth", 6, "--level", 4],
                  ["--depth", 6, "--shard", "1/2"], ["--depth", 6, "--shard", "2/2"]):
        seen.add(key(*other))
    check(len(seen) == 8, seen)
    for name, change in (("look.png", lambda: support.write_png(folder / "look.png", 4, 4, lambda x, y: (x * 60, y * 60, 201))),
                         ("m.mtl", lambda: (folder / "m.mtl").write_text("newmtl m\nKd 1 1 0.9\nmap_Kd look.png\n")),
                         ("m.obj", lambda: mesh.write_text(mesh.read_text() + "# more\n"))):
        change()
        seen.add(key("--depth", 6))
    check(len(seen) == 11, seen)
    (folder / "look.png").unlink()
    seen.add(key("--depth", 6))
    check(len(seen) == 12, "a missing texture")


def test_depfile(folder):
    odd = folder / "a b#c$d"
    odd.mkdir()
    mesh = textured(odd)
    out, dep = odd / "o.svo", folder / "o.d"
    run("svo-voxelize", mesh, "-o", out, "--depth", 4, "--depfile", dep)
    escape = lambda p: str(p).replace("$", "$$").replace("#", "\\#").replace(" ", "\\ ")
    want = escape(out) + ":" + "".join(" \\\n  " + escape(p) for p in sorted([odd / "look.png", odd / "m.mtl", odd / "m.obj"])) + "\n"
    check(dep.read_text() == want, dep.read_text())
    # glTF with a buffer and an image of its own
    glb = support.cube_glb(folder / "in.glb", texture=support.write_png(None, 4, 4, lambda x, y: (9, 9, 9)))
    data = glb.read_bytes()
    size = struct.unpack_from("<I", data, 12)[0]
    text, body = data[20:20 + size].decode().rstrip(), data[28 + size:]
    support.write_png(folder / "im age.png", 4, 4, lambda x, y: (9, 9, 9))
    (folder / "d.bin").write_bytes(body)
    text = re.sub(r'"buffers":\[\{', '"buffers":[{"uri":"d.bin",', text)
    text = re.sub(r'"images":\[\{[^]]*\}\]', '"images":[{"uri":"im%20age.png"}]', text)
    (folder / "s.gltf").write_text(text)
    run("svo-voxelize", folder / "s.gltf", "-o", folder / "s.svo", "--depth", 4, "--depfile", folder / "s.d")
    listed = (folder / "s.d").read_text()
    for name in ("s.gltf", "d.bin", "im\\ age.png"):
        check(str(folder) + "/" + name in listed, listed)
    # never over a file that was read, nor over another one without --force
    before = (odd / "m.mtl").read_bytes()
    r = tool("svo-voxelize", mesh, "-o", folder / "p.svo", "--depth", 4, "--depfile", odd / "m.mtl", "--force")
    check(r.code == 1 and (odd / "m.mtl").read_bytes() == before and not (folder / "p.svo").exists(), r)
    check(tool("svo-voxelize", mesh, "-o", folder / "q.svo", "--depth", 4, "--depfile", dep).code == 2 and not (folder / "q.svo").exists())
    (folder / "c.xyz").write_text("0 0 0\n1 2 3\n")
    check(tool("svo-voxelize", folder / "c.xyz", "-o", folder / "q.svo", "--depth", 4, "--depfile", dep).code == 2 and not (folder / "q.svo").exists())
    r = tool("svo-voxelize", folder / "c.raw", "--raw", "2x1x1:u8", "-o", folder / "q.svo", "--depfile", dep) if (folder / "c.raw").write_bytes(b"\1\1") else None
    check(r.code == 2 and "exists" in r.err and not (folder / "q.svo").exists(), r)
    run("svo-voxelize", mesh, "-o", out, "--depth", 4, "-MD", "--force")
    beside = out.parent / (out.name + ".d")
    check(beside.read_bytes() == dep.read_bytes(), "-MD writes the same rule beside the output")
    check(tool("svo-voxelize", mesh, "-o", out, "--depth", 4, "-MX", "--force").code == 1)
    check(tool("svo-voxelize", mesh, "-o", out, "--depth", 4, "-MD", "--depfile", dep, "--force").code == 1)
    check(tool("svo-voxelize", mesh, "-o", "-", "--depth", 4, "-MD").code == 1)
    check(tool("svo-voxelize", mesh, "-o", "-", "--depth", 4, "--depfile", dep, "--force").code == 1)


def test_ninja_rebuilds_what_changed(folder):
    ninja = program("ninja")
    mesh = textured(folder)
    (folder / "build.ninja").write_text(
        "rule voxelize\n  command = %s $in -o $out --depth 5 --depfile $out.d --force\n  depfile = $out.d\n  deps = gcc\nbuild m.svo: voxelize m.obj\n"
        % shlex.quote(str(tools / "svo-voxelize")).replace("$", "$$"))
    in_folder([ninja], folder)
    old = (folder / "m.svo").read_bytes()
    check("no work to do" in in_folder([ninja], folder))
    time.sleep(0.02)
    support.write_png(folder / "look.png", 4, 4, lambda x, y: (200, y * 60, 10))
    check("no work to do" not in in_folder([ninja], folder), "a texture has changed")
    check((folder / "m.svo").read_bytes() != old)
    check("no work to do" in in_folder([ninja], folder))


def test_make_reads_the_depfile(folder):
    make = program("make")
    mesh = textured(folder)
    (folder / "Makefile").write_text("m.svo: m.obj\n\t%s m.obj -o m.svo --depth 5 --depfile m.d --force\n-include m.d\n" % (tools / "svo-voxelize"))
    in_folder([make], folder)
    check("up to date" in in_folder([make], folder))
    later = (folder / "m.svo").stat().st_mtime + 5
    os.utime(folder / "look.png", (later, later))
    check("svo-voxelize" in in_folder([make], folder), "a texture has changed")


def script(name):
    path = source / "docs" / name
    check(os.access(path, os.X_OK), "%s cannot be run" % path)
    return path


def test_gnu_parallel(folder):
    parallel = program("parallel")
    mesh = bumpy(folder / "bumpy.obj")
    run("svo-voxelize", mesh, "-o", folder / "one.svo", "--depth", 9)
    in_folder([parallel, "-j", "2", "svo-voxelize", "bumpy.obj", "--depth", "9", "--shard", "{}/5", "-o", "p-{}.svo", ":::"] + [str(i) for i in range(1, 6)],
              folder, env=with_tools())
    check(merged(folder, sorted(folder.glob("p-*.svo"))) == (folder / "one.svo").read_bytes())
    # the script of the documentation; and again: what is there is not made again
    in_folder([script("voxelize_shards.sh"), "5", "m.svo", "bumpy.obj", "--depth", "9"], folder, env=with_tools(JOBS="2"))
    check((folder / "m.svo").read_bytes() == (folder / "one.svo").read_bytes())


def test_slurm_job_array(folder):
    mesh = bumpy(folder / "bumpy.obj")
    run("svo-voxelize", mesh, "-o", folder / "one.svo", "--depth", 9)
    one = (folder / "one.svo").read_bytes()
    slurm = Slurm(folder / "slurm")
    try:
        slurm.skip_unless_idle()
        # the script and the two lines of the documentation
        job = in_folder(["sbatch", "--parsable", "--array=1-4", script("shard.sbatch"), "4", "parts", "bumpy.obj", "--depth", "9"], folder, env=slurm.env).strip()
        in_folder(["sbatch", "--dependency=afterok:" + job, "--wrap", "ls parts/*.svo | svo-merge --list - -o script.svo"], folder, env=slurm.env)
        # the array's own numbers, from 0 in steps of 2
        job = in_folder(["sbatch", "--parsable", "--array=0-4:2", "--wrap", "svo-voxelize bumpy.obj --depth 9 --shard auto -o auto-$SLURM_ARRAY_TASK_ID.svo"],
                        folder, env=slurm.env).strip()
        in_folder(["sbatch", "--dependency=afterok:" + job, "--wrap", "svo-merge auto-*.svo -o auto.svo"], folder, env=slurm.env)
        slurm.wait_for_jobs(50)
    finally:
        slurm.close()
    talk = "".join(p.read_text(errors="replace") for p in sorted(folder.glob("slurm-*.out")))
    check(len(list((folder / "parts").glob("*.svo"))) == 4 and len(list(folder.glob("auto-*.svo"))) == 3, talk)
    for name in ("script.svo", "auto.svo"):
        check((folder / name).exists() and (folder / name).read_bytes() == one, name + ": " + talk)


support.main(globals())
