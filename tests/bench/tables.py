#!/usr/bin/env python3
"""Tables 2.1 to 2.5 and figure 2.6 of Dado et al. 2016 for our scenes, from what bench_tables prints.

    tables.py TOOLS BENCH_TABLES OUT.csv OUT.svg FIRST..LAST     in SVOKIT_MODELS: voxelizes, packs and measures four scenes at these depths
    tables.py --plot OUT.csv OUT.svg                             only draws and prints the tables
"""
import csv
import os
import subprocess
import sys
import tempfile

SCENES = {"building": "C_textured/sample_building/samplebuilding.gltf", "city": "C_textured/virtual_city/VC.gltf",
          "foliage": "C_textured/oak_tree/oaktree.gltf", "scan": "C_textured/sterngarten_wien/Sterngarten_Wien_innerArea.obj"}
LINES = (("svo", "SVO", "#888"), ("psvo", "PSVO", "#b80"), ("cdag", "CDAG", "#36c"), ("dado", "Dado et al.", "#292"), ("best", "ours, 12 bits", "#c22"),
         ("best_de3", "ours, delta E 3", "#e6c"))


def measure(tools, bench, out, depths):
    first, last = (int(x) for x in depths.split(".."))
    models = os.environ["SVOKIT_MODELS"]
    with tempfile.TemporaryDirectory() as folder, open(out, "w") as to:
        print("model,depth,quantity,value", file=to)
        for depth in range(first, last + 1):
            for name, path in SCENES.items():
                svo, dag = os.path.join(folder, "a.svo"), os.path.join(folder, name + ".svdag")
                subprocess.run([tools + "/svo-voxelize", os.path.join(models, path), "-o", svo, "--depth", str(depth), "--attributes", "color", "-q", "-f"], check=True)
                subprocess.run([tools + "/svo-compress", svo, "-o", dag, "--geometry", "svdag", "--lod", "stored", "-q", "-f"], check=True)
                lines = subprocess.run([bench, dag], check=True, capture_output=True, text=True).stdout.splitlines()
                to.write("\n".join(lines[1:]) + "\n")


def read(path):
    data = {}
    with open(path, newline="") as f:
        for r in csv.DictReader(f):
            data.setdefault((r["model"], int(r["depth"])), {})[r["quantity"]] = float(r["value"])
    return data


def table(title, data, depth, rows):
    names = [n for n in SCENES if (n, depth) in data]
    print("\n**%s** (depth %d)\n\n| | %s |\n|---|%s" % (title, depth, " | ".join(names), "---|" * len(names)))
    for label, f in rows:
        cells = []
        for n in names:
            try:
                cells.append(f(data[n, depth]))
            except KeyError:
                cells.append("-")
        print("| %s | %s |" % (label, " | ".join(cells)))


def mb(key):
    return lambda d: "%.2f" % (d[key] / 1e6)


def node(key):
    return lambda d: "%.3f" % (d[key] / d["attributes"])


def rate(key, whole):
    return lambda d: "%.1f %%" % (100 * d[key] / d[whole])


