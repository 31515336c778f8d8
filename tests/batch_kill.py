#!/usr/bin/env python3
"""A night's batch, disturbed: hundreds of models with damaged ones among them through svo-build, killed at random moments and resumed.

    tests/batch_kill.py TOOLS [--models FOLDER...] [--count N] [--kills N] [--jobs N] [--memory SIZE] [--depth D] [--seed N] [--work FOLDER]

Models are drawn from the folders (default: SVOKIT_MODELS and Debian's assimp-testmodels). One in six is copied and damaged (cut off, bytes changed, emptied), and some inputs
are missing. The manifest is built once undisturbed, then again into another folder while svo-build itself (kill -9, --kills times) and single steps of it are killed, and
resumed until it ends by itself. Then:
  - every output has the bytes of the undisturbed run, and there is no other file: no temporary file beside the outputs, in the state folder or in TMPDIR;
  - the same assets failed, with the same exit codes; what damage causes is "bad input", missing files are "bad luck", and no step died by a signal of its own making;
  - outputs that were there after a kill were whole;
  - memory: the sum of the resident memory of all steps, sampled, stayed within --memory; so did each step (its own report).
Prints figures, and the exit status is 1 where something of this does not hold. Python 3 standard library only."""

import argparse
import collections
import json
import os
import pathlib
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time

ENDINGS = {".obj", ".ply", ".stl", ".off", ".glb", ".gltf", ".drc", ".vox", ".binvox", ".nrrd"}
UNITS = {"K": 1 << 10, "M": 1 << 20, "G": 1 << 30}


def size(text):
    return int(float(text[:-1]) * UNITS[text[-1]]) if text[-1] in UNITS else int(text)


class Watch(threading.Thread):
    """Resident memory of the children of a process, summed, as often as the machine allows; and, when told, a kill of one of them."""

    def __init__(self, pid, rng=None, share=0.0):
        super().__init__(daemon=True)
        self.pid, self.rng, self.share, self.hit = pid, rng, share, set()
        self.peak = self.samples = self.killed = self.most = 0
        self.start()

    def kill(self, child):
        """A step's tool, at most once a step: the last try of a step that must fail is not to fail by this."""
        try:
            output = [w for w in open("/proc/%s/cmdline" % child).read().split("\0") if w.startswith("--output=")]
            if output and output[0] not in self.hit:
                self.hit.add(output[0])
                os.kill(int(child), signal.SIGKILL)
                self.killed += 1
        except OSError: # it has ended
            pass

    def run(self):
        page = os.sysconf("SC_PAGE_SIZE")
        seen = set()
        while True:
            try:
                children = open("/proc/%d/task/%d/children" % (self.pid, self.pid)).read().split()
            except OSError:
                return
            total = 0
            for c in children:
                try:
                    total += int(open("/proc/%s/statm" % c).read().split()[1]) * page
                except (OSError, IndexError):
                    continue
                if c not in seen and self.rng is not None:
                    seen.add(c)
                    if self.rng.random() < self.share:
                        self.kill(c)
            self.peak, self.samples, self.most = max(self.peak, total), self.samples + 1, max(self.most, len(children))
            time.sleep(0.002)


