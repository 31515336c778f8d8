#!/usr/bin/env python3
"""Individually twisted instances of six assets at 1280x720: seconds of each stage against the number of instances and of those that are seen.

    python3 tests/bench/bench_twist.py TOOLS MODELS FOLDER [OUT.csv OUT.svg [COUNT ...]]

TOOLS: the folder of the built tools; MODELS: the folder of real models; FOLDER: where files go (0.5 GB for 10^6). Two views: `field`, over
the whole field, where what is seen grows with the number of instances until they hide each other; `street`, from inside it, where it does not."""
import csv, json, math, os, pathlib, random, subprocess, sys, time

MODELS = ["A_organic/bunny_closed/bunny_hr.obj", "A_organic/camel/camel.off", "A_organic/elephant/elephant.off", "A_organic/horse/horse.ply",
          "A_organic/human_neutral/human_neutral.obj", "A_organic/scorpion/scorpion.obj"]


METHODS = (os.environ.get("METHODS") or "direct,emit").split(",")  # "resize" takes several GB


def run(*command):
    subprocess.run([str(c) for c in command], check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def bounds(dump):
    """Centre and size of an asset: those of its grid."""
    m, n = dump["voxel_to_world"], 2 ** dump["depth"]
    return [m[4 * k + 3] + m[5 * k] * n / 2 for k in range(3)], m[0] * n


def make_scene(folder, count, boxes):
    rng = random.Random(7)
    side = math.ceil(math.sqrt(count))
    with open(folder / f"twist{count}.json", "w") as f:
        f.write('{"assets":[%s],"instances":[\n' % ",".join('{"name":"%d","file":"%d.svdag"}' % (i, i) for i in range(6)))
        for i in range(count):
            a = rng.randrange(6)
            centre, size = boxes[a]
            s = 1 / size
            x, z = (i % side) * 1.2, -(i // side) * 1.2
            f.write('%s{"asset":"%d","translation":[%.6g,%.6g,%.6g],"scale":[%.6g,%.6g,%.6g],"pose":{"twist":{"degrees":%.2f}}}' %
                    (",\n" if i else "", a, x - s * centre[0], 0.5 - s * centre[1], z - s * centre[2], s, s, s, rng.uniform(-180, 180)))
        f.write("]}\n")
    return folder / f"twist{count}.json", 1.2 * side


def main():
    tools, models, folder = (pathlib.Path(p) for p in sys.argv[1:4])
    out = sys.argv[4:6]
    counts = [int(c) for c in sys.argv[6:]] or [10 ** 4, 10 ** 5, 10 ** 6]
    folder.mkdir(parents=True, exist_ok=True)
    boxes = []
    for i, model in enumerate(MODELS):
        dag = folder / f"{i}.svdag"
        if not dag.exists():
            run(tools / "svo-voxelize", models / model, "-o", folder / "t.svo", "-f", "--depth", 8)
            run(tools / "svo-compress", folder / "t.svo", "-o", dag, "--normal", 16)
        boxes.append(bounds(json.loads(subprocess.check_output([tools / "svo-dump", dag, "--json"]))))
    rows = []
    for count in counts:
        scene = folder / f"twist{count}.svscene"
        side = 1.2 * math.ceil(math.sqrt(count))
        pack_report = folder / f"pack{count}.json"
        if not scene.exists():
            make_scene(folder, count, boxes)
            run(tools / "svo-pack", folder / f"twist{count}.json", "-o", scene, "--report", pack_report)
            (folder / f"twist{count}.json").unlink()
        pack = json.loads(pack_report.read_text())
        views = {"field": (f"{side / 2},{0.35 * side},{0.6 * side}", f"{side / 2},0,{-0.45 * side}"),
                 "street": (f"{side / 2 + 0.6},1.7,{-side / 2 + 0.6}", f"{side / 2 + 4},0.8,{-side / 2 - 8}")}
        for view, (eye, target) in views.items():
            for method in METHODS:
                report = folder / "render.json"
                began = time.time()
                run(tools / "svo-render", scene, "-o", folder / f"{view}-{method}-{count}.png", "-f", "--size", "1280x720", "--eye", eye, "--target", target,
                    "--fov", 50, "--no-shadows", "--resample", method, "--report", report)
                r = json.loads(report.read_text())
                d = r["deformation"]
                phases = {p["name"]: p["seconds"] for p in r["phases"]}
                rows.append({"instances": count, "view": view, "resample": method, "instances_seen": d["instances_seen"], "pages_seen": d["pages_seen"],
                             "nodes_visited": d["nodes_visited"], "selected": d["selected"], "samples": d.get("samples", 0), "cells": d.get("cells", 0),
                             "open": phases["open"], "select_deform": d["seconds_select"], "resample_seconds": d.get("seconds_resample", 0),
                             "attributes": d.get("seconds_attributes", 0), "sort": d.get("seconds_sort", 0), "build": d.get("seconds_hierarchy", 0),
                             "draw": phases["render"], "peak_rss_mb": r["peak_rss_bytes"] / 1e6, "pack_seconds": pack["wall_seconds"],
                             "bytes_per_instance": (pack["output"]["bytes_by_part"]["instances"] + pack["output"]["bytes_by_part"]["poses"]) / count})
                for k in rows[-1]:
                    if isinstance(rows[-1][k], float):
                        rows[-1][k] = float("%.4g" % rows[-1][k])
                print(rows[-1], file=sys.stderr, flush=True)
    if not out:
        return
    with open(out[0], "w", newline="") as f:
        w = csv.DictWriter(f, rows[0].keys(), lineterminator="\n")
        w.writeheader()
        w.writerows(rows)
    pathlib.Path(out[1]).write_text(plot(rows))


def plot(rows):
    """Seconds for a picture (selection to drawing, without opening the file) against instances, both logarithmic."""
    W, H, L, B = 640, 420, 70, 60
    counts = sorted({r["instances"] for r in rows})
    total = lambda r: r["select_deform"] + r["resample_seconds"] + r["attributes"] + r["sort"] + r["build"] + (r["draw"] - r["select_deform"] if r["resample"] == "direct" and r["draw"] > r["select_deform"] else r["draw"])
    ys = [total(r) for r in rows]
    y0, y1 = math.floor(math.log10(min(ys))), math.ceil(math.log10(max(ys)))
    x = lambda v: L + (math.log10(v) - math.log10(counts[0])) / max(1e-9, math.log10(counts[-1]) - math.log10(counts[0])) * (W - L - 170)
    y = lambda v: H - B - (math.log10(v) - y0) / (y1 - y0) * (H - B - 30)
    s = [f'<svg xmlns="http://www.w3.org/2000/svg" width="{W}" height="{H}" font-family="sans-serif" font-size="12">', f'<rect width="{W}" height="{H}" fill="white"/>']
    for e in range(y0, y1 + 1):
        s.append(f'<line x1="{L}" x2="{W - 170}" y1="{y(10 ** e):.1f}" y2="{y(10 ** e):.1f}" stroke="#ddd"/><text x="{L - 6}" y="{y(10 ** e) + 4:.1f}" text-anchor="end">{10 ** e:g} s</text>')
    for c in counts:
        s.append(f'<text x="{x(c):.1f}" y="{H - B + 18}" text-anchor="middle">{c}</text>')
    s.append(f'<text x="{(L + W - 170) / 2}" y="{H - 18}" text-anchor="middle">instances, each with a twist of its own; 1280 x 720</text>')
    colours = {"direct": "#1b6ca8", "resize": "#c0392b", "emit": "#2e8b57"}
    n = 0
    for view in ("field", "street"):
        for method, colour in colours.items():
            line = [(x(r["instances"]), y(total(r))) for r in rows if r["view"] == view and r["resample"] == method]
            dash = ' stroke-dasharray="5 4"' if view == "street" else ""
            s.append(f'<polyline fill="none" stroke="{colour}" stroke-width="2"{dash} points="{" ".join("%.1f,%.1f" % p for p in line)}"/>')
            s.append(f'<line x1="{W - 155}" x2="{W - 125}" y1="{50 + 20 * n}" y2="{50 + 20 * n}" stroke="{colour}" stroke-width="2"{dash}/><text x="{W - 118}" y="{54 + 20 * n}">{view}, {method}</text>')
            n += 1
    return "\n".join(s + ["</svg>", ""])


main()