def print_tables(data):
    depth = max(d for d in {d for _, d in data} if sum((n, d) in data for n in SCENES) == len(SCENES))
    table("2.1: decoupling and palettes, MB", data, depth, (
        ("nodes, millions", mb("attributes")), ("distinct colours, millions", lambda d: "%.3f" % (d["distinct"] / 1e6)), ("DAG", mb("dag")), ("with offsets", mb("dag_offsets")), ("A: 24 bits", mb("array")), ("indices and table", mb("array_indices")),
        ("Algorithm 1", mb("pc24")), ("of A", rate("pc24", "array")), ("ours, lossless, with geometry", mb("fast_lossless"))))
    table("2.2: colours by number, MB and CIE94", data, depth, (
        ("14 bits, Algorithm 1", mb("pc14")), ("mean, max", lambda d: "%.2f, %.2f" % (d["pc14_mean"], d["pc14_max"])), ("12 bits, Algorithm 1", mb("pc12")),
        ("mean, max", lambda d: "%.2f, %.2f" % (d["pc12_mean"], d["pc12_max"])), ("of A", rate("pc12", "array")),
        ("12 bits, ours", lambda d: "%.2f" % ((d["best"] - d["best_geometry"]) / 1e6)), ("delta E 3, ours", lambda d: "%.2f" % ((d["best_de3"] - d["best_de3_geometry"]) / 1e6)),
        ("mean, max", lambda d: "%.2f, %.2f" % (d["best_de3_mean"], d["best_de3_max"]))))
    table("2.3: geometry with offsets, MB", data, depth, (
        ("uncompressed", mb("dag_offsets")), ("first offset implicit", mb("dag_implicit")), ("offsets of whole bytes", mb("dag_offset_bytes")), ("pointers of whole bytes", mb("dag_pointer_bytes")),
        ("8-bit masks", mb("dag_mask_bytes")), ("pointers by frequency", mb("dag_entropy")), ("combined", mb("dag_combined")), ("of uncompressed", rate("dag_combined", "dag_offsets")),
        ("ours, fast", mb("fast_geometry")), ("ours, best", mb("best_geometry")), ("best, of combined", rate("best_geometry", "dag_combined"))))
    table("2.4: bytes a node, 12-bit colours", data, depth, (
        ("SVO", node("svo")), ("PSVO", node("psvo")), ("CDAG", node("cdag")), ("Dado et al.", node("dado")), ("ours, fast", node("fast")), ("ours, best", node("best")),
        ("ours, best, delta E 3", node("best_de3")), ("ours, lossless", node("fast_lossless")), ("best, of Dado et al.", rate("best", "dado")), ("delta E 3, of Dado et al.", rate("best_de3", "dado"))))
    table("2.5: seconds of CPU, 12-bit colours", data, depth, (
        ("coloured DAG", lambda d: "%.2f" % d["cdag_cpu_s"]), ("Algorithm 1 alone", lambda d: "%.2f" % d["pc12_cpu_s"]), ("ours, fast", lambda d: "%.2f" % d["fast_cpu_s"]),
        ("million nodes a second, fast", lambda d: "%.1f" % (d["attributes"] / 1e6 / d["fast_cpu_s"])), ("the same, lossless", lambda d: "%.1f" % (d["attributes"] / 1e6 / d["fast_lossless_cpu_s"]))))


def plot(data, out):
    import math
    names = [n for n in SCENES if any(m == n for m, _ in data)]
    depths = sorted({d for _, d in data})
    width, height, left, top = 250, 240, 50, 30
    values = [d[k] / d["attributes"] for d in data.values() for k, _, _ in LINES if k in d]
    low, high = math.floor(math.log2(min(values))), math.ceil(math.log2(max(values)))
    s = ['<svg xmlns="http://www.w3.org/2000/svg" width="%d" height="%d" font-family="sans-serif" font-size="11">' % (left + width * len(names) + 20, height + top + 75), '<rect width="100%" height="100%" fill="white"/>']

    def y(v):
        return top + height * (high - math.log2(v)) / (high - low)

    for i, n in enumerate(names):
        x0, w = left + i * width, width - 30
        s.append('<text x="%d" y="%d" font-size="13">%s</text>' % (x0, top - 10, n))
        for e in range(low, high + 1):
            s.append('<line x1="%d" x2="%d" y1="%.1f" y2="%.1f" stroke="#ddd"/>' % (x0, x0 + w, y(2.0**e), y(2.0**e)))
            if i == 0:
                s.append('<text x="%d" y="%.1f" text-anchor="end">%g</text>' % (x0 - 5, y(2.0**e) + 4, 2.0**e))

        def x(d):
            return x0 + w * (d - depths[0] + 0.2) / (depths[-1] - depths[0] + 0.4)

        for d in depths:
            s.append('<text x="%.1f" y="%d" text-anchor="middle">%d</text>' % (x(d), top + height + 16, d))
        for key, _, color in LINES:
            points = [(x(d), y(data[n, d][key] / data[n, d]["attributes"])) for d in depths if key in data.get((n, d), {})]
            s.append('<polyline fill="none" stroke="%s" stroke-width="1.8" points="%s"/>' % (color, " ".join("%.1f,%.1f" % p for p in points)))
            s += ['<circle cx="%.1f" cy="%.1f" r="2.5" fill="%s"/>' % (*p, color) for p in points]
    for i, (_, label, color) in enumerate(LINES):
        s.append('<line x1="%d" x2="%d" y1="%d" y2="%d" stroke="%s" stroke-width="2"/><text x="%d" y="%d">%s</text>' % (left + i * 150, left + 20 + i * 150, top + height + 50, top + height + 50, color, left + 26 + i * 150, top + height + 54, label))
    s.append('<text x="%d" y="%d">bytes a node (all octree nodes) by depth</text></svg>' % (left, top + height + 34))
    with open(out, "w") as f:
        f.write("\n".join(s) + "\n")


def main(args):
    if len(args) == 5:
        measure(args[0], args[1], args[2], args[4])
        args = ["--plot", args[2], args[3]]
    if len(args) != 3 or args[0] != "--plot":
        sys.exit(__doc__)
    data = read(args[1])
    plot(data, args[2])
    print_tables(data)


main(sys.argv[1:])