def damage(path, to, rng):
    data = bytearray(path.read_bytes())
    kind = rng.choice(("cut", "cut", "bytes", "empty"))
    if kind == "cut":
        del data[rng.randrange(len(data)):]
    elif kind == "bytes":
        for _ in range(1 + len(data) // 200):
            data[rng.randrange(len(data))] = rng.randrange(256)
    else:
        data.clear()
    to.write_bytes(bytes(data))
    return kind


def draw(folders, count, largest, rng, work):
    files = sorted(p for f in folders for p in pathlib.Path(f).rglob("*") if p.suffix.lower() in ENDINGS and p.is_file() and p.stat().st_size <= largest)
    rng.shuffle(files)
    assets, kinds = [], {}
    (work / "damaged").mkdir()
    for i, p in enumerate(files[:count]):
        name, source = "m%04d" % i, p
        kinds[name] = "as it is"
        if i % 6 == 5 and p.stat().st_size:
            source = work / "damaged" / (name + p.suffix.lower())
            kinds[name] = "damaged: " + damage(p, source, rng)
        elif i % 40 == 20:
            source = work / (name + ".ply")
            kinds[name] = "missing"
        asset = {"name": name, "input": str(source.resolve())}
        if i % 7 == 3:
            asset["voxelize"] = {"fill": "solid"}
        if i % 5 == 4:
            asset["compress"] = {"geometry": rng.choice(("fast", "symmetric", "svdag")), "color": "deltaE=2"}
        assets.append(asset)
    return assets, kinds


def outputs(folder):
    return {str(p.relative_to(folder)): p for p in folder.rglob("*") if p.is_file()}


class Batch:
    def __init__(self, o, work):
        self.o, self.work, self.faults, self.peaks, self.most = o, work, [], [], 0
        self.temp = work / "tmp"
        self.temp.mkdir()

    def fault(self, text):
        self.faults.append(text)
        print("FAULT:", text)

    def manifest(self, out, assets):
        path = self.work / (out + ".json")
        path.write_text(json.dumps({"output": out, "defaults": {"voxelize": {"depth": self.o.depth}, "compress": {"color": "deltaE=1"}}, "assets": assets}))
        return path

    def start(self, path, retries=1):
        return subprocess.Popen([str(self.o.tools / "svo-build"), str(path), "-q", "-j", str(self.o.jobs), "--memory", self.o.memory, "--retries", str(retries)],
                                stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=dict(os.environ, TMPDIR=str(self.temp)))

    def finish(self, path, retries=1, **watch):
        p = self.start(path, retries)
        w = Watch(p.pid, **watch)
        out, err = p.communicate()
        w.join()
        self.peaks.append(w.peak)
        self.most = max(self.most, w.most)
        return p.returncode, [json.loads(l) for l in out.decode().splitlines()], err.decode(), w


def failures(lines):
    return {l["asset"]: l for l in lines if l["state"] == "failed"}


def judge(b, lines, kinds):
    """What is said of each asset."""
    failed = failures(lines)
    for name, l in failed.items():
        code = l.get("exit_code")
        if code is None:
            b.fault("%s (%s) died by signal %s" % (name, kinds[name], l.get("signal")))
        elif kinds[name] == "missing" and (code, l["because"]) != (2, "bad luck"):
            b.fault("%s is missing, but: %s" % (name, l))
        elif code == 2 and kinds[name] != "missing" and "No such file" not in l.get("message", ""): # .gltf and .obj name files that may be missing
            b.fault("%s (%s) is called bad luck: %s" % (name, kinds[name], l))
        elif code in (1, 3, 5, 6) and l["because"] != "bad input" or code not in (1, 2, 3, 5, 6):
            b.fault("%s (%s): %s" % (name, kinds[name], l))
        if not l.get("message"):
            b.fault("%s failed without a message" % name)
    for name, kind in kinds.items():
        if kind in ("missing", "damaged: empty") and name not in failed:
            b.fault("%s is %s, but nothing failed" % (name, kind))
    return failed


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("tools", type=pathlib.Path)
    parser.add_argument("--models", nargs="*", default=[f for f in (os.environ.get("SVOKIT_MODELS"), "/usr/share/assimp/models", "/usr/share/assimp/models-nonbsd") if f and os.path.isdir(f)])
    parser.add_argument("--count", type=int, default=300)
    parser.add_argument("--kills", type=int, default=12)
    parser.add_argument("--jobs", type=int, default=4)
    parser.add_argument("--memory", default="1G")
    parser.add_argument("--depth", type=int, default=7)
    parser.add_argument("--largest", type=size, default=size("8M"), help="largest model file that is drawn")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--work", type=pathlib.Path)
    o = parser.parse_args()
    o.tools = o.tools.resolve()
    work = o.work or pathlib.Path(tempfile.mkdtemp(prefix="svokit-batch-"))
    work.mkdir(exist_ok=True)
    rng = random.Random(o.seed)
    b = Batch(o, work)
    assets, kinds = draw(o.models, o.count, o.largest, rng, work)
    print("%d models: %s" % (len(assets), ", ".join("%d %s" % (n, k) for k, n in sorted(collections.Counter(kinds.values()).items()))))

    begin = time.monotonic()
    code, plain, err, _ = b.finish(b.manifest("plain", assets))
    whole = time.monotonic() - begin
    failed = judge(b, plain, kinds)
    wanted = {n: p.read_bytes() for n, p in outputs(work / "plain").items() if not n.startswith(".svo-build")}
    if code != (4 if any(l["because"] == "bad luck" for l in failed.values()) else 3 if failed else 0):
        b.fault("exit code %d of the undisturbed run: %s" % (code, err[-300:]))
    print("undisturbed: %.0f s, exit code %d, %d outputs, failed by bad input %d, by bad luck %d" % (
        whole, code, len(wanted), sum(l["because"] == "bad input" for l in failed.values()), sum(l["because"] == "bad luck" for l in failed.values())))

    path, kills, left = b.manifest("killed", assets), 0, 0
    for _ in range(o.kills):
        p = b.start(path)
        time.sleep(rng.uniform(0.05, 1.6 * whole / o.kills))
        p.send_signal(signal.SIGKILL)
        p.communicate()
        kills += p.returncode == -signal.SIGKILL
        deadline = time.monotonic() + 10 # steps die with it, but not before their next chance
        for n, f in outputs(work / "killed").items():
            if ".svokit-part-" in n:
                left += 1
            elif not n.startswith(".svo-build") and f.read_bytes() != wanted.get(n):
                b.fault("after a kill %s is not whole" % n)
        while time.monotonic() < deadline: # the lock goes with the last of them
            probe = subprocess.run([str(o.tools / "svo-build"), str(path), "-q", "-n"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
            if probe.returncode != 2:
                break
            time.sleep(0.02)
    print("killed %d times; %d temporary files were left by that" % (kills, left))
    code, lines, err, w = b.finish(path, retries=20, rng=rng, share=0.2)
    states = collections.Counter(l["state"] for l in lines)
    again = sum(l.get("tries", 1) > 1 for l in lines)
    print("resumed: exit code %d, %s; %d steps killed meanwhile, %d tried again" % (code, dict(states), w.killed, again))
    if w.killed and not again:
        b.fault("steps were killed, but none was tried again")
    now = judge(b, lines, kinds)
    if {n: l["exit_code"] for n, l in now.items()} != {n: l["exit_code"] for n, l in failed.items()}:
        b.fault("other assets failed: %s" % sorted(set(now) ^ set(failed)))
    got = outputs(work / "killed")
    for n in sorted(set(wanted) | {n for n in got if not n.startswith(".svo-build")}):
        if n not in got or n not in wanted:
            b.fault("%s is %s" % (n, "missing" if n not in got else "too much"))
        elif got[n].read_bytes() != wanted[n]:
            b.fault("%s has other bytes" % n)
    for n in got:
        if ".svokit-part-" in n:
            b.fault("left behind: %s" % n)
    if set(outputs(work / "killed" / ".svo-build")) != set(outputs(work / "plain" / ".svo-build")):
        b.fault("other files in the state folder: %s" % sorted(set(outputs(work / "killed" / ".svo-build")) ^ set(outputs(work / "plain" / ".svo-build")))[:5])
    if os.listdir(b.temp):
        b.fault("left in TMPDIR: %s" % os.listdir(b.temp)[:5])
    code, lines, err, _ = b.finish(path)
    if any(l["state"] not in ("current", "failed", "skipped") for l in lines):
        b.fault("a second run finds something out of date")

    budget = size(o.memory)
    peak_of_one = max((l["peak_rss_bytes"] for l in plain if l.get("peak_rss_bytes")), default=0)
    print("memory: %s for up to %d steps at a time; the sum of their resident memory was at most %.0f MiB, the largest step took %.0f MiB of its %.0f" % (
        o.memory, b.most, max(b.peaks) / 2 ** 20, peak_of_one / 2 ** 20, budget / o.jobs / 2 ** 20))
    if max(b.peaks) > budget:
        b.fault("more than --memory")
    if peak_of_one > budget / o.jobs:
        b.fault("a step took more than its share")
    print("outputs compared: %d, %d bytes" % (len(wanted), sum(map(len, wanted.values()))))
    if o.work is None and not b.faults:
        shutil.rmtree(work)
    elif b.faults:
        print("kept: %s" % work)
    print("%d faults" % len(b.faults))
    return 1 if b.faults else 0


if __name__ == "__main__":
    sys.exit(main())
