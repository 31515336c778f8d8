#!/usr/bin/env python3
"""The measurements of Willcocks 2013, section 3.4: pixels covered by direct, resize and emit (figures 20 to 25), and samples a voxel (figures 27 and 28).

    python3 tests/bench/bench_deform.py TOOLS MODEL FOLDER OUT.csv OUT.svg [DEPTH]

A model at a low resolution (depth 6 unless given, so that single voxels are seen), under shear of x by y, twist about y (radians along the whole height) and scale of all axes.
Pixels are counted in transparent pictures; the camera holds the sheared shape in view. As in the thesis, direct (boxes as they are) is the reference."""
import csv, json, math, pathlib, struct, subprocess, sys, zlib

AMOUNTS = [0.2, 0.4, 0.8, 1.6, 3.2, 6.4, 12.8]


def covered(path):
    """Pixels that are not transparent in an RGBA PNG."""
    data, at, body = path.read_bytes(), 8, b""
    while at < len(data):
        size, kind = struct.unpack(">I4s", data[at:at + 8])
        if kind == b"IHDR":
            w, h = struct.unpack(">II", data[at + 8:at + 16])
        if kind == b"IDAT":
            body += data[at + 8:at + 8 + size]
        at += size + 12
    raw, stride, before, n = zlib.decompress(body), 4 * w, bytes(4 * w), 0
    for y in range(h):
        f, line = raw[y * (stride + 1)], bytearray(raw[y * (stride + 1) + 1:(y + 1) * (stride + 1)])
        for i in range(3, stride, 4):  # alpha only: filters work byte by byte, four apart
            a, b, c = line[i - 4] if i >= 4 else 0, before[i], before[i - 4] if i >= 4 else 0
            if f == 1: line[i] = line[i] + a & 255
            elif f == 2: line[i] = line[i] + b & 255
            elif f == 3: line[i] = line[i] + (a + b) // 2 & 255
            elif f == 4:
                p = a + b - c
                pa, pb, pc = abs(p - a), abs(p - b), abs(p - c)
                line[i] = line[i] + (a if pa <= pb and pa <= pc else b if pb <= pc else c) & 255
            n += line[i] != 0
        before = line
    return n


