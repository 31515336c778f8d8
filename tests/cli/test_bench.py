"""svo-bench: rows, documents and failures. Times are read, never judged."""

import csv
import io
import json
import math
import subprocess
import time
import xml.etree.ElementTree as xml

import support
from support import check, run, tool

SVG = "{http://www.w3.org/2000/svg}"


def rows_of(path):
    text = path.read_bytes().decode("utf-8")
    rows = list(csv.DictReader(io.StringIO(text, newline="")))
    check(all(None not in r and None not in r.values() for r in rows), "ragged CSV: " + text)
    return rows


def numbers(rows, column):
    return [float(r[column]) for r in rows]


def falls(values):
    return all(a > b for a, b in zip(values, values[1:]))


def picture(path):
    """The panels' points, (x, y) of each marker, and all the text."""
    root = xml.fromstring(path.read_bytes())
    check(root.tag == SVG + "svg", root.tag)
    panels = [[g for g in p.iter(SVG + "g") if g.get("class") == "point"] for p in root.iter(SVG + "g") if p.get("class") == "panel"]
    check(len(panels) == 2, "%d panels" % len(panels))
    return root, panels


def all_output(folder):
    return ["--csv", folder / "o.csv", "--json", folder / "o.json", "--svg", folder / "o.svg"]


def painted_cube(folder):
    """A cube with a smooth, colourful texture."""
    texture = support.write_png(None, 64, 64, lambda x, y: (4 * x, 4 * y, 2 * (x + y) % 256))
    return support.cube_glb(folder / "painted.glb", texture=texture)


def test_html(folder):
    """One page: well-formed, with the plots, every row and column, the command and the host; nothing from elsewhere, nothing that runs."""
    ball = support.sphere_obj(folder / "ball & <b>.obj", rings=8)
    r = tool("svo-bench", ball, folder / "none.obj", "--sweep", "depth", "--values", "3..5", "--repeat", 1, "--html", folder / "o.html", *all_output(folder))
    check(r.code == 2, r)
    text = (folder / "o.html").read_text()
    check(text.startswith("<!DOCTYPE html>\n") and "<script" not in text and "href=" not in text and "src=" not in text and "url(" not in text)
    root = xml.fromstring(text.split("\n", 1)[1].replace('<meta charset="utf-8">', "").replace('<meta name="viewport" content="width=device-width">', ""))
    check(len([p for p in root.iter(SVG + "g") if p.get("class") == "panel"]) == 2)
    svg = xml.fromstring((folder / "o.svg").read_bytes())
    check(sum(1 for _ in root.iter(SVG + "path")) == sum(1 for _ in svg.iter(SVG + "path")), "another picture")
    words = "".join(root.itertext())
    check("svo-bench " + str(ball) in words and "none.obj: cannot open" in words and "processors" in words)
    tables = {t.get("class"): t for t in root.iter("table")}
    head = [h.text for h in tables["all"].iter("th")]
    cells = [[c.text for c in row] for row in tables["all"].find("tbody")]
    given = rows_of(folder / "o.csv")
    check(len(cells) == len(given) == 6 and [c[0] for c in cells] == ["ball & <b>.obj"] * 3 + ["none.obj"] * 3)
    for row, cell in zip(given[:3], cells):
        check(cell[1] == row["depth"] and len(cell) == len(head))
        for name, shown in zip(head[2:], cell[2:]):
            check((shown == "-") == (row[name] == "") and (shown == "-" or math.isclose(float(shown), float(row[name]), rel_tol=1e-3, abs_tol=1e-4)), (name, shown, row[name]))
    check(len(list(tables["meaning"].iter("tr"))) == len(head) - 2)
    check(tool("svo-bench", ball, "--sweep", "depth", "--values", 3, "--html", folder / "x", "--svg", folder / "x").code == 1)
    both = run("svo-bench", ball, "--sweep", "depth", "--values", 3, "--repeat", 1, "--html", "-")
    check(both.text.startswith("<!DOCTYPE html>") and both.text.endswith("</body></html>\n"))


