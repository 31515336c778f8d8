"""Error against run time of svo-skeleton for its method, ball search and omega: CSV and SVG. Standard library only.

    python3 tests/bench/skeleton_methods.py build/tools OUT.csv OUT.svg MODEL... [omega=0.015,0.025,0.05]

Time is the user CPU time of the whole process with one thread (other work on the machine changes it less than wall time), the lower of two runs; error is the mean distance of
the surface from the inscribed balls around the curve, percent of the diagonal (errors.inscribed_balls_mean of the report)."""

import csv
import json
import math
import pathlib
import resource
import subprocess
import sys
import tempfile

METHODS = [(m, s) for m in ("fast", "literal") for s in ("flann", "grid")]
COLORS = {("fast", "flann"): "#1f77b4", ("fast", "grid"): "#2ca02c", ("literal", "flann"): "#d62728", ("literal", "grid"): "#ff7f0e"}


def measure(tools, model, omega, method, search):
    best = None
    with tempfile.TemporaryDirectory() as folder:
        out = pathlib.Path(folder)
        command = [tools / "svo-skeleton", model, "-o", out / "m.skel", "-f", "-q", "--omega", str(omega), "--method", method, "--search", search, "--threads", "1", "--report", out / "r.json"]
        for _ in range(2):
            before = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
            subprocess.run(command, check=True)
            used = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - before
            best = used if best is None or used < best else best
        report = json.loads((out / "r.json").read_text())
        size = (out / "m.skel").read_bytes()
    r, e = report["output"], report["errors"]
    contract = next(p["seconds"] for p in report["phases"] if p["name"] == "contract")
    return {"model": model.name, "omega": omega, "method": method, "search": search, "user_s": round(best, 4), "contract_wall_s": round(contract, 4),
            "vertices": report["input"]["vertices_tessellated"], "sweeps": r["iterations"], "converged": int(r["converged"]), "joints": r["joints"], "ends": r["ends"],
            "branches": r["branches"], "loops": r["loops"], "inside_percent": round(e["length_inside_percent"], 3), "balls_mean_percent": round(e["inscribed_balls_mean"], 4),
            "reconstruction_mean_percent": round(e["reconstruction_mean"], 4), "peak_rss_bytes": report["peak_rss_bytes"], "skel_bytes": len(size)}


def plot(rows, path):
    models = list(dict.fromkeys(r["model"] for r in rows))
    wide, high, left, top = 360, 260, 60, 40
    xs = [math.log10(max(r["user_s"], 1e-3)) for r in rows]
    x0, x1 = math.floor(min(xs) * 2) / 2, math.ceil(max(xs) * 2) / 2
    y1 = 1.1 * max(r["balls_mean_percent"] for r in rows)
    out = ['<svg xmlns="http://www.w3.org/2000/svg" width="%d" height="%d" font-family="sans-serif" font-size="11">' % ((wide + left) * len(models) + 20, high + top + 70),
           '<rect width="100%" height="100%" fill="white"/>']
    for i, model in enumerate(models):
        ox = left + i * (wide + left)
        px = lambda v: ox + (v - x0) / (x1 - x0) * wide
        py = lambda v: top + high * (1 - v / y1)
        out.append('<text x="%d" y="20" font-size="13">%s</text><rect x="%d" y="%d" width="%d" height="%d" fill="none" stroke="#888"/>' % (ox, model, ox, top, wide, high))
        for t in range(math.ceil(x0), math.floor(x1) + 1):
            out.append('<path d="M%.1f %d v%d" stroke="#ddd"/><text x="%.1f" y="%d" text-anchor="middle">%g</text>' % (px(t), top, high, px(t), top + high + 15, 10.0**t))
        for k in range(5):
            v = y1 * k / 4
            out.append('<text x="%d" y="%.1f" text-anchor="end">%.2g</text>' % (ox - 5, py(v) + 4, v))
        out.append('<text x="%.1f" y="%d" text-anchor="middle">user CPU seconds</text>' % (ox + wide / 2, top + high + 32))
        for key in METHODS:
            line = [(px(math.log10(max(r["user_s"], 1e-3))), py(r["balls_mean_percent"]), r["omega"]) for r in rows if r["model"] == model and (r["method"], r["search"]) == key]
            out.append('<polyline points="%s" fill="none" stroke="%s"/>' % (" ".join("%.1f,%.1f" % p[:2] for p in line), COLORS[key]))
            out += ['<circle cx="%.1f" cy="%.1f" r="3.5" fill="%s"/><text x="%.1f" y="%.1f" font-size="9">%g</text>' % (x, y, COLORS[key], x + 5, y - 4, w) for x, y, w in line]
    out.append('<text x="12" y="%d" transform="rotate(-90 12 %d)" text-anchor="middle">surface to inscribed balls, mean, %% of the diagonal</text>' % (top + high / 2, top + high / 2))
    for i, key in enumerate(METHODS):
        out.append('<circle cx="%d" cy="%d" r="4" fill="%s"/><text x="%d" y="%d">%s, %s</text>' % (left + 130 * i, top + high + 52, COLORS[key], left + 130 * i + 8, top + high + 56, *key))
    path.write_text("\n".join(out) + "\n</svg>\n")


def main():
    tools, table, picture = (pathlib.Path(a) for a in sys.argv[1:4])
    models = [pathlib.Path(a) for a in sys.argv[4:] if not a.startswith("omega=")]
    omegas = [[float(x) for x in a[6:].split(",")] for a in sys.argv[4:] if a.startswith("omega=")] or [[0.015, 0.025, 0.05]]
    rows = [measure(tools.resolve(), m, w, *how) for m in models for how in METHODS for w in omegas[0]]
    with open(table, "w", newline="") as f:
        writer = csv.DictWriter(f, rows[0].keys(), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
    plot(rows, picture)


if __name__ == "__main__":
    sys.exit(main())
