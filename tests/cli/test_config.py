"""Options by file and by environment: every option of every tool, precedence, what is refused and where, and what svo-build does not let through."""

import json
import os
import re

import support
from support import check, run, tool

ALONE = {"output", "force", "report", "help", "version", "config", "no-config"}


def tools():
    return sorted(p.stem.replace("_", "-") for p in (support.source / "tools").glob("svo_*.c"))


def variable(prefix, option):
    return (prefix + "_" + option).upper().replace("-", "_")


def env(**variables):
    clean = {k: v for k, v in os.environ.items() if not k.startswith("SVO_") and k not in ("XDG_CONFIG_HOME",)}
    return dict(clean, **{"SVOKIT_CONFIG": "", **variables})


def config(folder, *lines, name="c.conf"):
    path = folder / name
    path.write_text("\n".join(lines) + "\n")
    return path


def test_every_option_of_every_tool(folder):
    """No option takes an empty value: each must be refused by name, from a file with its line, and from the environment."""
    seen = 0
    for name in tools():
        for option in re.findall(r"^  (?:-\w, |    )--([A-Za-z0-9-]+)", run(name, "--help").text, re.M):
            seen += 1
            path = config(folder, "# a comment", "", "[%s]" % name, "%s =" % option)
            by_file = tool(name, "x", env=env(SVOKIT_CONFIG=str(path)))
            check(by_file.code == 1 and "%s:4: %s" % (path, option) in by_file.err, by_file)
            by_variable = tool(name, "x", env=env(**{variable(name, option): ""}))
            check(by_variable.code == 1 and variable(name, option) in by_variable.err, by_variable)
            check(("command line alone" in by_file.err) == (option in ALONE), by_file)
            if option in ("threads", "memory", "quiet", "verbose", "progress", "no-progress"):
                common = tool(name, "x", env=env(**{variable("svokit", option): ""}))
                check(common.code == 1 and variable("svokit", option) in common.err, common)
                common = tool(name, "x", "--config", config(folder, "%s =" % option), env=env())
                check(common.code == 1 and "c.conf:1: %s" % option in common.err, common)
    check(seen > 250, seen)


def test_precedence(folder):
    cube = support.cube_obj(folder / "c.obj")
    path = config(folder, "[svo-voxelize]", "threads = 2", "depth=3", "attributes = none", "[svo-compress]", "anything = 1", name="all.conf")
    path.write_text("threads = 1\nmemory = 1.5G\n" + path.read_text())
    report = folder / "r.json"

    def options(*more, **variables):
        run("svo-voxelize", cube, "-o", folder / "c.svo", "-f", "--report", report, *more, env=env(**variables))
        data = support.report(report)
        return {k: data["options"][k] for k in ("threads", "depth", "attributes", "memory")}, data.get("settings", [])

    where = {"SVOKIT_CONFIG": str(path)}
    seen, told = options(**where)
    check(seen == {"threads": 2, "depth": 3, "attributes": "none", "memory": 3 << 29}, seen)
    check({(t["option"], t["value"], t["from"]) for t in told} == {("threads", "1", "%s:1" % path), ("memory", "1.5G", "%s:2" % path), ("threads", "2", "%s:4" % path),
                                                                  ("depth", "3", "%s:5" % path), ("attributes", "none", "%s:6" % path)}, told)
    check(options(SVOKIT_THREADS="3", **where)[0]["threads"] == 3)
    check(options(SVOKIT_THREADS="3", SVO_VOXELIZE_THREADS="4", SVO_VOXELIZE_DEPTH="5", **where)[0] == {"threads": 4, "depth": 5, "attributes": "none", "memory": 3 << 29})
    check(options("--threads", 6, "-d7", "--attributes=color", SVO_VOXELIZE_THREADS="4", SVO_VOXELIZE_DEPTH="5", **where)[0] == {"threads": 6, "depth": 7, "attributes": "color", "memory": 3 << 29})
    # --config over SVOKIT_CONFIG, that over the file in the home folder; --no-config over all, the environment too
    other = config(folder, "[ svo-voxelize ]", "  depth =  4\r", "; note", "fill=solid", name="other.conf")
    check(options("--config", other, **where)[0]["depth"] == 4)
    check(options("--no-config", "--depth", 2, SVO_VOXELIZE_FILL="nonsense", **where) == ({"threads": 0, "depth": 2, "attributes": "auto", "memory": 0}, []))
    (folder / "home/.config").mkdir(parents=True)
    config(folder / "home/.config", "[svo-voxelize]", "depth = 6", name="svokit.conf")
    (folder / "xdg").mkdir()
    config(folder / "xdg", "[svo-voxelize]", "depth = 8", name="svokit.conf")
    at_home = env(HOME=str(folder / "home"))
    for more, depth in (({}, 6), ({"XDG_CONFIG_HOME": str(folder / "xdg")}, 8), (where, 3)):
        e = dict(at_home, **more)
        if "SVOKIT_CONFIG" not in more:
            del e["SVOKIT_CONFIG"]
        run("svo-voxelize", cube, "-o", folder / "c.svo", "-f", "--report", report, env=e)
        check(support.report(report)["options"]["depth"] == depth, (more, depth))
    # a file made with settings is the file made with options, but for nothing
    run("svo-voxelize", cube, "-o", folder / "a.svo", "--depth", 3, "--attributes", "none", env=env())
    run("svo-voxelize", cube, "-o", folder / "b.svo", env=env(**where))
    check((folder / "a.svo").read_bytes() == (folder / "b.svo").read_bytes())