def test_depth(folder):
    ball, cube = support.sphere_obj(folder / "ball.obj", radius=2.5), support.cube_obj(folder / "cube.obj")
    depths = [3, 4, 5, 6, 7]
    r = run("svo-bench", ball, cube, "--sweep", "depth", "--values", "3..5,6,7", "--repeat", 2, "--report", folder / "r.json", *all_output(folder))
    rows = rows_of(folder / "o.csv")
    check([(x["model"], int(x["depth"])) for x in rows] == [(m, d) for m in ("ball.obj", "cube.obj") for d in depths], rows)
    for model in (rows[:5], rows[5:]):
        check(falls(numbers(model, "distance_mean_world")), numbers(model, "distance_mean_world"))
        for column in ("svo_bytes", "svdag_bytes", "voxels", "nodes"):
            check(falls([-x for x in numbers(model, column)]), column)
        for row in model:
            x = {k: float(v) for k, v in row.items() if k not in ("model", "error") and v != ""}
            check(set(row) - set(x) == {"model", "error", "color_error_mean", "color_error_max"}, "no colours, all else: %r" % row)
            check(0.2 < x["surface_to_voxel_mean_voxels"] <= x["surface_to_voxel_max_voxels"] <= x["distance_bound_voxels"] + x["snap_max_voxels"] + 1e-6, row)
            check(0 <= x["normal_error_mean"] <= x["normal_error_max"] < 20 and x["normal_error_mean"] < 1 and x["reference_voxels"] > 0, row)
            check(x["peak_rss_bytes"] > 1e6, row)
            check(0 < x["distance_mean_voxels"] <= x["distance_max_voxels"] <= x["distance_bound_voxels"] + x["snap_max_voxels"], row)
            check(math.isclose(x["distance_bound_voxels"], math.sqrt(3) / 2, rel_tol=1e-6), row)
            check(math.isclose(x["distance_mean_world"], x["distance_mean_voxels"] * x["voxel_size_world"], rel_tol=1e-6), row)
            check(math.isclose(x["svdag_bytes_per_voxel"], x["svdag_bytes"] / x["voxels"], rel_tol=1e-6), row)
            check(math.isclose(x["total_wall_s"], x["voxelize_wall_s"] + x["compress_wall_s"], rel_tol=1e-6, abs_tol=1e-9), row)
            check(x["voxelize_wall_s"] > 0 and x["compress_wall_s"] > 0 and x["voxelize_peak_bytes"] > 0 and x["compress_peak_bytes"] > 0, row)
            check(x["distance_samples"] > 0 and row["error"] == "", row)
    # a smaller error always costs more bytes here, so that every point is on that front
    check(all(x["pareto_bytes"] == "1" for x in rows), rows)
    # the same figures from the tools themselves
    run("svo-voxelize", ball, "-o", folder / "b.svo", "--depth", 6, "--report", folder / "v.json")
    v = support.report(folder / "v.json")
    row = rows[3]
    check(int(row["voxels"]) == v["output"]["voxels"] and int(row["nodes"]) == v["output"]["nodes"], v["output"])
    check(math.isclose(float(row["distance_mean_voxels"]), v["errors"]["centre_to_surface_mean"], rel_tol=1e-6), v["errors"])
    check(0 <= v["output"]["bytes"] - int(row["svo_bytes"]) < 1200, "only provenance may differ: %s, %s" % (v["output"]["bytes"], row["svo_bytes"]))
    run("svo-compress", folder / "b.svo", "-o", folder / "b.svdag", "--report", folder / "c.json")
    c = support.report(folder / "c.json")
    check(0 <= c["output"]["bytes"] - int(row["svdag_bytes"]) < 1800, (c["output"]["bytes"], row["svdag_bytes"]))
    check(int(row["geometry_bytes"]) == c["output"]["geometry_bytes"] and int(row["attribute_bytes"]) == c["output"]["attribute_bytes"], c["output"])
    # JSON holds the same rows
    data = json.loads((folder / "o.json").read_text())
    check(data["sweep"] == "depth" and data["repeat"] == 2 and data["host"]["processors"] >= 1 and data["host"]["compiler"], data["host"])
    names = {x["name"] for x in data["columns"]}
    check(names | {"model", "depth", "pareto_seconds", "pareto_bytes", "error"} == set(rows[0]), "columns")
    for a, b in zip(data["rows"], rows):
        for name in names:
            check(b[name] == "" if a[name] is None else math.isclose(a[name], float(b[name]), rel_tol=1e-8), (name, a[name], b[name]))
    # a marker a row in both panels
    root, panels = picture(folder / "o.svg")
    check([len(p) for p in panels] == [10, 10], "points")
    report = support.report(folder / "r.json")
    check(report["output"]["rows"] == 10 and report["output"]["rows_failed"] == 0 and len(report["rows"]) == 10, report["output"])
    check({"import", "voxelize", "compress", "write"} <= {p["name"] for p in report["phases"]}, report["phases"])
    lines = r.text.splitlines()
    check(len(lines) == 11 and len({len(x) for x in lines}) == 1, "the table is not aligned:\n" + r.text)


