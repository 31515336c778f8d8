#!/usr/bin/env python3
"""A deep octree in bounded memory: svo-voxelize piped into svo-compress, with the operating system's account of it.

    tests/bench/depth16.py TOOLS MESH OUT [--depth 16] [--memory 4G] [--hours 1] [--estimate 10,11,12,13] [--attributes LIST]

First the depths of --estimate are run; from their last two follow voxels, bytes and seconds of the wanted depth (each level the ratio of the last). When that says
that the run does not fit in the time, it is not started (--force starts it). The memory is split between the two: a quarter for svo-voxelize, of which it holds the mesh and its
textures, a half for svo-compress, the rest for what tools hold besides. OUT.svdag, OUT.json and OUT.md are written. The peak is the largest sum of
both processes' resident memory, seen every 50 ms, and at least each one's own high-water mark. Exit status 0: done within both limits; 1: not; 3: not started."""

import argparse
import json
import os
import pathlib
import subprocess
import sys
import time


def size(text):
    return int(float(text.rstrip("KMGkmg")) * {"K": 1 << 10, "M": 1 << 20, "G": 1 << 30}.get(text[-1].upper(), 1))


def resident(pid):
    try:
        for line in open("/proc/%d/status" % pid):
            if line.startswith("VmRSS:"):
                return 1024 * int(line.split()[1])
    except OSError:
        pass
    return 0


def piped(o, depth, out, limit):
    """Runs both tools; a dict of what they took."""
    reports = [out.with_suffix(".%d.%s.json" % (depth, n)) for n in ("voxelize", "compress")]
    commands = [[o.tools + "/svo-voxelize", o.mesh, "-o", "-", "--depth", str(depth), "--attributes", o.attributes, "--reference", "0", "-q", "--report", str(reports[0]), "-f"],
                [o.tools + "/svo-compress", "-", "-o", str(out.with_suffix(".svdag")), "-q", "--report", str(reports[1]), "-f"]]
    if limit:
        commands[0] += ["--memory", str(limit // 4)]
        commands[1] += ["--memory", str(limit // 2)]
    start = time.monotonic()
    first = subprocess.Popen(commands[0], stdout=subprocess.PIPE)
    second = subprocess.Popen(commands[1], stdin=first.stdout)
    first.stdout.close()
    left, ended, peak = {first.pid: 0, second.pid: 1}, [None, None], 0
    while left:
        peak = max(peak, sum(resident(p) for p in left))
        for pid in list(left):
            done, status, usage = os.wait4(pid, os.WNOHANG)
            if done:
                ended[left.pop(pid)] = (os.waitstatus_to_exitcode(status), usage)
        time.sleep(0.05)
    first.returncode, second.returncode = ended[0][0], ended[1][0]
    seconds = time.monotonic() - start
    row = {"depth": depth, "seconds": seconds, "exit_codes": [e[0] for e in ended], "user_seconds": [e[1].ru_utime for e in ended],
           "peak_rss_bytes": [1024 * e[1].ru_maxrss for e in ended], "peak_rss_sum_bytes": max(peak, *(1024 * e[1].ru_maxrss for e in ended)),
           "commands": [" ".join([pathlib.Path(c[0]).name, pathlib.Path(c[1]).name] + [a for a in c[2:] if "/" not in a]) for c in commands]}
    if row["exit_codes"] == [0, 0]:
        v, c = (json.loads(r.read_text()) for r in reports)
        row.update(voxels=v["output"]["voxels"], svo_bytes=v["output"]["bytes"], svdag_bytes=c["output"]["bytes"], channels=[a["name"] for a in v["output"]["attributes"]])
    for r in reports:
        r.unlink(missing_ok=True)
    return row


def extrapolate(rows, depth):
    a, b = rows[-2:]
    levels = depth - b["depth"]
    return {k: b[k] * (b[k] / a[k]) ** levels for k in ("voxels", "svo_bytes", "svdag_bytes", "seconds", "peak_rss_sum_bytes") if a[k] > 0}


def markdown(data):
    lines = ["# %s at depth %d" % (data["mesh"], data["depth"]), "", "| depth | M voxels | .svo MB | .svdag MB | seconds | user s (voxelize, compress) | peak RSS MB (voxelize, compress, together) |",
             "|---|---|---|---|---|---|---|"]
    for r in data["rows"]:
        if "voxels" not in r:
            lines.append("| %d | exit codes %s | | | %.0f | | %.0f |" % (r["depth"], r["exit_codes"], r["seconds"], r["peak_rss_sum_bytes"] / 1e6))
            continue
        lines.append("| %d | %.1f | %.1f | %.1f | %.1f | %.1f, %.1f | %.0f, %.0f, %.0f |" % (
            r["depth"], r["voxels"] / 1e6, r["svo_bytes"] / 1e6, r["svdag_bytes"] / 1e6, r["seconds"], *r["user_seconds"], *(b / 1e6 for b in r["peak_rss_bytes"]), r["peak_rss_sum_bytes"] / 1e6))
    e = data.get("estimate")
    if e:
        lines += ["", "Estimate for depth %d from the last two smaller ones: %.0f M voxels, .svo %.2f GB, .svdag %.2f GB, %.0f s." % (
            data["depth"], e["voxels"] / 1e6, e["svo_bytes"] / 1e9, e["svdag_bytes"] / 1e9, e["seconds"])]
    lines += ["", "`%s`" % data["rows"][-1]["commands"][0], "`%s`" % data["rows"][-1]["commands"][1], "", data["verdict"]]
    return "\n".join(lines) + "\n"


def main():
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("tools"), p.add_argument("mesh"), p.add_argument("out")
    p.add_argument("--depth", type=int, default=16)
    p.add_argument("--memory", type=size, default="4G")
    p.add_argument("--hours", type=float, default=1)
    p.add_argument("--estimate", default="10,11,12,13")
    p.add_argument("--attributes", default="auto")
    p.add_argument("--force", action="store_true")
    o = p.parse_args()
    out = pathlib.Path(o.out)
    data = {"mesh": pathlib.Path(o.mesh).name, "depth": o.depth, "memory": o.memory, "hours": o.hours, "processors": os.cpu_count(), "rows": []}

    def save(verdict):
        data["verdict"] = verdict
        out.with_suffix(".json").write_text(json.dumps(data, indent=1) + "\n")
        out.with_suffix(".md").write_text(markdown(data))
        print(markdown(data), flush=True)

    for depth in [int(d) for d in o.estimate.split(",") if d]:
        data["rows"].append(piped(o, depth, out, o.memory))
        save("Estimating.")
        if data["rows"][-1]["exit_codes"] != [0, 0]:
            return save("A smaller depth already failed; not started.") or 3
    if len(data["rows"]) >= 2:
        data["estimate"] = extrapolate(data["rows"], o.depth)
        if data["estimate"]["seconds"] > 3600 * o.hours and not o.force:
            return save("The estimate is beyond %g hours; not started." % o.hours) or 3
    data["rows"].append(piped(o, o.depth, out, o.memory))
    r = data["rows"][-1]
    good = r["exit_codes"] == [0, 0] and r["peak_rss_sum_bytes"] <= o.memory and r["seconds"] <= 3600 * o.hours
    save("Done within %g hours and %.1f GB." % (o.hours, o.memory / 1e9) if good else "NOT done within %g hours and %.1f GB." % (o.hours, o.memory / 1e9))
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
