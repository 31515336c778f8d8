"""Same bytes from every compiler: no product is fused with a sum but where a source asks for it (fma(), the kernels' intrinsics). gcc 12 does it in straight code for products that are added and
subtracted by turns, in spite of -ffp-contract=off; svo_unfused (cmake/SvoFlags.cmake) is for the files that this test names."""

import re
import shutil
import subprocess

import support
from support import check, skip

LIBRARIES = ("libsvo/libsvo.a", "libskel/libsvoskel.a", "formats/libsvoformats.a")
FUSED = re.compile(r"\bvfm(addsub|subadd)\d")


def test_nothing_is_fused_behind_the_sources(folder):
    if shutil.which("objdump") is None:
        skip("objdump is not installed")
    build, found, seen = support.tools.parent, set(), 0
    for library in LIBRARIES:
        text = subprocess.run(["objdump", "-d", "--no-show-raw-insn", str(build / library)], check=True, stdout=subprocess.PIPE).stdout.decode()
        member = None
        for line in text.split("\n"):
            if ":     file format" in line:
                member = line.split(":")[0]
                seen += 1
            elif FUSED.search(line):
                found.add(member)
    check(seen > 100, "%d objects" % seen)
    check(not found, "fused: %s" % ", ".join(sorted(found)))


support.main(globals())