def test_documents_grow_with_the_sweep(folder):
    """A sweep that is stopped leaves the points it has measured."""
    ball = support.sphere_obj(folder / "ball.obj", rings=200)
    command = [str(support.tools / "svo-bench"), str(ball), "--sweep", "depth", "--values", "4..14", "--repeat", "1", "-q"] + [str(a) for a in all_output(folder)]
    sweep = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        for _ in range(3000):
            if (folder / "o.svg").exists() and len([x for x in rows_of(folder / "o.csv") if x["error"] == ""]) >= 2:
                break
            check(sweep.poll() is None, "the sweep ended")
            time.sleep(0.1)
    finally:
        sweep.kill()
        sweep.wait()
    rows = rows_of(folder / "o.csv")
    measured = [x for x in rows if x["error"] == ""]
    check(2 <= len(measured) < 11 == len(rows), rows)
    check(all(x["error"] == "not measured yet" and x["voxels"] == "" for x in rows if x not in measured), rows)
    check(len(json.loads((folder / "o.json").read_text())["rows"]) == 11, "JSON")
    _, panels = picture(folder / "o.svg")
    check(all(1 <= len(p) <= len(measured) for p in panels), "a marker for each point measured")
    check(sorted(p.name for p in folder.iterdir()) == ["ball.obj", "o.csv", "o.json", "o.svg"], "something else was left behind")


def test_points_lie_where_the_rows_say(folder):
    """Log axes: equal ratios are equal distances, more is right of and above less."""
    for clock in ("wall", "cpu"):
        points_lie(folder, clock)


def points_lie(folder, clock):
    run("svo-bench", support.sphere_obj(folder / "ball.obj"), "--sweep", "depth", "--values", "3..7", "--attributes", "none", "--repeat", 1, *all_output(folder), "--clock", clock, "-f")
    rows = rows_of(folder / "o.csv")
    _, panels = picture(folder / "o.svg")
    circles = [[(float(g.find(SVG + "circle").get("cx")), float(g.find(SVG + "circle").get("cy"))) for g in p] for p in panels]
    for points, column in zip(circles, ("total_%s_s" % clock, "svdag_bytes")):
        for axis, values in ((0, numbers(rows, column)), (1, numbers(rows, "distance_mean_percent"))):
            if min(values) <= 0:  # a clock too coarse for so little work: at the edge
                continue
            logs, at = [math.log10(v) for v in values], [p[axis] for p in points]
            # the line through the outermost points: coordinates have one decimal, and between close ones rounding would be the slope
            low, high = logs.index(min(logs)), logs.index(max(logs))
            if logs[low] == logs[high]:
                continue
            slope = (at[high] - at[low]) / (logs[high] - logs[low])
            check(slope > 0 if axis == 0 else slope < 0, (column, axis, slope))
            for l, a in zip(logs, at):
                check(abs(at[low] + slope * (l - logs[low]) - a) < 0.3, (column, axis, at, logs))
    check(all(r["attribute_bytes"] == "0" for r in rows), rows)


def test_color(folder):
    cube = painted_cube(folder)
    run("svo-bench", cube, "--sweep", "color", "--depth", 6, "--values", "2..8:2,deltaE=1,lossless", "--repeat", 1, *all_output(folder))
    rows = rows_of(folder / "o.csv")
    check([r["color"] for r in rows] == ["2", "4", "6", "8", "deltaE=1", "lossless"], rows)
    check(falls(numbers(rows[:4], "delta_e_mean")), numbers(rows, "delta_e_mean"))
    check(falls([-x for x in numbers(rows[:4], "channel_bytes")]), numbers(rows, "channel_bytes"))
    check(all(float(r["distinct_out"]) <= 2 ** int(r["color"]) for r in rows[:4]), rows)
    check(0 < float(rows[4]["delta_e_max"]) <= 1, rows[4])
    check(float(rows[5]["delta_e_max"]) == 0 and rows[5]["distinct_in"] == rows[5]["distinct_out"], rows[5])
    check(len({r["voxels"] for r in rows}) == 1 and all(r["grid_depth"] == "6" for r in rows), rows)
    root, panels = picture(folder / "o.svg")
    check([len(p) for p in panels] == [6, 6], "the error of 0 has its point at the edge")
    # colours that do not vary: nothing to sweep, but no failure
    r = run("svo-bench", support.cube_obj(folder / "grey.obj"), "--sweep", "color", "--values", "4,8", "--depth", 3, "--repeat", 1, "-f", *all_output(folder))
    check("grey.obj" in r.err and "same" in r.err, r)
    check(len(rows_of(folder / "o.csv")) == 2, "rows")
    picture(folder / "o.svg")


