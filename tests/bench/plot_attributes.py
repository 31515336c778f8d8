#!/usr/bin/env python3
"""Error against bytes as a plot:  plot_attributes.py IN.csv OUT.svg   (IN.csv as bench_attributes prints it)

Left: bits a value against the mean CIE94 difference; right: against PSNR. Logarithmic bits. One stream a file."""
import csv
import math
import sys

rows = list(csv.DictReader(open(sys.argv[1])))
W, H, PAD = 460, 380, 56
COLORS = {"Algorithm 1": "#c0392b", "two endpoints": "#7f8c8d", "blocks: bound": "#2c6fbb", "blocks: bound and mean": "#1e8449", "blocks: bound and squares": "#8e44ad"}


def series(row):
    if row["method"] != "blocks":
        return row["method"]
    s = row["setting"]
    return "blocks: bound and squares" if "square" in s else "blocks: bound and mean" if "unit" in s else "blocks: bound"


def panel(x0, key, label, low, high, points):
    out = ['<g transform="translate(%d,10)">' % x0]
    bits = (0.5, 12)
    px = lambda v: PAD + (v - low) / (high - low) * (W - PAD - 12)
    py = lambda v: H - PAD - math.log(v / bits[0]) / math.log(bits[1] / bits[0]) * (H - PAD - 12)
    for b in (0.5, 1, 2, 4, 8, 12):
        out.append('<path d="M%.1f %.1fH%d" stroke="#ddd"/><text x="%d" y="%.1f" text-anchor="end">%g</text>' % (PAD, py(b), W - 12, PAD - 6, py(b) + 4, b))
    steps = 6
    for i in range(steps + 1):
        v = low + (high - low) * i / steps
        out.append('<path d="M%.1f 12V%d" stroke="#eee"/><text x="%.1f" y="%d" text-anchor="middle">%.3g</text>' % (px(v), H - PAD, px(v), H - PAD + 16, v))
    out.append('<text x="%d" y="%d" text-anchor="middle">%s</text>' % ((W + PAD) / 2, H - PAD + 36, label))
    out.append('<text transform="translate(14,%d) rotate(-90)" text-anchor="middle">bits a value</text>' % (H / 2))
    for name, color in COLORS.items():
        p = sorted((float(r[key]), float(r["bits_per_value"])) for r in points if series(r) == name and low <= float(r[key]) <= high and float(r["bits_per_value"]) <= 12)
        if p:
            out.append('<path d="M%s" fill="none" stroke="%s" stroke-width="1.6"/>' % ("L".join("%.1f %.1f" % (px(a), py(b)) for a, b in p), color))
            out += ['<circle cx="%.1f" cy="%.1f" r="2.6" fill="%s"/>' % (px(a), py(b), color) for a, b in p]
    return out + ["</g>"]


out = ['<svg xmlns="http://www.w3.org/2000/svg" width="%d" height="%d" font-family="sans-serif" font-size="11">' % (2 * W + 10, H + 40),
       '<rect width="100%" height="100%" fill="white"/>']
out += panel(0, "mean_delta_e", "mean difference (CIE94)", 0, 2.1, rows) + panel(W, "psnr", "PSNR (dB)", 32, 56, rows)
for i, (name, color) in enumerate(COLORS.items()):
    out.append('<rect x="%d" y="%d" width="10" height="10" fill="%s"/><text x="%d" y="%d">%s</text>' % (60 + 165 * i, H + 20, color, 74 + 165 * i, H + 29, name))
out.append("</svg>")
open(sys.argv[2], "w").write("\n".join(out) + "\n")
