"""Files made by an earlier build are read as they were meant: tests/golden holds some of every kind and coding, and what is in them."""

import json
import pathlib
import sys

import contents
import support
from support import check

GOLDEN = pathlib.Path(sys.argv[2]).resolve() / "tests/golden"
TOOLS = pathlib.Path(sys.argv[1]).resolve()


def test_golden_files_hold_what_they_held(folder):
    wanted = json.loads((GOLDEN / "golden.json").read_text())
    files = {f.name for f in GOLDEN.iterdir() if f.suffix in (".svo", ".svdag", ".svscene", ".skel")}
    check(files == set(wanted) and len(files) >= 15, files ^ set(wanted))
    for name, what in wanted.items():
        check(contents.of(TOOLS, GOLDEN / name) == what, (name, contents.of(TOOLS, GOLDEN / name), what))


def test_codings_of_one_octree_hold_the_same(folder):
    """Without loss, whatever the form."""
    wanted = json.loads((GOLDEN / "golden.json").read_text())
    same = [wanted[n] for n in ("cubes.svo", "cubes_small.svo", "cubes_zstd.svo", "cubes_svdag.svdag", "cubes_symmetric.svdag", "cubes_fast.svdag", "cubes_best.svdag")]
    check(all(w["voxels_digest"] == same[0]["voxels_digest"] and w["levels"] == same[0]["levels"] for w in same), same)
    packed = [w for w in same if w["format"] == "svdag"]
    check(len(packed) == 4 and len({w["inner_digest"] for w in packed}) == 1, packed)


support.main(globals())