def test_normal(folder):
    ball = support.sphere_obj(folder / "ball.obj")
    run("svo-bench", ball, "--sweep", "normal", "--depth", 5, "--values", "6..14,deg=2", "--repeat", 1, *all_output(folder))
    rows = rows_of(folder / "o.csv")
    check([r["normal"] for r in rows] == ["6", "8", "10", "12", "14", "deg=2"], rows)
    check(falls(numbers(rows[:5], "degrees_mean")), numbers(rows, "degrees_mean"))
    check(0 < float(rows[5]["degrees_max"]) <= 2, rows[5])
    _, panels = picture(folder / "o.svg")
    check([len(p) for p in panels] == [6, 6], "points")


def test_omega(folder):
    ball = support.sphere_obj(folder / "ball.obj", rings=12)
    run("svo-bench", ball, "--sweep", "omega", "--values", "0.5,0.25", "--repeat", 1, *all_output(folder))
    rows = rows_of(folder / "o.csv")
    check([float(r["omega"]) for r in rows] == [0.5, 0.25], rows)
    run("svo-skeleton", ball, "-o", folder / "b.skel", "--omega", "0.25", "--report", folder / "s.json")
    s = support.report(folder / "s.json")
    for column in ("joints", "bones", "ends", "loops", "components", "iterations"):
        check(int(rows[1][column]) == s["output"][column], column)
    check(math.isclose(float(rows[1]["reconstruction_mean_percent"]), s["errors"]["reconstruction_mean"], rel_tol=1e-6), s["errors"])
    check(rows[1]["converged"] == "1" and s["output"]["converged"], rows)
    _, panels = picture(folder / "o.svg")
    check([len(p) for p in panels] == [2, 2], "points")


def test_methods(folder):
    """How a skeleton is made: what svo-skeleton and svo-compare say of the same runs, and the literal iteration beside itself."""
    ball = support.sphere_obj(folder / "ball.obj", rings=12)
    values = ["fast+grid@0.3", "fast+flann@0.3", "literal@0.3", "fast+contracted+delta@0.25"]
    run("svo-bench", ball, "--sweep", "method", "--values", ",".join(values), "--repeat", 1, *all_output(folder))
    rows = rows_of(folder / "o.csv")
    check([r["method"] for r in rows] == values, rows)
    options = [("--search", "grid"), (), ("--method", "literal"), ("--place", "contracted", "--delta", 0.05)]
    for row, option, omega in zip(rows, options, (0.3, 0.3, 0.3, 0.25)):
        run("svo-skeleton", ball, "-o", folder / "b.skel", "-f", "--omega", omega, "--report", folder / "s.json", *option)
        place = option[:2] if "--place" in option else ()
        run("svo-skeleton", ball, "-o", folder / "l.skel", "-f", "--omega", omega, "--method", "literal", *place)
        tool("svo-compare", folder / "b.skel", folder / "l.skel", "--report", folder / "c.json", "-f")
        out, distance = support.report(folder / "s.json")["output"], support.report(folder / "c.json")["comparison"]["skeleton"]
        for column in ("joints", "ends", "loops", "iterations"):
            check(int(row[column]) == out[column], (row, column))
        check(math.isclose(float(row["literal_distance_mean_omegas"]), distance["curve_distance_mean_omegas"], rel_tol=1e-6, abs_tol=1e-12), (row, distance))
        check(float(row["inscribed_balls_mean_percent"]) >= 0 and 0 <= float(row["length_inside_percent"]) <= 100, row)
    same = ("joints", "iterations", "inscribed_balls_mean_percent", "literal_distance_mean_omegas", "skel_bytes")
    check([rows[0][k] for k in same] == [rows[1][k] for k in same], "FLANN and the grid differ")
    check(float(rows[2]["literal_distance_mean_omegas"]) == 0 == float(rows[2]["literal_hausdorff_percent"]), rows[2])
    _, panels = picture(folder / "o.svg")
    check([len(p) for p in panels] == [4, 4], "points")


