#!/usr/bin/env python3
"""Where the bytes and the time went: summarize.py OUT reads OUT/reports/*.json and the files of a demo run, writes
OUT/report.json (all reports in one) and OUT/summary.txt, and prints the latter."""

import json
import pathlib
import sys


def human(n):
    for unit in ("B", "KiB", "MiB", "GiB"):
        if n < 1024 or unit == "GiB":
            return "%d B" % n if unit == "B" else "%.1f %s" % (n, unit)
        n /= 1024


def table(rows, head):
    rows = [head] + [[str(c) for c in r] for r in rows]
    widths = [max(len(r[i]) for r in rows) for i in range(len(head))]
    lines = ["  ".join(c.ljust(w) if i == 0 else c.rjust(w) for i, (c, w) in enumerate(zip(r, widths))).rstrip() for r in rows]
    return [lines[0], "-" * len(lines[0])] + lines[1:]


def main():
    out = pathlib.Path(sys.argv[1])
    steps = [json.loads(p.read_text()) for p in sorted((out / "reports").glob("*.json"))]
    files = {p.name: p.stat().st_size for p in sorted(out.iterdir()) if p.suffix in (".svo", ".svdag", ".skel", ".svscene", ".png", ".glb")}
    total = sum(s["wall_seconds"] for s in steps)
    lines = ["Where the time went", ""]
    rows = []
    for s in steps:
        rows.append([s["tool"], "%.2f s" % s["wall_seconds"], "%.0f %%" % (100 * s["wall_seconds"] / total if total else 0), human(s["peak_rss_bytes"])])
        rows += [["  " + p["name"], "%.2f s" % p["seconds"], "", ""] for p in s.get("phases", [])]
    rows.append(["all", "%.2f s" % total, "", ""])
    lines += table(rows, ["step", "time", "share", "peak memory"])
    lines += ["", "Where the bytes went", ""]
    lines += table([[name, human(size)] for name, size in files.items()], ["file", "size"])
    pack = next((s for s in steps if s["tool"] == "svo-pack"), None)
    if pack and "output" in pack:
        o = pack["output"]
        lines += ["", "scene.svscene: %d assets, %d instances, %d pages" % (o["assets"], o["instances"], o["pages"]), ""]
        lines += table([[k, human(v)] for k, v in o["bytes_by_part"].items()], ["part", "size"])
        lines += [""]
        lines += table([[a["name"], a["instances"], a.get("depth", ""), a.get("voxels", ""), human(a.get("bytes", 0)),
                         "%.2f" % (a["bytes"] / a["voxels"]) if a.get("voxels") and a.get("bytes") else ""] for a in o["asset_list"]],
                       ["asset", "instances", "depth", "voxels", "size", "bytes a voxel"])
        if o["left_out"]:
            lines += ["", "left out:"] + ["  %s %s: %s" % (x["what"], x.get("name", ""), human(x["bytes"])) for x in o["left_out"]]
    warnings = ["%s: %s" % (s["tool"], w if isinstance(w, str) else w.get("text", w)) for s in steps for w in s.get("warnings", [])]
    if warnings:
        lines += ["", "Warnings", ""] + ["  " + w for w in warnings]
    text = "\n".join(lines) + "\n"
    (out / "summary.txt").write_text(text)
    (out / "report.json").write_text(json.dumps({"seconds": total, "files": files, "steps": steps}, indent=1) + "\n")
    sys.stdout.write(text)


main()
