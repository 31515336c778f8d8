"""What svo-dump --validate accepts makes no other tool fail: valid files are changed at random inside their hashes, and those that are still accepted go
through every tool that reads their kind. Refused they may be for what is not supported or over a limit, never as invalid, and never by a crash.

    SVOKIT_MUTANTS=1000 SVOKIT_TEST_SEED=5 test_accepted.py TOOLS SOURCE     more copies of each file, others
    SVOKIT_CORPUS=FOLDER test_accepted.py TOOLS SOURCE corpus                 the files of a fuzzing corpus
"""

import json
import os
import pathlib
import shutil
import subprocess
import sys

import support
from support import check, tool

SEED = int(os.environ.get("SVOKIT_TEST_SEED", "1"))
COPIES = int(os.environ.get("SVOKIT_MUTANTS", "12"))
GOOD = (0, 5, 6)
LIMITS = ["--threads", 2, "--memory", "512M"]


def seeds(folder, ending):
    out = folder / "seeds"
    if not out.exists():
        subprocess.run([sys.executable, str(support.source / "tests/fuzz/make_seeds.py"), str(support.tools), str(out)], check=True, timeout=300,
                       stdout=subprocess.DEVNULL)
    return sorted((out / "container").glob("*" + ending))


def mutants(folder, ending):
    program = support.tools.parent / "tests/fuzz/mutate_files"
    if not program.exists():
        support.skip("no mutate_files beside the tools")
    out = folder / "mutants"
    out.mkdir()
    subprocess.run([str(program), str(SEED), str(COPIES), str(out)] + [str(f) for f in seeds(folder, ending)], check=True, timeout=300)
    return sorted(out.iterdir())


def accepted(files):
    """Those that --validate finds valid, asked for many at a time."""
    good = []
    for i in range(0, len(files), 200):
        r = tool("svo-dump", "--validate", "--json", *files[i:i + 200])
        check(r.code in (0, 3, 5), r)
        verdicts = json.loads(r.out)
        verdicts = verdicts if isinstance(verdicts, list) else [verdicts]
        check(len(verdicts) == len(files[i:i + 200]), "a file without a verdict")
        good += [f for f, v in zip(files[i:i + 200], verdicts) if v["valid"]]
        check(all(v["valid"] == (v["messages"] == []) for v in verdicts), "a verdict without a reason")
    return good


def through(folder, path, runs):
    """Run them all; an error names the bytes, so that the finding can be kept."""
    for command in runs:
        r = tool(*command, *LIMITS)
        if r.code not in GOOD:
            kept = pathlib.Path(os.environ.get("SVOKIT_KEEP", "/tmp")) / ("accepted-" + path.name)
            kept.write_bytes(path.read_bytes())
            check(False, "%s is accepted by --validate (kept as %s), but: %s" % (path.name, kept, r))
        if command[0] == "svo-dump" and r.code == 0 and str(command[-1]).endswith(".html"):
            check((folder / "o.html").stat().st_size > 1000, "an empty page")


def common(folder, path):
    return [("svo-dump", path, "--json"), ("svo-dump", path, "-f", "--html", folder / "o.html")]


def drawn(folder, path):
    return [("svo-render", path, "-f", "-o", folder / "o.png", "--size", "24x16"),
            ("svo-dump", path, "-f", "--voxels", folder / "v.ply", "--limit", 100000),
            ("svo-dump", path, "-f", "--export", folder / "o.ply", "--limit", 100000),
            ("svo-dump", path, "-f", "--export", folder / "o.vox", "--limit", 100000),
            ("svo-compare", path, path)]


def octree(folder, path):
    yield from common(folder, path) + drawn(folder, path)
    for mode in ("svdag", "fast", "symmetric", "best"):
        yield ("svo-compress", path, "-f", "-o", folder / "c.svdag", "--geometry", mode, "--color", "deltaE=2" if mode == "fast" else "lossless", "--normal", "deg=5" if mode == "best" else "lossless")
    yield ("svo-merge", path, "-f", "-o", folder / "m.svo", "--disk", "small")
    yield ("svo-merge", path, "-f", "-o", folder / "m.svo", "--disk", "fast", "--level", 3)
    yield ("svo-skeleton", path, "-f", "-o", folder / "s.skel", "--omega", 0.3)


def packed(folder, path):
    scene = folder / "scene.json"
    scene.write_text(json.dumps({"assets": [{"name": "a", "file": str(path.relative_to(folder))}], "instances": [{"asset": "a"}, {"asset": "a", "translation": [3, 0, 0], "scale": [1, 2, 1]}]}))
    yield from common(folder, path) + drawn(folder, path)
    yield ("svo-pack", scene, "-f", "-o", folder / "p.svscene")
    yield ("svo-render", path, "-f", "-o", folder / "d.png", "--size", "16x16", "--deform", "twist=y:40")


def packed_scene(folder, path):
    yield from common(folder, path) + drawn(folder, path)


def skeleton(folder, path):
    yield from common(folder, path)[:1] + [("svo-compare", path, path)]


KINDS = {".svo": octree, ".svdag": packed, ".svscene": packed_scene, ".skel": skeleton}


def over(folder, files, least):
    good = accepted(files)
    check(len(good) >= least, "only %d of %d are accepted: nothing was tested" % (len(good), len(files)))
    done = 0
    for path in good:
        through(folder, path, KINDS[path.suffix](folder, path))
        done += 1
    print("  %d of %d changed files are accepted, and went through the tools" % (done, len(files)))


def test_octrees(folder):
    over(folder, mutants(folder, ".svo"), COPIES // 4)


def test_packed_octrees(folder):
    over(folder, mutants(folder, ".svdag"), COPIES // 4)


def test_octrees_that_were_findings(folder):
    """Sound files that a tool once refused as invalid."""
    found = sorted((support.source / "tests/fuzz/regressions/svdag").glob("ok-*.svdag"))
    for path in found:
        shutil.copy(path, folder)
    over(folder, [folder / p.name for p in found], 1)


def test_scenes(folder):
    over(folder, mutants(folder, ".svscene"), 1)


def test_skeletons(folder):
    over(folder, mutants(folder, ".skel"), 1)


def test_corpus(folder):
    if "SVOKIT_CORPUS" not in os.environ:
        support.skip("no folder of a fuzzing corpus (SVOKIT_CORPUS)")
    files = []
    kinds = {b"SVO ": ".svo", b"SVDG": ".svdag", b"SCNE": ".svscene", b"SKEL": ".skel"}
    for p in sorted(pathlib.Path(os.environ["SVOKIT_CORPUS"]).iterdir()):
        data = p.read_bytes()
        if data[:4] == b"\x89SVX" and data[16:20] in kinds:
            path = folder / (p.name[:16] + kinds[data[16:20]])
            path.write_bytes(data)
            files.append(path)
    over(folder, files, 1)


support.main(globals())