def test_figures_do_not_change_from_run_to_run(folder):
    ball = support.sphere_obj(folder / "ball.obj")
    seen = []
    for threads in (1, 2, 2):
        run("svo-bench", ball, "--sweep", "depth", "--values", "4,5", "--repeat", 1, "--threads", threads, "-f", "--csv", folder / "o.csv")
        # the peak of memory depends on which threads were busy at the same time
        seen.append([{k: v for k, v in r.items() if not k.endswith("_s") and "peak" not in k and k != "pareto_seconds"} for r in rows_of(folder / "o.csv")])
    check(seen[0] == seen[1] == seen[2], seen)


def test_a_bad_mesh_among_good_ones(folder):
    good, other = support.cube_obj(folder / "good.obj"), support.sphere_obj(folder / "other.obj")
    bad = folder / "bad.ply"
    bad.write_bytes(b"ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\n")
    r = tool("svo-bench", good, bad, other, folder / "missing.obj", "--sweep", "depth", "--values", "3,4", "--repeat", 1, "--report", folder / "r.json", *all_output(folder))
    check(r.code == 3 and "bad.ply" in r.err and "missing.obj" in r.err, r)  # the code of the first failure
    check(sum(": error: " in line for line in r.err.splitlines()) == 1, r)
    rows = rows_of(folder / "o.csv")
    check([x["model"] for x in rows] == [m for m in ("good.obj", "bad.ply", "other.obj", "missing.obj") for _ in range(2)], rows)
    check([bool(x["error"]) for x in rows] == [False, False, True, True, False, False, True, True], rows)
    check(all(x["voxels"] == "" for x in rows if x["error"]) and all(int(x["voxels"]) > 0 for x in rows if not x["error"]), rows)
    data = json.loads((folder / "o.json").read_text())
    check([x.get("error_code") for x in data["rows"]] == [None, None, "INVALID_DATA", "INVALID_DATA", None, None, "IO", "IO"], data["rows"])
    _, panels = picture(folder / "o.svg")
    check([len(p) for p in panels] == [4, 4], "points of good meshes alone")
    report = support.report(folder / "r.json")
    check(report["exit_code"] == 3 and report["output"]["rows_failed"] == 4, report)
    # nothing measured: no documents
    other = folder / "none"
    other.mkdir()
    r = tool("svo-bench", bad, "--sweep", "depth", "--values", "3", *all_output(other))
    check(r.code == 3 and not list(other.iterdir()), r)


def test_a_limit_fails_one_point(folder):
    """Memory that suffices for a small depth but not for a large one."""
    ball = support.sphere_obj(folder / "ball.obj")
    run("svo-bench", ball, "--sweep", "depth", "--values", "4", "--repeat", 1, "--threads", 1, "--csv", folder / "a.csv")
    r = tool("svo-bench", ball, "--sweep", "depth", "--values", "4,9", "--repeat", 1, "--threads", 1, "--memory", "6M", "--csv", folder / "o.csv")
    rows = rows_of(folder / "o.csv")
    check(r.code == 6 and [bool(x["error"]) for x in rows] == [False, True], "%s %s" % (r, rows))


def test_odd_names(folder):
    """Names are data: in CSV, XML and JSON they come back as they are, but for what XML cannot hold."""
    name = "a & <b>, \"q\" 'p' \N{GREEK SMALL LETTER OMEGA}]]>.obj"
    cube = support.cube_obj(folder / name)
    control = support.cube_obj(folder / "c\x01\n.obj")
    (folder / "sub").mkdir()
    twin = support.cube_obj(folder / "sub" / name)
    run("svo-bench", cube, control, twin, "--sweep", "depth", "--values", "2", "--repeat", 1, *all_output(folder))
    models = [r["model"] for r in rows_of(folder / "o.csv")]
    check(models == ["%s/%s" % (folder.name, name), "c\x01\n.obj", "sub/" + name], models)
    check([r["model"] for r in json.loads((folder / "o.json").read_text())["rows"]] == models, models)
    root, panels = picture(folder / "o.svg")
    titles = [g.find(SVG + "title").text for g in panels[0]]
    check(titles[2].startswith("sub/" + name + ", depth 2: "), titles)
    check(titles[1].startswith("c\ufffd\ufffd.obj, "), titles)
    legend = ["".join(g.itertext()) for g in root.iter(SVG + "g") if g.get("class") == "legend"]
    check(len(legend) == 3, legend)