def main():
    tools, model, folder = (pathlib.Path(p) for p in sys.argv[1:4])
    depth = sys.argv[6] if len(sys.argv) > 6 else "6"
    folder.mkdir(parents=True, exist_ok=True)
    run = lambda *c: subprocess.run([str(x) for x in c], check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    run(tools / "svo-voxelize", model, "-o", folder / "m.svo", "-f", "--depth", depth)
    run(tools / "svo-compress", folder / "m.svo", "-o", folder / "m.svdag", "-f")
    d = json.loads(subprocess.check_output([tools / "svo-dump", folder / "m.svdag", "--json"]))
    m, n = d["voxel_to_world"], 2 ** d["depth"]
    middle, size = [m[4 * k + 3] + m[5 * k] * n / 2 for k in range(3)], m[0] * n
    rows = []
    for kind, spec in (("shear", "shear=xy:%g"), ("twist", "twist=y:%g"), ("scale", "scale=%g")):
        for amount in AMOUNTS:
            value = math.degrees(amount) if kind == "twist" else 0.15 * amount if kind == "scale" else amount
            # a shear moves what is not at y = 0: look at where the middle goes, from where all of it is in view
            target, reach = list(middle), size
            if kind == "shear":
                target[0] += amount * middle[1]
                reach = size * (1 + amount)
            if kind == "scale":
                target, reach = [value * c for c in middle], 2 * size
            eye = [target[0], target[1], target[2] + 2.2 * reach]
            row = {"deformation": kind, "amount": value if kind == "scale" else amount}
            for method in ("direct", "resize", "emit"):
                run(tools / "svo-render", folder / "m.svdag", "-o", folder / "o.png", "-f", "--size", "800x600", "--background", "transparent", "--no-shadows",
                    "--footprint", 0, "--deform", spec % value, "--resample", method, "--eye", "%.9g,%.9g,%.9g" % tuple(eye), "--target", "%.9g,%.9g,%.9g" % tuple(target),
                    "--fov", 30, "--report", folder / "r.json")
                row[method + "_pixels"] = covered(folder / "o.png")
                # figures 27 and 28 count all voxels, seen or not: with shadows nothing is left out
                if method != "direct":
                    run(tools / "svo-render", folder / "m.svdag", "-o", folder / "o.png", "-f", "--size", "64x48", "--deform", spec % value, "--resample", method, "--delta", "0.001",
                        "--report", folder / "r.json")
                    r = json.loads((folder / "r.json").read_text())["deformation"]
                    row["voxels"] = r["selected"]
                    row[method + "_samples_per_voxel"] = round(r["samples"] / r["selected"], 3)
            for method in ("resize", "emit"):
                row[method + "_error_percent"] = round(100 * (row[method + "_pixels"] / row["direct_pixels"] - 1), 3)
            rows.append(row)
            print(row, file=sys.stderr, flush=True)
    keys = ["deformation", "amount", "voxels", "direct_pixels", "resize_pixels", "emit_pixels", "resize_error_percent", "emit_error_percent", "resize_samples_per_voxel", "emit_samples_per_voxel"]
    with open(sys.argv[4], "w", newline="") as f:
        w = csv.DictWriter(f, keys, lineterminator="\n")
        w.writeheader()
        w.writerows(rows)
    pathlib.Path(sys.argv[5]).write_text(plot(rows))


def plot(rows):
    W, H, L, T = 330, 260, 46, 40
    s = [f'<svg xmlns="http://www.w3.org/2000/svg" width="{3 * W}" height="{2 * H}" font-family="sans-serif" font-size="11"><rect width="{3 * W}" height="{2 * H}" fill="white"/>']
    for col, kind in enumerate(("shear", "twist", "scale")):
        mine = [r for r in rows if r["deformation"] == kind]
        for line, (what, title) in enumerate((("error_percent", "silhouette: pixels more than direct, %"), ("samples_per_voxel", "samples a voxel"))):
            x0, y0, w, h = col * W + L, line * H + T, W - L - 16, H - T - 34
            top = max(1e-9, max(r[m + "_" + what] for r in mine for m in ("resize", "emit"))) * 1.05
            x = lambda v: x0 + (math.log2(v) - math.log2(mine[0]["amount"])) / (math.log2(mine[-1]["amount"]) - math.log2(mine[0]["amount"])) * w
            y = lambda v: y0 + h - max(0, v) / top * h
            s.append(f'<text x="{x0}" y="{y0 - 12}">{kind}: {title}</text>')
            for k in range(5):
                s.append(f'<line x1="{x0}" x2="{x0 + w}" y1="{y0 + h * k / 4}" y2="{y0 + h * k / 4}" stroke="#ddd"/><text x="{x0 - 4}" y="{y0 + h * k / 4 + 4}" text-anchor="end">{top * (1 - k / 4):.3g}</text>')
            for r in mine:
                s.append(f'<text x="{x(r["amount"]):.1f}" y="{y0 + h + 14}" text-anchor="middle">{r["amount"]:.3g}</text>')
            for m, colour in (("resize", "#c0392b"), ("emit", "#2e8b57")):
                points = " ".join("%.1f,%.1f" % (x(r["amount"]), y(r[m + "_" + what])) for r in mine)
                s.append(f'<polyline fill="none" stroke="{colour}" stroke-width="2" points="{points}"/>')
    s.append(f'<text x="{W * 3 - 130}" y="16" fill="#c0392b">resize</text><text x="{W * 3 - 80}" y="16" fill="#2e8b57">emit</text></svg>')
    return "\n".join(s) + "\n"


main()