def test_flags(folder):
    cube = support.cube_obj(folder / "c.obj")
    out = ["-o", folder / "c.svo", "-f", "--depth", 3]
    (folder / "m.json").write_text(json.dumps({"assets": []}))
    check(run("svo-build", folder / "m.json", env=env(SVOKIT_QUIET="true")).err == "")
    check(run("svo-build", folder / "m.json", env=env(SVOKIT_QUIET="false")).err != "")
    run("svo-voxelize", cube, *out, "--report", folder / "r.json", env=env(SVOKIT_VERBOSE="2"))
    check(support.report(folder / "r.json")["options"]["verbose"] == 2)
    check(tool("svo-voxelize", cube, *out, env=env(SVOKIT_QUIET="yes")).code == 1)


def test_what_is_refused(folder):
    cube = support.cube_obj(folder / "c.obj")
    for lines, line, word in ((["depth = 9"], 1, "[svo-NAME]"), (["[svo-voxelize]", "dpeth = 9"], 2, "dpeth: unknown option"), (["", "[svo-voxel]"], 2, "a section"),
                              (["[svo-voxelize"], 1, "a section"), (["["], 1, "a section"), (["[svo-voxelize]", "depth"], 2, "OPTION = VALUE"), (["[svo-voxelize]", "depth = 99"], 2, "range"),
                              (["quiet = maybe"], 1, "true or false"), (["force = true"], 1, "command line alone"), (["[svo-voxelize]", "", "output=x"], 3, "command line alone"),
                              (["memory = lots"], 1, "size")):
        path = config(folder, *lines)
        r = tool("svo-voxelize", cube, "-o", folder / "c.svo", "--config", path, env=env())
        check(r.code == 1 and "%s:%d: " % (path, line) in r.err and word in r.err and not (folder / "c.svo").exists(), (lines, str(r)))
    (folder / "nul.conf").write_bytes(b"threads = 1\0\n")
    check(tool("svo-voxelize", cube, "-o", folder / "c.svo", "--config", folder / "nul.conf", env=env()).code == 1)
    (folder / "large.conf").write_bytes(b"#" * (2 << 20))
    check(tool("svo-voxelize", cube, "-o", folder / "c.svo", "--config", folder / "large.conf", env=env()).code == 6)
    for named in (("--config", folder / "none.conf"), ("--config=%s" % (folder / "none.conf"),)):
        r = tool("svo-voxelize", cube, "-o", folder / "c.svo", *named, env=env())
        check(r.code == 2 and "none.conf" in r.err, r)
    check(tool("svo-voxelize", cube, "-o", folder / "c.svo", env=env(SVOKIT_CONFIG=str(folder / "none.conf"))).code == 2)
    check(tool("svo-voxelize", cube, "-o", folder / "c.svo", "--config", env=env()).code == 1)
    r = tool("svo-voxelize", cube, "-o", folder / "c.svo", env=env(SVO_VOXELIZE_DEPHT="3"))
    check(r.code == 1 and "SVO_VOXELIZE_DEPHT" in r.err, r)
    r = tool("svo-voxelize", cube, "-o", folder / "c.svo", env=env(SVO_VOXELIZE_FORCE="true"))
    check(r.code == 1 and "SVO_VOXELIZE_FORCE" in r.err, r)
    # another tool's variable and section are not looked into, and help needs neither
    check(tool("svo-voxelize", cube, "-o", folder / "c.svo", "--depth", 3, env=env(SVO_PACK_NONSENSE="1", SVOKIT_OTHER="1")).code == 0)
    check(tool("svo-voxelize", "--help", env=env(SVOKIT_CONFIG=str(folder / "none.conf"))).code == 0)


def test_steps_of_a_batch_do_not_see_it(folder):
    support.cube_obj(folder / "c.obj")
    (folder / "m.json").write_text(json.dumps({"output": "out", "defaults": {"voxelize": {"depth": 4}}, "assets": [{"name": "a", "input": "c.obj"}]}))
    path = config(folder, "[svo-voxelize]", "fill = solid", "[svo-build]", "jobs = 1")
    run("svo-build", folder / "m.json", "-q", "--config", path, "--report", folder / "r.json", env=env(SVO_VOXELIZE_DEPTH="2", SVO_COMPRESS_NONSENSE="1"))
    check(support.report(folder / "r.json")["options"]["jobs"] == 1)
    data = json.loads((folder / "out/.svo-build/a.voxelize.report.json").read_text())
    check(data["options"]["depth"] == 4 and data["options"]["fill"] == "surface" and "settings" not in data, data["options"])


support.main(globals())