def test_list(folder):
    sub = folder / "sub"
    sub.mkdir()
    support.cube_obj(sub / "a.obj"), support.cube_obj(sub / "b.obj", size=2)
    names = sub / "list.txt"
    names.write_bytes(b"# two cubes\r\na.obj\r\n\nb.obj")
    first = support.sphere_obj(folder / "first.obj", rings=6)
    run("svo-bench", first, "--list", names, "--sweep", "depth", "--values", "2", "--repeat", 1, "--csv", folder / "o.csv")
    check([r["model"] for r in rows_of(folder / "o.csv")] == ["first.obj", "a.obj", "b.obj"], "list")
    for content, code in ((b"# none\n", 3), (b"a.obj\0", 3), (b"x" * 5000, 3)):
        names.write_bytes(content)
        check(tool("svo-bench", "--list", names, "--sweep", "depth").code == code, content[:20])
    check(tool("svo-bench", "--list", folder / "missing.txt", "--sweep", "depth").code == 2)
    # a mesh of the list is an input too
    names.write_text("a.obj\n")
    before = (sub / "a.obj").read_bytes()
    check(tool("svo-bench", "--list", names, "--sweep", "depth", "-f", "--csv", sub / "a.obj").code == 1)
    check(tool("svo-bench", "--list", names, "--sweep", "depth", "-f", "--svg", names).code == 1)
    check((sub / "a.obj").read_bytes() == before and names.read_text() == "a.obj\n", "inputs are as they were")


def test_usage(folder):
    cube = support.cube_obj(folder / "cube.obj")
    bad = [[], ["--sweep", "size"], ["--sweep", "depth", "--depth", "4"], ["--sweep", "color", "--attributes", "none"], ["--sweep", "depth", "--repeat", "0"]]
    bad += [["--sweep", "depth", "--values", v] for v in ("22", "-1", "1.5", "", ",", "3,", "5..3", "3..", "..3", "3..5:0", "3,3", "3..5,4", "lossless", "deltaE=1", "1e1x", "0x4", " 4")]
    bad += [["--sweep", "color", "--values", v] for v in ("0", "17", "deltaE=0", "deltaE=", "deltaE=-1", "deltaE=nan", "deg=1")]
    bad += [["--sweep", "normal", "--values", v] for v in ("3", "5", "34", "deltaE=1")]
    bad += [["--sweep", "omega", "--values", v] for v in ("0", "5", "0.1..0.2", "inf")]
    bad += [["--sweep", "method", "--values", v] for v in ("fast", "@0.1", "slow@0.1", "fast+@0.1", "fast@", "fast@5", "fast@0x1", "fast@0.1,fast@0.1", "fast grid@0.1")]
    bad += [["--sweep", "omega", "--values", ",".join("0.%03d" % i for i in range(100, 170))]]
    same = folder / "same.out"
    bad += [["--sweep", "depth", "--csv", same, "--svg", same], ["--sweep", "depth", "--json", folder / "r.json", "--report", folder / "r.json"], ["--sweep", "depth", "-f", "--csv", cube]]
    for words in bad:
        r = tool("svo-bench", cube, *words)
        check(r.code == 1 and "--help" in r.err and r.out == b"", r)
    check(tool("svo-bench", "--sweep", "depth").code == 1 and tool("svo-bench", "-", "--sweep", "depth").code == 1)
    check(not same.exists(), "no output after a usage error")
    check(support.report(folder / "r.json")["exit_code"] == 1, "the report says why")


def test_documents_on_stdout_and_existing_files(folder):
    cube = support.cube_obj(folder / "cube.obj")
    words = [cube, "--sweep", "depth", "--values", "2,3", "--repeat", 1]
    r = run("svo-bench", *words, "--csv", "-")
    check(len(list(csv.DictReader(io.StringIO(r.text)))) == 2 and r.text.startswith("model,depth,"), r)
    r = run("svo-bench", *words, "--svg", "-")
    check(xml.fromstring(r.out).tag == SVG + "svg", r)
    check(len(run("svo-bench", *words, "--json", "-").json["rows"]) == 2)
    kept = folder / "kept.csv"
    kept.write_text("precious")
    r = tool("svo-bench", *words, "--csv", kept, "--json", folder / "new.json")
    check(r.code == 2 and "--force" in r.err and kept.read_text() == "precious" and not (folder / "new.json").exists(), r)
    run("svo-bench", *words, "--csv", kept, "--force")
    check(len(rows_of(kept)) == 2)
    check(tool("svo-bench", *words, "--csv", folder / "nowhere" / "o.csv").code == 2)


support.main(globals())
