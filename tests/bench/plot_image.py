#!/usr/bin/env python3
"""Error of pictures over seconds and over bytes as a plot:  plot_image.py IN.csv OUT.svg   (IN.csv as bench_image or bench_poses prints it)

Left: root mean square difference of light against seconds, a line for each number of samples and kernel at delta 1, a point for each depth. Right: the same against bytes of the file,
a line for each delta, 4 x 4 samples. Of what bench_poses prints: light against seconds, a panel for each pose, a line for each way of resampling at delta 1. Logarithmic axes."""
import csv
import math
import sys

rows = list(csv.DictReader(open(sys.argv[1])))
W, H, PAD = 470, 380, 60
COLORS = ("#c0392b", "#2c6fbb", "#1e8449", "#8e44ad")


def span(values):
    return min(values) * 0.85, max(values) * 1.18


def panel(x0, key, label, groups):
    """groups: list of (name, colour, dashes, rows)"""
    every = [r for g in groups for r in g[3]]
    low, high = span([float(r[key]) for r in every])
    bottom, top = span([float(r["rms_light"]) for r in every])
    px = lambda v: PAD + math.log(v / low) / math.log(high / low) * (W - PAD - 12)
    py = lambda v: H - PAD - math.log(v / bottom) / math.log(top / bottom) * (H - PAD - 12)
    out = ['<g transform="translate(%d,10)">' % x0]
    for axis, (a, b) in (("x", (low, high)), ("y", (bottom, top))):
        for e in range(math.floor(math.log10(a)), math.ceil(math.log10(b)) + 1):
            for m in (1, 2, 5):
                v = m * 10.0 ** e
                if not a <= v <= b:
                    continue
                if axis == "x":
                    out.append('<path d="M%.1f 12V%d" stroke="#eee"/><text x="%.1f" y="%d" text-anchor="middle">%g</text>' % (px(v), H - PAD, px(v), H - PAD + 16, v))
                else:
                    out.append('<path d="M%d %.1fH%d" stroke="#ddd"/><text x="%d" y="%.1f" text-anchor="end">%g</text>' % (PAD, py(v), W - 12, PAD - 6, py(v) + 4, v))
    out.append('<text x="%d" y="%d" text-anchor="middle">%s</text>' % ((W + PAD) / 2, H - PAD + 36, label))
    out.append('<text transform="translate(14,%d) rotate(-90)" text-anchor="middle">RMS difference of linear light</text>' % (H / 2))
    for i, (name, color, dashes, group) in enumerate(groups):
        p = sorted((int(r["depth"]), px(float(r[key])), py(float(r["rms_light"]))) for r in group)
        out.append('<path d="M%s" fill="none" stroke="%s" stroke-width="1.6"%s/>' % ("L".join("%.1f %.1f" % q[1:] for q in p), color, ' stroke-dasharray="5 3"' if dashes else ""))
        out += ['<circle cx="%.1f" cy="%.1f" r="2.6" fill="%s"><title>depth %d</title></circle>' % (q[1], q[2], color, q[0]) for q in p]
        out.append('<text x="%d" y="%d" fill="%s">%s</text>' % (PAD + 10, H - PAD - 90 + 14 * i, color, name))
    return out + ["</g>"]


def pictures():
    left = [("%s x %s, %s" % (s, s, k), COLORS[i], k == "portable", [r for r in rows if r["samples"] == s and r["kernel"] == k and r["delta"] == "1"])
            for i, s in enumerate(("1", "2", "4")) for k in ("avx512", "portable")]
    right = [("delta %s" % d, COLORS[i], "", [r for r in rows if r["samples"] == "4" and r["kernel"] == "avx512" and r["delta"] == d]) for i, d in enumerate(("0", "1", "2", "4"))]
    return [panel(0, "seconds", "thread CPU seconds a picture (points: depths)", left), panel(W, "bytes", "bytes of the .svdag (points: depths)", right)]


def poses():
    out = []
    for n, pose in enumerate(dict.fromkeys(r["pose"] for r in rows)):
        groups = [(m, COLORS[i], False, [r for r in rows if r["pose"] == pose and r["resample"] == m and r["delta"] == "1"]) for i, m in enumerate(dict.fromkeys(r["resample"] for r in rows))]
        out.append(panel(n * W, "seconds", pose + ": thread CPU seconds a picture (points: depths)", groups))
    return out


panels = poses() if "pose" in rows[0] else pictures()
out = ['<svg xmlns="http://www.w3.org/2000/svg" width="%d" height="%d" font-family="sans-serif" font-size="11">' % (len(panels) * W + 10, H + 20), '<rect width="100%" height="100%" fill="white"/>']
out += sum(panels, [])
out.append("</svg>")
open(sys.argv[2], "w").write("\n".join(out) + "\n")
